"""adaptation=error_model: nets on what a model leaves over, pretrained, then adapted or frozen (paper, IV-B)."""

from dataclasses import dataclass, field

import jax

from invdyn_cli.adaptation.incremental import AbstractDescent, Incremental
from invdyn_cli.hybrid import Hybrid
from invdyn_cli.interfaces import AbstractAdapter, AbstractModel, Progress, silent
from invdyn_cli.types import Array, Dataset, Fit, Motion, PyTree


@dataclass(frozen=True)
class ErrorModel(AbstractAdapter):
    """tau = model + learner, equations 9 and 10: the model is learned once, the learner goes on.

    Attributes:
        learner: model that learns the residual of the main model.
        adapted: whether the learner goes on learning; otherwise it stays as pretrained.
        incremental: how the learner goes on learning, see adaptation=incremental and memory_learning_rate.
    """

    learner: AbstractModel
    adapted: bool = True
    incremental: AbstractDescent = field(default_factory=Incremental)

    if_diverged = "a lower adaptation.incremental.learning_rate may help"

    @property
    def adapts(self) -> bool:  # type: ignore[override]
        """Whether the learner goes on."""
        return self.adapted

    @property
    def block(self) -> int:
        """The rate at which the learner goes on."""
        return self.incremental.block

    def extended(self, model: AbstractModel) -> AbstractModel:
        """The model and the learner on what it leaves."""
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
        """As `incremental`'s."""
        return self.incremental.init(model, fit)

    def predict(self, model: AbstractModel, state: PyTree, motion: Motion) -> Array:
        """Torque (n,) of one sample."""
        return self.incremental.predict(model, state, motion)

    def update(self, model: AbstractModel, state: PyTree, motion: Motion, tau: Array) -> PyTree:
        """The learner one sample further."""
        return self.incremental.update(model, state, motion, tau) if self.adapted else state

    def learn(self, model: AbstractModel, state: PyTree, motion: Motion, tau: Array) -> PyTree:
        """The learner one block further."""
        return self.incremental.learn(model, state, motion, tau) if self.adapted else state
