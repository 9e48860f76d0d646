"""What lies between the logged torque and the joint: signs, times, and the way back."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import signal

from invdyn_cli.effects.actuator import shifted
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.interfaces import AbstractChannelEffect
from tests.effects.drawn import named, parameters

NAMES = named(AbstractChannelEffect)
RATE = 500.0
T = np.arange(3000) / RATE
INSIDE = slice(300, -300)
"""Half a second off either end: ten time constants."""


def tone(t: np.ndarray) -> np.ndarray:
    """Up to 3 Hz, 2.5 at most."""
    return 1.5 * np.sin(2 * np.pi * 0.7 * t + 0.3) + np.sin(2 * np.pi * 3 * t)


@pytest.mark.parametrize("name", [n for n in NAMES if n != "torque_saturation"])
def test_there_and_back(name):
    """What was logged comes back from what was delivered: a gain to rounding, a delay to the spline's 1e-6, a lag to
    1e-3 (its slope is a central difference: (2 pi 3 Hz / 500 Hz)^2 / 6 of it)."""
    effect = EFFECTS[name]
    for seed in range(5):
        given = parameters(name, np.random.default_rng(seed))
        back = effect.logged(given, effect.delivered(given, tone(T), RATE), RATE)
        error = {"torque_gain_error": 1e-14, "torque_gain_change": 1e-14, "torque_delay": 1e-6, "actuator_lag": 1e-3}[
            name
        ]
        assert np.abs(back - tone(T))[INSIDE].max() < 3 * error


@pytest.mark.parametrize("name", NAMES)
def test_numpy_and_jax_agree(name):
    """Either way is the same of numpy and jax arrays, to rounding."""
    given = parameters(name, np.random.default_rng(0))
    for way in (EFFECTS[name].delivered, EFFECTS[name].logged):
        np.testing.assert_allclose(way(given, jnp.asarray(tone(T)), RATE), way(given, tone(T), RATE), atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_trials_are_within_bounds(name):
    """Every trial gives all parameters, none that the effect itself refuses."""
    effect = EFFECTS[name]
    trials = effect.shapes(tone(T), RATE)
    assert len(trials) > 0
    assert all(set(x) == set(effect.parameters) and not effect.refuse(x) for x in trials)


def test_a_gain_scales_what_arrives():
    """delivered = gain x logged."""
    np.testing.assert_allclose(EFFECTS["torque_gain_error"].delivered({"gain": 0.8}, tone(T), RATE), 0.8 * tone(T))


@pytest.mark.parametrize("delay", [0.0, 0.004, 0.0107, 0.05, -0.0107])
def test_a_delay_comes_later(delay):
    """delivered(t) = logged(t - delay), whole samples or not, to 1e-6 of the signal."""
    delivered = EFFECTS["torque_delay"].delivered({"delay": delay}, tone(T), RATE)
    assert np.abs(delivered - tone(T - delay))[INSIDE].max() < 2e-6


def test_shifted_by_whole_samples():
    """shifted(x, 1)[i] is x[i + 1], and the last value goes on."""
    x = tone(T)
    np.testing.assert_allclose(shifted(x, 1), np.append(x[1:], x[-1]), atol=1e-12)


@pytest.mark.parametrize("time_constant", [0.0005, 0.003, 0.02, 0.2])
def test_a_lag_is_exact_on_straight_lines(time_constant):
    """Of a torque that runs in straight lines between samples, from rest: SciPy's lsim, which is exact there too."""
    draw = np.random.default_rng(0)
    lines = np.interp(T, T[::25], draw.normal(size=len(T[::25])))
    lines[:50] = lines[0]
    system = signal.lti([1], [time_constant, 1])
    (_, wanted, _) = signal.lsim(system, lines - lines[0], T)
    got = EFFECTS["actuator_lag"].delivered({"time_constant": time_constant}, lines, RATE)
    np.testing.assert_allclose(got, wanted + lines[0], atol=1e-10)


def test_no_lag_changes_nothing():
    """A time constant of zero delivers what was logged."""
    assert np.array_equal(EFFECTS["actuator_lag"].delivered({"time_constant": 0.0}, tone(T), RATE), tone(T))


def test_a_saturation_clips():
    """delivered = clip(logged, +-limit), below the limit nothing changes, and twice is once."""
    effect, limit = EFFECTS["torque_saturation"], {"limit": 1.2}
    once = effect.delivered(limit, tone(T), RATE)
    assert once.max() == 1.2 and once.min() == -1.2
    free = np.abs(tone(T)) <= 1.2
    assert np.array_equal(once[free], tone(T)[free])
    assert np.array_equal(effect.delivered(limit, once, RATE), once)


def test_limits_are_tried_where_they_would_cut():
    """Each tried limit cuts the share of samples that it is there for."""
    effect = EFFECTS["torque_saturation"]
    for shape, share in zip(effect.shapes(tone(T), RATE), effect.shares, strict=True):
        assert np.mean(np.abs(tone(T)) > shape["limit"]) == pytest.approx(share, abs=0.002)
