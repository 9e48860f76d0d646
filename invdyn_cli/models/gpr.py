"""model=gpr: Gaussian process regression, one process per joint (Rasmussen and Williams 2006, chapters 2, 5 and 8).

For inverse dynamics: Nguyen-Tuong, Seeger and Peters 2008, "Computed torque control with nonparametric regression".
"""

from collections.abc import Mapping
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from invdyn_cli.maths import gaussian_process as gp
from invdyn_cli.models.kernel_model import AbstractKernelModel
from invdyn_cli.types import Array, Motion, PyTree, Robot


@dataclass(frozen=True)
class Gpr(AbstractKernelModel):
    """A squared exponential kernel over the standardised state, with a length scale per input and hyperparameters by
    evidence.

    Attributes:
        exact: [samples] largest training set for exact inference, whose cost grows with the third power.
        inducing: number of inducing inputs for a larger training set, spread evenly over its samples.
        hyperparameter_samples: [samples] number of training samples from which hyperparameters are estimated.
        steps: iterations of L-BFGS on the evidence.
    """

    kernel = staticmethod(gp.squared_exponential)

    exact: int = 2000
    inducing: int = 500
    hyperparameter_samples: int = 400
    steps: int = 60

    def inputs(self, scales: PyTree, motion: Motion, robot: Robot | None) -> Array:
        """(3 n,) of one sample, or (T, 3 n) of a motion: the standardised state."""
        state = jnp.concatenate([motion.q, motion.qd, motion.qdd], axis=-1)
        return (state - scales["input_mean"]) / scales["input_scale"]

    def start(self, n: int) -> PyTree:
        """A length scale per input, all alike."""
        return gp.start(3 * n)

    def told(self, hyper: PyTree, scales: PyTree) -> Mapping[str, np.ndarray]:
        """Also the length scales (n, 3 n), in units of the state."""
        return {"length_scales": np.exp(hyper["scale"]) * scales["input_scale"], **super().told(hyper, scales)}

    def chunk(self, motion: Motion) -> int:
        """Fewer samples at a time: each one needs a covariance with every input of every joint."""
        return 512
