"""Measured logs as a data source: which files, which trajectories; `conditioning` makes them ready to learn from."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from invdyn_cli import hdf5
from invdyn_cli.data.conditioning import Conditioning, ordered
from invdyn_cli.data.selection import SETS, Block
from invdyn_cli.errors import LogError, UsageError, listed
from invdyn_cli.formats.reading import Columns, read_log, trajectory_names
from invdyn_cli.interfaces import AbstractSource, Progress, silent
from invdyn_cli.logfile import Log, RawTrajectory, refuse_defects
from invdyn_cli.types import Header, Robot, Splits


@dataclass(frozen=True)
class RealLog(AbstractSource):
    """Trajectories of one or several logs of one robot, in any format that `formats` reads.

    `selection` says how trajectories are named and split; with several logs they are called "<file stem>/<name>" too.
    With logged derivatives and neither filter, lag nor rate the clock plays no part: samples are taken as they stand.

    Attributes:
        path: the log, or a list of logs of one robot.
        train: trajectories to learn from, a list of name or name[t0:t1] in seconds (an end may be left open); None: see
            train_share.
        validation: trajectories that are watched during training and never learned from; None: see validation_share.
        test: trajectories that the scores are computed on; None: all that train does not name, or see train_share.
        reference: earlier log of the same robot, or selected trajectories of this log; `invdyn diagnose` reports only
            what has changed since, `invdyn run` ignores it.
        train_share: [-] first share of each trajectory's time to learn from if nothing is selected; the rest is the
            test set.
        validation_share: [-] last share in time of every training block that is used for validation instead; 0: none.
        derivatives: source of velocity and acceleration: logged, positions (central differences of filtered positions)
            or auto (logged if there are any).
        filter_cutoff: [Hz] cut-off of the zero-phase low-pass filter on positions, derivatives and torques; None: no
            filter.
        filter_order: [-] order of that Butterworth filter, which runs forward and backward.
        causal: whether the filter runs forward only, as in a control loop, so that no sample depends on later ones.
        torque_lag: [samples] the state at t is paired with the torque that many samples earlier, on a uniform clock (1:
            paper, section V-A).
        decimate: [samples] keeps every n-th sample, after the filter.
        drive_gain: [N m/A] torque constants (n,), one for each joint, instead of the log's.
        rate: [Hz] rate of the uniform clock; None: the nominal rate, or that of the median step if they differ by over
            20 %.
        max_gap: [s] a longer step splits a trajectory; nothing is interpolated across it.
        max_size: [GB] largest size of the trajectories of a log.
        columns: column map of a file in another format: a YAML file, or its entries; None: guessed, and shown.
    """

    path: str | Sequence[str]
    train: Sequence[str] | None = None
    validation: Sequence[str] | None = None
    test: Sequence[str] | None = None
    reference: Sequence[str] | str | None = None
    train_share: float = 0.7
    validation_share: float = 0.1
    derivatives: str = "auto"
    filter_cutoff: float | None = 10.0
    filter_order: int = 4
    causal: bool = False
    torque_lag: int = 0
    decimate: int = 1
    drive_gain: Sequence[float] | None = None
    rate: float | None = None
    max_gap: float = 0.1
    max_size: float = hdf5.LIMIT / 1e9
    columns: Columns = None

    needs_robot = False

    def __post_init__(self) -> None:
        for name in ("path", *SETS, "reference", "drive_gain"):
            value = getattr(self, name)
            if value is not None:
                single = isinstance(value, str | int | float | Path)
                object.__setattr__(self, name, (value,) if single else tuple(value))

    @property
    def limit(self) -> float:
        """[bytes] that may be read of a log.

        Raises:
            UsageError: if `max_size` is no such number.
        """
        if not 0 < self.max_size < np.inf:
            raise UsageError(f"data.max_size={self.max_size}; allowed: a number of GB above 0")
        return 1e9 * self.max_size

    def names(self, path: Path) -> tuple[str, ...]:
        """The trajectories of one of its logs."""
        return trajectory_names(path, self.columns, self.limit)

    def header(self) -> Header:
        """Robot and joints of the logs, and the first URDF that one of them names."""
        self._refuse_options()
        logs = self._read({path: () for path in self._paths()})
        return Header(logs[0].robot, logs[0].joints, next((log.urdf for log in logs if log.urdf), ""))

    def load(self, robot: Robot | None, progress: Progress = silent) -> Splits:
        """Read, cut, condition.

        Raises:
            LogError, UsageError, RobotError: one line that names the file, the trajectory or the option.
        """
        self._refuse_options()
        notes: list[str] = []
        asked, records, logs = self._found(robot, notes)
        how = {"keys": self._keys(), "notes": notes, "description": self._described(logs), "progress": progress}
        return Conditioning.of(self).splits(asked, records, robot, **how)

    def _refuse_options(self) -> None:
        for i, gain in enumerate(self.drive_gain or ()):
            if not isinstance(gain, int | float):
                raise UsageError(f"data.drive_gain[{i}]={gain}; allowed: a number")
        Conditioning.of(self).refuse_options()

    def _paths(self) -> tuple[Path, ...]:
        paths = tuple(Path(path).expanduser() for path in self.path)
        if not paths or len({path.stem for path in paths}) < len(paths):
            raise UsageError(f"data.path={listed(map(str, paths))}; allowed: one log or more, with different names")
        return paths

    def _keys(self) -> dict[str, tuple[Path, str]]:
        """What a trajectory is called in selections -> its log, and its name there."""
        paths = self._paths()
        label = "{0.stem}/{1}" if len(paths) > 1 else "{1}"
        return {label.format(path, name): (path, name) for path in paths for name in self.names(path)}

    def _found(
        self, robot: Robot | None, notes: list[str]
    ) -> tuple[dict[str, list[Block] | None], dict[str, tuple[Log, RawTrajectory]], list[Log]]:
        """What was asked for, the trajectories that this takes with the log of each, and the logs."""
        keys = self._keys()
        asked = Conditioning.of(self).asked(keys)
        named = {block.key for blocks in asked.values() for block in blocks or ()}
        used = list(keys) if asked["train"] is None or asked["test"] is None else [key for key in keys if key in named]
        logs = self._read({path: [keys[k][1] for k in used if keys[k][0] == path] for path in self._paths()})
        logs = [ordered(log, robot, notes) for log in logs]
        raws = ((log, raw) for log in logs for raw in log.trajectories)
        return asked, dict(zip(used, raws, strict=True)), logs

    def _read(self, wanted: Mapping[Path, Iterable[str]]) -> list[Log]:
        """The logs with the wanted trajectories, drive gains set, all of the same joints."""
        logs = []
        for path, names in wanted.items():
            log = read_log(path, names, check=False, columns=self.columns, limit=self.limit)
            if self.drive_gain is not None and log.torque_unit == "A":
                log = replace(log, drive_gain=np.asarray(self.drive_gain, float))
            refuse_defects(log, str(path))
            logs.append(log)
            if log.joints != logs[0].joints:
                got = f"{path} has joints {listed(log.joints)}, {next(iter(wanted))} has {listed(logs[0].joints)}"
                raise LogError(f"{got}; allowed: logs of one robot")
        if self.drive_gain is not None and all(log.torque_unit != "A" for log in logs):
            raise UsageError("data.drive_gain is given, but the torques are in N m", advice="data.drive_gain=null")
        return logs

    def _described(self, logs: Iterable[Log]) -> dict[str, Any]:
        words = ("robot", "source", "licence", "torque_side", "torque_unit", "position_side", "compensated")
        return {
            "logs": [
                {"path": str(path)} | {word: getattr(log, word) for word in words}
                for path, log in zip(self._paths(), logs, strict=True)
            ]
        }
