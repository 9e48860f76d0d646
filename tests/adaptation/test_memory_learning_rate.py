"""The memory of learning rates: the rule in plain numpy, and a rate that was chosen far too low."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from invdyn_cli import experiment
from invdyn_cli.adaptation.error_model import ErrorModel
from invdyn_cli.adaptation.incremental import Incremental
from invdyn_cli.adaptation.memory_learning_rate import MemoryLearningRate
from invdyn_cli.errors import UsageError
from invdyn_cli.maths.metrics import nmse
from invdyn_cli.models.ffnn import Ffnn
from invdyn_cli.models.pest import Pest
from invdyn_cli.testing import check_adapter
from tests.sine_arm import sine_tasks

KEY = jax.random.key(0)
NET = Ffnn(hidden=(8,), joints=(), epochs=2)


def test_contract(data):
    """It keeps the contract of an adaptation, by itself and as the rule of an error model."""
    adapter = MemoryLearningRate(rate=16, batch_size=8)
    check_adapter(adapter, NET, data)
    check_adapter(ErrorModel(NET, incremental=adapter), ErrorModel(NET).extended(Pest()), data)


def test_rule_is_that_of_its_docstring():
    """Forty steps down a quadratic valley, weights, rates and gradients by loops in numpy: the same to 1e-9."""
    adapter = MemoryLearningRate(learning_rate=0.02, memory_rate=0.2, centres=10, highest=0.5)
    slopes = np.array([3.0, 0.4, 0.01])
    weights = {"w": jnp.array([1.0, -2.0, 5.0])}
    memory = adapter.memory(weights)
    own, log_rates, before = np.array([1.0, -2.0, 5.0]), np.full(10, np.log(0.02)), np.zeros(3)
    centres = np.linspace(-8, 1, 10)

    def activity(g: float) -> np.ndarray:
        return np.exp(-0.5 * (np.clip(np.log10(abs(g) + 1e-30), -8, 1) - centres) ** 2)

    for _ in range(40):
        weights, memory = adapter.step(weights, memory, {"w": slopes * weights["w"]}, jnp.asarray(0.02))
        g = slopes * own
        for k in range(10):
            share = np.array([activity(x)[k] for x in before])
            log_rates[k] += 0.2 * (share * np.sign(g) * np.sign(before)).sum() / share.sum()
        log_rates = np.clip(log_rates, np.log(1e-9), np.log(0.5))
        own = own - np.array([activity(x) @ np.exp(log_rates) / activity(x).sum() for x in g]) * g
        before = g
        np.testing.assert_allclose(weights["w"], own, atol=1e-9)
    assert np.abs(own[:2]).max() < 0.01


def test_without_memory_it_is_incremental(data):
    """With a memory_rate of zero it is adaptation=incremental."""
    fit = Incremental().fit(NET, data, KEY)
    said = [experiment.follow(one, NET, fit, data)[0] for one in (Incremental(), MemoryLearningRate(memory_rate=0.0))]
    np.testing.assert_allclose(said[1], said[0], atol=1e-4 * data.tau.std())


def test_recovers_from_a_rate_that_is_too_low():
    """Started at a thousandth of the usual learning rate, after a torque that rises by 3 N m, it leaves less than half
    of what that rate leaves without a memory over the second half."""
    train, test = sine_tasks()
    model = Ffnn(hidden=(32,), joints=(), epochs=60)
    moved = replace(test, trajectories=tuple(replace(x, tau=x.tau + 3) for x in test.trajectories))
    options: dict = {"learning_rate": 1e-5, "rate": 10, "batch_size": 10}
    fit = Incremental().fit(model, train, KEY)
    half = slice(moved.samples // 2, None)
    errors = []
    for adapter in (Incremental(**options), MemoryLearningRate(**options)):
        said, _ = experiment.follow(adapter, model, fit, moved)
        errors.append(nmse(moved.tau[half], said[half]).mean())
    assert errors[1] < 0.5 * errors[0]


def test_bad_options():
    """Options outside their ranges are refused by name."""
    each: list[dict] = [{"highest": 0.001}, {"memory_rate": -1.0}, {"centres": 1}, {"rate": 0}]
    for options in each:
        with pytest.raises(UsageError, match=f"{next(iter(options))}="):
            MemoryLearningRate(**options)
