"""The contract of effects: physical causes that a simulation may lack, of six kinds. `interfaces` has the others."""

import abc
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np

from invdyn_cli.joints import NO_PLACE, NO_TIME, JointState, SimulatorTerms, UsualJoint
from invdyn_cli.types import Array, EffectText, Motion, Robot


class Parameter(NamedTuple):
    """A parameter of an effect: its unit, and the bounds outside of which it is no physics."""

    unit: str
    lower: float = -np.inf
    upper: float = np.inf


Parameters = Mapping[str, Any]
"""Parameters of an effect by name, in the units that the effect declares."""


class AbstractEffect(abc.ABC):
    """A physical cause that a simulation may lack. It acts at one of six points, composed in this order: on the
    motion, on the bodies, in the gear, as a force from outside, on a joint's torque, on the channel (logged ->
    delivered); each has its class below.

    Its formula appears twice: linear for the search (`basis`, and `read` back into parameters), which tries the
    nonlinear parameters that `shapes` lists, and as it stands (`term` and the like) for the extended model. Array
    functions come from the arrays themselves (`x.__array_namespace__()`): numpy or jax alike.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    """Its name in a sentence."""
    meaning: ClassVar[str] = ""
    """What it is, in a sentence for someone who never met it."""
    equation: ClassVar[str]
    reference: ClassVar[str]
    parameters: ClassVar[Mapping[str, Parameter]]
    point: ClassVar[str]
    """Where it acts: motion, body, gear, force, torque or channel; its base class says so."""
    sides: ClassVar[tuple[str, ...]] = ("link", "motor", "command", "unknown")
    """Torque sides on which it shows."""
    position_sides: ClassVar[tuple[str, ...]] = ("link", "motor", "unknown")
    """Position sides on which it shows."""
    chosen: ClassVar[tuple[str, ...]] = ()
    """Parameters that are one of a few values, as gears have them: tried, never refined, and without an interval."""
    passing: ClassVar[bool] = False
    """Whether it comes and goes: it acts in a window of time, which is found with it."""
    confounders: ClassVar[tuple[tuple[str, ...], ...]] = ()
    """Sets of effects that theory allows to stand for it on some logs."""
    contains: ClassVar[tuple[str, ...]] = ()
    """Effects that are special cases of it: the simpler one is named unless the data ask for more."""
    contains_as_limit: ClassVar[bool] = False
    """Whether it is what it contains only in a limit, so that both may act on one joint."""
    advice: ClassVar[str] = ""
    """What to record to tell it from its confounders."""
    panels: ClassVar[tuple[str, ...]] = ()
    """What its picture shows, names of `report.diagnosis_figures.PANELS`; () for the residual over time."""
    loaded: ClassVar[bool] = False
    """Whether its columns hang on the torque that the joint transmits."""
    group: ClassVar[str] = "anomaly"
    """"standard" for what every arm has beside its URDF, "anomaly" for what only some have."""
    jumps: ClassVar[bool] = False
    """Whether its torque jumps where the joint turns back."""
    load: ClassVar[bool] = False
    """Whether it is a body that the last link carries."""
    turns_gravity: ClassVar[bool] = False
    """Whether it moves gravity and no inertials: nothing of it shows where nothing falls."""
    reaches_others: ClassVar[bool] = False
    """Whether other joints feel it than the one it acts on (and the one that shares its gear)."""
    is_local: ClassVar[bool] = True
    """Whether it must be worth something on its own joint; if not, on the arm as a whole."""
    yields: ClassVar[bool] = False
    """Whether a link moves against its motor by it, the more the more it carries."""
    stays_near: ClassVar[bool] = False
    """Whether its columns are true near the parameters of their trial only."""
    coupled: ClassVar[bool] = False
    """Whether it is of a gear that its joint shares with the joint before it (`JointState.driver`)."""
    invertible: ClassVar[bool] = True
    """Of a channel: whether what was logged follows from what reached the joint; if not, models are compared with the
    latter."""
    factor: ClassVar[str] = ""
    """Of a channel that only multiplies what was logged: the parameter that does."""
    late_by: ClassVar[str] = ""
    """The parameter [s] by which what it delivers comes late: effects that have one differ to second order only."""
    of_joint: ClassVar[bool] = True
    """Whether it acts on a joint, or its link; if not, on the whole arm."""
    needs: ClassVar[tuple[str, ...]] = ()
    """What a joint's motion must have to show it, names of `diagnosis.checks.excitation.NEEDS`."""
    sum_of: ClassVar[Mapping[str, Mapping[str, float]]] = {}
    """Of an effect that is the sum of others whatever the motion: each one's name, and how much its parameter adds to
    each parameter here."""
    scanned: ClassVar[tuple[Parameters, ...]] = ()
    """Of an effect whose nonlinear parameters are scanned for in a log: those that a design of motions tries."""
    shows: ClassVar[tuple[str, ...]] = ()
    """Tests of the residual (`types.ResidualTest.against`) in which it shows first where a model lacks it."""

    def is_ordinary(self, shape: Parameters) -> bool:
        """Whether its columns at these nonlinear parameters help to measure the noise: of many trials, some; none whose
        columns hold the log's noise themselves."""
        return True

    def travel(self, parameters: Parameters) -> float:
        """Motion of its joint [rad; m] within which it differs from what it contains as a limit; inf: at any motion."""
        return float("inf")

    def is_plain(self, parameters: Parameters, state: JointState) -> bool:
        """Whether an effect of these parameters can be told, on this motion of its joint, from what only looks like
        it."""
        return True

    def typical(self, usual: UsualJoint) -> dict[str, Any] | None:
        """Parameters of an ordinary size on a joint like this; None where no size is ordinary."""
        return None

    def in_simulator(self, parameters: Parameters) -> SimulatorTerms:
        """What of it the file of a simulator holds, beside other inertials and another gravity."""
        return SimulatorTerms(lost=NO_TIME if self.passing else NO_PLACE)

    @property
    def text(self) -> EffectText:
        """How a report speaks of it."""
        adds = self.point in ("torque", "force")
        return EffectText(self.title, self.meaning, self.equation, tuple(self.parameters), adds, self.panels)

    @abc.abstractmethod
    def found(
        self, coefficients: Sequence[float], trial: Parameters, robot: Robot, joint: int | None
    ) -> dict[str, Any]:
        """Parameters from the coefficients of its columns, which were made for a trial's parameters."""

    def coordinates(self, parameters: Parameters, robot: Robot, joint: int | None) -> list[float] | None:
        """The coefficients that `found` makes these parameters from, where the torque is linear in them; None where it
        is not."""
        return None

    def precision(self, robot: Robot, joint: int | None, count: int) -> np.ndarray:
        """(count,) what is known of its columns' coefficients beforehand: 1 / scale^2."""
        return np.zeros(count)

    @property
    def changes_inertials(self) -> bool:
        """Whether it is another body in the place of a link, or on it."""
        return False

    @property
    def bends(self) -> bool:
        """Whether its torque is far from a straight line of its size."""
        return False

    def refuse(self, parameters: Parameters) -> str:
        """Why these values are no physics, "" if they are."""
        for name, bound in self.parameters.items():
            value = np.asarray(parameters[name])
            if value.dtype.kind in "fi" and (np.any(value < bound.lower) or np.any(value > bound.upper)):
                return (
                    f"{name} would be {np.round(value, 4)} {bound.unit}; possible: {bound.lower:g} to {bound.upper:g}"
                )
        return ""


class AbstractTorqueEffect(AbstractEffect):
    """An effect that adds to one joint's torque; a coupled one, `share_on_driver` times as much to the torque of the
    joint before it in the chain as well, which drives the same gear."""

    point = "torque"

    @abc.abstractmethod
    def term(self, parameters: Parameters, state: JointState) -> Array:
        """What it adds to the logged torque [N m; N], shape of the state's arrays."""

    nonlinear: ClassVar[tuple[str, ...]] = ()
    """Parameters that no linear combination of columns can make up for."""

    def shapes(self, state: JointState) -> Sequence[Parameters]:
        """Values of the nonlinear parameters to try on this motion."""
        return ({},)

    def jump(self, columns: Sequence[Array]) -> Array:
        """Of an effect that jumps, the part of its columns that does."""
        return columns[0]

    def share_on_driver(self, parameters: Parameters) -> float:
        """Of a coupled effect: what share of its term acts on the joint before its own."""
        return 0.0

    def shape_of(self, parameters: Parameters) -> Parameters:
        """The nonlinear ones of these parameters, as `shapes` has them."""
        return {name: parameters[name] for name in self.nonlinear}

    @abc.abstractmethod
    def basis(self, state: JointState, shape: Parameters) -> Sequence[Array]:
        """The columns whose linear combination is the term, for a trial's nonlinear parameters."""

    @abc.abstractmethod
    def read(self, coefficients: Sequence[float], shape: Parameters) -> dict[str, float]:
        """Parameters from the columns' coefficients."""

    def found(
        self, coefficients: Sequence[float], trial: Parameters, robot: Robot, joint: int | None
    ) -> dict[str, Any]:
        return self.read(coefficients, trial)


class AbstractChannelEffect(AbstractEffect):
    """An effect between the logged torque of a joint and what the joint receives."""

    point = "channel"
    stays_near = True

    def is_ordinary(self, shape: Parameters) -> bool:
        return bool(self.factor)

    @abc.abstractmethod
    def shapes(self, tau: Array, rate: float) -> Sequence[Parameters]:
        """Parameters to try on a logged torque tau (T,) at `rate` [Hz]; each gets a free small correction."""

    @abc.abstractmethod
    def delivered(self, parameters: Parameters, tau: Array, rate: float) -> Array:
        """What reaches the joint of a logged torque (T,) at `rate` [Hz]."""

    @abc.abstractmethod
    def logged(self, parameters: Parameters, tau: Array, rate: float) -> Array:
        """What is logged where tau (T, …) at `rate` [Hz] reaches the joint."""

    def found(
        self, coefficients: Sequence[float], trial: Parameters, robot: Robot, joint: int | None
    ) -> dict[str, Any]:
        if self.factor:  # its column is the model's torque
            return {self.factor: float(1 / max(1 + coefficients[0], 1e-3))}
        return _corrected(self, coefficients, trial)


class AbstractBodyEffect(AbstractEffect):
    """An effect on masses or gravity: another robot; of a joint, on the inertials of its link."""

    point = "body"
    reaches_others = True
    is_local = False

    @abc.abstractmethod
    def changed(self, parameters: Parameters, robot: Robot, joint: int | None) -> Robot:
        """The robot with the effect."""

    @abc.abstractmethod
    def directions(self, robot: Robot, joint: int | None) -> Sequence[tuple[Array, Array, float]]:
        """Directions in which it moves inertials (n, 10) and gravity (3,), and how far at most; the torque is linear
        in both, so that each gives a column."""

    @abc.abstractmethod
    def read(self, coefficients: Sequence[float], robot: Robot, joint: int | None) -> dict[str, Any]:
        """Parameters from the columns' coefficients."""

    @abc.abstractmethod
    def coefficients(self, parameters: Parameters, robot: Robot, joint: int | None) -> list[float]:
        """The coefficients that `read` makes these parameters from: coordinates without singular points."""

    def found(
        self, coefficients: Sequence[float], trial: Parameters, robot: Robot, joint: int | None
    ) -> dict[str, Any]:
        if trial:  # what was tried is there already, beside its correction
            coefficients = np.add(coefficients, self.coefficients(trial, robot, joint))
        return self.read(coefficients, robot, joint)

    def coordinates(self, parameters: Parameters, robot: Robot, joint: int | None) -> list[float]:
        return self.coefficients(parameters, robot, joint)

    def precision(self, robot: Robot, joint: int | None, count: int) -> np.ndarray:
        return np.array([1 / scale**2 for *_, scale in self.directions(robot, joint)])

    @property
    def changes_inertials(self) -> bool:
        return not self.turns_gravity

    @property
    def bends(self) -> bool:
        return self.turns_gravity


class AbstractMotionEffect(AbstractEffect):
    """An effect between the logged and the true motion."""

    point = "motion"
    reaches_others = True
    is_local = False

    @abc.abstractmethod
    def true(self, parameters: Parameters, motion: Motion, joint: int) -> Motion:
        """The true motion of a logged one, (n, *batch) arrays."""

    @property
    def bends(self) -> bool:
        return True

    def found(
        self, coefficients: Sequence[float], trial: Parameters, robot: Robot, joint: int | None
    ) -> dict[str, Any]:
        return _corrected(self, coefficients, trial)


class AbstractGearEffect(AbstractEffect):
    """An effect between motor and link, that lets the link move against the motor whose angle is logged."""

    point = "gear"
    loaded = True
    reaches_others = True
    yields = True
    stays_near = True
    position_sides = ("motor", "unknown")

    @abc.abstractmethod
    def shapes(self, load: Array, inertia: Array, rate: float) -> Sequence[Parameters]:
        """Parameters to try on these loads and inertias (T,); each gets a free small correction."""

    @abc.abstractmethod
    def deflection(self, parameters: Parameters, load: Array, inertia: Array, rate: float) -> tuple[Array, Array]:
        """The link's angle less the motor's (T,) [rad; m], and its second derivative.

        Args:
            load: (T,) torque [N m; N] that would keep the link on the motor's motion.
            inertia: (T,) [kg m^2; kg] that the joint carries.
            rate: [Hz].
        """

    def compliance(self, parameters: Parameters) -> float:
        """The one number that the deflection grows with, nearly in proportion."""
        (value,) = parameters.values()
        return value

    def from_compliance(self, compliance: float) -> dict[str, float]:
        """The parameters of that number."""
        (name,) = self.parameters
        return {name: compliance}

    def found(
        self, coefficients: Sequence[float], trial: Parameters, robot: Robot, joint: int | None
    ) -> dict[str, Any]:
        return self.from_compliance(self.compliance(trial) + float(coefficients[0]))


class AbstractForceEffect(AbstractEffect):
    """A force on the arm from outside, linear in its parameters."""

    point = "force"
    reaches_others = True
    is_local = False
    scale: ClassVar[float]
    """What a coefficient hardly exceeds: what a log does not show of a force stays near zero."""

    @abc.abstractmethod
    def basis(self, robot: Robot, joint: int | None, motion: Motion) -> Array:
        """(k, n, T) torques that hold the arm against unit forces, of a motion (n, T)."""

    @abc.abstractmethod
    def read(self, coefficients: Sequence[float]) -> dict[str, Any]:
        """Parameters from the columns' coefficients."""

    @abc.abstractmethod
    def coefficients(self, parameters: Parameters) -> list[float]:
        """The coefficients that `read` makes these parameters from."""

    def found(
        self, coefficients: Sequence[float], trial: Parameters, robot: Robot, joint: int | None
    ) -> dict[str, Any]:
        return self.read(coefficients)

    def coordinates(self, parameters: Parameters, robot: Robot, joint: int | None) -> list[float]:
        return self.coefficients(parameters)

    def precision(self, robot: Robot, joint: int | None, count: int) -> np.ndarray:
        return np.full(count, 1 / self.scale**2)


def _corrected(effect: AbstractEffect, corrections: Sequence[float], trial: Parameters) -> dict[str, float]:
    """A trial's parameters, each with the correction that its column found."""
    return {name: float(trial.get(name, 0.0) + x) for name, x in zip(effect.parameters, corrections, strict=True)}
