"""How good a prediction is: NMSE and RMSE per joint (paper, section V-B)."""

import numpy as np


def rmse(target: np.ndarray, prediction: np.ndarray) -> np.ndarray:
    """Root mean squared error per joint (n,) of torques (T, n) [N m; N]."""
    return np.sqrt(np.mean((target - prediction) ** 2, axis=0))


def nmse(target: np.ndarray, prediction: np.ndarray) -> np.ndarray:
    """Normalised mean squared error per joint (n,): MSE(P) / Var(T). NaN for a joint whose target never changes."""
    variance = np.var(target, axis=0)
    return np.divide(
        np.mean((target - prediction) ** 2, axis=0), variance, out=np.full(variance.shape, np.nan), where=variance > 0
    )
