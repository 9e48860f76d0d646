"""Delays and soft gears of a worn arm that only the noise of encoders asks for. They are taken out of the search: what
gains by that on many joints is found before what is there."""

from invdyn_cli.diagnosis.columns.evidence import slow_saved, slow_share
from invdyn_cli.diagnosis.search.judge import Hypothesis, HypothesisScorer

EVIDENCE = 250.0
"""Noise variances by which an anomaly on a worn arm must lower the held-out loss, everything else refitted, counting
only the share that it saves where the arm moves (docs/decisions/045, 046)."""

MOSTLY = 0.5
"""That share, below which an anomaly of less evidence is feigned."""


def feigned(scorer: HypothesisScorer, always: Hypothesis, found: Hypothesis) -> set[tuple]:
    """The keys of the delays, lags and gears among `found` whose evidence is less, and mostly not where the arm moves.
    Friction and ripple, too, are fast, but no noise is like them."""
    evidence, every, odd = scorer.evidence, (*always, *found), set[tuple]()
    late = [c for c in found if c.effect.late_by or c.effect.yields]
    if not late:
        return odd
    loss, after = scorer.loss(every), evidence.residual(every, scorer.quick(every)[1])
    for c in late:
        others = tuple(x for x in every if x is not c)
        before = evidence.residual(others, scorer.quick(others)[1])
        saved = slow_saved(evidence, c.columns, c.effect.yields, before, after, scorer.weights)
        if asked_by_noise(slow_share(saved), scorer.loss(others) - loss):
            odd.add(c.key)
    return odd


def asked_by_noise(share: float, evidence: float) -> bool:
    """Whether evidence, a `share` of which is saved where the arm moves, is no more than what encoder noise feigns."""
    return share < MOSTLY and share * evidence < EVIDENCE
