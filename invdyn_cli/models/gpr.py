"""model=gpr: Gaussian process regression, one process per joint (Rasmussen and Williams 2006, chapters 2, 5 and 8).

For inverse dynamics: Nguyen-Tuong, Seeger and Peters 2008, "Computed torque control with nonparametric regression".
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from invdyn_cli.chunks import in_chunks
from invdyn_cli.errors import UsageError
from invdyn_cli.interfaces import AbstractModel, Progress, silent
from invdyn_cli.maths import gaussian_process as gp
from invdyn_cli.maths.scaling import standardisation, standardised
from invdyn_cli.types import Array, Dataset, Fit, Motion, PyTree, Robot


@dataclass(frozen=True)
class Gpr(AbstractModel):
    """A squared exponential kernel over the standardised state, with a length scale per input and hyperparameters by
    evidence.

    Exact inference up to `exact` samples; beyond, all samples are projected on inducing inputs (section 8.3.4 of
    Rasmussen and Williams 2006; the posterior of Titsias 2009). `variance` gives the predictive variance.

    Attributes:
        exact: [samples] largest number for exact inference; its cost grows with the third power.
        inducing: number of inducing inputs beyond, evenly from the training samples.
        hyperparameter_samples: [samples] number of training samples from which hyperparameters are estimated.
        steps: iterations of L-BFGS on the evidence.
    """

    needs_robot = False

    exact: int = 2000
    inducing: int = 500
    hyperparameter_samples: int = 400
    steps: int = 60

    def __post_init__(self) -> None:
        for name in ("exact", "inducing", "hyperparameter_samples", "steps"):
            if not (isinstance(getattr(self, name), int) and getattr(self, name) >= 1):
                raise UsageError(f"model.{name}={getattr(self, name)}; allowed: a whole number >= 1")

    def init(self, dataset: Dataset, key: jax.Array) -> PyTree:
        """The prior: mean zero in the standardisation of this dataset."""
        n = len(dataset.joints)
        scales = standardisation(dataset.motion, dataset.tau)
        return {**scales, **gp.blank(gp.start(3 * n), dataset.samples, 3 * n, n, self._sizes)}

    def apply(self, params: PyTree, motion: Motion, robot: Robot | None) -> Array:
        """Torque (n,) of one sample: the posterior mean."""
        x = (jnp.concatenate([motion.q, motion.qd, motion.qdd]) - params["input_mean"]) / params["input_scale"]
        return params["target_mean"] + params["target_scale"] * gp.mean(gp.squared_exponential, params, x)

    def fit(
        self, dataset: Dataset, key: jax.Array, *, validation: Dataset | None = None, progress: Progress = silent
    ) -> Fit:
        """Hyperparameters of largest evidence, then the posterior.

        details: length_scales (n, 3 n) and noise (n,) [N m; N] of every joint.
        """
        scales = standardisation(dataset.motion, dataset.tau)
        x, y = standardised(scales, dataset.motion, dataset.tau)
        learned = gp.learned(gp.squared_exponential, gp.start(x.shape[1]), x, y, self._sizes, progress)
        hyper = learned["hyper"]
        finite = bool(np.isfinite(learned["coefficients"]).all())
        return Fit(
            params={**scales, **learned},
            robot=dataset.robot,
            joints=dataset.joints,
            parameters=learned["coefficients"].size + sum(leaf.size for leaf in jax.tree.leaves(hyper)),
            details={
                "length_scales": np.exp(hyper["scale"]) * scales["input_scale"],
                "noise": np.exp(hyper["noise"]) * scales["target_scale"],
            },
            warnings=() if finite else ("The kernel matrix is singular: fewer or less similar samples help.",),
        )

    def variance(self, fit: Fit, motion: Motion) -> np.ndarray:
        """Variance (T, n) [(N m)²; N²] of the torque without noise, at every sample of a motion."""
        params = fit.params

        def each(part: Motion) -> Array:
            x = (jnp.concatenate([part.q, part.qd, part.qdd], 1) - params["input_mean"]) / params["input_scale"]
            return gp.variance(gp.squared_exponential, params, x) * params["target_scale"] ** 2

        return in_chunks(each, motion, self.chunk(motion))

    @property
    def _sizes(self) -> gp.Sizes:
        return gp.Sizes(self.exact, self.inducing, self.hyperparameter_samples, self.steps)

    def chunk(self, motion: Motion) -> int:
        """Fewer samples at a time: each one needs a covariance with every input of every joint."""
        return 512
