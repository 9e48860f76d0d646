"""Sound logs for the doctor's tests, and ways to spoil them: smooth motions, the URDF's torque, friction, noise."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from invdyn_cli.diagnosis.checks.samples import nominal_torque
from invdyn_cli.log import Log, RawTrajectory
from invdyn_cli.types import Check, Examination, Motion, Robot


def motion(robot: Robot, t: np.ndarray, seed: int) -> Motion:
    """Sums of five sines per joint, 0.05 to 0.6 Hz, in the middle of the joints' ranges, on the clock t (T,) [s]."""
    rng = np.random.default_rng(seed)
    n = robot.dofs
    low, high = (np.where(np.isfinite(x), x, s) for x, s in ((robot.lower, -2.0), (robot.upper, 2.0)))
    w = 2 * np.pi * rng.uniform(0.05, 0.6, (n, 5))
    phase, size = rng.uniform(0, 2 * np.pi, (n, 5)), rng.uniform(0.3, 1, (n, 5))
    size *= 0.7 * np.minimum((high - low) / 2, 1.8)[:, None] / size.sum(1, keepdims=True)
    angle = t[:, None, None] * w + phase
    q = (high + low) / 2 + np.sum(size * np.sin(angle), axis=2)
    return Motion(q, np.sum(size * w * np.cos(angle), axis=2), -np.sum(size * w**2 * np.sin(angle), axis=2))


def sound(
    robot: Robot,
    seed: int = 0,
    *,
    seconds: float = 30.0,
    rate: float = 200.0,
    coulomb: float = 0.1,
    viscous: float = 0.05,
    noise: float = 0.01,
    truth: Robot | None = None,
    channels: tuple[str, ...] = ("qd",),
) -> Log:
    """A log without defects: friction and noise in shares of the torque's standard deviation per joint.

    `truth` is the robot that moves, where it is not the one of the URDF.
    """
    rng = np.random.default_rng(seed + 1000)
    t = np.arange(round(seconds * rate)) / rate
    moved = motion(robot, t, seed)
    tau, _ = nominal_torque(truth or robot, moved)
    size = tau.std(0)
    tau = tau + size * (coulomb * np.tanh(moved.qd / 0.01) + viscous * moved.qd + noise * rng.normal(size=tau.shape))
    q = moved.q + 1e-5 * rng.normal(size=tau.shape)
    qd = moved.qd + 1e-3 * rng.normal(size=tau.shape)
    logged = {"qd": qd, "qdd": moved.qdd, "q_ref": delayed(moved.q, t, -0.02)}
    raw = RawTrajectory("run", t, q, tau, **{c: logged[c] for c in channels})
    return Log(robot.name, robot.joints, "link", "N m", rate, (raw,))


def changed(log: Log, **channels: Any) -> Log:
    """The log with channels of its first trajectory put in their place."""
    return replace(log, trajectories=(replace(log.trajectories[0], **channels), *log.trajectories[1:]))


def seen(examination: Examination, name: str, *, least: str = "note") -> list[Check]:
    """Findings of this name that are at least so severe."""
    order = ("ok", "skipped", "note", "warn", "fail")
    return [c for c in examination.checks if c.check == name and order.index(c.severity) >= order.index(least)]


def alarms(examination: Examination) -> Mapping[str, str]:
    """{check: what was seen} of all warnings and failures."""
    return {c.check: c.seen for c in examination.checks if c.severity in ("warn", "fail")}


def delayed(x: np.ndarray, t: np.ndarray, seconds: float) -> np.ndarray:
    """x (T,) or (T, n) as it comes `seconds` later."""
    columns = np.atleast_2d(x.T)
    return np.stack([np.interp(t - seconds, t, one) for one in columns]).T.reshape(x.shape)
