"""The information in autocorrelated residuals: integrated autocorrelation time, covariance from blocks of scores, and
the number of blocks that share something."""

import numpy as np
import scipy


def autocorrelation_time(x: np.ndarray) -> float:
    """Integrated autocorrelation time of a series x (T,) in samples, at least 1: T / it is the effective sample size.

    1 + 2 sum rho_k up to the smallest lag that is five times the sum so far (Sokal 1997, section 3).
    """
    times = 2 * np.cumsum(_correlation(x)) - 1
    enough = np.arange(len(x)) >= 5 * times
    return float(max(1.0, times[np.argmax(enough)] if enough.any() else times.max()))


def resonance_time(x: np.ndarray) -> float:
    """1 + 2 sum rho_k^2 over half the series, in samples, at least 1 (Bartlett 1946): by how much the variance of a sum
    of products grows when both factors are correlated like x. It sees what oscillates, which adds up to nothing in
    `autocorrelation_time`."""
    rho = _correlation(x)[: max(1, len(x) // 2)]
    return float(max(1.0, 2 * np.sum(rho**2) - 1))


def _correlation(x: np.ndarray) -> np.ndarray:
    """Autocorrelation of x (T,) at lags 0 to T - 1 by FFT; 1 and zeros for a constant."""
    x = x - np.mean(x)
    length = scipy.fft.next_fast_len(2 * len(x), real=True)  # large prime factors take twenty times as long
    power = np.abs(scipy.fft.rfft(x, length)) ** 2
    correlation = scipy.fft.irfft(power, length)[: len(x)]
    return correlation / correlation[0] if correlation[0] > 0 else np.eye(1, len(x))[0]


def effective_number(shares: np.ndarray) -> float:
    """How many of some equal shares would be as uneven as these shares (k,): k if all are equal, 1 if one has all (Kish
    1965, the effective sample size of weights); 0 if there is nothing to share."""
    return float(shares.sum() ** 2 / max(np.sum(shares**2), 1e-300))


def merge_blocks(scores: np.ndarray, size: int) -> np.ndarray:
    """Sums of `size` neighbouring rows of scores (blocks, p); rows of an incomplete last group go to the one before."""
    return np.add.reduceat(scores, size * np.arange(max(1, len(scores) // size)), axis=0)


def score_covariance(scores: np.ndarray) -> np.ndarray:
    """Covariance (p, p) of the total score from independent block scores (B, p): the meat of the sandwich estimator.

    sum_b s_b s_b' B / (B - 1), the scores about their mean (Cameron and Miller 2015, equation 11, with a block as
    cluster).
    """
    centred = scores - scores.mean(0)
    return centred.T @ centred * len(scores) / max(1, len(scores) - 1)


def coherence(scores: np.ndarray) -> tuple[float, float, float]:
    """Whether stretches of a series say the same: scores (B, k), each stretch's products with k orthonormal columns.

    The squares |sum_b s_b|^2 are compared with those of random signs, |sum_b e_b s_b|^2 (the wild bootstrap of
    clusters: Cameron, Gelbach and Miller 2008), of which mean sum_b |s_b|^2 and variance 2 sum_(b != c) (s_b' s_c)^2
    are known; a scaled chi-square has the same two (Satterthwaite 1946). What is correlated within a stretch is counted
    as it is.

    Returns:
        the chi-square, its degrees of freedom, and the chance of as much. 0, 1, 1 where there is nothing to compare.
    """
    products = scores @ scores.T
    mean, variance = float(np.trace(products)), 2 * float(np.sum(products**2) - np.sum(np.diag(products) ** 2))
    if not variance > 0:
        return 0.0, 1.0, 1.0
    scale = variance / (2 * mean)
    value, freedom = float(np.sum(products)) / scale, mean / scale
    return value, freedom, float(scipy.stats.chi2.sf(value, freedom))
