"""The common time between torque and motion: a controller holds its command for a sample, a logger reads one channel
after the other.

Half a sample of it looks like a negative viscous friction on the heaviest joint. It is removed before anything is
named; only a joint's remaining time can then be called a delay.
"""

from dataclasses import replace

import numpy as np
import scipy

from invdyn_cli.diagnosis.columns.bodies import STEP
from invdyn_cli.diagnosis.columns.evidence import filtered, joint_states
from invdyn_cli.effects.actuator import shifted
from invdyn_cli.effects.rigid import gravity_columns, regressor, rigid_torque
from invdyn_cli.recording.pieces import Recording
from invdyn_cli.types import Robot

MOST = 1.05
"""Largest number of samples that count as a property of the log: holding takes half of one, reading in turn up to
one."""

UNSURE = 0.5
"""Samples of standard error from which on the common time is not known: holding takes as much."""


def offsets(robot: Robot, recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Time (n,) [s] by which each joint's logged torque leads its motion, and its standard error: the factor of the
    nominal torque's slope beside all inertials, gravity, encoder offsets, friction and offset."""
    n = robot.dofs
    bodies, slopes, extras = [], [], []
    for piece in recording.pieces:
        torque = rigid_torque(robot, piece.motion)
        states = joint_states(piece, torque, recording, robot.parents)
        zeros = [
            rigid_torque(robot, replace(piece.motion, q=piece.q + STEP * row[:, None])) - torque for row in np.eye(n)
        ]
        links = regressor(robot, piece.motion)
        bodies.append(np.concatenate([links, gravity_columns(robot, np.eye(3), piece.q), zeros]))
        slopes.append(np.gradient(torque, 1 / recording.filter.rate, axis=-1))
        extras.append(np.stack([[s.sign, s.qd, np.ones_like(s.qd), s.qd * abs(s.qd)] for s in states], axis=1))
    bodies, slopes, extras = (filtered(recording, x) for x in (bodies, slopes, extras))
    tau = filtered(recording, [p.tau for p in recording.pieces])
    lead, error = np.zeros(n), np.full(n, np.inf)
    for j in range(n):
        x = np.column_stack([slopes[j], *bodies[:, j], *extras[:, j]])
        scale = np.sqrt(np.mean(x**2, axis=0))
        if not scale[0] > 0:
            continue
        used = scale > 1e-9 * scale.max()
        x = x[:, used] / scale[used]
        values, vectors = np.linalg.eigh(x.T @ x)
        kept = values > 1e-11 * values[-1]
        inverse = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T
        theta = inverse @ (x.T @ tau[j])
        variance = np.sum((tau[j] - x @ theta) ** 2) / max(len(x) - kept.sum(), 1)
        lead[j] = theta[0] / scale[0]
        error[j] = np.sqrt(variance * inverse[0, 0]) / scale[0]
    return lead, error


def remove_common_delay(robot: Robot, recording: Recording, side: str) -> tuple[Recording, float]:
    """The recording with the common time between torque and motion taken out, and that time [s].

    It is the weighted median of the joints' own times, if it is within MOST samples and known; otherwise every joint
    has its own delay, or something else moves the estimates, and half a sample is used (zero for a sensor behind the
    gear).
    """
    common, error = _median(*offsets(robot, recording), 0.02 * recording.period)
    if error > UNSURE * recording.period or abs(common) > MOST * recording.period:
        common = 0.0 if side == "link" else recording.period / 2
    return moved(recording, common), float(common)


def moved(recording: Recording, lead: float) -> Recording:
    """The recording with torques delayed by `lead` [s]."""
    pieces = tuple(
        replace(p, tau=np.stack([shifted(x, -lead * recording.filter.rate) for x in p.tau])) for p in recording.pieces
    )
    return replace(recording, pieces=pieces)


def _median(x: np.ndarray, error: np.ndarray, least: float) -> tuple[float, float]:
    """The weighted median of measurements (n,), none of which errs by less than `least`, and its standard error. Where
    they differ by more than their errors, these are too small by as much (Birge 1932), here by the median of all."""
    known = np.isfinite(error)
    if not known.any():
        return 0.0, np.inf
    x, error = x[known], np.maximum(error[known], least)
    order, weight = np.argsort(x), 1 / error**2
    share = np.cumsum(weight[order]) / weight.sum()
    middle = float(x[order][np.searchsorted(share, 0.5)])
    apart = np.median(np.abs(x - middle) / error) / scipy.stats.norm.ppf(0.75)
    return middle, float(max(1.0, apart) / np.sqrt(weight.sum()))
