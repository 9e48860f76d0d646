"""model=lwpr: locally weighted projection regression (Vijayakumar, D'Souza and Schaal 2005).

"Incremental online learning in high dimensions" (Neural Computation 17): a receptive field is a Gaussian weight around
a centre, in which partial least squares regresses the torque on a few projections of the state. From each sample every
field near it learns, its shape by gradient descent on the squared error of leave-one-out predictions.
"""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from invdyn_cli.errors import UsageError
from invdyn_cli.interfaces import AbstractModel, Progress, silent
from invdyn_cli.maths.scaling import standardisation, standardised
from invdyn_cli.types import Array, Dataset, Fit, Motion, PyTree, Robot

INACTIVE = 1e-3
"""Activation below which a field does not learn, as in the authors' code."""

STEP = 0.1
"""Largest relative change of a field's shape by one sample: a larger one is not made and halves the field's learning
rate, as in the authors' code."""

TRUSTED = 2
"""A field's shape, and a projection, are trusted after so many times as many samples as there are inputs."""


@dataclass(frozen=True)
class Lwpr(AbstractModel):
    """Fields of their own for every joint, with a width for every input (a diagonal distance metric).

    A prediction is the mean of all fields' regressions, weighted by exp(-(x - c)' D (x - c) / 2); far from all of them
    it is the nearest one's.

    Attributes:
        fields: most fields of a joint.
        projections: most projections of a field.
        width: [-] width of a new field, in units of the training data's spread times the root of the number of inputs.
        generate: [-] a sample that activates no field more than this begins a new one.
        prune: [-] of two fields that a sample activates more than this, the narrower one is removed.
        gain: [-] a projection is used if it lowers the squared error to less than this share.
        learning_rate: [-] step size of gradient descent on the shape of the fields; 0 keeps them as they begin.
        penalty: [-] weight of the squares of D beside the squared error; more of it makes wider fields.
        forgetting: [-] factor per sample of a field on what it learned before.
        passes: number of times that the training samples are gone through, in random order.
    """

    needs_robot = False

    fields: int = 100
    projections: int = 4
    width: float = 0.3
    generate: float = 0.2
    prune: float = 0.9
    gain: float = 0.9
    learning_rate: float = 20.0
    penalty: float = 1e-7
    forgetting: float = 0.9999
    passes: int = 2

    def __post_init__(self) -> None:
        for name in ("fields", "projections", "passes"):
            if not (isinstance(getattr(self, name), int) and getattr(self, name) >= 1):
                raise UsageError(f"model.{name}={getattr(self, name)}; allowed: a whole number >= 1")
        for name in ("generate", "prune", "gain", "forgetting"):
            if not 0 < getattr(self, name) <= 1:
                raise UsageError(f"model.{name}={getattr(self, name)}; allowed: above 0, at most 1")
        if not self.width > 0:
            raise UsageError(f"model.width={self.width}; allowed: a number > 0")
        for name in ("learning_rate", "penalty"):
            if not getattr(self, name) >= 0:
                raise UsageError(f"model.{name}={getattr(self, name)}; allowed: a number >= 0")

    def init(self, dataset: Dataset, key: jax.Array) -> PyTree:
        """No fields: the mean of the training torques."""
        n = len(dataset.joints)
        scales = standardisation(dataset.motion, dataset.tau)
        return {**scales, "fields": jax.tree.map(lambda x: np.repeat(x[None], n, 0), self.blank(3 * n))}

    def apply(self, params: PyTree, motion: Motion, robot: Robot | None) -> Array:
        """Torque (n,) of one sample."""
        x = (jnp.concatenate([motion.q, motion.qd, motion.qdd]) - params["input_mean"]) / params["input_scale"]
        said = jax.vmap(lambda one: self.mean(one, x))(params["fields"])
        return params["target_mean"] + params["target_scale"] * said

    def fit(
        self, dataset: Dataset, key: jax.Array, *, validation: Dataset | None = None, progress: Progress = silent
    ) -> Fit:
        """Learn from every sample, `passes` times. details: fields (n,), how many there are."""
        params = self.init(dataset, key)
        x, y = standardised(params, dataset.motion, dataset.tau)
        state = params["fields"]
        for k in range(self.passes):
            order = jax.random.permutation(jax.random.fold_in(key, k), len(x))
            state = _passed(self, state, jnp.asarray(x)[order], jnp.asarray(y)[order])
            progress((k + 1) / self.passes, f"{int((state['count'] > 0).sum(1).max())} fields")
        state = jax.tree.map(np.asarray, state)
        used = state["count"] > 0
        finite = all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(state))
        each = 2 * x.shape[1] + 1 + self.projections * (2 * x.shape[1] + 1)
        return Fit(
            params={**params, "fields": state},
            robot=dataset.robot,
            joints=dataset.joints,
            parameters=int(used.sum()) * each,
            details={"fields": used.sum(1)},
            warnings=() if finite else ("Learning diverged: a smaller model.learning_rate helps.",),
        )

    def learned_from(self, params: PyTree, motion: Motion, tau: Array, robot: Robot | None) -> PyTree:
        """The parameters after ONE more sample."""
        x = (jnp.concatenate([motion.q, motion.qd, motion.qdd]) - params["input_mean"]) / params["input_scale"]
        y = (tau - params["target_mean"]) / params["target_scale"]
        return {**params, "fields": jax.vmap(self.after, (0, None, 0))(params["fields"], x, y)}

    def chunk(self, motion: Motion) -> int:
        """Fewer samples at a time: every one is projected in every field."""
        return 128

    def blank(self, inputs: int) -> dict[str, np.ndarray]:
        """Fields (fields, …) of one target, none in use. Sums over samples, weighted, are named as in Table 3 there:
        zz, xz and zy of each projection, xy (its direction), errors (of the regression with so many projections)."""
        k, r, d = self.fields, self.projections, inputs
        shapes = {
            "centre": (k, d), "shape": (k, d), "weight": (k,), "mean": (k, d), "offset": (k,),
            "xy": (k, r, d), "xz": (k, r, d), "zz": (k, r), "zy": (k, r), "errors": (k, r + 1),
            "left_out": (k,), "rate": (k,), "h": (k, r), "r": (k, r),
        }  # fmt: skip
        return {**{name: np.zeros(shape) for name, shape in shapes.items()}, "count": np.zeros(k, np.int32)}

    def mean(self, state: PyTree, x: Array) -> Array:
        """Prediction of one target at an input (d,), both standardised."""
        said = jax.vmap(lambda one: self._regression(one, x))(state)
        return jax.nn.softmax(_log_activation(state, x)) @ said

    def after(self, state: PyTree, x: Array, y: Array) -> PyTree:
        """The fields of one target after a sample."""
        activation = jnp.exp(_log_activation(state, x))
        learned = jax.vmap(self._learned, (0, 0, None, None))(state, activation, x, y)
        state = jax.tree.map(lambda a, b: jnp.where(_like(activation > INACTIVE, a), b, a), state, learned)
        state = self._pruned(state, activation)
        free = jnp.argmin(state["count"])
        begins = (jnp.max(activation) < self.generate) & (state["count"][free] == 0)
        fresh = {name: jnp.zeros(leaf.shape[1:], leaf.dtype) for name, leaf in state.items()}
        wide = 1 / (self.width * np.sqrt(len(x)))
        fresh |= {"centre": x, "shape": jnp.full_like(x, wide), "mean": x, "offset": y, "weight": jnp.array(1e-10)}
        fresh |= {"rate": jnp.array(float(self.learning_rate)), "count": jnp.array(1, state["count"].dtype)}
        return jax.tree.map(lambda a, b: a.at[free].set(jnp.where(begins, b, a[free])), state, fresh)

    def _used(self, one: PyTree) -> Array:
        """Which projections (projections,) of a field are used: those that help, up to the first that does not."""
        before, after = one["errors"][:-1], one["errors"][1:]
        known = one["count"] > TRUSTED * (len(one["centre"]) + jnp.arange(1, self.projections + 1))
        return jnp.cumprod((after < self.gain * before) & known).astype(bool)

    def _regression(self, one: PyTree, x: Array) -> Array:
        """Prediction of a field (Table 3, bottom)."""
        left, said = x - one["mean"], one["offset"]
        used = self._used(one)
        for k in range(self.projections):
            z = left @ _unit(one["xy"][k])
            left = left - z * one["xz"][k] / _safe(one["zz"][k])
            said = said + jnp.where(used[k], z * one["zy"][k] / _safe(one["zz"][k]), 0.0)
        return said

    def _learned(self, one: PyTree, w: Array, x: Array, y: Array) -> PyTree:
        """A field after a sample of activation w: regression (Table 3), then its shape (Table 4)."""
        keep = self.forgetting
        weight = keep * one["weight"] + w
        mean = one["mean"] + w / weight * (x - one["mean"])
        offset = one["offset"] + w / weight * (y - one["offset"])
        left, error = x - mean, y - offset
        sums = {name: [] for name in ("xy", "xz", "zz", "zy")}
        errors, zs = [keep * one["errors"][0] + w * error**2], []
        lefts = [error]
        for k in range(self.projections):
            xy = keep * one["xy"][k] + w * left * error
            z = left @ _unit(xy)
            zz = keep * one["zz"][k] + w * z**2
            xz = keep * one["xz"][k] + w * left * z
            zy = keep * one["zy"][k] + w * z * error
            left, error = left - z * xz / _safe(zz), error - z * zy / _safe(zz)
            errors.append(keep * one["errors"][k + 1] + w * error**2)
            lefts.append(error)
            zs.append(z)
            for name, value in (("xy", xy), ("xz", xz), ("zz", zz), ("zy", zy)):
                sums[name].append(value)
        state = {**one, **{name: jnp.stack(value) for name, value in sums.items()}}
        state |= {"weight": weight, "mean": mean, "offset": offset, "errors": jnp.stack(errors)}
        state |= {"count": one["count"] + 1}
        used = self._used(state)
        z, scaled = jnp.stack(zs), jnp.where(used, jnp.stack(zs) / _safe(state["zz"]), 0.0)
        error = jnp.stack(lefts)[jnp.sum(used)]
        return {**state, **self._shaped(one, state, w, x, error, z, scaled)}

    def _shaped(self, one: PyTree, state: PyTree, w: Array, x: Array, error: Array, z: Array, scaled: Array) -> PyTree:
        """The field's shape M (d,), D = M², and the sums for its gradient, after an error of the used projections."""
        leverage = jnp.minimum(w * jnp.sum(z * scaled), 0.99)
        alone = error / (1 - leverage)
        weight, total = state["weight"], self.forgetting * one["left_out"] + w * alone**2
        slope = alone**2 - 2 * error * (scaled @ one["h"]) - 2 * (scaled**2 @ one["r"]) - total / weight
        shape, apart = one["shape"], x - one["centre"]
        of_error = slope / weight * (-w * shape * apart**2)
        of_size = w / weight * self.penalty * 4 * shape**3 / len(x)
        change = one["rate"] * (of_error + of_size)
        known, small = state["count"] > TRUSTED * len(x), jnp.all(jnp.abs(change) < STEP * shape)
        return {
            "shape": jnp.where(known & small, shape - change, shape),
            "rate": jnp.where(known & ~small, one["rate"] / 2, one["rate"]),
            "left_out": total,
            "h": self.forgetting * one["h"] + w * alone * z / (1 - leverage),
            "r": self.forgetting * one["r"] + w**2 * alone**2 * z**2 / (1 - leverage),
        }

    def _pruned(self, state: PyTree, activation: Array) -> PyTree:
        """The fields without the narrower one of two that overlap."""
        strongest, which = jax.lax.top_k(activation, min(2, self.fields))
        narrow = which[jnp.argmax(jnp.sum(jnp.log(state["shape"][which] + 1e-300), 1))]
        goes = (strongest[-1] > self.prune) & (self.fields > 1)
        return {**state, "count": state["count"].at[narrow].set(jnp.where(goes, 0, state["count"][narrow]))}


def _log_activation(state: PyTree, x: Array) -> Array:
    """-(x - c)' D (x - c) / 2 (fields,); very small for a field that is not in use."""
    squares = jnp.sum(((x - state["centre"]) * state["shape"]) ** 2, 1)
    return jnp.where(state["count"] > 0, -0.5 * squares, -1e30)


def _unit(direction: Array) -> Array:
    """The direction at length one, or zero."""
    size = jnp.sum(direction**2)
    return direction / jnp.sqrt(jnp.where(size > 0, size, 1.0))


def _safe(x: Array) -> Array:
    return jnp.where(x > 0, x, 1.0)


def _like(mask: Array, leaf: Array) -> Array:
    return mask.reshape(-1, *(1,) * (leaf.ndim - 1))


@partial(jax.jit, static_argnums=0)
def _passed(model: Lwpr, state: PyTree, x: Array, y: Array) -> PyTree:
    """All targets' fields after all samples (N, d) and (N, n) in turn."""

    def one(part: tuple) -> PyTree:
        state, y = part
        return jax.lax.scan(lambda s, sample: (model.after(s, *sample), None), state, (x, y))[0]

    return jax.lax.map(one, (state, y.T))
