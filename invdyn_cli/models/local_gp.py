"""model=local_gp: many small Gaussian processes, each for a region of the state (Nguyen-Tuong, Seeger and Peters 2009).

"Local Gaussian process regression for real time online model learning and control" (NIPS 21). A sample belongs to the
nearest centre by w = exp(-d² / 2), d being the distance in length scales, and begins a region of its own where no
centre has w above `nearness`. A prediction is the mean of the nearest regions' processes, weighted by w.

Here a sample joins all the `nearest` regions that predict it, not only the nearest one: a process that is evaluated
beside its samples extrapolates, which makes the mean worse where torques have little noise.
"""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import cho_solve

from invdyn_cli.errors import UsageError
from invdyn_cli.fields import counts
from invdyn_cli.interfaces import AbstractModel, Progress, silent
from invdyn_cli.maths import gaussian_process as gp
from invdyn_cli.maths.scaling import spread_rows, standardisation, standardised, standardised_state
from invdyn_cli.types import Array, Dataset, Fit, Motion, PyTree, Robot


@dataclass(frozen=True)
class LocalGp(AbstractModel):
    """Each joint has its own regions, all with the joint's squared exponential kernel of model=gpr.

    Learning keeps an even random choice of each region's samples; adaptation=online puts new ones in the place of the
    oldest, so that its cost does not grow.

    Attributes:
        nearness: [-] weight below which a sample begins a region of its own, while there are fewer than `regions`.
        regions: largest number of regions of a joint.
        capacity: [samples] largest number of samples of a region; the cost of an update grows with the third power.
        nearest: number of regions that a sample joins, and that a prediction is made of.
        hyperparameter_samples: [samples] number of training samples from which hyperparameters are estimated.
        steps: iterations of L-BFGS on the evidence.
    """

    needs_robot = False

    nearness: float = 0.9
    regions: int = 100
    capacity: int = 100
    nearest: int = 2
    hyperparameter_samples: int = 400
    steps: int = 60

    def __post_init__(self) -> None:
        counts(self, "model", "regions", "capacity", "nearest", "hyperparameter_samples", "steps")
        if not 0 < self.nearness < 1:
            raise UsageError(f"model.nearness={self.nearness}; allowed: a number between 0 and 1")

    def init(self, dataset: Dataset, key: jax.Array) -> PyTree:
        """No samples yet: the prior, mean zero in the standardisation of this dataset."""
        n = len(dataset.joints)
        hyper = gp.each(gp.start(3 * n), n)
        return {**standardisation(dataset.motion, dataset.tau), "hyper": hyper, **self._empty(n)}

    def apply(self, params: PyTree, motion: Motion, robot: Robot | None) -> Array:
        """Torque (n,) of one sample."""
        x = standardised_state(params, motion)
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
                "regions": (local["begun"] > 0).sum(1),
            },
        )

    def learned_from(self, params: PyTree, motion: Motion, tau: Array, robot: Robot | None) -> PyTree:
        """The parameters after ONE more sample, which replaces the oldest one in regions that are full."""
        x, y = standardised_state(params, motion), (tau - params["target_mean"]) / params["target_scale"]

        def one(hyper: PyTree, local: PyTree, y: Array) -> PyTree:
            local = self._centred(hyper, local, x)
            regions, taken = self._nearest(hyper, local, x)
            slots = jnp.where(taken, local["count"][regions] % self.capacity, self.capacity)
            local = {
                **local,
                "inputs": local["inputs"].at[regions, slots].set(x, mode="drop"),
                "targets": local["targets"].at[regions, slots].set(y, mode="drop"),
                "count": local["count"].at[regions].add(taken),
            }
            rows = {name: local[name][regions] for name in ("inputs", "targets", "count")}
            solved = jax.vmap(partial(self._solved, hyper))(rows)
            return {**local, "coefficients": local["coefficients"].at[regions].set(solved)}

        return {**params, "local": jax.vmap(one)(params["hyper"], params["local"], y)}

    def chunk(self, motion: Motion) -> int:
        """Fewer samples at a time: every one gathers the samples of its regions."""
        return 64

    def _empty(self, n: int) -> PyTree:
        """Regions (n, regions, …): centres, of how many samples each is the mean, samples that were kept and how many
        came, and coefficients."""
        k, c = self.regions, self.capacity
        shapes = {"centres": (n, k, 3 * n), "inputs": (n, k, c, 3 * n), "targets": (n, k, c), "coefficients": (n, k, c)}
        zeros = {name: np.zeros(shape) for name, shape in shapes.items()}
        return {"local": {**zeros, **{name: np.zeros((n, k), np.int32) for name in ("begun", "count")}}}

    def _mean(self, x: Array, hyper: PyTree, local: PyTree) -> Array:
        """Weighted mean of the nearest regions' posterior means at x (d,), of one joint."""
        regions, _ = self._nearest(hyper, local, x)
        near, coefficients = local["inputs"][regions], local["coefficients"][regions]
        k = gp.squared_exponential(hyper, x[None], near.reshape(-1, len(x)))[0].reshape(coefficients.shape)
        return jax.nn.softmax(_closeness(hyper, local, x)[regions]) @ jnp.sum(k * coefficients, 1)

    def _nearest(self, hyper: PyTree, local: PyTree, x: Array) -> tuple[Array, Array]:
        """Indices of the regions that are near a sample, and whether each has begun."""
        regions = jax.lax.top_k(_closeness(hyper, local, x), min(self.nearest, self.regions))[1]
        return regions, local["begun"][regions] > 0

    def _centred(self, hyper: PyTree, local: PyTree, x: Array) -> PyTree:
        """The centres after a sample: the nearest one moves towards it, or a new region begins there."""
        closeness, used = _closeness(hyper, local, x), jnp.sum(local["begun"] > 0)
        begins = (used < self.regions) & (jnp.max(closeness) < np.log(self.nearness))
        k = jnp.where(begins, used, jnp.argmax(closeness))
        begun = jnp.where(begins, 1, local["begun"][k] + 1)
        centre = jnp.where(begins, x, local["centres"][k] + (x - local["centres"][k]) / begun)
        return {**local, "centres": local["centres"].at[k].set(centre), "begun": local["begun"].at[k].set(begun)}

    def _solved(self, hyper: PyTree, region: PyTree) -> Array:
        """Coefficients (capacity,) of a region's posterior mean; slots without a sample have none."""
        filled = jnp.arange(self.capacity) < region["count"]
        k = gp.squared_exponential(hyper, region["inputs"], region["inputs"]) * (filled[:, None] & filled)
        k = k + jnp.diag(jnp.where(filled, jnp.exp(2 * hyper["noise"]), 1.0))
        return cho_solve((jnp.linalg.cholesky(k), True), region["targets"] * filled)


def _closeness(hyper: PyTree, local: PyTree, x: Array) -> Array:
    """log w (regions,) of a sample; very small for a region that has not begun."""
    squares = jnp.sum(((x - local["centres"]) / jnp.exp(hyper["scale"])) ** 2, 1)
    return jnp.where(local["begun"] > 0, -0.5 * squares, -1e30)


@partial(jax.jit, static_argnums=0)
def _sorted_in(model: LocalGp, hyper: PyTree, x: Array, y: Array, key: jax.Array, local: PyTree) -> PyTree:
    """The regions of all joints: a first turn over all samples decides the centres; in a second one each region keeps
    an even random choice of the samples that it is near to (reservoir sampling, Vitter 1985), and is solved."""
    numbers = jnp.arange(len(x))

    def one(part: tuple) -> PyTree:
        hyper, local, y = part
        centred = jax.lax.scan(lambda state, x: (model._centred(hyper, state, x), None), local, x)[0]

        def keep(count: jax.Array, sample: tuple) -> tuple[jax.Array, tuple]:
            number, x = sample
            regions, taken = model._nearest(hyper, centred, x)
            came = count[regions]
            drawn = jax.random.randint(jax.random.fold_in(key, number), came.shape, 0, came + 1)
            slots = jnp.where(came < model.capacity, came, drawn)
            return count.at[regions].add(taken), (regions, jnp.where(taken, slots, model.capacity))

        count, at = jax.lax.scan(keep, local["count"], (numbers, x))
        latest = jnp.full(local["targets"].shape, -1).at[at].max(numbers[:, None], mode="drop")
        kept = latest >= 0
        rows = {"inputs": x[latest] * kept[..., None], "targets": y[latest] * kept, "count": count}
        return {**centred, **rows, "coefficients": jax.lax.map(partial(model._solved, hyper), rows)}

    return jax.lax.map(one, (hyper, local, y.T))
