"""Dense linear least squares by orthogonal triangles: rows in streams, and regularisation that is chosen by its
predictions.

A triangle R of the rows [X | Y] holds all that least squares asks of them, in the precision of the rows (a Gram matrix
X'X squares the condition number). Triangles of groups of rows (tasks, trajectories) are put together again and again,
so that each group can be left out in turn: a strength that predicts every group from the others extrapolates; one that
is chosen inside the groups is next to none, and blows up between them.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy

Solver = Literal["lstsq", "tsvd", "ridge"]
SOLVERS = ("lstsq", "tsvd", "ridge")

STRENGTHS = {"lstsq": np.zeros(1), "tsvd": 10.0 ** np.arange(-15, 0), "ridge": 10.0 ** np.arange(-28, 0)}
"""What is tried: of the largest singular value (tsvd), of its square (ridge); the columns have length 1."""


ROUNDING = float(np.finfo(float).eps)
"""Share of the largest singular value, below which directions are dropped. A share that grows with the number of
columns costs decades without noise: a direction that one task excites at that level, another excites more."""


@dataclass(frozen=True)
class Solution:
    """Coefficients theta (p, targets), and what led to them: rank, singular values of the columns at length 1, strength
    in use per target, and the mean square (strengths, targets) that every strength leaves on groups that were left out
    (nan where none were)."""

    theta: np.ndarray
    rank: int
    singular_values: np.ndarray
    strength: np.ndarray
    tried: np.ndarray
    left_out: np.ndarray


def triangle(blocks: Iterable[np.ndarray]) -> np.ndarray:
    """R (at most c, c) of all rows of blocks (rows, c); memory: twice R and twice a block."""
    r: np.ndarray | None = None
    waiting: list[np.ndarray] = []
    for block in blocks:
        waiting.append(block)
        if sum(map(len, waiting)) >= block.shape[1]:
            r, waiting = _reduced([*([] if r is None else [r]), *waiting]), []
    if waiting:
        r = _reduced([*([] if r is None else [r]), *waiting])
    assert r is not None
    return r


def solve(
    groups: Sequence[tuple[np.ndarray, int]], targets: int, solver: Solver, strength: float | None = None
) -> Solution:
    """The least-squares solution of smallest norm (of columns at length 1), regularised.

    Args:
        groups: a triangle of the rows [X | Y] each, and how many rows it stands for; Y has `targets` columns.
        strength: of the regularisation; None chooses the one of `STRENGTHS` that leaves least, on average over groups,
            on the group that is left out.
    """
    tried = STRENGTHS[solver] if strength is None else np.array([strength])
    left_out = np.full((len(tried), targets), np.nan)
    best = np.zeros(targets, int)
    if len(tried) > 1 and len(groups) > 1:
        left_out = np.zeros_like(left_out)
        for k, (r, rows) in enumerate(groups):
            others = _Decomposed([x for i, x in enumerate(groups) if i != k], targets)
            x, y = r[:, :-targets], r[:, -targets:]
            for s, value in enumerate(tried):
                left_out[s] += np.sum((x @ others.theta(solver, float(value)) - y) ** 2, axis=0) / rows / len(groups)
        best = np.argmin(left_out, axis=0)
    parts = _Decomposed(groups, targets)
    theta = np.stack([parts.theta(solver, float(tried[b]))[:, i] for i, b in enumerate(best)], axis=1)
    limit = parts.cut(tried[best].max() if solver == "tsvd" else 0.0)
    return Solution(theta, int(np.sum(parts.values > limit)), parts.values, tried[best], tried, left_out)


class _Decomposed:
    """The singular value decomposition of all rows of some groups, the columns at length 1."""

    def __init__(self, groups: Sequence[tuple[np.ndarray, int]], targets: int) -> None:
        r = _reduced([r for r, _ in groups])
        x, y = r[:, :-targets], r[:, -targets:]
        length = np.sqrt(np.sum(x**2, axis=0))
        self.length = np.where(length > 0, length, 1.0)
        left, self.values, self.right = scipy.linalg.svd(x / self.length, full_matrices=False, check_finite=False)
        self.scores = left.T @ y

    def cut(self, share: float) -> float:
        """Singular values at or below it count as zero."""
        return max(share, ROUNDING) * self.values[0]

    def theta(self, solver: Solver, strength: float) -> np.ndarray:
        """Coefficients (p, targets)."""
        s = self.values
        kept = s > self.cut(strength if solver == "tsvd" else 0.0)
        damping = strength * s[0] ** 2 if solver == "ridge" else 0.0
        factors = np.where(kept, s / np.where(kept, s**2 + damping, 1.0), 0.0)
        return self.right.T @ (factors[:, None] * self.scores) / self.length[:, None]


def _reduced(blocks: Sequence[np.ndarray]) -> np.ndarray:
    """R of blocks that are stacked."""
    rows = np.concatenate(blocks)
    return np.asarray(scipy.linalg.qr(rows, mode="r", overwrite_a=True, check_finite=False)[0])[: rows.shape[1]]
