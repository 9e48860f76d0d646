"""GIP: the kernel against its explicit features, the polynomials that it spans, and how few samples it needs."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from invdyn_cli.errors import UsageError
from invdyn_cli.models.gip import Gip, kernel
from invdyn_cli.models.gpr import Gpr
from invdyn_cli.testing import check_model
from invdyn_cli.types import Motion
from tests.records import make_dataset, make_robot
from tests.sine_arm import error, rubbed, sine_tasks

KEY = jax.random.key(0)
SMALL = Gip(hyperparameter_samples=60, steps=10)
UNIT = {"input_scale": np.ones(6)}


def test_contract():
    """It keeps the contract of a model, of an arm with a joint that slides too."""
    robot = make_robot(("a", "b"), (False, True))
    check_model(SMALL, make_dataset(robot, np.random.default_rng(0), samples=60))


def explicit(hyper: dict, motion: Motion) -> np.ndarray:
    """Features (N, F) of two revolute joints whose inner products are the kernel, one monomial each."""
    weight = {name: np.exp(value) for name, value in hyper.items()}
    one = np.ones(len(motion.q))
    outer = [np.sqrt(weight["constant"]) * one]
    outer += [np.sqrt(weight["acceleration"][i]) * motion.qdd[:, i] for i in range(2)]
    outer += [
        np.sqrt(weight["velocity"][i, j]) * motion.qd[:, i] * motion.qd[:, j]
        for i, j in itertools.combinations_with_replacement(range(2), 2)
    ]
    factors = [outer]
    for joint, s in itertools.product(range(2), range(2)):
        cosine = np.sqrt(weight["cosine"][s, joint]) * np.cos(motion.q[:, joint])
        factors.append([one, cosine, np.sqrt(weight["sine"][s, joint]) * np.sin(motion.q[:, joint])])
    products = [np.prod(parts, axis=0) for parts in itertools.product(*factors)]
    friction = [np.sqrt(weight["viscous"][i]) * motion.qd[:, i] for i in range(2)]
    friction += [np.sqrt(weight["coulomb"][i]) * np.clip(motion.qd[:, i] / 0.02, -1, 1) for i in range(2)]
    return np.stack(products + friction, axis=1)


def test_kernel_is_the_inner_product_of_its_features():
    """For two joints the kernel equals the inner product of its 6 x 3^4 + 4 explicit monomials, to rounding."""
    rng = np.random.default_rng(0)
    start = SMALL.start(2)
    hyper = jax.tree.map(lambda leaf: rng.normal(size=np.shape(leaf)), start)
    motions = [Motion(*rng.normal(size=(3, size, 2))) for size in (7, 5)]
    a, b = (np.asarray(Gip().inputs(UNIT, motion, None)) for motion in motions)
    left, right = (explicit(hyper, motion) for motion in motions)
    assert left.shape[1] == 6 * 3**4 + 4
    np.testing.assert_allclose(kernel(hyper, a, b), left @ right.T, rtol=1e-12)


def test_kernel_has_no_square_of_a_sliding_joints_sine():
    """A joint that slides enters by its position, of degree two, and without trigonometry."""
    robot = make_robot(("a", "b"), (False, True))
    motion = Motion(jnp.array([0.3, 0.4]), jnp.zeros(2), jnp.zeros(2))
    inputs = np.asarray(Gip().inputs(UNIT, motion, robot))
    np.testing.assert_allclose(inputs[:4], [np.cos(0.3), 0.4, np.sin(0.3), 0.0])


def test_needs_fewer_samples_than_a_squared_exponential():
    """From 120 samples it leaves less than 1e-3 of the variance of unseen motions, and less than a tenth of what the
    squared exponential kernel leaves: what the paper claims of it (data efficiency)."""
    train, test = sine_tasks(2, 200)
    assert train.samples < 140
    errors = []
    for model in (Gip(steps=40), Gpr(steps=40)):
        errors.append(error(model, model.fit(train, KEY), test))
    assert (errors[0] < 1e-3).all() and (errors[0] < 0.1 * errors[1]).all()


def test_friction_terms_learn_friction():
    """With Coulomb and viscous friction in the torques, it leaves less than half without its friction terms."""
    train, test = (rubbed(x) for x in sine_tasks(2, 200))
    models = [Gip(steps=30), Gip(steps=30, friction=False)]
    errors = [error(model, model.fit(train, KEY), test).mean() for model in models]
    assert errors[0] < 0.5 * errors[1]


def test_bad_options():
    """Counts that are no whole numbers from one are refused by name."""
    with pytest.raises(UsageError, match=r"model.steps=0; allowed: a whole number >= 1"):
        Gip(steps=0)
