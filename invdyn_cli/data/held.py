"""A log in memory as a data source."""

from dataclasses import dataclass, field

from invdyn_cli.interfaces import AbstractSource, Progress, silent
from invdyn_cli.log import Log, Recorded
from invdyn_cli.logfile import refuse_defects
from invdyn_cli.recording.channels import ordered
from invdyn_cli.recording.conditioning import Conditioning
from invdyn_cli.types import Header, Robot, Splits


@dataclass(frozen=True)
class HeldLog(AbstractSource):
    """The trajectories of a log that is already in memory, split and conditioned as `how` says."""

    log: Log
    how: Conditioning = field(default_factory=Conditioning)

    needs_robot = False
    has_log = True

    def header(self) -> Header:
        """Robot and joints of the log, and the URDF that it names."""
        return Header(self.log.robot, self.log.joints, self.log.urdf)

    def load(self, robot: Robot | None, progress: Progress = silent) -> Splits:
        """Cut and condition.

        Raises:
            LogError, UsageError, RobotError: one line that names the trajectory or the option.
        """
        self.how.refuse_options()
        refuse_defects(self.log)
        notes: list[str] = []
        log = ordered(self.log, robot, notes)
        description = {"source": log.source, "torque_side": log.torque_side}
        return self.how.splits_of_log(log, robot, notes=notes, description=description, progress=progress)

    def recorded(self, robot: Robot | None, progress: Progress = silent) -> Recorded:
        """The log itself."""
        notes: list[str] = []
        return Recorded(ordered(self.log, robot, notes), notes=tuple(notes))
