"""Normal equations of parts of a log: solved with what is known beforehand, and judged on the parts held out."""

from collections.abc import Iterator, Sequence

import numpy as np

LEAST_PRECISION = 1e-9
"""Share of a column's own square that is added to it: columns that cancel each other are no error."""


def summed(rows: Sequence[tuple[np.ndarray, ...]]) -> tuple[np.ndarray, ...]:
    """Sums of every part of some tuples."""
    return tuple(np.sum(parts, axis=0) for parts in zip(*rows, strict=True))


def held_out(
    folds: np.ndarray, r: np.ndarray, normal: np.ndarray, precision: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Parts (B,) bool that are held out in turn, and the coefficients (k,) that the others give."""
    for fold in range(folds.max() + 1):
        out = folds == fold
        others = ~out if folds.max() else out
        yield out, solved(normal[others].sum(0), r[others].sum(0), precision)


def squares_left(s: np.ndarray, r: np.ndarray, normal: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Sums of squares (B,) that coefficients (k,) leave, of blocks' s (B,), r (B, k) and N (B, k, k)."""
    return s - 2 * r @ theta + normal @ theta @ theta


def solved(normal: np.ndarray, r: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """Coefficients (k,) of the normal equations with what is known beforehand."""
    if not len(r):
        return r
    scale = np.sqrt(np.maximum(np.diag(normal) + precision, 1e-300))
    scaled = normal / np.outer(scale, scale) + np.diag(precision / scale**2 + LEAST_PRECISION)
    return np.linalg.solve(scaled, r / scale) / scale
