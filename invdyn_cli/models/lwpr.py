"""model=lwpr: locally weighted projection regression, many linear models, each with a receptive field of its own.

Vijayakumar, D'Souza and Schaal 2005, "Incremental online learning in high dimensions" (Neural Computation 17(12)). A
field weighs a sample by w = exp(-|M (x - c)|² / 2), with M diagonal here. Its linear model is a weighted partial least
squares regression of a few directions, one after the other, from sums that forget by a factor. M descends the gradient
of the weighted leave-one-out error plus a penalty on small fields. Where no field has w above `generate`, a new one
begins; of two that both have w above `prune`, the narrower one ends.

Unlike there, the step of M is relative: log M descends the gradient of the logarithm of the error, so that one learning
rate serves targets of any size; and a field is judged only once its own regression has begun to settle, since the large
errors of its first samples otherwise make it grow over its neighbours.
"""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from invdyn_cli.errors import UsageError
from invdyn_cli.fields import counts, positive
from invdyn_cli.interfaces import AbstractModel, Progress, silent
from invdyn_cli.maths.scaling import standardisation, standardised, standardised_state
from invdyn_cli.types import Array, Dataset, Fit, Motion, PyTree, Robot

ACTIVE = 1e-3
"""Weight below which a sample changes nothing of a field."""

LARGEST_STEP = 1.0
"""Largest change of M by one sample, as a share: the gradient of a single sample is noisy."""

STEADY = 100.0
"""[samples] Added to a field's weight in the step of M: the gradient of few samples is noise, and a field that
grows too wide ends its neighbours."""

TINY = 1e-10
"""Least sum of squares along a direction: before the first sample it is zero."""

FORGETTING_PACE = 0.9999
"""Share of the distance to the final forgetting factor that is left after each sample (the paper's annealing)."""

UNREADY = -30.0
"""Added to log w of a field that has seen too few samples: it counts only where no other one is near."""


@dataclass(frozen=True)
class Lwpr(AbstractModel):
    """Each joint has its own fields over the standardised state (q, qd, qdd).

    Attributes:
        fields: largest number of receptive fields of a joint.
        directions: largest number of directions of a field.
        reach: [spreads] radius of a new field, in units of an input's spread times the root of the number of inputs.
        generate: [-] a new field begins at a sample at which all fields have less weight than this.
        prune: [-] where two fields both have more weight than this, the narrower one is removed.
        direction_gain: [-] a field adds a direction only if this reduces its squared error by at least this share.
        learning_rate: [-] step of the gradient descent on M.
        penalty: [-] weight of the penalty on small fields.
        forgetting: [-] factor by which a field reduces the weight of its earlier samples at each new one, at the start.
        last_forgetting: [-] value that this factor approaches as the field gets more samples (option forgetting).
        passes: how often the training samples are learned from, each time in a new random order.
    """

    needs_robot = False

    fields: int = 200
    directions: int = 4
    reach: float = 0.3
    generate: float = 0.2
    prune: float = 0.7
    direction_gain: float = 0.1
    learning_rate: float = 0.5
    penalty: float = 1e-7
    forgetting: float = 0.999
    last_forgetting: float = 0.9999
    passes: int = 5

    def __post_init__(self) -> None:
        counts(self, "model", "fields", "directions", "passes")
        for name in ("generate", "prune", "direction_gain", "forgetting", "last_forgetting"):
            if not 0 < getattr(self, name) <= 1:
                raise UsageError(f"model.{name}={getattr(self, name)}; allowed: a number above 0, up to 1")
        for name in ("learning_rate", "penalty"):
            if not getattr(self, name) >= 0:
                raise UsageError(f"model.{name}={getattr(self, name)}; allowed: a number >= 0")
        positive(self, "model", "reach")

    def init(self, dataset: Dataset, key: jax.Array) -> PyTree:
        """No fields yet: the mean torque."""
        n = len(dataset.joints)
        blank = jax.tree.map(lambda leaf: np.repeat(np.asarray(leaf)[None], n, 0), self.blank(3 * n))
        return {**standardisation(dataset.motion, dataset.tau), "fields": blank}

    def apply(self, params: PyTree, motion: Motion, robot: Robot | None) -> Array:
        """Torque (n,) of one sample."""
        x = standardised_state(params, motion)
        return params["target_mean"] + params["target_scale"] * jax.vmap(lambda f: said(f, x))(params["fields"])

    def fit(
        self, dataset: Dataset, key: jax.Array, *, validation: Dataset | None = None, progress: Progress = silent
    ) -> Fit:
        """Learn from the samples one by one, in random order; details: fields and directions (n,) of every joint."""
        params = self.init(dataset, key)
        x, y = standardised(params, dataset.motion, dataset.tau)
        fields = jax.tree.map(jnp.asarray, params["fields"])
        for turn in range(self.passes):
            order = jax.random.permutation(jax.random.fold_in(key, turn), len(x))
            fields = _one_turn(self, fields, x[order], y[order].T)
            progress((turn + 1) / self.passes, f"{int((fields['count'] > 0).sum())} fields")
        fields = jax.tree.map(np.asarray, fields)
        there = fields["count"] > 0
        used = np.where(there, fields["used"], 0)
        lost = there.sum(1) == self.fields
        return Fit(
            params={**params, "fields": fields},
            robot=dataset.robot,
            joints=dataset.joints,
            parameters=int(there.sum() * (3 * x.shape[1] + 1) + used.sum() * (2 * x.shape[1] + 1)),
            details={"fields": there.sum(1), "directions": used.sum(1)},
            warnings=(f"All {self.fields} fields are taken (model.fields): some regions have none.",)
            if lost.any()
            else (),
        )

    def learned_from(self, params: PyTree, motion: Motion, tau: Array, robot: Robot | None) -> PyTree:
        """The parameters after ONE more sample."""
        x, y = standardised_state(params, motion), (tau - params["target_mean"]) / params["target_scale"]
        return {**params, "fields": jax.vmap(lambda fields, y: self.learned(fields, x, y))(params["fields"], y)}

    def chunk(self, motion: Motion) -> int:
        """Fewer samples at a time: each one asks all fields of every joint."""
        return 256

    def blank(self, inputs: int) -> dict[str, np.ndarray]:
        """Fields of one joint before the first sample, leading axis `fields`.

        centre, width (the diagonal of M), mean, level, direction, slope, loading, used and count make a prediction; the
        others are sums over samples, by their names in the paper: weight W, u, ss, sr, sz, mse, e, h, r.
        """
        k, r, d = self.fields, self.directions, inputs
        shapes = {
            "centre": (d,), "width": (d,), "mean": (d,), "level": (), "direction": (r, d), "slope": (r,),
            "loading": (r, d), "forgetting": (), "weight": (), "u": (r, d), "ss": (r,), "sr": (r,), "sz": (r, d),
            "mse": (r + 1,), "judged": (), "e": (), "h": (r + 1,), "r": (r + 1,),
        }  # fmt: skip
        zeros = {name: np.zeros((k, *shape)) for name, shape in shapes.items()}
        counts = {"used": np.ones(k, np.int32), "count": np.zeros(k, np.int32)}
        narrow = np.full((k, d), 1 / (self.reach * np.sqrt(d)))
        return {**zeros, **counts, "width": narrow, "forgetting": np.full(k, self.forgetting)}

    def learned(self, fields: PyTree, x: Array, y: Array) -> PyTree:
        """Fields of one joint after ONE sample, an input x (d,) and a target y."""
        near = jnp.where(fields["count"] > 0, jnp.exp(closeness(fields, x)), 0.0)
        free = jnp.argmin(fields["count"] > 0)
        begins = (jnp.max(near) < self.generate) & (fields["count"][free] == 0)
        new = {name: jnp.asarray(leaf[0]) for name, leaf in self.blank(len(x)).items()}
        fields = jax.tree.map(
            lambda leaf, start: leaf.at[free].set(jnp.where(begins, start, leaf[free])), fields, {**new, "centre": x}
        )
        near = near.at[free].set(jnp.where(begins, 1.0, near[free]))
        fields = jax.vmap(partial(self._updated, x, y))(fields, near)
        first, second = jax.lax.top_k(near, 2)[1] if self.fields > 1 else (0, 0)
        narrow = jnp.prod(fields["width"][first]) > jnp.prod(fields["width"][second])
        ended = jnp.where(narrow, first, second)
        crowded = (near[second] > self.prune) & (self.fields > 1)
        count = fields["count"].at[ended].multiply(jnp.where(crowded, 0, 1))
        return {**fields, "count": count}

    def _updated(self, x: Array, y: Array, f: PyTree, w: Array) -> PyTree:
        """One field after a sample of weight w, if w is above ACTIVE."""
        keep = f["forgetting"]
        weight = keep * f["weight"] + w
        mean = (keep * f["weight"] * f["mean"] + w * x) / jnp.maximum(weight, TINY)
        level = (keep * f["weight"] * f["level"] + w * y) / jnp.maximum(weight, TINY)
        z, left = x - mean, y - level
        errors, along, parts = [left], [], []
        for k in range(self.directions):
            u = keep * f["u"][k] + w * z * left
            direction = u / jnp.sqrt(u @ u + TINY**2)
            s = z @ direction
            ss, sr = keep * f["ss"][k] + w * s**2, keep * f["sr"][k] + w * s * left
            sz = keep * f["sz"][k] + w * s * z
            slope, loading = sr / jnp.maximum(ss, TINY), sz / jnp.maximum(ss, TINY)
            z, left = z - s * loading, left - s * slope
            errors.append(left)
            along.append(s)
            parts.append({"direction": direction, "slope": slope, "loading": loading, "u": u, "ss": ss, "sr": sr,
                          "sz": sz})  # fmt: skip
        mse = keep * f["mse"] + w * jnp.stack(errors) ** 2
        ready = f["count"] > 2 * len(x)
        more = jnp.minimum(f["used"] + 1, self.directions)
        takes = ready & (mse[more] < (1 - self.direction_gain) * mse[f["used"]])
        stacked = jax.tree.map(lambda *rows: jnp.stack(rows), *parts)
        new = {
            **f, **stacked, "mean": mean, "level": level, "weight": weight, "mse": mse, "count": f["count"] + 1,
            "used": jnp.where(takes, more, f["used"]),
            "forgetting": FORGETTING_PACE * keep + (1 - FORGETTING_PACE) * self.last_forgetting,
        }  # fmt: skip
        new = self._shaped(x, f, new, w, jnp.stack(along), jnp.stack(errors)[f["used"]], ready)
        return jax.tree.map(partial(jnp.where, w > ACTIVE), new, f)

    def _shaped(self, x: Array, f: PyTree, new: PyTree, w: Array, s: Array, error: Array, ready: Array) -> PyTree:
        """The field with M after a step down the gradient of its error, and the sums that this takes.

        J = E / W + penalty / d sum_k M_k⁴ with E = sum_i w_i e_i² / (1 - h_i)², e_i the error and h_i = w_i s_i' P s_i
        the leverage of sample i, P = 1 / ss (level: s = 1, P = 1 / W). A new weight w changes the slopes by P s e, so
        that, with H = sum_i w_i e_i s_i / (1 - h_i)² and R = sum_i w_i² e_i² s_i² / (1 - h_i)³ over the samples before,
        dJ/dw = (e² / (1 - h)² - 2 e s' P H - 2 (s²)' P² R - E / W) / W. P stands outside the sums, which would keep the
        large values that it has at a field's first samples.
        """
        keep, inputs = f["forgetting"], len(x)
        used = jnp.arange(self.directions + 1) <= f["used"]
        s = jnp.concatenate([jnp.ones(1), s])
        p = jnp.where(used, 1 / jnp.maximum(jnp.concatenate([new["weight"][None], new["ss"]]), TINY), 0.0)
        rest = jnp.maximum(1 - w * (s**2 @ p), 0.01)
        crossed = error / rest
        ready = ready & (f["weight"] > 2 * (len(x) + 1))
        counts, keep = jnp.where(ready, w, 0.0), jnp.where(ready, keep, 1.0)
        e, weight = keep * f["e"] + counts * crossed**2, keep * f["judged"] + counts
        by_weight = (
            crossed**2 - 2 * error * (s @ (p * f["h"])) - 2 * (s**2) @ (p**2 * f["r"]) - e / jnp.maximum(weight, TINY)
        )
        away = (x - f["centre"]) ** 2
        square = f["width"] ** 2
        slope = (-by_weight * square * away + 4 * self.penalty / inputs * square**2) * w
        slope = slope / jnp.maximum(e * (1 + STEADY / jnp.maximum(weight, TINY)), TINY)
        step = jnp.clip(self.learning_rate * slope, -LARGEST_STEP, LARGEST_STEP)
        return {
            **new,
            "width": f["width"] * jnp.exp(-jnp.where(ready, step, 0.0)),
            "judged": weight,
            "e": e,
            "h": keep * f["h"] + counts * crossed * s / rest,
            "r": keep * f["r"] + counts**2 * crossed**2 * s**2 / rest,
        }


def closeness(fields: PyTree, x: Array) -> Array:
    """log w (fields,) of an input x (d,)."""
    return -0.5 * jnp.sum((fields["width"] * (x - fields["centre"])) ** 2, 1)


def said(fields: PyTree, x: Array) -> Array:
    """Target at an input x (d,): the mean of the fields' linear models, weighted by w; far from all, the nearest
    one's. Zero before the first sample."""
    ready = fields["count"] > 2 * len(x)
    shares = closeness(fields, x) + jnp.where(ready, 0.0, UNREADY) + jnp.where(fields["count"] > 0, 0.0, -1e30)
    return jax.nn.softmax(shares) @ jax.vmap(partial(_linear, x))(fields)


def _linear(x: Array, f: PyTree) -> Array:
    z, total = x - f["mean"], f["level"]
    for k in range(len(f["slope"])):
        s = z @ f["direction"][k]
        total = total + jnp.where(k < f["used"], f["slope"][k] * s, 0.0)
        z = z - s * f["loading"][k]
    return total


@partial(jax.jit, static_argnums=0)
def _one_turn(model: Lwpr, fields: PyTree, x: Array, y: Array) -> PyTree:
    """Fields of every joint after all samples x (T, d), y (n, T), one after the other."""

    def one(part: tuple) -> PyTree:
        return jax.lax.scan(lambda state, sample: (model.learned(state, *sample), None), part[0], (x, part[1]))[0]

    return jax.lax.map(one, (fields, y))
