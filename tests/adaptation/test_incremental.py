"""Nets that go on learning: the delta rule, blocks and samples, what is moved and what stays."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from invdyn_cli import experiment
from invdyn_cli.adaptation.error_model import ErrorModel
from invdyn_cli.adaptation.incremental import Incremental
from invdyn_cli.errors import UsageError
from invdyn_cli.interfaces import AbstractModel
from invdyn_cli.models.ffnn import Ffnn
from invdyn_cli.models.pest import Pest
from invdyn_cli.testing import check_adapter
from invdyn_cli.types import Fit
from tests.records import make_dataset, make_robot

KEY = jax.random.key(0)
NET = Ffnn(hidden=(8,), epochs=3, joints=())


@dataclass(frozen=True)
class Linear(AbstractModel):
    """tau = w q, a weight per joint: what the delta rule was written for."""

    needs_robot = False

    def init(self, dataset, key):
        return {"w": jnp.zeros(len(dataset.joints))}

    def apply(self, params, motion, robot):
        return params["w"] * motion.q

    def fit(self, dataset, key, *, validation=None, progress=None):
        return Fit(self.init(dataset, key), dataset.robot, dataset.joints, len(dataset.joints))

    def weights(self, params):
        return params["w"]

    def with_weights(self, params, weights):
        return {"w": weights}


@pytest.fixture
def data():
    return make_dataset(make_robot(("a", "b")), np.random.default_rng(0), samples=150)


@pytest.mark.parametrize(
    "adapter", [Incremental(rate=20, batch_size=8, epochs=2), ErrorModel(NET, incremental=Incremental(rate=7))]
)
def test_contract(adapter, data):
    """Both keep the contract of an adaptation, for the model that they extend."""
    check_adapter(adapter, adapter.extended(NET), data)


def test_one_step_is_the_delta_rule(data):
    """With one batch of all samples and one epoch, w moves by 2 rate mean(error q) / scale^2 (Widrow and Hoff)."""
    adapter = Incremental(rate=50, batch_size=50, epochs=1, learning_rate=0.1)
    state = adapter.init(Linear(), adapter.fit(Linear(), data, KEY))
    motion, tau = data.motion[slice(0, 50)], data.tau[:50]
    moved = adapter.learn(Linear(), state, motion, tau)["params"]["w"]
    expected = 0.1 * 2 * np.mean(tau * motion.q, axis=0) / data.tau.std(0) ** 2
    np.testing.assert_allclose(moved, expected, rtol=1e-9)


@pytest.mark.parametrize(
    "adapter",
    [Incremental(rate=40), ErrorModel(NET, incremental=Incremental(rate=40)), Incremental(rate=1000)],
    ids=["incremental", "error_model", "none is full"],
)
def test_blocks_are_samples(adapter, data):
    """A log that is followed in blocks, with a rest that fills none, is predicted as sample by sample; so is one that
    is shorter than a block."""
    model = adapter.extended(NET)
    fit = adapter.fit(model, data, KEY)
    said, _ = experiment.follow(adapter, model, fit, data)
    step = jax.jit(lambda s, m, t: (adapter.update(model, s, m, t), adapter.predict(model, s, m)))
    state, motion, tau = adapter.init(model, fit), data.motion, data.tau
    looped = []
    for k in range(len(tau)):
        state, one = step(state, jax.tree.map(lambda x, k=k: x[k], motion), tau[k])
        looped.append(one)
    np.testing.assert_allclose(said, looped, atol=1e-4 * data.tau.std())  # the nets are single precision
    assert len(tau) % adapter.block


def test_it_follows_what_changes(data):
    """A torque that is 3 N m more than was learned is followed: in the last half of the log the adapted model errs by
    less than a third of what the fitted one does."""
    changed = replace(data, trajectories=tuple(replace(x, tau=x.tau + 3.0) for x in data.trajectories * 4))
    adapter = Incremental(rate=20, batch_size=10, epochs=5, learning_rate=0.02)
    model = replace(NET, epochs=30)
    fit = adapter.fit(model, data, KEY)
    late = slice(changed.samples // 2, None)
    error = [
        np.abs(said[late] - changed.tau[late]).mean()
        for said in (experiment.follow(adapter, model, fit, changed)[0], experiment.predict(model, fit, changed))
    ]
    assert error[0] < error[1] / 3


def test_an_error_model_leaves_its_base_alone(data):
    """Only the learner moves; frozen, nothing does, and it is the model and the pretrained learner."""
    robot = data.robot
    adapter = ErrorModel(NET, incremental=Incremental(rate=20))
    model = adapter.extended(Pest())
    fit = adapter.fit(model, data, KEY)
    start = adapter.init(model, fit)
    after = adapter.learn(model, start, data.motion[slice(0, 20)], data.tau[:20])
    for part, moves in (("base", False), ("learner", True)):
        same = [
            np.array_equal(*pair)
            for pair in zip(*(jax.tree.leaves(x["params"][part]) for x in (start, after)), strict=True)
        ]
        assert not all(same) if moves else all(same)
    frozen = replace(adapter, adapted=False)
    assert not frozen.adapts and robot is not None
    np.testing.assert_allclose(
        experiment.follow(frozen, model, fit, data)[0], experiment.predict(model, fit, data), atol=1e-4
    )


def test_a_model_without_weights_is_refused(data):
    """PEST has no weights that steps could move, be it the model or a learner: that is said in one line, before
    anything is fitted, with models that have some and no place that it may not be in."""
    with pytest.raises(UsageError, match="no weights") as model:
        Incremental().fit(Pest(), data, KEY)
    adapter = ErrorModel(Pest())
    with pytest.raises(UsageError, match="no weights") as learner:
        adapter.fit(adapter.extended(Pest()), data, KEY)
    assert str(model.value) == str(learner.value)
    assert "ffnn_deep" in str(model.value) and "model=" not in str(model.value)


@pytest.mark.parametrize(("name", "value"), [("rate", 0), ("batch_size", 0), ("epochs", 0), ("learning_rate", 0.0)])
def test_wrong_options(name, value):
    """What is out of range is named with what is allowed, but no place: adaptation, or adaptation.incremental."""
    with pytest.raises(UsageError, match=f"^{name}={value}; allowed: "):
        Incremental(**{name: value})
