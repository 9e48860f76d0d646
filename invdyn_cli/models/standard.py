"""model=standard: what every real arm has in addition to its URDF, in one fit with a prior (`maths/standard.py`)."""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from invdyn_cli.errors import UsageError
from invdyn_cli.fields import positive
from invdyn_cli.interfaces import AbstractModel, Progress, silent
from invdyn_cli.maths import regression, rigid_body, standard, statistics
from invdyn_cli.maths.regression import Design
from invdyn_cli.maths.standard import Standard as Fitted
from invdyn_cli.maths.standard import Sums
from invdyn_cli.models import rigid_model
from invdyn_cli.types import Array, Dataset, Fit, Motion, PyTree, Robot

TERMS = ("offset", "coulomb", "viscous", "armature")
"""Columns beside the inertial ones."""


@dataclass(frozen=True)
class Standard(AbstractModel):
    """The URDF's links with errors of some percent, and friction, an offset and a rotor on every joint.

    Least squares with a prior around the URDF: parameters that the motion does not determine stay as in the URDF, so
    that few data suffice and the model is valid for other motions. `share` is chosen by leaving motions out if the
    training data contain several different ones, otherwise by the evidence.

    Attributes:
        share: [-] standard deviation of the URDF's inertial parameters, as a share of a link's scales; None: learned
            from the data.
        rotor_inertia: whether a rotor inertia per joint is fitted (only if the torque is measured at the motor).
        rest_speed: [rad/s; m/s] speed below which the sign of a measured velocity is noise.
    """

    share: float | None = None
    rotor_inertia: bool = True
    rest_speed: float = regression.REST_SPEED

    def __post_init__(self) -> None:
        if self.share is not None and not self.share > 0:
            raise UsageError(f"model.share={self.share}; allowed: a number above 0, or null")
        positive(self, "model", "rest_speed")

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the columns that every joint has in addition to the inertial ones."""
        return TERMS if self.rotor_inertia else TERMS[:-1]

    def init(self, dataset: Dataset, key: jax.Array) -> PyTree:
        """The URDF as it is: {"psi": (n, 10), and (n,) each of `terms`}."""
        n = len(dataset.joints)
        psi = jnp.zeros((n, 10)) if dataset.robot is None else jnp.asarray(dataset.robot.inertial)
        return {"psi": psi, **{name: jnp.zeros(n) for name in self.terms}}

    def apply(self, params: PyTree, motion: Motion, robot: Robot | None) -> Array:
        """Torque (n,) of one sample."""
        assert robot is not None
        columns = regression.extra_columns(self.terms, motion, self.rest_speed)
        return rigid_model.torque(robot, params["psi"], motion, [params[name] for name in self.terms], columns)

    def linear(self, params: PyTree) -> PyTree:
        """All of them."""
        return params

    def predict(self, fit: Fit, motion: Motion) -> np.ndarray:
        """Torques (T, n)."""
        return rigid_model.torques(self, fit.params, motion, fit.robot)

    def fit(
        self, dataset: Dataset, key: jax.Array, *, validation: Dataset | None = None, progress: Progress = silent
    ) -> Fit:
        """The coefficients of largest posterior, after Gram matrices of every motion.

        details: share (s), chosen (how), std {term: (n,)} and of the links (n, 10), noise (n,), effective_samples (n,).

        Raises:
            UsageError: if the dataset has no robot.
        """
        robot = dataset.robot
        if robot is None:
            raise UsageError(
                "model=standard needs the robot's URDF, but these data have none",
                advice="robot=urdf robot.path=arm.urdf, or a model that needs no robot (model=ffnn)",
            )
        motions = []
        for k, one in enumerate(dataset.trajectories):
            motions.append(_sums(self, robot, one.motion, one.tau))
            progress(0.8 * (k + 1) / len(dataset.trajectories), "regressor")
        motions = standard.distinct(motions)
        beside = np.repeat(self.terms, robot.dofs)
        inertial = np.concatenate([standard.link_scales(robot).ravel(), np.zeros(len(beside))])
        positive = np.concatenate([np.zeros(10 * robot.dofs, bool), beside != "offset"])
        prior = standard.prior_of(motions, inertial, positive)
        times = np.ones(robot.dofs)
        first = standard.fit(motions, prior, times, standard.USUAL)
        times = self._correlation(dataset, self._params(robot, first))
        found = standard.fit(motions, prior, times, self.share)
        std = np.sqrt(np.diag(found.covariance))
        spread = std[10 * robot.dofs :].reshape(-1, robot.dofs)
        return Fit(
            params=self._params(robot, found),
            robot=robot,
            joints=dataset.joints,
            parameters=len(found.theta),
            details={
                "share": found.share,
                "chosen": found.chosen,
                "std": {"psi": std[: 10 * robot.dofs].reshape(-1, 10), **dict(zip(self.terms, spread, strict=True))},
                "noise": found.noise,
                "effective_samples": dataset.samples / times,
            },
        )

    def _params(self, robot: Robot, found: Fitted) -> PyTree:
        links, beside = found.theta[: 10 * robot.dofs], found.theta[10 * robot.dofs :].reshape(-1, robot.dofs)
        return {"psi": robot.inertial + links.reshape(-1, 10), **dict(zip(self.terms, beside, strict=True))}

    def _correlation(self, dataset: Dataset, params: PyTree) -> np.ndarray:
        """Autocorrelation time (n,) [samples] of the residual, the longest of all trajectories."""
        times = np.ones(len(dataset.joints))
        for one in dataset.trajectories:
            rows = slice(0, regression.RESIDUALS)
            left = one.tau[rows] - rigid_model.torques(self, params, one.motion[rows], dataset.robot)
            times = np.maximum(times, [statistics.autocorrelation_time(x) for x in left.T])
        return times


def _sums(model: Standard, robot: Robot, motion: Motion, tau: Array) -> Sums:
    """The data of one trajectory, in chunks of few shapes."""
    p = (10 + len(model.terms)) * robot.dofs
    grams = jnp.zeros((robot.dofs, p + 1, p + 1))
    design = Design(robot, model.terms, np.ones(robot.dofs), model.rest_speed)
    for part, torque, valid in regression.chunks(motion, tau):
        grams = _added(design, part, torque, valid, grams)
    return Sums(np.asarray(grams), np.full(robot.dofs, len(tau)))


@partial(jax.jit, donate_argnums=4)
def _added(design: Design, motion: Motion, tau: Array, valid: Array, grams: Array) -> Array:
    def add(grams, block):
        motion, tau, valid = block
        rows = regression.design_rows(design, motion, valid)
        robot = design.robot
        nominal = rigid_body.inverse_dynamics(robot, robot.inertial, motion.q, motion.qd, motion.qdd)
        rows = jnp.concatenate([rows, ((tau - nominal) * valid)[None]])
        return grams + jnp.einsum("pnb,qnb->npq", rows, rows), None

    return jax.lax.scan(add, grams, regression.blocks(motion, tau, valid))[0]
