"""LIP: its kernel against differentiated energies, the arm's torques from few samples, and its parts."""

import functools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from invdyn_cli.errors import UsageError
from invdyn_cli.maths import gaussian_process as gp
from invdyn_cli.models.gip import Gip
from invdyn_cli.models.lip import Lip, _gram, _state, torque_covariance
from invdyn_cli.testing import check_model
from tests.records import make_dataset, make_robot
from tests.sine_arm import error, rubbed, sine_tasks

KEY = jax.random.key(0)
SMALL = Lip(hyperparameter_samples=20, steps=8)


def test_contract():
    """It keeps the contract of a model, of an arm with a joint that slides too."""
    robot = make_robot(("a", "b"), (False, True))
    check_model(SMALL, make_dataset(robot, np.random.default_rng(0), samples=30))


def energies(weight, q, qd):
    """Features (F,) of the Lagrangian of two revolute joints whose inner products are the energies' kernel."""

    def every(parts):  # all products of one entry of each part
        return functools.reduce(lambda x, y: jnp.outer(x, y).ravel(), parts)

    def place(name, at, joint):
        cosine, sine = (weight[f"{name}_{x}"][(*at, joint)] for x in ("cosine", "sine"))
        return jnp.stack([1.0, jnp.sqrt(cosine) * jnp.cos(q[joint]), jnp.sqrt(sine) * jnp.sin(q[joint])])

    features = []
    for link in range(2):
        joints = range(link + 1)
        speeds = jnp.sqrt(weight["speed"][link, : link + 1]) * qd[: link + 1]
        features.append(every([speeds, speeds, *(place("kinetic", (s,), j) for j in joints for s in range(2))]))
        features.append(every([weight["potential"][link, None] ** 0.5, *(place("potential", (), j) for j in joints)]))
    return jnp.concatenate(features)


def test_kernel_is_the_euler_lagrange_operator_on_the_energies():
    """For two joints the covariance of torques equals the inner product of the torques that JAX differentiates from
    each of the energies' explicit monomials, to rounding."""
    rng = np.random.default_rng(0)
    hyper = jax.tree.map(lambda leaf: rng.normal(size=np.shape(leaf)), Lip(friction=False).start(2))
    weight = jax.tree.map(jnp.exp, hyper)

    def torques(row):
        q, qd, qdd = jnp.split(row, 3)
        momentum = jax.jacfwd(lambda q, qd: energies(weight, q, qd), 1)
        rate = jax.jvp(momentum, (q, qd), (qd, qdd))[1]
        return (rate - jax.jacfwd(lambda q: energies(weight, q, qd))(q)).T  # (2, F)

    a, b = rng.normal(size=(4, 6)), rng.normal(size=(3, 6))
    scales = {"time": 1.0, "length": np.ones(2)}
    said = torque_covariance(hyper, _state(scales, a, None), _state(scales, b, None))
    left, right = (np.asarray(jax.jit(jax.vmap(torques))(x)) for x in (a, b))
    np.testing.assert_allclose(said, np.einsum("aif,bjf->ijab", left, right), rtol=1e-9, atol=1e-9)


def test_recovers_a_rigid_arm_from_few_samples():
    """From 60 samples of two joints it leaves less than 1e-3 of the variance of unseen motions, and less than gip: what
    the paper claims of it (torques of all joints inform each other)."""
    train, test = sine_tasks(2, 400)
    assert train.samples < 80
    errors = [error(model, model.fit(train, KEY), test).mean() for model in (Lip(steps=40), Gip(steps=40))]
    assert errors[0] < 1e-3 and errors[0] < errors[1]


def test_the_support_is_that_of_snelson_and_ghahramani():
    """The projected process, from dense matrices of all rows: what the torques of the support cannot represent of a
    torque counts as its noise. To 1e-4: the kernel matrix of the support has 1e-8 on its diagonal."""
    data, _ = sine_tasks(2, 400)
    model = replace(SMALL, exact=1, inducing=5)
    fit = model.fit(data, KEY)
    p, x = fit.params, np.concatenate([data.motion.q, data.motion.qd, data.motion.qdd], axis=1)
    every, support = (_state(p, rows, None) for rows in (x, p["support"]))
    own, across, all_of = (
        np.asarray(_gram(p["hyper"], *pair, p["scale"]))
        for pair in ((support, support), (every, support), (every, every))
    )
    inner = np.linalg.inv(own + gp.JITTER * np.diag(own).mean() * np.eye(len(own)))
    shared = across @ inner @ across.T
    noise = np.tile(np.exp(2 * p["hyper"]["noise"]), data.samples)
    total = shared + np.diag(np.diag(all_of - shared) + noise)
    expected = shared @ np.linalg.solve(total, (data.tau / p["scale"]).ravel())
    assert np.diag(all_of - shared).max() > noise.max()
    said = model.predict(fit, data.motion) / p["scale"]
    np.testing.assert_allclose(said.ravel(), expected, atol=1e-4)


@pytest.mark.benchmark
def test_more_samples_than_the_support():
    """Projected on the torques of 30 of 120 samples, which span the polynomials, it leaves at most twice the error of
    exact inference from all, or 1e-5 of the variance."""
    train, test = sine_tasks(2, 200)
    exact, projected = Lip(steps=20), Lip(steps=20, exact=100, inducing=40)
    errors = [error(model, model.fit(train, KEY), test).mean() for model in (exact, projected)]
    assert errors[1] < max(2 * errors[0], 1e-5)


@pytest.mark.benchmark
def test_friction_terms_learn_friction():
    """With Coulomb and viscous friction in the torques, it leaves less than half without its friction terms."""
    train, test = (rubbed(x) for x in sine_tasks(2, 400))
    models = [Lip(steps=25), Lip(steps=25, friction=False)]
    errors = [error(model, model.fit(train, KEY), test).mean() for model in models]
    assert errors[0] < 0.5 * errors[1]


def test_bad_options():
    """Counts that are no whole numbers from one are refused by name."""
    with pytest.raises(UsageError, match=r"model.inducing=0; allowed: a whole number >= 1"):
        Lip(inducing=0)
