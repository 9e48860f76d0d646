"""The contract of effects: physical causes that a simulation may lack, of six kinds. `interfaces` has the others."""

import abc
import copy
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from invdyn_cli.joints import NO_PLACE, NO_TIME, JointState, SimulatorTerms, UsualJoint
from invdyn_cli.types import Array, EffectText, Motion, Robot


class Parameter(NamedTuple):
    """A parameter of an effect: its unit, and the bounds outside of which it is physically impossible."""

    unit: str
    lower: float = -np.inf
    upper: float = np.inf


Parameters = Mapping[str, Any]
"""Parameters of an effect by name, in the units that the effect declares."""


class AbstractEffect(abc.ABC):
    """A physical cause that a simulation may lack. It acts at one of six points, composed in this order: on the
    motion, on the bodies, in the gear, as a force from outside, on a joint's torque, on the channel (logged ->
    delivered); each has its class below.

    Its formula appears twice: in linear form for the search (`basis`, and `read` back into parameters), which tries the
    nonlinear parameters that `shapes` lists, and exactly (`term` and the like) for the extended model. Array functions
    come from the arrays themselves (`x.__array_namespace__()`): numpy or jax alike.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    """Its name in a sentence."""
    meaning: ClassVar[str] = ""
    """What it is, in one sentence for a reader who does not know it."""
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
    """Parameters that take only a few values, as the ratios of gears do: they are tried, not refined, and have no
    interval."""
    defaults: ClassVar[Mapping[str, Any]] = {}
    """Values of parameters that a description may leave out."""
    passing: ClassVar[bool] = False
    """Whether it acts in a time window only; the window is then estimated with it."""
    for_a_time: ClassVar[str] = ""
    """The effect that it is called where it acts in a time window only."""
    confounders: ClassVar[tuple[tuple[str, ...], ...]] = ()
    """Sets of effects that can, in theory, explain the same logs."""
    contains: ClassVar[tuple[str, ...]] = ()
    """Effects that are special cases of it: the simpler one is named unless the data require more."""
    contains_as_limit: ClassVar[bool] = False
    """Whether it equals what it contains only in a limit, so that both may act on one joint."""
    advice: ClassVar[str] = ""
    """What to record to distinguish it from its confounders."""
    panels: ClassVar[tuple[str, ...]] = ()
    """What its picture shows, names of `report.diagnosis_figures.PANELS`; () for the residual over time."""
    loaded: ClassVar[bool] = False
    """Whether its columns depend on the torque that the joint transmits."""
    group: ClassVar[str] = "anomaly"
    """"standard" for what every arm has in addition to its URDF, "anomaly" for what only some arms have."""
    friction: ClassVar[bool] = False
    """Whether it is friction, which every joint has in some form."""
    jumps: ClassVar[bool] = False
    """Whether its torque jumps where the joint reverses."""
    load: ClassVar[bool] = False
    """Whether it is a body that the last link carries."""
    turns_gravity: ClassVar[bool] = False
    """Whether it changes the direction of gravity and no inertials: without gravity it has no effect."""
    reaches_others: ClassVar[bool] = False
    """Whether it also acts on other joints than its own (and the one that shares its gear)."""
    is_local: ClassVar[bool] = True
    """Whether it must improve the prediction on its own joint; if not, on the arm as a whole."""
    adds: ClassVar[bool] = True
    """Whether it adds a torque, its own or of changed bodies; if not, it changes what is logged or how links move."""
    yields: ClassVar[bool] = False
    """Whether it lets a link move relative to its motor, in proportion to the load."""
    stays_near: ClassVar[bool] = False
    """Whether its columns are valid only near the parameters of their trial."""
    coupled: ClassVar[bool] = False
    """Whether it belongs to a gear that its joint shares with the joint before it (`JointState.driver`)."""
    invertible: ClassVar[bool] = True
    """Of a channel: whether the logged torque follows from the delivered one; if not, models are compared with the
    delivered torque."""
    factor: ClassVar[str] = ""
    """Of a channel that only multiplies the logged torque: the name of the factor."""
    late_by: ClassVar[str] = ""
    """Name of the parameter [s] by which the delivered torque is late; effects with one differ from each other only to
    second order."""
    sized_by: ClassVar[str] = ""
    """Name of the parameter that is zero where there is no effect, if it has several."""
    of_joint: ClassVar[bool] = True
    """Whether it acts on a joint or its link; if not, on the whole arm."""
    needs: ClassVar[tuple[str, ...]] = ()
    """What a joint's motion must have to show it, names of `diagnosis.checks.excitation.NEEDS`."""
    placed_by: ClassVar[str] = ""
    """Of a force: name of the parameter (3,) [m] that places it on its link, in the joint's frame; "": nothing does."""
    sum_of: ClassVar[Mapping[str, Mapping[str, float]]] = {}
    """Of an effect that is always the sum of others: their names, and how much the parameter of each adds to each
    parameter here."""
    scanned: ClassVar[tuple[Parameters, ...]] = ()
    """Of an effect whose nonlinear parameters are scanned in a log: the values that a design of motions tries."""
    shows: ClassVar[tuple[str, ...]] = ()
    """Tests of the residual (`types.ResidualTest.against`) in which it appears first if a model lacks it."""
    lessens: ClassVar[bool] = False
    """Whether there may be less of it than in an earlier log: as a change since then its size has either sign."""

    def as_change(self) -> Self:
        """The same as a change since an earlier log."""
        if not self.lessens:
            return self
        made = copy.copy(self)
        bounds = {name: bound._replace(lower=-np.inf) for name, bound in self.parameters.items()}
        object.__setattr__(made, "parameters", bounds)  # of this object alone; its class is frozen
        return made

    def is_ordinary(self, shape: Parameters) -> bool:
        """Whether its columns at these nonlinear parameters are used to estimate the noise: only a few of many trials,
        and none whose columns contain the noise of the log."""
        return True

    def whole(self, parameters: Parameters) -> dict[str, Any]:
        """These parameters, and the defaults of those that are left out."""
        return {**self.defaults, **parameters}

    def looks_like(self, robot: Robot, joint: int | None) -> Sequence[tuple["AbstractEffect", Parameters]]:
        """Effects, with their nonlinear parameters, that look the same where the joint moves little: they are tried in
        its place before it is named."""
        return ()

    def relatives(self, parameters: Parameters) -> Sequence[Parameters]:
        """Of an effect that was found with these parameters: nonlinear parameters of another kind that are then tried,
        and not before: they would often do as well."""
        return ()

    def travel(self, parameters: Parameters) -> float:
        """Motion of its joint [rad; m] beyond which it equals the effect that it contains as a limit; inf: it always
        differs."""
        return float("inf")

    def is_plain(self, parameters: Parameters, state: JointState) -> bool:
        """Whether an effect with these parameters can be distinguished, on this motion of its joint, from effects that
        look similar."""
        return True

    def typical(self, usual: UsualJoint) -> dict[str, Any] | None:
        """Parameters of a typical size on a joint like this; None if there is no typical size."""
        return None

    def in_simulator(self, parameters: Parameters) -> SimulatorTerms:
        """What the file of a simulator contains of it, besides changed inertials and gravity."""
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
        """The coefficients from which `found` makes these parameters, if the torque is linear in them; otherwise
        None."""
        return None

    def precision(self, robot: Robot, joint: int | None, count: int) -> np.ndarray:
        """(count,) prior precision 1 / scale^2 of its columns' coefficients."""
        return np.zeros(count)

    @property
    def changes_inertials(self) -> bool:
        """Whether it changes the body of a link, or adds a body to it."""
        return False

    @property
    def bends(self) -> bool:
        """Whether its torque is far from linear in its size."""
        return False

    def refuse(self, parameters: Parameters) -> str:
        """Why these values are physically impossible, "" if they are possible."""
        every = self.whole(parameters)
        for name, bound in self.parameters.items():
            value = np.asarray(every[name])
            if value.dtype.kind in "fi" and (np.any(value < bound.lower) or np.any(value > bound.upper)):
                unit = "" if bound.unit == "-" else f" {bound.unit}"
                allowed = f"{bound.lower:g} to {bound.upper:g}".replace("inf", "∞")
                return f"{name} would be {np.round(value, 4)}{unit}; possible: {allowed}"
        return ""

    def remark(self, parameters: Parameters, robot: Robot) -> str:
        """What a user should know of these values on a nominal robot that the values do not say, "" if nothing."""
        return ""


class AbstractTorqueEffect(AbstractEffect):
    """An effect that adds a torque to one joint. A coupled effect also adds `share_on_driver` times this torque to the
    joint before it in the chain, which drives the same gear."""

    point = "torque"

    @abc.abstractmethod
    def term(self, parameters: Parameters, state: JointState) -> Array:
        """The torque that it adds to the logged one [N m; N], in the shape of the state's arrays."""

    nonlinear: ClassVar[tuple[str, ...]] = ()
    """Parameters that no linear combination of columns can replace."""

    def shapes(self, state: JointState) -> Sequence[Parameters]:
        """Values of the nonlinear parameters to try on this motion."""
        return ({},)

    def jump(self, columns: Sequence[Array]) -> Array:
        """Of an effect that jumps, the part of its columns that jumps."""
        return columns[0]

    def share_on_driver(self, parameters: Parameters) -> float:
        """Of a coupled effect: the share of its term that acts on the joint before its own."""
        return 0.0

    def shape_of(self, parameters: Parameters) -> Parameters:
        """The nonlinear parameters among these, as `shapes` has them."""
        every = self.whole(parameters)
        return {name: every[name] for name in self.nonlinear}

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
    adds = False
    stays_near = True

    def is_ordinary(self, shape: Parameters) -> bool:
        return bool(self.factor)

    @abc.abstractmethod
    def shapes(self, tau: Array, rate: float) -> Sequence[Parameters]:
        """Trial parameters for a logged torque tau (T,) at `rate` [Hz]; each gets a small linear correction."""

    @abc.abstractmethod
    def delivered(self, parameters: Parameters, tau: Array, rate: float) -> Array:
        """The torque (T,) that reaches the joint if this torque (T,) is logged, at `rate` [Hz]."""

    @abc.abstractmethod
    def logged(self, parameters: Parameters, tau: Array, rate: float) -> Array:
        """The torque that is logged if tau (T, …) reaches the joint, at `rate` [Hz]."""

    def found(
        self, coefficients: Sequence[float], trial: Parameters, robot: Robot, joint: int | None
    ) -> dict[str, Any]:
        if self.factor:  # its column is the model's torque
            return {self.factor: float(1 / max(1 + coefficients[0], 1e-3))}
        return _corrected(self, coefficients, trial)


class AbstractBodyEffect(AbstractEffect):
    """An effect on masses or gravity: it changes the robot; an effect of a joint changes the inertials of its link."""

    point = "body"
    reaches_others = True
    is_local = False

    @abc.abstractmethod
    def changed(self, parameters: Parameters, robot: Robot, joint: int | None) -> Robot:
        """The robot with the effect."""

    @abc.abstractmethod
    def directions(self, robot: Robot, joint: int | None) -> Sequence[tuple[Array, Array, float]]:
        """Directions in which it changes inertials (n, 10) and gravity (3,), and the scale of each; the torque is
        linear in both, so that each direction gives a column."""

    @abc.abstractmethod
    def read(self, coefficients: Sequence[float], robot: Robot, joint: int | None) -> dict[str, Any]:
        """Parameters from the columns' coefficients."""

    @abc.abstractmethod
    def coefficients(self, parameters: Parameters, robot: Robot, joint: int | None) -> list[float]:
        """The coefficients from which `read` makes these parameters: coordinates without singular points."""

    def found(
        self, coefficients: Sequence[float], trial: Parameters, robot: Robot, joint: int | None
    ) -> dict[str, Any]:
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
    adds = False
    reaches_others = True
    is_local = False

    @abc.abstractmethod
    def true(self, parameters: Parameters, motion: Motion, joint: int) -> Motion:
        """The true motion for a logged one, (n, *batch) arrays."""

    @property
    def bends(self) -> bool:
        return True

    def found(
        self, coefficients: Sequence[float], trial: Parameters, robot: Robot, joint: int | None
    ) -> dict[str, Any]:
        return _corrected(self, coefficients, trial)


class AbstractGearEffect(AbstractEffect):
    """An effect between motor and link, that lets the link move against the motor whose angle is logged.

    Attributes:
        sharp: whether a trial beside its true parameters fits worse than nothing, and is refined before it is compared.
    """

    sharp: ClassVar[bool] = False
    point = "gear"
    adds = False
    loaded = True
    reaches_others = True
    yields = True
    stays_near = True
    position_sides = ("motor", "unknown")

    @abc.abstractmethod
    def shapes(self, load: Array, inertia: Array, rate: float) -> Sequence[Parameters]:
        """Trial parameters for these loads and inertias (T,); each gets a small linear correction."""

    @abc.abstractmethod
    def deflection(self, parameters: Parameters, load: Array, inertia: Array, rate: float) -> tuple[Array, Array]:
        """The angle of the link minus that of the motor (T,) [rad; m], and its second derivative.

        Args:
            load: (T,) torque [N m; N] that would keep the link on the motor's motion, with its own friction.
            inertia: (T,) [kg m^2; kg] that the joint carries.
            rate: [Hz].
        """

    def drag(self, parameters: Parameters, qd: Array) -> Array | float:
        """Friction (T,) [N m; N] of the link itself, at velocities (T,) of the motor, that the gear transmits."""
        return 0.0

    def dragged(self, coulomb: float, viscous: float) -> Sequence[Parameters]:
        """Trials of parameters for a link that has a share of these frictions of its joint; none where that matters
        little."""
        return ()

    def compliance(self, parameters: Parameters) -> float:
        """The one number to which the deflection is nearly proportional."""
        (value,) = parameters.values()
        return value

    def from_compliance(self, compliance: float) -> dict[str, float]:
        """The parameters of that number."""
        (name,) = self.parameters
        return {name: compliance}

    def as_soft(self, parameters: Parameters, compliance: float) -> dict[str, Any]:
        """These parameters with that number."""
        return {**parameters, **self.from_compliance(compliance)}

    def found(
        self, coefficients: Sequence[float], trial: Parameters, robot: Robot, joint: int | None
    ) -> dict[str, Any]:
        return self.as_soft(trial, self.compliance(trial) + float(coefficients[0]))


class AbstractForceEffect(AbstractEffect):
    """A force on the arm from outside, linear in its parameters."""

    point = "force"
    reaches_others = True
    is_local = False
    scale: ClassVar[float]
    """Scale of a coefficient: coefficients that a log does not determine stay near zero."""

    @abc.abstractmethod
    def basis(self, robot: Robot, joint: int | None, motion: Motion) -> Array:
        """(k, n, T) joint torques that balance unit forces, for a motion (n, T)."""

    def placed(self, trial: Parameters, robot: Robot, joint: int | None, motion: Motion) -> Array:
        """The same for forces where `trial` places them."""
        return self.basis(robot, joint, motion)

    @abc.abstractmethod
    def read(self, coefficients: Sequence[float]) -> dict[str, Any]:
        """Parameters from the columns' coefficients."""

    @abc.abstractmethod
    def coefficients(self, parameters: Parameters) -> list[float]:
        """The coefficients from which `read` makes these parameters."""

    def found(
        self, coefficients: Sequence[float], trial: Parameters, robot: Robot, joint: int | None
    ) -> dict[str, Any]:
        return {**self.read(coefficients), **{name: x for name, x in trial.items() if name == self.placed_by}}

    def coordinates(self, parameters: Parameters, robot: Robot, joint: int | None) -> list[float]:
        return self.coefficients(parameters)

    def precision(self, robot: Robot, joint: int | None, count: int) -> np.ndarray:
        return np.full(count, 1 / self.scale**2)


def _corrected(effect: AbstractEffect, corrections: Sequence[float], trial: Parameters) -> dict[str, float]:
    """The parameters of a trial, each with the correction from its column."""
    return {name: float(trial.get(name, 0.0) + x) for name, x in zip(effect.parameters, corrections, strict=True)}
