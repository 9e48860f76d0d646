"""Friction: torques that depend on a joint's own motion.

Sizes refer to the logged torque. sign(qd) is part of the state, which defines how it crosses zero.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from invdyn_cli.effects.linear import AbstractLinearEffect
from invdyn_cli.interfaces import AbstractTorqueEffect, JointState, Parameter, Parameters
from invdyn_cli.joints import SimulatorTerms, UsualJoint
from invdyn_cli.types import Array

ARMSTRONG = "Armstrong-Hélouvry, Dupont and Canudas de Wit, Automatica 1994"

STICK_TIME = 0.005
"""[s] At a reversal a joint sticks for some milliseconds, in which its friction is indeterminate, and it reverses some
milliseconds before or after the logged angle does. `about_reversals` allows for both."""

REVERSAL_COLUMNS = 2
"""As many as `about_reversals` makes."""


def about_reversals(jump: Array, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """What a torque (..., T) with jumps, at `rate` [Hz], lacks for each second that they come late, and for each second
    of their spread (half of its square, over STICK_TIME): the first two terms of Taylor's series, averaged."""
    late = np.gradient(np.asarray(jump), axis=-1) * rate
    return late, STICK_TIME * rate * np.gradient(late, axis=-1)


LEAST_DROP, LARGEST_DROP = 1.1, 4.0
"""Ratio of static to Coulomb level, above which it shows that a gear has Stribeck friction, and of which none has more:
most have 1.1 to 1.6, and what sticks for some rows beside a reversal is no level."""


@dataclass(frozen=True)
class ViscousFriction(AbstractLinearEffect):
    """Proportional to velocity."""

    name = "viscous_friction"
    title = "viscous friction"
    friction = True
    meaning = "Friction that grows in proportion to velocity."
    equation = "damping qd"
    reference = ARMSTRONG
    parameters = {"damping": Parameter("N m s/rad", 0.0)}
    confounders = (
        ("thermal_friction_drift",),
        ("quadratic_friction",),
        ("actuator_lag",),
        ("torque_delay",),
        ("stribeck_friction",),
    )
    advice = "at least three constant speeds in both directions"
    panels = ("velocity",)
    group = "standard"
    lessens = True
    needs = ("motion", "speeds")
    shows = ("velocity",)

    def typical(self, usual: UsualJoint) -> dict[str, Any]:
        return {"damping": usual.level / usual.speed}

    def in_simulator(self, parameters: Parameters) -> SimulatorTerms:
        return SimulatorTerms({"damping": parameters["damping"]})

    def basis(self, state: JointState, shape: Parameters) -> Sequence[Array]:
        return (state.qd,)


@dataclass(frozen=True)
class CoulombFriction(AbstractLinearEffect):
    """Constant, against the motion."""

    name = "coulomb_friction"
    title = "Coulomb friction"
    friction = True
    meaning = "Friction against the motion, the same at every speed."
    equation = "coulomb sign(qd)"
    reference = ARMSTRONG
    parameters = {"coulomb": Parameter("N m", 0.0)}
    confounders = (("stribeck_friction",), ("asymmetric_coulomb_friction",), ("load_dependent_friction",))
    advice = "slow motion with many reversals, also below 0.05 rad/s"
    jumps = True
    panels = ("velocity",)
    group = "standard"
    lessens = True
    needs = ("motion", "reversals")
    shows = ("velocity", "reversals")

    def typical(self, usual: UsualJoint) -> dict[str, Any]:
        return {"coulomb": usual.level}

    def in_simulator(self, parameters: Parameters) -> SimulatorTerms:
        return SimulatorTerms({"friction": parameters["coulomb"]})

    def basis(self, state: JointState, shape: Parameters) -> Sequence[Array]:
        return (state.sign,)


@dataclass(frozen=True)
class AsymmetricCoulombFriction(AbstractLinearEffect):
    """A different constant in each direction: Coulomb friction and an offset, which no motion distinguishes."""

    name = "asymmetric_coulomb_friction"
    title = "asymmetric Coulomb friction"
    friction = True
    meaning = "Coulomb friction with different levels in the two directions."
    equation = "positive for qd > 0, −negative for qd < 0"
    reference = "Elhami and Brookfield, Proc. IMechE 1996"
    parameters = {"positive": Parameter("N m", 0.0), "negative": Parameter("N m", 0.0)}
    confounders = (("coulomb_friction", "torque_offset"),)
    contains = ("coulomb_friction",)
    advice = "the torque at rest, brakes open, in a posture without gravity load: an offset remains, friction vanishes"
    panels = ("velocity",)
    jumps = True
    sum_of = {
        "coulomb_friction": {"positive": 1.0, "negative": 1.0},
        "torque_offset": {"positive": 1.0, "negative": -1.0},
    }
    needs = ("motion", "reversals")
    shows = ("velocity", "reversals")

    def typical(self, usual: UsualJoint) -> dict[str, Any]:
        return {"positive": 1.4 * usual.level, "negative": 0.6 * usual.level}

    def in_simulator(self, parameters: Parameters) -> SimulatorTerms:
        up, down = parameters["positive"], parameters["negative"]
        return SimulatorTerms({"friction": (up + down) / 2, "offset": (up - down) / 2})  # within both nothing moves

    def jump(self, columns: Sequence[Array]) -> Array:
        return columns[0] + columns[1]

    def basis(self, state: JointState, shape: Parameters) -> Sequence[Array]:
        size = abs(state.sign)
        return (size + state.sign) / 2, (state.sign - size) / 2


@dataclass(frozen=True)
class StribeckFriction(AbstractTorqueEffect):
    """Falls from the static level to Coulomb's as the joint gains speed. Below some multiples of the Stribeck velocity
    that fall is nearly a parabola, which Coulomb, viscous and quadratic friction make too.

    Attributes:
        velocities: Stribeck velocities to try [rad/s]; the found one is refined between them.
        nearest: where a fall with the exponent 2 (Bo and Pavelescu) is found, the velocities to try with the exponent 1
            (Tustin), as multiples of its own.
        usual_velocity: [rad/s] of an ordinary one.
        usual_ratio: static over Coulomb level of an ordinary one.
        largest_drop: the same that none exceeds.
    """

    velocities: tuple[float, ...] = (0.006, 0.01, 0.017, 0.028, 0.047, 0.08, 0.13, 0.22, 0.36)
    nearest: tuple[float, ...] = (0.4, 0.6, 0.85)
    usual_velocity: float = 0.028
    usual_ratio: float = 1.3
    largest_drop: float = LARGEST_DROP

    name = "stribeck_friction"
    title = "Stribeck friction"
    friction = True
    meaning = "Friction that is higher near standstill and falls as the speed grows."
    equation = "(coulomb + (static − coulomb) exp(−|qd/velocity|^exponent)) sign(qd)"
    reference = "Bo and Pavelescu, Wear 1982; Tustin, J. IEE 1947; " + ARMSTRONG
    parameters = {
        "coulomb": Parameter("N m", 0.0),
        "static": Parameter("N m", 0.0),
        "velocity": Parameter("rad/s", 5e-3, 1.0),
        "exponent": Parameter("-", 0.5, 2.0),
    }
    defaults = {"exponent": 2.0}
    chosen = ("exponent",)
    confounders = (("coulomb_friction",), ("coulomb_friction", "viscous_friction"), ("quadratic_friction",))
    contains = ("coulomb_friction",)
    nonlinear = ("velocity", "exponent")
    advice = "constant speeds from 0.005 to 0.2 rad/s in both directions, logged unfiltered"
    jumps = True
    panels = ("velocity", "near_standstill")
    needs = ("motion", "speeds", "creep")
    shows = ("velocity", "reversals")

    def typical(self, usual: UsualJoint) -> dict[str, Any]:
        static = self.usual_ratio * usual.level
        return {"coulomb": usual.level, "static": static, "velocity": self.usual_velocity, **self.defaults}

    def in_simulator(self, parameters: Parameters) -> SimulatorTerms:
        level = parameters["coulomb"]
        return SimulatorTerms({"friction": level}, lost=f"is represented by its level at high speed, {level:.3g}")

    def term(self, parameters: Parameters, state: JointState) -> Array:
        level, drop = self.basis(state, self.shape_of(parameters))
        return parameters["coulomb"] * level + (parameters["static"] - parameters["coulomb"]) * drop

    def shapes(self, state: JointState) -> Sequence[Parameters]:
        return [{"velocity": v, **self.defaults} for v in self.velocities]

    def relatives(self, parameters: Parameters) -> Sequence[Parameters]:
        return [{"velocity": factor * parameters["velocity"], "exponent": 1.0} for factor in self.nearest]

    def basis(self, state: JointState, shape: Parameters) -> Sequence[Array]:
        xp = state.qd.__array_namespace__()
        return state.sign, state.sign * xp.exp(-(abs(state.qd / shape["velocity"]) ** shape["exponent"]))

    def read(self, coefficients: Sequence[float], shape: Parameters) -> dict[str, float]:
        return {"coulomb": coefficients[0], "static": coefficients[0] + coefficients[1], **shape}

    def as_change(self) -> Self:
        """The levels are then what came to those of before, which are not known: any ratio is possible."""
        return replace(self, largest_drop=np.inf)

    def is_ordinary(self, shape: Parameters) -> bool:
        return 0.02 < shape["velocity"] < 0.1

    def is_plain(self, parameters: Parameters, state: JointState) -> bool:
        """Its Stribeck velocity is above the speeds that a joint has while it sticks, and the drop of its friction is
        one that gears have."""
        gained = STICK_TIME * float(np.std(state.qdd))
        return parameters["velocity"] > gained and parameters["static"] > LEAST_DROP * parameters["coulomb"]

    def refuse(self, parameters: Parameters) -> str:
        if parameters["static"] < parameters["coulomb"]:
            return "friction would rise with speed: the static level is below Coulomb's"
        if parameters["static"] > self.largest_drop * parameters["coulomb"] > 0:
            ratio = parameters["static"] / parameters["coulomb"]
            return f"the static level would be {ratio:.3g} times Coulomb's; possible: up to {self.largest_drop:g}"
        return super().refuse(parameters)


@dataclass(frozen=True)
class LoadDependentFriction(AbstractLinearEffect):
    """Grows with the torque that the gear transmits."""

    name = "load_dependent_friction"
    title = "load-dependent friction"
    friction = True
    meaning = "Friction that grows with the torque that the gear transmits."
    equation = "mu |transmitted torque| sign(qd)"
    loaded = True
    reference = "Gogoussis and Donath, ICRA 1988; Hamon, Gautier and Garrec, IROS 2010"
    parameters = {"mu": Parameter("-", 0.0, 1.0)}
    confounders = (("coulomb_friction",), ("torque_gain_error",))
    advice = (
        "the same slow motion in both directions, in postures with different load or with and without a known payload"
    )
    jumps = True
    panels = ("velocity", "load")
    needs = ("motion", "load")
    shows = ("load",)

    def typical(self, usual: UsualJoint) -> dict[str, Any]:
        return {"mu": 0.1}

    def basis(self, state: JointState, shape: Parameters) -> Sequence[Array]:
        return (abs(state.transmitted) * state.sign,)


@dataclass(frozen=True)
class QuadraticFriction(AbstractLinearEffect):
    """Drag, with the square of velocity."""

    name = "quadratic_friction"
    title = "quadratic friction"
    friction = True
    meaning = "Friction that grows with the square of velocity."
    equation = "drag qd |qd|"
    reference = "Waiboer, Aarts and Jonker, Multibody Dynamics 2005"
    parameters = {"drag": Parameter("N m s²/rad²", 0.0)}
    confounders = (("viscous_friction",), ("stribeck_friction",), ("thermal_friction_drift",))
    advice = "constant speeds up to the maximum of the joint, in both directions"
    panels = ("velocity",)
    needs = ("motion", "speeds", "curvature")
    shows = ("velocity",)

    def typical(self, usual: UsualJoint) -> dict[str, Any]:
        return {"drag": usual.level / usual.speed**2}

    def in_simulator(self, parameters: Parameters) -> SimulatorTerms:
        return SimulatorTerms({"drag": parameters["drag"]})

    def basis(self, state: JointState, shape: Parameters) -> Sequence[Array]:
        return (state.qd * abs(state.qd),)


@dataclass(frozen=True)
class ThermalFrictionDrift(AbstractTorqueEffect):
    """Viscous friction that falls while the gear warms up.

    Attributes:
        trials: how many time constants are tried, evenly in the logarithm between a tenth of the log and all of it.
    """

    trials: int = 6

    name = "thermal_friction_drift"
    title = "thermal friction drift"
    friction = True
    meaning = "Viscous friction that falls as the gear warms up."
    equation = "(warm + (cold − warm) exp(−t/time_constant)) qd"
    reference = "Simoni, Beschi, Legnani and Visioli, IROS 2015; Bittencourt and Gunnarsson, ASME JDSMC 2012"
    parameters = {
        "cold": Parameter("N m s/rad", 0.0),
        "warm": Parameter("N m s/rad", 0.0),
        "time_constant": Parameter("s", 0.1),
    }
    confounders = (("viscous_friction",), ("quadratic_friction",))
    contains = ("viscous_friction",)
    nonlinear = ("time_constant",)
    advice = "the same trajectory with a cold gear and after 20 minutes of motion"
    panels = ("velocity", "slope_over_time")
    needs = ("motion", "warming")
    shows = ("time",)

    def typical(self, usual: UsualJoint) -> dict[str, Any]:
        warm = usual.level / usual.speed
        return {"cold": 1.5 * warm, "warm": warm, "time_constant": usual.duration / 3}

    def in_simulator(self, parameters: Parameters) -> SimulatorTerms:
        warm = parameters["warm"]
        return SimulatorTerms(
            {"damping": warm}, lost=f"is represented by the damping of the warm gear, {warm:.3g}, at every temperature"
        )

    def term(self, parameters: Parameters, state: JointState) -> Array:
        xp = state.t.__array_namespace__()
        cooling = xp.exp(-state.t / parameters["time_constant"])
        return (parameters["warm"] + (parameters["cold"] - parameters["warm"]) * cooling) * state.qd

    def shapes(self, state: JointState) -> Sequence[Parameters]:
        last = float(np.max(state.t))
        return [{"time_constant": float(x)} for x in np.geomspace(0.08 * last, 1.2 * last, self.trials)]

    def basis(self, state: JointState, shape: Parameters) -> Sequence[Array]:
        xp = state.t.__array_namespace__()
        return state.qd, state.qd * xp.exp(-state.t / shape["time_constant"])

    def read(self, coefficients: Sequence[float], shape: Parameters) -> dict[str, float]:
        return {"cold": coefficients[0] + coefficients[1], "warm": coefficients[0], **shape}

    def refuse(self, parameters: Parameters) -> str:
        if parameters["cold"] < parameters["warm"]:
            return "friction would rise while the gear warms up"
        return super().refuse(parameters)
