"""One experiment on objects: source -> fit -> predict -> score -> RunRecord. No files, no config, no printing."""

import copy
import hashlib
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import jax
import numpy as np

from invdyn_cli import leftovers
from invdyn_cli.errors import UsageError, listed
from invdyn_cli.interfaces import AbstractAdapter, AbstractModel, AbstractSource, Progress, silent
from invdyn_cli.maths import metrics
from invdyn_cli.types import Dataset, Fit, Prediction, PyTree, Robot, RunRecord, Score, Splits

TIMED = 200
"""Blocks whose learning is timed."""

Stage = Callable[[str], Progress]
"""Opens a stage of the work with this name, and returns the function that reports its progress."""


@dataclass(frozen=True)
class Prepared:
    """What exists before an experiment begins: its data, the fit of its model, and its share of the time [s] for
    both."""

    splits: Splits
    fit: Fit
    data_seconds: float
    fit_seconds: float


def run(
    source: AbstractSource,
    model: AbstractModel,
    adaptation: AbstractAdapter,
    robot: Robot | None,
    *,
    seed: int = 0,
    stage: Stage = lambda name: silent,
    prepared: Prepared | None = None,
) -> RunRecord:
    """Make or read the data, learn, and score every set.

    Args:
        robot: None where the kinematics are unknown; then only sources and models that need none will do.
        seed: of everything random.
        prepared: data and fit, where these are there already.

    Raises:
        UsageError: if the source or the model needs a robot and there is none.
        LogError: if the source's log cannot be used as asked.
    """
    leftovers.clear()
    model = adaptation.extended(model)
    if robot is None and (source.needs_robot or model.needs_robot):
        who = "this data source" if source.needs_robot else f"the model {type(model).__name__}"
        raise UsageError(
            f"{who} needs the robot's kinematics, but these data have no URDF",
            advice="robot=urdf robot.path=arm.urdf, or a model that needs no robot (model=ffnn)",
        )
    if model.has_memory and adaptation.adapts:
        got = f"{type(model).__name__} needs the earlier samples of a recording"
        raise UsageError(
            f"{got}, but an adaptation takes samples one by one", advice="adaptation=batch, or a model without memory"
        )
    started = time.perf_counter()
    splits = prepared.splits if prepared else source.load(robot, stage("data"))
    if "test" not in splits.tests:
        got = f"the source {type(source).__name__} has no test set named test, only {listed(splits.tests)}"
        raise UsageError(f"{got}; allowed: one test set named test, and any others")
    fit_started = time.perf_counter()
    fit = adaptation.fit(
        _known(model, prepared.fit) if prepared else model,
        splits.train,
        jax.random.key(seed),
        validation=splits.validation,
        progress=stage("learn"),
    )
    fitted = time.perf_counter()
    judge, judged = stage("judge"), splits.sets
    predictions = {}
    for name, data in judged.items():
        predictions[name] = Prediction(data, predict(model, fit, data))
        judge(len(predictions) / len(judged), name)
    updates: dict[str, float] = {}
    trace: dict[str, np.ndarray] = {}
    if adaptation.adapts:
        test = splits.tests["test"]
        said, trace = follow(adaptation, model, fit, test)
        predictions["test_adapted"] = Prediction(test, said)
        told = diverged(adaptation, test, predictions["test"].tau, said)
        fit = replace(fit, warnings=(*fit.warnings, *told))
        took = update_times(adaptation, model, fit, test)
        updates = {f"update_{name}": float(np.percentile(took, x)) for name, x in (("p50", 50), ("p99", 99))}
    predicted = time.perf_counter()
    earlier = (prepared.data_seconds, prepared.fit_seconds) if prepared else (0.0, 0.0)
    members = model.members(fit)
    member_scores = {
        name: tuple(score(data, predict(model, member, data)) for member in members)
        for name, data in judged.items()
        if len(members) > 1
    }
    return RunRecord(
        choices={"seed": seed},
        model=model,
        adaptation=adaptation,
        fit=fit,
        predictions={name: p for name, p in predictions.items() if name != "train"},
        scores={name: score(p.data, p.tau) for name, p in predictions.items()},
        member_scores=member_scores,
        samples={name: p.data.samples for name, p in predictions.items()},
        seconds={
            "data": fit_started - started + earlier[0],
            "fit": fitted - fit_started + earlier[1],
            "predict": predicted - fitted,
            "total": time.perf_counter() - started + sum(earlier),
            **updates,
        },
        split=splits.description,
        digest=digest(splits),
        trace=trace,
    )


def _known(model: AbstractModel, fit: Fit) -> AbstractModel:
    """The same model, except that its `fit` returns the known result."""
    known = copy.copy(model)
    object.__setattr__(known, "fit", lambda dataset, key, **options: fit)
    return known


def predict(model: AbstractModel, fit: Fit, data: Dataset) -> np.ndarray:
    """Torques (samples, n) over all trajectories, each computed by itself: the memory of a model ends with a
    recording."""
    return np.concatenate([model.predict(fit, x.motion) for x in data.trajectories])


def follow(
    adaptation: AbstractAdapter, model: AbstractModel, fit: Fit, data: Dataset
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Torques (samples, n), each sample predicted before it is learned from, one trajectory after the other; and the
    adaptation's trace, (samples, …) by name, after each sample (after each block, where blocks are learned from)."""
    size, samples = adaptation.block, (data.motion, data.tau)
    whole = data.samples // size * size
    state, parts = adaptation.init(model, fit), []
    if whole:
        blocks = jax.tree.map(lambda x: x[:whole].reshape(whole // size, size, x.shape[1]), samples)
        state, (said, traced) = follow_blocks(adaptation, model, state, blocks)
        traced = {name: np.repeat(x, size, axis=0) for name, x in traced.items()}
        parts.append((np.asarray(said).reshape(whole, len(data.joints)), traced))
    if whole < data.samples:  # what fills no block is taken one by one
        parts.append(_samples(adaptation, model, state, jax.tree.map(lambda x: x[whole:], samples)))
    said, traces = zip(*parts, strict=True)
    return np.concatenate(said), {name: np.concatenate([x[name] for x in traces]) for name in traces[0]}


@partial(jax.jit, static_argnums=(0, 1))
def follow_blocks(adaptation: AbstractAdapter, model: AbstractModel, state: PyTree, blocks: PyTree) -> PyTree:
    """The state after a motion and its torques in blocks (blocks, block, n), and predictions and trace of each
    block."""

    def block(state: PyTree, part: tuple) -> tuple[PyTree, tuple]:
        said = jax.vmap(lambda one: adaptation.predict(model, state, one))(part[0])
        state = adaptation.learn(model, state, *part)
        return state, (said, adaptation.trace(state))

    return jax.lax.scan(block, state, blocks)


@partial(jax.jit, static_argnums=(0, 1))
def _samples(adaptation: AbstractAdapter, model: AbstractModel, state: PyTree, samples: PyTree) -> PyTree:
    """Torques and trace of samples (T, n), one after the other."""

    def sample(state: PyTree, one: tuple) -> tuple[PyTree, tuple]:
        said = adaptation.predict(model, state, one[0])
        state = adaptation.update(model, state, *one)
        return state, (said, adaptation.trace(state))

    return jax.lax.scan(sample, state, samples)[1]


def update_times(adaptation: AbstractAdapter, model: AbstractModel, fit: Fit, data: Dataset) -> np.ndarray:
    """Time [s] to learn from a block, called from Python, for each of at most TIMED blocks of the data."""
    size = adaptation.block
    learn = jax.jit(partial(adaptation.learn, model))
    state, motion, tau = adaptation.init(model, fit), data.motion, data.tau
    took = []
    for k in range(min(TIMED + 1, data.samples // size)):
        rows = slice(k * size, (k + 1) * size)
        started = time.perf_counter()
        state = jax.block_until_ready(learn(state, motion[rows], tau[rows]))
        took.append(time.perf_counter() - started)
    return np.array(took[1:] or [np.nan])  # the first one compiles


def diverged(adaptation: AbstractAdapter, data: Dataset, learned: np.ndarray, followed: np.ndarray) -> tuple[str, ...]:
    """A sentence if the predictions (samples, n) during adaptation are not finite although those before it were, or
    none."""
    finite = np.all(np.isfinite(followed), axis=1)
    lost = ~finite & np.all(np.isfinite(learned), axis=1)
    if not lost.any():
        return ()
    first = row = int(np.argmax(lost))
    for x in data.trajectories:
        if row < len(x.t):
            at = f"{x.t[row] - x.t[0]:.2f} s of {x.name}"
            how = "from there on" if not finite[first:].any() else "there"
            advice = f"; {adaptation.if_diverged}" if adaptation.if_diverged else ""
            return (f"the adaptation diverged at {at}: its torques are not finite {how}{advice}",)
        row -= len(x.t)
    return ()


def score(data: Dataset, prediction: np.ndarray) -> Score:
    """NMSE and RMSE of every joint over all trajectories together, NaN where a prediction is not finite."""
    finite = np.isfinite(prediction).all(axis=0)
    nmse, rmse = (np.where(finite, error(data.tau, prediction), np.nan) for error in (metrics.nmse, metrics.rmse))
    return Score(data.joints, nmse, rmse)


def digest(splits: Splits) -> str:
    """Sixteen hex digits that depend on every number in the data."""
    hashed = hashlib.sha256()
    for data in splits.sets.values():
        for x in data.trajectories:
            for array in (x.t, x.motion.q, x.motion.qd, x.motion.qdd, x.tau):
                hashed.update(np.ascontiguousarray(array, float).data)
    return hashed.hexdigest()[:16]
