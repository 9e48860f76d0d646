"""How well torque columns fit joints: the log marginal likelihood of each column on each joint, with each sign and
unit.

    s tau_i = u (m_j + Y_j dphi + g m_j + d dm_j/dt)
              + coulomb sign(qd) + viscous qd + armature qdd + stiffness q + offset

m_j is the URDF's torque. Inertial parameters are wrong by a share of their scales (`maths.standard.link_scales`) and by
a tool that the URDF lacks, gains by g, time by d, all Gaussian. Friction, offset, spring and rotor have flat priors;
friction and rotor are positive, and the posterior probability of this is part of the likelihood, so that neither a
spring nor a placeholder inertia looks like a change of sign. If gravity was subtracted, it was that of another model,
so that errors of the inertial parameters then also show in gravity. A row counts as 1 / autocorrelation time of the
residual, or of the torque. A column that no rigid body explains is equally likely on every joint (`LOST`).
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy

from invdyn_cli.diagnosis.checks.fits import left
from invdyn_cli.diagnosis.checks.placeholders import doubtful_inertias
from invdyn_cli.diagnosis.checks.samples import EXCITED, SLOW, Samples, regressor_rows, torque_of
from invdyn_cli.maths.standard import link_scales
from invdyn_cli.maths.statistics import autocorrelation_time
from invdyn_cli.types import Array, Motion, Robot

SHARES = (0.1, 0.3)
"""Relative errors of inertial parameters, in units of their scales: for a URDF from CAD, and from a drawing (Swevers
2007)."""

GAIN, DELAY = 0.2, 0.03
"""Standard deviations of a joint's torque gain [-] and delay [s] (ours: drives differ by less)."""

GAINS = (0.5, 2.0)
"""Factors of a drive's gain that a torque in the common unit may have at most (ours)."""

TOOL, REACH = 0.1, 0.15
"""Mass of a tool that the URDF lacks, over the arm's mass, and the distance [m] of its centre: standard deviations."""

LOST = 0.03
"""Probability that rigid-body dynamics do not explain a joint's torque at all: a hose, a wrong topic, a contact."""

FEWEST = -10.0
"""Log probability of a negative friction, or of a negative rotor inertia: other errors have this effect that often."""

HEAVY = -25.0
"""Log probability of a negative inertia about a joint's axis (rotor and links together), with friction and spring
fitted."""

MOST_ROWS = 100.0
"""Largest number of independent rows of a joint (ours)."""

NOISE = np.geomspace(1e-4, 2.0, 16)
"""Variance of the residual over that of the torque."""

THIN = 3
"""Every third of the regressor's rows is used: a joint has 100 independent ones at most."""

STEP = 0.005
"""[s] of the difference quotient in dm/dt."""


@dataclass(frozen=True)
class Rows:
    """R rows of a log: motion with jerk (R, n), torque (R, n) as logged; `reach` (n,) what random states ask of the
    arm; whether gravity is out of the torque."""

    motion: Motion
    jerk: np.ndarray
    tau: np.ndarray
    reach: np.ndarray
    without_gravity: bool

    def arranged(self, order: tuple[int, ...], signs: tuple[float, ...]) -> "Rows":
        """The motion with its columns in another order, then with these signs; the torque as it is."""
        parts = (x[:, list(order)] * np.array(signs) for x in (self.motion.q, self.motion.qd, self.motion.qdd))
        return replace(self, motion=Motion(*parts), jerk=self.jerk[:, list(order)] * np.array(signs))


def rows_of(samples: Samples, *, without_gravity: bool = False) -> Rows:
    """Rows of a gathered log."""
    jerks = [np.gradient(x.qdd, 1 / x.rate, axis=0) for x in samples.stretches]
    jerk = np.concatenate([x[samples.row[samples.stretch == i]] for i, x in enumerate(jerks)])
    return Rows(samples.motion, jerk, samples.tau, samples.reach, without_gravity)


@dataclass(frozen=True)
class Fitness:
    """Log likelihoods (n joints, n columns, 2 signs, units + 1) of torque columns on joints, signs + and -; the last
    unit is a factor of the column's own.

    `lost` (n, n): of a column that its joint does not explain; `plain` (n, n, 2, units + 1): what the URDF's torque as
    it stands adds to that, but for a factor in GAINS; `factor` (n, n): that last unit, logged torque over N m;
    `explained` (n, n): share of a column's variance that a joint explains at best; `effective` (n,): independent rows
    of each column.
    """

    likelihood: np.ndarray
    lost: np.ndarray
    plain: np.ndarray
    factor: np.ndarray
    explained: np.ndarray
    effective: np.ndarray


def fitness(
    rows: Rows,
    robot: Robot,
    units: Array | tuple[float, ...],
    effective: np.ndarray | None = None,
    home: tuple[int, ...] | None = None,
) -> Fitness:
    """Of every torque column on every joint for one motion. `units` (units,) or (n, units): logged
    torque over N m that are tried, of each column; `effective` (n,) rows of each column, where they are known; else
    from what is left of column `home[j]` on joint j."""
    n = rows.tau.shape[1]
    taken, columns = regressor_rows(robot, rows.motion, THIN)
    motion, jerk = rows.motion[taken], rows.jerk[taken]
    later = (motion.q + STEP * motion.qd, motion.qd + STEP * motion.qdd, motion.qdd + STEP * jerk)
    both = Motion(*(np.concatenate(x) for x in zip((motion.q, motion.qd, motion.qdd), later, strict=True)))
    bodies = replace(robot, gravity=np.zeros(3)) if rows.without_gravity else robot
    model, change = np.split(torque_of(bodies, both), 2)
    change = (change - model) / STEP
    tau = rows.tau[taken]
    spread = tau.std(0)
    tau = (tau - tau.mean(0)) / np.where(spread > 0, spread, 1.0)
    joints = [_Joint.of(motion, j, tau, columns[j], model[:, j], change[:, j]) for j in range(n)]
    scales = {share: np.append(_scales(robot, share), [GAIN, DELAY]) for share in SHARES}
    if effective is None:
        rows_each = np.ones(n)
        for joint, column in zip(joints, home or range(n), strict=True):
            rows_each[column] = joint.effective(column, spread[column], scales[SHARES[-1]])
        effective = rows_each
    found = [_of_joint(x, spread, scales, units, effective, rows.reach[j]) for j, x in enumerate(joints)]
    likelihood, lost, plain, factor, explained = (np.array(x) for x in zip(*found, strict=True))
    return Fitness(likelihood, lost, plain, factor, explained, effective)


@dataclass(frozen=True)
class _Joint:
    """Rows of one joint: `own` (R, 5) friction, rotor, spring, offset; `model` (R,) its nominal torque; `parts` (R, p)
    what may be added to it, without scales; tau (R, n). `gram` (p + n + 1, p + n + 1): parts, tau and model once `own`
    is taken out; `readings` (2, R): weights that read friction's power per |qd|, and the rotor, off a torque."""

    own: np.ndarray
    tau: np.ndarray
    model: np.ndarray
    parts: np.ndarray
    gram: np.ndarray
    readings: np.ndarray

    @classmethod
    def of(cls, motion: Motion, j: int, tau, columns, model, change) -> "_Joint":
        """From rows of the whole arm."""
        qd = motion.qd[:, j]
        ramp = np.clip(qd / SLOW, -1, 1)
        own = np.column_stack([ramp, qd, motion.qdd[:, j], motion.q[:, j], np.ones(len(tau))])
        parts = np.column_stack([columns, model, change])
        out = left(np.column_stack([parts, tau, model]), own)
        speed = np.mean(qd**2) / max(np.mean(np.abs(qd)), 1e-12)
        readings = np.array([[1.0, speed, 0, 0, 0], [0, 0, 1.0, 0, 0]]) @ np.linalg.pinv(own)
        return cls(own, tau, model, parts, out.T @ out, readings)

    def directions(self, scale: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Sizes (k,) and coefficients (p, k) of the orthogonal directions that scaled parts have beside `own`."""
        p = len(scale)
        values, vectors = np.linalg.eigh(self.gram[:p, :p] * scale[:, None] * scale)
        keep = values > 1e-10 * max(values[-1], 1e-300)
        return np.sqrt(values[keep]), scale[:, None] * vectors[:, keep]

    def effective(self, column: int, spread: float, scale: np.ndarray) -> float:
        """Independent rows of a column: over the autocorrelation time of what a generous fit leaves, or of the torque
        itself: errors of the model are functions of the motion, and change no faster."""
        sizes, vectors = self.directions(scale)
        factor = 1 / spread if spread > 0 else 0.0
        p = len(scale)
        product = vectors.T @ (self.gram[:p, p + column] - factor * self.gram[:p, -1])
        ratio = 100 * (factor * sizes) ** 2
        fitted = self.parts @ (vectors @ (product / sizes**2 * ratio / (1 + ratio)))
        rest = left(self.tau[:, column] - factor * self.model - fitted, self.own)
        repeats = max(autocorrelation_time(rest), autocorrelation_time(self.tau[:, column]))
        return float(min(MOST_ROWS, len(rest) / repeats))


def _of_joint(joint: _Joint, spread, scales, units, effective, reach: float):
    """Likelihoods of all columns on one joint, of their being lost, their own factors, and what is explained."""
    count, p, n = len(joint.tau), joint.parts.shape[1], joint.tau.shape[1]
    power = np.diag(joint.gram)[p : p + n]
    cross, strength = joint.gram[p : p + n, -1], joint.gram[-1, -1]
    whole = max(float(joint.model @ joint.model), 1e-300)
    noise = np.maximum(power / count, NOISE[0])
    lost = -0.5 * effective * (np.log(noise) + power / count / noise)
    if np.sqrt(strength / count) < EXCITED * reach or strength < 1e-16 * whole:  # then nothing tells whose a column is
        same = np.broadcast_to(lost[:, None, None], (n, 2, np.shape(units)[-1] + 1))
        return same, lost, np.zeros(same.shape), np.zeros(n), np.zeros(n)
    slopes = np.abs(cross) / strength
    safe = np.where(spread > 0, spread, 1.0)
    factor = np.concatenate(
        [np.broadcast_to(units, (n, np.shape(units)[-1])) / safe[:, None], slopes[:, None]], axis=1
    )[:, None, :]
    signed = factor * np.array([1.0, -1.0])[None, :, None]  # (n, 2, units + 1)
    square = power[:, None, None] - 2 * signed * cross[:, None, None] + signed**2 * strength
    weight = (effective / count)[:, None, None]
    best, explained = None, np.zeros(n)
    for scale in scales.values():
        sizes, vectors = joint.directions(scale)
        of_tau = (vectors.T @ joint.gram[:p, p : p + n]).T / sizes  # (n, k)
        of_model = vectors.T @ joint.gram[:p, -1] / sizes
        gain = weight[..., None] * (factor[..., None] * sizes) ** 2  # (n, 1, units + 1, k)
        tried = NOISE[:, None, None, None]
        ratio = gain[:, 0] / tried  # (noise, n, units + 1, k)
        products = np.stack([of_tau**2, np.broadcast_to(of_model**2, of_tau.shape), of_tau * of_model], axis=-1)
        tau_tau, model_model, tau_model = np.moveaxis(ratio / (1 + ratio) @ products, -1, 0)[..., None, :]
        taken = tau_tau + signed**2 * model_model - 2 * signed * tau_model
        spent = np.sum(np.log1p(ratio), axis=-1)[..., None, :] + effective[:, None, None] * np.log(tried)
        values = -0.5 * (spent + weight * np.maximum(square - taken, 0) / tried)
        noise = NOISE[np.argmax(values, axis=0)]
        along = of_tau[:, None, None, :] - signed[..., None] * of_model
        total = values.max(0) + _positive(joint, vectors, sizes, along, signed, factor, noise, weight)
        explained = np.maximum(explained, 1 - noise.min(axis=(1, 2)))
        best = total if best is None else np.maximum(best, total)
    mixed = np.logaddexp(np.log(1 - LOST) + best, np.log(LOST) + lost[:, None, None])
    mixed = np.where((spread > 0)[:, None, None], mixed, 0.0)
    # Of the URDF's torque as it stands, a factor of a column's own or one within GAINS of the unit's.
    at = np.concatenate([np.clip(slopes[:, None], *(g * factor[:, 0, :-1] for g in GAINS)), slopes[:, None]], axis=1)
    at = at[:, None, :] * np.array([1.0, -1.0])[None, :, None]
    rest = 1 - (2 * at * cross[:, None, None] - at**2 * strength) / np.maximum(power, 1e-300)[:, None, None]
    plain = -0.5 * effective[:, None, None] * np.log(np.clip(rest, NOISE[0], 1.0))
    return mixed, lost, plain, slopes * spread, explained


def _positive(joint: _Joint, vectors, sizes, along, signed, factor, noise, weight) -> np.ndarray:
    """(n, 2, units + 1) log chance that friction takes power and that the rotor's inertia is positive, over that before
    anything was seen."""
    ratio = weight[..., None] * (factor[..., None] * sizes) ** 2 / noise[..., None]
    coefficient = along * ratio / (1 + ratio) / sizes
    total = np.zeros(signed.shape)
    through = joint.readings @ joint.parts @ vectors  # (2, k)
    for k, reading in enumerate(joint.readings):
        mean = (reading @ joint.tau)[:, None, None] - signed * float(reading @ joint.model) - coefficient @ through[k]
        variance = noise / weight * float(reading @ reading)
        variance = variance + np.sum((factor[..., None] * through[k]) ** 2 / (1 + ratio), axis=-1)
        turned = np.array([1.0, -1.0])[None, :, None]  # a turned column has its friction turned, too
        chance = scipy.special.log_ndtr(turned * mean / np.sqrt(np.maximum(variance, 1e-300)))
        total += np.maximum(chance, FEWEST) - np.log(0.5)
    reading = joint.readings[1]  # off the whole torque, as if the links' other torques were noise
    n = signed.shape[0]
    power = np.diag(joint.gram)[joint.parts.shape[1] : joint.parts.shape[1] + n]
    deviation = np.sqrt(np.maximum(power / len(joint.tau) / weight[:, 0, 0] * float(reading @ reading), 1e-300))
    chance = scipy.special.log_ndtr(np.array([1.0, -1.0]) * (reading @ joint.tau / deviation)[:, None])
    return total + np.maximum(chance, HEAVY)[..., None] - np.log(0.5)


def _scales(robot: Robot, share: float) -> np.ndarray:
    """(10 n,) standard deviations of the inertial parameters; an inertia that is a placeholder may be any."""
    scales = share * link_scales(robot)
    scales[doubtful_inertias(robot), 4:] /= share
    mass = TOOL * float(np.sum(np.asarray(robot.inertial)[:, 0]))
    tool = np.array([mass, *[mass * REACH] * 3, *[mass * REACH**2] * 6])
    scales[-1] = np.hypot(scales[-1], tool)
    return scales.reshape(-1)
