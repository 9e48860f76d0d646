"""Arrays of a recording as a log; a wrong shape or clock is refused in one sentence."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypedDict

import numpy as np

from invdyn_cli.errors import LogError, UsageError, listed
from invdyn_cli.formats.columns import numbered
from invdyn_cli.formats.reading import FEWEST
from invdyn_cli.log import CHANNELS, POSITION_SIDES, TORQUE_SIDES, TORQUE_UNITS, Log, RawTrajectory

NAME = "trajectory_1"


class Arrays(TypedDict, total=False):
    """The keywords of `from_arrays`."""

    q: Any
    tau: Any
    t: Any
    rate: float | None
    qd: Any
    qdd: Any
    q_ref: Any
    q_link: Any
    joints: Sequence[str] | None
    urdf: str | Path
    robot_name: str
    torque_side: str
    torque_unit: str
    position_side: str
    drive_gain: Sequence[float] | None
    compensated: Sequence[str]


def from_arrays(
    q: Any = None,
    tau: Any = None,
    t: Any = None,
    *,
    rate: float | None = None,
    qd: Any = None,
    qdd: Any = None,
    q_ref: Any = None,
    q_link: Any = None,
    joints: Sequence[str] | None = None,
    urdf: str | Path = "",
    robot_name: str = "robot",
    torque_side: str = "unknown",
    torque_unit: str = "N m",
    position_side: str = "unknown",
    drive_gain: Sequence[float] | None = None,
    compensated: Sequence[str] = (),
) -> Log:
    """A log of one recording.

    Values are not changed, not even NaN and repeated times: `check` describes such defects.

    Args:
        q, tau: (T, n) positions [rad; m] and torques [N m; N, or A].
        t: (T,) [s], not descending; or `rate` [Hz] where the samples are evenly spaced.
        qd, qdd, q_ref, q_link: (T, n) as in a log (docs/logs.md), where there are any.
        joints: n names in the order of the columns; None: the columns follow the URDF's joints.
        urdf: path of the robot's URDF.
        robot_name: what the robot is called in results.
        torque_side, torque_unit, position_side, drive_gain, compensated: as in a log.

    Raises:
        UsageError: for what is missing, shapes that do not match, a word that is not allowed.
        LogError: for times that descend.
    """
    given = {"q": q, "tau": tau, "qd": qd, "qdd": qdd, "q_ref": q_ref, "q_link": q_link}
    for name in ("q", "tau"):
        if given[name] is None:
            got = f"{name} is missing; a recording needs q (T, n), tau (T, n) and t (T,)"
            raise UsageError(got, advice="check(q=q, tau=tau, t=t, urdf='arm.urdf')")
    channels: dict[str, Any] = {name: _numbers(name, given[name]) for name in CHANNELS if given[name] is not None}
    clock = _clock(t, rate, channels)
    _refuse_shapes(channels, clock, timed=t is not None)
    names = _names(joints, channels["q"].shape[1])
    gain = None if drive_gain is None else _numbers("drive_gain", drive_gain)
    if gain is not None and gain.shape != (len(names),):
        raise UsageError(f"drive_gain has shape {gain.shape}; allowed: ({len(names)},), N m per A of each joint")
    for word, value, allowed in (
        ("torque_side", torque_side, TORQUE_SIDES),
        ("torque_unit", torque_unit, TORQUE_UNITS),
        ("position_side", position_side, POSITION_SIDES),
    ):
        if value not in allowed:
            raise UsageError(f"{word}={value!r}; allowed: {', '.join(allowed)}")
    steps = np.diff(clock)
    typical = float(np.median(steps[steps > 0])) if (steps > 0).any() else float("nan")
    return Log(
        robot=robot_name,
        joints=names,
        torque_side=torque_side,
        torque_unit=torque_unit,
        rate=1 / typical if rate is None else float(rate),
        trajectories=(RawTrajectory(name=NAME, t=clock, **channels),),
        urdf=str(urdf),
        drive_gain=gain,
        source="arrays",
        position_side=position_side,
        compensated=tuple(compensated),
    )


def _numbers(name: str, values: Any) -> np.ndarray:
    try:
        return np.asarray(values, float)
    except (TypeError, ValueError) as error:
        raise UsageError(f"{name} cannot be read as an array of numbers ({error}); allowed: one array") from None


def _clock(t: Any, rate: float | None, channels: dict[str, np.ndarray]) -> np.ndarray:
    """The times (T,) [s], given or of evenly spaced samples."""
    if (t is None) == (rate is None):
        got = "t is missing" if t is None else f"t and rate={rate} are both given"
        advice = "t=t, (T,) in seconds, or rate=1000.0 (Hz) if the samples are evenly spaced"
        raise UsageError(f"{got}; allowed: one of them", advice=advice)
    if rate is not None:
        if not (isinstance(rate, int | float) and 0 < rate < np.inf):
            raise UsageError(f"rate={rate}; allowed: a number of Hz above 0")
        return np.arange(len(np.atleast_1d(channels["q"]))) / rate
    clock = _numbers("t", t)
    if clock.ndim != 1:
        advice = "t.ravel()" if clock.size == max(clock.shape, default=0) else ""
        raise UsageError(
            f"t has shape {clock.shape}; allowed: (T,), one time in seconds for each sample", advice=advice
        )
    back = np.flatnonzero(np.diff(clock) < 0)
    if len(back):
        row = back[0] + 1
        got = f"t descends in row {row}, from {clock[row - 1]:.6g} s to {clock[row]:.6g} s, and in {len(back)} rows"
        advice = "rows in the order of their times (np.argsort(t)), or a log for each recording"
        raise LogError(f"{got} altogether; allowed: ascending times", advice=advice)
    return clock


def _refuse_shapes(channels: dict[str, np.ndarray], clock: np.ndarray, *, timed: bool) -> None:
    """Raise a UsageError unless all channels are (T, n) with T times, which were given (`timed`) or counted."""
    rows, shape = len(clock), channels["q"].shape
    if len(shape) == 1:
        got = f"q has shape {shape}; allowed: (T, n), a row for each sample and a column for each joint"
        raise UsageError(got, advice="q[:, None] and tau[:, None] for a robot of one joint")
    turned = [name for name, x in channels.items() if x.ndim == 2 and _is_transposed(x.shape, rows, timed)]
    if turned:
        name = turned[0]
        got = f"{name} has shape {channels[name].shape}, with {rows} samples in t; allowed: (T, n), time first"
        raise UsageError(got, advice=" and ".join(f"{x}.T" for x in turned))
    if len(shape) != 2 or shape[0] != rows:
        raise UsageError(f"q has shape {shape}, t has {rows} samples; allowed: ({rows}, n), one row for each time")
    for name, x in channels.items():
        if x.shape != shape:
            raise UsageError(f"{name} has shape {x.shape}, q has {shape}; allowed: the same shape, (T, n)")
    if rows < FEWEST:
        raise UsageError(f"q has {rows} rows; allowed: at least {FEWEST}")


def _is_transposed(shape: tuple[int, ...], rows: int, timed: bool) -> bool:
    """Whether (n, T) was given: the second axis has the length of the clock or, if only a rate is given, is the longer
    one."""
    return shape[1] == rows != shape[0] if timed else shape[0] < shape[1]


def _names(joints: Sequence[str] | None, n: int) -> tuple[str, ...]:
    if joints is None:
        return numbered(n)
    names = (joints,) if isinstance(joints, str) else tuple(map(str, joints))
    if len(names) != n or len(set(names)) < n:
        got = f"joints names {len(names)} joints ({listed(names)}), q has {n} columns"
        raise UsageError(f"{got}; allowed: a name for each column, each once")
    return names
