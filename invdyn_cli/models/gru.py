"""model=gru: a gated recurrent unit along the recording (Cho et al. 2014), for all joints at once.

The part of a torque that depends on the past (a gear that was last pushed the other way, a drive that lags) is not a
function of the present state. The paper's outlook names recurrent structures.
"""

from dataclasses import dataclass

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np

from invdyn_cli import training
from invdyn_cli.chunks import padded
from invdyn_cli.fields import counts, positive
from invdyn_cli.interfaces import AbstractModel, Progress, silent
from invdyn_cli.maths.scaling import standardisation, standardised
from invdyn_cli.models import network
from invdyn_cli.types import Array, Dataset, Fit, Motion, PyTree, Robot


class _Head(nn.Module):
    """From the unit's memory and the present input to the torques."""

    width: int
    outputs: int

    @nn.compact
    def __call__(self, x: Array) -> Array:
        wide = nn.relu(nn.Dense(self.width)(x))
        return nn.Dense(self.outputs)(wide)


@dataclass(frozen=True)
class Gru(AbstractModel):
    """h_t = GRU(h_(t-1), x_t), tau_t = head(h_t, x_t); h is zero before a recording's first sample.

    It remembers samples, not seconds: data to predict have the rate of the data that it learned from. It is not adapted
    while the robot works.

    Attributes:
        memory: number of units in the recurrent state.
        hidden: width of the head's hidden layer.
        window: [samples] length of the stretches that it is trained on, each from a memory of zero (truncated
            backpropagation through time); they overlap by half.
        epochs: passes over the stretches.
        batch_size: [stretches] size of a training batch.
        learning_rate: [-] step size of Adam at the start; it falls to zero.
    """

    needs_robot = False
    has_memory = True

    memory: int = 64
    hidden: int = 100
    window: int = 100
    epochs: int = 100
    batch_size: int = 16
    learning_rate: float = 0.003

    def __post_init__(self) -> None:
        counts(self, "model", "memory", "hidden", "window", "epochs", "batch_size")
        positive(self, "model", "learning_rate")

    def init(self, dataset: Dataset, key: jax.Array) -> PyTree:
        """Fresh weights and the standardisation of this dataset."""
        n = len(dataset.joints)
        one, other = jax.random.split(key)
        x, h = jnp.zeros(3 * n, jnp.float32), jnp.zeros(self.memory, jnp.float32)
        nets = {
            "unit": nn.GRUCell(self.memory).init(one, h, x)["params"],
            "head": _Head(self.hidden, n).init(other, jnp.concatenate([h, x]))["params"],
        }
        return {**standardisation(dataset.motion, dataset.tau), "nets": nets}

    def apply(self, params: PyTree, motion: Motion, robot: Robot | None) -> Array:
        """Torque (n,) of a recording's first sample."""
        return self._along(params, jax.tree.map(lambda x: jnp.asarray(x)[None], motion))[0]

    def predict(self, fit: Fit, motion: Motion) -> np.ndarray:
        """Torques (T, n) along a recording, from a memory of zero."""
        if not len(motion):
            return np.empty(motion.q.shape)
        size = 1 << (len(motion) - 1).bit_length()  # few shapes, few compilations
        return np.asarray(_along(self, fit.params, padded(motion, size)), float)[: len(motion)]

    def fit(
        self, dataset: Dataset, key: jax.Array, *, validation: Dataset | None = None, progress: Progress = silent
    ) -> Fit:
        """Train on stretches. history: train_loss and validation_loss (epochs, 1, n), mean squared error of the
        standardised torque."""
        start, shuffles = jax.random.split(key)
        params = self.init(dataset, start)
        scales = {name: value for name, value in params.items() if name != "nets"}
        length = min(self.window, *(len(x.t) for x in dataset.trajectories))
        watched = _stretches(scales, validation, length) if validation else None
        nets, history = training.descend(
            self._loss, params["nets"], {}, _stretches(scales, dataset, length),
            watched if watched is not None and len(watched[0]) else None,
            training.Schedule(self.epochs, self.batch_size), self.learning_rate, shuffles, progress,
        )  # fmt: skip
        return network.trained(dataset, scales, nets, history)

    def _along(self, params: PyTree, motion: Motion) -> Array:
        x = jnp.concatenate([motion.q, motion.qd, motion.qdd], axis=1)
        x = ((x - params["input_mean"]) / params["input_scale"]).astype(jnp.float32)
        said = self._outputs(params["nets"], x)
        return params["target_mean"] + params["target_scale"] * said.astype(float)

    def _outputs(self, nets: PyTree, x: Array) -> Array:
        """Standardised torques (T, n) along standardised inputs (T, 3 n)."""

        def step(h: Array, x: Array) -> tuple[Array, Array]:
            h = nn.GRUCell(self.memory).apply({"params": nets["unit"]}, h, x)[0]  # type: ignore[index]
            return h, h

        memory = jax.lax.scan(step, jnp.zeros(self.memory, jnp.float32), x)[1]
        outputs = nets["head"]["Dense_1"]["bias"].shape[0]
        return _Head(self.hidden, outputs).apply({"params": nets["head"]}, jnp.concatenate([memory, x], 1))  # type: ignore[return-value]

    def _loss(self, nets: PyTree, known: PyTree, batch: tuple[Array, Array]) -> Array:
        """Mean squared errors (n,) over the stretches of a batch."""
        x, y = batch
        return jnp.mean((jax.vmap(lambda one: self._outputs(nets, one))(x) - y) ** 2, (0, 1))


@jax.jit(static_argnums=0)
def _along(model: Gru, params: PyTree, motion: Motion) -> Array:
    return model._along(params, motion)


def _stretches(scales: PyTree, dataset: Dataset, length: int) -> tuple[Array, Array]:
    """Inputs (stretches, length, 3 n) and targets (stretches, length, n), standardised, float32, half overlapping; the
    last of a recording ends where it ends."""
    parts = []
    for one in dataset.trajectories:
        last = len(one.t) - length
        starts = sorted({*range(0, last + 1, max(1, length // 2)), last}) if last >= 0 else []
        x, y = standardised(scales, one.motion, one.tau)
        parts += [(x[s : s + length], y[s : s + length]) for s in starts]
    n = len(dataset.joints)
    x, y = (np.stack(side) for side in zip(*parts, strict=True)) if parts else (np.empty((0, 0, k * n)) for k in (3, 1))
    return jnp.asarray(x, jnp.float32), jnp.asarray(y, jnp.float32)
