"""What every arm has beside its URDF, fitted beside what was found: the written model has it, named or not.

A name is a statement and needs proof; a model that leaves out a real offset because its name is unsure costs its user
accuracy. So the terms of the standard model (`maths/standard.py`) are fitted to what the findings leave, and go into
the extended model with them.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Evidence, filtered, held_out, judged
from invdyn_cli.diagnosis.decide.findings import Made
from invdyn_cli.diagnosis.decide.gain import gain_of, lowers
from invdyn_cli.diagnosis.decide.intervals import reach
from invdyn_cli.diagnosis.decide.quantities import unit_of
from invdyn_cli.effects.actuator import RotorInertia, TorqueOffset
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.composition import EffectInstance
from invdyn_cli.effects.friction import CoulombFriction, ViscousFriction
from invdyn_cli.effects.load import LinkInertiaError
from invdyn_cli.effects.rigid import regressor
from invdyn_cli.maths import standard, statistics
from invdyn_cli.maths.links import bodies
from invdyn_cli.maths.standard import Standard, Sums
from invdyn_cli.types import Finding, Quantity

TERMS: Mapping[str, tuple[str, str]] = {
    "offset": (TorqueOffset.name, "offset"),
    "coulomb": (CoulombFriction.name, "coulomb"),
    "viscous": (ViscousFriction.name, "damping"),
    "armature": (RotorInertia.name, "armature"),
}
"""The terms of a joint: the effect that each is, and its parameter."""

LINK = EFFECTS[LinkInertiaError.name]

CLAIMED = 0.01
"""Share of its joint's RMS torque that a standard term must be worth to be claimed."""

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

    def of(self, theta: np.ndarray) -> np.ndarray:
        """(R, n) torque of coefficients (p,)."""
        n = self.evidence.dofs
        links, own = theta[: 10 * n], theta[10 * n :].reshape(-1, n)
        return (np.tensordot(links, self.links, 1) + np.einsum("tj,tjr->jr", own, self.own)).T

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
        """Autocorrelation time (n,) [rows] of what is left, the longest of all pieces."""
        times = np.ones(self.evidence.dofs)
        for number in range(len(self.evidence.recording.pieces)):
            mine = rows & (self.evidence.piece == number)
            for j in range(len(times)):
                kept = left[mine & self.evidence.valid[:, j], j]
                times[j] = max(times[j], statistics.autocorrelation_time(kept) if len(kept) > 1 else 1.0)
        return times


@dataclass(frozen=True)
class Beside:
    """What stands in the written model beside the findings: nothing where the evidence is for them alone.

    Attributes:
        columns: the standard model's, as they are logged behind the channels that were found.
        acting: all of it and the findings' effects; a standard term of a joint where one was found is added to it.
        asked: whether the log asks for more than the findings.
        intervals: like `acting`, {parameter: (value, lower, upper)}.
        residual: (R, n) what is left on all rows after a fit on those that chose.
        before: (R, n) what the nominal model leaves.
        learned, found: the standard model beside the findings, of what chose and of all rows.
        reach: (p,) half of the 95 % interval of each coefficient of `found`.
        share: by which the URDF's links are off, and how that was learned.
        worth: (n,) RMS torque of the links' change [N m; N].
    """

    columns: Columns
    acting: tuple[EffectInstance, ...]
    asked: bool
    intervals: tuple[Mapping[str, tuple], ...]
    residual: np.ndarray
    before: np.ndarray
    learned: Standard
    found: Standard
    reach: np.ndarray
    share: tuple[float, str]
    worth: np.ndarray


def told(
    evidence: Evidence,
    made: Beside,
    claimed: Mapping[tuple[str, str | None], Sequence[Sequence[str]]],
    more: Mapping[str, Mapping[str, Mapping[str, Any]]],
) -> dict[str, Any]:
    """The standard terms of every joint in the written model, as diagnosis.json has them; empty where the findings
    say all of it. What bristles or Stribeck friction have of a term is in it.

    Args:
        claimed: alternatives of what was claimed, by (effect, joint).
        more: what else is told of a joint's term, if anything.
    """
    if not made.asked:
        return {}
    out: dict[str, Any] = {}
    every = list(zip(made.acting, made.intervals, strict=True))
    for j, joint in enumerate(evidence.robot.joints):
        row = {}
        for term, (effect, name) in TERMS.items():
            parts = [(a, x) for a, x in every if has_part(a, term, j)]
            if not parts:
                continue
            value, *ends = np.sum([x.get(name, (a.parameters[name],) * 3) for a, x in parts], axis=0).tolist()
            unit = unit_of(EFFECTS[effect], name, evidence.robot.prismatic[j])
            others = claimed.get((effect, joint), ())
            row[term] = {"effect": effect, "value": value, "unit": unit, "interval95": ends}
            row[term]["claimed"] = (effect, joint) in claimed and not others
            if shares := [a.effect.name for a, _ in parts if a.effect.name != effect]:
                row[term]["with"] = shares
            general = [x[0] for x in others if len(x) == 1 and x[0] in EFFECTS and effect in EFFECTS[x[0]].contains]
            if others and len(general) == len(others):
                row[term]["perhaps"] = general
            row[term] |= more.get(joint, {}).get(term, {})
        out[joint] = row
    share, chosen = made.share
    worth = dict(zip(evidence.robot.joints, made.worth.tolist(), strict=True))
    return out | {"inertials": {"worth": worth, "share": share, "chosen": chosen}}


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


def _choosing(evidence: Evidence) -> np.ndarray:
    """The rows (R,) bool that choose, the reference's among them."""
    choosing = evidence.of_role("train")
    return choosing if evidence.reference_rows is None else choosing | evidence.reference_rows


def baselines(columns: Columns, evidence: Evidence, before: np.ndarray) -> dict[str, np.ndarray]:
    """(R, n) what a friction line and the standard model alone leave of what the nominal model does (`before`), fitted
    on the rows that choose."""
    choosing = _choosing(evidence)
    fitted = {"friction": columns.line(before, choosing), "standard": columns.fit(before, choosing).theta}
    return {name: before - columns.of(theta) for name, theta in fitted.items()}


def beside(columns: Columns, evidence: Evidence, made: Made) -> Beside:
    """The standard model beside what was found; where a reference is, what it shows as well."""
    before, chosen, whole, acting, intervals = made.before, made.residual, made.whole, made.acting, made.intervals
    choosing = _choosing(evidence)
    if evidence.reference_rows is not None:  # beside which what was found is a change
        before, chosen = evidence.residual((), np.zeros(0)), made.alone
    least = least_of(columns, acting)
    columns = columns.behind(acting)
    learned = columns.fit(chosen, choosing, least)
    every = np.ones_like(choosing)
    found = columns.fit(whole, every, least)
    if evidence.reference_rows is None and held_out(evidence):
        plain = columns.without_links(learned, chosen, choosing, least)
        linked, free = (errors(evidence, chosen - columns.of(x.theta)) for x in (learned, plain))
        if np.mean(free - linked) < 0:
            learned, found = plain, columns.without_links(found, whole, every, least)
    asked = learned.gain > 0
    half = columns.reach(found, whole, every)
    together, ends = _merged(evidence, columns.terms, found, half, acting, intervals) if asked else (acting, intervals)
    return Beside(
        columns=columns,
        acting=tuple(together),
        asked=asked,
        intervals=tuple(ends),
        residual=chosen - columns.of(learned.theta) if asked else chosen,
        before=before,
        learned=learned,
        found=found,
        reach=half,
        share=(found.share, found.chosen),
        worth=np.sqrt(np.mean(columns.of(np.where(columns.inertial, found.theta, 0.0)) ** 2, axis=0)),
    )


def errors(evidence: Evidence, residual: np.ndarray) -> np.ndarray:
    """(n,) logarithm of each joint's squared residuals (R, n) on the held-out rows."""
    return np.log(np.maximum(np.mean(residual[judged(evidence)] ** 2, axis=0), 1e-300))


def claims(
    evidence: Evidence, more: Beside, named: Collection[tuple[str, str | None]]
) -> tuple[tuple[Finding, ...], tuple[np.ndarray, ...]]:
    """The standard terms that the log proves, the largest gain first: away from zero by an interval that counts the
    autocorrelation, worth CLAIMED of their joint's torque, and missed on data that did not choose them; and what each
    adds to the torque (R, n).

    Args:
        named: (effect, joint) of the anomalies that were claimed; a special case of one is part of it.
    """
    n, rows, columns, made = evidence.dofs, judged(evidence), more.columns, []
    value, half = (x[10 * n :].reshape(-1, n) for x in (more.found.theta, more.reach))
    learned = more.learned.theta[10 * n :].reshape(-1, n)
    special = {(x, joint) for name, joint in named if name in EFFECTS for x in EFFECTS[name].contains}
    for t, term in enumerate(columns.terms):
        effect, name = TERMS[term]
        for j, joint in enumerate(evidence.robot.joints):
            low, high = float(value[t, j] - half[t, j]), float(value[t, j] + half[t, j])
            own = np.outer(learned[t, j] * columns.own[t, j], np.eye(n)[j])
            torque, whole = (float(np.sqrt(np.mean(x[rows, j] ** 2))) for x in (own, evidence.tau))
            if low <= 0 <= high or torque < CLAIMED * whole or (effect, joint) in {*named, *special}:
                continue
            gain = gain_of(evidence, j, more.residual + own, more.residual)
            if gain is None or gain.interval95[0] <= 0:
                continue
            own = np.outer(value[t, j] * columns.own[t, j], np.eye(n)[j])
            torque = float(np.sqrt(np.mean(own[rows, j] ** 2)))
            size = Quantity(
                float(value[t, j]), unit_of(EFFECTS[effect], name, evidence.robot.prismatic[j]), [low, high]
            )
            facts = {"rms_of_term_N_m": {joint: torque}, "share_of_torque": {joint: torque / whole}}
            told = {"parameters": {name: size}, "gain": {joint: gain}, "evidence": facts, "group": "standard"}
            made.append((Finding(effect, joint, "named", **told), own))
    made.sort(key=lambda x: -lowers([x[0]]))
    return tuple(x for x, _ in made), tuple(own for _, own in made)


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


def place_of(acting: Sequence[EffectInstance], term: str, joint: int) -> int | None:
    """Where a joint's term stands among effects that always act."""
    effect = TERMS[term][0]
    return next((k for k, a in enumerate(acting) if a.key == (effect, joint)), None)


def has_part(one: EffectInstance, term: str, joint: int) -> bool:
    """Whether an effect that always acts is a standard term of a joint, or has it in it."""
    effect, name = TERMS[term]
    own = one.effect.name == effect or effect in one.effect.contains
    return own and one.joint == joint and one.when is None and name in one.parameters


def _merged(
    evidence: Evidence,
    terms: Sequence[str],
    found: Standard,
    half: np.ndarray,
    acting: Sequence[EffectInstance],
    intervals: Sequence[Mapping[str, tuple]],
) -> tuple[Sequence[EffectInstance], Sequence[Mapping[str, tuple]]]:
    """All effects and their intervals."""
    n = evidence.dofs
    theta = found.theta
    together: list[EffectInstance] = list(acting)
    ends: list[dict[str, tuple]] = [dict(x) for x in intervals]
    for t, term in enumerate(terms):
        effect, name = TERMS[term]
        for j in range(n):
            value, wide = (float(x[10 * n + t * n + j]) for x in (theta, half))
            place = place_of(acting, term, j)
            if place is None:
                together.append(EffectInstance(EFFECTS[effect], j, {name: value}))
                ends.append({name: (value, value - wide, value + wide)})
                continue
            old = together[place]
            total = float(old.parameters[name]) + value
            together[place] = replace(old, parameters={**old.parameters, name: total})
            if name in ends[place]:  # the finding's own width, about the value that is written
                _, low, high = ends[place][name]
                ends[place][name] = (total, low + value, high + value)
    for j, row in enumerate(theta[: 10 * n].reshape(n, 10)):
        if not row.any():
            continue
        spread = half[10 * j : 10 * j + 10]
        split = {"mass": 0, "moment": slice(1, 4), "inertia": slice(4, 10)}
        plain = {k: float(row[at]) if k == "mass" else row[at] for k, at in split.items()}
        together.append(EffectInstance(LINK, j, plain))
        ends.append({k: (plain[k], row[at] - spread[at], row[at] + spread[at]) for k, at in split.items()})
    return together, ends
