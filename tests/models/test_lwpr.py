"""LWPR: partial least squares as the oracle, the gradient of its cost, the paper's cross function, and an arm."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from invdyn_cli import experiment
from invdyn_cli.adaptation.online import OnlineUpdate
from invdyn_cli.errors import UsageError
from invdyn_cli.maths.metrics import nmse
from invdyn_cli.models import lwpr
from invdyn_cli.models.lwpr import Lwpr
from invdyn_cli.testing import check_adapter, check_model
from tests.records import make_dataset, make_robot
from tests.sine_arm import error, ridge_error, sine_tasks

KEY = jax.random.key(0)
SMALL = Lwpr(fields=12, passes=1)
CROSS = Lwpr(fields=100, projections=2, width=0.1, learning_rate=250.0)


@pytest.fixture(scope="module")
def data():
    return make_dataset(make_robot(("a", "b")), np.random.default_rng(0), samples=100)


def test_contract(data):
    """It keeps the contract of a model, and adaptation=online that of an adaptation."""
    check_model(SMALL, data)
    check_adapter(OnlineUpdate(), SMALL, data)


def learned(model: Lwpr, x: np.ndarray, y: np.ndarray) -> dict:
    """The fields of one target after all samples in turn."""
    state = jax.tree.map(lambda leaf: leaf[None], model.blank(x.shape[1]))
    state = lwpr._passed(model, state, jnp.asarray(x), jnp.asarray(y)[:, None])
    return jax.tree.map(lambda leaf: leaf[0], state)


def said(model: Lwpr, state: dict, x: np.ndarray) -> np.ndarray:
    return np.asarray(jax.jit(jax.vmap(lambda one: model.mean(state, one)))(jnp.asarray(x)))


def test_one_wide_field_is_partial_least_squares():
    """A single field as wide as the data, with as many projections as inputs, is linear regression: after three passes
    over 1,000 samples of a plane it predicts it to 1 % of its spread."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=(1000, 4))
    y = 0.3 + x @ np.array([1.0, -2.0, 0.5, 3.0])
    model = Lwpr(fields=1, projections=4, width=100.0, learning_rate=0.0, gain=1.0, forgetting=1.0)
    state = learned(model, np.tile(x, (3, 1)), np.tile(y, 3))
    assert np.sqrt(np.mean((said(model, state, x) - y) ** 2)) < 0.01 * y.std()


def cross(x: np.ndarray) -> np.ndarray:
    """The paper's test function (its section 4.1)."""
    a, b = x.T
    return np.max([np.exp(-10 * a**2), np.exp(-50 * b**2), 1.25 * np.exp(-5 * (a**2 + b**2))], axis=0)


def test_the_papers_cross_function():
    """From 500 noisy samples (standard deviation 0.1), presented 20 times, it leaves less than 5 % of the variance of
    1,681 clean ones, and less than half of what fields leave that keep their first shape. The paper has 0.02."""
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, (500, 2))
    y = cross(x) + 0.1 * rng.normal(size=500)
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 41)] * 2), -1).reshape(-1, 2)
    order = np.concatenate([rng.permutation(500) for _ in range(20)])
    errors = []
    for model in (CROSS, replace(CROSS, learning_rate=0.0)):
        state = learned(model, x[order], y[order])
        errors.append(float(nmse(cross(grid)[:, None], said(model, state, grid)[:, None])[0]))
    assert errors[0] < 0.05 and errors[0] < 0.5 * errors[1]


def test_learns_an_arm():
    """On the paper's interpolation split it leaves less than 5 % of the variance, and less than half of what linear
    regression leaves."""
    train, test = sine_tasks()
    model = Lwpr(fields=60, passes=10)
    fit = model.fit(train, KEY)
    assert (error(model, fit, test) < 0.05).all()
    assert (error(model, fit, test) < 0.5 * ridge_error(train, test)).all()


def test_follows_a_change():
    """A torque that rises by 3 N m: while it follows, it leaves less than half of the batch model's squared error over
    the second half."""
    train, test = sine_tasks()
    model = Lwpr(fields=60, passes=5, forgetting=0.98)
    fit = OnlineUpdate().fit(model, train, KEY)
    moved = replace(test, trajectories=tuple(replace(x, tau=x.tau + 3) for x in test.trajectories))
    adapted, _ = experiment.follow(OnlineUpdate(), model, fit, moved)
    half = slice(moved.samples // 2, None)
    batch = nmse(moved.tau[half], model.predict(fit, moved.motion)[half])
    assert (nmse(moved.tau[half], adapted[half]) < 0.5 * batch).all()


def test_bad_options():
    """Options outside their ranges are refused by name."""
    for option, value in {"fields": 0, "generate": 0.0, "width": 0.0, "penalty": -1.0, "passes": 0}.items():
        with pytest.raises(UsageError, match=f"model.{option}={value}; allowed"):
            Lwpr(**{option: value})
