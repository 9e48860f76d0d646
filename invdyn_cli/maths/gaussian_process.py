"""Gaussian process regression of one target by any kernel, vmapped over joints (Rasmussen and Williams 2006).

A kernel is a function gram(hyper, a, b) -> (N, M) of inputs a (N, d) and b (M, d); `hyper` is a dict of logarithms, and
holds "noise", that of the noise's standard deviation. Targets have mean zero and spread one.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax.flatten_util import ravel_pytree
from jax.scipy.linalg import cho_solve, solve_triangular

from invdyn_cli.interfaces import Progress, silent
from invdyn_cli.maths.scaling import spread_rows
from invdyn_cli.types import Array, PyTree

Gram = Callable[[PyTree, Array, Array], Array]

JITTER = 1e-8
"""Added to the diagonal of a kernel matrix, as a share of its mean, no more than the least noise adds: rounding
makes the smallest eigenvalues negative, of rows of an arm at rest, which are alike, more than of others."""

LEAST_NOISE = 1e-4
"""Share of the target's spread: a smaller noise is lost in the rounding of kernel matrices of some thousand rows."""

REACH = 8.0
"""Largest change of the logarithms of hyperparameters from their start: a factor of 3,000 in both directions."""

REFUSED = 10.0
"""Loss over that of the start, in lengths of the first step, of hyperparameters whose kernel matrix is singular: the
search takes a step of some hundredths of that instead. With an infinite loss it takes none, and ends there."""

NOISE_STEPS = 8
"""Iterations in which only the noise is learned, before a second start: where it is most of a target, as of another
model's residual, length scales otherwise shrink first until every sample stands alone, and stay there. Where there is
hardly any, the first start finds more evidence."""

CHUNK = 2048
"""Rows whose covariances with the inducing inputs are computed at once."""


def squared_exponential(hyper: PyTree, a: Array, b: Array) -> Array:
    """signal² exp(-sum_k (a_k - b_k)² / (2 scale_k²)), a scale per input (equation 5.1 there)."""
    a, b = a / jnp.exp(hyper["scale"]), b / jnp.exp(hyper["scale"])
    squares = jnp.sum(a**2, 1)[:, None] + jnp.sum(b**2, 1)[None] - 2 * a @ b.T
    return jnp.exp(2 * hyper["signal"] - 0.5 * jnp.maximum(squares, 0.0))


def minus_log_evidence(gram: Gram, hyper: PyTree, x: Array, y: Array) -> Array:
    """-log p(y | x, hyper) of one target y (N,) (equation 2.30 there)."""
    lower = _factor(gram, hyper, x)
    white = solve_triangular(lower, y, lower=True)
    return 0.5 * white @ white + jnp.sum(jnp.log(jnp.diag(lower))) + 0.5 * len(y) * jnp.log(2 * jnp.pi)


def minimise(
    loss: Callable,
    start: PyTree,
    *data: PyTree,
    steps: int,
    progress: Progress = silent,
    floor: PyTree | None = None,
    free: Sequence[str] = (),
) -> PyTree:
    """The hyperparameters near `start` that minimise loss(hyper, *data), by L-BFGS-B in at most so many steps.

    The loss is divided by its slope at the start: with bounds on all sides the first step is as long as the slope.

    Args:
        loss: a function at module level (or a partial of one that hashes), so that it is compiled once.
        floor: lower bounds, a tree like `start`; values of -inf leave those of REACH.
        free: names of the hyperparameters that change; none: all.
    """
    at, back = ravel_pytree(jax.tree.map(lambda x: jnp.asarray(x, float), start))
    at = np.asarray(at)
    held = {name: np.full(np.shape(x), bool(free) and name not in free) for name, x in start.items()}
    reach = np.where(ravel_pytree(held)[0], 0.0, REACH)
    lower = at - reach if floor is None else np.maximum(at - reach, np.asarray(ravel_pytree(floor)[0]))
    done = iter(range(1, 10**9))

    def evaluated(point: np.ndarray) -> tuple[float, np.ndarray]:
        value, slope = _value_and_slope(loss, back(jnp.asarray(point)), *data)
        return float(value), np.where(reach > 0, np.asarray(ravel_pytree(slope)[0]), 0.0)

    value, slope = evaluated(np.maximum(at, lower))
    unit = float(np.linalg.norm(slope)) or 1.0
    refused = value / unit + REFUSED

    def both(point: np.ndarray) -> tuple[float, np.ndarray]:
        value, slope = evaluated(point)
        progress(min(1.0, next(done) / (1.3 * steps)), f"minus log evidence {value:.4g}")
        finite = np.isfinite(value) and np.isfinite(slope).all()
        return (value / unit, slope / unit) if finite else (refused, np.zeros_like(point))

    bounds = list(zip(lower, at + reach, strict=True))
    found = scipy.optimize.minimize(
        both, np.maximum(at, lower), jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": steps}
    )
    return jax.tree.map(np.asarray, back(jnp.asarray(found.x)))


@dataclass(frozen=True)
class Sizes:
    """How much is computed: exact inference up to `exact` samples, beyond with `inducing` inputs; hyperparameters from
    `hyperparameter_samples` in `steps` iterations of L-BFGS."""

    exact: int
    inducing: int
    hyperparameter_samples: int
    steps: int


def blank(start: PyTree, samples: int, inputs: int, targets: int, sizes: Sizes) -> dict[str, PyTree]:
    """The prior, of the shapes that `learned` gives for so many samples, inputs and targets."""
    support = samples if samples <= sizes.exact else min(sizes.inducing, samples)
    spread = 0 if samples <= sizes.exact else support
    return {
        "hyper": each(start, targets),
        "inputs": np.zeros((support, inputs)),
        "coefficients": np.zeros((targets, support)),
        "spread": np.zeros((targets, spread, spread)),
    }


def learned(
    gram: Gram, start: PyTree, x: Array, y: Array, sizes: Sizes, progress: Progress = silent
) -> dict[str, PyTree]:
    """The posterior of every target of y (N, n) given x (N, d), hyperparameters by evidence from `start`: hyper (n, …),
    inputs (m, d), coefficients (n, m), and spread (n, m, m), empty after exact inference."""
    rows = spread_rows(len(x), sizes.hyperparameter_samples)
    hyper = learned_hyperparameters(gram, start, x[rows], y[rows], sizes.steps, progress)
    if len(x) <= sizes.exact:
        inputs, coefficients, spread = x, exact(gram, hyper, x, y), np.zeros((y.shape[1], 0, 0))
    else:
        inputs = x[spread_rows(len(x), sizes.inducing)]
        coefficients, spread = projected(gram, hyper, inputs, x, y)
    return {
        "hyper": hyper,
        "inputs": np.asarray(inputs),
        "coefficients": np.asarray(coefficients),
        "spread": np.asarray(spread),
    }


def learned_hyperparameters(
    gram: Gram, start: PyTree, x: Array, y: Array, steps: int, progress: Progress = silent
) -> PyTree:
    """The hyperparameters of largest evidence for every target of y (N, n), leading axis n."""
    first = each(start, y.shape[1])
    floor: dict = jax.tree.map(lambda leaf: np.full_like(leaf, -np.inf), first)
    floor["noise"] = np.full_like(first["noise"], np.log(LEAST_NOISE))
    loss, data = SummedEvidence(gram), (jnp.asarray(x), jnp.asarray(y))
    noisy = minimise(loss, first, *data, steps=NOISE_STEPS, floor=floor, free=("noise",))
    found = [minimise(loss, x, *data, steps=steps, progress=progress, floor=floor) for x in (first, noisy)]
    return min(found, key=lambda hyper: float(np.nan_to_num(_value_and_slope(loss, hyper, *data)[0], nan=np.inf)))


def start(inputs: int) -> PyTree:
    """Logarithms for `squared_exponential`: length scales that grow with the number of inputs, as distances do, a
    signal of one and a noise of a tenth."""
    return {"scale": np.full(inputs, 0.5 * np.log(inputs)), "signal": np.array(0.0), "noise": np.array(np.log(0.1))}


def each(start: PyTree, targets: int) -> PyTree:
    """The hyperparameters repeated for every target, as a leading axis."""
    return jax.tree.map(lambda leaf: np.repeat(np.asarray(leaf, float)[None], targets, 0), start)


def mean(gram: Gram, params: PyTree, x: Array) -> Array:
    """Posterior mean (n,) of every target at ONE input x (d,)."""
    k = jax.vmap(lambda hyper: gram(hyper, x[None], params["inputs"])[0])(params["hyper"])
    return jnp.sum(k * params["coefficients"], 1)


def variance(gram: Gram, params: PyTree, x: Array) -> Array:
    """Variance (M, n) of the noise-free targets at inputs x (M, d)."""
    if params["spread"].shape[1]:
        return projected_variance(gram, params["hyper"], params["inputs"], params["spread"], x).T
    return exact_variance(gram, params["hyper"], params["inputs"], x).T


@dataclass(frozen=True)
class SummedEvidence:
    """The summed loss of all targets for a kernel; equal for equal kernels, so that it is compiled once."""

    gram: Gram

    def __call__(self, hyper: PyTree, x: Array, y: Array) -> Array:
        return jnp.sum(jax.vmap(partial(minus_log_evidence, self.gram), (0, None, 1))(hyper, x, y))


@partial(jax.jit, static_argnums=0)
def exact(gram: Gram, hyper: PyTree, x: Array, y: Array) -> Array:
    """Coefficients (n, N) of the posterior means: mean_j(z) = gram(hyper_j, z, x) @ coefficients_j (equation 2.25)."""
    return jax.lax.map(lambda one: cho_solve((_factor(gram, one[0], x), True), one[1]), (hyper, y.T))


@partial(jax.jit, static_argnums=0)
def exact_variance(gram: Gram, hyper: PyTree, x: Array, z: Array) -> Array:
    """Variance (n, M) of the noise-free target at z (M, d) after exact inference from x (N, d) (equation 2.26)."""

    def one(hyper: PyTree) -> Array:
        half = solve_triangular(_factor(gram, hyper, x), gram(hyper, x, z), lower=True)
        return _prior_variance(gram, hyper, z) - jnp.sum(half**2, 0)

    return jax.lax.map(one, hyper)


def projected(gram: Gram, hyper: PyTree, inducing: Array, x: Array, y: Array) -> tuple[Array, Array]:
    """The projected process of all rows on m inducing inputs: coefficients (n, m), and (n, m, m) for the variance.

    mean_j(z) = k coefficients_j and var_j(z) = k(z, z) - k spread_j k' with k = gram(hyper_j, z, inducing)
    (Snelson and Ghahramani 2006: what the inducing inputs cannot represent of a row is noise of that row;
    Quinonero-Candela and Rasmussen 2005, equation 24).
    """
    n, m = y.shape[1], len(inducing)
    moments = jnp.zeros((n, m, m)), jnp.zeros((n, m))
    for start in range(0, len(x), CHUNK):
        part = slice(start, start + CHUNK)
        moments = _add(gram, hyper, inducing, x[part], y[part], moments)
    return _projected(gram, hyper, inducing, *moments)


@partial(jax.jit, static_argnums=0)
def projected_variance(gram: Gram, hyper: PyTree, inducing: Array, spread: Array, z: Array) -> Array:
    """Variance (n, M) of the noise-free target at z (M, d), of what `projected` gives."""

    def one(part: tuple[PyTree, Array]) -> Array:
        hyper, spread = part
        k = gram(hyper, z, inducing)
        return _prior_variance(gram, hyper, z) - jnp.sum((k @ spread) * k, 1)

    return jax.lax.map(one, (hyper, spread))


@partial(jax.jit, static_argnums=0)
def _add(gram: Gram, hyper: PyTree, inducing: Array, x: Array, y: Array, moments: tuple) -> tuple[Array, Array]:
    def one(part: tuple) -> tuple[Array, Array]:
        hyper, y, square, product = part
        white = solve_triangular(_factor(gram, hyper, inducing, noisy=False), gram(hyper, inducing, x), lower=True)
        unseen = jnp.maximum(_prior_variance(gram, hyper, x) - jnp.sum(white**2, 0), 0.0)
        weighted = white / (jnp.exp(2 * hyper["noise"]) + unseen)
        return square + weighted @ white.T, product + weighted @ y

    return jax.lax.map(one, (hyper, y.T, *moments))


@partial(jax.jit, static_argnums=0)
def _projected(gram: Gram, hyper: PyTree, inducing: Array, squares: Array, products: Array) -> tuple[Array, Array]:
    def one(part: tuple) -> tuple[Array, Array]:
        hyper, square, product = part
        lower = _factor(gram, hyper, inducing, noisy=False)
        middle = jnp.linalg.cholesky(jnp.eye(len(square)) + square)
        back = partial(solve_triangular, lower, lower=True, trans=1)
        kept = jnp.eye(len(square)) - cho_solve((middle, True), jnp.eye(len(square)))
        return back(cho_solve((middle, True), product)), back(back(kept).T)

    return jax.lax.map(one, (hyper, squares, products))


def _prior_variance(gram: Gram, hyper: PyTree, z: Array) -> Array:
    return jax.vmap(lambda row: gram(hyper, row[None], row[None])[0, 0])(z)


def _factor(gram: Gram, hyper: PyTree, x: Array, *, noisy: bool = True) -> Array:
    """Lower Cholesky factor of the kernel matrix, with the noise on its diagonal or without."""
    k = gram(hyper, x, x)
    more = JITTER * jnp.mean(jnp.diag(k)) + (jnp.exp(2 * hyper["noise"]) if noisy else 0.0)
    return jnp.linalg.cholesky(k + more * jnp.eye(len(x)))


@partial(jax.jit, static_argnums=0)
def _value_and_slope(loss: Callable, hyper: PyTree, *data: PyTree) -> tuple[Array, PyTree]:
    return jax.value_and_grad(loss)(hyper, *data)
