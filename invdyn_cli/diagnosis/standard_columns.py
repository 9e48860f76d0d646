"""The standard model as columns on the rows of a log, and its least-squares fit to a residual.

The standard model (`maths/standard.py`) is what every arm has beside its URDF: friction, offset and rotor of every
joint, and errors of all links.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Evidence, filtered
from invdyn_cli.diagnosis.decide.intervals import reach
from invdyn_cli.effects.actuator import RotorInertia, TorqueOffset
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.composition import EffectInstance
from invdyn_cli.effects.friction import CoulombFriction, ViscousFriction
from invdyn_cli.effects.load import LinkInertiaError
from invdyn_cli.effects.rigid import regressor
from invdyn_cli.maths import standard, statistics
from invdyn_cli.maths.links import bodies
from invdyn_cli.maths.standard import Standard, Sums

TERMS: Mapping[str, tuple[str, str]] = {
    "offset": (TorqueOffset.name, "offset"),
    "coulomb": (CoulombFriction.name, "coulomb"),
    "viscous": (ViscousFriction.name, "damping"),
    "armature": (RotorInertia.name, "armature"),
}
"""The terms of a joint: the effect that each is, and its parameter."""

LINK = EFFECTS[LinkInertiaError.name]

STRETCHES = 8
"""Number of stretches of time, each left out once, from whose fits a coefficient's scatter is taken."""

SYSTEMATIC = 2.5e-3
"""Standard error, as a share of a coefficient, that no scatter shows: clocks, holding, filters (`make worn`)."""

RECORDINGS = 3
"""Least number of recordings from which the scatter between them is taken."""


@dataclass(frozen=True)
class Columns:
    """The columns of the standard model on the rows of an evidence.

    Attributes:
        evidence: whose rows these are.
        terms: names of those that a joint has, a rotor's inertia only where the torque is taken before the gear.
        links: (10 n, n, R) what each inertial parameter of each link adds to each joint's torque, filtered like it.
        own: (terms, n, R) the terms of each joint.

    Its p coefficients are the ten parameters of each link and then each term of every joint.
    """

    evidence: Evidence
    terms: tuple[str, ...]
    links: np.ndarray
    own: np.ndarray

    def behind(self, acting: Sequence[EffectInstance]) -> "Columns":
        """The same as they are logged behind the channels among these effects."""
        links, own = (self.evidence.logged(acting, x.swapaxes(1, 2)).swapaxes(1, 2) for x in (self.links, self.own))
        return replace(self, links=links, own=own)

    @property
    def inertial(self) -> np.ndarray:
        """(p,) which coefficients are those of links."""
        return np.arange(len(self.links) + self.own[..., 0].size) < len(self.links)

    def split(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients (p,) as those of the links (n, 10) and of the terms (terms, n)."""
        n = self.evidence.dofs
        return theta[: 10 * n].reshape(n, 10), theta[10 * n :].reshape(-1, n)

    def of(self, theta: np.ndarray) -> np.ndarray:
        """(R, n) torque of coefficients (p,)."""
        links, own = self.split(theta)
        return (np.tensordot(links.ravel(), self.links, 1) + np.einsum("tj,tjr->jr", own, self.own)).T

    def fit(self, left: np.ndarray, rows: np.ndarray, least: np.ndarray | None = None) -> Standard:
        """The standard model, its links being bodies, of what is `left` (R, n) on some `rows` (R,); `least` (terms, n):
        bounds of the terms."""
        robot = self.evidence.robot
        motions, prior, times = self.asked(left, rows, standard.link_scales(robot), least)
        made = standard.fit(motions, prior, times)
        return replace(made, theta=standard.within(prior, bodies(robot, made.theta, made.covariance), made.covariance))

    def widest(self, left: np.ndarray, rows: np.ndarray) -> float:
        """The largest share by which links may be off beside a load, which may be any: see `maths.standard.widest`."""
        scales = standard.link_scales(self.evidence.robot)
        scales[-1] = 0.0  # the last link's parameters are the load's
        return standard.widest(*self.asked(left, rows, scales))

    def asked(
        self, left: np.ndarray, rows: np.ndarray, links: np.ndarray, least: np.ndarray | None = None
    ) -> tuple[list[Sums], standard.Prior, np.ndarray]:
        """Motions, prior and autocorrelation times; `links` (n, 10): scales of their parameters, zero where any will
        do."""
        motions = standard.distinct(self._motions(left, rows))
        scales, positive, bounds = np.zeros((3, len(self.inertial)))
        scales[self.inertial] = links.ravel()
        positive[~self.inertial] = np.repeat([name != "offset" for name in self.terms], self.evidence.dofs)
        bounds[~self.inertial] = 0.0 if least is None else least.ravel()
        prior = standard.prior_of(motions, scales, positive, bounds)
        first = standard.fit(motions, prior, np.ones(self.evidence.dofs), standard.USUAL)
        return motions, prior, self.times(left - self.of(first.theta), rows)

    def reach(self, fitted: Standard, left: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """(p,) half of the 95 % interval of coefficients that were fitted to what is `left` (R, n) on some `rows` (R,),
        from the root of the sum of squares: what the noise and the prior leave unknown; their scatter between stretches
        of time or between recordings, which shows what the model has not; and SYSTEMATIC."""
        _, prior, times = self.asked(left, rows, standard.link_scales(self.evidence.robot))
        parts = [self.sums(left, stretch) for stretch in stretches(rows)]
        ways = [x for x, least in ((parts, 2), (self._motions(left, rows), RECORDINGS)) if len(x) >= least]
        scatter = reach(
            [standard.replicas(x, prior, times, fitted.share) for x in ways], np.zeros((1, len(fitted.theta)))
        )
        unknown = reach([], np.diag(std_of(fitted)))
        return np.sqrt(scatter**2 + unknown**2 + (2 * SYSTEMATIC * fitted.theta) ** 2)

    def line(self, left: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Coefficients (p,) of the terms alone by plain least squares: the friction line that a user would draw."""
        return standard.line(self._motions(left, rows), ~self.inertial)

    def without_links(self, fitted: Standard, left: np.ndarray, rows: np.ndarray, least: np.ndarray) -> Standard:
        """The terms alone, in the place of a fit with links: least squares within the same bounds."""
        bounds = np.where([[name == "offset"] for name in self.terms], -np.inf, least).ravel()
        free = ~self.inertial
        while True:
            theta = standard.line(self._motions(left, rows), free)
            beyond = np.flatnonzero(theta[~self.inertial] < bounds)
            if not len(beyond):
                break
            free[np.flatnonzero(~self.inertial)[beyond]] = False
        terms = np.outer(~self.inertial, ~self.inertial)
        return replace(fitted, theta=theta, covariance=fitted.covariance * terms, share=0.0, chosen="held out")

    def _motions(self, left: np.ndarray, rows: np.ndarray) -> list[Sums]:
        """What every trajectory says."""
        names = self.evidence.trajectory
        return [self.sums(left, rows & (names == name)) for name in dict.fromkeys(names[rows].tolist())]

    def sums(self, left: np.ndarray, rows: np.ndarray) -> Sums:
        """What some rows (R,) bool say of what is `left` (R, n)."""
        n, p = self.evidence.dofs, len(self.links) + self.own[..., 0].size
        grams, count = np.zeros((n, p + 1, p + 1)), np.zeros(n)
        for j in range(n):
            kept = np.flatnonzero(rows & self.evidence.valid[:, j])
            mine = np.r_[np.arange(len(self.links)), len(self.links) + n * np.arange(len(self.terms)) + j, p]
            table = np.vstack([self.links[:, j, kept], self.own[:, j, kept], left[kept, j]])
            grams[np.ix_([j], mine, mine)], count[j] = table @ table.T, len(kept)
        return Sums(grams, count)

    def times(self, left: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Autocorrelation time (n,) [rows] of each joint's residual `left` (R, n), the longest of all pieces."""
        times = np.ones(self.evidence.dofs)
        for number in range(len(self.evidence.recording.pieces)):
            mine = rows & (self.evidence.piece == number)
            for j in range(len(times)):
                kept = left[mine & self.evidence.valid[:, j], j]
                times[j] = max(times[j], statistics.autocorrelation_time(kept) if len(kept) > 1 else 1.0)
        return times


def columns_of(evidence: Evidence, side: str) -> Columns:
    """The columns on an evidence whose torque was taken on this side."""
    recording, terms = evidence.recording, tuple(t for t in TERMS if side in EFFECTS[TERMS[t][0]].sides)
    n, rows = evidence.dofs, len(evidence.role)
    own = np.empty((len(terms), n, rows))
    for j in range(n):
        parts = []
        for states in evidence.states:
            s = states[j]
            made = {"offset": np.ones_like(s.qd), "coulomb": s.sign, "viscous": s.qd, "armature": s.qdd}
            parts.append(np.stack([np.asarray(made[t]) for t in terms]))
        own[:, j] = filtered(recording, parts, j)
    links = filtered(recording, [regressor(evidence.robot, p.motion) for p in recording.pieces])
    return Columns(evidence, terms, links, own)


def std_of(fitted: Standard) -> np.ndarray:
    """Standard deviations (p,) of the coefficients."""
    return np.sqrt(np.diag(fitted.covariance))


def least_of(columns: Columns, acting: Sequence[EffectInstance]) -> np.ndarray:
    """(terms, n) how far below zero a term may go: as far as one that was found, or an effect that comes to it in a
    limit, goes above it. Friction with a memory takes over that of other terms, and their sum is no less than zero."""
    least = np.zeros(columns.own.shape[:2])
    for t, term in enumerate(columns.terms):
        effect, name = TERMS[term]
        for a in acting:
            same = a.effect.name == effect or (a.effect.contains_as_limit and effect in a.effect.contains)
            if same and a.joint is not None and a.when is None:
                least[t, a.joint] -= float(a.parameters[name])
    return least


def stretches(rows: np.ndarray) -> list[np.ndarray]:
    """The chosen rows (R,) bool in STRETCHES parts, one behind the other, each as such."""
    return [np.isin(np.arange(len(rows)), at) for at in np.array_split(np.flatnonzero(rows), STRETCHES)]


def has_part(one: EffectInstance, term: str, joint: int) -> bool:
    """Whether an effect that always acts is a standard term of a joint, or has it in it."""
    effect, name = TERMS[term]
    own = one.effect.name == effect or effect in one.effect.contains
    return own and one.joint == joint and one.when is None and name in one.parameters
