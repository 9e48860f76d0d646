"""What autocorrelated samples are worth, on AR(1) noise, where theory says it exactly."""

from itertools import product

import numpy as np
import pytest
from scipy import signal

from invdyn_cli.maths import statistics


def ar1(a: float, shape: tuple[int, ...], seed: int = 0) -> np.ndarray:
    """x_t = a x_{t-1} + white noise along the last axis, unit variance, from its stationary distribution."""
    e = np.random.default_rng(seed).normal(size=shape) * np.sqrt(1 - a**2)
    e[..., 0] /= np.sqrt(1 - a**2)
    return signal.lfilter([1], [1, -a], e, axis=-1)


@pytest.mark.parametrize("a", [0.0, 0.5, 0.9, 0.98])
def test_autocorrelation_time_of_ar1(a):
    """It is (1 + a) / (1 - a); allowed are four of the estimate's own spreads, sqrt((20 tau + 2) / T) of it."""
    true, samples = (1 + a) / (1 - a), 400_000
    spread = np.sqrt((20 * true + 2) / samples)
    assert statistics.autocorrelation_time(ar1(a, (samples,))) == pytest.approx(true, rel=4 * spread)


@pytest.mark.parametrize("x", [np.zeros(100), np.full(100, 3.0), ar1(-0.5, (10_000,)), np.array([2.0])])
def test_autocorrelation_time_is_never_below_one(x):
    """Constants, a single sample and series that swing back count each sample as one, no more."""
    assert statistics.autocorrelation_time(x) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("a", [0.0, 0.5, 0.9])
def test_resonance_time_of_ar1(a):
    """It is 1 + 2 sum a^(2k) = (1 + a^2) / (1 - a^2), and 3/4 more: each lag's estimate has the variance
    (1 - k/T) / T times that, and their squares add up over half the series. On the safe side, and known."""
    true = (1 + a**2) / (1 - a**2)
    assert statistics.resonance_time(ar1(a, (100_000,))) == pytest.approx(1.75 * true, rel=0.1)


def test_resonance_time_sees_what_oscillates():
    """A sine adds up to nothing in the autocorrelation time, but here to 7 T / 24: rho is a cosine that fades as
    1 - k/T, whose square has the mean (1 - k/T)^2 / 2, summed up to T/2 and doubled."""
    x = np.sin(2 * np.pi * 0.05 * np.arange(4000))
    assert statistics.autocorrelation_time(x) < 20
    assert statistics.resonance_time(x) == pytest.approx(4000 * 7 / 24, rel=0.02)


def test_autocorrelation_time_has_no_unit():
    """Another unit and another zero change nothing."""
    x = ar1(0.8, (5000,))
    assert statistics.autocorrelation_time(1e6 * x + 3e6) == pytest.approx(statistics.autocorrelation_time(x), rel=1e-6)


def test_blocks_cover_the_mean_of_ar1_and_white_noise_does_not():
    """95 % intervals of the mean from block sums hold the truth in 95 % of 400 draws (four binomial deviations either
    way, and 2 % less for 64 blocks); those of the white-noise formula, too narrow by sqrt(19), in 35 %."""
    draws, samples, block = 400, 16_384, 256  # blocks of 13 autocorrelation times
    noise = ar1(0.9, (draws, samples), seed=1)
    means = noise.mean(axis=1)
    sums = noise.reshape(draws, -1, block).sum(axis=2)
    spread = np.array([np.sqrt(statistics.score_covariance(s[:, None])[0, 0]) for s in sums]) / samples
    covered = np.mean(np.abs(means) <= 1.96 * spread)
    white = np.mean(np.abs(means) <= 1.96 * noise.std(axis=1) / np.sqrt(samples))
    assert 0.89 <= covered <= 0.99
    assert white == pytest.approx(0.35, abs=0.1)


def test_covariance_of_correlated_scores():
    """A score and its double have covariance [[v, 2 v], [2 v, 4 v]], where v is B times the score's variance."""
    x = np.random.default_rng(0).normal(size=50)
    v = 50 * x.var(ddof=1)
    np.testing.assert_allclose(statistics.score_covariance(np.stack([x, 2 * x], axis=1)), [[v, 2 * v], [2 * v, 4 * v]])


def test_merged_blocks_lose_nothing():
    """Sums of neighbours; what is left over at the end joins the last group, and a size beyond all gives one group."""
    scores = np.arange(14.0).reshape(7, 2)
    np.testing.assert_array_equal(statistics.merge_blocks(scores, 3), [[6, 9], [36, 40]])
    np.testing.assert_array_equal(statistics.merge_blocks(scores, 100), [scores.sum(0)])
    np.testing.assert_array_equal(statistics.merge_blocks(scores, 1), scores)


def test_coherence_has_the_moments_of_random_signs():
    """Of ten stretches all 1024 signs are tried: a chi-square with these degrees of freedom, scaled so that the log's
    own squares come out as the statistic, has their mean and their variance."""
    scores = np.random.default_rng(0).normal(size=(10, 3)) * np.array([3.0, 1.0, 0.2])
    signs = np.array(list(product([-1, 1], repeat=10)))
    squares = np.sum((signs @ scores) ** 2, axis=1)
    value, freedom, _ = statistics.coherence(scores)
    scale = np.sum(scores.sum(0) ** 2) / value
    assert scale * freedom == pytest.approx(squares.mean(), rel=1e-9)
    assert 2 * scale**2 * freedom == pytest.approx(squares.var(), rel=1e-9)


def test_coherence_tells_what_all_stretches_say():
    """Stretches without a common sign are below 5 % in 5 % of draws (2 to 9 % of 400); a common part of half their size
    in nearly all; one stretch alone, and none, say nothing."""
    draw = np.random.default_rng(0)
    none = [statistics.coherence(draw.normal(size=(40, 4)))[2] < 0.05 for _ in range(400)]
    common = [statistics.coherence(draw.normal(size=(40, 4)) + 0.5)[2] < 0.05 for _ in range(100)]
    assert 0.02 < np.mean(none) < 0.09 and np.mean(common) > 0.95
    assert statistics.coherence(np.ones((1, 2)))[2] == 1.0 and statistics.coherence(np.zeros((5, 2)))[2] == 1.0


@pytest.mark.parametrize(
    ("shares", "number"),
    [([3.0, 3.0, 3.0, 3.0], 4.0), ([0.0, 7.0, 0.0], 1.0), ([2.0, 2.0, 0.0], 2.0), ([0.0, 0.0], 0.0)],
)
def test_the_number_of_equal_shares(shares, number):
    """Equal shares count in full, whatever their size, and those of nothing not at all."""
    assert statistics.effective_number(np.array(shares)) == pytest.approx(number)
