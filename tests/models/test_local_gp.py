"""Local GP: one region against the exact process, the parts of a prediction, what it learns, and how it goes on."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from invdyn_cli import experiment
from invdyn_cli.adaptation.online import OnlineUpdate
from invdyn_cli.errors import UsageError
from invdyn_cli.maths.metrics import nmse
from invdyn_cli.maths.scaling import standardised
from invdyn_cli.models.gpr import Gpr
from invdyn_cli.models.local_gp import LocalGp
from invdyn_cli.models.pest import Pest
from invdyn_cli.testing import check_adapter, check_model
from tests.sine_arm import error, ridge_error, sine_tasks

KEY = jax.random.key(0)
SMALL = LocalGp(regions=6, capacity=30, hyperparameter_samples=80, steps=15)


def test_contract(data):
    """It keeps the contract of a model, and adaptation=online that of an adaptation."""
    check_model(SMALL, data)
    check_adapter(OnlineUpdate(), SMALL, data)


def test_one_region_that_holds_all_is_the_exact_process(data):
    """With a single region that takes all samples it is model=gpr."""
    whole = replace(SMALL, regions=1, capacity=data.samples)
    exact = Gpr(hyperparameter_samples=80, steps=15)
    ours, theirs = whole.fit(data, KEY), exact.fit(data, KEY)
    difference = whole.predict(ours, data.motion) - exact.predict(theirs, data.motion)
    assert np.abs(difference).max() < 1e-6 * data.tau.std()


def test_prediction_is_the_weighted_mean_of_the_nearest(data):
    """Textbook algebra in numpy on the samples that the regions keep gives the same torques."""
    fit = SMALL.fit(data, KEY)
    p = fit.params
    x, _ = standardised(p, data.motion, data.tau)
    for row, j in ((3, 0), (77, 1), (150, 1)):
        scale, noise = np.exp(p["hyper"]["scale"][j]), np.exp(2 * p["hyper"]["noise"][j])
        signal, regions = np.exp(2 * p["hyper"]["signal"][j]), {k: v[j] for k, v in p["local"].items()}
        weights, means = [], []
        for k in np.flatnonzero(regions["count"]):
            a = regions["inputs"][k, : regions["count"][k]]
            b = regions["targets"][k, : regions["count"][k]]
            gram = signal * np.exp(-0.5 * (((a[:, None] - a) / scale) ** 2).sum(-1)) + noise * np.eye(len(a))
            at = signal * np.exp(-0.5 * (((x[row] - a) / scale) ** 2).sum(-1))
            means.append(at @ np.linalg.solve(gram, b))
            weights.append(np.exp(-0.5 * (((x[row] - regions["centres"][k]) / scale) ** 2).sum()))
        nearest = np.argsort(weights)[-SMALL.nearest :]
        mean = np.average(np.array(means)[nearest], weights=np.array(weights)[nearest])
        torque = p["target_mean"][j] + p["target_scale"][j] * mean
        assert SMALL.predict(fit, data.motion)[row, j] == pytest.approx(torque, rel=1e-8)


def test_learns_an_arm():
    """On the paper's interpolation split it leaves less than 1 % of the variance and a tenth of what linear regression
    leaves: regions have less to learn from than one process of all samples."""
    train, test = sine_tasks()
    model = LocalGp(regions=20, capacity=60, hyperparameter_samples=200, steps=30)
    fit = model.fit(train, KEY)
    assert (error(model, fit, test) < 0.01).all()
    assert (error(model, fit, test) < 0.1 * ridge_error(train, test)).all()


def test_follows_a_change():
    """A torque that rises by 3 N m: while it follows, it leaves less than a fifth of the batch model's squared error
    over the second half."""
    train, test = sine_tasks()
    model = LocalGp(regions=20, capacity=60, hyperparameter_samples=200, steps=30)
    fit = OnlineUpdate().fit(model, train, KEY)
    moved = replace(test, trajectories=tuple(replace(x, tau=x.tau + 3) for x in test.trajectories))
    said, _ = experiment.follow(OnlineUpdate(), model, fit, moved)
    half = slice(moved.samples // 2, None)
    batch = nmse(moved.tau[half], model.predict(fit, moved.motion)[half])
    assert (nmse(moved.tau[half], said[half]) < 0.2 * batch).all()


def test_a_full_region_forgets_its_oldest(data):
    """After as many equal samples as a region holds, it holds nothing else, and predicts them."""
    one = replace(SMALL, regions=1)
    fit = one.fit(data, KEY)
    motion, tau = jax.tree.map(lambda x: jnp.asarray(x[10]), (data.motion, data.tau + 20.0))

    @jax.jit
    def learn(params):
        step = lambda p, _: (one.learned_from(p, motion, tau, None), None)  # noqa: E731
        return jax.lax.scan(step, params, None, one.capacity)[0]

    params = learn(jax.tree.map(jnp.asarray, fit.params))
    inputs = params["local"]["inputs"]
    np.testing.assert_allclose(inputs, np.broadcast_to(inputs[:, :, :1], inputs.shape))
    left = np.abs(one.apply(params, motion, None) - tau) / data.tau.std(0)
    assert (left < 0.05).all()


def test_refusals(data):
    """Bad options, and adaptation=online with a model that has no update: one line each."""
    for option, value in {"regions": 0, "capacity": 0, "nearness": 1.0}.items():
        with pytest.raises(UsageError, match=f"model.{option}={value}; allowed"):
            LocalGp(**{option: value})
    with pytest.raises(UsageError, match="Pest does not learn from single samples"):
        OnlineUpdate().fit(Pest(), data, KEY)
