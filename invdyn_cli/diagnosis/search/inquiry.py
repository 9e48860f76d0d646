"""The inquiry: search and exact refinement in turn, until the set of causes stays the same."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import permutations

import numpy as np

from invdyn_cli.diagnosis import known
from invdyn_cli.diagnosis.columns.candidates import trial_at
from invdyn_cli.diagnosis.columns.evidence import Candidate, Evidence
from invdyn_cli.diagnosis.search import events, naming, noise, resting
from invdyn_cli.diagnosis.search.believed import believed
from invdyn_cli.diagnosis.search.composed import Model, Refined
from invdyn_cli.diagnosis.search.delay_or_lag import distinguish
from invdyn_cli.diagnosis.search.edges import together
from invdyn_cli.diagnosis.search.equations import solved
from invdyn_cli.diagnosis.search.events import Windows
from invdyn_cli.diagnosis.search.exact import refine
from invdyn_cli.diagnosis.search.feigned import feigned
from invdyn_cli.diagnosis.search.further import acting_of, geared, others_of, related, sharpened
from invdyn_cli.diagnosis.search.judge import Hypothesis, HypothesisScorer
from invdyn_cli.diagnosis.search.likely import unlikely
from invdyn_cli.diagnosis.search.noise import Noise
from invdyn_cli.diagnosis.search.shared_part import precision_of
from invdyn_cli.diagnosis.search.slopes import Slopes
from invdyn_cli.diagnosis.search.steps import search
from invdyn_cli.diagnosis.search.windows import asked_for, at_first, left_by_standard, standing_out, terms_of
from invdyn_cli.effects.composition import EffectInstance
from invdyn_cli.effects.transmission import TorqueRipple
from invdyn_cli.interfaces import AbstractEffect
from invdyn_cli.recording.pieces import ROLES

ROUNDS = 3
"""Search and refinement in turn, at most: the second search knows the nonlinear parameters."""

WORTH = 0.97
"""Of what was left before a round beyond ROUNDS, or before windows, what it must come below for another to follow."""

PLAINLY = 0.5
"""Of the loss of a search that tries drives that two joints share at last, what one that tries them from the first step
must come below (ours: 0.93 where a payload and friction were hidden, 0.04 where such a drive was)."""


@dataclass(frozen=True)
class Inquiry:
    """What the search came to: the hypothesis with its trials, its exact parameters on the data that chose (`chosen`)
    and on all data (`whole`), and all that rivals are judged with. `close` says of a delay or lag whether the other
    does as well; `wear` are the last of `always`: the standard model, friction, offsets, rotors and links that are some
    percent off, if it is part of every hypothesis."""

    evidence: Evidence
    judge: HypothesisScorer
    model: Model
    noise: Noise
    always: Hypothesis
    hypothesis: Hypothesis
    pool: Sequence[Candidate]
    chosen: Refined
    whole: Refined
    close: Mapping[tuple[str, int | None], bool]
    wear: Hypothesis

    def beside(self, found: Sequence[Candidate | EffectInstance]) -> Hypothesis:
        """`always` as it is refined beside these."""
        return _beside(self.always, self.wear, found)

    @cached_property
    def always_usual(self) -> Hypothesis:
        """`always` with links that may be as far off as those of URDFs usually are, or as the search believed where
        that is more. Its belief was chosen with its hypothesis: beside a payload that is none it is less than is true.
        """
        of_links = [c for c in self.wear if c.joint is None]
        return tuple(replace(c, precision=np.minimum(c.precision, 1)) if c in of_links else c for c in self.always)

    def beside_usual_links(self) -> "Inquiry":
        """The same inquiry with `always_usual`: where such links refuse one effect, they judge the others, too."""
        always, noise = self.always_usual, self.noise
        judge = HypothesisScorer(self.evidence, self.judge.rows, noise.weights, noise.deviation, always, True)
        judge.refresh()
        return replace(self, always=always, judge=judge, wear=always[len(always) - len(self.wear) :])

    def worn(self, refined: Refined) -> np.ndarray:
        """(R, n) logged torque of the standard model beside these effects, which is not in their residual."""
        wear = _apart(self.wear, refined.acting)
        return self.model.allowed(refined, refined.acting, sum(len(c.precision) for c in wear))


def _beside(always: Hypothesis, wear: Hypothesis, found: Sequence[Candidate | EffectInstance]) -> Hypothesis:
    """What is always there, the standard model (the last of it) only as far as it is no part of what was found."""
    return (*always[: len(always) - len(wear)], *_apart(wear, found))


def _apart(wear: Hypothesis, found: Sequence[Candidate | EffectInstance]) -> Hypothesis:
    """What is worn beside what was found, which may have a standard term as its special case: a Stribeck friction has
    its own Coulomb level. Bristles may stand beside rigid friction."""
    general = [x for x in found if not x.effect.contains_as_limit]
    return tuple(c for c in wear if not any(x.joint == c.joint and c.effect.name in x.effect.contains for x in general))


def inquire(
    evidence: Evidence,
    effects: Mapping[str, AbstractEffect],
    allowed: Sequence[tuple[str, int | None]],
    most: int,
    compares: bool,
    side: str = "unknown",
    parted: bool = True,
    wear: Hypothesis = (),
    start: Hypothesis = (),
    heard: Noise | None = None,
) -> Inquiry:
    """What acts always, and then what comes and goes beside it.

    Args:
        effects: the causes to look for.
        allowed: (effect, joint or None for all) that are allowed for and not reported.
        most: effects at most.
        compares: whether the recording has a reference beside it.
        side: the torque's.
        parted: whether a user said what chooses and what judges; it then stays so.
        wear: links that are some percent off. They are then part of every hypothesis, and so are friction, offset and
            rotor of every joint; none of these is looked for.
        start: trials of what lasts, from which the search starts as well as from nothing.
        heard: noise that another hypothesis leaves: a model of all columns may leave far more on a short log.
    """
    everywhere = [] if compares else events.places(evidence, effects, side)  # first what both logs show
    gears = [c for c in evidence.candidates if c.effect.yields]

    def looked(
        evidence: Evidence, windows: Windows, gears: Sequence[Candidate], starts: Sequence[Hypothesis], rounds: int
    ) -> tuple[Inquiry, Windows]:
        """What a search among what lasts, these gears and windows came to; and the windows that it made use of."""
        lasting = [c for c in evidence.candidates if c.when is None and not c.effect.yields]
        if windows and not parted:
            evidence = events.interleaved(evidence, windows)
        taken = replace(evidence, candidates=[*lasting, *gears, *(c for own in windows.values() for c in own)])
        one = _searched(taken, effects, allowed, most, compares, starts, rounds, wear, heard)
        numbers = {w.number for c in one.hypothesis if c.when is not None for w in c.when.each}
        return one, {when: own for when, own in windows.items() if when.number in numbers}

    def proposed(inquiry: Inquiry, held: Windows) -> Windows:
        """All windows anew, now that the rest is known."""
        acting = inquiry.whole.acting
        refined = [w for a in acting if a.when is not None for w in a.when.each]
        residuals = [inquiry.whole.residual]
        if refined:
            residuals.append(inquiry.model.without(inquiry.whole, [a for a in acting if a.when is None]))
        lasting = [c for c in inquiry.hypothesis if c.when is None]
        beside = (*inquiry.beside(lasting), *lasting)
        places, measured = everywhere or events.places(inquiry.evidence, effects, side), inquiry.noise
        made = events.proposed(inquiry.evidence, places, residuals, measured, [*held, *refined], beside)
        if compares:  # what lasts may have taken the place of what comes and goes
            common, seen = inquiry.always, [*held, *refined, *made]
            left = [inquiry.evidence.residual(common, inquiry.judge.quick(common)[1])]
            made |= events.proposed(inquiry.evidence, places, left, measured, seen, common, events.LARGE)
        return made

    inquiry: Inquiry | None = None
    held: Windows = {}
    found: Windows = {}
    begun: Hypothesis = ()
    if everywhere and wear:
        found, begun = standing_out(evidence, everywhere, allowed, most, wear, parted)
    elif everywhere:
        found = at_first(evidence, everywhere, most)
    if found and not wear:  # what a gear carries is known when what comes and goes is
        inquiry, held = looked(evidence, found, [], [()], 1)
        if held:
            evidence, found = inquiry.evidence, proposed(inquiry, held)
        else:
            inquiry, found = None, {}
    for turn in range(1 + events.ROUNDS - bool(held)):
        starts = [*([inquiry.hypothesis] if inquiry else []), *([start] if start and not turn else [])]
        starts += [()] if compares or not turn else []
        starts += [begun] if begun else []
        again, kept = looked(evidence, {**held, **found}, gears, starts, ROUNDS + evidence.dofs)
        if turn and inquiry and kept.keys() == held.keys():
            inquiry = again  # no window more, but what lasts is known better
            break
        full = bool(held or found) and len(again.hypothesis) >= most  # and nobody knows what is missing
        idle = inquiry is not None and _left(again, again) > WORTH * _left(inquiry, again)
        inquiry, evidence, held = again, again.evidence, kept
        found = {} if full or idle else proposed(inquiry, held)
        if found and wear:
            apart = evidence if parted else events.interleaved(evidence, {**held, **found})
            found, begun = asked_for(apart, found, held, inquiry.noise, allowed, most, wear, inquiry.hypothesis)
        if not found:
            break
    assert inquiry is not None
    return inquiry


def _left(inquiry: Inquiry, other: Inquiry) -> float:
    """Squares that an inquiry leaves of all data, in another's noise variances."""
    return float(np.sum((inquiry.whole.residual * inquiry.evidence.valid) ** 2 @ other.noise.weights))


def _searched(
    evidence: Evidence,
    effects: Mapping[str, AbstractEffect],
    allowed: Sequence[tuple[str, int | None]],
    most: int,
    compares: bool,
    starts: Sequence[Hypothesis],
    rounds: int,
    wear: Hypothesis,
    heard: Noise | None,
) -> Inquiry:
    """Search from each of `starts`, refine the best, search again with the nonlinear parameters that were found, some
    rounds at most."""
    new = evidence.role == ROLES.index("train")
    choosing = new | (evidence.role == ROLES.index("reference"))
    measured = _measured(evidence, effects, new, choosing, wear)
    measured = measured if heard is None else noise.no_more(measured, heard)
    pool = list(evidence.candidates)
    declared = known.allowed_for(pool, allowed)
    pool = [c for c in pool if not known.is_allowed(c, allowed)]
    if compares and evidence.reference_rows is None:
        known.compare(evidence, pool, ROLES.index("reference"))
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
    judge.refresh()
    one = _Search(evidence, effects, choosing, measured, always, usual, most, judge, Model(evidence), pool)
    return one.finished(_begun(judge, pool, always, starts, most), rounds)


def _scale_what_both_show(
    evidence: Evidence, always: Hypothesis, pool: Sequence[Candidate], weights: np.ndarray
) -> None:
    """Add to the columns of gains what the reference shows beside the nominal model, friction above all: a gain that
    came since scales that, too; one in a window of time is to do so as well."""
    before = evidence.reference_rows
    assert before is not None
    shown, scale = Slopes.free(evidence, always), np.sqrt(weights) * (before[:, None] & evidence.valid)
    own = shown.weighed(scale)
    theta = solved(own.normal(), own.moment(evidence.residual((), np.zeros(0)) * scale), precision_of(always))
    evidence.shown = torque = shown.torque(theta)
    for c in pool:
        if c.effect.factor and c.joint is not None:
            (column,) = c.columns[c.joint][1]
            evidence.tables[c.joint][~before, column] += torque[~before, c.joint]


def _measured(
    evidence: Evidence,
    effects: Mapping[str, AbstractEffect],
    new: np.ndarray,
    choosing: np.ndarray,
    wear: Hypothesis,
) -> Noise:
    """The noise; ripples that stand out of it are no noise, and become candidates of the evidence."""
    measured = noise.measure(evidence, new)  # what has changed since a reference is no noise
    ripple = effects.get(TorqueRipple.name)
    if not isinstance(ripple, TorqueRipple) or any(c.effect is ripple for c in evidence.candidates):
        return measured
    terms = left_by_standard(evidence, measured, choosing, wear) if wear else noise.left_by_terms(evidence, choosing)
    lines = noise.ripples(evidence, measured, [terms] if wear else [measured.residual, terms], choosing, ripple)
    evidence.candidates += lines
    return noise.measure(evidence, new) if lines else measured


@dataclass
class _Search:
    """A search on rows that choose (`choosing`), beside what is `always` there, the last of it `usual`: the standard
    model. `pool` are the trials, which become more with what is found, and fewer by what cannot be (`barred`)."""

    evidence: Evidence
    effects: Mapping[str, AbstractEffect]
    choosing: np.ndarray
    noise: Noise
    always: Hypothesis
    usual: Hypothesis
    most: int
    judge: HypothesisScorer
    model: Model
    pool: list[Candidate]
    barred: set[tuple] = field(default_factory=set)

    def settled(self, hypothesis: Hypothesis, rounds: int) -> Hypothesis:
        """A hypothesis after refinement and search in turn, until the causes stay the same or hardly gain."""
        seen: list[set[tuple]] = []
        loss = np.inf
        loads: dict[int, list[np.ndarray]] = {}
        widened: set[tuple] = set()
        for number in range(rounds):
            self._add(sharpened(self.judge, self.always, hypothesis, self.pool))
            seen.append({c.key for c in hypothesis})
            refined = self._refined(hypothesis)
            odd = unlikely(self.evidence, self.model, self.noise, refined) | self._feigned(hypothesis)
            kin = [c for a in refined.acting if a.key not in widened for c in related(self.evidence, a)]
            widened |= {a.key for a in refined.acting}
            self._add(kin)
            odd -= {c.key for c in kin}  # its other kind may be likely
            if odd:
                hypothesis = self._without(odd, hypothesis)
                continue
            trials = tuple(trial_at(self.evidence, a, others_of(refined.acting, a)) for a in refined.acting)
            self._add([*trials, *geared(self.evidence, refined.acting, loads)])
            hypothesis = self._simplified(search(self.judge, self.pool, self.always, trials, self.most))
            before, loss = loss, self.judge.loss((*self.always, *hypothesis))
            if {c.key for c in hypothesis} in seen or (number >= ROUNDS and loss > WORTH * before):
                break
        return hypothesis

    def _add(self, trials: Sequence[Candidate]) -> None:
        """Trials that are new, and their columns to the judge's."""
        self.pool += [c for c in trials if c not in self.pool]
        self.judge.refresh()

    def finished(self, hypothesis: Hypothesis, rounds: int) -> Inquiry:
        """The inquiry that begins with a hypothesis: settled, refined on the data that chose it and on all, without
        what is unlikely then. On a worn arm, where it leaves plainly less than the noise, it is settled again in
        that."""
        evidence, model = self.evidence, self.model
        hypothesis, listens = self.settled(hypothesis, rounds), bool(self.usual)
        while True:
            model.scanned.clear()  # gears once more from far and near, now that all of their load is known
            chosen = self._refined(hypothesis)
            quieter = noise.quieter(evidence, chosen.residual, self.choosing, self.noise) if listens else None
            if quieter is not None:
                self.noise, listens = quieter, False
                weights, deviation = quieter.weights, quieter.deviation
                self.judge = HypothesisScorer(evidence, self.choosing, weights, deviation, self.always, True)
                hypothesis = self.settled(hypothesis, rounds)
                continue
            weights, around = self.noise.weights, self._around(hypothesis)
            fixed = (self.judge, model, self.effects, around)
            hypothesis, chosen, close = distinguish(*fixed, hypothesis, chosen, self.barred)
            joined = self._joined(hypothesis, chosen)
            if joined is not None:
                hypothesis = joined
                continue
            chosen, timed = resting.edges(evidence, model, chosen)
            found = zip(hypothesis, chosen.acting, timed, strict=True)
            hypothesis = tuple(
                trial_at(evidence, a) if edges or (a.when and a.when.again) else c for c, a, edges in found
            )
            self.judge.refresh()
            whole = refine(evidence, model, chosen.acting, np.ones_like(self.choosing), weights, around)
            odd = {key for one in (chosen, whole) for key in unlikely(evidence, model, self.noise, one)}
            odd |= self._feigned(hypothesis)
            if not odd:
                searched = (evidence, self.judge, model, self.noise, self.always, hypothesis, self.pool)
                return Inquiry(*searched, chosen, whole, close, self.usual)
            hypothesis = self._simplified(self._without(odd, hypothesis))

    def _joined(self, hypothesis: Hypothesis, chosen: Refined) -> Hypothesis | None:
        """A hypothesis with one effect in the place of two that come and go, if that does no worse: one all the time
        from the first to the last, because a rest in the middle of an event says nothing of it, or the same effect
        twice, as a load that is taken up again. None if no two may be one."""
        for i, k in permutations(range(len(hypothesis)), 2):
            one, other = chosen.acting[i], chosen.acting[k]
            if one.when is None or other.when is None or one.when.trajectory != other.when.trajectory:
                continue
            twice = together(sorted((*one.when.each, *other.when.each), key=lambda when: when.start))
            whole = one.when._replace(end=max(one.when.end, other.when.end))
            ways = [twice]
            if (one.effect, one.joint) == (other.effect, other.joint) and one.when.start < other.when.start:
                ways = [whole, twice]
            both = [trial_at(self.evidence, a) for a in (one, other)]
            trials = [trial_at(self.evidence, replace(one, when=when)) for when in ways]
            self._add([*both, *trials])
            rest = tuple(c for n, c in enumerate(hypothesis) if n not in (i, k))
            every = (*self._around(hypothesis), *rest)
            best = min(trials, key=lambda c: self.judge.loss((*every, c)))
            if self.judge.loss((*every, best)) <= self.judge.loss((*every, *both)):
                return (*rest, best)
        return None

    def _feigned(self, hypothesis: Hypothesis) -> set[tuple]:
        return feigned(self.judge, self._around(hypothesis), hypothesis) if self.usual else set()

    def _around(self, hypothesis: Hypothesis) -> Hypothesis:
        return _beside(self.always, self.usual, hypothesis)

    def _refined(self, hypothesis: Hypothesis) -> Refined:
        """On the data that choose, from where the columns have it."""
        around = self._around(hypothesis)
        acting = acting_of(self.judge, around, hypothesis)
        return refine(self.evidence, self.model, acting, self.choosing, self.noise.weights, around)

    def _simplified(self, hypothesis: Hypothesis) -> Hypothesis:
        return naming.simplified(self.judge, self._around(hypothesis), hypothesis, self.pool, self.usual)

    def _without(self, odd: Collection[tuple], hypothesis: Hypothesis) -> Hypothesis:
        """The search again without what cannot be."""
        self.barred |= set(odd)
        self.pool = [c for c in self.pool if c.key not in odd]
        kept = tuple(c for c in hypothesis if c.key not in odd)
        return search(self.judge, self.pool, self.always, kept, self.most)


def _begun(
    judge: HypothesisScorer, pool: Sequence[Candidate], always: Hypothesis, starts: Sequence[Hypothesis], most: int
) -> Hypothesis:
    """The best of what a search comes to from each of `starts`. A drive that two joints share takes up half of all that
    is still missing: with it from the first step on a search must come to PLAINLY more than with it beside the rest."""

    def best(pool: Sequence[Candidate], starts: Sequence[Hypothesis]) -> Hypothesis:
        found = (search(judge, pool, always, start, most) for start in starts)
        return min(found, key=lambda one: judge.loss((*always, *one)))

    shared = [c for c in pool if c.effect.coupled]
    if not shared:
        return best(pool, starts)
    late = best(pool, [best([c for c in pool if not c.effect.coupled], starts)])
    asked = PLAINLY * judge.loss((*always, *late))
    if asked < judge.floor and np.min(judge.extended(always, shared)[0]) > asked:  # noise was measured without them
        return late
    early = best(pool, starts)
    return early if judge.loss((*always, *early)) < asked else late
