"""adaptation=error_model: networks on the residual of a model, pretrained, then adapted or frozen (paper, IV-B)."""

from dataclasses import dataclass, field
from typing import Any

import jax

from invdyn_cli.adaptation.incremental import AbstractDescent, Incremental
from invdyn_cli.adaptation.own_fit import AbstractOwnFit
from invdyn_cli.hybrid import Hybrid
from invdyn_cli.interfaces import AbstractModel
from invdyn_cli.types import Array, Dataset, Fit, Motion, PyTree


@dataclass(frozen=True)
class ErrorModel(AbstractOwnFit):
    """tau = model + learner, equations 9 and 10: the model is fitted once, the learner continues to learn.

    Attributes:
        learner: model that learns the residual of the main model.
        adapted: whether the learner continues to learn; otherwise it stays as pretrained.
        incremental: how the learner continues to learn, see adaptation=incremental and memory_learning_rate.
    """

    learner: AbstractModel
    adapted: bool = True
    incremental: AbstractDescent = field(default_factory=Incremental)

    if_diverged = "a lower adaptation.incremental.learning_rate may help"

    @property
    def adapts(self) -> bool:  # type: ignore[override]
        """Whether the learner continues to learn."""
        return self.adapted

    @property
    def block(self) -> int:
        """The update interval of the learner [samples]."""
        return self.incremental.block

    def extended(self, model: AbstractModel) -> AbstractModel:
        """The model, and the learner on its residual."""
        return Hybrid(model, self.learner)

    def refuse(self, model: AbstractModel, dataset: Dataset, key: jax.Array) -> None:
        """The same as that of `incremental`."""
        self.incremental.refuse(model, dataset, key)

    def details(self, model: AbstractModel, fit: Fit, dataset: Dataset) -> dict[str, Any]:
        """The same as those of `incremental`."""
        return self.incremental.details(model, fit, dataset)

    def init(self, model: AbstractModel, fit: Fit) -> PyTree:
        """The same as that of `incremental`."""
        return self.incremental.init(model, fit)

    def update(self, model: AbstractModel, state: PyTree, motion: Motion, tau: Array) -> PyTree:
        """The state after the learner has learned from one sample."""
        return self.incremental.update(model, state, motion, tau) if self.adapted else state

    def learn(self, model: AbstractModel, state: PyTree, motion: Motion, tau: Array) -> PyTree:
        """The state after the learner has learned from one block."""
        return self.incremental.learn(model, state, motion, tau) if self.adapted else state
