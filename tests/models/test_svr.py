"""SVR: scikit-learn's own prediction as the oracle, the meaning of nu, and what it learns."""

import sys

import jax
import numpy as np
import pytest

pytest.importorskip("sklearn", reason="scikit-learn is not installed: pip install 'invdyn[sklearn]'")
from sklearn.svm import NuSVR

from invdyn_cli.errors import UsageError
from invdyn_cli.maths.scaling import standardised
from invdyn_cli.models.svr import Svr
from invdyn_cli.testing import check_model
from tests.records import make_dataset, make_robot
from tests.sine_arm import error, ridge_error, sine_tasks

KEY = jax.random.key(0)


@pytest.fixture(scope="module")
def data():
    return make_dataset(make_robot(("a", "b")), np.random.default_rng(0), samples=60)


def test_contract(data):
    """It keeps the contract of a model."""
    check_model(Svr(), data)


@pytest.mark.parametrize("options", [{}, {"nu": 0.2, "cost": 3.0, "gamma": 0.5}])
def test_predicts_what_scikit_learn_predicts(options, data):
    """The stored coefficients give scikit-learn's prediction, and nu bounds the share of support vectors from below."""
    model = Svr(**options)
    fit = model.fit(data, KEY)
    x, y = standardised(fit.params, data.motion, data.tau)
    said = (model.predict(fit, data.motion) - fit.params["target_mean"]) / fit.params["target_scale"]
    gamma = model.gamma or 1 / x.shape[1]
    for j in range(2):
        machine = NuSVR(nu=model.nu, C=model.cost, gamma=gamma, tol=model.tolerance).fit(x, y[:, j])
        np.testing.assert_allclose(said[:, j], machine.predict(x), atol=1e-9)
    assert (fit.details["support_vectors"] >= model.nu * len(x) - 1).all()


def test_learns_an_arm():
    """On the paper's interpolation split it leaves less than 5e-3 of the variance, and a tenth of what linear
    regression leaves: its tube is not a likelihood, so that it stays behind model=gpr."""
    train, test = sine_tasks()
    model = Svr()
    fit = model.fit(train, KEY)
    assert (error(model, fit, test) < 5e-3).all()
    assert (error(model, fit, test) < 0.1 * ridge_error(train, test)).all()


def test_says_what_is_missing(data, monkeypatch):
    """Without scikit-learn there is one line that says how to get it."""
    monkeypatch.setitem(sys.modules, "sklearn.svm", None)
    with pytest.raises(UsageError, match=r"model=svr needs scikit-learn, which is not installed") as raised:
        Svr().fit(data, KEY)
    assert 'pip install "invdyn[sklearn]"' in str(raised.value)


def test_bad_options():
    """Options outside their ranges are refused by name."""
    for option, value in {"nu": 1.5, "cost": 0.0, "gamma": -1.0, "samples": 0}.items():
        with pytest.raises(UsageError, match=f"model.{option}={value}; allowed"):
            Svr(**{option: value})
