"""model=local_gp: many small Gaussian processes, each of a region of the state (Nguyen-Tuong, Seeger and Peters 2009).

"Local Gaussian process regression for real time online model learning and control" (NIPS 21). A sample belongs to the
nearest centre by w = exp(-d² / 2), d being the distance in length scales, and begins a region of its own where no
centre has w above `nearness`. A prediction is the mean of the nearest regions' processes, weighted by w.
"""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import cho_solve

from invdyn_cli.errors import UsageError
from invdyn_cli.interfaces import AbstractModel, Progress, silent
from invdyn_cli.maths import gaussian_process as gp
from invdyn_cli.maths.scaling import spread_rows, standardisation, standardised
from invdyn_cli.types import Array, Dataset, Fit, Motion, PyTree, Robot


@dataclass(frozen=True)
class LocalGp(AbstractModel):
    """Regions of their own for every joint, all with the joint's squared exponential kernel of model=gpr.

    Learning keeps an even random choice of each region's samples; adaptation=online puts new ones in the place of the
    oldest, so that its cost does not grow.

    Attributes:
        nearness: [-] weight below which a sample begins a region of its own, while there are fewer than `regions`.
        regions: most regions of a joint.
        capacity: [samples] most samples of a region; the cost of an update grows with the third power.
        nearest: number of regions that a prediction is made of.
        hyperparameter_samples: [samples] so many, evenly from the training samples, decide the hyperparameters.
        steps: iterations of L-BFGS on the evidence.
    """

    needs_robot = False

    nearness: float = 0.5
    regions: int = 100
    capacity: int = 100
    nearest: int = 3
    hyperparameter_samples: int = 400
    steps: int = 60

    def __post_init__(self) -> None:
        for name in ("regions", "capacity", "nearest", "hyperparameter_samples", "steps"):
            if not (isinstance(getattr(self, name), int) and getattr(self, name) >= 1):
                raise UsageError(f"model.{name}={getattr(self, name)}; allowed: a whole number >= 1")
        if not 0 < self.nearness < 1:
            raise UsageError(f"model.nearness={self.nearness}; allowed: a number between 0 and 1")

    def init(self, dataset: Dataset, key: jax.Array) -> PyTree:
        """No samples yet: the prior, mean zero in the standardisation of this dataset."""
        n = len(dataset.joints)
        hyper = gp.each(gp.start(3 * n), n)
        return {**standardisation(dataset.motion, dataset.tau), "hyper": hyper, **self._empty(n)}

    def apply(self, params: PyTree, motion: Motion, robot: Robot | None) -> Array:
        """Torque (n,) of one sample."""
        x = _input(params, motion)
        each = jax.vmap(partial(self._mean, x))(params["hyper"], params["local"])
        return params["target_mean"] + params["target_scale"] * each

    def fit(
        self, dataset: Dataset, key: jax.Array, *, validation: Dataset | None = None, progress: Progress = silent
    ) -> Fit:
        """Hyperparameters of largest evidence on some of the samples, then the regions from all of them in turn.

        details: length_scales (n, 3 n), noise (n,) [N m; N] and regions (n,), how many there are.
        """
        scales = standardisation(dataset.motion, dataset.tau)
        x, y = standardised(scales, dataset.motion, dataset.tau)
        rows = spread_rows(len(x), self.hyperparameter_samples)
        start = gp.start(x.shape[1])
        hyper = gp.learned_hyperparameters(gp.squared_exponential, start, x[rows], y[rows], self.steps, progress)
        local = _sorted_in(self, hyper, jnp.asarray(x), jnp.asarray(y), key, self._empty(y.shape[1])["local"])
        local = jax.tree.map(np.asarray, local)
        return Fit(
            params={**scales, "hyper": hyper, "local": local},
            robot=dataset.robot,
            joints=dataset.joints,
            parameters=int(np.minimum(local["count"], self.capacity).sum())
            + sum(leaf.size for leaf in jax.tree.leaves(hyper)),
            details={
                "length_scales": np.exp(hyper["scale"]) * scales["input_scale"],
                "noise": np.exp(hyper["noise"]) * scales["target_scale"],
                "regions": (local["count"] > 0).sum(1),
            },
        )

    def learned_from(self, params: PyTree, motion: Motion, tau: Array, robot: Robot | None) -> PyTree:
        """The parameters after ONE more sample: it joins its region, in the place of the oldest where that is full."""
        x, y = _input(params, motion), (tau - params["target_mean"]) / params["target_scale"]

        def one(hyper: PyTree, local: PyTree, y: Array) -> PyTree:
            k, begins = self._region(hyper, local, x)
            local = _joined(local, k, begins, local["count"][k] % self.capacity, x, y)
            row = {name: local[name][k] for name in ("inputs", "targets", "count")}
            return {**local, "coefficients": local["coefficients"].at[k].set(self._solved(hyper, row))}

        return {**params, "local": jax.vmap(one)(params["hyper"], params["local"], y)}

    def chunk(self, motion: Motion) -> int:
        """Fewer samples at a time: every one gathers the samples of its regions."""
        return 64

    def _empty(self, n: int) -> PyTree:
        """Regions (n, regions, …): centres, how many samples came, those that were kept, and coefficients."""
        k, c = self.regions, self.capacity
        shapes = {"centres": (n, k, 3 * n), "inputs": (n, k, c, 3 * n), "targets": (n, k, c), "coefficients": (n, k, c)}
        zeros = {name: np.zeros(shape) for name, shape in shapes.items()}
        return {"local": {**zeros, "count": np.zeros((n, k), np.int32)}}

    def _mean(self, x: Array, hyper: PyTree, local: PyTree) -> Array:
        """Weighted mean of the nearest regions' posterior means at x (d,), of one joint."""
        closeness = _closeness(hyper, local, x)
        weights, nearest = jax.lax.top_k(closeness, min(self.nearest, self.regions))
        near, coefficients = local["inputs"][nearest], local["coefficients"][nearest]
        k = gp.squared_exponential(hyper, x[None], near.reshape(-1, len(x)))[0].reshape(coefficients.shape)
        return jax.nn.softmax(weights) @ jnp.sum(k * coefficients, 1)

    def _region(self, hyper: PyTree, local: PyTree, x: Array) -> tuple[Array, Array]:
        """Index of the region that a sample joins, and whether it begins it."""
        closeness, used = _closeness(hyper, local, x), jnp.sum(local["count"] > 0)
        begins = (used < self.regions) & (jnp.max(closeness) < np.log(self.nearness))
        return jnp.where(begins, used, jnp.argmax(closeness)), begins

    def _solved(self, hyper: PyTree, region: PyTree) -> Array:
        """Coefficients (capacity,) of a region's posterior mean; slots without a sample have none."""
        filled = jnp.arange(self.capacity) < region["count"]
        k = gp.squared_exponential(hyper, region["inputs"], region["inputs"]) * (filled[:, None] & filled)
        k = k + jnp.diag(jnp.where(filled, jnp.exp(2 * hyper["noise"]), 1.0))
        return cho_solve((jnp.linalg.cholesky(k), True), region["targets"] * filled)


def _input(params: PyTree, motion: Motion) -> Array:
    return (jnp.concatenate([motion.q, motion.qd, motion.qdd]) - params["input_mean"]) / params["input_scale"]


def _closeness(hyper: PyTree, local: PyTree, x: Array) -> Array:
    """log w (regions,) of a sample; very small for a region without samples."""
    squares = jnp.sum(((x - local["centres"]) / jnp.exp(hyper["scale"])) ** 2, 1)
    return jnp.where(local["count"] > 0, -0.5 * squares, -1e30)


def _joined(local: PyTree, k: Array, begins: Array, slot: Array, x: Array, y: Array) -> PyTree:
    """The regions with a sample in a slot of region k (a slot beyond the capacity: it is counted and not kept), whose
    centre is the mean of all samples that came."""
    count = jnp.where(begins, 1, local["count"][k] + 1)
    centre = local["centres"][k] + (x - local["centres"][k]) / count
    return {
        **local,
        "centres": local["centres"].at[k].set(jnp.where(begins, x, centre)),
        "count": local["count"].at[k].set(count),
        "inputs": local["inputs"].at[k, slot].set(x, mode="drop"),
        "targets": local["targets"].at[k, slot].set(y, mode="drop"),
    }


@partial(jax.jit, static_argnums=0)
def _sorted_in(model: LocalGp, hyper: PyTree, x: Array, y: Array, key: jax.Array, local: PyTree) -> PyTree:
    """The regions of all joints after all samples; each keeps an even random choice of its own (reservoir sampling,
    Vitter 1985), and is solved at the end."""
    numbers = jnp.arange(len(x))

    def one(part: tuple) -> PyTree:
        hyper, local, y = part

        def step(local: PyTree, sample: tuple) -> tuple[PyTree, None]:
            number, x, y = sample
            k, begins = model._region(hyper, local, x)
            before = local["count"][k]
            drawn = jax.random.randint(jax.random.fold_in(key, number), (), 0, before + 1)
            return _joined(local, k, begins, jnp.where(before < model.capacity, before, drawn), x, y), None

        local = jax.lax.scan(step, local, (numbers, x, y))[0]
        rows = {name: local[name] for name in ("inputs", "targets", "count")}
        return {**local, "coefficients": jax.lax.map(partial(model._solved, hyper), rows)}

    return jax.lax.map(one, (hyper, local, y.T))
