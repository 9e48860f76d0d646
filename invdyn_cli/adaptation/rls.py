"""adaptation=rls: recursive least squares with forgetting on the parameters in which a model's torque is linear.

Ljung 1999, "System Identification", section 11.2 (equations 11.12 to 11.16); with parameters in which the torque is not
linear, as some of model=extended, the same with the gradient in the place of the columns (section 11.4, recursive
prediction errors). Forgetting stops while the covariance's trace is that of the prior, so that directions without
excitation do not grow without bound (Goodwin and Sin 1984, section 3.3).
"""

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from invdyn_cli.adaptation.own_fit import AbstractOwnFit
from invdyn_cli.chunks import CHUNK
from invdyn_cli.errors import UsageError
from invdyn_cli.interfaces import AbstractModel
from invdyn_cli.maths.metrics import rms
from invdyn_cli.maths.regression import torque_spread
from invdyn_cli.types import Array, Dataset, Fit, Motion, PyTree

LEAST_NOISE = 1e-3
"""Share of a joint's torque: smaller residuals on the training data count as that large (data without noise)."""

UNSEEN = 1e-9
"""Share of the largest column: a smaller column is rounding, and its parameter does not change."""


@dataclass(frozen=True)
class Rls(AbstractOwnFit):
    """theta <- theta + K (tau - prediction), for model=pest, standard, extended and rff.

    Attributes:
        forgetting: [-] factor per sample on what was learned before; 1 forgets nothing, 0.999 has a memory of 1,000
            samples.
        memory: [samples] number of samples that the training data count as at the start, at most their own number.
    """

    forgetting: float = 0.999
    memory: float = 1000.0

    if_diverged = "adaptation.forgetting nearer to 1 may help"

    def __post_init__(self) -> None:
        if not 0 < self.forgetting <= 1:
            raise UsageError(f"adaptation.forgetting={self.forgetting}; allowed: above 0, at most 1")
        if not self.memory >= 0:
            raise UsageError(f"adaptation.memory={self.memory}; allowed: a number of samples >= 0")

    def refuse(self, model: AbstractModel, dataset: Dataset, key: jax.Array) -> None:
        """Raise a UsageError for a model without linear parameters."""
        model.linear(model.init(dataset, key))

    def details(self, model: AbstractModel, fit: Fit, dataset: Dataset) -> dict[str, Any]:
        """What the training data tell about the parameters: rls_information (blocks, q, q), rls_noise and rls_spread
        (n,) [N m; N], and rls_samples."""
        spread = torque_spread(dataset)
        left = np.concatenate([x.tau - model.predict(fit, x.motion) for x in dataset.trajectories])
        noise = np.maximum(rms(left), LEAST_NOISE * spread)
        information = jnp.zeros(())
        motion = dataset.motion
        for start in range(0, len(motion), CHUNK):
            part = motion[slice(start, start + CHUNK)]
            information = information + _information(model, fit.params, fit.robot, noise, part)
        known = {"rls_information": np.asarray(information), "rls_noise": noise, "rls_samples": len(motion)}
        return {**known, "rls_spread": spread}

    def init(self, model: AbstractModel, fit: Fit) -> PyTree:
        """Parameters, robot, noise (n,), the covariance of the parameters (blocks, q, q) and the prior's scales
        (blocks, q): one block for all joints, or one per joint where the model is `by_joint`."""
        information, samples = jnp.asarray(fit.details["rls_information"]), float(fit.details["rls_samples"])
        noise = jnp.asarray(fit.details["rls_noise"])
        scale = self._scales(information / samples, jnp.asarray(fit.details["rls_spread"]) / noise)
        share = min(1.0, self.memory / samples)
        within = share * information * scale[:, :, None] * scale[:, None, :] + jnp.eye(scale.shape[1])
        covariance = scale[:, :, None] * jnp.linalg.inv(within) * scale[:, None, :]
        return {
            **super().init(model, fit),
            "noise": noise,
            "covariance": covariance,
            "scale": scale,
        }

    def update(self, model: AbstractModel, state: PyTree, motion: Motion, tau: Array) -> PyTree:
        """The parameters after one more sample."""
        said, columns = _columns(model, state["params"], motion, state["robot"])
        blocks = len(columns)
        errors = jnp.reshape((tau - said) / state["noise"], (blocks, -1))
        columns = columns / jnp.reshape(state["noise"], (blocks, -1, 1))
        step, covariance = jax.vmap(self._block)(state["covariance"], state["scale"], columns, errors)
        before = model.linear(state["params"])
        moved = jax.tree.map(lambda a, b: a + b.astype(a.dtype), before, _apart(before, step))
        return {**state, "params": model.with_linear(state["params"], moved), "covariance": covariance}

    def trace(self, state: PyTree) -> dict[str, Array]:
        """certainty: 1 minus the trace of the covariance as a share of the prior's; 0 where nothing is known."""
        return {"certainty": 1 - _share(state["covariance"], state["scale"]).mean()}

    def _block(self, covariance: Array, scale: Array, columns: Array, errors: Array) -> tuple[Array, Array]:
        """Change of the parameters (q,) and their covariance (q, q) by rows `columns` (o, q) with unit noise."""
        forgetting = jnp.where(_share(covariance, scale) <= self.forgetting, self.forgetting, 1.0)
        reach = covariance @ columns.T
        gain = jnp.linalg.solve(columns @ reach + forgetting * jnp.eye(len(columns)), reach.T).T
        covariance = (covariance - gain @ reach.T) / forgetting
        return gain @ errors, (covariance + covariance.T) / 2

    def _scales(self, squares: Array, ratio: Array) -> Array:
        """Standard deviations (blocks, q) of the parameters before any data: each parameter alone makes as much torque
        as the joints have in the training data; 0 for a parameter that makes none."""
        size = jnp.sqrt(jnp.diagonal(squares, axis1=1, axis2=2))
        torque = jnp.sqrt(jnp.sum(jnp.reshape(ratio**2, (len(squares), -1)), 1))[:, None]
        seen = size > UNSEEN * jnp.max(size)
        return jnp.where(seen, torque / jnp.where(seen, size, 1.0), 0.0)


def _share(covariance: Array, scale: Array) -> Array:
    """Trace of a covariance in units of the prior's, divided by the number of parameters that can change."""
    moves = scale > 0
    variances = jnp.diagonal(covariance, axis1=-2, axis2=-1) / jnp.where(moves, scale, 1.0) ** 2
    return jnp.sum(variances * moves, -1) / jnp.maximum(jnp.sum(moves, -1), 1)


def _columns(model: AbstractModel, params: PyTree, motion: Motion, robot: PyTree) -> tuple[Array, Array]:
    """Torque (n,) of one sample and its derivatives (blocks, outputs of a block, q) by the linear parameters."""

    def torque(linear: PyTree) -> Array:
        return model.apply(model.with_linear(params, linear), motion, robot)

    linear = model.linear(params)
    said, back = jax.vjp(torque, linear)
    if model.by_joint:
        return said, _together(back(jnp.ones_like(said))[0], len(said))[:, None]
    rows = jax.vmap(lambda one: _together(back(one)[0], 1)[0])(jnp.eye(len(said), dtype=said.dtype))
    return said, rows[None]


def _together(tree: PyTree, blocks: int) -> Array:
    """(blocks, q) numbers of a tree."""
    return jnp.concatenate([jnp.reshape(leaf, (blocks, -1)) for leaf in jax.tree.leaves(tree)], axis=1)


def _apart(tree: PyTree, numbers: Array) -> PyTree:
    """The numbers (blocks, q) in the shape of a tree."""
    leaves, structure = jax.tree.flatten(tree)
    ends = np.cumsum([np.size(leaf) // len(numbers) for leaf in leaves])[:-1]
    parts = jnp.split(numbers, ends, axis=1)
    return jax.tree.unflatten(structure, [jnp.reshape(x, np.shape(y)) for x, y in zip(parts, leaves, strict=True)])


@partial(jax.jit, static_argnums=0)
def _information(model: AbstractModel, params: PyTree, robot: PyTree, noise: Array, motion: Motion) -> Array:
    """Sum over samples of columns' columns (blocks, q, q), in units of the noise."""

    def add(total: Array, one: Motion) -> tuple[Array, None]:
        columns = _columns(model, params, one, robot)[1]
        columns = columns / jnp.reshape(noise, (len(columns), -1, 1))
        return total + jnp.einsum("boq,bor->bqr", columns, columns), None

    shape = jax.eval_shape(lambda one: _columns(model, params, one, robot)[1], jax.tree.map(lambda x: x[0], motion))
    start = jnp.zeros((shape.shape[0], shape.shape[2], shape.shape[2]))
    return jax.lax.scan(add, start, jax.tree.map(jnp.asarray, motion))[0]
