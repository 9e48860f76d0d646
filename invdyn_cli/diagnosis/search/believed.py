"""By how much the links of a worn arm are off, and the anomalies that its search begins with: both at once.

Links that may be off by anything imitate a payload, a tilt or an encoder offset, and a share that was chosen while the
anomaly was missing is too large. So each anomaly is tried with every share, and the marginal likelihood decides
(MacKay 1992): it pays for links by the volume that the log leaves of what was believed of them.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Candidate, Evidence
from invdyn_cli.diagnosis.search.judge import Hypothesis, HypothesisScorer
from invdyn_cli.diagnosis.search.noise import Noise
from invdyn_cli.diagnosis.search.steps import free_beside

SMALLER = (1.0, 0.3, 0.1, 0.03, 0.01)
"""Of the share by which links are off beside no anomaly, what is tried beside one."""


def believed(
    evidence: Evidence,
    rows: np.ndarray,
    noise: Noise,
    always: Hypothesis,
    links: Candidate,
    pool: Sequence[Candidate],
    starts: Sequence[Hypothesis],
    most: int,
) -> tuple[Candidate, Hypothesis]:
    """The links with the share of largest evidence, and the anomalies that are added one by one, as long as the
    evidence grows, to each of `starts`; the best of these.

    Args:
        rows: (R,) bool, those that choose.
        always: what else is part of every hypothesis.
        links: all links off by the largest share, as one candidate.
        pool: trials of anomalies.
        most: anomalies at most.
    """
    shares = [replace(links, precision=links.precision / share**2) for share in SMALLER]
    judges = [HypothesisScorer(evidence, rows, noise.weights, noise.deviation, (*always, x), True) for x in shares]
    for judge in judges:
        judge.refresh()
    costs = [volume(judge, (x,)) - judge.price(judge.always) for judge, x in zip(judges, shares, strict=True)]

    def value(k: int, hypothesis: Hypothesis) -> float:
        return judges[k].quick((*judges[k].always, *hypothesis))[0] + costs[k]

    def grown(found: Hypothesis) -> tuple[float, int, Hypothesis]:
        """The evidence, the share's number and the anomalies that `found` grows to."""
        best = min(((value(k, found), k, found) for k in range(len(shares))), key=lambda x: x[0])
        while len(best[2]) < most:
            base, free = best[2], free_beside(best[2], pool)
            tried = [one for k, judge in enumerate(judges) if (one := _added(judge, k, costs[k], base, free, best[0]))]
            if not tried:
                break
            best = min(tried, key=lambda x: x[0])
        return best

    _, at, found = min((grown(start) for start in starts), key=lambda x: x[0])
    return shares[at], found


def _added(
    judge: HypothesisScorer, number: int, cost: float, found: Hypothesis, free: Sequence[Candidate], loss: float
) -> tuple[float, int, Hypothesis] | None:
    """The evidence with the best of some trials beside what was found, if it is better than `loss` and physics."""
    base = (*judge.always, *found)
    losses, own = judge.extended(base, free)
    for i in np.argsort(losses):
        if losses[i] + cost >= loss:
            return None
        one = (*base, free[i])
        if not judge.impossible(free[i], own[i]) and not judge.refused(one, judge.quick(one)[1]):
            return float(losses[i] + cost), number, (*found, free[i])
    return None


def volume(judge: HypothesisScorer, hypothesis: Hypothesis) -> float:
    """Logarithm of the volume of coefficients beforehand, less that of those that the log allows; doubled, as losses
    are."""
    if not hypothesis:
        return 0.0
    scale = 1 / np.sqrt(np.concatenate([c.precision for c in hypothesis]))
    normal = judge.equations(hypothesis)[1] * np.outer(scale, scale)
    return float(np.linalg.slogdet(np.eye(len(scale)) + normal)[1])
