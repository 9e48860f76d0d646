"""RFF: the kernel that it approximates, Bayesian linear regression in closed form, and what it learns."""

import jax
import numpy as np
import pytest
from scipy import stats

from invdyn_cli.errors import UsageError
from invdyn_cli.maths import gaussian_process as gp
from invdyn_cli.maths.scaling import standardised
from invdyn_cli.models import rff
from invdyn_cli.models.rff import Rff
from invdyn_cli.testing import check_model
from tests.sine_arm import error, ridge_error, sine_tasks

KEY = jax.random.key(0)
SMALL = Rff(frequencies=30, hyperparameter_samples=100, steps=10)


def test_contract(data):
    """It keeps the contract of a model."""
    check_model(SMALL, data)


def test_features_give_the_kernel():
    """phi(x)' phi(z) nears the squared exponential kernel as frequencies grow (Rahimi and Recht 2007): with 20,000 the
    error is within five standard errors, 1 / sqrt(20,000)."""
    rng = np.random.default_rng(0)
    x, directions = rng.normal(size=(10, 3)), rng.normal(size=(20_000, 3))
    hyper = {"scale": np.array([0.1, -0.3, 0.5]), "signal": np.array(0.2), "noise": np.array(-2.0)}
    phi = np.asarray(rff._features(hyper, directions, x))
    assert np.abs(phi @ phi.T - gp.squared_exponential(hyper, x, x)).max() < 5 / np.sqrt(20_000) * np.exp(0.4)


def test_evidence_is_that_of_the_gaussian_it_stands_for():
    """The evidence is the density of the targets under N(0, phi phi' + noise²), up to a constant."""
    rng = np.random.default_rng(1)
    x, y, directions = rng.normal(size=(40, 2)), rng.normal(size=(40, 1)), rng.normal(size=(7, 2))
    told = []
    for noise in (-1.0, -0.2):
        hyper = {"scale": np.zeros((1, 2)), "signal": np.array([0.3]), "noise": np.array([noise])}
        phi = np.asarray(rff._features({k: v[0] for k, v in hyper.items()}, directions, x))
        density = stats.multivariate_normal(np.zeros(40), phi @ phi.T + np.exp(2 * noise) * np.eye(40))
        told.append(float(rff._loss(hyper, directions, x, y)) + density.logpdf(y[:, 0]))
    assert told[0] == pytest.approx(told[1], abs=1e-8)


def test_weights_are_the_posterior_mean(data):
    """The weights are those of ridge regression on the features over all samples, whatever decided hyperparameters."""
    fit = SMALL.fit(data, KEY)
    p = fit.params
    x, y = standardised(p, data.motion, data.tau)
    for j in range(2):
        hyper = {name: leaf[j] for name, leaf in p["hyper"].items()}
        phi = np.asarray(rff._features(hyper, p["directions"], x))
        noise = np.exp(2 * hyper["noise"])
        direct = np.linalg.solve(phi.T @ phi + noise * np.eye(60), phi.T @ y[:, j])
        np.testing.assert_allclose(p["weights"][j], direct, rtol=1e-6, atol=1e-8)


def test_learns_an_arm():
    """On the paper's interpolation split it leaves less than 1e-3 of the variance, the bar of a good net there, and a
    hundredth of what linear regression leaves."""
    train, test = sine_tasks()
    model = Rff(frequencies=80, hyperparameter_samples=200, steps=25)
    fit = model.fit(train, KEY)
    assert (error(model, fit, test) < 1e-3).all()
    assert (error(model, fit, test) < 0.01 * ridge_error(train, test)).all()


def test_bad_options():
    """No frequencies are refused by name."""
    with pytest.raises(UsageError, match=r"model.frequencies=0; allowed: a whole number >= 1"):
        Rff(frequencies=0)
