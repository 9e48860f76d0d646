"""adaptation=batch: learn once, then change nothing (paper, section V-B)."""

from dataclasses import dataclass

import jax

from invdyn_cli.interfaces import AbstractAdapter, AbstractModel, Progress, silent
from invdyn_cli.types import Array, Dataset, Fit, Motion, PyTree


@dataclass(frozen=True)
class Batch(AbstractAdapter):
    """The model as it was fitted; new samples change nothing."""

    adapts = False

    def fit(
        self,
        model: AbstractModel,
        dataset: Dataset,
        key: jax.Array,
        *,
        validation: Dataset | None = None,
        progress: Progress = silent,
    ) -> Fit:
        """The model's own fit."""
        return model.fit(dataset, key, validation=validation, progress=progress)

    def init(self, model: AbstractModel, fit: Fit) -> PyTree:
        """The fitted parameters and the robot."""
        return fit.params, fit.robot

    def predict(self, model: AbstractModel, state: PyTree, motion: Motion) -> Array:
        """Torque (n,) of one sample."""
        params, robot = state
        return model.apply(params, motion, robot)

    def update(self, model: AbstractModel, state: PyTree, motion: Motion, tau: Array) -> PyTree:
        """The state as it was."""
        return state
