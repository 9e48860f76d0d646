"""adaptation=incremental: networks continue to learn while the robot works, from the last samples (paper, IV-A)."""

import abc
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from invdyn_cli.adaptation.own_fit import AbstractOwnFit
from invdyn_cli.fields import counts, positive
from invdyn_cli.interfaces import AbstractModel
from invdyn_cli.maths.regression import torque_spread
from invdyn_cli.types import Array, Dataset, Fit, Motion, PyTree

SCALE = "torque_scale"
"""Name of the torques' standard deviation (n,) among a fit's details."""


class AbstractDescent(AbstractOwnFit):
    """Gradient descent on the squared error in the model's weights, on blocks of new samples only.

    Attributes:
        rate, batch_size, epochs, learning_rate, seed: as in `Incremental`.
    """

    rate: int
    batch_size: int
    epochs: int
    learning_rate: float
    seed: int

    if_diverged = "a lower adaptation.learning_rate may help"

    def __post_init__(self) -> None:
        counts(self, "", "rate", "batch_size", "epochs")
        positive(self, "", "learning_rate")

    @abc.abstractmethod
    def memory(self, weights: PyTree) -> PyTree:
        """The memory of the steps before the first step."""

    @abc.abstractmethod
    def step(self, weights: PyTree, memory: PyTree, slopes: PyTree, rate: Array) -> tuple[PyTree, PyTree]:
        """Weights and memory after a step along the gradient of the weights; `rate` is the learning rate."""

    @property
    def block(self) -> int:
        """The rate."""
        return self.rate

    def refuse(self, model: AbstractModel, dataset: Dataset, key: jax.Array) -> None:
        """Raise a UsageError for a model without weights."""
        model.weights(model.init(dataset, key))

    def details(self, model: AbstractModel, fit: Fit, dataset: Dataset) -> dict[str, Any]:
        """The torques' standard deviation (n,)."""
        return {SCALE: torque_spread(dataset)}

    def init(self, model: AbstractModel, fit: Fit) -> PyTree:
        """Parameters, robot, torque scale, learning rate, the memory of the steps, the samples (rate, n) that wait to
        be learned from, their number, and the number of updates so far."""
        empty = jnp.zeros((self.rate, len(fit.joints)))
        return {
            **super().init(model, fit),
            "scale": jnp.asarray(fit.details[SCALE]),
            "learning_rate": jnp.asarray(self.learning_rate),
            "memory": self.memory(model.weights(fit.params)),
            "motion": Motion(empty, empty, empty),
            "tau": empty,
            "waiting": jnp.array(0),
            "learned": jnp.array(0),
        }

    def update(self, model: AbstractModel, state: PyTree, motion: Motion, tau: Array) -> PyTree:
        """Store the sample; learn as soon as `rate` samples are stored."""
        at = state["waiting"]
        kept = jax.tree.map(lambda rows, row: rows.at[at].set(row), state["motion"], motion)
        state = {**state, "motion": kept, "tau": state["tau"].at[at].set(tau), "waiting": at + 1}
        full = state["waiting"] == self.rate
        return jax.lax.cond(full, lambda s: self.learn(model, s, s["motion"], s["tau"]), lambda s: s, state)

    def learn(self, model: AbstractModel, state: PyTree, motion: Motion, tau: Array) -> PyTree:
        """The state after `epochs` over these samples in shuffled batches."""
        motion, tau = jax.tree.map(jnp.asarray, (motion, tau))
        size = min(self.batch_size, self.rate)
        steps = self.rate // size
        key = jax.random.fold_in(jax.random.key(self.seed), state["learned"])
        orders = jax.vmap(lambda k: jax.random.permutation(k, self.rate))(jax.random.split(key, self.epochs))
        rows = orders[:, : steps * size].reshape(self.epochs * steps, size)
        batches = jax.tree.map(lambda x: x[rows], (motion, tau))

        def error(weights: PyTree, motion: Motion, tau: Array) -> Array:
            params = model.with_weights(state["params"], weights)
            said = jax.vmap(lambda one: model.apply(params, one, state["robot"]))(motion)
            return jnp.sum(jnp.mean(((tau - said) / state["scale"]) ** 2, axis=0))

        def step(carried: tuple[PyTree, PyTree], batch: tuple[Motion, Array]) -> tuple[tuple[PyTree, PyTree], None]:
            weights, memory = carried
            return self.step(weights, memory, jax.grad(error)(weights, *batch), state["learning_rate"]), None

        weights, memory = jax.lax.scan(step, (model.weights(state["params"]), state["memory"]), batches)[0]
        return {
            **state,
            "params": model.with_weights(state["params"], weights),
            "memory": memory,
            "waiting": jnp.array(0),
            "learned": state["learned"] + 1,
        }


@dataclass(frozen=True)
class Incremental(AbstractDescent):
    """The delta rule (Widrow and Hoff 1960): gradient descent on the squared error, on new samples only.

    Attributes:
        rate: [samples] number of new samples that are learned from at once and then discarded (lambda in the paper).
        batch_size: [samples] size of a batch; a last, incomplete one waits for the next epoch's shuffle.
        epochs: passes over the new samples.
        learning_rate: [-] step size of gradient descent, for errors in units of the training torques' standard
            deviation.
        seed: random seed of the shuffles.
    """

    rate: int = 100
    batch_size: int = 32
    epochs: int = 5
    learning_rate: float = 0.01
    seed: int = 0

    def memory(self, weights: PyTree) -> PyTree:
        """Nothing."""
        return {}

    def step(self, weights: PyTree, memory: PyTree, slopes: PyTree, rate: Array) -> tuple[PyTree, PyTree]:
        """One learning rate for all weights."""
        return jax.tree.map(lambda w, s: w - (rate * s).astype(w.dtype), weights, slopes), memory
