"""model=lagrangian_net: a Deep Lagrangian Network (Lutter, Ritter and Peters 2019).

A net gives, for a posture q, a lower triangle L(q) and a potential V(q). With the mass matrix H = L L' the torque
follows from Euler and Lagrange's equation (equations 3 to 6 there), by automatic differentiation:

tau = H qdd + dH/dt qd - grad_q(qd' H qd / 2) + grad_q V + friction
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np

from invdyn_cli import training
from invdyn_cli.errors import UsageError
from invdyn_cli.fields import counts, positive
from invdyn_cli.interfaces import AbstractModel, Progress, silent
from invdyn_cli.maths.regression import REST_SPEED
from invdyn_cli.maths.scaling import standardisation
from invdyn_cli.models import network
from invdyn_cli.types import Array, Dataset, Fit, Motion, PyTree, Robot

LEAST = 1e-3
"""Added to the diagonal of L, in units of torque over acceleration: H stays invertible."""


class _Net(nn.Module):
    """Fully connected layers with softplus between them, whose derivatives are smooth."""

    widths: tuple[int, ...]

    @nn.compact
    def __call__(self, x: Array) -> Array:
        for width in self.widths[:-1]:
            x = nn.softplus(nn.Dense(width)(x))
        return nn.Dense(self.widths[-1])(x)


@dataclass(frozen=True)
class LagrangianNet(AbstractModel):
    """One network for all joints; it needs no URDF, but uses one to know which joints slide.

    Its input is cosine and sine of every angle that turns, the standardised position of every joint that slides; H is
    positive definite, and the torque without friction conserves energy, whatever was learned.

    Attributes:
        hidden: widths of the hidden layers.
        friction: whether every joint has a viscous and a Coulomb friction, not negative, and an offset.
        epochs: passes over the training data.
        batch_size: [samples] size of a training batch.
        learning_rate: [-] step size of Adam at the start; it falls to zero.
    """

    needs_robot = False

    hidden: tuple[int, ...] = (64, 64)
    friction: bool = True
    epochs: int = 100
    batch_size: int = 128
    learning_rate: float = 0.003

    def __post_init__(self) -> None:
        if not isinstance(self.hidden, Sequence) or any(not (isinstance(w, int) and w >= 1) for w in self.hidden):
            raise UsageError(f"model.hidden={self.hidden}; allowed: a list of whole numbers >= 1")
        object.__setattr__(self, "hidden", tuple(self.hidden))
        counts(self, "model", "epochs", "batch_size")
        positive(self, "model", "learning_rate")

    def init(self, dataset: Dataset, key: jax.Array) -> PyTree:
        """A fresh net and the standardisation of this dataset."""
        n = len(dataset.joints)
        net = _Net(self._widths(n)).init(key, jnp.zeros(2 * n, jnp.float32))["params"]
        few, zero = jnp.full(n, -4.0, jnp.float32), jnp.zeros(n, jnp.float32)
        rubbing = {"friction": {"viscous": few, "coulomb": few, "offset": zero}} if self.friction else {}
        return {**standardisation(dataset.motion, dataset.tau), "nets": {"net": net, **rubbing}}

    def apply(self, params: PyTree, motion: Motion, robot: Robot | None) -> Array:
        """Torque (n,) of one sample."""
        said = self._torque(params["nets"], params, _slides(robot, len(motion.q)), motion)
        return jnp.asarray(said, float)

    def fit(
        self, dataset: Dataset, key: jax.Array, *, validation: Dataset | None = None, progress: Progress = silent
    ) -> Fit:
        """Train the net. history: train_loss and validation_loss (epochs, 1, n), mean squared error of the torque in
        units of its standard deviation. details: viscous [N m s/rad], coulomb and offset [N m], (n,) each."""
        start, shuffles = jax.random.split(key)
        params = self.init(dataset, start)
        scales = {name: params[name] for name in ("input_mean", "input_scale", "target_mean", "target_scale")}
        known = {**scales, "slides": _slides(dataset.robot, len(dataset.joints))}
        nets, history = training.descend(
            self._loss, params["nets"], known, _rows(dataset), _rows(validation) if validation else None,
            training.Schedule(self.epochs, self.batch_size), self.learning_rate, shuffles, progress,
        )  # fmt: skip
        units = {"viscous": scales["target_scale"] / np.split(scales["input_scale"], 3)[1]}
        told = {
            name: np.asarray(_strength(name, value)) * units.get(name, scales["target_scale"])
            for name, value in nets.get("friction", {}).items()
        }
        return network.trained(dataset, scales, nets, history, told)

    def weights(self, params: PyTree) -> PyTree:
        """The net and the friction."""
        return params["nets"]

    def with_weights(self, params: PyTree, weights: PyTree) -> PyTree:
        """Another net in the same standardisation."""
        return {**params, "nets": weights}

    def chunk(self, motion: Motion) -> int:
        """Fewer samples at a time: each one needs the derivatives of its network."""
        return 1024

    def _widths(self, n: int) -> tuple[int, ...]:
        return (*self.hidden, n * (n + 1) // 2 + 1)

    def _loss(self, nets: PyTree, known: PyTree, batch: tuple[Motion, Array]) -> Array:
        """Mean squared errors (n,) of a batch."""
        motion, tau = batch
        said = jax.vmap(lambda one: self._torque(nets, known, known["slides"], one))(motion)
        return jnp.mean(((tau - said) / known["target_scale"].astype(jnp.float32)) ** 2, 0)

    def _torque(self, nets: PyTree, scales: PyTree, slides: Array, motion: Motion) -> Array:
        """Torque (n,) of one sample in float32."""
        q, qd, qdd = (jnp.asarray(x).astype(jnp.float32) for x in (motion.q, motion.qd, motion.qdd))

        def mass(q: Array) -> Array:
            return self._energy(nets, scales, slides, q)[0]

        def minus_lagrangian(q: Array) -> Array:
            h, potential = self._energy(nets, scales, slides, q)
            return potential - 0.5 * qd @ h @ qd

        h, change = jax.jvp(mass, (q,), (qd,))
        tau = h @ qdd + change @ qd + jax.grad(minus_lagrangian)(q)
        if self.friction:
            strength = {name: _strength(name, value) for name, value in nets["friction"].items()}
            speed = qd / jnp.split(_single(scales["input_scale"]), 3)[1]
            rubbing = strength["viscous"] * speed + strength["coulomb"] * jnp.clip(qd / REST_SPEED, -1, 1)
            tau = tau + _single(scales["target_scale"]) * (rubbing + strength["offset"])
        return tau

    def _energy(self, nets: PyTree, scales: PyTree, slides: Array, q: Array) -> tuple[Array, Array]:
        """Mass matrix (n, n) and potential at a posture."""
        n = len(q)
        place = (q - _single(scales["input_mean"])[:n]) / _single(scales["input_scale"])[:n]
        turned = jnp.where(slides, place, jnp.cos(q)), jnp.where(slides, 0.0, jnp.sin(q))
        out: Any = _Net(self._widths(n)).apply({"params": nets["net"]}, jnp.concatenate(turned))
        torque, push = _single(scales["target_scale"]), jnp.split(_single(scales["input_scale"]), 3)[2]
        lower = jnp.zeros((n, n), q.dtype).at[jnp.tril_indices(n, -1)].set(out[n:-1])
        lower = lower + jnp.diag(nn.softplus(out[:n]) + LEAST)
        lower = jnp.sqrt(torque / push)[:, None] * lower
        return lower @ lower.T, jnp.max(torque) * out[-1]


def _single(x: Array) -> Array:
    return jnp.asarray(x).astype(jnp.float32)


def _strength(name: str, value: Array) -> Array:
    """A friction's coefficient, not negative; an offset as it is."""
    return value if name == "offset" else nn.softplus(value)


def _slides(robot: Robot | None, n: int) -> Array:
    return jnp.array(robot.prismatic if robot is not None else (False,) * n)


def _rows(dataset: Dataset) -> tuple[Motion, Array]:
    return jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), (dataset.motion, dataset.tau))
