"""What the models that are linear in inertial parameters share: the torque of links and of further columns."""

from collections.abc import Iterable

import jax
import jax.numpy as jnp
import numpy as np

from invdyn_cli.chunks import in_chunks
from invdyn_cli.interfaces import AbstractModel
from invdyn_cli.maths import rigid_body
from invdyn_cli.types import Array, Motion, PyTree, Robot


def torque(robot: Robot, psi: Array, motion: Motion, values: Iterable[Array], columns: Iterable[Array]) -> Array:
    """Torque (n,) of one sample, or (n, T) of a motion (n, T): of links psi (n, 10), plus value (n,) times column."""
    tau = rigid_body.inverse_dynamics(robot, psi, motion.q, motion.qd, motion.qdd)
    for value, column in zip(values, columns, strict=True):
        tau = tau + jnp.reshape(value, (-1, *(1,) * (jnp.ndim(motion.q) - 1))) * column
    return tau


def torques(model: AbstractModel, params: PyTree, motion: Motion, robot: Robot | None) -> np.ndarray:
    """Torques (T, n) of a motion (T, n), by a model whose `apply` takes whole rows of samples (n, T): this is faster
    than vmap over samples."""
    return in_chunks(lambda part: _rows(model, params, part, robot), motion)


@jax.jit(static_argnums=0)
def _rows(model: AbstractModel, params: PyTree, motion: Motion, robot: Robot | None) -> Array:
    return model.apply(params, jax.tree.map(jnp.transpose, motion), robot).T
