"""adaptation=online: a model that has its own update for single samples continues to use it while the robot works."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from invdyn_cli.interfaces import AbstractAdapter, AbstractModel, Progress, silent
from invdyn_cli.types import Array, Dataset, Fit, Motion, PyTree


@dataclass(frozen=True)
class OnlineUpdate(AbstractAdapter):
    """The model's own update (`AbstractModel.learned_from`), sample by sample: model=local_gp."""

    def fit(
        self,
        model: AbstractModel,
        dataset: Dataset,
        key: jax.Array,
        *,
        validation: Dataset | None = None,
        progress: Progress = silent,
    ) -> Fit:
        """The model's own fit; UsageError for a model without an update of its own."""
        params = model.init(dataset, key)
        first, tau = jax.tree.map(lambda x: x[0], dataset.motion), dataset.tau[0]
        jax.eval_shape(lambda p: model.learned_from(p, first, tau, dataset.robot), params)
        return model.fit(dataset, key, validation=validation, progress=progress)

    def init(self, model: AbstractModel, fit: Fit) -> PyTree:
        """The fitted parameters and the robot."""
        return {"params": jax.tree.map(jnp.asarray, fit.params), "robot": fit.robot}

    def predict(self, model: AbstractModel, state: PyTree, motion: Motion) -> Array:
        """Torque (n,) of one sample."""
        return model.apply(state["params"], motion, state["robot"])

    def update(self, model: AbstractModel, state: PyTree, motion: Motion, tau: Array) -> PyTree:
        """The parameters after one more sample."""
        return {**state, "params": model.learned_from(state["params"], motion, tau, state["robot"])}
