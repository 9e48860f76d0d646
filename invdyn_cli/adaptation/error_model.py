"""adaptation=error_model: networks on the residual of a model, pretrained, then adapted or frozen (paper, IV-B)."""

from dataclasses import dataclass, field

import jax

from invdyn_cli.adaptation.incremental import AbstractDescent, Incremental
from invdyn_cli.hybrid import Hybrid
from invdyn_cli.interfaces import AbstractAdapter, AbstractModel, Progress, silent
from invdyn_cli.types import Array, Dataset, Fit, Motion, PyTree


@dataclass(frozen=True)
class ErrorModel(AbstractAdapter):
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

    def fit(
        self,
        model: AbstractModel,
        dataset: Dataset,
        key: jax.Array,
        *,
        validation: Dataset | None = None,
        progress: Progress = silent,
    ) -> Fit:
        """The model, then the learner on its residual."""
        return self.incremental.fit(model, dataset, key, validation=validation, progress=progress)

    def init(self, model: AbstractModel, fit: Fit) -> PyTree:
        """The same as that of `incremental`."""
        return self.incremental.init(model, fit)

    def predict(self, model: AbstractModel, state: PyTree, motion: Motion) -> Array:
        """Torque (n,) of one sample."""
        return self.incremental.predict(model, state, motion)

    def update(self, model: AbstractModel, state: PyTree, motion: Motion, tau: Array) -> PyTree:
        """The state after the learner has learned from one sample."""
        return self.incremental.update(model, state, motion, tau) if self.adapted else state

    def learn(self, model: AbstractModel, state: PyTree, motion: Motion, tau: Array) -> PyTree:
        """The state after the learner has learned from one block."""
        return self.incremental.learn(model, state, motion, tau) if self.adapted else state
