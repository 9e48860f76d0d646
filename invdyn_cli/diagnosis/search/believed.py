"""The size of the link errors of a worn arm, and the anomalies with which its search begins: both at once.

Links with unlimited errors imitate a payload, a tilt or an encoder offset, and a size of link errors that was chosen
without the anomaly is wrong. Therefore each anomaly is tried with every size, and the marginal likelihood decides
(MacKay 1992): its price for links is the ratio of prior to posterior volume. The noise is estimated anew for each
hypothesis, from its residual with its autocorrelation.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Candidate, Evidence
from invdyn_cli.diagnosis.search.feigned import feigned
from invdyn_cli.diagnosis.search.judge import PRICE_OF_COEFFICIENT, Hypothesis, HypothesisScorer
from invdyn_cli.diagnosis.search.noise import Noise, beside
from invdyn_cli.diagnosis.search.shared_part import precision_of
from invdyn_cli.diagnosis.search.steps import free_beside

SIZES = (3.0, 1.0, 0.3, 0.1, 0.03)
"""Sizes of link errors that are tried with an anomaly, as multiples of the size that was fitted without it: that is too
large where links took up what the anomaly does, and too small where other effects took up what links do."""

SHORTLIST, LOOKED_AT = 3, 40
"""Number of trials whose evidence is computed: those with the largest gain at the noise of the present hypothesis, and
those with the largest gain at the smallest noise, if they are possible; and how many are looked at for that. A large
anomaly that is missing makes the noise of its joint so large that nothing is gained there."""


FARTHER = 30.0
"""Twice the logarithm of the likelihood by which links that are farther off than those of URDFs usually are must do
better: they take up most of what an anomaly does."""


@dataclass(frozen=True)
class Belief:
    """Links with a share, the anomalies beside them, and the noise that both leave; `cost`: what they must gain, as
    twice a logarithm: the prices of anomalies, and links by the prior and by the volume."""

    links: Candidate
    found: Hypothesis
    noise: Noise
    cost: float

    def beats(self, other: "Belief", rows: np.ndarray) -> bool:
        """Whether the evidence for this is larger, `rows` (n,) being counted by what of them is independent where the
        better of both is right: what is missing goes on for long, and leaves noise when it is there."""
        time = np.minimum(self.noise.time, other.noise.time)
        heard = self.noise.deviation > 0
        gain = 2 * np.log(other.noise.deviation[heard] / self.noise.deviation[heard])
        return float((rows / time)[heard] @ gain) > self.cost - other.cost


def believed(
    evidence: Evidence,
    rows: np.ndarray,
    noise: Noise,
    always: Hypothesis,
    links: Candidate,
    pool: list[Candidate],
    starts: Sequence[Hypothesis],
    most: int,
) -> tuple[Belief, list[Candidate]]:
    """The share of largest evidence, and the anomalies that are added one by one to each of `starts`, as long as the
    evidence grows; the best of these, found again without what is `feigned`; and the pool without that.

    Args:
        rows: (R,) bool, those that choose.
        noise: to begin with, and the least.
        always: what else is part of every hypothesis.
        links: all links off by the largest share, as one candidate.
        pool: trials of anomalies.
        most: anomalies at most.
    """
    shares = [replace(links, precision=links.precision / share**2) for share in SIZES]
    used = np.sum(rows[:, None] & evidence.valid, axis=0)

    made: list[tuple[Noise, Candidate, HypothesisScorer]] = []

    def scorer_of(own: Noise, links: Candidate) -> HypothesisScorer:
        """The scorer in a noise beside links of a size; made once for many hypotheses."""
        for one, size, scorer in made:
            if one is own and size is links:
                return scorer
        scorer = HypothesisScorer(evidence, rows, own.weights, own.deviation, (*always, links), True)
        made.append((own, links, scorer))
        return scorer

    def told(own: Noise, links: Candidate, found: Hypothesis) -> Belief:
        """A hypothesis, fitted with a first guess of its noise."""
        scorer = scorer_of(own, links)
        every = (*scorer.always, *found)
        theta = scorer.quick(every)[1]
        left = beside(evidence, evidence.residual(every, theta), rows, noise)
        bodies = (links, *(c for c in found if c.effect.load))
        by_volume = volume(scorer, bodies) - PRICE_OF_COEFFICIENT * sum(map(scorer.freedom, bodies[1:]))
        unusual = FARTHER * bool(np.any(links.precision < 1))
        cost = precision_of(every) @ theta**2 + scorer.price(found) + by_volume + unusual
        return Belief(links, found, left, float(cost))

    def best(of: Iterable[Belief]) -> Belief:
        return reduce(lambda one, other: other if other.beats(one, used) else one, of)

    def grown(found: Hypothesis) -> Belief:
        """Steps to the best of what has one more or one less. What a step back leads away from is not tried again: two
        hypotheses may each beat the other in its own noise."""
        own, seen = told(noise, links, found).noise, {_keys(found)}
        for _ in range(max(1, 2 * most)):
            bases = [told(own, x, found) for x in shares]
            scorers = [[scorer_of(y, x.links) for y in (x.noise, noise)] for x in bases]
            more = [(x, one) for x, by in zip(bases, scorers, strict=True) for one in _more(by, x, pool, most)]
            more = [(x, one) for x, one in more if _keys(one) not in seen]
            fewer = [(x, found[:i] + found[i + 1 :]) for x in bases for i in range(len(found))]
            same = [(x, found) for x in bases]  # in the noise that the others are told in
            chosen = best([told(x.noise, x.links, one) for x, one in same + more + fewer])
            if _keys(chosen.found) == _keys(found):
                break
            found, own = chosen.found, chosen.noise
            made.clear()
            seen.add(_keys(found))
        return chosen

    while True:
        one = best([grown(start) for start in starts])
        scorer = scorer_of(one.noise, one.links)
        odd = feigned(scorer, scorer.always, one.found)
        if not odd:
            return one, pool
        pool = [c for c in pool if c.key not in odd]
        starts = [tuple(c for c in one.found if c.key not in odd)]


def _keys(found: Hypothesis) -> frozenset[tuple]:
    return frozenset(c.key for c in found)


def _more(scorers: Sequence[HypothesisScorer], base: Belief, pool: Sequence[Candidate], most: int) -> list[Hypothesis]:
    """The hypothesis with one more of a few possible trials: those that gain most by each of these scorers, in its own
    noise and in the smallest."""
    if len(base.found) >= most:
        return []
    free, chosen = free_beside(base.found, pool), dict[tuple, Candidate]()
    for scorer in scorers:
        chosen |= {c.key: c for c in _best(scorer, (*scorer.always, *base.found), free)}
    return [(*base.found, c) for c in chosen.values()]


def _best(scorer: HypothesisScorer, every: Hypothesis, free: Sequence[Candidate]) -> list[Candidate]:
    """The possible trials that gain most beside a hypothesis, the best of each effect and joint."""
    losses, own = scorer.extended(every, free)
    seen: dict[tuple, Candidate] = {}
    for i in np.argsort(losses - [scorer.price((c,)) for c in free])[:LOOKED_AT]:
        if len(seen) == SHORTLIST:
            break
        one = (*every, free[i])
        if free[i].key in seen or scorer.impossible(free[i], own[i]) or scorer.refused(one, scorer.quick(one)[1]):
            continue
        seen[free[i].key] = free[i]
    return list(seen.values())


def volume(scorer: HypothesisScorer, hypothesis: Hypothesis) -> float:
    """Logarithm of the prior volume of coefficients minus that of the posterior; doubled, as losses are."""
    if not hypothesis:
        return 0.0
    scale = 1 / np.sqrt(np.concatenate([c.precision for c in hypothesis]))
    normal = scorer.equations(hypothesis)[1] * np.outer(scale, scale)
    return float(np.linalg.slogdet(np.eye(len(scale)) + normal)[1])
