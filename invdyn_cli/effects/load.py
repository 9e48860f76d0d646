"""Bodies, mounting and encoders: effects that act on all joints."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from invdyn_cli.interfaces import AbstractBodyEffect, AbstractMotionEffect, Parameter, Parameters
from invdyn_cli.joints import SimulatorTerms, UsualJoint
from invdyn_cli.types import Array, Motion, Robot

MASS, MOMENT, INERTIA = 5.0, 1.0, 0.3
"""Scales that changes of a link's mass [kg], first moments [kg m] and inertia [kg m²] hardly exceed on a robot arm."""

USUAL_TILT, LEVEL = 0.05, 1e-6
"""[rad]; and by how much the cosine of the mounting of a level base differs from 1."""

STILL = np.zeros(3)


class AbstractLoadEffect(AbstractBodyEffect):
    """A body on the last link. `inertia` (xx, xy, yy, xz, yz, zz) about its centre of mass is what it has beyond a
    point mass."""

    parameters = {"mass": Parameter("kg"), "com": Parameter("m"), "inertia": Parameter("kg m²")}
    panels = ("joints",)
    of_joint = False
    load = True

    def changed(self, parameters: Parameters, robot: Robot, joint: int | None) -> Robot:
        return _added(robot, robot.dofs - 1, _body(parameters))

    def directions(self, robot: Robot, joint: int | None) -> Sequence[tuple[Array, Array, float]]:
        scales = [MASS] + [MOMENT] * 3 + [0.1 * INERTIA] * 6
        return [(_unit(robot, robot.dofs - 1, k), STILL, scale) for k, scale in enumerate(scales)]

    def read(self, coefficients: Sequence[float], robot: Robot, joint: int | None) -> dict[str, Any]:
        mass = coefficients[0] or 1e-12
        com = np.asarray(coefficients[1:4]) / mass
        return {"mass": mass, "com": com, "inertia": np.asarray(coefficients[4:]) - mass * np.array(_point(*com))}

    def coefficients(self, parameters: Parameters, robot: Robot, joint: int | None) -> list[float]:
        return [float(x) for x in _body(parameters)]


@dataclass(frozen=True)
class Payload(AbstractLoadEffect):
    """A body on the last link that the model does not contain: tool, gripper, object.

    A negative mass is kept for the search: it is then no payload, but a link that is lighter than its model; or, as a
    change since an earlier log, a body that was taken off.
    """

    name = "payload"
    title = "payload"
    meaning = "A body on the last link that the URDF does not have: a tool, a load."
    equation = "a body of this mass at com in the frame of the last moving joint"
    reference = "Atkeson, An and Hollerbach, IJRR 1986; Khalil, Gautier and Lemoine, ICRA 2007"
    for_a_time = "payload_change"
    confounders = (("link_inertia_error",), ("torque_gain_error",))
    advice = "the same trajectory without the load, or the mass of the tool from a scale"
    shows = ("load", "acceleration")

    def typical(self, usual: UsualJoint) -> dict[str, Any]:
        arm = float(np.asarray(usual.robot.inertial)[:, 0].sum())
        return {"mass": 0.05 * arm, "com": np.array([0.02, 0.0, 0.05]), "inertia": np.zeros(6)}

    def in_simulator(self, parameters: Parameters) -> SimulatorTerms:
        return SimulatorTerms(body=np.array(_body(parameters), float))


@dataclass(frozen=True)
class LinkInertiaError(AbstractBodyEffect):
    """Other inertials of one link than in the model. Only base parameters are identifiable; the others stay as in the
    model."""

    name = "link_inertia_error"
    title = "link inertia error"
    meaning = "A link's mass, centre of mass or inertia differs from the URDF's."
    equation = "another mass, first moment and inertia of one link"
    reference = "Gautier and Khalil, IEEE T-RA 1990"
    parameters = {"mass": Parameter("kg"), "moment": Parameter("kg m"), "inertia": Parameter("kg m²")}
    confounders = (
        ("link_inertia_error",),
        ("payload",),
        ("encoder_offset",),
        ("base_tilt",),
        ("rotor_inertia",),
        ("torque_gain_error",),
        ("torque_offset",),
        ("joint_spring",),
    )
    advice = "an exciting trajectory that moves all joints fast and over their whole range"
    panels = ("joints",)
    group = "standard"
    shows = ("angle", "acceleration", "neighbours")

    def typical(self, usual: UsualJoint) -> dict[str, Any]:
        own = 0.2 * np.asarray(usual.robot.inertial)[usual.joint]
        return {"mass": float(own[0]), "moment": own[1:4], "inertia": own[4:]}

    def in_simulator(self, parameters: Parameters) -> SimulatorTerms:
        return SimulatorTerms()

    def changed(self, parameters: Parameters, robot: Robot, joint: int | None) -> Robot:
        assert joint is not None
        return _added(robot, joint, [parameters["mass"], *parameters["moment"], *parameters["inertia"]])

    def directions(self, robot: Robot, joint: int | None) -> Sequence[tuple[Array, Array, float]]:
        assert joint is not None
        scales = [MASS] + [MOMENT] * 3 + [INERTIA] * 6
        return [(_unit(robot, joint, k), STILL, scale) for k, scale in enumerate(scales)]

    def read(self, coefficients: Sequence[float], robot: Robot, joint: int | None) -> dict[str, Any]:
        change = np.asarray(coefficients)
        return {"mass": float(change[0]), "moment": change[1:4], "inertia": change[4:]}

    def coefficients(self, parameters: Parameters, robot: Robot, joint: int | None) -> list[float]:
        return [float(parameters["mass"]), *map(float, parameters["moment"]), *map(float, parameters["inertia"])]


@dataclass(frozen=True)
class BaseTilt(AbstractBodyEffect):
    """Gravity in another direction than in the model: the base is not mounted as the model says."""

    name = "base_tilt"
    title = "base tilt"
    meaning = "The base is not level."
    equation = "gravity = 9.81 (sin angle cos azimuth, sin angle sin azimuth, −cos angle)"
    reference = "Atkeson, An and Hollerbach, IJRR 1986"
    parameters = {"angle": Parameter("rad", 0.0, np.pi), "azimuth": Parameter("rad")}
    sized_by = "angle"
    confounders = (("link_inertia_error",), ("encoder_offset",), ("torque_offset",))
    advice = (
        "a spirit level on the base; or rotations of a vertical first joint: its gravity torque is zero without tilt"
    )
    panels = ("joints",)
    of_joint = False
    turns_gravity = True
    shows = ("angle",)

    def typical(self, usual: UsualJoint) -> dict[str, Any] | None:
        gravity = np.asarray(usual.robot.gravity)
        if not np.any(gravity):
            return None
        down = gravity / np.linalg.norm(gravity)
        down = down + USUAL_TILT * _sideways(down)[0]
        down = down / np.linalg.norm(down)
        angle, azimuth = np.arccos(np.clip(-down[2], -1, 1)), np.arctan2(down[1], down[0])
        return {"angle": float(angle), "azimuth": float(azimuth)}

    def in_simulator(self, parameters: Parameters) -> SimulatorTerms:
        return SimulatorTerms()

    def changed(self, parameters: Parameters, robot: Robot, joint: int | None) -> Robot:
        xp = np if isinstance(parameters["angle"], float) else parameters["angle"].__array_namespace__()
        angle, azimuth = parameters["angle"], parameters["azimuth"]
        down = [xp.sin(angle) * xp.cos(azimuth), xp.sin(angle) * xp.sin(azimuth), -xp.cos(angle)]
        return replace(robot, gravity=_length(robot) * xp.stack([xp.asarray(x) for x in down]))

    def directions(self, robot: Robot, joint: int | None) -> Sequence[tuple[Array, Array, float]]:
        none = np.zeros((robot.dofs, 10))
        return [(none, _length(robot) * side, 0.3) for side in _sideways(np.asarray(robot.gravity))]

    def read(self, coefficients: Sequence[float], robot: Robot, joint: int | None) -> dict[str, Any]:
        down = np.asarray(robot.gravity) / _length(robot)
        down = down + sum(c * side for c, side in zip(coefficients, _sideways(down), strict=True))
        down = down / np.linalg.norm(down)
        angle = np.arctan2(np.hypot(down[0], down[1]), -down[2])
        return {"angle": float(angle), "azimuth": float(np.arctan2(down[1], down[0]))}

    def remark(self, parameters: Parameters, robot: Robot) -> str:
        nominal = np.asarray(robot.gravity) / _length(robot)
        if nominal[2] < -1 + LEVEL:  # then that is the angle
            return ""
        down = np.asarray(self.changed(parameters, robot, None).gravity) / _length(robot)
        turned = np.degrees(np.arccos(np.clip(nominal @ down, -1.0, 1.0)))
        return f"Gravity is {turned:.3g} degrees away from its direction in the stated mounting of the base."

    def coefficients(self, parameters: Parameters, robot: Robot, joint: int | None) -> list[float]:
        nominal = np.asarray(robot.gravity) / _length(robot)
        down = np.asarray(self.changed(parameters, robot, joint).gravity) / _length(robot)
        return [float(down @ side / (down @ nominal)) for side in _sideways(nominal)]


@dataclass(frozen=True)
class EncoderOffset(AbstractMotionEffect):
    """A wrong zero position of a joint. What it changes of the last joint's load, a payload may change, too."""

    name = "encoder_offset"
    title = "encoder offset"
    meaning = "The joint's zero is not where the URDF has it."
    equation = "logged q = true q + offset"
    reference = "Hollerbach and Wampler, IJRR 1996"
    parameters = {"offset": Parameter("rad", -0.8, 0.8)}
    confounders = (("link_inertia_error",), ("payload",), ("base_tilt",), ("torque_offset",))
    advice = "a calibration of the joint's zero by an external measurement"
    panels = ("position",)
    needs = ("range",)
    shows = ("angle",)

    def typical(self, usual: UsualJoint) -> dict[str, Any]:
        return {"offset": 0.03}

    def in_simulator(self, parameters: Parameters) -> SimulatorTerms:
        return SimulatorTerms({"encoder": parameters["offset"]})

    def true(self, parameters: Parameters, motion: Motion, joint: int) -> Motion:
        xp = motion.q.__array_namespace__()
        own = xp.asarray(np.arange(motion.q.shape[0]) == joint, dtype=motion.q.dtype)
        own = xp.reshape(own, (-1, *(1,) * (motion.q.ndim - 1)))
        return Motion(motion.q - own * parameters["offset"], motion.qd, motion.qdd)


def _unit(robot: Robot, link: int, parameter: int) -> np.ndarray:
    """(n, 10), one for this parameter of this link."""
    one = np.zeros((robot.dofs, 10))
    one[link, parameter] = 1.0
    return one


def _body(parameters: Parameters) -> list[Any]:
    """The ten inertial parameters of a payload about the frame's origin."""
    mass, com, own = parameters["mass"], parameters["com"], parameters["inertia"]
    about = (mass * i + o for i, o in zip(_point(*com), own, strict=True))
    return [mass, *(mass * x for x in com), *about]


def _point(x: Any, y: Any, z: Any) -> tuple[Any, ...]:
    """Inertia (xx, xy, yy, xz, yz, zz) of a unit mass at a point, about the origin."""
    return y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y


def _added(robot: Robot, link: int, change: Sequence[Any]) -> Robot:
    """The robot with ten more parameters on a link."""
    xp = next((x.__array_namespace__() for x in change if hasattr(x, "__array_namespace__")), np)
    row = xp.stack([xp.asarray(x, dtype=float) for x in change])
    own = np.arange(robot.dofs) == link
    return replace(robot, inertial=xp.asarray(robot.inertial) + xp.asarray(own[:, None], dtype=float) * row)


def _length(robot: Robot) -> float:
    return float(np.linalg.norm(np.asarray(robot.gravity)))


def _sideways(down: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors perpendicular to the nominal direction of gravity."""
    down = down / np.linalg.norm(down)
    first = np.eye(3)[np.argmin(np.abs(down))]
    first = first - down * (first @ down)
    first = first / np.linalg.norm(first)
    return first, np.cross(down, first)
