"""Transmission and cables: torques that follow a joint's angle."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from invdyn_cli.interfaces import AbstractEffect, AbstractTorqueEffect, JointState, Parameter, Parameters
from invdyn_cli.joints import SimulatorTerms, UsualJoint
from invdyn_cli.maths import ripple
from invdyn_cli.types import Array, Robot

PERIODS = 1.5
"""Least number of periods of a ripple within the joint's motion."""


@dataclass(frozen=True)
class TorqueRipple(AbstractTorqueEffect):
    """A periodic torque over the angle: teeth, wave generator, magnets.

    Its cycles are not tried from a list but scanned for in the residual (`diagnosis.search.noise`), from two periods
    within the joint's range up to `most`.
    """

    most: float = ripple.MOST

    name = "torque_ripple"
    title = "torque ripple"
    meaning = "A torque that is periodic in the joint's angle: cogging, or a gear that is not round."
    equation = "amplitude sin(cycles q + phase)"
    reference = "Taghirad and Bélanger, ASME JDSMC 1998; Tuttle and Seering, IEEE T-RA 1996"
    parameters = {
        "amplitude": Parameter("N m", 0.0),
        "cycles": Parameter("1/rev", 0.5),
        "phase": Parameter("rad"),
    }
    confounders = (("joint_spring",),)
    nonlinear = ("cycles",)
    advice = "a slow constant speed over a full revolution, at a high sampling rate"
    panels = ("angle", "angle_spectrum")
    scanned = tuple({"cycles": x} for x in (6.0, 12.0, 24.0, 48.0))
    needs = ("motion", "turn")
    shows = ("ripple",)

    def typical(self, usual: UsualJoint) -> dict[str, Any]:
        return {"amplitude": usual.level, **self.scanned[1], "phase": 0.5}

    def term(self, parameters: Parameters, state: JointState) -> Array:
        xp = state.q.__array_namespace__()
        return parameters["amplitude"] * xp.sin(parameters["cycles"] * state.q + parameters["phase"])

    def shapes(self, state: JointState) -> Sequence[Parameters]:
        return ()

    def is_plain(self, parameters: Parameters, state: JointState) -> bool:
        """Whether it has enough periods: fewer look like any curve of the torque over the angle."""
        return parameters["cycles"] * float(np.ptp(state.q)) > 2 * np.pi * PERIODS

    def basis(self, state: JointState, shape: Parameters) -> Sequence[Array]:
        xp = state.q.__array_namespace__()
        return xp.sin(shape["cycles"] * state.q), xp.cos(shape["cycles"] * state.q)

    def read(self, coefficients: Sequence[float], shape: Parameters) -> dict[str, float]:
        a, b = coefficients
        return {"amplitude": float(np.hypot(a, b)), **shape, "phase": float(np.arctan2(b, a))}


@dataclass(frozen=True)
class JointSpring(AbstractTorqueEffect):
    """A spring at the joint: cable, hose, dress pack, balancer."""

    name = "joint_spring"
    title = "joint spring"
    meaning = "A torque that pulls the joint back to a rest angle: a cable, a hose, a balancer."
    equation = "stiffness (q − rest)"
    reference = "Khalil and Dombre, Modeling, Identification and Control of Robots, 2002"
    parameters = {"stiffness": Parameter("N m/rad", 0.0), "rest": Parameter("rad")}
    confounders = (("link_inertia_error",), ("torque_offset",), ("base_tilt",), ("encoder_offset",), ("torque_ripple",))
    contains = ("torque_offset",)
    advice = "postures over the joint's whole range: gravity torque follows a sine, a spring torque a line"
    panels = ("position",)
    needs = ("motion", "range")
    shows = ("angle",)

    def typical(self, usual: UsualJoint) -> dict[str, Any]:
        return {"stiffness": 4 * usual.level / usual.span, "rest": usual.middle}

    def in_simulator(self, parameters: Parameters) -> SimulatorTerms:
        stiffness = parameters["stiffness"]
        return SimulatorTerms({"stiffness": stiffness, "pull": stiffness * parameters["rest"]})

    def term(self, parameters: Parameters, state: JointState) -> Array:
        return parameters["stiffness"] * (state.q - parameters["rest"])

    def basis(self, state: JointState, shape: Parameters) -> Sequence[Array]:
        xp = state.q.__array_namespace__()
        return state.q, xp.ones_like(state.q)

    def read(self, coefficients: Sequence[float], shape: Parameters) -> dict[str, float]:
        stiffness = coefficients[0]
        return {"stiffness": stiffness, "rest": float(-coefficients[1] / (stiffness if stiffness else 1e-300))}

    def looks_like(self, robot: Robot, joint: int | None) -> Sequence[tuple[AbstractEffect, Parameters]]:
        """A ripple of few periods a turn, of which a slide has none."""
        slides = joint is None or robot.prismatic[joint]
        return () if slides else ((TorqueRipple(), TorqueRipple.scanned[0]),)

    def coordinates(self, parameters: Parameters, robot: Robot, joint: int | None) -> list[float]:
        return [parameters["stiffness"], -parameters["stiffness"] * parameters["rest"]]
