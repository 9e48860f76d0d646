"""The contracts, in one file: who has read it can add a model, an adaptation or a data source as one file and one YAML.

Rules for all of them: a class is either abstract or final, a frozen dataclass whose fields are its hyperparameters
(plain values, or other objects of this kind); what is learned lives in a nested dict of arrays; state is passed in and
given back; randomness comes from a key. `invdyn_cli.testing` checks whether an implementation keeps its contract.
"""

import abc
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from invdyn_cli.types import Array, Dataset, Fit, Header, Motion, PyTree, Robot, Splits

Progress = Callable[[float, str], None]
"""Called with the share that is done, 0 to 1, and a short note (a loss, say)."""


def silent(done: float, note: str) -> None:
    """The progress that shows nothing."""


class AbstractModel(abc.ABC):
    """An inverse dynamics model tau = f(q, qd, qdd)."""

    needs_robot: bool = True
    """Whether `apply` uses the robot's kinematics; a model that does not still runs on a log without a URDF."""

    @abc.abstractmethod
    def init(self, dataset: Dataset, key: jax.Array) -> PyTree:
        """Parameters before learning, of the shapes that this dataset asks for: a nested dict of arrays."""

    @abc.abstractmethod
    def apply(self, params: PyTree, motion: Motion, robot: Robot | None) -> Array:
        """Torque (n,) of ONE sample, a motion of (n,) arrays. Pure and differentiable in `params` and `motion`."""

    @abc.abstractmethod
    def fit(
        self, dataset: Dataset, key: jax.Array, *, validation: Dataset | None = None, progress: Progress = silent
    ) -> Fit:
        """Learn from a dataset; `validation` is watched, never learned from."""

    def predict(self, fit: Fit, motion: Motion) -> np.ndarray:
        """Torques (T, n) of a motion (T, n): `apply` over all samples, in chunks of one shape (one compilation)."""
        return in_chunks(lambda chunk: _apply_all(self, fit.params, chunk, fit.robot), motion)

    def members(self, fit: Fit) -> tuple[Fit, ...]:
        """The single models that a fit of several seeds holds; most fits hold one: themselves."""
        return (fit,)


class AbstractAdapter(abc.ABC):
    """A way to learn a model, and to go on learning while the robot works.

    `fit` is the pretraining; then predict comes before learn: `predict(state, …)`, `update(state, …)`, both pure, so
    that they run in `lax.scan` over a log and sample by sample in a control loop.
    """

    adapts: bool = True
    """Whether `update` changes anything; then the test set is also judged as it is adapted to ("test_adapted")."""

    @abc.abstractmethod
    def fit(
        self,
        model: AbstractModel,
        dataset: Dataset,
        key: jax.Array,
        *,
        validation: Dataset | None = None,
        progress: Progress = silent,
    ) -> Fit:
        """Pretrain."""

    @abc.abstractmethod
    def init(self, model: AbstractModel, fit: Fit) -> PyTree:
        """The state before the first new sample."""

    @abc.abstractmethod
    def predict(self, model: AbstractModel, state: PyTree, motion: Motion) -> Array:
        """Torque (n,) of ONE sample with what is known so far."""

    @abc.abstractmethod
    def update(self, model: AbstractModel, state: PyTree, motion: Motion, tau: Array) -> PyTree:
        """The state after ONE more measured sample."""


class AbstractSource(abc.ABC):
    """Where data come from: it makes or reads them, and says what is learned from and what is judged."""

    needs_robot: bool = True
    """Whether data can only be made with a robot's kinematics."""

    def header(self) -> Header | None:
        """What the data know about their robot; None for data that any robot can make."""
        return None

    @abc.abstractmethod
    def load(self, robot: Robot | None, progress: Progress = silent) -> Splits:
        """The data, split. Raises LogError for a log that cannot be used as asked."""


@dataclass(frozen=True)
class FittedModel:
    """A model with what it has learned: three lines from run.h5 to torques."""

    model: AbstractModel
    fit: Fit

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the columns, in order."""
        return self.fit.joints

    def predict(self, q: Array, qd: Array, qdd: Array) -> np.ndarray:
        """Torques (T, n) [N m; N] of a motion given as (T, n), or (n,) for one sample.

        Raises:
            ValueError: if the arrays are not of one shape with n columns.
        """
        arrays = [np.asarray(x, float) for x in (q, qd, qdd)]
        shapes = [x.shape for x in arrays]
        if len(set(shapes)) > 1 or not shapes[0] or shapes[0][-1] != len(self.joints) or len(shapes[0]) > 2:
            raise ValueError(
                f"q, qd, qdd have shapes {shapes}; allowed: one shape, (T, {len(self.joints)}) or ({len(self.joints)},)"
            )
        tau = self.model.predict(self.fit, Motion(*(np.atleast_2d(x) for x in arrays)))
        return tau.reshape(shapes[0])


CHUNK = 4096
"""Samples that go through a jitted function at once: big enough to hide its call, small enough to stay in cache."""


def in_chunks(function: Callable[[Motion], Array], motion: Motion) -> np.ndarray:
    """`function` of a motion (T, n) in chunks padded to powers of two up to CHUNK, few compilations: (T, n)."""
    total = len(motion)
    size = min(CHUNK, 1 << max(0, total - 1).bit_length())
    out = [np.empty((0, motion.q.shape[1]))]
    for start in range(0, total, size):
        part = motion[slice(start, start + size)]
        missing = size - len(part)
        padded = jax.tree.map(lambda x, m=missing: np.pad(x, ((0, m), (0, 0)), mode="edge"), part) if missing else part
        out.append(np.asarray(function(padded))[: len(part)])
    return np.concatenate(out).astype(float)


@jax.jit(static_argnums=0)
def _apply_all(model: AbstractModel, params: PyTree, motion: Motion, robot: Robot | None) -> Any:
    return jax.vmap(lambda one: model.apply(params, one, robot))(motion)
