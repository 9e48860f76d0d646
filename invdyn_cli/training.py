"""Training of many small networks at once: minibatches and epochs in one `lax.scan`, `vmap` over networks of one shape.

A group is a stack of networks of one shape, each with its own target column, learning rate and seed; its training is
one compiled program, which serves all learning rates. Groups of different shapes run in parallel, one thread each:
padding them to a common shape, or one scan over all, takes about twice the time on a CPU.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import optax

from invdyn_cli.interfaces import Progress, silent
from invdyn_cli.maths.threads import takes_one_core
from invdyn_cli.types import Array, PyTree


class MLP(nn.Module):
    """Fully connected layers with ReLU between them and one linear output: (..., inputs) -> (...)."""

    hidden: tuple[int, ...]

    @nn.compact
    def __call__(self, x: Array) -> Array:
        for width in self.hidden:
            x = nn.relu(nn.Dense(width)(x))
        return nn.Dense(1)(x)[..., 0]


@dataclass(frozen=True)
class Group:
    """Nets of one shape: `hidden` widths, the `columns` of the target that they learn, a learning rate for each."""

    hidden: tuple[int, ...]
    columns: tuple[int, ...]
    learning_rates: tuple[float, ...]


@dataclass(frozen=True)
class Schedule:
    """Length and batches of the training: `epochs` over all rows, minibatches of `batch_size` rows (an incomplete last
    one waits for the next epoch's shuffle)."""

    epochs: int = 100
    batch_size: int = 32


class Data(NamedTuple):
    """Standardised inputs (N, d) and targets (N, n), float32."""

    x: Array
    y: Array


class Trained(NamedTuple):
    """Parameters of a group with leading axes (members, nets), and losses (epochs, members, nets); the validation's are
    NaN without validation data."""

    params: PyTree
    train_loss: np.ndarray
    validation_loss: np.ndarray


@partial(jax.jit, static_argnums=(0, 1, 2))
def initial(hidden: tuple[int, ...], columns: tuple[int, ...], inputs: int, keys: Array) -> PyTree:
    """Fresh parameters of a group's nets, leading axes (members, nets), from one key per member: member k does not
    depend on how many there are, and a net does not depend on which other joints share its shape."""
    net = MLP(hidden)
    blank = jnp.zeros((1, inputs), jnp.float32)
    per_net = jax.vmap(lambda key, column: net.init(jax.random.fold_in(key, column), blank)["params"], (None, 0))
    return jax.vmap(per_net, (0, None))(keys, jnp.array(columns))


def train(
    groups: Sequence[Group],
    schedule: Schedule,
    data: Data,
    validation: Data | None,
    keys: Array,
    progress: Progress = silent,
    rates: Sequence[np.ndarray] | None = None,
) -> list[Trained]:
    """Minimise the mean squared error of every net with Adam (Kingma and Ba 2015; optax defaults beside the rate).

    Args:
        keys: (members,) one key per member (seed); each member shuffles and starts on its own.
        rates: learning rates of each group, (members, nets), instead of the same for all members.
    """
    watch = _Watch(len(groups), progress)
    if rates is None:
        rates = [np.tile(group.learning_rates, (len(keys), 1)) for group in groups]
    jobs = [
        partial(_train_group, group, schedule, data, validation, keys, rates[i], partial(watch, i))
        for i, group in enumerate(groups)
    ]
    with ThreadPoolExecutor(1 if takes_one_core() else max(1, len(jobs))) as pool:
        return list(pool.map(lambda job: job(), jobs))


class _Watch:
    """Collects the shares and losses of the groups, and reports their means."""

    def __init__(self, groups: int, progress: Progress) -> None:
        self.shares, self.losses, self.progress = [0.0] * groups, [np.zeros(0)] * groups, progress

    def __call__(self, group: int, share: float, losses: np.ndarray) -> None:
        self.shares[group], self.losses[group] = share, losses
        self.progress(sum(self.shares) / len(self.shares), f"loss {np.mean(np.concatenate(self.losses)):.2e}")


def _train_group(
    group: Group,
    schedule: Schedule,
    data: Data,
    validation: Data | None,
    keys: Array,
    rates: np.ndarray,
    report: Callable[[float, np.ndarray], None],
) -> Trained:
    params = initial(group.hidden, group.columns, data.x.shape[1], keys)
    steps = jnp.asarray(rates, jnp.float32)
    state = params, jax.vmap(jax.vmap(_adam.init))(params)
    watched = validation if validation is not None and len(validation.x) else Data(data.x[:0], data.y[:0])
    bites = _bites(schedule.epochs)
    curves, done = [], 0
    for epochs in bites:
        state, losses = _epochs(
            group.hidden, group.columns, schedule.batch_size, epochs, state, data, watched, keys, steps, done
        )
        curves.append(jax.tree.map(np.asarray, losses))
        done += epochs
        report(done / schedule.epochs, curves[-1][0][-1].ravel())
    train_loss, validation_loss = (np.concatenate(c) for c in zip(*curves, strict=True))
    return Trained(jax.tree.map(np.asarray, state[0]), train_loss, validation_loss)


def _bites(epochs: int) -> list[int]:
    """Epochs in about 20 equal bites (few shapes, few compilations), so that progress can be told between them."""
    size = max(1, -(-epochs // 20))
    return [size] * (epochs // size) + [epochs % size] * (epochs % size > 0)


_adam = optax.scale_by_adam()


def descend(
    loss: Callable[[PyTree, PyTree, PyTree], Array],
    params: PyTree,
    known: PyTree,
    rows: PyTree,
    watched: PyTree,
    schedule: Schedule,
    rate: float,
    key: jax.Array,
    progress: Progress = silent,
) -> tuple[PyTree, dict[str, np.ndarray]]:
    """Minimise the sum of loss(params, known, batch) (k,) with Adam, its rate falling to zero along half a cosine
    (Loshchilov and Hutter 2017): params, and curves (epochs, 1, k) of the training and, where given, validation loss.

    Args:
        loss: a function at module level, or a method of a frozen dataclass, so that it is compiled once.
        known: what the loss needs beside.
        rows: arrays of one length, of which a batch takes the same rows.
        watched: such arrays of the validation data, or None.
    """
    state = params, _adam.init(params)
    curves, done = [], 0
    for epochs in _bites(schedule.epochs):
        state, losses = _descend(loss, schedule, epochs, state, known, rows, watched, rate, key, done)
        curves.append([np.asarray(x) for x in losses])
        done += epochs
        progress(done / schedule.epochs, f"loss {curves[-1][0][-1].mean():.2e}")
    names = ("train_loss", "validation_loss")[: len(curves[0])]
    joined = {name: np.concatenate(c)[:, None] for name, c in zip(names, zip(*curves, strict=True), strict=True)}
    return jax.tree.map(np.asarray, state[0]), joined


@partial(jax.jit, static_argnums=(0, 1, 2))
def _descend(loss, schedule: Schedule, epochs: int, state, known, rows, watched, rate: float, key, done: int):
    total = len(jax.tree.leaves(rows)[0])
    size = min(schedule.batch_size, total)
    steps = total // size

    def step(carried, at):
        (params, moments), count = carried
        batch = jax.tree.map(lambda x: x[at], rows)
        (_, each), slope = jax.value_and_grad(lambda p: (jnp.sum(x := loss(p, known, batch)), x), has_aux=True)(params)
        change, moments = _adam.update(slope, moments)
        now = 0.5 * rate * (1 + jnp.cos(jnp.pi * count / (schedule.epochs * steps)))
        params = jax.tree.map(lambda p, c: p - (now * c).astype(p.dtype), params, change)
        return ((params, moments), count + 1), each

    def epoch(state, number):
        order = jax.random.permutation(jax.random.fold_in(key, number), total)[: steps * size].reshape(steps, size)
        (state, _), losses = jax.lax.scan(step, (state, number * steps), order)
        told = (losses.mean(0),) if watched is None else (losses.mean(0), loss(state[0], known, watched))
        return state, told

    return jax.lax.scan(epoch, state, done + jnp.arange(epochs))


@partial(jax.jit, static_argnums=(0, 1, 2, 3), donate_argnums=4)
def _epochs(
    hidden: tuple[int, ...],
    targets: tuple[int, ...],
    batch: int,
    epochs: int,
    state,
    data: Data,
    validation: Data,
    keys: Array,
    rates: Array,
    done: int,
):
    """`epochs` more epochs of all nets of a group, learning rates (members, nets): state, (train, validation) losses
    (epochs, members, nets)."""
    net = MLP(hidden)
    columns = jnp.array(targets)
    batch = min(batch, len(data.x))
    steps = len(data.x) // batch
    table = jnp.concatenate([data.x, data.y[:, columns]], axis=1)

    def loss(params, x, y):
        return jnp.mean((net.apply({"params": params}, x) - y) ** 2)

    def learn(params, moments, rate, x, y):
        value, slope = jax.value_and_grad(loss)(params, x, y)
        step, moments = _adam.update(slope, moments)
        return jax.tree.map(lambda p, s: p - rate * s, params, step), moments, value

    def epoch(state, number):
        def member(state, key, rates):
            order = jax.random.permutation(jax.random.fold_in(key, number), len(table))[: steps * batch]
            batches = table[order].reshape(steps, batch, -1)

            def step(state, rows):
                params, moments = state
                x, y = rows[:, : data.x.shape[1]], rows[:, data.x.shape[1] :]
                params, moments, value = jax.vmap(learn, (0, 0, 0, None, 1))(params, moments, rates, x, y)
                return (params, moments), value

            state, losses = jax.lax.scan(step, state, batches)
            watched = jax.vmap(loss, (0, None, 1))(state[0], validation.x, validation.y[:, columns])
            return state, (losses.mean(0), watched)

        return jax.vmap(member)(state, keys, rates)

    return jax.lax.scan(epoch, state, done + jnp.arange(epochs))
