"""Where in a log each finding of the checks is: rows of the log as recorded, channel by channel."""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from invdyn_cli.diagnosis import doctor
from invdyn_cli.diagnosis.checks.clock import Duplicates
from invdyn_cli.diagnosis.checks.excitation import Excitation
from invdyn_cli.diagnosis.checks.power import PowerOff
from invdyn_cli.diagnosis.checks.saturation import Saturation
from invdyn_cli.diagnosis.checks.values import Outliers
from invdyn_cli.log import Log, RawTrajectory
from invdyn_cli.recording.rows import MAX_GAP, forward_rows, median_step, runs, uninterrupted
from invdyn_cli.types import Check, Examination, Robot

REST = 0.5
"""[s] of a window in which a joint that moves less than `Excitation.rest` allows is at rest."""

CHANNELS = {
    "clock_jitter": "t", "gaps": "t", "duplicates": "t", "too_short": "t", "not_moving": "q", "saturation": "tau",
    "gravity_removed": "tau", "model_mismatch": "tau", "command_copies_measurement": "q_ref",
}  # fmt: skip
"""Channel of the findings of a check that do not name one."""


COUNTED = {
    "not_finite": ("row not finite", "rows not finite"),
    "outliers": ("outlier", "outliers"),
    "gaps": ("gap", "gaps"),
}
"""Words after the number of rows; for gaps, after their number."""

DERIVATIVES = {"fail": "not q's derivative", "note": "shifted against q's derivative"}
"""Words for a defective velocity or acceleration, by severity."""


@dataclass(frozen=True)
class Mark:
    """A finding in one channel.

    Attributes:
        check: the check's name, or "at_rest".
        severity: of the finding; "" where nothing is wrong.
        channel: "t", "q", "qd", "qdd", "tau" or "q_ref".
        joint: its column, None for all.
        rows: (R,) rows of all trajectories one after another; of a gap the last before and the first after it. None:
            the whole channel.
        label: a few words.
    """

    check: str
    severity: str
    channel: str
    joint: int | None
    rows: np.ndarray | None
    label: str


def located(log: Log, robot: Robot | None, *, correct: bool = True) -> tuple[Log, Examination, tuple[Mark, ...]]:
    """The log as corrected, what the doctor says of it, and a mark for every finding that has a place in it; nothing is
    corrected where `correct` is False.

    `rows` of the corrected trajectories gives the numbers of their rows in the log as recorded.

    Raises:
        RobotError: if the robot has another number of joints than the log.
    """
    ends = np.cumsum([len(raw.t) for raw in log.trajectories], dtype=int)
    counted = tuple(
        replace(raw, rows=np.arange(end - len(raw.t), end)) for raw, end in zip(log.trajectories, ends, strict=True)
    )
    found: list[Mark] = []

    def follow(seen: Log, findings: Sequence[Check]) -> None:
        for one in findings:
            found.extend(_marks(seen, one))

    corrected, examination = doctor.correct(replace(log, trajectories=counted), robot, follow=follow, change=correct)
    return corrected, examination, (*_merged(found), *(_at_rest(corrected) if correct or examination.usable else ()))


def _marks(log: Log, one: Check) -> Iterator[Mark]:
    known = one.threshold if isinstance(one.threshold, Mapping) else {}
    joint = log.joints.index(one.joint) if one.joint in log.joints else None
    if one.check == "joint_order":
        for channel, key in (("q", "order"), ("tau", "columns")):
            for j, i in enumerate(known.get(key, ())):
                if i != j:
                    yield Mark(one.check, one.severity, channel, j, None, f"belongs to {log.joints[i]}")
        return
    channels = known.get("channel", CHANNELS.get(one.check, ""))
    for channel in channels.replace(" or ", ", ").split(", ") if channels else ():
        rows = None
        if one.check in PLACES:
            everywhere = one.trajectory is None or one.check == "saturation"  # of it only the worst is told
            mine = [x for x in log.trajectories if x.rows is not None and (everywhere or x.name == one.trajectory)]
            chosen = [np.asarray(raw.rows)[PLACES[one.check](log, raw, one, channel, joint)] for raw in mine]
            rows = np.concatenate([np.arange(0), *chosen])
        yield Mark(one.check, one.severity, channel, joint, rows, _label(one))


def _merged(marks: Sequence[Mark]) -> Iterator[Mark]:
    """Marks of several recordings as one."""
    groups: dict[tuple, list[Mark]] = {}
    for x in marks:
        groups.setdefault((x.check, x.channel, x.joint, x.rows is None, x.severity), []).append(x)
    for same in groups.values():
        first = same[0]
        labels = list(dict.fromkeys(x.label for x in same))
        label = labels[0] + " …" * (len(labels) > 1)
        if first.rows is not None:
            rows = np.concatenate([np.arange(0), *(x.rows for x in same if x.rows is not None)])
            count = len(rows) // 2 if first.check == "gaps" else len(rows)
            words = COUNTED.get(first.check)
            label = f"{count} {words[count != 1]}" if words else label
            first = replace(first, rows=rows)
        yield replace(first, label=label)


def _label(one: Check) -> str:
    """What stands beside the mark."""
    value = one.value if isinstance(one.value, int | float) else None
    known = one.threshold if isinstance(one.threshold, Mapping) else {}
    if one.check == "time_offset" and value is not None:
        apart = f"{1e3 * abs(value):.3g} ms" if abs(value) < 1 else f"{abs(value):.3g} s"
        word = "late" if value > 0 else "early"
        doubt = "perhaps " * (one.severity == "note" and one.joint is None)  # nothing is changed then
        return f"q comes {apart} {word}" if known.get("channel") == "q_ref" else f"{doubt}{apart} {word}"
    if one.check == "unit_error" and known.get("factor"):
        unit = one.meaning.split(":")[0]
        return unit if len(unit) < 40 else f"{known['channel']} is {known['factor']:.3g} times SI"
    number = "" if value is None else f"{value:.3g}"
    words = {
        "saturation": f"stays at {number}",
        "quantisation": f"steps of {number}",
        "power_off": "no power",
        "not_moving": "does not move",
        "duplicates": "stamps out of order" if one.severity == "fail" else "repeated rows",
        "sign_error": "opposite sign" if one.severity == "fail" else "sign in doubt",
        "unit_error": one.meaning.split(":")[0],
        "gravity_removed": "without gravity" if one.severity == "fail" else "perhaps without gravity",
        "command_copies_measurement": "a copy",
        "too_short": f"{number} s: too short",
        "derivative_consistency": DERIVATIVES.get(one.severity, "differs from q's derivative"),
    }
    return words.get(one.check, one.check.replace("_", " "))


def _not_finite(raw: RawTrajectory, channel: str, joint: int | None) -> np.ndarray:
    x = np.asarray(getattr(raw, channel), float)
    if len(x) != len(raw.t) or not len(x):
        return np.zeros(len(raw.t), bool)
    bad = ~np.isfinite(x if joint is None or x.ndim < 2 else x[:, joint])
    return np.asarray(bad.reshape(len(x), -1).any(axis=1))


def _gaps(raw: RawTrajectory) -> np.ndarray:
    return np.array([row for a, b in itertools.pairwise(uninterrupted(raw)) for row in (a[-1], b[0])], int)


PLACES: dict[str, Callable[[Log, RawTrajectory, Check, str, int | None], np.ndarray]] = {
    "not_finite": lambda log, raw, one, channel, joint: _not_finite(raw, channel, joint),
    "duplicates": lambda log, raw, one, *_: (
        ~forward_rows(raw.t) if one.severity == "fail" else Duplicates().repeated(raw)
    ),
    "gaps": lambda log, raw, *_: _gaps(raw),
    "outliers": lambda log, raw, one, channel, joint: Outliers().rows_of(raw, channel, joint or 0),
    "saturation": lambda log, raw, one, *_: Saturation().rows_of(log, raw, one),
    "power_off": lambda log, raw, one, *_: PowerOff().rows_of(raw, one),
}
"""Checks whose findings are in some rows of a channel, and these rows: a mask or numbers."""


def _at_rest(log: Log) -> Iterator[Mark]:
    """Where joints that move elsewhere rest for at least two windows."""
    for joint in range(len(log.joints)):
        rows = []
        for raw in log.trajectories:
            step = median_step(raw.t)
            size = int(REST / step) if np.isfinite(step) else 0
            if size < 2 or step > MAX_GAP or np.ptp(raw.q[:, joint]) < 0.005:
                continue
            blocks = raw.q[: len(raw.q) // size * size, joint].reshape(-1, size)
            still = np.ptp(blocks, axis=1) < Excitation().rest * REST
            for a, b in runs(still):
                if b - a > 1:
                    rows.append(np.asarray(raw.rows)[a * size : b * size])
        if rows:
            yield Mark("at_rest", "", "q", joint, np.concatenate(rows), "at rest")
