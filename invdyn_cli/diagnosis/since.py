"""Offset and friction of each joint before and now: the two logs of a comparison, each fitted by itself.

Where nothing else has changed, these are the changes: the search judges them on rows where other errors of formulas,
which both logs have, weigh more. A table tells them in any case.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Candidate, Evidence, judged
from invdyn_cli.diagnosis.decide.claim import left
from invdyn_cli.diagnosis.decide.findings import Made, facts, joined
from invdyn_cli.diagnosis.decide.gain import gain_of
from invdyn_cli.diagnosis.decide.intervals import reach
from invdyn_cli.diagnosis.decide.quantities import quantities
from invdyn_cli.diagnosis.search.inquiry import Inquiry
from invdyn_cli.diagnosis.search.judge import RELEVANT, Hypothesis
from invdyn_cli.diagnosis.search.naming import blind_to_stribeck
from invdyn_cli.diagnosis.standard import Beside
from invdyn_cli.diagnosis.standard_columns import SYSTEMATIC, TERMS, Columns, has_part, stretches
from invdyn_cli.effects.composition import EffectInstance
from invdyn_cli.effects.friction import StribeckFriction
from invdyn_cli.maths import standard
from invdyn_cli.types import Finding, Gain

LOGS = ("reference", "now")
FITTED = ("offset", "coulomb", "viscous")
"""Terms of the standard model that are fitted to each log: links and rotors stay as they are."""

SURE = 2.3
"""95 % intervals by which two sizes differ for sure: that is 99.9 % with eight stretches of time (Student's t with 7
degrees of freedom), and an arm of seven joints has 21 pairs of sizes."""

BETWEEN = 0.05
"""Least change of an offset or a friction that is claimed, as a share of what it was: two motions of one arm differ in
speeds, loads and rests, and the formulas of friction are wrong by some percent there (own choice)."""


def candidates(evidence: Evidence, columns: Columns) -> list[Candidate]:
    """The evidence's, those of a drive's gain only as far as each log tells by itself that it gives what links and
    rotor need by another factor: friction that has changed looks like a gain where it is most of the torque."""
    nominal, reference = evidence.residual((), np.zeros(0)), evidence.of_role("reference")
    theta = columns.fit(nominal, np.ones_like(reference)).theta
    needed, friction = evidence.tau - _without_links(columns, nominal, theta), _own(columns)

    def same(joint: int) -> bool:
        """Whether both logs have the same factor, as far as they tell."""
        table = np.vstack([needed[:, joint], friction[:, joint]]).T
        logs = (evidence.valid[:, joint] & rows for rows in (reference, ~reference))
        (before, one), (now, other) = (_factor(table, evidence.tau[:, joint], rows) for rows in logs)
        return not abs(now - before) > SURE * np.hypot(one, other)

    return [c for c in evidence.candidates if not c.effect.factor or c.joint is None or not same(c.joint)]


def _factor(table: np.ndarray, tau: np.ndarray, rows: np.ndarray) -> tuple[float, float]:
    """The first coefficient by least squares of columns (R, m) on some rows (R,), and half of its 95 % interval."""
    parts = stretches(rows)
    every, *others = (
        np.linalg.lstsq(table[x], tau[x], rcond=1e-10)[0][0] for x in (rows, *(rows & ~part for part in parts))
    )
    return float(every), float(reach([np.array(others)], np.zeros(1)))


def each_log(evidence: Evidence, made: Made, more: Beside) -> dict[str, dict[str, dict[str, Any]]]:
    """{joint: {term: {"reference": (value, lower, upper), "now": …, "differ": …}}} of offset, Coulomb and viscous
    friction beside all other changes; 95 % intervals. Nothing where there is no reference."""
    columns, reference = more.columns, evidence.reference_rows
    if reference is None or not more.asked:
        return {}
    values, halves = _fitted(columns, _without_links(columns, made.whole, more.found.theta), (reference, ~reference))
    _, both = columns.split(more.found.theta)
    for t, term, j, _ in _places(evidence):
        now = sum(a.parameters[TERMS[term][1]] for a in more.acting if has_part(a, term, j))
        values[1, t, j] += now - both[columns.terms.index(term), j]
    differ = _differ(values, halves)
    out: dict[str, dict[str, dict[str, Any]]] = {joint: {} for joint in evidence.robot.joints}
    for t, term, j, joint in _places(evidence):
        own = zip(LOGS, values[:, t, j].tolist(), halves[:, t, j].tolist(), strict=True)
        told = {log: (value, value - half, value + half) for log, value, half in own}
        out[joint][term] = {**told, "differ": bool(differ[t, j])}
    return out


def retold(inquiry: Inquiry, columns: Columns, made: Made) -> Made:
    """The claims with all offsets and frictions that differ for sure, by more than motions make them differ (BETWEEN),
    are RELEVANT and are missed on held-out data, if only such were found, and fewer, and the claims do not predict that
    better. On joints on which the search came to something else there are none."""
    evidence, claims = inquiry.evidence, made.findings[: len(made.terms)]
    reference, plain = evidence.reference_rows, {TERMS[term][0] for term in FITTED}
    others = [c for c in inquiry.hypothesis if c.effect.name not in plain]
    if reference is None or any(x.effect not in plain for x in claims) or any(c.joint is None for c in others):
        return made
    theta = columns.fit(made.whole, np.ones_like(reference)).theta
    nominal, friction = evidence.residual((), np.zeros(0)), _own(columns)
    links = _without_links(columns, nominal, theta)
    values, halves = _fitted(columns, links, (reference, ~reference))
    learned, _ = _fitted(columns, links, (reference, ~reference & ~judged(evidence)))
    differ = _differ(values, halves) & beyond_motions(*values)
    differ[:, [c.joint for c in others if c.joint is not None]] = False
    pool = {c.key: c for c in inquiry.pool if not c.shape}
    changes, least = [], RELEVANT * np.sqrt(np.mean(evidence.tau[~reference] ** 2, axis=0))
    for t, term, j, _ in _places(evidence):
        candidate = pool.get((TERMS[term][0], j))
        if differ[t, j] and candidate is not None:
            own = np.outer(friction[t, j] * ~reference, np.eye(evidence.dofs)[j])
            before, after = ((x[1] - x[0])[t, j] for x in (learned, values))
            if abs(after) * np.sqrt(np.mean(own[~reference, j] ** 2)) < least[j]:
                continue
            half = np.hypot(*halves[:, t, j])
            changes.append(_Change(candidate, j, TERMS[term][1], float(before), float(after), float(half), own))
    now = links - np.einsum("tj,tjr->rj", learned[1], friction)
    gains = [gain_of(evidence, x.joint, now + x.learned * x.torque, now) for x in changes]
    sure = [(x, gain) for x, gain in zip(changes, gains, strict=True) if gain and gain.interval95[0] > 0]
    if {x.candidate.key for x, _ in sure} <= {a.key for a in made.acting}:
        return made
    sure.sort(key=lambda x: x[1].rmse_after - x[1].rmse_before)
    hypothesis, torques = tuple(x.candidate for x, _ in sure), [x.size * x.torque for x, _ in sure]
    residual = left(inquiry, hypothesis)
    if _squares(inquiry, residual) > _squares(inquiry, made.residual):  # each helps beside the others, not by itself
        return made
    told = [_finding(inquiry, hypothesis, x, gain, claims) for x, gain in sure]
    told_now = {x.candidate.key for x, _ in sure}  # the search may have refused one of them
    refused = tuple(x for x in made.refused if x.candidate.key not in told_now)
    rest = replace(made, findings=made.findings[len(claims) :], terms=(), refused=refused)
    return replace(
        joined(rest, told, torques),
        hypothesis=hypothesis,
        acting=tuple(EffectInstance(x.candidate.effect, x.joint, {x.name: x.size}) for x, _ in sure),
        intervals=tuple({x.name: x.ends} for x, _ in sure),
        residual=residual,
        alone=nominal - sum(x.learned * x.torque for x, _ in sure),
        whole=nominal - sum(x.size * x.torque for x, _ in sure),
    )


def _squares(inquiry: Inquiry, residual: np.ndarray) -> float:
    """A residual's squares (R, n) on data that did not choose it, in noise variances."""
    valid = inquiry.evidence.valid & judged(inquiry.evidence)[:, None]
    return float(np.sum(residual**2 * valid @ inquiry.noise.weights))


@dataclass(frozen=True)
class _Change:
    """An offset or a friction that differs: its size as the data that choose have it, and as all have it, with half of
    its 95 % interval; and the torque (R, n) of a size of one."""

    candidate: Candidate
    joint: int
    name: str
    learned: float
    size: float
    half: float
    torque: np.ndarray

    @property
    def ends(self) -> tuple[float, float, float]:
        return self.size, self.size - self.half, self.size + self.half


def _finding(inquiry: Inquiry, hypothesis: Hypothesis, one: _Change, gain: Gain, claims: Sequence[Finding]) -> Finding:
    """A change as a finding; what the search could not tell from it stays its alternative, unless that changed, too."""
    candidate, robot = one.candidate, inquiry.evidence.robot
    effect, joint = candidate.effect, robot.joints[one.joint]
    old = next((x for x in claims if (x.effect, x.joint) == (effect.name, joint)), None)
    there = {c.effect.name for c in hypothesis if c.joint == one.joint}
    others = [x for x in old.alternatives if not there.issuperset(x)] if old else []
    around = (*inquiry.always, *(c for c in hypothesis if c is not candidate))
    if not old and blind_to_stribeck(inquiry.judge, around, candidate, inquiry.pool):
        others.append((StribeckFriction.name,))
    return Finding(
        effect.name,
        joint,
        "ambiguous" if others else "named",
        alternatives=tuple(others),
        parameters=quantities(robot, effect, one.joint, {one.name: one.ends}),
        gain={joint: gain},
        evidence=facts(inquiry.evidence, one.size * one.torque),
        rejected=old.rejected if old else (),
        advice=effect.advice,
        group=effect.group,
        text=effect.text,
    )


def _places(evidence: Evidence) -> Iterator[tuple[int, str, int, str]]:
    """Number and name of every term, and of every joint."""
    for t, term in enumerate(FITTED):
        for j, joint in enumerate(evidence.robot.joints):
            yield t, term, j, joint


def _own(columns: Columns) -> np.ndarray:
    """(terms, n, R) the columns of FITTED."""
    return columns.own[[columns.terms.index(term) for term in FITTED]]


def _without_links(columns: Columns, left: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """(R, n) what links and rotors of the standard model (p,) leave of what is `left`."""
    return left - columns.of(np.where(_free(columns), 0.0, theta))


def _free(columns: Columns) -> np.ndarray:
    """(p,) which coefficients are those of FITTED."""
    own = np.repeat([term in FITTED for term in columns.terms], columns.evidence.dofs)
    return np.r_[np.zeros(len(columns.links), bool), own]


def _fitted(columns: Columns, left: np.ndarray, logs: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Terms (logs, terms, n) by least squares of what is `left` (R, n) on the rows (R,) of each log, and half of their
    95 % intervals: the scatter between stretches of time, and SYSTEMATIC."""
    free, made = _free(columns), []
    for rows in logs:
        parts = [columns.sums(left, x) for x in stretches(rows)]
        every = standard.line(parts, free)
        others = np.stack([standard.line([x for x in parts if x is not one], free) for one in parts])
        made.append((every, np.hypot(reach([others], np.zeros((1, len(every)))), 2 * SYSTEMATIC * every)))
    values, halves = np.array(made)[..., free].reshape(len(logs), 2, len(FITTED), -1).swapaxes(0, 1)
    return values, halves


def beyond_motions(before: np.ndarray, now: np.ndarray) -> np.ndarray:
    """Whether sizes (terms, n) differ by more than two motions of one arm make them differ."""
    return np.abs(now - before) > BETWEEN * np.abs(before)


def _differ(values: np.ndarray, halves: np.ndarray) -> np.ndarray:
    """Whether (terms, n) sizes (2, terms, n) differ beyond doubt, with half of their intervals."""
    return np.abs(values[1] - values[0]) > SURE * np.hypot(halves[0], halves[1])
