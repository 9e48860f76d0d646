"""The data of the expensive checks: a few thousand rows of a log's stretches, and the nominal model's torque."""

from dataclasses import dataclass

import numpy as np

from invdyn_cli.effects.rigid import PART, regressor, rigid_torque
from invdyn_cli.log import Log
from invdyn_cli.maths import rigid_body
from invdyn_cli.maths.metrics import rms
from invdyn_cli.recording.stretches import Stretch, stretches
from invdyn_cli.types import Array, Motion, Robot

ROWS = 4096
"""Number of rows that regressions use, one shape to compile: 17 a second of a four-minute log, fewer for a longer
one."""

SIZE = PART
"""Number of rows of a regressor: what a compiled program takes at once."""

SLOW = 0.02
"""[rad/s; m/s] below which the sign of a velocity is noise: sign(qd) is a ramp there, as in `maths.regression`."""

EXCITED = 0.03
"""Least RMS of a joint's nominal torque without friction, over that of random states (ours: below it friction and model
errors dominate)."""

NO_MOTION = "no motion, or a torque that never changes"
"""Why a check is skipped."""


@dataclass(frozen=True)
class Samples:
    """R rows of all stretches, and what the nominal model says of them.

    `stretch` and `row` (R,) say where each comes from; `nominal`, `gravity` (R, n) [N m; N]: the nominal torque
    (without gravity where the log is compensated for it) and its share that gravity makes; `reach` (n,): RMS of the
    nominal torque over states all over the joints' ranges, what this arm could be asked to do.
    """

    stretches: tuple[Stretch, ...]
    stretch: np.ndarray
    row: np.ndarray
    motion: Motion
    tau: np.ndarray
    nominal: np.ndarray
    gravity: np.ndarray
    reach: np.ndarray

    def columns(self, joint: int) -> np.ndarray:
        """(R, 3) columns of friction and offset of a joint: ramped sign(qd), qd, 1."""
        qd = self.motion.qd[:, joint]
        return np.stack([np.clip(qd / SLOW, -1, 1), qd, np.ones_like(qd)], axis=1)


def gather(log: Log, robot: Robot, most: int = ROWS, parts: tuple[Stretch, ...] | None = None) -> Samples | None:
    """The samples of a log; None if no trajectory is a time series of at least a few hundred milliseconds."""
    parts = stretches(log) if parts is None else parts
    lengths = np.array([len(x.q) for x in parts], int)
    if not lengths.sum():
        return None
    every = np.linspace(0, lengths.sum() - 1, min(most, int(lengths.sum()))).astype(int)
    ends = np.cumsum(lengths)
    stretch = np.searchsorted(ends, every, side="right")
    row = every - (ends - lengths)[stretch]
    chosen = [row[stretch == i] for i in range(len(parts))]
    q, qd, qdd, tau = (
        np.concatenate([getattr(x, c)[rows] for x, rows in zip(parts, chosen, strict=True)])
        for c in ("q", "qd", "qdd", "tau")
    )
    motion = Motion(q, qd, qdd)
    nominal, gravity = nominal_torque(robot, motion)
    if "gravity" in log.compensated:
        nominal, gravity = nominal - gravity, np.zeros_like(gravity)
    return Samples(parts, stretch, row, motion, tau, nominal, gravity, reach(robot))


def gather_changing(log: Log, robot: Robot) -> Samples | None:
    """1024 samples of a log at most; None if they are fewer than 100, or no torque changes in them."""
    samples = gather(log, robot, 1024) if log.trajectories else None
    return samples if samples is not None and len(samples.tau) >= 100 and np.ptp(samples.tau, axis=0).any() else None


def nominal_torque(robot: Robot, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    """The URDF's torque (T, n) [N m; N] for a motion (T, n), and the part of it that holds the arm against gravity."""
    return torque_of(robot, motion), gravity_torque(robot, motion.q)


def gravity_torque(robot: Robot, q: Array) -> np.ndarray:
    """The URDF's torque (T, n) [N m; N] that holds the arm at positions q (T, n)."""
    still = np.zeros_like(np.asarray(q))
    return torque_of(robot, Motion(q, still, still))


def torque_of(robot: Robot, motion: Motion) -> np.ndarray:
    """The URDF's torque (T, n) [N m; N] for a motion (T, n)."""
    return rigid_torque(robot, _joints_first(motion)).T


def reach(robot: Robot) -> np.ndarray:
    """(n,) RMS of the nominal torque [N m; N] over random states: velocities and accelerations of about 1."""
    return rms(rigid_torque(robot, Motion(*rigid_body.random_states(robot, 256, seed=0))).T)


def regressor_rows(robot: Robot, motion: Motion, thin: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Which rows (R,) of a motion were taken, evenly, SIZE or every `thin`-th of these; and their joint-torque
    regressor (n, R, 10 n): all inertial parameters of all links. Rows of a short motion repeat."""
    rows = np.linspace(0, len(motion) - 1, SIZE).astype(int)[::thin]
    return rows, regressor(robot, _joints_first(motion[rows])).transpose(1, 2, 0)


def _joints_first(motion: Motion) -> Motion:
    """A motion (T, n) as (n, T)."""
    return Motion(*(np.asarray(x).T for x in (motion.q, motion.qd, motion.qdd)))
