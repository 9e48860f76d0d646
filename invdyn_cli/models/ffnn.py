"""model=ffnn: one feed-forward net per joint, from all joints' state to the torque of one (paper, III-B, Table I)."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace

import jax
import jax.numpy as jnp
import numpy as np

from invdyn_cli import training
from invdyn_cli.errors import UsageError, listed
from invdyn_cli.fields import counts, positive
from invdyn_cli.interfaces import AbstractModel, Progress, silent
from invdyn_cli.maths.scaling import standardisation, standardised, standardised_state
from invdyn_cli.models import network
from invdyn_cli.types import Array, Dataset, Fit, Motion, PyTree, Robot

MOST_WEIGHTS = 10_000_000
"""Largest number of weights of a joint's networks after their inputs: with Adam's two moments 120 MB a joint in
float32; those of Table I have 10,000."""

MOST_NUMBERS = 250_000_000
"""Largest number of values in the rows of all members, each of which has its own shuffle: 1 GB in float32."""


@dataclass(frozen=True)
class JointNet:
    """What Table I fixes per joint: hidden widths and learning rate."""

    hidden: tuple[int, ...] = (100,)
    learning_rate: float = 0.001

    def __post_init__(self) -> None:
        object.__setattr__(self, "hidden", tuple(int(w) for w in self.hidden))
        if any(w < 1 for w in self.hidden):
            raise UsageError(f"hidden widths {list(self.hidden)}; allowed: a list of whole numbers >= 1")
        positive(self, "", "learning_rate")


@dataclass(frozen=True)
class Ffnn(AbstractModel):
    """Per-joint nets (3 n inputs, hidden layers with ReLU, 1 output), inputs and targets standardised, Adam.

    Attributes:
        hidden: widths of the hidden layers, of a joint that `joints` does not name.
        learning_rate: [-] step size of Adam, of a joint that `joints` does not name.
        joints: exceptions for single joints, {joint number from 1: {hidden: [...], learning_rate: x}}; numbers that the
            robot does not have are ignored, so that the default (Table I) serves arms of any length.
        epochs: passes over the training data (Table I).
        batch_size: [samples] size of a training batch (Table I).
        seeds: networks per joint, initialised and shuffled independently, trained in one program; `predict` gives their
            mean, `members` each of them.
    """

    needs_robot = False

    hidden: tuple[int, ...] = (100,)
    learning_rate: float = 0.001
    joints: tuple[tuple[int, JointNet], ...] = field(
        default=((2, JointNet((100, 100))), (3, JointNet(learning_rate=0.0007)), (4, JointNet(learning_rate=0.005)))
    )
    epochs: int = 100
    batch_size: int = 32
    seeds: int = 1

    def __post_init__(self) -> None:
        common = JointNet(self.hidden, self.learning_rate)
        object.__setattr__(self, "hidden", common.hidden)
        object.__setattr__(self, "joints", _per_joint(self.joints, common))
        counts(self, "model", "epochs", "batch_size", "seeds")
        for net in (common, *(net for _, net in self.joints)):
            weights = _weights(net, self.seeds)
            if weights > MOST_WEIGHTS:
                got = f"model.hidden={list(net.hidden)} with model.seeds={self.seeds}: {weights:.3g} weights a joint"
                raise UsageError(f"{got}; allowed: {MOST_WEIGHTS:.0e}")

    def groups(self, n: int) -> tuple[training.Group, ...]:
        """The nets of n joints by shape, the deepest first."""
        special = dict(self.joints)
        nets = [special.get(j + 1, JointNet(self.hidden, self.learning_rate)) for j in range(n)]
        shapes = sorted({net.hidden for net in nets}, key=lambda h: (-len(h), h))
        return tuple(
            training.Group(
                shape,
                tuple(j for j, net in enumerate(nets) if net.hidden == shape),
                tuple(net.learning_rate for net in nets if net.hidden == shape),
            )
            for shape in shapes
        )

    def init(self, dataset: Dataset, key: jax.Array) -> PyTree:
        """Fresh nets and the standardisation of this dataset."""
        motion, tau = dataset.motion, dataset.tau
        nets = [
            training.initial(g.hidden, g.columns, 3 * tau.shape[1], self._keys(key)) for g in self.groups(tau.shape[1])
        ]
        return {**standardisation(motion, tau), "nets": _named(nets)}

    def apply(self, params: PyTree, motion: Motion, robot: Robot | None) -> Array:
        """Torque (n,) of one sample: the mean over the members."""
        n = motion.q.shape[-1]
        x = standardised_state(params, motion).astype(jnp.float32)
        outputs = jnp.zeros(n)
        for i, group in enumerate(self.groups(n)):
            nets = params["nets"][f"group{i}"]
            net = training.MLP(group.hidden)
            each = jax.vmap(jax.vmap(lambda p, net=net: net.apply({"params": p}, x)))(nets)
            outputs = outputs.at[jnp.array(group.columns)].set(jnp.asarray(each, float).mean(0))
        return params["target_mean"] + params["target_scale"] * outputs

    def fit(
        self, dataset: Dataset, key: jax.Array, *, validation: Dataset | None = None, progress: Progress = silent
    ) -> Fit:
        """Train all joints' nets. history: train_loss and validation_loss (epochs, members, n), mean squared error of
        the standardised torque."""
        return self.fit_together([self], dataset, [key], validation=validation, progress=progress)[0]

    def alike(self) -> "Ffnn":
        """All but the learning rates."""
        nets = tuple((number, JointNet(net.hidden, 1.0)) for number, net in self.joints)
        return replace(self, learning_rate=1.0, joints=nets)

    def fit_together(
        self,
        models: Sequence[AbstractModel],
        dataset: Dataset,
        keys: Sequence[jax.Array],
        *,
        validation: Dataset | None = None,
        progress: Progress = silent,
    ) -> list[Fit]:
        """The fit of each model, all of them alike, as `fit` with its key gives it: their nets are members of one
        program, or of several where one would take too much memory."""
        motion, tau = dataset.motion, dataset.tau
        n = tau.shape[1]
        weights = sum(_weights(net, self.seeds) for net in (JointNet(self.hidden), *(net for _, net in self.joints)))
        most = max(1, min(MOST_WEIGHTS // weights, MOST_NUMBERS // (4 * n * len(tau) * self.seeds)))
        scales = standardisation(motion, tau)
        data = _standardised(scales, motion, tau)
        watched = _standardised(scales, validation.motion, validation.tau) if validation else None
        schedule = training.Schedule(self.epochs, self.batch_size)
        fits: list[Fit] = []
        for first in range(0, len(models), most):
            some = [model for model in models[first : first + most] if isinstance(model, Ffnn)]
            groups = [model.groups(n) for model in some]
            rates = [
                np.repeat([g.learning_rates for g in same], self.seeds, axis=0) for same in zip(*groups, strict=True)
            ]
            members = jnp.concatenate([self._keys(key) for key in keys[first : first + most]])
            trained = training.train(
                groups[0], schedule, data, watched, members, _part(progress, first, len(some), len(models)), rates=rates
            )
            for k in range(len(some)):
                own = slice(k * self.seeds, (k + 1) * self.seeds)
                fits.append(self._fit(dataset, scales, [_members(x, own) for x in trained], watched is not None))
        return fits

    def _fit(self, dataset: Dataset, scales: PyTree, trained: list[training.Trained], watched: bool) -> Fit:
        n = len(dataset.joints)
        history = {}
        for name in ("train_loss", "validation_loss")[: 2 if watched else 1]:
            history[name] = np.full((self.epochs, self.seeds, n), np.nan)
            for group, result in zip(self.groups(n), trained, strict=True):
                history[name][..., list(group.columns)] = getattr(result, name)
        return network.trained(dataset, scales, _named([x.params for x in trained]), history)

    def predict(self, fit: Fit, motion: Motion) -> np.ndarray:
        """Torques (T, n) of a motion (T, n); one compiled program for all learning rates."""
        return AbstractModel.predict(self.alike(), fit, motion)

    def weights(self, params: PyTree) -> PyTree:
        """The nets."""
        return params["nets"]

    def with_weights(self, params: PyTree, weights: PyTree) -> PyTree:
        """Other nets in the same standardisation."""
        return {**params, "nets": weights}

    def members(self, fit: Fit) -> tuple[Fit, ...]:
        """The nets of each seed as a fit of their own."""

        def member(k: int) -> Fit:
            nets = jax.tree.map(lambda leaf: leaf[k : k + 1], fit.params["nets"])
            return Fit({**fit.params, "nets": nets}, fit.robot, fit.joints, fit.parameters // self.seeds)

        return tuple(member(k) for k in range(self.seeds)) if self.seeds > 1 else (fit,)

    def _keys(self, key: jax.Array) -> jax.Array:
        """A key per member; the first is that of a fit with one seed."""
        return jax.vmap(lambda k: jax.random.fold_in(key, k))(jnp.arange(self.seeds))


def _weights(net: JointNet, seeds: int) -> int:
    """Number of weights of a joint's networks after their inputs."""
    return seeds * sum(a * b for a, b in itertools.pairwise((1, *net.hidden, 1)))


def _members(trained: training.Trained, own: slice) -> training.Trained:
    """Some members of a group."""
    losses = (loss[:, own] for loss in (trained.train_loss, trained.validation_loss))
    return training.Trained(jax.tree.map(lambda leaf: leaf[own], trained.params), *losses)


def _part(progress: Progress, first: int, some: int, every: int) -> Progress:
    """The progress of the models from `first` on as that of every model."""
    return lambda done, note: progress((first + some * done) / every, note)


def _per_joint(given, common: JointNet) -> tuple[tuple[int, JointNet], ...]:
    """The config's {number: {field: value}} (or the finished pairs) as sorted pairs, completed from `common`."""
    names = [f.name for f in fields(JointNet)]
    if not isinstance(given, Mapping | tuple | list):
        raise UsageError(f"model.joints={given}; allowed: {{joint number: {{{', '.join(names)}}}}}")
    pairs = given.items() if isinstance(given, Mapping) else given
    out = []
    for number, net in pairs:
        if isinstance(net, JointNet):
            out.append((int(number), net))
            continue
        if unknown := set(net) - set(names):
            raise UsageError(f"model.joints.{number} has {listed(sorted(unknown))}; allowed: {listed(names)}")
        out.append((int(number), JointNet(**{name: net.get(name, getattr(common, name)) for name in names})))
    return tuple(sorted(out))


def _named(nets: list[PyTree]) -> dict[str, PyTree]:
    return {f"group{i}": params for i, params in enumerate(nets)}


def _standardised(scales: Mapping[str, Array], motion: Motion, tau: np.ndarray) -> training.Data:
    return training.Data(*(jnp.asarray(part, jnp.float32) for part in standardised(scales, motion, tau)))
