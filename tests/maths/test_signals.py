"""Derivatives and filters: exact where theory says so, and refused where they have no meaning."""

import numpy as np
import pytest
from scipy import signal

from invdyn_cli.maths import signals

RATE = 100.0
T = np.arange(400) / RATE


def polynomial(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """x and dx/dt (T, 2) of two polynomials of this degree."""
    factors = np.random.default_rng(degree).normal(size=(2, degree + 1))
    x = np.stack([np.polyval(f, T) for f in factors], axis=1)
    return x, np.stack([np.polyval(np.polyder(f), T) for f in factors], axis=1)


@pytest.mark.parametrize(
    ("method", "degree", "inside"),
    [("backward", 1, False), ("central", 1, False), ("central", 2, True), ("savgol", 2, False), ("savgol", 3, False)],
)
def test_derivatives_are_exact_on_polynomials(method, degree, inside):
    """Backward is exact on lines, central on parabolas (lines at the ends), savgol up to its degree, ends included."""
    x, slope = polynomial(degree)
    found = signals.differentiate(x, RATE, method=method, window=11, order=degree)
    part = slice(1, -1) if inside else slice(None)
    np.testing.assert_allclose(found[part], slope[part], atol=1e-10 * np.abs(x).max() * RATE)


def test_no_method_is_better_than_its_degree():
    """One degree more and the error is the theory's: backward h x'' / 2, central h^2 x''' / 6, savgol above that."""
    x, h = T**2, 1 / RATE
    np.testing.assert_allclose(signals.differentiate(x, RATE, method="backward")[1:] - 2 * T[1:], -h, rtol=1e-6)
    x = T**3
    np.testing.assert_allclose(signals.differentiate(x, RATE)[1:-1] - 3 * T[1:-1] ** 2, h**2, rtol=1e-5)
    savgol = signals.differentiate(x, RATE, method="savgol", window=11, order=2)[5:-5] - 3 * T[5:-5] ** 2
    assert (savgol > h**2).all()


@pytest.mark.parametrize("method", signals.DERIVATIVES)
def test_derivatives_keep_the_shape(method):
    """(T,), (T, n) and (T, n, m) come back in their shape, every column as if it were alone."""
    x = np.random.default_rng(0).normal(size=(50, 2, 3))
    found = signals.differentiate(x, RATE, method=method, window=5)
    assert found.shape == x.shape
    np.testing.assert_allclose(signals.differentiate(x[:, 1, 2], RATE, method=method, window=5), found[:, 1, 2])


@pytest.mark.parametrize(
    ("options", "words"),
    [({"method": "spline"}, "'spline'; allowed: backward, central, savgol"), ({"window": 401}, "400 samples; .* 401")],
)
def test_derivatives_refuse(options, words):
    """An unknown method and too few samples are refused with what is allowed."""
    with pytest.raises(ValueError, match=words):
        signals.differentiate(T, RATE, **options)


def test_lowpass_has_unit_gain_at_rest():
    """A constant passes unchanged from end to end; a line up to 1 % of its change while the filter settles."""
    np.testing.assert_allclose(signals.lowpass(np.full(400, 3.0), RATE, 10.0), 3.0, atol=1e-9)
    settles = signals.settling(RATE, 10.0) / RATE
    np.testing.assert_allclose(signals.lowpass(2 - 5 * T, RATE, 10.0), 2 - 5 * T, atol=0.01 * 5 * settles)


@pytest.mark.parametrize("order", [1, 2, 4])
def test_lowpass_halves_at_its_cutoff_without_phase(order):
    """A sine at the cut-off comes out at half its size (-6 dB) and in phase; one at a tenth of it nearly untouched."""
    t = np.arange(4000) / RATE
    middle = slice(1000, -1000)  # 20 periods at either end: far beyond `settling`
    for frequency, gain in ((5.0, 0.5), (0.5, 1 / (1 + 0.1 ** (2 * order)))):
        wave = np.exp(2j * np.pi * frequency * t)
        real, imaginary = (signals.lowpass(x, RATE, 5.0, order) for x in (wave.real, wave.imag))
        ratio = np.mean((real + 1j * imaginary)[middle] / wave[middle])
        warped = 2e-2 if frequency < 5 else 1e-6  # the bilinear transform bends frequencies away from the cut-off
        assert ratio.real == pytest.approx(gain, rel=warped) and abs(ratio.imag) < 1e-6


def test_signals_that_pass_together_come_out_as_alone():
    """Whatever shapes and lengths pass the filter together, each leaves it as SciPy's filtfilt would leave it."""
    draw, padding = np.random.default_rng(2), signals.settling(RATE, 8.0)
    shapes = [(3, 2, 400), (900,), (0, 500), (2, 433), (padding + 1,), (5, 3000), (4, 70_000)]
    parts = [np.cumsum(draw.normal(size=shape), axis=-1) for shape in shapes]
    sections = signal.butter(4, 8.0, fs=RATE, output="sos")
    for x, made in zip(parts, signals.lowpass_each(parts, RATE, 8.0), strict=True):
        alone = signal.sosfiltfilt(sections, x, padlen=padding) if x.size else x
        np.testing.assert_allclose(made, alone, atol=1e-12 * max(np.abs(x).max(initial=0), 1))
    with pytest.raises(ValueError, match="needs more than"):
        signals.lowpass_each([*parts, np.zeros(padding)], RATE, 8.0)


def test_lowpass_looks_both_ways():
    """Filtering a reversed signal is reversing the filtered one; the filter prefers no direction of time."""
    x = np.cumsum(np.random.default_rng(0).normal(size=2000))
    there, back = signals.lowpass(x, RATE, 8.0), signals.lowpass(x[::-1], RATE, 8.0)[::-1]
    np.testing.assert_allclose(there[200:-200], back[200:-200], atol=1e-6 * np.abs(x).max())


def test_lowpass_is_linear():
    """The filter of a sum is the sum of the filtered, in every column."""
    x, y = np.random.default_rng(1).normal(size=(2, 400, 3))
    mixed = signals.lowpass(2 * x - 3 * y, RATE, 8.0)
    np.testing.assert_allclose(mixed, 2 * signals.lowpass(x, RATE, 8.0) - 3 * signals.lowpass(y, RATE, 8.0), atol=1e-12)


def test_settling_is_when_one_percent_is_left():
    """A first-order low-pass (one pole) is within 1 % of a step after `settling` samples, and not one sample before."""
    samples = signals.settling(RATE, 2.0, 1)
    response = signal.lfilter(*signal.butter(1, 2.0, fs=RATE), np.ones(2 * samples))
    left = (1 - response) / (1 - response[0])  # as a share of what is left after the first sample
    assert left[samples] <= 0.01 < left[samples - 1]


@pytest.mark.parametrize(
    ("cutoff", "order", "words"),
    [(0.0, 4, "0 Hz; allowed: above 0"), (50.0, 4, "below half the rate, 50 Hz"), (5.0, 0, "order 0; allowed: 1")],
)
def test_lowpass_refuses(cutoff, order, words):
    """Cut-offs at zero or at half the rate, and an order below 1, are refused; so is a signal that is too short."""
    with pytest.raises(ValueError, match=words):
        signals.lowpass(T, RATE, cutoff, order)
    with pytest.raises(ValueError, match=f"10 samples at {RATE:g} Hz; a low-pass at 5 Hz needs more than"):
        signals.lowpass(T[:10], RATE, 5.0)


def test_resampling_is_linear_in_between():
    """Samples of lines at random times give the lines on every tick, from the first sample to the last one's."""
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.uniform(0.002, 0.02, 300)) + 5
    ticks, x = signals.resample(t, np.stack([2 * t + 1, -t], axis=1), RATE)
    np.testing.assert_allclose(ticks, t[0] + np.arange(len(ticks)) / RATE)
    assert ticks[-1] <= t[-1] < ticks[-1] + 1 / RATE
    np.testing.assert_allclose(x, np.stack([2 * ticks + 1, -ticks], axis=1), atol=1e-12)


def test_resampling_leaves_ticks_alone():
    """Samples that tick at the rate already come back as the same arrays."""
    x = np.random.default_rng(0).normal(size=400)
    ticks, same = signals.resample(T, x, RATE)
    assert ticks is T and same is x
