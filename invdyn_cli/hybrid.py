"""model=hybrid, also used by adaptation=error_model: a model, and a learner of its residual.

They are fitted one after the other on the same data:

tau = base(q, qd, qdd) + learner(q, qd, qdd), the learner's target being tau - base (paper, equations 9 and 10, in
batch).
"""

from dataclasses import dataclass, replace

import jax

from invdyn_cli.interfaces import AbstractModel, Progress, silent
from invdyn_cli.types import Array, Dataset, Fit, Motion, PyTree, Robot


@dataclass(frozen=True)
class Hybrid(AbstractModel):
    """Any two models, the second on the residual of the first.

    Attributes:
        base: model that learns the torque.
        learner: model that learns the residual of the base.
    """

    base: AbstractModel
    learner: AbstractModel

    @property
    def needs_robot(self) -> bool:  # type: ignore[override]
        """Whether either part does."""
        return self.base.needs_robot or self.learner.needs_robot

    @property
    def by_joint(self) -> bool:  # type: ignore[override]
        """Whether the base is by joint: its linear parameters are those of the hybrid."""
        return self.base.by_joint

    @property
    def has_memory(self) -> bool:  # type: ignore[override]
        """Whether either part does."""
        return self.base.has_memory or self.learner.has_memory

    def init(self, dataset: Dataset, key: jax.Array) -> PyTree:
        """Both parts' parameters."""
        base_key, learner_key = jax.random.split(key)
        return {"base": self.base.init(dataset, base_key), "learner": self.learner.init(dataset, learner_key)}

    def apply(self, params: PyTree, motion: Motion, robot: Robot | None) -> Array:
        """Torque (n,) of one sample, the sum."""
        return self.base.apply(params["base"], motion, robot) + self.learner.apply(params["learner"], motion, robot)

    def fit(
        self, dataset: Dataset, key: jax.Array, *, validation: Dataset | None = None, progress: Progress = silent
    ) -> Fit:
        """Fit the base, then the learner to its residual; details are the base's, history the learner's."""
        base_key, learner_key = jax.random.split(key)
        base = self.base.fit(dataset, base_key, validation=validation)
        left = self._residual(base, dataset)
        watched = self._residual(base, validation) if validation else None
        learner = self.learner.fit(left, learner_key, validation=watched, progress=progress)
        return Fit(
            params={"base": base.params, "learner": learner.params},
            robot=dataset.robot,
            joints=dataset.joints,
            parameters=base.parameters + learner.parameters,
            history=learner.history,
            details={**learner.details, **base.details},
            warnings=base.warnings + learner.warnings,
        )

    def predict(self, fit: Fit, motion: Motion) -> Array:
        """Torques (T, n), each part predicted its own way."""
        base, learner = (replace(fit, params=fit.params[part]) for part in ("base", "learner"))
        return self.base.predict(base, motion) + self.learner.predict(learner, motion)

    def weights(self, params: PyTree) -> PyTree:
        """The learner's."""
        return self.learner.weights(params["learner"])

    def with_weights(self, params: PyTree, weights: PyTree) -> PyTree:
        """The learner with other weights, on the same base."""
        return {**params, "learner": self.learner.with_weights(params["learner"], weights)}

    def linear(self, params: PyTree) -> PyTree:
        """The base's."""
        return self.base.linear(params["base"])

    def with_linear(self, params: PyTree, linear: PyTree) -> PyTree:
        """The base with other linear parameters under the same learner."""
        return {**params, "base": self.base.with_linear(params["base"], linear)}

    def members(self, fit: Fit) -> tuple[Fit, ...]:
        """The members of the learner, each with the same base."""
        learners = self.learner.members(replace(fit, params=fit.params["learner"]))
        return tuple(replace(x, params={"base": fit.params["base"], "learner": x.params}) for x in learners)

    def _residual(self, base: Fit, dataset: Dataset) -> Dataset:
        left = (replace(x, tau=x.tau - self.base.predict(base, x.motion)) for x in dataset.trajectories)
        return replace(dataset, trajectories=tuple(left))
