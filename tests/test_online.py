"""The loop's functions: what comes in tick by tick is what `data.causal` and `experiment.follow` make of a log."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from scipy import signal

from invdyn_cli import experiment
from invdyn_cli.adaptation.incremental import Incremental
from invdyn_cli.adaptation.payload import Payload
from invdyn_cli.interfaces import AbstractAdapter, AbstractModel
from invdyn_cli.maths.signals import butterworth, differentiate, lowpass
from invdyn_cli.models.ffnn import Ffnn
from invdyn_cli.models.pest import Pest
from invdyn_cli.online import filtered, online
from invdyn_cli.types import Dataset, Motion, Trajectory
from tests.commands import usually
from tests.records import make_dataset, make_robot

RATE, CUTOFF = 200.0, 15.0
CASES = [
    (Incremental(rate=10, batch_size=5, epochs=1, learning_rate=1e-4), Ffnn(hidden=(8,), epochs=2, joints=())),
    (Payload(), Pest(friction="coulomb_viscous")),
]


@pytest.fixture(scope="module")
def log():
    """Noisy positions and torques (T, 2)."""
    t, draw = np.arange(400) / RATE, np.random.default_rng(0)
    q = np.sin(np.outer(t, [3.0, 5.0])) + 1e-4 * draw.normal(size=(400, 2))
    return q, np.cos(np.outer(t, [3.0, 4.0])) + 0.1 * draw.normal(size=(400, 2))


@pytest.mark.parametrize(("adapter", "model"), usually(CASES[:1], CASES))
def test_ticks_are_the_log(adapter: AbstractAdapter, model: AbstractModel, log):
    """The torque that is predicted for each measured state, and the state itself, are those of the whole log filtered
    forth, differenced backward, paired with the torque before, and followed."""
    q, tau = log
    learned = make_dataset(make_robot(("a", "b")), np.random.default_rng(1), samples=100)
    fit = adapter.fit(model, learned, jax.random.key(0))
    smooth = lowpass(q, RATE, CUTOFF, causal=True)
    qd = np.diff(smooth, axis=0, prepend=smooth[:1]) * RATE
    motion = Motion(smooth, qd, np.diff(qd, axis=0, prepend=0 * qd[:1]) * RATE)
    measured = lowpass(tau, RATE, CUTOFF, causal=True)
    rows = slice(1, None)
    whole = Dataset(
        (Trajectory("x", np.arange(399) / RATE, motion[rows], measured[:-1]),), learned.joints, learned.robot
    )
    said, _ = experiment.follow(adapter, model, fit, whole)

    loop = online(adapter, model, fit, rate=RATE, cutoff=CUTOFF)
    state, ticked = loop.init(q[0], tau[0]), []
    for k in range(1, len(q)):
        state, _ = loop.step(state, q[k], tau[k - 1], Motion(q[k], 0 * q[k], 0 * q[k]))
        ticked.append(np.asarray(state["said"]))
    np.testing.assert_allclose(ticked, said, rtol=1e-4, atol=1e-4 * np.abs(said).max())
    np.testing.assert_allclose(state["motion"].qdd, motion.qdd[-1], rtol=1e-6)


@pytest.mark.parametrize("order", [1, 2, 4, 5])
def test_the_recursion_is_scipys(order):
    """Sample by sample the sections give what scipy.signal.sosfilt gives of the whole, from rest at the first one."""
    x = np.cumsum(np.random.default_rng(0).normal(size=(400, 3)), axis=0)
    sections = butterworth(1000.0, 30.0, order)
    past = signal.sosfilt_zi(sections)[..., None] * x[0]
    _, said = jax.lax.scan(lambda memory, row: filtered(sections, memory, row)[::-1], jax.numpy.array(past), x)
    np.testing.assert_allclose(said, signal.sosfilt(sections, x, axis=0, zi=past)[0], rtol=0, atol=1e-9)


def test_it_gives_the_torque_of_the_motion_that_is_wanted(log):
    """The feedforward is the adapted model's torque for the wanted motion, not for the measured one."""
    adapter, model = CASES[0]
    learned = make_dataset(make_robot(("a", "b")), np.random.default_rng(1), samples=100)
    fit = adapter.fit(model, learned, jax.random.key(0))
    loop = online(adapter, model, fit, rate=RATE, cutoff=CUTOFF)
    wanted = Motion(np.array([0.3, -0.2]), np.array([1.0, 0.5]), np.zeros(2))
    state, torque = loop.step(loop.init(log[0][0], log[1][0]), log[0][1], log[1][0], wanted)
    known = replace(fit, params=state["adapter"]["params"])
    expected = model.predict(known, jax.tree.map(lambda x: x[None], wanted))[0]
    np.testing.assert_allclose(torque, expected, rtol=1e-5)


def test_backward_differences_are_the_logs(log):
    """`data.causal` differentiates as the loop does, but for the first sample."""
    qd = differentiate(log[0], RATE, method="backward")
    np.testing.assert_allclose(qd[1:], np.diff(log[0], axis=0) * RATE)


def test_a_cutoff_beyond_the_rate_is_refused():
    """A filter that cannot be is refused, with what can."""
    adapter, model = CASES[0]
    learned = make_dataset(make_robot(("a", "b")), np.random.default_rng(1), samples=100)
    fit = adapter.fit(model, learned, jax.random.key(0))
    with pytest.raises(ValueError, match="half the rate, 100 Hz"):
        online(adapter, model, fit, rate=200.0, cutoff=100.0)
