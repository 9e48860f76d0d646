"""Normal equations, solved with what is known of the coefficients beforehand."""

import numpy as np

LEAST_PRECISION = 1e-9
"""Share of a column's own square that is added to it: columns that cancel each other are no error."""


def inverted(normal: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """The inverse of the normal matrix with what is known beforehand, as `solved` takes it."""
    if not len(normal):
        return normal
    scale = np.sqrt(np.maximum(np.diag(normal) + precision, 1e-300))
    scaled = normal / np.outer(scale, scale) + np.diag(precision / scale**2 + LEAST_PRECISION)
    return np.linalg.inv(scaled) / np.outer(scale, scale)


def solved(normal: np.ndarray, r: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """Coefficients (k,) of the normal equations with what is known beforehand."""
    if not len(r):
        return r
    scale = np.sqrt(np.maximum(np.diag(normal) + precision, 1e-300))
    scaled = normal / np.outer(scale, scale) + np.diag(precision / scale**2 + LEAST_PRECISION)
    return np.linalg.solve(scaled, r / scale) / scale
