"""Recursive least squares: batch least squares as the oracle, forgetting, and a load that a rigid body takes in."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

from invdyn_cli import experiment, store
from invdyn_cli.adaptation.rls import Rls
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.composition import EffectInstance
from invdyn_cli.effects.description import ExtendedModel
from invdyn_cli.errors import UsageError
from invdyn_cli.maths import rigid_body
from invdyn_cli.maths.metrics import nmse
from invdyn_cli.models.extended import Extended
from invdyn_cli.models.ffnn import Ffnn
from invdyn_cli.models.pest import Pest
from invdyn_cli.models.rff import Rff
from invdyn_cli.models.standard import Standard
from invdyn_cli.testing import check_adapter
from invdyn_cli.types import Dataset, Fit, Motion
from tests.records import make_dataset, make_robot
from tests.sine_arm import sine_tasks

KEY = jax.random.key(0)
RFF = Rff(frequencies=20, hyperparameter_samples=100, steps=5)
PEST = Pest(friction="coulomb_viscous", offset=True)


def diagnosed(tmp_path, robot, **found) -> Extended:
    """The extended_model.json of a robot with effects {name: (joint, parameters)}."""
    acting = tuple(EffectInstance(EFFECTS[name], joint, parameters) for name, (joint, parameters) in found.items())
    path = tmp_path / "extended_model.json"
    store.write_model(ExtendedModel(robot, acting), path)
    return Extended(path.read_text())


def test_contract(data):
    """It keeps the contract of an adaptation."""
    check_adapter(Rls(), RFF, data)


def batch(model, state, dataset: Dataset) -> np.ndarray:
    """All linear parameters by regularised least squares, from the prior that the state holds: the normal equations as
    a textbook has them, with columns by finite steps of one, which are exact where the torque is linear."""
    before, back = ravel_pytree(model.linear(state["params"]))

    def torque(numbers):
        params = model.with_linear(state["params"], back(numbers))
        return model.predict(fit_of(params, state, dataset), dataset.motion) / np.asarray(state["noise"])

    start = torque(before)
    columns = np.stack([torque(before + step) - start for step in np.eye(len(before))], axis=-1)
    errors = dataset.tau / np.asarray(state["noise"]) - start
    precision = np.linalg.inv(np.asarray(state["covariance"][0]))
    left = precision + np.einsum("tnp,tnq->pq", columns, columns)
    return np.asarray(before) + np.linalg.solve(left, np.einsum("tnp,tn->p", columns, errors))


def fit_of(params, state, dataset):
    return Fit(params, state["robot"], dataset.joints, 0)


def test_without_forgetting_it_is_batch_least_squares(tmp_path):
    """At forgetting 1 the parameters after 200 samples are those of least squares over all of them beside the prior,
    to 1e-8 of their sizes: friction and offsets of a diagnosed model with unit columns."""
    robot = make_robot(("a", "b"))
    found = {"viscous_friction": (0, {"damping": 0.4}), "torque_offset": (1, {"offset": 0.3})}
    model = diagnosed(tmp_path, robot, **found, joint_spring=(1, {"stiffness": 2.0, "rest": 0.0}))
    model = _Linear(model.text)
    data = make_dataset(robot, np.random.default_rng(1), samples=100)
    adapter = Rls(forgetting=1.0)
    start = adapter.init(model, adapter.fit(model, data, KEY))
    expected = batch(model, start, data)
    motion, tau = jax.tree.map(jnp.asarray, (data.motion, data.tau))
    end = jax.jit(lambda s: adapter.learn(model, s, motion, tau))(start)
    found = np.asarray(ravel_pytree(model.linear(end["params"]))[0])
    np.testing.assert_allclose(found, expected, rtol=1e-8)
    assert np.abs(found - np.asarray(ravel_pytree(model.linear(start["params"]))[0])).max() > 0.1


class _Linear(Extended):
    """The diagnosed model without its spring's rest, in which the torque is not linear beside the stiffness."""

    def linear(self, params):
        return {name: {k: v for k, v in one.items() if k != "rest"} for name, one in params.items()}

    def with_linear(self, params, linear):
        return {name: {**one, **linear[name]} for name, one in params.items()}


def test_joint_by_joint_it_is_batch_least_squares(data):
    """The same for random features, whose covariance has a block for every joint."""
    adapter = Rls(forgetting=1.0, memory=50)
    fit = adapter.fit(RFF, data, KEY)
    state = adapter.init(RFF, fit)
    moved = replace(data, trajectories=tuple(replace(x, tau=x.tau + 5 * np.sin(x.motion.q)) for x in data.trajectories))
    motion, tau = jax.tree.map(jnp.asarray, (moved.motion, moved.tau))
    end = jax.jit(lambda s: adapter.learn(RFF, s, motion, tau))(state)
    basis = np.eye(40)
    zero = {**fit.params, "weights": np.zeros((2, 40)), "target_mean": np.zeros(2)}
    columns = np.stack(
        [RFF.predict(replace(fit, params={**zero, "weights": np.tile(one, (2, 1))}), data.motion) for one in basis], -1
    )
    for j in range(2):
        rows = columns[:, j] / state["noise"][j]
        target = (moved.tau - fit.params["target_mean"])[:, j] / state["noise"][j]
        precision = np.linalg.inv(np.asarray(state["covariance"][j]))
        left = precision + rows.T @ rows
        expected = np.linalg.solve(left, precision @ fit.params["weights"][j] + rows.T @ target)
        np.testing.assert_allclose(end["params"]["weights"][j], expected, rtol=1e-6, atol=1e-8)


def loaded(data: Dataset, mass: float, step: int = 1) -> Dataset:
    """The torques of the same motion with a point mass 10 cm behind the last joint."""
    robot = data.robot
    assert robot is not None
    heavy = np.array(robot.inertial)
    heavy[-1] += [mass, 0.1 * mass, 0.0, 0.0, 0.0, 0.0, 0.01 * mass, 0.0, 0.0, 0.01 * mass]
    more = replace(robot, inertial=heavy)

    def torque(motion: Motion) -> np.ndarray:
        return np.asarray(rigid_body.inverse_dynamics(more, more.inertial, motion.q.T, motion.qd.T, motion.qdd.T)).T

    return replace(data, trajectories=tuple(replace(x, tau=torque(x.motion)) for x in data.trajectories))


@pytest.mark.parametrize("model", [Pest(), Standard(share=0.1)], ids=["pest", "standard"])
def test_takes_in_a_load(model):
    """A rigid body that picks up 2 kg: after half a trajectory (110 samples) it predicts the rest with less than 1 % of
    the error of the batch model, which stays wrong. Its training torques have noise of 0.01 N m."""
    train, test = sine_tasks()
    adapter = Rls(memory=1.0)
    rng = np.random.default_rng(0)
    noisy = (replace(x, tau=x.tau + 0.01 * rng.normal(size=x.tau.shape)) for x in train.trajectories)
    fit = adapter.fit(model, replace(train, trajectories=tuple(noisy)), KEY)
    heavy = loaded(test, 2.0)
    said, trace = experiment.follow(adapter, model, fit, heavy)
    rest = slice(heavy.samples // 4, None)
    batch_error = nmse(heavy.tau[rest], model.predict(fit, heavy.motion)[rest])
    assert (nmse(heavy.tau[rest], said[rest]) < 0.01 * batch_error).all()
    assert np.isfinite(trace["certainty"]).all() and (trace["certainty"] > -1e-6).all()


def test_a_diagnosed_model_follows_its_friction(tmp_path):
    """A diagnosed joint whose Coulomb friction rises from 2 to 3 N m: the parameter follows, to 0.05 N m."""
    train, test = sine_tasks()
    model = diagnosed(tmp_path, train.robot, coulomb_friction=(1, {"coulomb": 2.0}))
    worn = diagnosed(tmp_path, train.robot, coulomb_friction=(1, {"coulomb": 3.0}))

    def measured(one: Extended, data: Dataset) -> Dataset:
        fit = one.fit(data, KEY)
        return replace(data, trajectories=tuple(replace(x, tau=one.predict(fit, x.motion)) for x in data.trajectories))

    adapter = Rls(forgetting=0.98)
    fit = adapter.fit(model, measured(model, train), KEY)
    data = measured(worn, test)
    motion, tau = jax.tree.map(jnp.asarray, (data.motion, data.tau))
    end = jax.jit(lambda s: adapter.learn(model, s, motion, tau))(adapter.init(model, fit))
    assert float(end["params"]["0_coulomb_friction"]["coulomb"]) == pytest.approx(3.0, abs=0.05)


def test_forgetting_stops_where_nothing_is_excited(data):
    """Three thousand samples at one posture: the covariance stays within the prior's, the torque finite."""
    adapter = Rls(forgetting=0.9)
    state = adapter.init(PEST, adapter.fit(PEST, data, KEY))
    one = jax.tree.map(lambda x: jnp.asarray(x[0]), data.motion)

    @jax.jit
    def rest(state):
        return jax.lax.scan(lambda s, _: (adapter.update(PEST, s, one, data.tau[0]), None), state, None, 3000)[0]

    end = rest(state)
    assert float(adapter.trace(end)["certainty"]) > -1e-6
    np.testing.assert_allclose(adapter.predict(PEST, end, one), data.tau[0], rtol=1e-3)


def test_refuses_a_net_and_bad_options(data):
    """A net has no linear parameters, and forgetting is a share: said in a line."""
    with pytest.raises(UsageError, match="Ffnn has no linear parameters"):
        Rls().fit(Ffnn(), data, KEY)
    for options in ({"forgetting": 0.0}, {"forgetting": 1.1}, {"memory": -1.0}):
        with pytest.raises(UsageError, match=r"adaptation\.(forgetting|memory)="):
            Rls(**options)
