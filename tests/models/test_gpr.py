"""GPR: scikit-learn's Gaussian process as the oracle, inducing inputs against exact inference, and what it learns."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from invdyn_cli.errors import UsageError
from invdyn_cli.maths import gaussian_process as gp
from invdyn_cli.maths.scaling import standardised
from invdyn_cli.models.gpr import Gpr
from invdyn_cli.testing import check_model
from tests.sine_arm import error, ridge_error, sine_tasks

KEY = jax.random.key(0)
SMALL = Gpr(hyperparameter_samples=80, steps=15)


@pytest.mark.parametrize("model", [SMALL, replace(SMALL, exact=100, inducing=60)], ids=["exact", "inducing"])
def test_contract(model, data):
    """Exact or by inducing inputs, it keeps the contract of a model."""
    check_model(model, data)


def test_mean_and_variance_are_scikit_learns(data):
    """With the hyperparameters that it learned, scikit-learn's Gaussian process has the same mean, variance and log
    evidence, to 1e-6."""
    sklearn = pytest.importorskip("sklearn.gaussian_process", reason="needs pip install 'invdyn[sklearn]'")
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    fit = SMALL.fit(data, KEY)
    p, motion = fit.params, data.motion[slice(0, 50)]
    x, y = standardised(p, data.motion, data.tau)
    ours, variance = SMALL.predict(fit, motion), SMALL.variance(fit, motion)
    for j in range(2):
        hyper = {name: leaf[j] for name, leaf in p["hyper"].items()}
        kernel = ConstantKernel(np.exp(2 * hyper["signal"])) * RBF(np.exp(hyper["scale"]))
        noise = np.exp(2 * hyper["noise"])
        theirs = sklearn.GaussianProcessRegressor(kernel, alpha=noise, optimizer=None).fit(x, y[:, j])
        mean, std = theirs.predict(x[:50], return_std=True)
        np.testing.assert_allclose((ours[:, j] - p["target_mean"][j]) / p["target_scale"][j], mean, atol=1e-6)
        np.testing.assert_allclose(variance[:, j] / p["target_scale"][j] ** 2, std**2, atol=1e-6)
        noisy = sklearn.GaussianProcessRegressor(kernel + WhiteKernel(noise), alpha=0.0, optimizer=None)
        evidence = noisy.fit(x, y[:, j]).log_marginal_likelihood_value_
        loss = gp.minus_log_evidence(gp.squared_exponential, hyper, x, y[:, j])
        assert -float(loss) == pytest.approx(evidence, rel=1e-6)


def test_evidence_grows(data):
    """Learning raises the evidence of every joint above that of the starting point."""
    fit = SMALL.fit(data, KEY)
    x, y = standardised(fit.params, data.motion, data.tau)
    start = SMALL.init(data, KEY)["hyper"]
    for j in range(2):
        before, after = (
            float(gp.minus_log_evidence(gp.squared_exponential, {k: v[j] for k, v in hyper.items()}, x, y[:, j]))
            for hyper in (start, fit.params["hyper"])
        )
        assert after < before - 10


def test_as_many_inducing_inputs_as_samples_are_exact(data):
    """The projected process on all training inputs is the exact one, in mean and in variance."""
    exact = SMALL.fit(data, KEY)
    other = replace(SMALL, exact=1, inducing=data.samples)
    projected = other.fit(data, KEY)
    motion = data.motion[slice(0, 60)]
    motion = replace(motion, q=motion.q + 0.01, qd=motion.qd - 0.02)
    size = data.tau.std(0)
    assert np.abs(SMALL.predict(exact, motion) - other.predict(projected, motion)).max() < 1e-4 * size.max()
    difference = SMALL.variance(exact, motion) - other.variance(projected, motion)
    assert np.abs(difference / size**2).max() < 1e-4


def test_inducing_inputs_are_those_of_snelson_and_ghahramani(data):
    """Mean and variance of the projected process, from dense matrices of all rows: what the inducing inputs cannot
    represent of a row counts as its noise (Quinonero-Candela and Rasmussen 2005, equation 24). To 1e-5: the kernel
    matrix of the inducing inputs has 1e-8 on its diagonal."""
    model = replace(SMALL, exact=1, inducing=25)
    fit = model.fit(data, KEY)
    p, rows = fit.params, slice(0, 40)
    x, y = standardised(p, data.motion, data.tau)
    mean, variance = model.predict(fit, data.motion[rows]), model.variance(fit, data.motion[rows])
    for j in range(2):
        hyper = {name: leaf[j] for name, leaf in p["hyper"].items()}

        def k(a, b, hyper=hyper):
            squares = (((a[:, None] - b[None]) / np.exp(hyper["scale"])) ** 2).sum(-1)
            return np.exp(2 * hyper["signal"] - 0.5 * squares)

        own, size = p["inputs"], np.exp(2 * hyper["signal"])
        inner = np.linalg.inv(k(own, own) + gp.JITTER * size * np.eye(len(own)))
        shared = k(x, own) @ inner @ k(own, x)
        total = shared + np.diag(size - np.diag(shared) + np.exp(2 * hyper["noise"]))
        across = shared[rows]
        theirs = across @ np.linalg.solve(total, y[:, j])
        left = size - np.diag(across @ np.linalg.solve(total, across.T))
        scale = p["target_scale"][j]
        np.testing.assert_allclose((mean[:, j] - p["target_mean"][j]) / scale, theirs, atol=1e-5)
        np.testing.assert_allclose(variance[:, j] / scale**2, left, atol=1e-5)


def steep(hyper, target):
    """As an evidence of many rows: steep, and not a number where the kernel matrix is singular."""
    away = hyper["a"] - target
    return 300 * jnp.sum(jnp.where(jnp.abs(hyper["a"]) < 2, away**2, jnp.nan))


def test_a_singular_kernel_matrix_does_not_end_the_search():
    """The minimum is found although the loss is not a number at the bounds, where a step as long as the slope leads."""
    target = np.array([0.9, -1.3])
    found = gp.minimise(steep, {"a": np.zeros(2)}, target, steps=40)
    np.testing.assert_allclose(found["a"], target, atol=1e-3)


def test_learns_an_arm():
    """On the paper's interpolation split it leaves less than 1e-3 of the variance, the bar of a good net there, and a
    hundredth of what linear regression leaves; beyond its data the variance returns to the prior's."""
    train, test = sine_tasks()
    fit = SMALL.fit(train, KEY)
    assert (error(SMALL, fit, test) < 1e-3).all()
    assert (error(SMALL, fit, test) < 0.01 * ridge_error(train, test)).all()
    far = replace(test.motion, q=test.motion.q + 1e3)
    signal = np.exp(2 * fit.params["hyper"]["signal"]) * fit.params["target_scale"] ** 2
    np.testing.assert_allclose(SMALL.variance(fit, far)[0], signal, rtol=1e-6)
    assert (SMALL.variance(fit, test.motion).mean(0) < 0.01 * signal).all()


@pytest.mark.parametrize("option", ["exact", "inducing", "hyperparameter_samples", "steps"])
def test_bad_options(option):
    """Counts that are no whole numbers from one are refused by name."""
    with pytest.raises(UsageError, match=f"model.{option}=0; allowed: a whole number >= 1"):
        Gpr(**{option: 0})


def test_finds_what_is_smooth_in_a_target_of_mostly_noise():
    """Under noise of twice its spread, as in another model's residual, less than half of an arm's torque is left. With
    all hyperparameters learned at once length scales shrank to nothing, and all of it was left."""
    train, test = sine_tasks(2, 40)
    rng = np.random.default_rng(0)
    spread = train.tau.std(0)

    def hidden(x):
        return replace(x, tau=0.5 * x.tau / spread + rng.normal(size=x.tau.shape))

    noisy = replace(train, trajectories=tuple(hidden(x) for x in train.trajectories))
    smooth = replace(test, trajectories=tuple(replace(x, tau=0.5 * x.tau / spread) for x in test.trajectories))
    model = Gpr(hyperparameter_samples=300, steps=30)
    assert (error(model, model.fit(noisy, KEY), smooth) < 0.5).all()
