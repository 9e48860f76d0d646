"""Residual tests: noise passes them, whatever its colour; what goes with something fails the test of it."""

import numpy as np
import pytest
from scipy.signal import lfilter

from invdyn_cli.diagnosis.residual_tests import residual_tests, structured
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.composition import EffectInstance

LOUD = 0.05
"""RMS of the noise, in RMS torques of each joint."""


def noise(evidence, seed: int, memory: float = 0.0) -> np.ndarray:
    """(R, n) autoregressive noise of this coefficient, louder where the arm is faster."""
    draw = np.random.default_rng(seed)
    e = lfilter([1.0], [1.0, -memory], draw.normal(size=evidence.tau.shape), axis=0)
    e *= (1 + np.abs(evidence.on_rows("qd"))) * LOUD * np.sqrt(np.mean(evidence.tau**2, axis=0))
    return e - e.mean(0)


@pytest.mark.parametrize("memory", [0.0, 0.9])
def test_noise_passes(evidence, memory):
    """One log of noise in a hundred may fail a test: of twelve not more than one does (two: 0.6 %)."""
    failed = [not all(x.passed for x in residual_tests(evidence, noise(evidence, k, memory))) for k in range(12)]
    assert sum(failed) <= 1


def term(evidence, against: str, j: int) -> np.ndarray:
    """(R,) what goes with one thing."""
    q, qd, qdd = (evidence.on_rows(name) for name in ("q", "qd", "qdd"))
    load, t = evidence.nominal[:, j], evidence.on_rows("t")
    turned = np.flatnonzero(np.diff(np.sign(qd[:, j])) != 0) + 1
    pulses = np.zeros(len(t))
    for k in turned:
        pulses += np.sign(qd[min(k, len(t) - 1), j]) * ((t >= t[k]) & (t < t[k] + 0.1))
    return {
        "level": np.ones(len(t)),
        "velocity": np.sign(qd[:, j]) * np.exp(-np.abs(qd[:, j]) / np.abs(qd[:, j]).mean()),
        "angle": np.tanh(5 * (q[:, j] - q[:, j].mean())),
        "ripple": np.sin(23.0 * q[:, j]),
        "load": np.abs(load) * np.sign(qd[:, j]),
        "acceleration": qdd[:, j],
        "torque_slope": np.gradient(load, t),
        "reversals": pulses,
        "neighbours": qdd[:, 1 if j != 1 else 0],
        "time": t - t.mean(),
    }[against]


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("against", ["level", "velocity", "angle", "ripple", "load", "acceleration", "torque_slope",
                                     "reversals", "neighbours", "time"])  # fmt: skip
def test_what_goes_with_something_fails_its_test(evidence, against, seed):
    """A term of half the noise's RMS fails the test that it belongs to, and the share that the test tells is at
    least half of what was put in; the other joints pass."""
    j = int(np.random.default_rng(seed).integers(evidence.dofs))
    residual = noise(evidence, seed, 0.5)
    own = term(evidence, against, j)
    own *= 0.5 * np.sqrt(np.mean(residual[:, j] ** 2) / np.mean(own**2))
    residual[:, j] += own
    tests = residual_tests(evidence, residual, EFFECTS.values())
    failed = {x.against: x for x in tests if x.joint == evidence.robot.joints[j] and not x.passed}
    assert against in failed
    used = evidence.valid[:, j]
    assert failed[against].torque > 0.5 * np.sqrt(np.mean(own[used] ** 2))
    assert against == "neighbours" or failed[against].points_at or against == "load_zeros"
    assert np.count_nonzero(structured(tests, evidence.robot.joints)) == 1


def test_what_is_in_the_model_is_not_pointed_at(evidence):
    """A test points at effects that show so, but for those that the model has on this joint."""
    residual = noise(evidence, 0)
    there = [EffectInstance(EFFECTS["viscous_friction"], 0, {"damping": 1.0})]
    tests = residual_tests(evidence, residual, EFFECTS.values(), there)
    first, second = (x.points_at for x in tests if x.against == "velocity" and x.joint in evidence.robot.joints[:2])
    assert set(second) - set(first) == {"viscous_friction"}


def test_what_is_tiny_passes(evidence):
    """What is sure but worth a thousandth of the joint's torque fails nothing: clocks and filters leave as much."""
    residual = 1e-6 * noise(evidence, 0)
    residual[:, 0] += 1e-3 * evidence.nominal[:, 0]
    tests = residual_tests(evidence, residual)
    assert all(x.passed for x in tests) and min(x.p for x in tests) < 1e-6


def test_a_short_log_is_not_tested(evidence):
    """Where too few stretches are left of a joint, no test is claimed to have been done."""
    few = np.arange(len(evidence.tau)) < 100
    some = type(evidence)(**{**vars(evidence), "valid": evidence.valid & few[:, None]})
    assert residual_tests(some, noise(evidence, 0)) == ()
