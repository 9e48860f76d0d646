"""The noise floor from a repeated trajectory."""

import numpy as np

from invdyn_cli.maths.metrics import noise_floor


def test_it_recovers_noise_over_a_lag():
    """Two recordings of one motion, started seven samples apart, with independent noise sigma: RMS of half the
    difference is sigma / sqrt(2), within 5 % (20,000 samples: the standard error is 0.5 %)."""
    rng = np.random.default_rng(1)
    t = np.arange(20_000)[:, None] / 500
    q, tau, sigma = np.sin(t * [1.0, 1.7]), 30 * np.cos(t * [1.0, 1.7]), np.array([0.3, 0.02])
    noise = rng.normal(size=(2, *tau.shape)) * sigma
    floor = noise_floor(q[7:], (tau + noise[0])[7:], q[:-7], (tau + noise[1])[:-7])
    np.testing.assert_allclose(floor, sigma / np.sqrt(2), rtol=0.05)


def test_short_repetitions():
    """Of twenty samples that differ by 0.2 N m, whatever the lag that is tried."""
    q = np.random.default_rng(2).normal(size=(20, 2)).cumsum(0)
    np.testing.assert_allclose(noise_floor(q, q + 0.2, q[3:], q[3:]), 0.1)
