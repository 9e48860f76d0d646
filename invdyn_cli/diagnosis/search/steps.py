"""The search: which few causes together explain the residual of the nominal model, scored on blocks that were not
fitted.

A hypothesis is a set of candidates. Its loss is the weighted sum of squared residuals on held-out blocks, in units of
the noise variance and with the residual's autocorrelation, plus a price for every effect and every coefficient.
Additions, drops, exchanges and merges continue until none of them helps.
"""

from collections.abc import Iterable, Iterator, Sequence
from itertools import combinations

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Candidate
from invdyn_cli.diagnosis.search.judge import Hypothesis, HypothesisScorer

SHORTLIST = 10
"""Number of candidates of a step whose held-out loss is computed; the others gain less on the fitted data."""

Move = tuple[Hypothesis, list[Candidate]]
"""A hypothesis, and candidates, one of which is added at a time; without candidates: the hypothesis alone."""


def search(
    judge: HypothesisScorer, pool: Sequence[Candidate], always: Hypothesis = (), start: Hypothesis = (), most: int = 12
) -> Hypothesis:
    """The hypothesis of least loss that steps from `start` lead to; `always` is part of it and not counted."""
    hypothesis, loss = start, judge.loss(always + start)
    for _ in range(6 * most):
        better = _best(judge, always, _additions(hypothesis, pool), loss) if len(hypothesis) < most else None
        for moves in (_drops, _swaps, _merges):
            better = better or _best(judge, always, moves(hypothesis, pool), loss)
        if better is None:
            return hypothesis
        hypothesis, loss = better
    return hypothesis


def _best(
    judge: HypothesisScorer, always: Hypothesis, moves: Iterable[Move], loss: float
) -> tuple[Hypothesis, float] | None:
    """The best hypothesis after one of these moves, with its loss, if it is better than `loss`."""
    quick: list[tuple[float, Hypothesis, np.ndarray]] = []
    for base, candidates in moves:
        judge.tried += max(1, len(candidates))
        if not candidates:
            quick.append((judge.quick(always + base)[0], base, np.zeros(0)))
            continue
        losses, own = judge.extended(always + base, candidates)
        quick += [(losses[i], (*base, candidates[i]), own[i]) for i in np.flatnonzero(losses < loss)]
    quick.sort(key=lambda x: x[0])
    found, seen = None, 0
    for value, one, own in quick:
        if value >= loss:  # what is held out is never predicted better than what is fitted
            break
        if (len(own) and judge.impossible(one[-1], own)) or judge.refused(always + one, judge.quick(always + one)[1]):
            continue
        after = judge.loss(always + one)
        if after < loss - 1e-6:
            found, loss = (one, after), after
        seen += 1
        if seen == SHORTLIST:
            break
    return found


def _additions(hypothesis: Hypothesis, pool: Sequence[Candidate]) -> Iterator[Move]:
    """One more effect, which replaces its special cases."""
    groups: dict[tuple[int, ...], list[Candidate]] = {}
    for c in free_beside(hypothesis, pool, instead=True):
        special = tuple(i for i, e in enumerate(hypothesis) if clash(c, e)) if c.effect.contains else ()
        groups.setdefault(special, []).append(c)
    for out, candidates in groups.items():
        yield tuple(e for i, e in enumerate(hypothesis) if i not in out), candidates


def _drops(hypothesis: Hypothesis, pool: Sequence[Candidate]) -> Iterator[Move]:
    """One effect less."""
    for i in range(len(hypothesis)):
        yield hypothesis[:i] + hypothesis[i + 1 :], []


def _swaps(hypothesis: Hypothesis, pool: Sequence[Candidate]) -> Iterator[Move]:
    """Another effect in place of one that acts on the same joint."""
    for i, out in enumerate(hypothesis):
        others = hypothesis[:i] + hypothesis[i + 1 :]
        near = [c for c in pool if c is not out and not c.columns.keys().isdisjoint(out.columns)]
        fitting = free_beside(others, near)
        if fitting:
            yield others, fitting


def _merges(hypothesis: Hypothesis, pool: Sequence[Candidate]) -> Iterator[Move]:
    """One effect of the whole arm in the place of one such and another: what it does to many joints takes many others
    to imitate. And one that comes and goes in the place of one such and what always is: a change until some time is
    another from then on."""
    whole = [c for c in pool if c.effect.reaches_others or c.when is not None]
    for i, k in combinations(range(len(hypothesis)), 2):
        pair = hypothesis[i], hypothesis[k]
        if not any(c.effect.reaches_others or c.when is not None for c in pair):
            continue
        others = tuple(c for m, c in enumerate(hypothesis) if m not in (i, k))
        fitting = free_beside(others, whole)
        if fitting:
            yield others, fitting


def free_beside(hypothesis: Hypothesis, pool: Sequence[Candidate], instead: bool = False) -> list[Candidate]:
    """Candidates that have a place beside these: that are not there yet, no special case of one nor (unless it comes
    `instead`) its general case nor the general case of the same, and in a window in which nothing else happened. A
    torque is late once: a lag and a delay of opposite signs would make a second derivative."""
    keys = {e.key for e in hypothesis}
    there = {(e.joint, e.effect.name) for e in hypothesis}
    special = {(e.joint, name) for e in hypothesis for name in e.effect.contains}
    taken = special if instead else special | there
    windows = {w.number for e in hypothesis if e.when is not None for w in e.when.each}
    late = {e.joint for e in hypothesis if e.effect.late_by}
    return [
        c
        for c in pool
        if c.key not in keys
        and (c.joint, c.effect.name) not in special
        and not any((c.joint, name) in taken for name in c.effect.contains)
        and not (c.effect.late_by and c.joint in late)
        and (c.when is None or windows.isdisjoint(w.number for w in c.when.each))
    ]


def clash(whole: Candidate, part: Candidate) -> bool:
    """Whether one effect on a joint is the general case of another there."""
    return whole.joint == part.joint and part.effect.name in whole.effect.contains
