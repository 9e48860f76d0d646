"""A log in memory as a data source."""

from dataclasses import dataclass

from invdyn_cli.data.conditioning import Conditioning, ordered
from invdyn_cli.interfaces import AbstractSource, Progress, silent
from invdyn_cli.logfile import Log, refuse_defects
from invdyn_cli.types import Header, Robot, Splits


@dataclass(frozen=True)
class HeldLog(AbstractSource):
    """The trajectories of a log that was read or made before, split and conditioned as `how` says."""

    log: Log
    how: Conditioning

    needs_robot = False

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
        records = {raw.name: (log, raw) for raw in log.trajectories}
        description = {"source": log.source, "torque_side": log.torque_side}
        how = {"keys": records, "notes": notes, "description": description, "progress": progress}
        return self.how.splits(self.how.asked(records), records, robot, **how)
