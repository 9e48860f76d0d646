"""The standard model: what every real arm has in addition to its URDF, all in one fit with a prior.

    tau = Y(q, qd, qdd) (phi + dphi) + offset + coulomb sign(qd) + viscous qd + armature qdd + noise

The ten parameters phi of every link are off by a share s of scales of the URDF's own, dphi ~ N(0, s² diag(d)²); every
other coefficient has a prior of its own that is wide beside what is left of its joint. Noise is correlated: a row
counts for 1 / (variance x autocorrelation time) of its joint's residual. s is learned by leaving motions out where
there are several, else by the evidence (MacKay 1992). Priors on inertial parameters: Swevers 2007; Lee et al. 2020.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import scipy

from invdyn_cli.types import Array, Robot

SHARES = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
"""Shares of a link's scales by which a URDF may be wrong, from a calibrated arm to one whose URDF is a rough
drawing."""

USUAL = 0.1
"""The share that is used if nothing determines it: CAD masses of arms with cables and covers are wrong by about this
share (Swevers 2007)."""

OPEN = 5.0
"""Nats of evidence by which a share must be worse than another to be ruled out: Kass and Raftery (1995) call more very
strong."""

WIDE = 3.0
"""Prior standard deviation of a coefficient that is not inertial, as a multiple of the size that explains the whole
residual."""

LIGHTEST, SHORTEST = 0.1, 0.05
"""[kg], [m] Least mass of a link and least distance of its centre from which the scales of their errors are
computed."""

EXACT = 1e-13
"""Least variance of the noise, as a share of the sum of squares of the largest torque that the prior allows: beside
less noise the prior drowns in rounding (logs of a simulation without any)."""

ROUNDS = 8
"""Number of iterations that estimate the noise and the coefficients in turn; four or five suffice."""


@dataclass(frozen=True)
class Sums:
    """The data of a motion: Gram matrices (n, p + 1, p + 1) of each joint's p columns and, as the last one, its torque
    minus the nominal torque; the number of rows (n,)."""

    grams: np.ndarray
    rows: np.ndarray

    def __add__(self, other: "Sums") -> "Sums":
        return Sums(self.grams + other.grams, self.rows + other.rows)


@dataclass(frozen=True)
class Prior:
    """What is known beforehand of p coefficients: they are about zero with standard deviations `scale` (p,), for those
    that are `inertial` (p,) times a share s; those that are `positive` (p,) are not below `least` (p,)."""

    scale: np.ndarray
    inertial: np.ndarray
    positive: np.ndarray
    least: np.ndarray

    @property
    def lower(self) -> np.ndarray:
        """(p,) bounds of all coefficients, none above zero."""
        return np.where(self.positive, np.minimum(self.least, 0.0), -np.inf)

    def at(self, share: float) -> np.ndarray:
        """Standard deviations (p,) for this share."""
        return np.where(self.inertial, share, 1.0) * self.scale


@dataclass(frozen=True)
class Standard:
    """Coefficients (p,) with their covariance (p, p), the share s and how it was chosen ("left out", "evidence",
    "given"), the standard deviation (n,) of each joint's noise, and by how much [nats] the evidence for them is above
    that for the nominal torque as it is, and above that for the inertial ones as they are nominally."""

    theta: np.ndarray
    covariance: np.ndarray
    share: float
    chosen: str
    noise: np.ndarray
    gain: float
    of_inertial: float


ALIKE = 0.05
"""Relative distance of two motions' Gram matrices below which they are repeats: the same path, driven again, differs by
its tracking errors; another draw of sines by a fifth and more."""


def distinct(motions: Sequence[Sums]) -> list[Sums]:
    """The motions that differ; repeats of one motion are summed, regardless of when they began."""
    found: list[Sums] = []
    for one in motions:
        near = next((k for k, other in enumerate(found) if _distance(one, other) < ALIKE), None)
        if near is None:
            found.append(one)
        else:
            found[near] = found[near] + one
    return found


def link_scales(robot: Robot) -> np.ndarray:
    """(n, 10) what a link's parameters are of the order of: mass m, first moments m L, inertia 2 m L² + 2/3 tr I about
    its centre; L is the distance of the centre."""
    rows = np.asarray(robot.inertial, float)
    mass = np.maximum(rows[:, 0], LIGHTEST)
    centre = rows[:, 1:4] / np.where(np.abs(rows[:, :1]) > 0, rows[:, :1], np.inf)
    length = np.maximum(np.linalg.norm(centre, axis=1), SHORTEST)
    about_frame = rows[:, 4] + rows[:, 6] + rows[:, 9]
    about_centre = np.maximum(about_frame - 2 * rows[:, 0] * np.sum(centre**2, axis=1), 0.0)
    inertia = 2 * mass * length**2 + 2 / 3 * about_centre
    return np.column_stack([mass, *[mass * length] * 3, *[inertia] * 6])


def prior_of(motions: Sequence[Sums], inertial: Array, positive: Array, least: Array | None = None) -> Prior:
    """The prior of columns whose `inertial` scales (p,) are known, zero for a coefficient that is none: its standard
    deviation is WIDE times the RMS of its joint's torque beside the nominal one, over the RMS of its column."""
    total = _total(motions)
    squares = np.einsum("jpp->jp", total.grams) / np.maximum(total.rows, 1)[:, None]
    own = np.argmax(squares[:, :-1], axis=0)  # a column of one joint has rows of that joint alone
    left, column = squares[own, -1], squares[own, np.arange(len(own))]
    wide = WIDE * np.sqrt(left / np.where(column > 0, column, np.inf))
    inertial, positive = np.asarray(inertial, float), np.asarray(positive, bool)
    least = np.zeros(len(own)) if least is None else np.asarray(least, float)
    return Prior(np.where(inertial > 0, inertial, wide), inertial > 0, positive, least)


def fit(motions: Sequence[Sums], prior: Prior, times: Array, share: float | None = None) -> Standard:
    """The coefficients of largest posterior.

    Args:
        motions: one for each that differs from the others; repeats of a motion are summed, because what is not
            modelled repeats with it, and leaving one out would say that a free fit is best.
        times: (n,) autocorrelation time of each joint's residual [rows].
        share: s, where it is not to be learned.
    """
    times = np.asarray(times, float)
    total = _total(motions)
    chosen = "given"
    if share is None:
        chosen = "left out" if len(motions) > 1 else "evidence"
        judge = partial(_left_out, motions) if len(motions) > 1 else lambda *given: -evidence(total, *given)
        share = min(SHARES, key=lambda s: judge(prior, times, s))
    theta, noise, precision = _posterior(total, prior, times, share)
    scale = prior.at(share)
    half = scipy.linalg.solve_triangular(scipy.linalg.cholesky(precision, lower=True), np.diag(scale), lower=True)
    fewer = (np.zeros(len(scale)), np.where(prior.inertial, 0.0, prior.scale))
    gains = [evidence(total, replace(prior, scale=x), times, share) for x in fewer]
    gain, of_inertial = evidence(total, prior, times, share) - np.array(gains)
    bounded = _bounded(theta, precision, prior.lower, scale)
    return Standard(bounded, half.T @ half, share, chosen, np.sqrt(noise), float(gain), float(of_inertial))


def within(prior: Prior, theta: Array, covariance: Array) -> np.ndarray:
    """Coefficients (p,) of which no positive one is below its bound, as likely as they can be with the inertial ones as
    they are: links that were moved to be bodies move friction, too. `covariance` (p, p) is that of the posterior."""
    theta, known = np.array(theta, float), prior.scale > 0
    if np.all(theta >= prior.lower):
        return theta
    free, scale = ~prior.inertial & known, prior.scale[known]
    precision = np.linalg.inv(np.asarray(covariance)[np.ix_(known, known)] / np.outer(scale, scale))
    own = free[known]
    theta[free] = _bounded(theta[free], precision[np.ix_(own, own)], prior.lower[free], scale[own])
    return theta


def of_shares(motions: Sequence[Sums], prior: Prior, times: Array) -> dict[float, float]:
    """The evidence for each share up to the USUAL one."""
    total = _total(motions)
    return {s: evidence(total, prior, times, s) for s in SHARES if s <= USUAL}


def widest(motions: Sequence[Sums], prior: Prior, times: Array) -> float:
    """The largest share up to the USUAL one for which the evidence is no less than OPEN nats below the best."""
    found = of_shares(motions, prior, times)
    return max(s for s in found if found[s] > max(found.values()) - OPEN)


def with_one_more(motions: Sequence[Sums], prior: Prior, together: Array, scale: float) -> tuple[list[Sums], Prior]:
    """The same with one coefficient more, the last: it moves the others by `together` (p,) each, and has this prior
    standard deviation."""
    p = len(prior.scale)
    make = np.zeros((p + 1, p + 2))
    make[:p, :p], make[:p, p], make[p, p + 1] = np.eye(p), together, 1.0
    more = [Sums(make.T @ one.grams @ make, one.rows) for one in motions]
    added = {"scale": scale, "inertial": False, "positive": False, "least": 0.0}
    return more, Prior(**{name: np.append(getattr(prior, name), x) for name, x in added.items()})


def replicas(parts: Sequence[Sums], prior: Prior, times: Array, share: float) -> np.ndarray:
    """(parts, p) coefficients of the data without each of its parts, for a jackknife."""
    total, times = _total(parts), np.asarray(times, float)
    others = [Sums(total.grams - one.grams, total.rows - one.rows) for one in parts]
    return np.stack([_posterior(x, prior, times, share)[0] for x in others])


def left(motions: Sequence[Sums], theta: Array) -> np.ndarray:
    """RMS (n,) of the torque that these coefficients leave unexplained."""
    total = _total(motions)
    return np.sqrt(_squares(total, np.asarray(theta)) / np.maximum(total.rows, 1))


def line(motions: Sequence[Sums], columns: Array) -> np.ndarray:
    """Coefficients (p,) by plain least squares of some `columns` (p,) alone, each joint by itself; zero elsewhere."""
    total, theta = _total(motions), np.zeros(len(np.asarray(columns)))
    for gram in total.grams:
        own = np.flatnonzero(np.asarray(columns) & (np.diag(gram)[:-1] > 0))
        scale = np.sqrt(np.diag(gram)[own])
        scaled = gram[np.ix_(own, own)] / np.outer(scale, scale)
        theta[own] = np.linalg.pinv(scaled, rcond=1e-10, hermitian=True) @ (gram[own, -1] / scale) / scale
    return theta


def evidence(total: Sums, prior: Prior, times: Array, share: float) -> float:
    """Log marginal likelihood of a share but for a constant, the noise at its likeliest, a row for 1 / `times`."""
    theta, noise, precision = _posterior(total, prior, np.asarray(times, float), share)
    effective = total.rows / times
    known = (theta / np.maximum(prior.at(share), 1e-300)) ** 2
    spread = 2 * np.sum(np.log(np.diag(scipy.linalg.cholesky(precision, lower=True))))
    return float(-0.5 * effective @ np.log(noise) - 0.5 * known.sum() - 0.5 * spread)


def _left_out(motions: Sequence[Sums], prior: Prior, times: np.ndarray, share: float) -> float:
    """Mean square of the residual on motions that were not learned from, relative for each joint to that of a fit of
    all motions at the usual share."""
    usual = _posterior(_total(motions), prior, times, USUAL)[1]
    squares = np.zeros(len(times))
    for k, one in enumerate(motions):
        theta, _, _ = _posterior(_total([m for i, m in enumerate(motions) if i != k]), prior, times, share)
        squares += _squares(one, theta)
    return float(np.sum(squares / np.maximum(_total(motions).rows, 1) / usual))


def _distance(one: Sums, other: Sums) -> float:
    """Relative distance of two motions' Gram matrices per row, each column in its own unit."""
    a, b = (x.grams[:, :-1, :-1].sum(0) / max(float(x.rows.max()), 1.0) for x in (one, other))
    unit = np.sqrt(np.diag(a) + np.diag(b))
    scale = np.outer(unit, unit)
    a, b = (np.divide(x, scale, out=np.zeros_like(x), where=scale > 0) for x in (a, b))
    return float(np.linalg.norm(a - b) / max(np.linalg.norm(a + b) / 2, 1e-300))


def _posterior(total: Sums, prior: Prior, times: np.ndarray, share: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coefficients (p,), variance (n,) of the noise, and the precision (p, p) of the coefficients over their scales."""
    scale = prior.at(share)
    scaled = total.grams * np.append(scale, 1.0)[:, None] * np.append(scale, 1.0)
    least = 1e-12 * np.maximum(total.grams[:, -1, -1] / np.maximum(total.rows, 1), 1e-12)
    least = np.maximum(least, EXACT * np.einsum("jpp->jp", scaled)[:, :-1].max(axis=1))
    noise = np.maximum(total.grams[:, -1, -1] / np.maximum(total.rows, 1), least)
    theta, precision = np.zeros(len(scale)), np.eye(len(scale))
    for _ in range(ROUNDS):
        weighed = np.einsum("j,jab->ab", 1 / (noise * times), scaled)
        precision = np.eye(len(scale)) + weighed[:-1, :-1]
        theta = scale * scipy.linalg.solve(precision, weighed[:-1, -1], assume_a="pos")
        before, noise = noise, np.maximum(_squares(total, theta) / np.maximum(total.rows, 1), least)
        if np.allclose(before, noise, rtol=1e-3):
            break
    return theta, noise, precision


def _bounded(theta: np.ndarray, precision: np.ndarray, lower: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """The likeliest coefficients none of which is below its bound, from the likeliest at all; `precision` over their
    scales."""
    if np.all(theta >= lower):
        return theta
    root = scipy.linalg.cholesky(precision)
    safe = np.where(scale > 0, scale, 1.0)
    return scipy.optimize.lsq_linear(root, root @ (theta / safe), (lower / safe, np.inf), method="bvls").x * scale


def _squares(total: Sums, theta: np.ndarray) -> np.ndarray:
    """(n,) sums of squares of the residuals of these coefficients."""
    whole = np.append(-theta, 1.0)
    return np.maximum(np.einsum("a,jab,b->j", whole, total.grams, whole), 0.0)


def _total(motions: Sequence[Sums]) -> Sums:
    return Sums(np.sum([m.grams for m in motions], axis=0), np.sum([m.rows for m in motions], axis=0))
