"""model=gip: Gaussian process regression with the geometrically inspired polynomial kernel.

Dalla Libera and Carli 2020, "A data-efficient geometrically inspired polynomial kernel for robot inverse dynamics"
(IEEE RA-L 5(1)): a rigid body's torque is a polynomial in the accelerations, the products of velocities, and cosine
and sine of each revolute joint's angle (or the position of a prismatic one), of degree one in the former and two in
each joint's own. The kernel spans exactly such polynomials, by multiplicative polynomial kernels.
"""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from invdyn_cli.maths.regression import REST_SPEED
from invdyn_cli.models.kernel_model import AbstractKernelModel
from invdyn_cli.types import Array, Motion, PyTree, Robot


def kernel(hyper: PyTree, a: Array, b: Array) -> Array:
    """The kernel (N, M) between inputs (N, 5 n) and (M, 5 n): cosines, sines, velocities, accelerations, signs of the
    velocities; a position that slides stands in the place of its cosine, with a sine of zero."""
    (cosine, sine, qd, qdd, sign), other = jnp.split(a, 5, axis=1), jnp.split(b, 5, axis=1)
    weight = {name: jnp.exp(value) for name, value in hyper.items()}
    products, others = (v[:, :, None] * v[:, None, :] for v in (qd, other[2]))
    velocity = jnp.triu(weight["velocity"])
    k = weight["constant"] + (weight["acceleration"] * qdd) @ other[3].T
    k = k + jnp.einsum("aij,bij->ab", velocity * products, others)
    for s in range(2):
        for joint in range(cosine.shape[1]):
            c, d = (jnp.outer(x[:, joint], y[:, joint]) for x, y in ((cosine, other[0]), (sine, other[1])))
            k = k * (1 + weight["cosine"][s, joint] * c + weight["sine"][s, joint] * d)
    if "viscous" in weight:
        k = k + (weight["viscous"] * qd) @ other[2].T + (weight["coulomb"] * sign) @ other[4].T
    return k


@dataclass(frozen=True)
class Gip(AbstractKernelModel):
    """One process per joint; needs no URDF, but takes from one which joints slide.

    k = (c + sum_i a_i qdd_i qdd_i' + sum_(i<=j) v_ij qd_i qd_j qd_i' qd_j') prod_b k_b + friction, with
    k_b = prod_(s=1,2) (1 + g_bs cos q_b cos q_b' + h_bs sin q_b sin q_b'); all coefficients are learned by evidence.

    Attributes:
        friction: whether terms linear in every joint's velocity and its sign are added.
        exact, inducing, hyperparameter_samples, steps: as in model=gpr.
    """

    kernel = staticmethod(kernel)

    exact: int = 2000
    inducing: int = 1000
    hyperparameter_samples: int = 300
    steps: int = 60
    friction: bool = True

    def chunk(self, motion: Motion) -> int:
        """Fewer samples at a time: each one needs a covariance with every input of every joint."""
        return 256

    def start(self, n: int) -> PyTree:
        """Logarithms of the coefficients, all equal at the start; without friction its terms are absent."""
        zero = np.zeros(n)
        friction = {"viscous": zero - 4.0, "coulomb": zero - 4.0} if self.friction else {}
        return {
            "constant": np.array(0.0),
            "acceleration": zero - 2.0,
            "velocity": np.full((n, n), -3.0),
            "cosine": np.full((2, n), -1.0),
            "sine": np.full((2, n), -1.0),
            "noise": np.array(np.log(0.1)),
            **friction,
        }

    def inputs(self, scales: PyTree, motion: Motion, robot: Robot | None) -> Array:
        """(5 n,) of one sample, or (T, 5 n) of a motion; velocities and accelerations in units of their spread."""
        n = motion.q.shape[-1]
        slides = jnp.array(robot.prismatic if robot is not None else (False,) * n)
        place, speed, push = jnp.split(jnp.asarray(scales["input_scale"]), 3)
        cosine = jnp.where(slides, motion.q / place, jnp.cos(motion.q))
        sine = jnp.where(slides, 0.0, jnp.sin(motion.q))
        sign = jnp.clip(motion.qd / REST_SPEED, -1, 1)
        return jnp.concatenate([cosine, sine, motion.qd / speed, motion.qdd / push, sign], axis=-1)
