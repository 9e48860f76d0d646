"""Windows to begin with: what comes and goes, before anything else is known, or beside the standard model."""

from collections.abc import Sequence
from itertools import islice

import numpy as np

from invdyn_cli.diagnosis import known
from invdyn_cli.diagnosis.columns.evidence import Candidate, Evidence
from invdyn_cli.diagnosis.search import events, noise
from invdyn_cli.diagnosis.search.believed import believed
from invdyn_cli.diagnosis.search.events import Windows
from invdyn_cli.diagnosis.search.inquiry import Question
from invdyn_cli.diagnosis.search.judge import Hypothesis, HypothesisScorer
from invdyn_cli.diagnosis.search.shared_part import precision_of
from invdyn_cli.diagnosis.search.slopes import Slopes
from invdyn_cli.diagnosis.search.steps import search

CROWDED = 1
"""Causes a joint, above which there seem to be many because what comes and goes is not among them."""


def at_first(evidence: Evidence, everywhere: Sequence[events.Place], most: int) -> Windows:
    """Windows to begin with: where what comes and goes explains most, or where without it too much seems to last."""
    measured = noise.measure_beside(evidence, evidence.of_role("train"))
    judge = HypothesisScorer(evidence, np.ones(len(evidence.block), bool), measured.weights, measured.deviation)
    nominal = evidence.residual((), np.zeros(0))
    lasting = [c for c in evidence.candidates if c.effect.invertible]  # a limit explains much of what comes and goes
    found = events.proposed(evidence, everywhere, [nominal], measured, share=events.LARGE)
    judge.refresh()
    if found and _outdoes(judge, [c for own in found.values() for c in own], lasting):
        return found
    crowd = search(judge, lasting, most=most)
    if len(crowd) <= CROWDED * evidence.dofs:
        return {}
    left = evidence.residual(crowd, judge.quick(crowd)[1])
    return events.proposed(evidence, everywhere, [left], measured, lasting=crowd)


def standing_out(
    evidence: Evidence, everywhere: Sequence[events.Place], question: Question
) -> tuple[Windows, Hypothesis]:
    """Windows of what comes and goes beyond the standard model, if the evidence asks for them beside what lasts; and
    the hypothesis that does."""
    rows, wear = evidence.of_role("train"), question.wear
    measured = noise.measure_beside(evidence, rows)
    left = left_by_standard(evidence, measured, rows, wear)
    beside = (*terms_of(evidence.candidates, wear), *wear)
    found = events.proposed(evidence, everywhere, [left], measured, lasting=beside)
    return asked_for(evidence, found, {}, measured, question) if found else ({}, ())


def asked_for(
    evidence: Evidence,
    found: Windows,
    held: Windows,
    measured: noise.Noise,
    question: Question,
    start: Hypothesis = (),
) -> tuple[Windows, Hypothesis]:
    """The windows among those found that the evidence asks for, beside what lasts and windows that are held; and the
    hypothesis that does. A load that comes and goes several times leaves most of the noise as long as one of its
    windows is missing: all at once are a start, too."""
    allowed, wear = question.allowed, question.wear
    if not question.parted:
        evidence = events.interleaved(evidence, {**held, **found})
    pool = [*evidence.candidates, *(c for own in {**held, **found}.values() for c in own)]
    always = (*evidence.given, *known.allowed_for(pool, allowed), *terms_of(pool, wear))
    pool = [c for c in pool if c.effect.group != "standard" and not known.is_allowed(c, allowed)]
    rows = evidence.of_role("train")
    judge = HypothesisScorer(evidence, rows, measured.weights, measured.deviation, (*always, wear[0]), True)
    loads = [[c for c in own if c.effect.load] for own in found.values()]
    every = [(*start, *own) for own in zip(*loads, strict=True)] if len(found) > 1 else []
    every.sort(key=lambda one: judge.loss((*judge.always, *one)))
    possible = (one for one in every if not judge.refused(whole := (*judge.always, *one), judge.quick(whole)[1]))
    starts = [start, *islice(possible, 1)]
    begun = believed(evidence, rows, measured, always, wear[0], pool, starts, question.most)[0].found
    return {when: own for when, own in found.items() if any(c.when == when for c in begun)}, begun


def _outdoes(judge: HypothesisScorer, passing: Sequence[Candidate], lasting: Sequence[Candidate]) -> bool:
    """Whether something that comes and goes explains more by itself than one effect on every joint, or of the arm, that
    lasts."""
    nothing = judge.quick(())[0]
    losses, own = judge.extended((), passing)
    possible = [x for x, c, o in zip(losses, passing, own, strict=True) if not judge.impossible(c, o)]
    best: dict[int | None, float] = {}
    for loss, c in zip(judge.extended((), lasting)[0], lasting, strict=True):
        place = c.joint if len(c.columns) == 1 else None
        best[place] = max(best.get(place, 0.0), nothing - loss)
    arm = best.pop(None, 0.0)
    return nothing - min(possible, default=nothing) > max(arm, sum(best.values()))


def terms_of(pool: Sequence[Candidate], wear: Hypothesis) -> Hypothesis:
    """The standard terms of every joint, beside links."""
    return tuple(c for c in pool if c.effect.group == "standard" and c.effect is not wear[0].effect)


def left_by_standard(evidence: Evidence, measured: noise.Noise, rows: np.ndarray, wear: Hypothesis) -> np.ndarray:
    """(R, n) what the standard model leaves; a model of all columns would take up a ripple with those of others."""
    model = (*terms_of(evidence.candidates, wear), *wear)
    scale = np.sqrt(measured.weights) * (rows[:, None] & evidence.valid)
    prior = precision_of(model)
    target = evidence.residual(model, np.zeros(len(prior)))
    return evidence.residual(model, Slopes.free(evidence, model).fitted(target, scale, prior))
