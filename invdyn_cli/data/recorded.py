"""Measured logs as a data source: cut into blocks first, and only then resampled, filtered and differentiated.

Blocks come first so that a zero-phase filter, which looks ahead, carries nothing from what is tested into what is
learned. Positions, logged derivatives and torques pass through one and the same filter: none leads or lags another.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from invdyn_cli.data.selection import SETS, Block, complete, parse, refuse_overlap
from invdyn_cli.errors import LogError, RobotError, UsageError, listed
from invdyn_cli.interfaces import AbstractSource, Progress, silent
from invdyn_cli.logfile import Log, RawTrajectory, read_log, refuse_defects, trajectory_names
from invdyn_cli.maths.signals import differentiate, lowpass, resample, settling
from invdyn_cli.types import Dataset, Header, Motion, Robot, Splits, Trajectory

DERIVATIVES = ("auto", "logged", "positions")
RATE_TOLERANCE = 0.2
"""How far the nominal rate may be from the median step's before the step is believed: a wrong rate is off by more."""


@dataclass(frozen=True)
class RealLog(AbstractSource):
    """Trajectories of one or several invdyn logs of one robot.

    `selection` says how trajectories are named and split; with several logs they are called "<file stem>/<name>" too.
    With logged derivatives and neither filter, lag nor rate the clock plays no part: samples are taken as they stand.

    Attributes:
        path: the log, or several.
        train, validation, test: selections, or None.
        train_share, validation_share: shares of time, where nothing was selected.
        derivatives: "logged"; "positions": central differences of filtered positions; "auto": logged where possible.
        filter_cutoff: [Hz] of the zero-phase low-pass on all channels, None for no filter.
        filter_order: order of that Butterworth filter, which goes forth and back.
        torque_lag: pairs the state at t with the torque so many samples before (1: paper, section V-A) [uniform clock].
        decimate: keeps every n-th sample, after the filter.
        drive_gain: (n,) [N m/A], in place of the logs'.
        rate: [Hz] of the uniform clock; None: the nominal one, or the median step's where the two disagree.
        max_gap: [s], a longer step parts a block in two; nothing is interpolated across it.
    """

    path: str | Sequence[str]
    train: Sequence[str] | None = None
    validation: Sequence[str] | None = None
    test: Sequence[str] | None = None
    train_share: float = 0.7
    validation_share: float = 0.1
    derivatives: str = "auto"
    filter_cutoff: float | None = 10.0
    filter_order: int = 4
    torque_lag: int = 0
    decimate: int = 1
    drive_gain: Sequence[float] | None = None
    rate: float | None = None
    max_gap: float = 0.1

    needs_robot = False

    def __post_init__(self) -> None:
        for name in ("path", *SETS, "drive_gain"):
            value = getattr(self, name)
            if value is not None:
                single = isinstance(value, str | int | float | Path)
                object.__setattr__(self, name, (value,) if single else tuple(value))

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
        clocks = {key: raw.t for key, (_, raw) in records.items()}
        blocks = complete(asked, clocks, self.train_share, self.validation_share)
        sets: dict[str, list[Trajectory]] = {name: [] for name in SETS}
        described: dict[str, list[dict[str, Any]]] = {name: [] for name in SETS}
        todo = [(name, block) for name in SETS for block in blocks[name]]
        for done, (name, block) in enumerate(todo, start=1):
            log, raw = records[block.key]
            trajectories, what = self._conditioned(block, log, raw, notes)
            if trajectories:
                sets[name] += trajectories
                described[name].append(what)
            progress(done / len(todo), str(block))
        for name in ("train", "test"):
            if not sets[name]:
                why = "; ".join(notes) or "no trajectory is left for it"
                raise LogError(f"data.{name} is empty: {why}", advice=f"data.{name}=[…] of {listed(self._keys())}")
        data = {name: Dataset(tuple(sets[name]), logs[0].joints, robot) for name in SETS}
        return Splits(
            train=data["train"],
            validation=data["validation"] if sets["validation"] else None,
            tests={"test": data["test"]},
            description=self._described(logs) | described | {"notes": notes},
        )

    def _refuse_options(self) -> None:
        numbers = {f.name: getattr(self, f.name) for f in fields(self) if isinstance(f.default, int | float)}
        optional = {"rate": self.rate, **{f"drive_gain[{i}]": x for i, x in enumerate(self.drive_gain or ())}}
        for name, value in (numbers | {k: v for k, v in optional.items() if v is not None}).items():
            if not isinstance(value, int | float) and (name, value) != ("filter_cutoff", None):
                raise UsageError(f"data.{name}={value}; allowed: a number")
        for name, good, allowed in (
            ("derivatives", self.derivatives in DERIVATIVES, ", ".join(DERIVATIVES)),
            ("train_share", 0 < self.train_share < 1, "between 0 and 1"),
            ("validation_share", 0 <= self.validation_share < 1, "0 to below 1"),
            ("filter_order", _whole(self.filter_order, 1), "a whole number, 1 or more"),
            ("torque_lag", _whole(self.torque_lag, 0), "a whole number of samples, 0 or more"),
            ("decimate", _whole(self.decimate, 1), "a whole number of samples, 1 or more"),
            ("rate", self.rate is None or self.rate > 0, "null, or above 0 Hz"),
            ("max_gap", self.max_gap > 0, "above 0 s"),
        ):
            if not good:
                raise UsageError(f"data.{name}={getattr(self, name)}; allowed: {allowed}")

    def _paths(self) -> tuple[Path, ...]:
        paths = tuple(Path(path).expanduser() for path in self.path)
        if not paths or len({path.stem for path in paths}) < len(paths):
            raise UsageError(f"data.path={listed(map(str, paths))}; allowed: one log or more, with different names")
        return paths

    def _keys(self) -> dict[str, tuple[Path, str]]:
        """What a trajectory is called in selections -> its log, and its name there."""
        paths = self._paths()
        label = "{0.stem}/{1}" if len(paths) > 1 else "{1}"
        return {label.format(path, name): (path, name) for path in paths for name in trajectory_names(path)}

    def _found(
        self, robot: Robot | None, notes: list[str]
    ) -> tuple[dict[str, list[Block] | None], dict[str, tuple[Log, RawTrajectory]], list[Log]]:
        """What was asked for, the trajectories that this takes with the log of each, and the logs."""
        keys = self._keys()
        options = {name: getattr(self, name) for name in SETS}
        asked = {k: None if v is None else [parse(k, str(text), keys) for text in v] for k, v in options.items()}
        refuse_overlap({name: blocks or () for name, blocks in asked.items()})
        named = {block.key for blocks in asked.values() for block in blocks or ()}
        used = list(keys) if asked["train"] is None or asked["test"] is None else [key for key in keys if key in named]
        logs = self._read({path: [keys[k][1] for k in used if keys[k][0] == path] for path in self._paths()})
        logs = [_ordered(log, robot, notes) for log in logs]
        raws = ((log, raw) for log in logs for raw in log.trajectories)
        return asked, dict(zip(used, raws, strict=True)), logs

    def _read(self, wanted: Mapping[Path, Iterable[str]]) -> list[Log]:
        """The logs with the wanted trajectories, drive gains set, all of the same joints."""
        logs = []
        for path, names in wanted.items():
            log = read_log(path, names, check=False)
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

    def _rate(self, key: str, log: Log, t: np.ndarray) -> float:
        """Rate [Hz] of the uniform clock for a trajectory logged at t (T,) [s]."""
        steps = np.diff(t)
        steps = steps[steps <= self.max_gap]
        measured = 1 / float(np.median(steps)) if len(steps) else log.rate
        nominal = abs(log.rate / measured - 1) <= RATE_TOLERANCE
        rate = self.rate or (log.rate if nominal else measured)
        if rate < (1 - RATE_TOLERANCE) * measured:
            got = f"data.rate={rate:g}, but trajectory {key!r} is logged at {measured:.4g} Hz"
            raise UsageError(f"{got}; allowed: no slower", advice="data.decimate, it thins after the filter")
        if self.filter_cutoff is not None and not 0 < self.filter_cutoff < rate / 2:
            got = f"data.filter_cutoff={self.filter_cutoff:g} Hz for trajectory {key!r} at {rate:.4g} Hz"
            raise UsageError(f"{got}; allowed: above 0 and below half of it, or null")
        return rate

    def _conditioned(
        self, block: Block, log: Log, raw: RawTrajectory, notes: list[str]
    ) -> tuple[list[Trajectory], dict[str, Any]]:
        """The block's uninterrupted pieces ready to learn from, and how they came about."""
        rows = np.flatnonzero(block.rows(raw.t))
        if block.asked and not len(rows):
            raise LogError(f"no samples in {block}; {block.key!r} runs from {raw.t[0]:g} s to {raw.t[-1]:g} s")
        logged = [c for c in ("qd", "qdd") if getattr(raw, c) is not None and self.derivatives != "positions"]
        if self.derivatives == "logged" and len(logged) < 2:
            lacks = " and ".join(c for c in ("qd", "qdd") if c not in logged)
            got = f"data.derivatives=logged, but trajectory {block.key!r} lacks {lacks}"
            raise LogError(got, advice="data.derivatives=auto")
        timeless = len(logged) == 2 and self.filter_cutoff is None and self.rate is None and self.torque_lag == 0
        rate = self._rate(block.key, log, raw.t)
        settled = settling(rate, self.filter_cutoff, self.filter_order) if self.filter_cutoff is not None else 0
        inset = 0 if len(logged) == 2 else max(settled, 2)
        needed = max(2 * inset, settled) + 1 + self.torque_lag
        gain = log.drive_gain if log.torque_unit == "A" else 1.0
        channels = {"q": raw.q, "tau": raw.tau * gain, **{c: getattr(raw, c) for c in logged}}
        columns = np.concatenate(list(channels.values()), axis=1)
        pieces = [rows] if timeless else np.split(rows, np.flatnonzero(np.diff(raw.t[rows]) > self.max_gap) + 1)
        trajectories, longest = [], 0
        for piece in pieces:
            t, x = raw.t[piece], columns[piece]
            if len(piece) and not timeless:
                t, x = resample(t, x, rate)
            longest = max(longest, len(t))
            if len(t) >= needed:
                part = Block(block.key, float(raw.t[piece[0]]), float(raw.t[piece[-1]]))
                name = block.key if len(piece) == len(raw.t) else str(part)
                signals = dict(zip(channels, np.split(x, len(channels), axis=1), strict=True))
                trajectories.append(self._trajectory(name, t, signals, rate, inset))
        if len(trajectories) < len(pieces):
            short = f"{block}: {len(pieces) - len(trajectories)} of {len(pieces)} uninterrupted pieces too short"
            short += f", {needed} samples at {rate:.4g} Hz are needed for filter, derivatives and lag"
            short += "" if trajectories else f", the longest has {longest}"
            if block.asked and not trajectories:
                advice = "a longer window, a higher data.filter_cutoff (null: no filter), or a larger data.max_gap"
                raise LogError(short, advice=advice)
            notes.append(f"{short}; left out")
        return trajectories, {
            "trajectory": block.key,
            "window": [float(raw.t[rows[0]]), float(raw.t[rows[-1]])] if len(rows) else None,
            "rate": None if timeless else rate,
            "logged_samples": len(rows),
            "samples": sum(len(x.t) for x in trajectories),
            "pieces": [x.name for x in trajectories],
            "logged_derivatives": logged,
        }

    def _trajectory(
        self, name: str, t: np.ndarray, signals: dict[str, np.ndarray], rate: float, inset: int
    ) -> Trajectory:
        """One piece (T, n) on its clock: filtered, differentiated, `inset` samples off each end, lagged, thinned."""
        if self.filter_cutoff is not None:
            signals = {c: lowpass(x, rate, self.filter_cutoff, self.filter_order) for c, x in signals.items()}
        for channel, of in (("qd", "q"), ("qdd", "qd")):
            if channel not in signals:
                signals[channel] = differentiate(signals[of], rate)
        lag, last = self.torque_lag, len(t) - inset
        now, before = slice(inset + lag, last, self.decimate), slice(inset, last - lag, self.decimate)
        motion = Motion(*(signals[c][now] for c in ("q", "qd", "qdd")))
        return Trajectory(name, t[now], motion, signals["tau"][before])

    def _described(self, logs: Iterable[Log]) -> dict[str, Any]:
        words = ("robot", "source", "licence", "torque_side", "torque_unit", "position_side", "compensated")
        options = ("derivatives", "filter_cutoff", "filter_order", "torque_lag", "decimate", "max_gap")
        return {
            "logs": [
                {"path": str(path)} | {word: getattr(log, word) for word in words}
                for path, log in zip(self._paths(), logs, strict=True)
            ],
            **{option: getattr(self, option) for option in options},
        }


def _ordered(log: Log, robot: Robot | None, notes: list[str]) -> Log:
    """The log with its columns in the robot's order of joints."""
    if robot is None or robot.joints == log.joints:
        return log
    if robot.dofs != len(log.joints):
        got = f"robot {robot.name!r} moves {robot.dofs} joints: {listed(robot.joints)}; the log has {len(log.joints)}"
        raise RobotError(f"{got}: {listed(log.joints)}", advice="a URDF of the logged robot, robot.path=…")
    if known := set(robot.joints) & set(log.joints) if set(robot.joints) != set(log.joints) else set():
        got = f"robot {robot.name!r} moves {listed(robot.joints)}, the log has {listed(log.joints)}"
        raise RobotError(
            f"{got}: only {listed(sorted(known))} in both; allowed: the same names, or all others, taken in order",
            advice="robot.joints=[…] in the order of the log's columns, or another URDF",
        )
    if set(robot.joints) != set(log.joints):
        notes.append(f"the log's joints {listed(log.joints)} are taken for the robot's {listed(robot.joints)}")
        return replace(log, joints=robot.joints)
    order = [log.joints.index(joint) for joint in robot.joints]
    gain = None if log.drive_gain is None else log.drive_gain[order]
    columns = ("q", "tau", "qd", "qdd", "q_ref", "q_link")
    trajectories = tuple(
        replace(raw, **{c: getattr(raw, c)[:, order] for c in columns if getattr(raw, c) is not None})
        for raw in log.trajectories
    )
    return replace(log, joints=robot.joints, drive_gain=gain, trajectories=trajectories)


def _whole(x: float, least: int) -> bool:
    return isinstance(x, int) and x >= least
