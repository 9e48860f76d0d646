"""What the adaptations share whose pretraining is the model's own fit, and whose state holds its parameters."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp

from invdyn_cli.interfaces import AbstractAdapter, AbstractModel, Progress, silent
from invdyn_cli.types import Array, Dataset, Fit, Motion, PyTree


class AbstractOwnFit(AbstractAdapter):
    """The model's own fit, with details that the adaptation needs; a state with "params" and "robot"."""

    def refuse(self, model: AbstractModel, dataset: Dataset, key: jax.Array) -> None:
        """Raise a UsageError, before anything is learned, for a model that cannot be adapted in this way."""

    def details(self, model: AbstractModel, fit: Fit, dataset: Dataset) -> dict[str, Any]:
        """What is added to the details of the fit."""
        return {}

    def fit(
        self,
        model: AbstractModel,
        dataset: Dataset,
        key: jax.Array,
        *,
        validation: Dataset | None = None,
        progress: Progress = silent,
    ) -> Fit:
        """The model's own fit, with the `details`."""
        self.refuse(model, dataset, key)
        fit = model.fit(dataset, key, validation=validation, progress=progress)
        return replace(fit, details={**fit.details, **self.details(model, fit, dataset)})

    def init(self, model: AbstractModel, fit: Fit) -> PyTree:
        """The fitted parameters and the robot."""
        return {"params": jax.tree.map(jnp.asarray, fit.params), "robot": fit.robot}

    def predict(self, model: AbstractModel, state: PyTree, motion: Motion) -> Array:
        """Torque (n,) of one sample, with the current parameters."""
        return model.apply(state["params"], motion, state["robot"])
