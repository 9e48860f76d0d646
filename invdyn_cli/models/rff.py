"""model=rff: random Fourier features, Bayesian linear regression in the spectrum of a Gaussian process.

Rahimi and Recht 2007 (features); Lázaro-Gredilla et al. 2010, equations 6 to 9 (sparse spectrum, evidence); for inverse
dynamics and with updates: Gijsberts and Metta 2013, "Real-time model learning using incremental sparse spectrum
Gaussian process regression".
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import cho_solve, solve_triangular

from invdyn_cli.fields import counts
from invdyn_cli.interfaces import AbstractModel, Progress, silent
from invdyn_cli.maths import gaussian_process as gp
from invdyn_cli.maths.scaling import spread_rows, standardisation, standardised, standardised_state
from invdyn_cli.types import Array, Dataset, Fit, Motion, PyTree, Robot


@dataclass(frozen=True)
class Rff(AbstractModel):
    """tau_j = w_j' phi_j(x), phi_j cosines and sines of random frequencies scaled by joint j's length scales.

    The kernel is the squared exponential of model=gpr, approximated by its spectrum; the cost per sample does not grow
    with the data, and adaptation=rls continues the regression while the robot works.

    Attributes:
        frequencies: number of random frequencies of a joint; each gives a cosine and a sine.
        hyperparameter_samples: [samples] number of training samples from which hyperparameters are estimated.
        steps: iterations of L-BFGS on the evidence.
    """

    needs_robot = False
    by_joint = True

    frequencies: int = 200
    hyperparameter_samples: int = 1500
    steps: int = 60

    def __post_init__(self) -> None:
        counts(self, "model", "frequencies", "hyperparameter_samples", "steps")

    def init(self, dataset: Dataset, key: jax.Array) -> PyTree:
        """Weights zero, frequencies drawn."""
        n = len(dataset.joints)
        return {
            **standardisation(dataset.motion, dataset.tau),
            "hyper": gp.each(gp.start(3 * n), n),
            "directions": np.asarray(jax.random.normal(key, (self.frequencies, 3 * n))),
            "weights": np.zeros((n, 2 * self.frequencies)),
        }

    def apply(self, params: PyTree, motion: Motion, robot: Robot | None) -> Array:
        """Torque (n,) of one sample: the posterior mean."""
        x = standardised_state(params, motion)
        each = jax.vmap(lambda hyper, w: _features(hyper, params["directions"], x[None])[0] @ w)
        return params["target_mean"] + params["target_scale"] * each(params["hyper"], params["weights"])

    def fit(
        self, dataset: Dataset, key: jax.Array, *, validation: Dataset | None = None, progress: Progress = silent
    ) -> Fit:
        """Hyperparameters of largest evidence on some of the samples, then the weights from all of them.

        details: length_scales (n, 3 n) and noise (n,) [N m; N] of every joint.
        """
        params = self.init(dataset, key)
        x, y = standardised(params, dataset.motion, dataset.tau)
        rows, n = spread_rows(len(x), self.hyperparameter_samples), y.shape[1]
        floor = jax.tree.map(lambda leaf: np.full_like(leaf, -np.inf), params["hyper"])
        floor["noise"] = np.full(n, np.log(gp.LEAST_NOISE))
        hyper = gp.minimise(
            _loss, params["hyper"], params["directions"], x[rows], y[rows],
            steps=self.steps, progress=progress, floor=floor,
        )  # fmt: skip
        moments = jnp.zeros((n, 2 * self.frequencies, 2 * self.frequencies)), jnp.zeros((n, 2 * self.frequencies))
        for start in range(0, len(x), gp.CHUNK):
            part = slice(start, start + gp.CHUNK)
            moments = _add(hyper, params["directions"], x[part], y[part], moments)
        weights = np.asarray(_weights(hyper, *moments))
        return Fit(
            params={**params, "hyper": hyper, "weights": weights},
            robot=dataset.robot,
            joints=dataset.joints,
            parameters=weights.size + sum(leaf.size for leaf in jax.tree.leaves(hyper)),
            details={
                "length_scales": np.exp(hyper["scale"]) * params["input_scale"],
                "noise": np.exp(hyper["noise"]) * params["target_scale"],
            },
        )

    def weights(self, params: PyTree) -> PyTree:
        """The coefficients of the features."""
        return {"weights": params["weights"]}

    def with_weights(self, params: PyTree, weights: PyTree) -> PyTree:
        """Other coefficients of the same features."""
        return {**params, **weights}

    def linear(self, params: PyTree) -> PyTree:
        """The coefficients of the features, joint by joint."""
        return self.weights(params)


def _features(hyper: PyTree, directions: Array, x: Array) -> Array:
    """(N, 2 frequencies), so that phi(x)' phi(z) approximates the kernel: weights have a variance of one."""
    angles = (x / jnp.exp(hyper["scale"])) @ directions.T
    size = jnp.exp(hyper["signal"]) / np.sqrt(len(directions))
    return size * jnp.concatenate([jnp.cos(angles), jnp.sin(angles)], axis=1)


def _factor(hyper: PyTree, square: Array) -> Array:
    """Lower Cholesky factor of phi' phi + noise²."""
    return jnp.linalg.cholesky(square + jnp.exp(2 * hyper["noise"]) * jnp.eye(len(square)))


def _loss(hyper: PyTree, directions: Array, x: Array, y: Array) -> Array:
    """Minus the log evidence (Lázaro-Gredilla et al. 2010, equation 8), summed over joints."""

    def one(hyper: PyTree, y: Array) -> Array:
        phi = _features(hyper, directions, x)
        lower = _factor(hyper, phi.T @ phi)
        said = solve_triangular(lower, phi.T @ y, lower=True)
        freedom = len(y) - len(lower)
        squares = (y @ y - said @ said) * jnp.exp(-2 * hyper["noise"])
        return 0.5 * squares + jnp.sum(jnp.log(jnp.diag(lower))) + freedom * hyper["noise"]

    return jnp.sum(jax.vmap(one, (0, 1))(hyper, y))


@jax.jit
def _add(hyper: PyTree, directions: Array, x: Array, y: Array, moments: tuple) -> tuple[Array, Array]:
    def one(part: tuple) -> tuple[Array, Array]:
        hyper, y, square, product = part
        phi = _features(hyper, directions, x)
        return square + phi.T @ phi, product + phi.T @ y

    return jax.lax.map(one, (hyper, y.T, *moments))


@jax.jit
def _weights(hyper: PyTree, squares: Array, products: Array) -> Array:
    return jax.vmap(lambda h, a, b: cho_solve((_factor(h, a), True), b))(hyper, squares, products)
