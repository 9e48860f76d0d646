"""What the models that are Gaussian processes share: one process per joint, hyperparameters by evidence."""

import abc
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import jax
import numpy as np

from invdyn_cli.chunks import in_chunks
from invdyn_cli.fields import counts
from invdyn_cli.interfaces import AbstractModel, Progress, silent
from invdyn_cli.maths import gaussian_process as gp
from invdyn_cli.maths.scaling import standardisation
from invdyn_cli.types import Array, Dataset, Fit, Motion, PyTree, Robot


@dataclass(frozen=True)
class AbstractKernelModel(AbstractModel):
    """A kernel over inputs that are made of the state, and a process with it for every joint.

    Exact inference up to `exact` samples; beyond, all samples are projected on inducing inputs (Snelson and Ghahramani
    2006). `variance` gives the predictive variance.

    Attributes:
        kernel: covariance (N, M) of one joint's standardised torque between inputs (N, k) and (M, k).
        exact, inducing, hyperparameter_samples, steps: as in model=gpr.
    """

    needs_robot = False
    kernel: ClassVar[gp.Gram]

    exact: int
    inducing: int
    hyperparameter_samples: int
    steps: int

    def __post_init__(self) -> None:
        counts(self, "model", "exact", "inducing", "hyperparameter_samples", "steps")

    @abc.abstractmethod
    def inputs(self, scales: PyTree, motion: Motion, robot: Robot | None) -> Array:
        """(k,) of one sample, or (T, k) of a motion, from the standardisation of the training data."""

    @abc.abstractmethod
    def start(self, n: int) -> PyTree:
        """Logarithms of one joint's hyperparameters at the start of their estimation, of an arm with n joints."""

    def told(self, hyper: PyTree, scales: PyTree) -> Mapping[str, np.ndarray]:
        """Hyperparameters in physical units, for the record."""
        return {"noise": np.exp(hyper["noise"]) * scales["target_scale"]}

    def init(self, dataset: Dataset, key: jax.Array) -> PyTree:
        """The prior: mean zero in the standardisation of this dataset."""
        n, scales = len(dataset.joints), standardisation(dataset.motion, dataset.tau)
        inputs = jax.eval_shape(lambda: self.inputs(scales, dataset.motion, dataset.robot)).shape[-1]
        return {**scales, **gp.blank(self.start(n), dataset.samples, inputs, n, self._sizes)}

    def apply(self, params: PyTree, motion: Motion, robot: Robot | None) -> Array:
        """Torque (n,) of one sample: the posterior mean."""
        x = self.inputs(params, motion, robot)
        return params["target_mean"] + params["target_scale"] * gp.mean(self.kernel, params, x)

    def fit(
        self, dataset: Dataset, key: jax.Array, *, validation: Dataset | None = None, progress: Progress = silent
    ) -> Fit:
        """Hyperparameters of largest evidence, then the posterior; details: what is `told`, (n, …) of every joint."""
        scales = standardisation(dataset.motion, dataset.tau)
        x = np.asarray(self.inputs(scales, dataset.motion, dataset.robot))
        y = (dataset.tau - scales["target_mean"]) / scales["target_scale"]
        learned = gp.learned(self.kernel, self.start(len(dataset.joints)), x, y, self._sizes, progress)
        finite = bool(np.isfinite(learned["coefficients"]).all())
        return Fit(
            params={**scales, **learned},
            robot=dataset.robot,
            joints=dataset.joints,
            parameters=learned["coefficients"].size + sum(leaf.size for leaf in jax.tree.leaves(learned["hyper"])),
            details=self.told(learned["hyper"], scales),
            warnings=() if finite else ("The kernel matrix is singular: fewer or less similar samples help.",),
        )

    def variance(self, fit: Fit, motion: Motion) -> np.ndarray:
        """Variance (T, n) [(N m)²; N²] of the torque without noise, at every sample of a motion."""

        def each(part: Motion) -> Array:
            x = self.inputs(fit.params, part, fit.robot)
            return gp.variance(self.kernel, fit.params, x) * fit.params["target_scale"] ** 2

        return in_chunks(each, motion, self.chunk(motion))

    @property
    def _sizes(self) -> gp.Sizes:
        return gp.Sizes(self.exact, self.inducing, self.hyperparameter_samples, self.steps)
