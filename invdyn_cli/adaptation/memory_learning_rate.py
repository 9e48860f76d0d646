"""adaptation=memory_learning_rate: networks continue to learn, with learned learning rates (Meier et al. 2018).

Meier, Kappler and Schaal 2018, "Online learning of a memory for learning rates" (ICRA). The rate of a weight is a
function of its gradient, stored by radial basis functions. If two successive gradients have the same sign, the rate
between them was too small; if the sign changed, it was too large.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from invdyn_cli.adaptation.incremental import AbstractDescent
from invdyn_cli.errors import UsageError
from invdyn_cli.types import Array, PyTree

SMALLEST, LARGEST = -8.0, 1.0
"""Decades of the gradients that the memory spans; errors are in units of the torques' standard deviation."""

LEAST = 1e-9
"""Smallest learning rate, as in the authors' code."""


@dataclass(frozen=True)
class MemoryLearningRate(AbstractDescent):
    """Gradient descent on new samples as adaptation=incremental, with a memory of learning rates for every array of
    weights.

    rate(g) = sum_k a_k(g) v_k / sum_k a_k(g), a_k Gaussians over log10 |g|. After each step log v_k rises by
    memory_rate times the mean of sign(g g_before), weighted by a_k(g_before). The paper has the gradients' product in
    the place of its sign, and v_k in that of its logarithm: then steps scale with the gradients, and a memory_rate that
    suits one net does not suit another.

    Attributes:
        rate: [samples] number of new samples that are learned from at once and then discarded.
        batch_size: [samples] size of a batch; a last, incomplete one waits for the next epoch's shuffle.
        epochs: passes over the new samples.
        learning_rate: [-] learning rate at the start, everywhere in the memory.
        highest: [-] largest learning rate that the memory may hold.
        memory_rate: [-] largest step of a learning rate's logarithm; 0 keeps it as it is.
        centres: number of radial basis functions.
        seed: random seed of the shuffles.
    """

    rate: int = 100
    batch_size: int = 32
    epochs: int = 5
    learning_rate: float = 0.01
    highest: float = 0.3
    memory_rate: float = 0.1
    centres: int = 19
    seed: int = 0

    if_diverged = "a lower adaptation.highest may help"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.highest >= self.learning_rate:
            raise UsageError(f"highest={self.highest}; allowed: learning_rate ({self.learning_rate}) or above")
        if not self.memory_rate >= 0:
            raise UsageError(f"memory_rate={self.memory_rate}; allowed: a number >= 0")
        if not (isinstance(self.centres, int) and self.centres >= 2):
            raise UsageError(f"centres={self.centres}; allowed: a whole number >= 2")

    def memory(self, weights: PyTree) -> PyTree:
        """For every array of weights: logarithms of the learning rates (centres,), relative to `learning_rate`, and the
        gradients of the step before."""
        return jax.tree.map(lambda w: {"rates": jnp.zeros(self.centres), "slope": jnp.zeros(w.shape, w.dtype)}, weights)

    def step(self, weights: PyTree, memory: PyTree, slopes: PyTree, rate: Array) -> tuple[PyTree, PyTree]:
        """The memory learns from the last step; then the weights change at the rates of the memory."""
        structure = jax.tree.structure(weights)
        parts = zip(
            structure.flatten_up_to(weights), structure.flatten_up_to(memory), jax.tree.leaves(slopes), strict=True
        )
        moved, kept = zip(*(self._moved(*part, rate) for part in parts), strict=True)
        return jax.tree.unflatten(structure, moved), jax.tree.unflatten(structure, kept)

    def _moved(self, weights: Array, memory: PyTree, slope: Array, rate: Array) -> tuple[Array, PyTree]:
        """One array of weights."""
        before = self._activity(memory["slope"])
        agreed = jnp.sign(slope) * jnp.sign(memory["slope"])
        total = jnp.sum(before, tuple(range(weights.ndim)))
        change = jnp.tensordot(agreed, before, weights.ndim) / jnp.where(total > 0, total, 1.0)
        lowest, highest = jnp.log(LEAST / self.learning_rate), jnp.log(self.highest / self.learning_rate)
        rates = jnp.clip(memory["rates"] + self.memory_rate * change, lowest, highest)
        activity = self._activity(slope)
        own = activity @ jnp.exp(rates).astype(slope.dtype) / jnp.sum(activity, -1)
        return weights - (rate * own * slope).astype(weights.dtype), {"rates": rates, "slope": slope}

    def _activity(self, slope: Array) -> Array:
        """Activity (…, centres) of the basis functions, whose width is their distance. Gradients beyond the first or
        last centre count as being at it."""
        centres = jnp.linspace(SMALLEST, LARGEST, self.centres, dtype=slope.dtype)
        place = jnp.clip(jnp.log10(jnp.abs(slope) + 1e-30), SMALLEST, LARGEST)
        return jnp.exp(-0.5 * ((place[..., None] - centres) / (centres[1] - centres[0])) ** 2)
