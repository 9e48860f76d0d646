"""Trials that follow from what a search has found: gears under another load, another kind of the same friction, and
effects at their own sizes where a straight line is not enough."""

from collections.abc import Sequence

import numpy as np

from invdyn_cli.diagnosis.columns.candidates import kind_of, trial_at
from invdyn_cli.diagnosis.columns.evidence import Candidate, Evidence
from invdyn_cli.diagnosis.columns.gears import load_on
from invdyn_cli.diagnosis.search.judge import Hypothesis, HypothesisScorer, parameters_of, read_all
from invdyn_cli.effects.composition import EffectInstance

ALIKE = 0.02
"""Of the load that a gear carries, what must have changed for it to be tried anew."""

NEARLY = 0.9
"""Of what a body effect explains, what an encoder offset must explain to be tried at its own size."""


def others_of(acting: Sequence[EffectInstance], one: EffectInstance) -> list[EffectInstance]:
    """The other effects that reach more than a joint of their own."""
    return [a for a in acting if a is not one and a.effect.reaches_others]


def geared(evidence: Evidence, acting: Sequence[EffectInstance], tried: dict[int, list[np.ndarray]]) -> list[Candidate]:
    """The trials of every gear that might be on a joint where one was found, with what else it was found to carry, if
    that is another load than it was tried with."""
    made = []
    for one in acting:
        others = others_of(acting, one)
        if one.effect.yields and one.joint is not None and others:
            loads = tried.setdefault(one.joint, [load_on(evidence, one.joint)])
            load = load_on(evidence, one.joint, others)
            if min(np.std(load - x) for x in loads) < ALIKE * np.std(load):
                continue
            loads.append(load)
            made += [
                kind_of(c.effect).candidate(evidence, c.effect, one.joint, c.shape, others)
                for c in evidence.candidates
                if c.effect.yields and c.joint == one.joint
            ]
    return made


def related(evidence: Evidence, one: EffectInstance) -> list[Candidate]:
    """The trials of another kind of what was found."""
    shapes = one.effect.relatives(one.parameters)
    return [kind_of(one.effect).candidate(evidence, one.effect, one.joint, shape) for shape in shapes]


def acting_of(judge: HypothesisScorer, always: Hypothesis, hypothesis: Hypothesis) -> list[EffectInstance]:
    """The effects of a hypothesis with the parameters that its columns have on the data that chose it."""
    theta = judge.verdict((*hypothesis, *always)).theta
    return [EffectInstance(c.effect, c.joint, p, c.when) for c, p in read_all(judge.evidence, hypothesis, theta)]


def sharpened(
    judge: HypothesisScorer, always: Hypothesis, hypothesis: Hypothesis, pool: Sequence[Candidate]
) -> list[Candidate]:
    """Encoder offsets and base tilts, taken anew at their own sizes, that nearly do what a body or motion effect of the
    hypothesis does: others bend where their straight line does not."""
    made: list[Candidate] = []
    allowed = {c.key for c in pool}
    bent: dict[tuple, list[Candidate]] = {}
    for c in judge.evidence.candidates:
        if c.key in allowed and c.effect.bends:
            bent.setdefault(c.key, []).append(c)
    now = judge.quick((*always, *hypothesis))[0]
    for found in hypothesis:
        for key, trials in bent.items():
            if not found.effect.reaches_others or key == found.key:
                continue
            others = (*always, *(e for e in hypothesis if e is not found and e.key != key))
            without = judge.quick(others)[0]
            tried: list[tuple[float, EffectInstance]] = []
            for c in trials:
                value, theta = judge.quick((*others, c))
                parameters = parameters_of(judge.evidence, c, theta[-len(c.precision) :])
                if not c.effect.refuse(parameters) and without - value > NEARLY * (without - now):
                    tried.append((value, EffectInstance(c.effect, c.joint, parameters)))
            if tried:
                made.append(trial_at(judge.evidence, min(tried, key=lambda x: x[0])[1]))
    return made
