"""Checks whether an implementation keeps its contract: `check_model`, `check_adapter` and `check_source`, for third
parties too.

Each takes an object and data to test it on, returns nothing, and raises AssertionError with a sentence that says which
rule of `interfaces` is violated and what was found. They fit the model twice: give them little data and few epochs.
"""

import json
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import is_dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from invdyn_cli import experiment, registry, store
from invdyn_cli.adaptation.batch import Batch
from invdyn_cli.errors import InvdynError
from invdyn_cli.interfaces import AbstractAdapter, AbstractModel, AbstractSource
from invdyn_cli.types import Array, Dataset, Fit, Header, Motion, PyTree, Robot, RunRecord, Splits

ROUNDING = 1e-5
"""Share of the torque's size by which two ways to compute it may differ: nets work in float32 (1.2e-7), and sums of
some hundred terms lose up to two decades of that."""

SLOPE = 0.02
"""Share by which a gradient may differ from finite differences: a float32 net with steps of 1e-3 has rounding errors
near 1e-4 and crosses some kinks of ReLU; a missing or doubled term is larger."""

STEPS = (1e-2, 1e-3, 1e-4, 1e-5)
"""Steps of the finite differences, in units of the size of each number; the best one counts."""


def check_model(model: AbstractModel, dataset: Dataset, *, key: jax.Array | None = None) -> None:
    """The model keeps the contract of AbstractModel on this dataset.

    Checked: a frozen, hashable dataclass; `init` and `fit` give a nested dict of arrays of one structure; `apply` on
    one sample is (n,), finite, pure, differentiable, and the same under jit and vmap; `predict` is `apply` over all
    samples; the same key gives the same fit; `members` average to `predict`; run.h5 gives the model back.

    Args:
        dataset: a few hundred moving samples, with a robot if the model needs one.
        key: of everything random.
    """
    key = jax.random.key(0) if key is None else key
    who = _frozen(model)
    params = model.init(dataset, key)
    _nested_dict(who, "init", params)
    fit = model.fit(dataset, key, validation=dataset)
    _fit(who, fit, dataset, params)
    again = model.fit(dataset, key, validation=dataset)
    _claim(_same(fit.params, again.params), f"{who}.fit gives other parameters when called again with the same key")
    samples, torque = _samples(dataset.motion, 50), np.abs(dataset.tau).max()
    _apply(f"{who}.apply before learning", model, params, samples, fit.robot, torque)
    each = _apply(f"{who}.apply", model, fit.params, samples, fit.robot, torque)
    _pure(f"{who}.apply", model, fit, _row(samples, 0), each[0], torque)
    if not model.needs_robot:
        alone = replace(dataset, robot=None)
        one = jax.eval_shape(lambda p: model.apply(p, _row(samples, 0), None), model.init(alone, key))
        _claim(one.shape == (len(dataset.joints),), f"{who} says that it needs no robot, but gives no torque without")
    _gradients(who, model, fit, samples)
    said = model.predict(fit, samples)
    _claim(isinstance(said, np.ndarray), f"{who}.predict gives {type(said).__name__}; allowed: a numpy array")
    _claim(said.shape == each.shape, f"{who}.predict gives {said.shape} for a motion {each.shape}")
    if model.has_memory:
        rows = [model.predict(fit, samples[slice(row, row + 1)]) for row in range(len(samples))]
        _close(f"{who}.predict and apply on each sample alone", np.concatenate(rows), each, torque)
        half = model.predict(fit, samples[slice(0, len(samples) // 2)])
        _close(f"{who}.predict with and without later samples", half, said[: len(half)], torque)
    else:
        _close(f"{who}.predict and apply on every sample", said, each, torque)
    members = model.members(fit)
    mean = np.mean([model.predict(member, samples) for member in members], axis=0)
    _close(f"{who}.predict and the mean over its {len(members)} members", said, mean, torque)
    _round_trip(who, model, fit, samples, said)


def check_adapter(adapter: AbstractAdapter, model: AbstractModel, dataset: Dataset) -> None:
    """The adapter keeps the contract of AbstractAdapter with this model on this dataset.

    Checked: a frozen, hashable dataclass; `fit` gives a Fit; before any update `predict` is the fitted model; `predict`
    and `update` are pure, jit as they are, and run in `lax.scan`, the state keeping its structure; torques are finite.
    """
    who = _frozen(adapter)
    fit = adapter.fit(model, dataset, jax.random.key(0))
    _claim(isinstance(fit, Fit), f"{who}.fit gives {type(fit).__name__}; allowed: a Fit")
    start = adapter.init(model, fit)
    motion, tau = dataset.motion[slice(0, 64)], dataset.tau[:64]
    torque = np.abs(dataset.tau).max()
    first = _row(motion, 0)
    said = adapter.predict(model, start, first)
    _claim(
        np.shape(said) == (len(dataset.joints),), f"{who}.predict gives {np.shape(said)} for one sample; allowed: (n,)"
    )
    _close(f"{who}.predict before any update and the fitted model", said, model.predict(fit, motion)[0], torque)
    before = _numbers(start)
    after = adapter.update(model, start, first, tau[0])
    _claim(
        all(map(np.array_equal, before, _numbers(start))),
        f"{who}.update changes the state that it is given instead of giving a new one",
    )
    _claim(_shapes(after) == _shapes(start), f"{who}.update changes the structure, a shape or a type of the state")
    _claim(_same(after, adapter.update(model, start, first, tau[0])), f"{who}.update called twice gives two states")

    def step(state, sample):
        one, measured = sample
        return adapter.update(model, state, one, measured), adapter.predict(model, state, one)

    last, scanned = jax.lax.scan(step, jax.tree.map(jnp.asarray, start), (motion, tau))
    _claim(bool(np.isfinite(scanned).all()), f"{who} predicts numbers that are not finite within {len(tau)} updates")
    state, looped = start, []
    jitted = jax.jit(step)
    for row in range(len(tau)):
        state, prediction = jitted(state, (_row(motion, row), tau[row]))
        looped.append(prediction)
    _close(f"{who} sample by sample and in lax.scan", np.array(looped), scanned, torque)
    _claim(_shapes(last) == _shapes(state), f"{who} ends in states of two structures sample by sample and in lax.scan")


def check_source(source: AbstractSource, robot: Robot | None) -> None:
    """The source keeps the contract of AbstractSource for this robot (None where the data need none).

    Checked: a frozen dataclass; the same data whenever it loads; a "test" among the tests; shapes, joints, clocks that
    run forward, finite numbers; no sample in two of train, validation and a test; a description that JSON can hold.
    """
    _claim(_is_frozen(source), f"{type(source).__name__} is not a frozen dataclass")
    who = type(source).__name__
    header = source.header()
    _claim(
        header is None or isinstance(header, Header),
        f"{who}.header gives {type(header).__name__}; allowed: a Header, None",
    )
    shares: list[float] = []
    splits = source.load(robot, lambda share, note: shares.append(share))
    _claim(isinstance(splits, Splits), f"{who}.load gives {type(splits).__name__}; allowed: Splits")
    _claim(all(0 <= x <= 1 for x in shares), f"{who}.load reports a progress outside 0 to 1")
    digests = experiment.digest(splits), experiment.digest(source.load(robot))
    _claim(digests[0] == digests[1], f"{who}.load gives other data when called again")
    _claim("test" in splits.tests, f"{who}.load has tests {sorted(splits.tests)}; required: 'test'")
    sets = splits.sets
    for name, data in sets.items():
        _dataset(f"{who}: {name}", data, splits.train.joints, robot)
    rows = {name: set(_rows(data)) for name, data in sets.items()}
    for one, other in combinations(rows, 2):
        shared = len(rows[one] & rows[other])
        judged = one in splits.tests and other in splits.tests
        _claim(judged or not shared, f"{who}: {one} and {other} share {shared} samples")
    try:
        json.dumps(dict(splits.description))
    except (TypeError, ValueError) as error:
        raise AssertionError(f"{who}: the description cannot be written as JSON: {error}") from None


def _claim(holds: bool, sentence: str) -> None:
    if not holds:
        raise AssertionError(sentence)


def _close(what: str, one: Any, other: Any, size: float) -> None:
    one, other = np.asarray(one), np.asarray(other)
    size = max(size, float(np.abs(other).max(initial=0)))
    worst = float(np.abs(one - other).max(initial=0))
    _claim(worst <= ROUNDING * size, f"{what} differ by up to {worst:.3g} of {size:.3g}; allowed: {ROUNDING:g} of it")


def _frozen(value: Any) -> str:
    """The name of its class, once it is a frozen dataclass that can be hashed (jit takes it as a static argument)."""
    who = type(value).__name__
    _claim(_is_frozen(value), f"{who} is not a frozen dataclass")
    try:
        hash(value)
    except TypeError as error:
        raise AssertionError(
            f"{who} cannot be hashed ({error}): give its fields tuples in the place of lists and dicts"
        ) from None
    _claim(value == replace(value), f"{who} is not equal to its own copy: jit would compile it anew each time")
    return who


def _is_frozen(value: Any) -> bool:
    return is_dataclass(value) and type(value).__dataclass_params__.frozen  # type: ignore[attr-defined]


def _nested_dict(who: str, method: str, params: PyTree) -> None:
    _claim(
        isinstance(params, Mapping), f"{who}.{method} gives {type(params).__name__}; allowed: a nested dict of arrays"
    )
    for name, value in params.items():
        _claim(
            isinstance(name, str) and "/" not in name, f"{who}.{method} has a key {name!r}; allowed: text without '/'"
        )
        if isinstance(value, Mapping):
            _nested_dict(who, method, value)
        else:
            _claim(
                isinstance(value, jax.Array | np.ndarray | np.generic),
                f"{who}.{method} holds {type(value).__name__} at {name!r}; allowed: arrays in nested dicts",
            )


def _fit(who: str, fit: Fit, dataset: Dataset, params: PyTree) -> None:
    _claim(isinstance(fit, Fit), f"{who}.fit gives {type(fit).__name__}; allowed: a Fit")
    _nested_dict(who, "fit", fit.params)
    _claim(
        _shapes(fit.params, kinds=False) == _shapes(params, kinds=False),
        f"{who}.fit gives parameters of another structure or other shapes than init",
    )
    _claim(fit.joints == dataset.joints, f"{who}.fit names the joints {fit.joints}; required: {dataset.joints}")
    _claim(fit.parameters >= 0, f"{who}.fit counts {fit.parameters} parameters")
    _claim(all(isinstance(x, str) for x in fit.warnings), f"{who}.fit has warnings that are not sentences")
    for name, curve in fit.history.items():
        good = np.ndim(curve) == 3 and np.shape(curve)[2] == len(dataset.joints)
        _claim(good, f"{who}.fit has history {name!r} of shape {np.shape(curve)}; allowed: (epochs, members, n)")


@jax.jit(static_argnums=0)
def _one(model: AbstractModel, params: PyTree, one: Motion, robot: Robot | None) -> Array:
    return model.apply(params, one, robot)


@jax.jit(static_argnums=0)
def _all(model: AbstractModel, params: PyTree, samples: Motion, robot: Robot | None) -> Array:
    return jax.vmap(lambda one: model.apply(params, one, robot))(samples)


def _apply(
    what: str, model: AbstractModel, params: PyTree, samples: Motion, robot: Robot | None, torque: float
) -> np.ndarray:
    """Torques (S, n) of the samples by vmap, after their shape and values were checked."""
    shape = samples.q.shape
    jitted = _one(model, params, _row(samples, 0), robot)
    _claim(jitted.shape == shape[1:], f"{what} gives {jitted.shape} for one sample; allowed: {shape[1:]}")
    together = np.asarray(_all(model, params, samples, robot))
    _claim(bool(np.isfinite(together).all()), f"{what} gives numbers that are not finite")
    _close(f"{what} on one sample and under vmap", jitted, together[0], torque)
    return together


def _pure(what: str, model: AbstractModel, fit: Fit, one: Motion, mapped: np.ndarray, torque: float) -> None:
    before = _numbers((fit.params, one))
    plain = model.apply(fit.params, one, fit.robot)
    first, second = (jax.make_jaxpr(lambda p: model.apply(p, one, fit.robot))(fit.params) for _ in range(2))
    pure = str(first) == str(second) and _same(first.consts, second.consts)
    _claim(pure, f"{what} is not pure: called twice with the same numbers it computes two different things")
    _claim(_equal(before, (fit.params, one)), f"{what} is not pure: it changes what it is given")
    _close(f"{what} as it is and under jit and vmap", plain, mapped, torque)


def _gradients(who: str, model: AbstractModel, fit: Fit, samples: Motion) -> None:
    """Checks that gradients are finite everywhere, also at rest, and along a random direction equal to finite
    differences, except at kinks."""
    rng = np.random.default_rng(0)
    leaves, tree = jax.tree.flatten(fit.params)
    real = [i for i, leaf in enumerate(leaves) if jnp.issubdtype(jnp.asarray(leaf).dtype, jnp.floating)]

    def weighted(numbers: list, one: Motion):
        whole = [*leaves]
        for i, leaf in zip(real, numbers, strict=True):
            whole[i] = leaf
        return weights @ _one(model, jax.tree.unflatten(tree, whole), one, fit.robot)

    numbers = [jnp.asarray(leaves[i]) for i in real]
    still = jnp.zeros(samples.q.shape[1])
    moving = np.argmax((np.abs(samples.qd) / (np.abs(samples.qd).max(axis=0) + 1e-300)).min(axis=1))
    weights = rng.normal(size=samples.q.shape[1])

    slope = jax.jit(jax.grad(weighted, argnums=(0, 1)))
    for words, one in (("a moving sample", _row(samples, int(moving))), ("rest", Motion(still, still, still))):
        for name, gradient in zip(("parameters", "motion"), slope(numbers, one), strict=True):
            finite = all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))
            _claim(finite, f"{who}.apply has a gradient in its {name} at {words} that is not finite")
    one = _row(samples, int(moving))
    sizes = jax.tree.map(lambda x: np.sqrt(np.mean(np.square(x), axis=0)), samples)
    ways = {
        "parameters": (
            lambda x: weighted(x, one),
            numbers,
            [_size(leaf) * rng.normal(size=leaf.shape) for leaf in numbers],
        ),
        "motion": (lambda x: weighted(numbers, x), one, jax.tree.map(lambda s: s * rng.normal(size=s.shape), sizes)),
    }
    for (name, (function, at, direction)), gradient in zip(ways.items(), slope(numbers, one), strict=True):
        parts = [float(np.vdot(g, d)) for g, d in zip(*map(jax.tree.leaves, (gradient, direction)), strict=True)]
        _slopes(f"{who}.apply's gradient in its {name}", sum(parts), sum(map(abs, parts)), function, at, direction)


def _slopes(what: str, said: float, size: float, function: Callable, at: PyTree, direction: PyTree) -> None:
    def moved(step: float) -> float:
        return float(function(jax.tree.map(lambda x, d: (x + step * d).astype(x.dtype), at, direction)))

    at = jax.tree.map(np.asarray, at)
    measured = [(moved(step) - moved(-step)) / (2 * step) for step in STEPS]
    nearest = min(measured, key=lambda x: abs(x - said))
    allowed = SLOPE * max(size, min(map(abs, measured)))
    _claim(
        abs(nearest - said) <= allowed,
        f"{what} gives a slope of {said:.4g} where finite differences give {nearest:.4g}",
    )


def _size(leaf: Any) -> float:
    return float(np.sqrt(np.mean(np.square(leaf)))) or 1.0 if np.size(leaf) else 1.0


def _round_trip(who: str, model: AbstractModel, fit: Fit, samples: Motion, said: np.ndarray) -> None:
    try:
        again = registry.decode(registry.encode(model), AbstractModel, [type(model).__module__])
    except InvdynError as error:
        raise AssertionError(f"{who} cannot be saved and loaded again: {error}") from error
    _claim(again == model, f"{who} is not the same after saving and loading its fields")
    record = RunRecord({"seed": 0}, model, Batch(), fit, {}, {}, {}, {}, {}, {}, "")
    with tempfile.TemporaryDirectory() as folder:
        store.write_run(record, Path(folder) / "run.h5")
        loaded = store.load_model(Path(folder) / "run.h5", [type(model).__module__])
    told = loaded.predict(samples.q, samples.qd, samples.qdd)
    _claim(np.array_equal(told, said), f"{who} predicts other torques once written to run.h5 and read back")


def _dataset(what: str, data: Dataset, joints: tuple[str, ...], robot: Robot | None) -> None:
    _claim(data.joints == joints, f"{what} has joints {data.joints}; required: {joints}, as in train")
    _claim(
        robot is None or len(joints) == robot.dofs,
        f"{what} has {len(joints)} columns for {robot and robot.dofs} joints",
    )
    _claim(data.samples > 0, f"{what} has no samples")
    for x in data.trajectories:
        shape = (len(x.t), len(joints))
        arrays = {"q": x.motion.q, "qd": x.motion.qd, "qdd": x.motion.qdd, "tau": x.tau}
        for name, array in arrays.items():
            _claim(np.shape(array) == shape, f"{what}, {x.name}: {name} has shape {np.shape(array)}; required: {shape}")
            _claim(bool(np.isfinite(array).all()), f"{what}, {x.name}: {name} has numbers that are not finite")
        _claim(bool(np.all(np.diff(x.t) > 0)), f"{what}, {x.name}: the clock does not run forward")


def _rows(data: Dataset) -> Iterator[bytes]:
    for x in data.trajectories:
        table = np.column_stack([x.t, x.motion.q, x.motion.qd, x.motion.qdd, x.tau]).astype(float)
        yield from (row.tobytes() for row in table)


def _samples(motion: Motion, count: int) -> Motion:
    """That many samples, evenly spread over the motion."""
    rows = np.linspace(0, len(motion) - 1, count).astype(int)
    return motion[rows]


def _row(motion: Motion, row: int) -> Motion:
    return jax.tree.map(lambda x: jnp.asarray(x[row]), motion)


def _shapes(tree: PyTree, *, kinds: bool = True) -> Any:
    leaves, structure = jax.tree.flatten(tree)
    return structure, [(np.shape(x), jnp.asarray(x).dtype if kinds else None) for x in leaves]


def _same(one: PyTree, other: PyTree) -> bool:
    return _equal(_numbers(one), other)


def _equal(numbers: list[np.ndarray], tree: PyTree) -> bool:
    pairs = list(zip(numbers, _numbers(tree), strict=True))
    return all(np.array_equal(x, y, equal_nan=x.dtype.kind in "fc") for x, y in pairs)


def _numbers(tree: PyTree) -> list[np.ndarray]:
    """Copies of all arrays in a tree, random keys as their numbers."""
    leaves = [jnp.asarray(leaf) if not isinstance(leaf, np.ndarray) else leaf for leaf in jax.tree.leaves(tree)]
    keys = [jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key) for leaf in leaves]
    return [np.array(jax.random.key_data(x) if key else x) for x, key in zip(leaves, keys, strict=True)]
