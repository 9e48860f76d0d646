"""Small least-squares fits on one joint's torque: how much columns explain, and the residual without them."""

import numpy as np


def left(y: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """The residual of y (R,) or (R, m) after a fit of the columns (R, k); some may be zero or equal."""
    basis = span(columns)
    return y - basis @ (basis.T @ y)


def span(columns: np.ndarray) -> np.ndarray:
    """Orthonormal basis (R, r) of the columns (R, k), each scaled to its norm before its rank is judged."""
    norms = np.linalg.norm(columns, axis=0)
    scaled = columns[:, norms > 0] / norms[norms > 0]
    if not scaled.size:
        return np.zeros((len(columns), 0))
    basis, values, _ = np.linalg.svd(scaled, full_matrices=False)
    return basis[:, values > 1e-8 * values[0]]


def share(residual: np.ndarray, y: np.ndarray) -> float:
    """1 - residual variance over the variance of y, about its mean; NaN where y does not change."""
    total = float(np.sum((y - y.mean()) ** 2))
    return 1 - float(np.sum(residual**2)) / total if total > 0 else float("nan")


def slope(y: np.ndarray, x: np.ndarray) -> float:
    """Least-squares factor of x (R,) in y (R,); NaN where x is zero."""
    power = float(x @ x)
    return float(x @ y) / power if power > 0 else float("nan")


def correlation(y: np.ndarray, x: np.ndarray) -> float:
    """Cosine between x and y (R,); 0 where one of them is zero."""
    power = float(np.sqrt((x @ x) * (y @ y)))
    return float(x @ y) / power if power > 0 else 0.0


def lowest(x: np.ndarray, y: np.ndarray) -> float:
    """The position of the minimum of y over the evenly spaced x, refined by a parabola in the interior."""
    k = int(np.argmin(y))
    if not 0 < k < len(y) - 1:
        return float(x[k])
    curve = y[k - 1] - 2 * y[k] + y[k + 1]
    return float(x[k] + (0.5 * (y[k - 1] - y[k + 1]) / curve if curve > 0 else 0.0) * (x[1] - x[0]))
