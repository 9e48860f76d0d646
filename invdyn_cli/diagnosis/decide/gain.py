"""What a cause is worth: the held-out error of a joint without it and with it."""

from collections.abc import Iterable, Sequence

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Candidate, Evidence, judged
from invdyn_cli.types import Finding, Gain

DRAWS = 1000
"""Number of draws of blocks for the interval of a gain."""


def gain_of(evidence: Evidence, j: int, before: np.ndarray, after: np.ndarray) -> Gain | None:
    """Held-out error of a joint, where it moves, from the residuals (R, n) before and after; None where it is the same.
    What friction holds at rest is no gain and no loss: of a joint that rests in all that is held out, it is the error
    where it moves elsewhere. The interval comes from blocks drawn with replacement."""
    held, moves = judged(evidence), evidence.valid[:, j]
    rows = next((x for x in (held & moves, moves) if x.any()), held)
    numbers, of = np.unique(evidence.block[rows], return_inverse=True)
    draws = np.random.default_rng(0).multinomial(len(numbers), [1 / len(numbers)] * len(numbers), size=DRAWS)
    b, a, tau = (x[rows, j] for x in (before, after, evidence.tau))
    rms = [float(np.sqrt(np.mean(x**2))) for x in (b, a)]
    if abs(rms[0] - rms[1]) < 1e-3 * max(rms[0], 1e-12):
        return None
    per_block = [np.bincount(of, x**2, len(numbers)) for x in (b, a)]
    size = draws @ np.bincount(of, minlength=len(numbers))
    step = np.sqrt(draws @ per_block[0] / size) - np.sqrt(draws @ per_block[1] / size)
    variance = max(float(np.var(tau)), 1e-300)
    low, high = np.quantile(step, [0.025, 0.975])
    return Gain(rms[0], rms[1], rms[0] ** 2 / variance, rms[1] ** 2 / variance, (float(low), float(high)))


def gains_of(
    evidence: Evidence, candidates: Sequence[Candidate], before: np.ndarray, after: np.ndarray
) -> dict[str, Gain]:
    """Held-out error of every joint that these candidates change, from the residuals (R, n) without and with them."""
    local = all(not c.effect.reaches_others for c in candidates)
    felt = {j for c in candidates for j in c.columns} if local else range(evidence.dofs)
    gains = {name: gain_of(evidence, j, before, after) for j, name in enumerate(evidence.robot.joints) if j in felt}
    return {name: gain for name, gain in gains.items() if gain is not None}


def lowers(findings: Iterable[Finding]) -> float:
    """By how much the best of these findings lowers the RMSE of a joint [N m; N]."""
    return max((g.rmse_before - g.rmse_after for f in findings for g in f.gain.values()), default=0.0)
