"""The search as a whole: what acts always, and then what comes and goes beside it."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invdyn_cli.diagnosis import known
from invdyn_cli.diagnosis.columns.evidence import Candidate, Evidence
from invdyn_cli.diagnosis.columns.shown import beside_gain
from invdyn_cli.diagnosis.search import events, noise
from invdyn_cli.diagnosis.search.believed import believed
from invdyn_cli.diagnosis.search.composed import Model
from invdyn_cli.diagnosis.search.events import Windows
from invdyn_cli.diagnosis.search.inquiry import Inquiry, Question
from invdyn_cli.diagnosis.search.judge import Hypothesis, HypothesisScorer
from invdyn_cli.diagnosis.search.moments import on_one_side
from invdyn_cli.diagnosis.search.noise import Noise
from invdyn_cli.diagnosis.search.settling import ROUNDS, WORTH, Search, begin
from invdyn_cli.diagnosis.search.shared_part import precision_of
from invdyn_cli.diagnosis.search.slopes import Slopes
from invdyn_cli.diagnosis.search.windows import asked_for, at_first, left_by_standard, standing_out, terms_of
from invdyn_cli.effects.transmission import TorqueRipple

CROWD = 4
"""Number of different anomalies on one joint beyond which no more windows are searched: what acts there is none of the
catalogue's, and each search takes minutes."""


def inquire(evidence: Evidence, question: Question, start: Hypothesis = ()) -> Inquiry:
    """What acts always, and then what comes and goes beside it; `start` has trials of what lasts, from which the search
    starts as well as from nothing."""
    compares, wear, parted = question.compares, question.wear, question.parted
    everywhere = []  # in a comparison first what both logs show
    if not compares:
        evidence = replace(evidence, shown=np.column_stack([beside_gain(evidence, j) for j in range(evidence.dofs)]))
        everywhere = events.places(evidence, question.effects, question.side)
    gears = [c for c in evidence.candidates if c.effect.yields]
    inquiry: Inquiry | None = None
    held: Windows = {}
    found: Windows = {}
    begun: Hypothesis = ()
    if everywhere and wear:
        found, begun = standing_out(evidence, everywhere, question)
    elif everywhere:
        found = at_first(evidence, everywhere, question.most)
    if found and not wear:  # what a gear carries is known when what comes and goes is
        inquiry, held = _looked(evidence, question, found, [], [()], 1)
        if held:
            evidence, found = inquiry.evidence, _proposed(inquiry, question, held, everywhere)
        else:
            inquiry, found = None, {}
    for turn in range(1 + events.ROUNDS - bool(held)):
        starts = [*([inquiry.hypothesis] if inquiry else []), *([start] if start and not turn else [])]
        starts += [()] if compares or not turn else []
        starts += [begun] if begun else []
        again, kept = _looked(evidence, question, {**held, **found}, gears, starts, ROUNDS + evidence.dofs)
        if turn and inquiry and kept.keys() == held.keys():
            inquiry = again  # no window more, but what lasts is known better
            break
        many = len(again.hypothesis) >= question.most  # nobody knows then what is missing
        full = (many and bool(held or found or not compares)) or _is_crowded(again.hypothesis)
        idle = inquiry is not None and _left(again, again) > WORTH * _left(inquiry, again)
        inquiry, evidence, held = again, again.evidence, kept
        found = {} if full or idle else _proposed(inquiry, question, held, everywhere)
        if found and wear:
            found, begun = asked_for(evidence, found, held, inquiry.noise, question, inquiry.hypothesis)
        if not found:
            break
    assert inquiry is not None
    once = [] if parted or compares or held else on_one_side(evidence, inquiry.model.without(inquiry.whole, []))
    if once:
        evidence = events.interleaved(evidence, once)
        inquiry, _ = _looked(evidence, question, {}, gears, [inquiry.hypothesis, ()], ROUNDS + evidence.dofs)
    return inquiry


def _looked(
    evidence: Evidence,
    question: Question,
    windows: Windows,
    gears: Sequence[Candidate],
    starts: Sequence[Hypothesis],
    rounds: int,
) -> tuple[Inquiry, Windows]:
    """What a search among what lasts, these gears and windows came to; and the windows that it made use of."""
    lasting = [c for c in evidence.candidates if c.when is None and not c.effect.yields]
    if windows and not question.parted:
        evidence = events.interleaved(evidence, windows)
    taken = replace(evidence, candidates=[*lasting, *gears, *(c for own in windows.values() for c in own)])
    one = _searched(taken, question, starts, rounds)
    numbers = {w.number for c in one.hypothesis if c.when is not None for w in c.when.each}
    return one, {when: own for when, own in windows.items() if when.number in numbers}


def _proposed(inquiry: Inquiry, question: Question, held: Windows, everywhere: Sequence[events.Place]) -> Windows:
    """All windows anew, now that the rest is known."""
    acting = inquiry.whole.acting
    refined = [w for a in acting if a.when is not None for w in (a.when, *a.when.each)]
    residuals = [inquiry.whole.residual]
    if refined:
        residuals.append(inquiry.model.without(inquiry.whole, [a for a in acting if a.when is None]))
    lasting = [c for c in inquiry.hypothesis if c.when is None]
    beside = (*inquiry.beside(lasting), *lasting)
    places = everywhere or events.places(inquiry.evidence, question.effects, question.side)
    made = events.proposed(inquiry.evidence, places, residuals, inquiry.noise, [*held, *refined], beside)
    if question.compares:  # what lasts may have taken the place of what comes and goes
        common, seen = inquiry.always, [*held, *refined, *made]
        left = [inquiry.evidence.residual(common, inquiry.judge.quick(common)[1])]
        made |= events.proposed(inquiry.evidence, places, left, inquiry.noise, seen, common, events.LARGE)
    return made


def _is_crowded(hypothesis: Hypothesis) -> bool:
    """Whether more than CROWD different anomalies act on one joint."""
    kinds = {(c.joint, c.effect.name) for c in hypothesis if c.joint is not None and c.effect.group != "standard"}
    return max(Counter(joint for joint, _ in kinds).values(), default=0) > CROWD


def _left(inquiry: Inquiry, other: Inquiry) -> float:
    """Squares that an inquiry leaves of all data, in another's noise variances."""
    return float(np.sum((inquiry.whole.residual * inquiry.evidence.valid) ** 2 @ other.noise.weights))


def _searched(evidence: Evidence, question: Question, starts: Sequence[Hypothesis], rounds: int) -> Inquiry:
    """Search from each of `starts`, refine the best, search again with the nonlinear parameters that were found, some
    rounds at most."""
    new, most, wear = evidence.of_role("train"), question.most, question.wear
    choosing = new | evidence.of_role("reference")
    measured = _measured(evidence, question, new, choosing)
    measured = measured if question.heard is None else noise.no_more(measured, question.heard)
    pool = list(evidence.candidates)
    declared = known.allowed_for(pool, question.allowed)
    pool = [c for c in pool if not known.is_allowed(c, question.allowed)]
    if question.compares and evidence.reference_rows is None:
        known.compare(evidence, pool)
        _scale_what_both_show(evidence, (*evidence.given, *declared), pool, measured.weights)
    always = (*evidence.given, *declared)
    usual: Hypothesis = ()
    if wear:
        usual = terms_of(pool, wear)
        pool = [c for c in pool if c.effect.group != "standard"]
        begun, pool = believed(evidence, choosing, measured, (*always, *usual), wear[0], pool, starts, most)
        usual, starts, measured = (*usual, begun.links), [begun.found], begun.noise
        always += usual
    last = evidence.dofs - 1  # the last link's error has the payload's columns: a name for both is found afterwards
    if any(c.effect.load for c in pool):
        pool = [c for c in pool if not c.effect.changes_inertials or c.joint != last]
    pool += [c for start in starts for c in start if c not in pool]
    judge = HypothesisScorer(evidence, choosing, measured.weights, measured.deviation, always, bool(wear))
    one = Search(evidence, question, choosing, measured, always, usual, judge, Model(evidence), pool)
    return one.finished(begin(judge, pool, always, starts, most), rounds)


def _scale_what_both_show(
    evidence: Evidence, always: Hypothesis, pool: Sequence[Candidate], weights: np.ndarray
) -> None:
    """Add to the columns of gains what the reference shows beside the nominal model, friction above all: a gain that
    came since scales that, too; one in a window of time is to do so as well."""
    before = evidence.reference_rows
    assert before is not None
    shown, scale = Slopes.free(evidence, always), np.sqrt(weights) * (before[:, None] & evidence.valid)
    theta = shown.fitted(evidence.residual((), np.zeros(0)), scale, precision_of(always))
    evidence.shown = torque = shown.torque(theta)
    for c in pool:
        if c.effect.factor and c.joint is not None:
            (column,) = c.columns[c.joint][1]
            evidence.tables[c.joint][~before, column] += torque[~before, c.joint]


def _measured(evidence: Evidence, question: Question, new: np.ndarray, choosing: np.ndarray) -> Noise:
    """The noise; ripples that stand out of it are no noise, and become candidates of the evidence."""
    measured = noise.measure(evidence, new)  # what has changed since a reference is no noise
    ripple, wear = question.effects.get(TorqueRipple.name), question.wear
    if not isinstance(ripple, TorqueRipple) or any(c.effect is ripple for c in evidence.candidates):
        return measured
    terms = left_by_standard(evidence, measured, choosing, wear) if wear else noise.left_by_terms(evidence, choosing)
    lines = noise.ripples(evidence, measured, [terms] if wear else [measured.residual, terms], choosing, ripple)
    evidence.candidates += lines
    return noise.measure(evidence, new) if lines else measured
