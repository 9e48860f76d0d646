"""model=svr: nu support vector regression, one machine per joint (Schölkopf et al. 2000), by scikit-learn's libsvm.

For inverse dynamics: Nguyen-Tuong, Peters, Seeger and Schölkopf 2008, "Learning inverse dynamics: a comparison".
"""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from invdyn_cli.errors import UsageError
from invdyn_cli.fields import counts, positive
from invdyn_cli.interfaces import AbstractModel, Progress, silent
from invdyn_cli.maths.scaling import spread_rows, standardisation, standardised, standardised_state
from invdyn_cli.types import Array, Dataset, Fit, Motion, PyTree, Robot


@dataclass(frozen=True)
class Svr(AbstractModel):
    """tau_j = sum_i a_ij exp(-gamma |x - x_i|²) + b_j on the standardised state; needs scikit-learn.

    Attributes:
        nu: [-] at least that share of the samples are support vectors, at most that share lie outside the tube.
        cost: [-] penalty of a sample outside of the tube (C), for torques in units of their spread.
        gamma: [-] inverse squared width of the kernel in standardised inputs; None: one over the number of inputs.
        samples: [samples] largest number of training samples, evenly spread; the time grows with the
            square.
        tolerance: [-] by how much the optimality conditions may be missed; a tenth of it takes ten times as long.
    """

    needs_robot = False

    nu: float = 0.5
    cost: float = 10.0
    gamma: float | None = None
    samples: int = 4000
    tolerance: float = 0.01

    def __post_init__(self) -> None:
        if not 0 < self.nu <= 1:
            raise UsageError(f"model.nu={self.nu}; allowed: above 0, at most 1")
        positive(self, "model", "cost", *["gamma"] * (self.gamma is not None), "tolerance")
        counts(self, "model", "samples")

    def init(self, dataset: Dataset, key: jax.Array) -> PyTree:
        """No support vectors yet: coefficients of zero."""
        n, rows = len(dataset.joints), min(self.samples, dataset.samples)
        scales = standardisation(dataset.motion, dataset.tau)
        zeros = {"inputs": (rows, 3 * n), "coefficients": (n, rows), "offset": (n,)}
        return {**scales, **{name: np.zeros(shape) for name, shape in zeros.items()}}

    def apply(self, params: PyTree, motion: Motion, robot: Robot | None) -> Array:
        """Torque (n,) of one sample."""
        x = standardised_state(params, motion)
        k = jnp.exp(-self._gamma(len(x)) * jnp.sum((x - params["inputs"]) ** 2, 1))
        return params["target_mean"] + params["target_scale"] * (params["coefficients"] @ k + params["offset"])

    def fit(
        self, dataset: Dataset, key: jax.Array, *, validation: Dataset | None = None, progress: Progress = silent
    ) -> Fit:
        """One machine per joint. details: support_vectors (n,).

        Raises:
            UsageError: if scikit-learn is not installed.
        """
        try:
            from sklearn.svm import NuSVR
        except ImportError as error:
            got = "model=svr needs scikit-learn, which is not installed"
            raise UsageError(got, advice='pip install "invdyn[sklearn]"') from error
        params = self.init(dataset, key)
        x, y = standardised(params, dataset.motion, dataset.tau)
        rows = spread_rows(len(x), self.samples)
        x, y = x[rows], y[rows]
        coefficients, offset = np.zeros((y.shape[1], len(x))), np.zeros(y.shape[1])
        for j, target in enumerate(y.T):
            gamma: Any = self._gamma(x.shape[1])  # scikit-learn's annotation knows its words alone
            machine = NuSVR(nu=self.nu, C=self.cost, gamma=gamma, tol=self.tolerance).fit(x, target)
            coefficients[j, machine.support_] = machine.dual_coef_[0]
            offset[j] = machine.intercept_[0]
            progress((j + 1) / y.shape[1], f"{len(machine.support_)} support vectors")
        return Fit(
            params={**params, "inputs": x, "coefficients": coefficients, "offset": offset},
            robot=dataset.robot,
            joints=dataset.joints,
            parameters=int(np.count_nonzero(coefficients)) + len(offset),
            details={"support_vectors": np.count_nonzero(coefficients, axis=1)},
        )

    def chunk(self, motion: Motion) -> int:
        """Fewer samples at a time: each one is compared with every support vector."""
        return 512

    def _gamma(self, inputs: int) -> float:
        return 1 / inputs if self.gamma is None else self.gamma
