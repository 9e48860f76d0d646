"""The inquiry: search and exact refinement in turn, until the set of causes stays the same."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from invdyn_cli.diagnosis import known, naming, noise
from invdyn_cli.diagnosis.evidence import Candidate, Evidence, trial_at
from invdyn_cli.diagnosis.exact import Model, Refined, refine
from invdyn_cli.diagnosis.late import told_apart
from invdyn_cli.diagnosis.recording import ROLES
from invdyn_cli.diagnosis.search import Hypothesis, Judge, parameters_of, read_all, search
from invdyn_cli.effects.composition import Acting
from invdyn_cli.effects.transmission import TorqueRipple

ROUNDS = 3
"""Search and refinement in turn, at most: the second search knows the nonlinear parameters."""


@dataclass(frozen=True)
class Inquiry:
    """What the search came to: the hypothesis with its trials, its exact parameters on the data that chose (`chosen`)
    and on all data (`whole`), and all that rivals are judged with. `close` says of a delay or lag whether the other
    does as well."""

    evidence: Evidence
    judge: Judge
    model: Model
    noise: noise.Noise
    always: Hypothesis
    hypothesis: Hypothesis
    pool: Sequence[Candidate]
    chosen: Refined
    whole: Refined
    close: Mapping[tuple[str, int | None], bool]


def inquire(evidence: Evidence, allowed: Sequence[tuple[str, int | None]], most: int, compares: bool) -> Inquiry:
    """Search, refine, search again with the nonlinear parameters that were found.

    Args:
        allowed: (effect, joint or None for all) that are allowed for and not reported.
        most: effects at most.
        compares: whether the recording has a reference beside it.
    """
    choosing = (evidence.role == ROLES.index("train")) | (evidence.role == ROLES.index("reference"))
    pool = [c for c in evidence.candidates if c.effect.name != "asymmetric_coulomb_friction"]
    always: Hypothesis = tuple(c for c in pool if known.is_allowed(c, allowed))
    measured = noise.measure(evidence, choosing)
    lines = noise.ripples(evidence, measured, choosing, TorqueRipple())
    if lines:  # what is a ripple is no noise
        evidence.candidates += lines
        pool += lines
        measured = noise.measure(evidence, choosing)
    if compares:
        always, pool = known.compared(evidence, pool, ROLES.index("reference"))
    pool = [c for c in pool if c.key not in {a.key for a in always} or compares]
    last = evidence.dofs - 1  # the last link's error has the payload's columns: a name for both is found afterwards
    if any(c.effect.name == "payload" for c in pool):
        pool = [c for c in pool if c.key != ("link_inertia_error", last)]
    judge = Judge(evidence, choosing, measured.weights, measured.deviation, always)
    judge.refresh()
    model = Model(evidence)
    hypothesis = search(judge, pool, always, (), most)
    for _ in range(ROUNDS + evidence.dofs):
        pool += _sharpened(judge, always, hypothesis, pool)
        judge.refresh()
        before = {c.key for c in hypothesis}
        refined = refine(evidence, model, _acting(judge, always, hypothesis), choosing, measured.weights, always)
        beyond = {
            (a.effect.name, a.joint)
            for a in refined.acting
            if a.effect.name == "torque_saturation" and not _hugs(evidence, measured, refined, a)
        }
        if beyond:
            pool = [c for c in pool if c.key not in beyond]
            hypothesis = search(judge, pool, always, tuple(c for c in hypothesis if c.key not in beyond), most)
            continue
        trials = tuple(trial_at(evidence, a) for a in refined.acting)
        pool = [*pool, *(c for c in trials if not any(c is p for p in pool))]
        judge.refresh()
        hypothesis = search(judge, pool, always, trials, most)
        hypothesis = naming.simplified(judge, always, hypothesis, pool)
        if {c.key for c in hypothesis} == before:
            break
    acting = _acting(judge, always, hypothesis)
    chosen = refine(evidence, model, acting, choosing, measured.weights, always)
    hypothesis, chosen, close = told_apart(judge, model, always, hypothesis, chosen)
    whole = refine(evidence, model, chosen.acting, np.ones_like(choosing), measured.weights, always)
    return Inquiry(evidence, judge, model, measured, always, hypothesis, pool, chosen, whole, close)


def _acting(judge: Judge, always: Hypothesis, hypothesis: Hypothesis) -> list[Acting]:
    theta = judge.verdict((*hypothesis, *always)).theta
    return [Acting(c.effect, c.joint, p) for c, p in read_all(judge.evidence, hypothesis, theta)]


NEARLY = 0.9
"""Of what a body effect explains, what an encoder offset must explain to be tried at its own size."""


def _hugs(evidence: Evidence, measured: noise.Noise, refined: Refined, saturation: Acting) -> bool:
    """Whether the torque that moved a joint stays within the limit of its saturation, for the nominal model too."""
    j, limit = saturation.joint, saturation.parameters["limit"]
    assert j is not None
    used = evidence.valid[:, j]
    moved = np.abs(evidence.tau[used, j] - refined.residual[used, j])
    reach = min(float(np.quantile(x, 0.99)) for x in (moved, np.abs(evidence.nominal[used, j])))
    return limit > 0.75 * reach and limit > 3 * measured.deviation[j]


def _sharpened(judge: Judge, always: Hypothesis, hypothesis: Hypothesis, pool: Sequence[Candidate]) -> list[Candidate]:
    """Encoder offsets, taken anew at their own sizes, that nearly do what a body effect of the hypothesis does: ten
    inertials bend where the straight line of an offset does not."""
    made: list[Candidate] = []
    for i, body in enumerate(hypothesis):
        if body.effect.point != "body":
            continue
        others = (*always, *hypothesis[:i], *hypothesis[i + 1 :])
        without, now = judge.quick(others)[0], judge.quick((*always, *hypothesis))[0]
        for c in pool:
            if c.effect.point == "motion" and not any(c.key == e.key for e in others):
                value, theta = judge.quick((*others, c))
                parameters = parameters_of(judge.evidence, c, theta[-1:])
                if without - value > NEARLY * (without - now) and not c.effect.refuse(parameters):
                    made.append(trial_at(judge.evidence, Acting(c.effect, c.joint, parameters)))
    return made
