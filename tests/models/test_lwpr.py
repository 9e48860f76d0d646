"""LWPR: fixed fields against plain locally weighted regression, the gradient of M, the paper's function, an arm."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from invdyn_cli import experiment
from invdyn_cli.adaptation.online import OnlineUpdate
from invdyn_cli.errors import UsageError
from invdyn_cli.maths.metrics import nmse
from invdyn_cli.models.lwpr import Lwpr, _one_turn, said
from invdyn_cli.testing import check_adapter, check_model
from tests.records import make_dataset, make_robot
from tests.sine_arm import error, ridge_error, sine_tasks

KEY = jax.random.key(0)
SMALL = Lwpr(fields=8, directions=2, reach=1.0, passes=2)


def cross(x):
    """The paper's function of two inputs."""
    a, b = x[..., 0] ** 2, x[..., 1] ** 2
    return np.maximum(np.maximum(np.exp(-10 * a), np.exp(-50 * b)), 1.25 * np.exp(-5 * (a + b)))


def noisy(samples):
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, (samples, 2))
    return x, cross(x) + 0.1 * rng.normal(size=samples)


def learned(model, x, y, turns):
    """Fields of one target after so many turns over the samples."""
    fields = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], model.blank(x.shape[1]))
    for turn in range(turns):
        order = np.random.default_rng(turn).permutation(len(x))
        fields = _one_turn(model, fields, x[order], y[order][None])
    return jax.tree.map(lambda leaf: leaf[0], fields)


def weighted_plane(x, y, centre, width):
    """Weights, rows and coefficients of weighted least squares on [x - centre, 1], in numpy."""
    w = np.exp(-0.5 * (((x - centre) * width) ** 2).sum(1))
    rows = np.c_[x - centre, np.ones(len(x))]
    inverse = np.linalg.inv(rows.T @ (w[:, None] * rows))
    return w, rows, inverse, inverse @ rows.T @ (w * y)


def test_contract():
    """It keeps the contract of a model, and adaptation=online that of an adaptation."""
    data = make_dataset(make_robot(("a", "b")), np.random.default_rng(0), samples=60)
    check_model(SMALL, data)
    check_adapter(OnlineUpdate(), SMALL, data)


def test_fixed_fields_are_locally_weighted_regression():
    """With M fixed and as many directions as inputs, predictions differ from those of weighted least squares in the
    same fields by less than 2 % of the target's spread: sums that forget one in 10,000 keep a little of their first
    errors."""
    x, y = noisy(1000)
    model = Lwpr(fields=60, directions=2, reach=0.13, generate=0.1, direction_gain=1e-9, learning_rate=0)
    fields = learned(model, x, y, 20)
    grid = np.random.default_rng(1).uniform(-0.9, 0.9, (100, 2))
    top = bottom = 0
    for k in np.flatnonzero(fields["count"]):
        centre, width = (np.asarray(fields[name][k]) for name in ("centre", "width"))
        coefficients = weighted_plane(x, y, centre, width)[3]
        near = np.exp(-0.5 * (((grid - centre) * width) ** 2).sum(1))
        top, bottom = top + near * (np.c_[grid - centre, np.ones(len(grid))] @ coefficients), bottom + near
    mine = np.asarray(jax.vmap(lambda one: said(fields, one))(grid))
    assert np.sqrt(np.mean((mine - top / bottom) ** 2)) < 0.02 * y.std()


@pytest.mark.parametrize("width", [2.0, 5.0])
def test_gradient_of_the_leave_one_out_error(width):
    """The mean step of a turn is down the gradient of the logarithm of the leave-one-out error, which numpy differences
    from weighted least squares: to 15 % of its size, as stochastic sums neglect how the centre of weight moves."""
    x, y = noisy(4000)
    centre, start = np.array([0.3, 0.0]), np.array([width, width])

    def error(width):
        w, rows, inverse, coefficients = weighted_plane(x, y, centre, width)
        leverage = w * np.einsum("ij,jk,ik->i", rows, inverse, rows)
        return np.log((w * ((y - rows @ coefficients) / (1 - leverage)) ** 2).sum() / w.sum())

    def difference(k):
        up, down = (start * np.exp(step * np.eye(2)[k]) for step in (1e-4, -1e-4))
        return (error(up) - error(down)) / 2e-4

    still = Lwpr(fields=1, directions=2, learning_rate=0, forgetting=1.0, last_forgetting=1.0)
    fields = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], still.blank(2))
    begun = {"centre": centre[None, None], "width": start[None, None], "count": [[1]], "used": [[2]]}
    fields = {**fields, **{name: jnp.asarray(value, fields[name].dtype) for name, value in begun.items()}}
    for _ in range(5):
        fields = _one_turn(still, fields, x, y[None])
    field = jax.tree.map(lambda leaf: leaf[0, 0], fields)
    model = replace(still, learning_rate=1.0, penalty=0.0)
    w = np.exp(-0.5 * (((x - centre) * start) ** 2).sum(1))
    steps = jax.jit(jax.vmap(lambda x, y, w: jnp.log(model._updated(x, y, field, w)["width"] / start)))(x, y, w)
    turn = np.asarray(steps.sum(0)) * field["judged"] / w.sum()
    expected = -np.array([difference(0), difference(1)])
    assert np.abs(turn - expected).max() < 0.15 * np.abs(expected).max()


@pytest.mark.benchmark
def test_learns_the_papers_function():
    """From 2,000 samples with noise of 0.1 it leaves less than 2 % of the variance of the noise-free function (the
    paper's figure), and less than 0.6 of what fields of fixed shape leave: M is worth learning."""
    x, y = noisy(2000)
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 41)] * 2), -1).reshape(-1, 2)
    errors = []
    for rate in (0.5, 0.0):
        fields = learned(Lwpr(fields=100, directions=2, reach=0.07, learning_rate=rate), x, y, 10)
        mine = np.asarray(jax.vmap(lambda one, fields=fields: said(fields, one))(grid))
        errors.append(np.mean((mine - cross(grid)) ** 2) / cross(grid).var())
    assert errors[0] < 0.02 and errors[0] < 0.6 * errors[1]


def test_learns_an_arm_and_follows_a_change():
    """It leaves less than a third of what linear regression leaves on the paper's interpolation split; and, while it
    follows a torque that rises by 3 N m, less than half of the batch model's squared error over the second half."""
    train, test = sine_tasks(2, 20)
    model = Lwpr(fields=60, passes=3)
    fit = model.fit(train, KEY)
    assert (error(model, fit, test) < ridge_error(train, test) / 3).all()
    moved = replace(test, trajectories=tuple(replace(x, tau=x.tau + 3) for x in test.trajectories))
    followed, _ = experiment.follow(OnlineUpdate(), model, fit, moved)
    half = slice(moved.samples // 2, None)
    batch = nmse(moved.tau[half], model.predict(fit, moved.motion)[half])
    assert (nmse(moved.tau[half], followed[half]) < 0.5 * batch).all()


def test_all_fields_taken_is_told():
    """A warning names the option; a bad option is refused by name."""
    train, _ = sine_tasks(2, 200)
    assert "model.fields" in Lwpr(fields=2, passes=1).fit(train, KEY).warnings[0]
    with pytest.raises(UsageError, match=r"model.fields=0; allowed: a whole number >= 1"):
        Lwpr(fields=0)
    with pytest.raises(UsageError, match=r"model.generate=0; allowed: a number above 0, up to 1"):
        Lwpr(generate=0)
