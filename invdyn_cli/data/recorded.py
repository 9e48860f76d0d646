"""Measured logs as a data source: which files and which trajectories; `conditioning` makes data for learning of
them."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from invdyn_cli import hdf5
from invdyn_cli.errors import LogError, UsageError, listed
from invdyn_cli.formats.reading import Columns, files_of, is_foreign, read_log, trajectory_names
from invdyn_cli.interfaces import AbstractSource, Progress, silent
from invdyn_cli.log import Log, Recorded
from invdyn_cli.logfile import refuse_defects
from invdyn_cli.recording.channels import joined, ordered
from invdyn_cli.recording.conditioning import Conditioning
from invdyn_cli.recording.selection import SETS, Block, asked, cut, windows
from invdyn_cli.types import Header, Robot, Splits

UNUSED = ("derivatives", "filter_cutoff", "filter_order", "torque_lag", "decimate", "rate")
"""Options that prepare data for learning; a diagnosis ignores them, because it has diagnosis.conditioning."""

Keys = dict[str, tuple[Path, str]]
"""Name of a trajectory in selections ("name", or "log/name" if there are several logs) -> its log, and its name
there."""


@dataclass(frozen=True)
class RealLog(AbstractSource):
    """Trajectories of one or several logs of one robot, in any format that `formats` reads.

    `selection` says how trajectories are named and split; with several logs they are also called "<file stem>/<name>".
    With logged derivatives and without filter, lag and rate the clock is not used, and samples are unchanged.

    Attributes:
        path: the log, a list of logs of one robot, or a folder of logs of one format other than invdyn's.
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
    has_log = True

    def __post_init__(self) -> None:
        for name in ("path", *SETS, "reference", "drive_gain"):
            value = getattr(self, name)
            if value is not None:
                single = isinstance(value, str | int | float | Path)
                object.__setattr__(self, name, (value,) if single else tuple(value))
        paths = [[x] if not Path(str(x)).is_dir() else map(str, files_of(x)) for x in self.path]
        object.__setattr__(self, "path", tuple(file for files in paths for file in files))

    @property
    def limit(self) -> float:
        """Largest size [bytes] of a log.

        Raises:
            UsageError: if `max_size` is no such number.
        """
        if not 0 < self.max_size < np.inf:
            raise UsageError(f"data.max_size={self.max_size}; allowed: a number of GB above 0")
        return 1e9 * self.max_size

    def header(self) -> Header:
        """Robot and joints of the logs, and the first URDF that one of them names."""
        self._refuse_options()
        keys = self._keys(self._paths())
        logs = self._read(keys, ())
        logs += self._read(self._keys(files), ()) if (files := self._reference_files(keys)) else []
        return Header(logs[0].robot, logs[0].joints, next((log.urdf for log in logs if log.urdf), ""))

    def load(self, robot: Robot | None, progress: Progress = silent) -> Splits:
        """Read, cut, condition.

        Raises:
            LogError, UsageError, RobotError: one line that names the file, the trajectory or the option.
        """
        self._refuse_options()
        how, notes = Conditioning.of(self), []
        keys = self._keys(self._paths())
        blocks = how.asked(keys)
        logs = self._read(keys, self._used(keys, blocks))
        for path, log in zip(self._paths(), logs, strict=True):
            refuse_defects(log, str(path))
        if self.drive_gain is not None and all(log.torque_unit != "A" for log in logs):
            raise UsageError("data.drive_gain is given, but the torques are in N m", advice="data.drive_gain=null")
        logs = [ordered(log, robot, notes) for log in logs]
        records = {raw.name: (log, raw) for log in logs for raw in log.trajectories}
        described = self._described(logs)
        return how.splits(blocks, records, robot, keys=keys, notes=notes, description=described, progress=progress)

    def recorded(self, robot: Robot | None, progress: Progress = silent) -> Recorded:
        """The logs as one log, and the reference: other logs, or some of its own trajectories.

        Raises:
            LogError, UsageError, RobotError: as `load`, but for defects: a check describes these.
        """
        self._refuse_options()
        keys = self._keys(self._paths())
        files = self._reference_files(keys)
        named = {name: getattr(self, name) for name in (*SETS, *(() if files else ("reference",)))}
        blocks = asked(named, keys)
        in_vain = [f.name for f in fields(self) if f.name in UNUSED and getattr(self, f.name) != f.default]
        notes = [f"data.{name} is not used: the log is taken as it was recorded" for name in in_vain]
        progress(0.0, listed(map(str, self.path)))
        log = joined(self._read(keys, self._used(keys, blocks)), robot, notes)
        reference = None
        if files:
            others = self._keys(files)
            reference = joined(self._read(others, others), robot, [])
        elif chosen := blocks["reference"]:
            reference = cut(log, chosen)
            kept = {block.key for name in SETS for block in blocks[name] or ()}
            kept |= {x.name for x in log.trajectories} - {block.key for block in chosen}
            log = replace(log, trajectories=tuple(x for x in log.trajectories if x.name in kept))
            if not log.trajectories:
                got = "data.reference names all trajectories"
                raise UsageError(got, advice="leave some trajectories for the diagnosis")
        progress(1.0, "")
        return Recorded(log, reference, windows(blocks, log, self.train_share), tuple(notes))

    def _refuse_options(self) -> None:
        for i, gain in enumerate(self.drive_gain or ()):
            if not (isinstance(gain, int | float) and np.isfinite(gain) and gain):
                raise UsageError(f"data.drive_gain[{i}]={gain}; allowed: a number [N m/A], not 0")
        Conditioning.of(self).refuse_options()

    def _paths(self) -> tuple[Path, ...]:
        return tuple(Path(path).expanduser() for path in self.path)

    def _keys(self, paths: Sequence[Path]) -> Keys:
        """All trajectories of logs.

        Raises:
            LogError: for a file that is no log.
            UsageError: for logs of one name.
        """
        if not paths or len({path.stem for path in paths}) < len(paths):
            raise UsageError(f"data.path={listed(map(str, paths))}; allowed: one log or more, with different names")
        label = "{0.stem}/{1}" if len(paths) > 1 else "{1}"
        named = ((path, name) for path in paths for name in trajectory_names(path, self.columns, self.limit))
        return {label.format(path, name): (path, name) for path, name in named}

    def _used(self, keys: Keys, blocks: Mapping[str, list[Block] | None]) -> list[str]:
        """The trajectories that the selections name if both train and test are given, otherwise all."""
        named = {block.key for some in blocks.values() for block in some or ()}
        return [key for key in keys if blocks["train"] is None or blocks["test"] is None or key in named]

    def _reference_files(self, keys: Keys) -> tuple[Path, ...]:
        """The logs that `reference` names; () where it names trajectories, or nothing; UsageError if it names both."""
        named = [str(one) for one in self.reference or ()]
        files = [one for one in named if one not in keys and _is_file(one)]
        if files and len(files) < len(named):
            got = f"data.reference={listed(named)}"
            raise UsageError(f"{got}; allowed: other logs, or trajectories of data.path, not both")
        return tuple(Path(one).expanduser() for one in files)

    def _read(self, keys: Keys, used: Iterable[str]) -> list[Log]:
        """The logs of `keys` with those of their trajectories that are `used`, renamed to their keys, and with the
        given drive gains.

        Raises:
            LogError: if a log cannot be read, has drive gains for other joints, or logs have different joints.
        """
        used, logs = set(used), []
        for path in dict.fromkeys(path for path, _ in keys.values()):
            names = {name: key for key, (at, name) in keys.items() if at == path}
            chosen = [name for name, key in names.items() if key in used]
            log = read_log(path, chosen, check=False, columns=self.columns, limit=self.limit)
            if self.drive_gain is not None and log.torque_unit == "A":
                log = replace(log, drive_gain=np.asarray(self.drive_gain, float))
            if log.drive_gain is not None and np.shape(log.drive_gain) != (len(log.joints),):
                got = f"{path}: drive gains {np.asarray(log.drive_gain).tolist()}"
                raise LogError(f"{got}; allowed: {len(log.joints)} numbers [N m/A], one for each joint")
            logs.append(replace(log, trajectories=tuple(replace(x, name=names[x.name]) for x in log.trajectories)))
            if log.joints != logs[0].joints:
                got = f"{path} has joints {listed(log.joints)}, {self._paths()[0]} has {listed(logs[0].joints)}"
                raise LogError(f"{got}; allowed: logs of one robot")
        return logs

    def _described(self, logs: Iterable[Log]) -> dict[str, Any]:
        words = ("robot", "source", "licence", "torque_side", "torque_unit", "position_side", "compensated")
        return {
            "logs": [
                {"path": str(path)} | {word: getattr(log, word) for word in words}
                for path, log in zip(self._paths(), logs, strict=True)
            ]
        }


def _is_file(text: str) -> bool:
    return text.endswith((".h5", ".hdf5")) or Path(text).expanduser().is_file() or is_foreign(text)
