"""adaptation=online: a model that has its own update for single samples continues to use it while the robot works."""

from dataclasses import dataclass

import jax

from invdyn_cli.adaptation.own_fit import AbstractOwnFit
from invdyn_cli.interfaces import AbstractModel
from invdyn_cli.types import Array, Dataset, Motion, PyTree


@dataclass(frozen=True)
class OnlineUpdate(AbstractOwnFit):
    """The model's own update (`AbstractModel.learned_from`), sample by sample: model=local_gp."""

    def refuse(self, model: AbstractModel, dataset: Dataset, key: jax.Array) -> None:
        """Raise a UsageError for a model without an update of its own."""
        params = model.init(dataset, key)
        first, tau = jax.tree.map(lambda x: x[0], dataset.motion), dataset.tau[0]
        jax.eval_shape(lambda p: model.learned_from(p, first, tau, dataset.robot), params)

    def update(self, model: AbstractModel, state: PyTree, motion: Motion, tau: Array) -> PyTree:
        """The parameters after one more sample."""
        return {**state, "params": model.learned_from(state["params"], motion, tau, state["robot"])}
