"""model=pest: inertial parameter estimation, tau = K psi by a truncated singular value decomposition (paper, III-A)."""

from dataclasses import dataclass, replace
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np

from invdyn_cli.errors import UsageError
from invdyn_cli.fields import positive
from invdyn_cli.interfaces import AbstractModel, Progress, silent
from invdyn_cli.maths import links, regression, ripple
from invdyn_cli.maths.metrics import rms
from invdyn_cli.maths.regression import Design, Solution
from invdyn_cli.models import rigid_model
from invdyn_cli.types import Array, Dataset, Fit, Motion, PyTree, Robot

SCANNED = 20_000
"""Samples in which ripples are sought."""

LINE = 0.1
"""Share of a joint's residual torque from which on a line over the angle counts as ripple."""

MOST_RIPPLES = 50
"""Largest number of ripple lines that are searched: a wave generator and a motor have a dozen."""


@dataclass(frozen=True)
class Pest(AbstractModel):
    """Inertial parameters by least squares, without the directions that the data do not excite.

    Attributes:
        threshold: [-] singular values of the regressor at or below it are set to zero (paper, III-A: 0.001).
        relative: whether the threshold is a share of the largest singular value; the paper's is absolute, a relative
            one removes real base parameters when the motion is small.
        weighting: torque_spread divides the rows of each joint by the standard deviation of its torque, so that the
            noise of a strong joint does not dominate a weak one; none is the paper's.
        friction: friction columns of each joint: none (the paper's), coulomb_viscous (sign(qd) and qd) or stribeck
            (also terms that decay with speed, `regression.STRIBECK`).
        offset: whether a constant torque per joint is fitted (zero error of a sensor or drive).
        rotor_inertia: whether a term in qdd per joint is fitted (reflected rotor inertia; only if the torque is
            measured at the motor).
        consistent: whether the fit yields physically consistent links, which a simulator needs, as near to the URDF's
            as the data allow; otherwise it yields the least-squares solution of the smallest norm.
        rest_speed: [rad/s; m/s] speed below which the sign of a measured velocity is noise.
        least_speed: [rad/s; m/s] samples of a joint below this speed are not learned from: friction near rest is
            indeterminate.
        ripples: number of torque-ripple frequencies per joint, each found in the residual: sin(c q), cos(c q).
    """

    threshold: float = 1e-3
    relative: bool = False
    weighting: Literal["none", "torque_spread"] = "none"
    friction: Literal["none", "coulomb_viscous", "stribeck"] = "none"
    offset: bool = False
    rotor_inertia: bool = False
    consistent: bool = False
    rest_speed: float = regression.REST_SPEED
    least_speed: float = 0.0
    ripples: int = 0

    def __post_init__(self) -> None:
        for name, value, allowed in (
            ("weighting", self.weighting, ("none", "torque_spread")),
            ("friction", self.friction, ("none", "coulomb_viscous", "stribeck")),
        ):
            if value not in allowed:
                raise UsageError(f"model.{name}={value!r}; allowed: {', '.join(allowed)}")
        if not (isinstance(self.ripples, int) and 0 <= self.ripples <= MOST_RIPPLES):
            raise UsageError(f"model.ripples={self.ripples}; allowed: a whole number from 0 to {MOST_RIPPLES}")
        positive(self, "model", "rest_speed")
        for name in ("threshold", "least_speed"):
            if not getattr(self, name) >= 0:
                raise UsageError(f"model.{name}={getattr(self, name)}; allowed: a number >= 0")

    @property
    def extras(self) -> tuple[str, ...]:
        """Names of the columns that every joint has in addition to the inertial ones."""
        chosen = {
            "coulomb": self.friction != "none",
            "viscous": self.friction != "none",
            "offset": self.offset,
            "armature": self.rotor_inertia,
            **dict.fromkeys((f"stribeck_{i}" for i in range(len(regression.STRIBECK))), self.friction == "stribeck"),
            **{f"ripple_{i}_{wave}": True for i in range(self.ripples) for wave in ("sin", "cos")},
        }
        return tuple(name for name, wanted in chosen.items() if wanted)

    def init(self, dataset: Dataset, key: jax.Array) -> PyTree:
        """All parameters zero: {"psi": (n, 10), "extras": (columns, n), "cycles": (ripples, n)}."""
        n = len(dataset.joints)
        shapes = {"psi": (n, 10), "extras": (len(self.extras), n), "cycles": (self.ripples, n)}
        return {name: jnp.zeros(shape) for name, shape in shapes.items()}

    def apply(self, params: PyTree, motion: Motion, robot: Robot | None) -> Array:
        """Torque (n,) of one sample, equation 5."""
        assert robot is not None
        columns = regression.extra_columns(self.extras, motion, self.rest_speed, params["cycles"])
        return rigid_model.torque(robot, params["psi"], motion, params["extras"], columns)

    def linear(self, params: PyTree) -> PyTree:
        """psi and the extra columns' coefficients."""
        return {name: params[name] for name in ("psi", "extras")}

    def predict(self, fit: Fit, motion: Motion) -> np.ndarray:
        """Torques (T, n)."""
        return rigid_model.torques(self, fit.params, motion, fit.robot)

    def fit(
        self, dataset: Dataset, key: jax.Array, *, validation: Dataset | None = None, progress: Progress = silent
    ) -> Fit:
        """Least squares over all rows; standard deviations count the residuals' autocorrelation.

        details: rank, singular_values (descending), threshold (in use), base_parameters {names, expressions, values,
        std}, effective_samples (n,), blocks (independent stretches); where `consistent`, consistent {cost, chance}: the
        rise of the squares that its links cost, in noise variances, and that which true links cost at most by chance.

        Raises:
            UsageError: if the dataset has no robot.
        """
        robot = dataset.robot
        if robot is None:
            raise UsageError(
                "model=pest needs the robot's kinematics, but these data have no URDF",
                advice="robot=urdf robot.path=arm.urdf, or a model that needs no robot (model=ffnn)",
            )
        design, solution = self._solved(robot, dataset, lambda done, note: progress(0.6 * done, note))
        covariance, details = regression.uncertainty(
            design, dataset, solution, lambda done, note: progress(0.6 + 0.4 * done, f"rank {solution.rank}, {note}")
        )
        params = _params(solution.psi, design)
        blocks = details["blocks"]
        held = f"{blocks} independent stretch{'es' * (blocks != 1)}"
        few = blocks < regression.FEW_BLOCKS
        warnings = (f"The residuals hold only {held}: standard deviations are rough.",) * few
        if self.consistent:
            psi, cost, chance = links.consistent(robot, solution, covariance)
            if cost > chance:
                change = rms(_torques(self, _params(psi - solution.psi, design), dataset))
                warnings += (links.sentence(cost, chance, change, robot),)
            params, details = _params(psi, design), {**details, "consistent": {"cost": cost, "chance": chance}}
        return Fit(
            params=params,
            robot=robot,
            joints=dataset.joints,
            parameters=solution.rank,
            details={
                "rank": solution.rank,
                "singular_values": solution.singular_values,
                "threshold": solution.threshold,
                "base_parameters": regression.base_parameters(design, solution, covariance),
                **details,
            },
            warnings=warnings,
        )

    def _solved(self, robot: Robot, dataset: Dataset, progress: Progress) -> tuple[Design, Solution]:
        """The least-squares fit; every ripple is searched in the residual of the fit with the ones before it."""
        if self.ripples:
            before = replace(self, ripples=self.ripples - 1)
            design, solution = before._solved(robot, dataset, progress)
            line = before._line(dataset, _params(solution.psi, design))
            design = replace(design, extras=self.extras, cycles=np.concatenate([design.cycles, line[None]]))
        else:
            n, spread = robot.dofs, self.weighting == "torque_spread"
            weights = 1 / regression.torque_spread(dataset) if spread else np.ones(n)
            design = Design(robot, self.extras, weights, self.rest_speed, self.least_speed, np.zeros((0, n)))
        return design, regression.solve(design, dataset, self.threshold, self.relative, progress)

    def _line(self, dataset: Dataset, params: PyTree) -> np.ndarray:
        """Cycles (n,) of the dominant line in the residual of each joint while it moves; 0: there is none."""
        rows = slice(None, None, -(-dataset.samples // SCANNED))
        left, motion = (dataset.tau - _torques(self, params, dataset))[rows], dataset.motion[rows]
        moves = np.abs(motion.qd) >= max(self.least_speed, self.rest_speed)
        found = [ripple.strongest(x[m], q[m]) for x, q, m in zip(left.T, motion.q.T, moves.T, strict=True)]
        return np.array([cycles if share > LINE else 0.0 for cycles, share in found])


def _params(psi: np.ndarray, design: Design) -> dict[str, np.ndarray]:
    """The parameters (10 n + columns n,) as `apply` takes them."""
    n = design.robot.dofs
    return {
        "psi": psi[: 10 * n].reshape(n, 10),
        "extras": psi[10 * n :].reshape(-1, n),
        "cycles": np.asarray(design.cycles),
    }


def _torques(model: Pest, params: PyTree, dataset: Dataset) -> np.ndarray:
    """Torques (T, n) [N m; N] of parameters on all trajectories, one after the other."""
    return np.concatenate([rigid_model.torques(model, params, x.motion, dataset.robot) for x in dataset.trajectories])
