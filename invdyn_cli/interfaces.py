"""The contracts. After reading them you can add a model, an adaptation or a data source as one file and one YAML. The
contract of effects is in `effect_contract`, and can be imported from here as well.

Rules for all of them: a class is either abstract or final, a frozen dataclass whose fields are its hyperparameters
(plain values, or other objects of this kind); what is learned lives in a nested dict of arrays; state is passed in and
given back; randomness comes from a key. `invdyn_cli.testing` checks whether an implementation keeps its contract.
"""

import abc
from collections.abc import Callable, Hashable, Sequence
from typing import Any, ClassVar

import jax
import numpy as np

from invdyn_cli.chunks import CHUNK, in_chunks
from invdyn_cli.effect_contract import (
    AbstractBodyEffect,
    AbstractChannelEffect,
    AbstractEffect,
    AbstractForceEffect,
    AbstractGearEffect,
    AbstractMotionEffect,
    AbstractTorqueEffect,
    Parameter,
    Parameters,
)
from invdyn_cli.errors import UsageError
from invdyn_cli.joints import JointState
from invdyn_cli.log import Log, Recorded
from invdyn_cli.types import Array, Check, Dataset, Fit, Header, Motion, PyTree, Robot, Splits

__all__ = [
    "AbstractAdapter",
    "AbstractBodyEffect",
    "AbstractChannelEffect",
    "AbstractCheck",
    "AbstractEffect",
    "AbstractForceEffect",
    "AbstractGearEffect",
    "AbstractHiddenEffect",
    "AbstractModel",
    "AbstractMotionEffect",
    "AbstractSource",
    "AbstractTorqueEffect",
    "JointState",
    "Parameter",
    "Parameters",
    "Progress",
    "silent",
]

Progress = Callable[[float, str], None]
"""Called with the share that is done, 0 to 1, and a short note (for example a loss)."""


def silent(done: float, note: str) -> None:
    """The progress that shows nothing."""


class AbstractModel(abc.ABC):
    """An inverse dynamics model tau = f(q, qd, qdd)."""

    needs_robot: bool = True
    """Whether `apply` uses the robot's kinematics; a model that does not still runs on a log without a URDF."""
    by_joint: bool = False
    """Whether row j of each `linear` parameter changes the torque of joint j alone."""
    has_memory: bool = False
    """Whether `predict` uses the past of a recording; `apply` is then the torque of its first sample."""

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
        """Learn from a dataset; `validation` is only evaluated, never learned from."""

    def alike(self) -> Hashable | None:
        """A key that is equal for models that can be fitted in one program (`fit_together`), whatever their other
        hyperparameters are; None for a model that is fitted alone."""
        return None

    def fit_together(
        self,
        models: Sequence["AbstractModel"],
        dataset: Dataset,
        keys: Sequence[jax.Array],
        *,
        validation: Dataset | None = None,
        progress: Progress = silent,
    ) -> list[Fit]:
        """The fits of models that are all `alike`, each with its own key; equal to those of `fit`, except for
        rounding."""
        raise NotImplementedError

    def predict(self, fit: Fit, motion: Motion) -> np.ndarray:
        """Torques (T, n) of a motion (T, n): `apply` over all samples, in chunks of one shape (one compilation)."""
        return in_chunks(lambda chunk: _apply_all(self, fit.params, chunk, fit.robot), motion, self.chunk(motion))

    def chunk(self, motion: Motion) -> int:
        """Number of samples that `predict` computes at a time: fewer if one needs much memory."""
        return CHUNK

    def weights(self, params: PyTree) -> PyTree:
        """The parameters that gradient descent may change while the robot works; UsageError if there are none."""
        got = f"{type(self).__name__} has no weights that can be adapted"
        raise UsageError(got, advice="a model with weights: ffnn, ffnn_deep, lagrangian_net")

    def with_weights(self, params: PyTree, weights: PyTree) -> PyTree:
        """The parameters with other weights."""
        raise NotImplementedError

    def linear(self, params: PyTree) -> PyTree:
        """The parameters in which the torque is linear, or nearly linear; UsageError if there are none."""
        raise UsageError(f"{type(self).__name__} has no linear parameters", advice="pest, standard, extended or rff")

    def with_linear(self, params: PyTree, linear: PyTree) -> PyTree:
        """The parameters with the linear ones replaced."""
        return {**params, **linear}

    def learned_from(self, params: PyTree, motion: Motion, tau: Array, robot: Robot | None) -> PyTree:
        """Parameters of the same shapes after ONE more measured sample; UsageError for a model without this update."""
        raise UsageError(f"{type(self).__name__} does not learn from single samples", advice="model=local_gp")

    def members(self, fit: Fit) -> tuple[Fit, ...]:
        """The single models that a fit of several seeds holds; most fits hold one: themselves."""
        return (fit,)


class AbstractAdapter(abc.ABC):
    """A way to learn a model, and to continue learning while the robot works.

    `fit` is the pretraining; then predict comes before learn: `predict(state, …)`, `update(state, …)`, both pure, so
    that they run in `lax.scan` over a log and sample by sample in a control loop.
    """

    adapts: bool = True
    """Whether `update` changes anything; then the test set is also scored during adaptation ("test_adapted")."""
    if_diverged: str = ""
    """Advice for the case that its torques are no longer finite: the end of a sentence."""

    @property
    def block(self) -> int:
        """Number of samples that are learned from at once; predictions between two updates use the same state."""
        return 1

    def extended(self, model: AbstractModel) -> AbstractModel:
        """The model that is fitted instead of `model`: with the parts that this adaptation adds."""
        return model

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
        """Torque (n,) of ONE sample with the current state."""

    @abc.abstractmethod
    def update(self, model: AbstractModel, state: PyTree, motion: Motion, tau: Array) -> PyTree:
        """The state after ONE more measured sample."""

    def trace(self, state: PyTree) -> dict[str, Array]:
        """A few numbers by name that are worth a curve; NaN for unknown ones."""
        return {}

    def learn(self, model: AbstractModel, state: PyTree, motion: Motion, tau: Array) -> PyTree:
        """The state after a whole block of samples (block, n): the result of as many calls of `update`, or a faster
        equivalent."""

        def step(state: PyTree, sample: tuple[Motion, Array]) -> tuple[PyTree, None]:
            return self.update(model, state, *sample), None

        return jax.lax.scan(step, state, (motion, tau))[0]


class AbstractSource(abc.ABC):
    """A source of data: it makes or reads them, and divides them into training, validation and test data."""

    needs_robot: bool = True
    """Whether data can only be made with a robot's kinematics."""
    has_log: bool = False
    """Whether there is a log as it was recorded, for `invdyn check` and `invdyn diagnose`."""

    def header(self) -> Header | None:
        """What the data say about their robot; None for data that can be made with any robot."""
        return None

    @abc.abstractmethod
    def load(self, robot: Robot | None, progress: Progress = silent) -> Splits:
        """The data, split. Raises LogError for a log that cannot be used as asked."""

    def recorded(self, robot: Robot | None, progress: Progress = silent) -> Recorded:
        """The log as recorded, with its columns in the robot's order; called if `has_log`. Raises LogError as
        `load`."""
        raise NotImplementedError(f"{type(self).__name__} has no log")


class AbstractHiddenEffect(abc.ABC):
    """An effect of your own in the simulated arm (`data=plant`), in addition to its URDF."""

    name: ClassVar[str]
    """What the log's truth calls it."""
    joint: str | None
    """The joint that it acts on; None: all of them."""

    @abc.abstractmethod
    def force(self, t: float, q: Any, qd: Any) -> Any:
        """The part of the logged torque that does not move the arm [N m; N], at t [s] of the log: for the joint's own
        true angle [rad; m] and speed, or (n,) for those of all joints (n,)."""


class AbstractCheck(abc.ABC):
    """One check of a log; its fields are thresholds, each with its source beside it."""

    name: ClassVar[str] = ""
    """Its name in check.json."""
    again: bool = False
    """Whether it runs a second time, and then reports only its new findings."""

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if hasattr(cls, "mend"):
            raise TypeError(f"invdyn does not call {cls.__name__}.mend: rename the method to `correct`")

    @abc.abstractmethod
    def examine(self, log: Log, robot: Robot | None) -> list[Check]:
        """The findings in a log; without a robot, those of checks that need none. Parts that could not be examined are
        `skipped`."""

    def skipped(self, why: str, channel: str | None = None, trajectory: str | None = None) -> Check:
        """The entry that says that this check, or its part for a channel, was not made, and why."""
        return Check(self.name, "skipped", trajectory, threshold={"channel": channel} if channel else None, seen=why)

    def correct(self, log: Log, found: Sequence[Check], robot: Robot | None) -> tuple[Log, list[str]]:
        """The log with its own findings corrected if the correction is certain, and a sentence for each correction."""
        return log, []


@jax.jit(static_argnums=0)
def _apply_all(model: AbstractModel, params: PyTree, motion: Motion, robot: Robot | None) -> Any:
    return jax.vmap(lambda one: model.apply(params, one, robot))(motion)
