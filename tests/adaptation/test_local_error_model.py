"""The local error model: textbook Gaussian process regression on the window as the oracle, and a load it takes in."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from invdyn_cli import experiment
from invdyn_cli.adaptation.local_error_model import LocalErrorModel
from invdyn_cli.errors import UsageError
from invdyn_cli.maths.metrics import nmse
from invdyn_cli.models.pest import Pest
from invdyn_cli.testing import check_adapter
from tests.sine_arm import sine_tasks

KEY = jax.random.key(0)
PEST = Pest(friction="coulomb_viscous", offset=True)


def test_contract(data):
    """It keeps the contract of an adaptation."""
    check_adapter(LocalErrorModel(window=10, interval=3), PEST, data)


def test_regression_is_a_gaussian_process_on_the_window(data):
    """After 100 samples the local part is the posterior mean of a Gaussian process on the last ten that entered, by
    textbook algebra, and the offset is the error's running mean."""
    adapter = LocalErrorModel(window=10, interval=3, offset_rate=0.0)
    fit = adapter.fit(PEST, data, KEY)
    motion, tau = data.trajectories[0].motion, data.trajectories[0].tau
    learn = jax.jit(lambda s: adapter.learn(PEST, s, *jax.tree.map(jnp.asarray, (motion, tau))))
    state = learn(adapter.init(PEST, fit))
    spread = 0.5 * np.sqrt(6) * fit.details["local_scale"]
    x = (np.hstack([motion.q, motion.qd, motion.qdd]) - fit.details["local_mean"]) / spread
    errors = tau - PEST.predict(fit, motion)
    rows = np.arange(0, 100, 3)[-10:]

    def k(a, b):
        return np.exp(-0.5 * ((a[:, None] - b) ** 2).sum(-1))

    inverse = np.linalg.inv(k(x[rows], x[rows]) + 0.01 * np.eye(10))
    expected = PEST.predict(fit, motion) + k(x, x[rows]) @ inverse @ errors[rows]
    said = jax.vmap(lambda one: adapter.predict(PEST, state, one))(jax.tree.map(jnp.asarray, motion))
    np.testing.assert_allclose(said, expected, atol=1e-8)


def test_offset_alone_is_gradient_descent(data):
    """Without noise in the window's place (a window that never learns), a constant error of 2 N m falls by the
    offset_rate per sample."""
    adapter = LocalErrorModel(window=1, interval=10**6, noise=1e6, offset_rate=0.1)
    state = adapter.init(PEST, adapter.fit(PEST, data, KEY))
    one = jax.tree.map(lambda x: jnp.asarray(x[0]), data.motion)
    tau = adapter.predict(PEST, state, one) + 2.0
    for _ in range(5):
        state = adapter.update(PEST, state, one, tau)
    np.testing.assert_allclose(state["offset"], 2 * (1 - 0.9**5), rtol=1e-6)


def test_takes_in_a_change_that_depends_on_the_state():
    """A rigid body with 2 N m sin(q) more than it learned: both parts together leave less than half of the squared
    error of the offset alone, and less than a twentieth of the batch model's."""
    train, test = sine_tasks()
    moved = replace(test, trajectories=tuple(replace(x, tau=x.tau + 2 * np.sin(x.motion.q)) for x in test.trajectories))
    errors = []
    for window in (50, None):
        adapter = LocalErrorModel(interval=1) if window else LocalErrorModel(interval=10**6, noise=1e6)
        fit = adapter.fit(Pest(), train, KEY)
        errors.append(nmse(moved.tau, experiment.follow(adapter, Pest(), fit, moved)[0]).mean())
    batch = nmse(moved.tau, Pest().predict(fit, moved.motion)).mean()
    assert errors[0] < 0.5 * errors[1] and errors[0] < 0.05 * batch


def test_bad_options():
    """Options outside their ranges are refused by name."""
    for option, value in {"window": 0, "interval": 0, "width": 0.0, "noise": 0.0, "offset_rate": 2.0}.items():
        with pytest.raises(UsageError, match=f"adaptation.{option}={value}"):
            LocalErrorModel(**{option: value})
