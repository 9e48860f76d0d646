"""FFNN: Table I, and the program of all joints at once against a plain loop that trains one net after the other."""

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from invdyn_cli import training
from invdyn_cli.errors import UsageError
from invdyn_cli.models.ffnn import Ffnn, JointNet
from invdyn_cli.types import Dataset, Motion, Trajectory

KEY = jax.random.key(7)
FLOAT32 = {"rtol": 2e-4, "atol": 2e-5}
"""Twenty steps of Adam in float32: sums in another order differ by 1e-7, and Adam divides slopes by their size."""


def made(samples: int = 200, n: int = 3, seed: int = 0) -> Dataset:
    """Smooth torques of random states, that a small net can learn."""
    rng = np.random.default_rng(seed)
    q, qd, qdd = rng.normal(size=(3, samples, n))
    tau = 20 * np.sin(q) + 3 * qd + 5 * qdd[:, ::-1] + 100
    joints = tuple(f"j{i + 1}" for i in range(n))
    return Dataset((Trajectory("x", np.arange(samples) / 100, Motion(q, qd, qdd), tau),), joints)


DEEP = {2: {"hidden": [8, 8]}, 3: {"learning_rate": 0.0007}}
"""Table I's differences between joints, with eight units for a hundred."""


def small(**options) -> Ffnn:
    """Two epochs of nets with eight units, one like the other."""
    return Ffnn(**{"joints": {}, "hidden": (8,), "epochs": 2} | options)


def assert_same_nets(one, other, **tolerance):
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_allclose(a, b, **tolerance)


TABLE_1 = {1: ((100,), 0.001), 2: ((100, 100), 0.001), 3: ((100,), 0.0007), 4: ((100,), 0.005)}


@pytest.mark.parametrize("n", range(1, 9))
def test_table_1_for_any_number_of_joints(n):
    """Joints 1 to 4 have Table I's layers and learning rates, all others those of joint 1; each joint has one net."""
    nets = {
        column + 1: (group.hidden, rate)
        for group in Ffnn().groups(n)
        for column, rate in zip(group.columns, group.learning_rates, strict=True)
    }
    assert nets == {j: TABLE_1.get(j, TABLE_1[1]) for j in range(1, n + 1)}
    assert sum(len(group.columns) for group in Ffnn().groups(n)) == n
    assert (Ffnn().epochs, Ffnn().batch_size) == (100, 32)


def test_inputs_are_three_for_each_joint():
    """A net of n joints has 3 n inputs; joint 2's first layer leads to its second of the same width."""
    nets = jax.eval_shape(lambda: Ffnn().init(made(n=4), KEY))["nets"]
    deep, flat = nets["group0"], nets["group1"]
    assert deep["Dense_0"]["kernel"].shape == (1, 1, 12, 100) and deep["Dense_1"]["kernel"].shape == (1, 1, 100, 100)
    assert flat["Dense_0"]["kernel"].shape == (1, 3, 12, 100) and flat["Dense_1"]["kernel"].shape == (1, 3, 100, 1)


def test_config_and_object_mean_the_same():
    """Plain lists and dicts, as YAML gives them, and finished objects are one model; the unsaid is common."""
    plain = Ffnn(hidden=[7], learning_rate=0.1, joints={2: {"hidden": [9, 9]}, 1: {"learning_rate": 0.2}})
    assert plain == Ffnn((7,), 0.1, ((1, JointNet((7,), 0.2)), (2, JointNet((9, 9), 0.1))))
    assert hash(plain) == hash(Ffnn((7,), 0.1, plain.joints))


def plain_loop(model: Ffnn, data: Dataset, column: int, hidden: tuple[int, ...], rate: float) -> dict:
    """One net after the other, with optax as its manual says: the oracle. Keys: fold_in(key, member), then the column
    for the weights and the epoch for the shuffle, as `training` says."""
    member = jax.random.fold_in(KEY, 0)
    x = np.concatenate([data.motion.q, data.motion.qd, data.motion.qdd], axis=1)
    y = data.tau[:, column]
    x, y = (jnp.asarray((v - v.mean(0)) / v.std(0), jnp.float32) for v in (x, y))
    net = training.MLP(hidden)
    params = net.init(jax.random.fold_in(member, column), x[:1])["params"]
    optimiser = optax.adam(rate)
    state = optimiser.init(params)

    @jax.jit
    def step(params, state, x, y):
        def loss(params):
            *layers, last = (params[f"Dense_{i}"] for i in range(len(hidden) + 1))
            units = x
            for layer in layers:
                units = jnp.maximum(0, units @ layer["kernel"] + layer["bias"])
            return jnp.mean(jnp.square((units @ last["kernel"] + last["bias"])[:, 0] - y))

        updates, state = optimiser.update(jax.grad(loss)(params), state)
        return optax.apply_updates(params, updates), state

    for epoch in range(model.epochs):
        order = jax.random.permutation(jax.random.fold_in(member, epoch), len(x))
        for start in range(0, len(x) - model.batch_size + 1, model.batch_size):
            rows = order[start : start + model.batch_size]
            params, state = step(params, state, x[rows], y[rows])
    return params


def test_training_is_that_of_a_plain_loop():
    """After two epochs every joint's weights are those of a loop over joints, batches and epochs with optax.adam."""
    model, data = small(joints=DEEP), made(340)  # ten batches and a rest
    fit = model.fit(data, KEY)
    for i, group in enumerate(model.groups(3)):
        for k, (column, rate) in enumerate(zip(group.columns, group.learning_rates, strict=True)):
            oracle = plain_loop(model, data, column, group.hidden, rate)
            mine = jax.tree.map(lambda leaf, k=k: leaf[0, k], fit.params["nets"][f"group{i}"])
            assert_same_nets(mine, oracle, **FLOAT32)


def test_a_seed_does_not_depend_on_the_others():
    """Seed k of a fit with three seeds is a fit with that seed's key alone; the first is a fit with one seed."""
    data = made()
    three = small(seeds=3).fit(data, KEY)
    one = small().fit(data, KEY)
    assert_same_nets(small(seeds=3).members(three)[0].params, one.params, **FLOAT32)
    model = small()
    x = np.concatenate([data.motion.q, data.motion.qd, data.motion.qdd], axis=1)
    table = training.Data(*(jnp.asarray((v - v.mean(0)) / v.std(0), jnp.float32) for v in (x, data.tau)))
    keys = jax.vmap(lambda k: jax.random.fold_in(KEY, k))(jnp.arange(3))
    for k in (1, 2):
        alone = training.train(model.groups(3), training.Schedule(2, 32), table, None, keys[k : k + 1])
        nets = small(seeds=3).members(three)[k].params["nets"]
        assert_same_nets(nets, {f"group{i}": t.params for i, t in enumerate(alone)}, **FLOAT32)


def test_seeds_are_different_and_their_mean_is_the_model():
    """Three seeds give three predictions; the model's own is their mean; parameters are counted for all."""
    data, model = made(), small(seeds=3)
    fit = model.fit(data, KEY)
    each = np.array([model.predict(member, data.motion) for member in model.members(fit)])
    assert np.abs(each[0] - each[1]).max() > 1 and np.abs(each[1] - each[2]).max() > 1
    np.testing.assert_allclose(model.predict(fit, data.motion), each.mean(0), rtol=1e-5)
    assert fit.parameters == 3 * 3 * (9 * 8 + 8 + 8 + 1)
    assert fit.history["train_loss"].shape == (2, 3, 3)


def test_validation_is_watched_and_never_learned_from():
    """Other validation data leave every weight and scale as they were, bit for bit; only its own loss changes."""
    data, model = made(), small()
    one, other = (model.fit(data, KEY, validation=made(64, seed=seed)) for seed in (1, 2))
    assert_same_nets(one.params, other.params, rtol=0)
    np.testing.assert_array_equal(one.history["train_loss"], other.history["train_loss"])
    assert (one.history["validation_loss"] != other.history["validation_loss"]).all()
    unwatched = model.fit(data, KEY)
    assert_same_nets(one.params, unwatched.params, **FLOAT32)
    assert set(unwatched.history) == {"train_loss"}


def test_the_validation_loss_is_what_it_says():
    """The last validation loss is the mean squared error of the predictions over the variance that was learned with."""
    data, watched, model = made(), made(64, seed=1), small()
    fit = model.fit(data, KEY, validation=watched)
    error = np.mean((model.predict(fit, watched.motion) - watched.tau) ** 2, axis=0) / data.tau.var(0)
    np.testing.assert_allclose(fit.history["validation_loss"][-1, 0], error, rtol=1e-4)


def test_columns_that_never_change_do_no_harm():
    """A joint that stands still and a constant torque give finite weights, and the torque is predicted as it is."""
    data = made()
    motion, tau = data.motion, data.tau
    still = Motion(*(np.where([True, False, True], x, 0.3) for x in (motion.q, motion.qd, motion.qdd)))
    tau[:, 0] = -4.0
    data = Dataset((Trajectory("x", data.trajectories[0].t, still, tau),), data.joints)
    model = small(epochs=60, learning_rate=0.01)
    fit = model.fit(data, KEY)
    said = model.predict(fit, still)
    assert not fit.warnings and np.isfinite(said).all()
    np.testing.assert_allclose(said[:, 0], -4.0, atol=0.5)  # unit scale: a trained net is near, not at, its target
    assert fit.params["target_scale"][0] == 1.0 and fit.params["input_scale"][1] == 1.0


def test_divergence_is_a_sentence():
    """A learning rate that throws the weights to infinity gives a fit with a warning, no exception."""
    fit = small(learning_rate=1e30).fit(made(), KEY)
    assert "diverged" in fit.warnings[0] and "learning rate" in fit.warnings[0]


@pytest.mark.parametrize("samples", [1, 10])
def test_fewer_samples_than_a_batch(samples):
    """Less data than one batch are one batch: ten samples move the weights; one, which is its own mean, does not."""
    data, model = made(samples), small()
    fit, start = model.fit(data, KEY), model.init(data, KEY)
    pairs = zip(*map(jax.tree.leaves, (fit.params["nets"], start["nets"])), strict=True)
    moved = [np.abs(a - b).max() for a, b in pairs]
    assert np.isfinite(moved).all() and (max(moved) > 0) == (samples > 1)


def test_the_loss_falls():
    """Within 60 epochs the training loss of every joint falls to under a fifth, and the torque to an NMSE below 0.2."""
    data, model = made(), small(epochs=60, learning_rate=0.01)
    seen = []
    fit = model.fit(data, KEY, progress=lambda share, note: seen.append(share))
    losses = fit.history["train_loss"][:, 0]
    assert (losses[-1] < 0.2 * losses[0]).all()
    error = model.predict(fit, data.motion) - data.tau
    assert (np.mean(error**2, axis=0) / data.tau.var(0) < 0.2).all()
    assert seen[-1] == 1.0 and seen == sorted(seen)


def test_more_shapes_than_ten_keep_their_joints():
    """Eleven shapes of nets: after a way through jax's sorted dicts (group10 before group2) joints keep their nets."""
    model = Ffnn((4,), joints={j: {"hidden": [j + 3]} for j in range(2, 12)})
    nets = {}
    for i, group in enumerate(model.groups(11)):  # nets that always say their joint's column
        [width], [column] = group.hidden, group.columns
        first = {"kernel": jnp.zeros((1, 1, 33, width)), "bias": jnp.zeros((1, 1, width))}
        last = {"kernel": jnp.zeros((1, 1, width, 1)), "bias": jnp.full((1, 1, 1), column)}
        nets[f"group{i}"] = {"Dense_0": first, "Dense_1": last}
    scales = {"input_mean": 0.0, "input_scale": 1.0, "target_mean": 100.0, "target_scale": 1.0}
    zero = jnp.zeros(11)
    torque = jax.jit(lambda params: model.apply(params, Motion(zero, zero, zero), None))  # jit sorts the dicts
    np.testing.assert_array_equal(torque(scales | {"nets": nets}), 100 + np.arange(11))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"epochs": 0}, "model.epochs=0; allowed: a whole number >= 1"),
        ({"batch_size": 2.5}, "model.batch_size=2.5"),
        ({"seeds": -1}, "model.seeds=-1"),
        ({"learning_rate": 0.0}, "learning_rate=0.0; allowed: a number > 0"),
        ({"hidden": (0,)}, "hidden widths .0."),
        ({"joints": {2: {"width": 3}}}, "model.joints.2 has width; allowed: hidden, learning_rate"),
    ],
)
def test_misuse_is_refused(options, words):
    """Options that make no sense are refused by name, with what is allowed."""
    with pytest.raises(UsageError, match=words):
        Ffnn(**options)
