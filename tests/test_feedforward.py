"""What a loop learns from is what a log would give it: the same filter, the same derivatives, nothing ahead."""

import jax
import numpy as np
import pytest
from scipy import signal

from invdyn_cli.adaptation.batch import Batch
from invdyn_cli.feedforward import Adapting, filtered, resting
from invdyn_cli.interfaces import AbstractAdapter
from invdyn_cli.maths.signals import butterworth, differentiate, lowpass
from invdyn_cli.models.pest import Pest
from invdyn_cli.types import Fit, Motion

RATE, N = 1000.0, 2


def walk(seed: int, columns: int) -> np.ndarray:
    """(T, columns) that wander."""
    return np.cumsum(np.random.default_rng(seed).normal(size=(400, columns)), axis=0)


@pytest.mark.parametrize("order", [1, 2, 4, 5])
def test_recursion_is_scipys(order):
    """Sample by sample the sections give what scipy.signal.sosfilt gives of the whole, from rest at the first one."""
    x, sections = walk(0, 3), butterworth(RATE, 30.0, order)
    past = signal.sosfilt_zi(sections)[..., None] * x[0]
    _, said = jax.lax.scan(lambda memory, row: filtered(sections, memory, row), resting(sections, x[0]), x)
    np.testing.assert_allclose(said, signal.sosfilt(sections, x, axis=0, zi=past)[0], rtol=0, atol=1e-9)


class Recorder(AbstractAdapter):
    """Keeps the last sample that it was given."""

    fit = Batch.fit

    def init(self, model, fit):
        zero = np.zeros(N)
        return Motion(zero, zero, zero), zero

    def predict(self, model, state, motion):
        return motion.q

    def update(self, model, state, motion, tau):
        return motion, tau


@pytest.mark.parametrize("cutoff", [10.0, None])
def test_learns_from_what_a_causal_log_has(cutoff):
    """Angles, torques, and both derivatives are those of `lowpass(causal=True)` and backward differences on the log."""
    q, tau = walk(1, N), walk(2, N)
    adapting = Adapting(Recorder(), Pest(), Fit({}, None, ("a", "b"), 0), RATE, cutoff, 4)
    state, given = adapting.init(q[0], tau[0]), []
    for row in zip(q, tau, strict=True):
        state, _ = adapting.step(state, *row, Motion(q[0], q[0], q[0]))
        given.append(state["adapter"])
    smooth, torque = (x if cutoff is None else lowpass(x, RATE, cutoff, 4, causal=True) for x in (q, tau))
    qd = differentiate(smooth, RATE, method="backward")
    qdd = differentiate(qd, RATE, method="backward")
    for said, expected in (
        ([x[0].q for x in given], smooth),
        ([x[0].qd for x in given], qd),
        ([x[0].qdd for x in given], qdd),
        ([x[1] for x in given], torque),
    ):
        scale = np.abs(expected).max()
        np.testing.assert_allclose(np.array(said)[3:] / scale, expected[3:] / scale, rtol=0, atol=1e-7)
