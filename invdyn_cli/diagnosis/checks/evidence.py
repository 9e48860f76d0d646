"""What the costly checks look at: a log's motion and torque, filtered alike, beside the nominal model's torque.

Positions are filtered and differentiated here, so that nothing rests on logged derivatives; all comes from windows of
the log (`rows.windows`), cut before they are filtered, and from a few thousand rows of them.
"""

from dataclasses import dataclass

import jax
import numpy as np

from invdyn_cli.diagnosis.checks.rows import is_series, median_step, newton_metres, windows
from invdyn_cli.interfaces import in_chunks
from invdyn_cli.logfile import Log
from invdyn_cli.maths import rigid_body
from invdyn_cli.maths.signals import lowpass, resample, settling
from invdyn_cli.types import Motion, Robot

CUTOFF = 6.0
"""[Hz] of the zero-phase low-pass: what a position-controlled arm moves is below, encoder noise in qdd mostly above."""

ROWS = 4096
"""Rows that regressions see, one shape to compile: 17 a second of a four-minute log, thinner where it is longer."""

SLOW = 0.02
"""[rad/s; m/s] below which the sign of a velocity is noise: sign(qd) is a ramp there, as in `maths.regression`."""


@dataclass(frozen=True)
class Stretch:
    """An uninterrupted window on a uniform clock, filtered, its unsettled ends cut off.

    `extra` holds qd, qdd and q_ref as logged, filtered alike; `tau` is (T, n) [N m; N].
    """

    trajectory: str
    rate: float
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    tau: np.ndarray
    extra: dict[str, np.ndarray]


@dataclass(frozen=True)
class Evidence:
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
        """(R, 3) what friction and offsets may add to the torque of a joint: ramped sign(qd), qd, 1."""
        qd = self.motion.qd[:, joint]
        return np.stack([np.clip(qd / SLOW, -1, 1), qd, np.ones_like(qd)], axis=1)


def stretches(log: Log, cutoff: float = CUTOFF) -> tuple[Stretch, ...]:
    """The windows of all trajectories that are time series, and long enough for the filter."""
    series = {raw.name for raw in log.trajectories if is_series(raw)}
    made = []
    for raw, rows in windows(log):
        rate = 1 / median_step(raw.t[rows]) if len(rows) > 1 else 0.0
        at = min(cutoff, rate / 5)
        inset = settling(rate, at) if at > 0 else 0
        if raw.name not in series or len(rows) < 3 * inset + 8:
            continue
        extra = {c: getattr(raw, c) for c in ("qd", "qdd", "q_ref") if getattr(raw, c) is not None}
        extra = {c: x for c, x in extra.items() if np.isfinite(x[rows]).all()}
        x = np.concatenate([raw.q, newton_metres(log, raw), *extra.values()], axis=1, dtype=float)[rows]
        _, x = resample(raw.t[rows], x, rate)
        if len(x) < 3 * inset + 8:
            continue
        q, tau, *others = np.split(lowpass(x, rate, at), 2 + len(extra), axis=1)
        qd = np.gradient(q, 1 / rate, axis=0)
        settled = slice(inset, len(x) - inset)
        qdd = np.gradient(qd, 1 / rate, axis=0)
        logged = {c: y[settled] for c, y in zip(extra, others, strict=True)}
        made.append(Stretch(raw.name, rate, q[settled], qd[settled], qdd[settled], tau[settled], logged))
    return tuple(made)


def gather(log: Log, robot: Robot, most: int = ROWS, parts: tuple[Stretch, ...] | None = None) -> Evidence | None:
    """The evidence of a log; None where nothing in it is a time series of at least a few hundred milliseconds."""
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
    return Evidence(parts, stretch, row, motion, tau, nominal, gravity, reach(robot))


def nominal_torque(robot: Robot, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    """The URDF's torque (T, n) [N m; N] for a motion (T, n), and the part of it that holds the arm against gravity."""
    still = Motion(motion.q, np.zeros_like(motion.q), np.zeros_like(motion.q))
    return in_chunks(lambda x: _torque(robot, x), motion), in_chunks(lambda x: _torque(robot, x), still)


def reach(robot: Robot, states: int = 256) -> np.ndarray:
    """(n,) RMS of the nominal torque [N m; N] over random states: velocities and accelerations of about 1."""
    q, qd, qdd = rigid_body.random_states(robot, states, seed=0)
    nominal, _ = nominal_torque(robot, Motion(q.T, qd.T, qdd.T))
    return np.sqrt(np.mean(nominal**2, axis=0))


@jax.jit
def _torque(robot: Robot, motion: Motion):
    return rigid_body.inverse_dynamics(robot, robot.inertial, motion.q.T, motion.qd.T, motion.qdd.T).T
