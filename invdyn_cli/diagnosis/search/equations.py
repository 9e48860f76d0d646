"""Normal equations, solved with a prior on the coefficients."""

import numpy as np

LEAST_PRECISION = 1e-9
"""Share of a column's own square that is added to it, so that columns that cancel each other cause no failure."""


def _scales(normal: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """The size of each coefficient's column with its prior; one of a column that is zero on all rows, whose coefficient
    is then zero."""
    squares = np.diag(normal) + precision
    return np.sqrt(np.where(squares > 0, squares, 1.0))


def _scaled(normal: np.ndarray, precision: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The normal matrix with the prior and LEAST_PRECISION, in units of `_scales`; and these."""
    scale = _scales(normal, precision)
    return normal / np.outer(scale, scale) + np.diag(precision / scale**2 + LEAST_PRECISION), scale


def inverted(normal: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """The inverse of the normal matrix with the prior, as `solved` uses it."""
    scaled, scale = _scaled(normal, precision)
    return np.linalg.inv(scaled) / np.outer(scale, scale)


def inverse_root(normal: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """A root (k, k) of the inverse of the normal matrix with the prior: times its own transpose it is that inverse."""
    scale = _scales(normal, precision)
    values, vectors = np.linalg.eigh((normal + np.diag(precision)) / np.outer(scale, scale))
    return vectors / np.sqrt(np.maximum(values, LEAST_PRECISION)) / scale[:, None]


def solved(normal: np.ndarray, r: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """Coefficients (k,) of the normal equations with the prior."""
    scaled, scale = _scaled(normal, precision)
    return np.linalg.solve(scaled, r / scale) / scale
