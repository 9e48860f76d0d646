"""Search and exact refinement in turn, until the set of causes stays the same."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise, permutations

import numpy as np

from invdyn_cli.diagnosis.columns.candidates import trial_at
from invdyn_cli.diagnosis.columns.evidence import Candidate, Evidence
from invdyn_cli.diagnosis.search import naming, noise, resting
from invdyn_cli.diagnosis.search.composed import Model, Refined
from invdyn_cli.diagnosis.search.delay_or_lag import distinguish
from invdyn_cli.diagnosis.search.edges import together
from invdyn_cli.diagnosis.search.exact import refine
from invdyn_cli.diagnosis.search.feigned import feigned
from invdyn_cli.diagnosis.search.further import acting_of, geared, others_of, related, sharpened
from invdyn_cli.diagnosis.search.inquiry import Inquiry, Question, beside
from invdyn_cli.diagnosis.search.judge import Hypothesis, HypothesisScorer
from invdyn_cli.diagnosis.search.likely import unlikely
from invdyn_cli.diagnosis.search.noise import Noise
from invdyn_cli.diagnosis.search.placed import placed
from invdyn_cli.diagnosis.search.realisable import beyond
from invdyn_cli.diagnosis.search.steps import free_beside, search
from invdyn_cli.effects.composition import TimeWindow

ROUNDS = 3
"""Search and refinement in turn: the second search knows the nonlinear parameters. More follow only as WORTH says."""

WORTH = 0.97
"""Of what was left before a round beyond ROUNDS, or before windows, what it must come below for another to follow."""

MOSTLY, NEARLY = 0.1, 0.8
"""Of what two forces explain that act at NEARLY the same time, as a share of the time of both, what one of them may
leave: a force that comes and goes gradually is told as two that come one after the other."""

PLAINLY = 0.5
"""Of the loss of a search that tries drives that two joints share at last, what one that tries them from the first step
must come below (ours: 0.93 where a payload and friction were hidden, 0.04 where such a drive was)."""


@dataclass
class Search:
    """A search on rows that choose (`choosing`), beside what is `always` there, the last of it `usual`: the standard
    model. `pool` are the trials, which become more with what is found, and fewer by what cannot be (`barred`)."""

    evidence: Evidence
    question: Question
    choosing: np.ndarray
    noise: Noise
    always: Hypothesis
    usual: Hypothesis
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
            hypothesis = placed(self.judge, self.always, hypothesis)
            seen.append({c.key for c in hypothesis})
            self.question.told(len(hypothesis))
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
            hypothesis = self._simplified(search(self.judge, self.pool, self.always, trials, self.question.most))
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
        hypothesis, listens, embodied = self.settled(hypothesis, rounds), bool(self.usual), None
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
            fixed = (self.judge, model, self.question.effects, around)
            hypothesis, chosen, close = distinguish(*fixed, hypothesis, chosen, self.barred)
            joined = self._joined(hypothesis, chosen)
            if joined is not None:
                hypothesis = joined
                continue
            if embodied is None:  # once: a log that asks for several such payloads shows none of the catalogue's causes
                embodied = self._embodied(hypothesis, chosen)
                if embodied is not None:  # refined before anything is searched: its window may be a little off
                    hypothesis = self.settled(embodied, rounds)
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
        """A hypothesis with one effect in the place of two that come and go, if that does no worse; None if no two may
        be one. It acts from the start of the first window to the end of the second, because a rest in between says
        nothing of it; or in both windows, as a load does that is picked up in every cycle; or, as a force that comes
        and goes gradually, once where two windows are nearly the same. A drive does not become as weak again and again:
        that would fit a torque at one posture, which the catalogue lacks."""
        for i, k in permutations(range(len(hypothesis)), 2):
            one, other = chosen.acting[i], chosen.acting[k]
            if one.when is None or other.when is None or one.when.trajectory != other.when.trajectory:
                continue
            windows = sorted((*one.when.each, *other.when.each), key=lambda when: when.start)
            ways = []
            if (one.effect, one.joint) == (other.effect, other.joint) and len(windows) == 2:
                ways.append(windows[0]._replace(end=max(when.end for when in windows)))
            if not one.effect.factor and all(a.end <= b.start for a, b in pairwise(windows)):
                ways.append(together(windows))
            if not ways:
                continue
            both = tuple(trial_at(self.evidence, a) for a in (one, other))
            trials = [trial_at(self.evidence, replace(one, when=when)) for when in ways]
            self._add([*both, *trials])
            rest = tuple(c for n, c in enumerate(hypothesis) if n not in (i, k))
            every = (*self._around(hypothesis), *rest)
            most = self.judge.loss((*every, *both))
            if one.effect.placed_by and one.key[:2] == other.key[:2] and _at_once(one.when, other.when):
                most += MOSTLY * (self.judge.loss(every) - most)
            for trial in trials:
                if self.judge.loss((*every, trial)) <= most:
                    return (*rest, trial)
        return None

    def _feigned(self, hypothesis: Hypothesis) -> set[tuple]:
        return feigned(self.judge, self._around(hypothesis), hypothesis) if self.usual else set()

    def _embodied(self, hypothesis: Hypothesis, chosen: Refined) -> Hypothesis | None:
        """A hypothesis with another effect in the place of a payload that no body is, if that costs less than a
        consistent body: a torque along one axis can have nearly any cause. None if there is no such payload."""
        for key, cost in beyond(self.evidence, chosen, loads=True).items():
            one = next(c for c in hypothesis if c.key == key)
            rest = tuple(c for c in hypothesis if c is not one)
            others = [c for c in free_beside(rest, self.pool) if not c.effect.changes_inertials]
            around = (*self._around(hypothesis), *rest)
            losses = self.judge.extended(around, others)[0]
            if len(others) and np.min(losses) - self.judge.quick((*around, one))[0] < cost:
                self._bar({key})
                return (*rest, others[int(np.argmin(losses))])
        return None

    def _around(self, hypothesis: Hypothesis) -> Hypothesis:
        return beside(self.always, self.usual, hypothesis)

    def _refined(self, hypothesis: Hypothesis) -> Refined:
        """On the data that choose, from where the columns have it."""
        around = self._around(hypothesis)
        acting = acting_of(self.judge, around, hypothesis)
        return refine(self.evidence, self.model, acting, self.choosing, self.noise.weights, around)

    def _simplified(self, hypothesis: Hypothesis) -> Hypothesis:
        return naming.simplified(self.judge, self._around(hypothesis), hypothesis, self.pool, self.usual)

    def _without(self, odd: Collection[tuple], hypothesis: Hypothesis) -> Hypothesis:
        """The search again without what cannot be."""
        self._bar(odd)
        kept = tuple(c for c in hypothesis if c.key not in odd)
        return search(self.judge, self.pool, self.always, kept, self.question.most)

    def _bar(self, odd: Collection[tuple]) -> None:
        self.barred |= set(odd)
        self.pool = [c for c in self.pool if c.key not in odd]


def begin(
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


def _at_once(one: TimeWindow, other: TimeWindow) -> bool:
    """Whether two windows have nearly the same time."""
    common = min(one.end, other.end) - max(one.start, other.start)
    return common > NEARLY * (max(one.end, other.end) - min(one.start, other.start))
