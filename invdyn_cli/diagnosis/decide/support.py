"""What supports a claim: data that did not choose it gain by it, its exact formula holds there, and what stays
unexplained on its joint does not outweigh it."""

from collections.abc import Collection, Sequence

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Candidate, Evidence, shared_out
from invdyn_cli.diagnosis.search import naming
from invdyn_cli.diagnosis.search.exact import Refined, refine
from invdyn_cli.diagnosis.search.inquiry import Inquiry, acting_of
from invdyn_cli.diagnosis.search.judge import Hypothesis, strain
from invdyn_cli.effects.composition import EffectInstance
from invdyn_cli.recording.pieces import ROLES

OUTWEIGHED = 1.0
"""Share of the variance that stays unexplained on its joint, without which an effect explains too little to be named:
a column that is nearly orthogonal to an unknown cause still picks up a few percent of it, and one that the arm's answer
to it goes with, more."""

PICKED_UP = 0.2
"""And so much more for every further coefficient, each of which picks up as much."""

MIN_SHARE_OF_RESIDUAL = 0.5
"""Of the squares that are left on its joints, what an effect must save: a controller answers to the noise and the
rounding of its encoders, the motion follows, and the noise of the regressor goes with that of the torque."""

FELT = 0.1
"""Share of an effect's weighted squares that a joint must have to feel it."""

RARE = 0.1
"""Of its mean square, what an effect must have on the held-out rows, or at rest, to be judged there."""


def judged(evidence: Evidence) -> np.ndarray:
    """Rows (R,) bool that chose nothing; all but the reference's where there are none."""
    test = evidence.role == ROLES.index("test")
    return test if held_out(evidence) else evidence.role != ROLES.index("reference")


def _judging(evidence: Evidence, squares: np.ndarray) -> np.ndarray:
    """Rows (R,) bool on which an effect is judged that makes `squares` (R,) of them: all where it hardly comes up on
    those that chose nothing."""
    rows = judged(evidence)
    return rows if np.mean(squares[rows]) >= RARE * np.mean(squares) else np.ones_like(rows)


def held_out(evidence: Evidence) -> bool:
    """Whether there are rows that chose nothing."""
    return bool(np.any(evidence.role == ROLES.index("test")))


def refitted(inquiry: Inquiry, acting: Sequence[EffectInstance], rows: np.ndarray) -> Refined:
    return refine(inquiry.evidence, inquiry.model, acting, rows, inquiry.noise.weights, inquiry.beside(acting))


def exactly(inquiry: Inquiry, hypothesis: Hypothesis, before: Refined) -> Refined:
    """The exact parameters of a hypothesis on the data that chose it, from where they were `before` if they were."""
    known = {a.key: a for a in before.acting}
    start = acting_of(inquiry.judge, inquiry.beside(hypothesis), hypothesis)
    return refitted(inquiry, [known.get(a.key, a) for a in start], inquiry.judge.rows)


def supported(inquiry: Inquiry) -> tuple[Hypothesis, Refined, tuple[str, ...]]:
    """The candidates that gain on data that did not choose them, and explain more than what stays unknown, their
    parameters, refined anew whenever one is dropped; and sentences on others that held-out data speak for. What another
    effect might be as well has no sentence of its own: which of them was tried is chance."""
    hypothesis, chosen, said = inquiry.hypothesis, inquiry.chosen, []
    if {a.key for a in chosen.acting} != {c.key for c in hypothesis}:
        chosen = exactly(inquiry, hypothesis, chosen)
    while hypothesis:
        worst, after = None, left(inquiry, hypothesis)
        for i in range(len(hypothesis)):
            why = _fails(inquiry, hypothesis, chosen, i, after)
            if why is not None and (worst is None or why[0] < worst[1][0]):
                worst = i, why
        if worst is None and inquiry.wear and (vague := _vague(inquiry, hypothesis)):
            worst = vague[0], (vague[1].excess, "")
            one, other = sorted(_titled(inquiry, x) for x in (hypothesis[vague[0]], vague[1].candidate))
            said.append(f"Neither {one} nor {other} is claimed: these different effects explain the data equally well.")
        if worst is None:
            break
        if worst[1][1] and not any(r.equal for r in _rivals(inquiry, hypothesis, worst[0])):
            name = _titled(inquiry, hypothesis[worst[0]])
            said.append(f"{name[0].upper()}{name[1:]} was tried, but it is not claimed: {worst[1][1]}.")
        hypothesis = hypothesis[: worst[0]] + hypothesis[worst[0] + 1 :]
        around = inquiry.beside(hypothesis)
        hypothesis = naming.simplified(inquiry.judge, around, hypothesis, inquiry.pool, inquiry.wear)
        chosen = exactly(inquiry, hypothesis, chosen)
    return hypothesis, chosen, tuple(said)


def _titled(inquiry: Inquiry, one: Candidate) -> str:
    """A candidate in a sentence: its effect and its joint."""
    return one.effect.title + (f" on {inquiry.evidence.robot.joints[one.joint]}" if one.joint is not None else "")


def _rivals(inquiry: Inquiry, hypothesis: Hypothesis, i: int) -> list[naming.Rival]:
    return naming.rivals(inquiry.judge, inquiry.always, hypothesis, i, inquiry.pool)


def _vague(inquiry: Inquiry, hypothesis: Hypothesis) -> tuple[int, naming.Rival] | None:
    """The candidate beside the standard model in whose place an effect does best for which theory does not take it, if
    there is one, and that effect: what so different effects explain alike is too little to have a name."""
    found: list[tuple[int, naming.Rival]] = []
    for i, one in enumerate(hypothesis):
        like = {one.effect.name, *(name for names in one.effect.confounders for name in names)}
        others = [r for r in _rivals(inquiry, hypothesis, i) if r.equal]
        others = [r for r in others if not (one.effect.load and r.candidate.effect.load)]
        found += [(i, r) for r in others if r.candidate.effect.name not in like]
    return min(found, key=lambda x: x[1].excess, default=None)


def _fails(
    inquiry: Inquiry, hypothesis: Hypothesis, chosen: Refined, i: int, after: np.ndarray
) -> tuple[float, str] | None:
    """Why a candidate may not be claimed, with how much it explains; None if it may. The reason is "" where held-out
    data are not predicted better: that what is not there was tried is not worth a word. `after` is what the hypothesis
    leaves, `chosen` its exact parameters."""
    evidence, weights = inquiry.evidence, inquiry.noise.weights
    before = without(inquiry, hypothesis, (i,), after)
    rows = _judging(evidence, (((after - before) * evidence.valid) ** 2) @ weights)
    valid = evidence.valid & rows[:, None]
    own = [j in hypothesis[i].columns for j in range(evidence.dofs)]
    squares = np.sum((before**2 - after**2) * valid, axis=0) * own
    unknown = naming.structure(evidence, after, valid)
    gain = float(np.sum(weights * squares))
    if gain <= 0:
        return gain, ""
    everywhere = np.mean(before[rows] ** 2 - after[rows] ** 2, axis=0) @ own  # rows at rest count too
    if everywhere <= 0 and _acts_at_rest(inquiry, hypothesis, i):
        return gain, ""
    rest = float(np.sum(weights * unknown * valid.sum(0) * (np.abs(squares) > 1e-3 * np.abs(squares).max())))
    needed = OUTWEIGHED + PICKED_UP * (inquiry.judge.freedom(hypothesis[i]) - 1)
    if 0 < gain < needed * rest:
        return gain, "most of what it would explain comes from an effect that is not in the catalogue"
    late_by = hypothesis[i].effect.late_by
    if late_by:
        value = acting_of(inquiry.judge, inquiry.always, hypothesis)[i].parameters[late_by]
        if value < evidence.recording.period:
            return gain, f"{1e3 * value:.2g} ms is less than one sampling period and may come from the clock of the log"
    sure, share = _exactly(inquiry, hypothesis, chosen, i)
    if not sure:
        return gain, ""
    if share < MIN_SHARE_OF_RESIDUAL:
        why = "it is small compared with the residual, and may be an artefact of encoder noise in the feedback loop"
        return gain, why
    return None


def _acts_at_rest(inquiry: Inquiry, hypothesis: Hypothesis, i: int) -> bool:
    """Whether an effect is there while joints rest: of one that is not they say nothing, but of what friction bears."""
    evidence = inquiry.evidence
    term = _term(inquiry, hypothesis, i) ** 2 * inquiry.noise.weights
    at_rest = ~evidence.valid
    return bool(at_rest.any() and np.mean(term[at_rest]) > RARE * np.mean(term))


def _exactly(inquiry: Inquiry, hypothesis: Hypothesis, chosen: Refined, i: int) -> tuple[bool, float]:
    """Whether the logged torque is predicted better with an effect than without it, the others staying as they are: on
    held-out rows, and on draws of blocks of all rows by more than the effect costs for having been chosen on some of
    them; and by how much on the former, as a share of what is left on the joints that feel it. Columns of a channel
    effect act on the measured torque, and calm its noise; the formula does not.
    An effect that hardly comes up on the held-out rows is judged on all."""
    evidence, model, weights = inquiry.evidence, inquiry.model, inquiry.noise.weights
    others = [a for a in chosen.acting if a.key != hypothesis[i].key]
    after = chosen.residual * evidence.valid
    change = (model.without(chosen, others) - chosen.residual) * evidence.valid
    rows = _judging(evidence, change**2 @ weights)
    saved = ((2 * after + change) * change) @ weights
    every = evidence.role != ROLES.index("reference")
    per_block = np.bincount(evidence.block[every], saved[every])[np.unique(evidence.block[every])]
    doubt = naming.chance(per_block, -inquiry.judge.price((hypothesis[i],)))
    total = float(saved[rows].sum())
    of_joint = np.sum(change[rows] ** 2, axis=0) * weights
    felt = of_joint > FELT * of_joint.sum()
    remains = float(np.sum(after[rows] ** 2 @ (weights * felt)))
    return total > 0 and doubt < naming.DOUBT, total / max(remains, 1e-300)


def left(inquiry: Inquiry, hypothesis: Hypothesis) -> np.ndarray:
    """Residual (R, n) of a hypothesis fitted on the data that chose."""
    every = (*inquiry.always, *hypothesis)
    return inquiry.evidence.residual(every, inquiry.judge.verdict(every).theta)


def without(inquiry: Inquiry, hypothesis: Hypothesis, places: Collection[int], after: np.ndarray) -> np.ndarray:
    """Residual (R, n) of a hypothesis, which leaves `after`, without the candidates at these places: all else is fitted
    anew. Where that is mostly links that would be off by more than is believed of them, all else stays as it is: the
    data do not tell them from a load."""
    others = tuple(c for k, c in enumerate(hypothesis) if k not in places)
    fitted = left(inquiry, others)
    strained = _strain(inquiry, others) - _strain(inquiry, hypothesis)
    missed = (fitted**2 - after**2) * (inquiry.evidence.valid & judged(inquiry.evidence)[:, None])
    if strained <= np.sum(missed @ inquiry.noise.weights):
        return fitted
    return after + np.sum([_term(inquiry, hypothesis, k) for k in places], axis=0)


def _term(inquiry: Inquiry, hypothesis: Hypothesis, i: int) -> np.ndarray:
    """(R, n) what one candidate of a hypothesis adds to the logged torque."""
    evidence, every = inquiry.evidence, (*inquiry.always, *hypothesis)
    own = [theta for _, theta in shared_out(every, inquiry.judge.verdict(every).theta)][len(inquiry.always) + i]
    return evidence.residual((), own) - evidence.residual((hypothesis[i],), own)


def _strain(inquiry: Inquiry, hypothesis: Hypothesis) -> float:
    """`judge.strain` beside a hypothesis."""
    return strain(inquiry.always, inquiry.judge.verdict((*inquiry.always, *hypothesis)).theta)
