"""Coupled gears: drives that are also turned by the joint before their own.

Where the motor of a joint sits behind the joint before it, and its shaft or bevel gear runs through that one, both
joints turn it: wrists of the Stäubli RX and TX arms (joints 5 and 6), differential wrists, parallelograms. Friction and
inertia of that drive then act on both joints, by the principle of virtual work with the factors of its speed.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from invdyn_cli.effects.actuator import MOTOR_SIDES
from invdyn_cli.effects.composition import sign_of
from invdyn_cli.interfaces import AbstractTorqueEffect, JointState, Parameter, Parameters
from invdyn_cli.joints import SimulatorTerms, UsualJoint
from invdyn_cli.types import Array

LEAST_RATIO = 0.2
"""Share of the joint's own speed: below it, the other joint hardly turns the drive."""

NONE = 0.1
"""Share of all parts at 1 rad/s and 1 rad/s^2: a negative part that is smaller is an estimate of zero."""


@dataclass(frozen=True)
class CoupledFriction(AbstractTorqueEffect):
    """Friction and inertia of a drive that turns with qd + ratio qd_driver; the driver is the joint before its own in
    the chain, through which the shaft passes.

    Attributes:
        ratios: to try. Bevel gears of wrists have 1 or -1; another one beside own friction is hardly determined by a
            log, and would take the sizes with it.
    """

    ratios: tuple[float, ...] = (-1.0, 1.0)

    name = "coupled_friction"
    title = "coupled friction"
    friction = True
    meaning = "Friction and inertia of a drive that two joints turn: they share a gear."
    equation = (
        "coulomb sign(s) + damping s + armature ds/dt, s = qd + ratio qd_driver; on the driver (the joint before this "
        "one) ratio times this torque"
    )
    reference = "Khalil and Dombre, Modeling, Identification and Control of Robots, 2002"
    parameters = {
        "coulomb": Parameter("N m", 0.0),
        "damping": Parameter("N m s/rad", 0.0),
        "armature": Parameter("kg m²", 0.0),
        "ratio": Parameter("-", -4.0, 4.0),
    }
    sides = MOTOR_SIDES
    confounders = (
        ("coulomb_friction",),
        ("viscous_friction",),
        ("rotor_inertia",),
        ("stribeck_friction",),
        ("link_inertia_error",),
    )
    nonlinear = ("ratio",)
    chosen = ("ratio",)
    advice = "each of the two joints moved alone while the other is held, then both together, in both directions"
    panels = ("velocity", "shared_velocity")
    shows = ("neighbours",)
    coupled = True
    jumps = True
    needs = ("motion", "together")

    def typical(self, usual: UsualJoint) -> dict[str, Any]:
        level = usual.level / 2
        return {"coulomb": level, "damping": level / usual.speed, "armature": 0.05 * usual.inertia, "ratio": 1.0}

    def in_simulator(self, parameters: Parameters) -> SimulatorTerms:
        return SimulatorTerms(drive=parameters)

    def term(self, parameters: Parameters, state: JointState) -> Array:
        sign, speed, acceleration = self.basis(state, parameters)
        return parameters["coulomb"] * sign + parameters["damping"] * speed + parameters["armature"] * acceleration

    def shapes(self, state: JointState) -> Sequence[Parameters]:
        return [{"ratio": x} for x in self.ratios]

    def basis(self, state: JointState, shape: Parameters) -> Sequence[Array]:
        driver, ratio = state.driver, shape["ratio"]
        assert driver is not None, "a coupled effect acts on a joint that has one before it"
        speed = state.qd + ratio * driver.qd
        width = (state.width**2 + (ratio * driver.width) ** 2) ** 0.5
        return sign_of(speed, width), speed, state.qdd + ratio * driver.qdd

    def share_on_driver(self, parameters: Parameters) -> float:
        return parameters["ratio"]

    def read(self, coefficients: Sequence[float], shape: Parameters) -> dict[str, float]:
        parts = dict(zip(("coulomb", "damping", "armature"), coefficients, strict=True))
        small = NONE * sum(abs(x) for x in parts.values())
        return {**{k: 0.0 if -small < x < 0 else x for k, x in parts.items()}, **shape}

    def refuse(self, parameters: Parameters) -> str:
        if abs(parameters["ratio"]) < LEAST_RATIO:
            return f"ratio would be {parameters['ratio']:.2g}: the previous joint hardly turns this drive"
        return super().refuse(parameters)
