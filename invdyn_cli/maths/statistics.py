"""What autocorrelated residuals are worth: integrated autocorrelation time and covariance from blocks of scores."""

import numpy as np


def autocorrelation_time(x: np.ndarray, *, window: float = 5.0) -> float:
    """Integrated autocorrelation time of a series x (T,) in samples, at least 1: T / it is the effective sample size.

    1 + 2 sum rho_k up to the smallest lag that is `window` times the sum so far (Sokal 1997, section 3); FFT, O(T log
    T).
    """
    x = x - np.mean(x)
    power = np.abs(np.fft.rfft(x, 2 * len(x))) ** 2
    correlation = np.fft.irfft(power)[: len(x)]
    if correlation[0] <= 0:
        return 1.0
    times = 2 * np.cumsum(correlation / correlation[0]) - 1
    enough = np.arange(len(x)) >= window * times
    return float(max(1.0, times[np.argmax(enough)] if enough.any() else times.max()))


def merge_blocks(scores: np.ndarray, size: int) -> np.ndarray:
    """Sums of `size` neighbouring rows of scores (blocks, p); rows of an incomplete last group go to the one before."""
    groups = max(1, len(scores) // size)
    owner = np.minimum(np.arange(len(scores)) // size, groups - 1)
    merged = np.zeros((groups, scores.shape[1]))
    np.add.at(merged, owner, scores)
    return merged


def score_covariance(scores: np.ndarray) -> np.ndarray:
    """Covariance (p, p) of the total score from independent block scores (B, p): the meat of the sandwich estimator.

    sum_b s_b s_b' B / (B - 1), the scores about their mean (Cameron and Miller 2015, equation 11, with a block as
    cluster).
    """
    centred = scores - scores.mean(0)
    return centred.T @ centred * len(scores) / max(1, len(scores) - 1)
