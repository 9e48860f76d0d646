"""How good a prediction is: NMSE and RMSE per joint (paper, section V-B)."""

import numpy as np

from invdyn_cli.types import Array

ACCURATE = 0.1
"""The NMSE below which the paper calls predictions accurate (section V-B, the black line of Figs. 3 and 4)."""

BLOCK = 100
"""Number of samples over which errors during adaptation are averaged (the paper's lambda)."""


def rms(x: np.ndarray) -> np.ndarray:
    """Root of the mean square over time, (n,) of (T, n), or () of (T,)."""
    return np.asarray(np.sqrt(np.mean(np.square(x), axis=0)))


def rmse(target: np.ndarray, prediction: np.ndarray) -> np.ndarray:
    """Root mean squared error per joint (n,) of torques (T, n) [N m; N]."""
    return rms(target - prediction)


def nmse(target: np.ndarray, prediction: np.ndarray) -> np.ndarray:
    """Normalised mean squared error per joint (n,): MSE(P) / Var(T). NaN for a joint whose target never changes."""
    variance = np.var(target, axis=0)
    return np.divide(
        np.mean((target - prediction) ** 2, axis=0), variance, out=np.full(variance.shape, np.nan), where=variance > 0
    )


def nmse_in_blocks(target: np.ndarray, prediction: np.ndarray, size: int, variance: np.ndarray) -> np.ndarray:
    """MSE(S) / Var(T) per joint (blocks, n) of every `size` samples S in turn (paper, section V-C); what fills no block
    is left out. `variance` (n,) is Var(T). NaN for a joint whose target never changes; infinite where a prediction is
    not finite."""
    blocks = len(target) // size
    squares = ((target - prediction) ** 2)[: blocks * size].reshape(blocks, size, target.shape[1]).mean(axis=1)
    found = np.divide(squares, variance, out=np.full(squares.shape, np.nan), where=variance > 0)
    return np.where(np.isfinite(squares), found, np.inf)


def noise_floor(q: Array, tau: np.ndarray, q_again: Array, tau_again: np.ndarray) -> np.ndarray:
    """RMS per joint (n,) of half the difference of the torques (T, n) of a trajectory and its repetition [N m; N].

    No model of the motion can have a smaller error if both differ by noise alone. The repetition is shifted by the lag,
    at most 50 samples and half of either, at which its positions (T, n) agree best.
    """
    most = min(50, len(q) // 2, len(q_again) // 2)

    def overlap(lag: int) -> tuple[slice, slice]:
        length = min(len(q) - max(lag, 0), len(q_again) + min(lag, 0))
        return slice(max(lag, 0), max(lag, 0) + length), slice(max(-lag, 0), max(-lag, 0) + length)

    def distance(lag: int) -> float:
        here, there = overlap(lag)
        return float(np.mean((q[here] - q_again[there]) ** 2))

    here, there = overlap(min(range(-most, most + 1), key=distance))
    return rms((tau[here] - tau_again[there]) / 2)
