"""Typical sizes of effects, for causes that a log gave none: shares of the torque that the joint has anyway; and what a
design can do with an effect at all.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from invdyn_cli.design.causes import CYCLES, Usual
from invdyn_cli.diagnosis.search.naming import TYPICAL_STRIBECK, TYPICAL_VELOCITY
from invdyn_cli.effects.composition import has_driver
from invdyn_cli.errors import UsageError, listed
from invdyn_cli.interfaces import AbstractEffect, AbstractTorqueEffect, Parameters
from invdyn_cli.types import Robot

SHARE = 0.08
"""Of a joint's usual torque, what a typical effect adds to it."""

BRISTLE = 0.005
"""[rad; m] after which two thirds of the friction of bent bristles are there."""

GAP = 0.003
"""[rad; m] of play: 10 minutes of arc, a gear of ordinary make."""

RESONANCE = 12.0
"""[Hz] of a link on its joint's spring, motor held."""

POINTS = ("torque", "channel", "body", "motion", "gear")
"""Where what a design can play acts: from the motion alone."""

VECTORS = {"com": (3,), "moment": (3,), "inertia": (6,)}
"""Shapes of parameters that are no single number."""


@dataclass(frozen=True)
class Ordinary:
    """What a joint usually does: a typical share of its `torque` [N m; N], a usual `speed`, and the rest of `Usual`."""

    robot: Robot
    joint: int
    level: float
    torque: float
    speed: float
    span: float
    middle: float
    inertia: float
    duration: float


SIZES: Mapping[str, Callable[[Ordinary], dict[str, Any]]] = {
    "viscous_friction": lambda u: {"damping": u.level / u.speed},
    "coulomb_friction": lambda u: {"coulomb": u.level},
    "asymmetric_coulomb_friction": lambda u: {"positive": 1.4 * u.level, "negative": 0.6 * u.level},
    "stribeck_friction": lambda u: {
        "coulomb": u.level,
        "static": TYPICAL_STRIBECK * u.level,
        "velocity": TYPICAL_VELOCITY,
    },
    "load_dependent_friction": lambda u: {"mu": 0.1},
    "quadratic_friction": lambda u: {"drag": u.level / u.speed**2},
    "presliding_hysteresis": lambda u: {"coulomb": u.level, "stiffness": u.level / BRISTLE},
    "thermal_friction_drift": lambda u: {
        "cold": 1.5 * u.level / u.speed,
        "warm": u.level / u.speed,
        "time_constant": u.duration / 3,
    },
    "coupled_friction": lambda u: {
        "coulomb": u.level / 2,
        "damping": u.level / 2 / u.speed,
        "armature": 0.05 * u.inertia,
        "ratio": 1.0,
    },
    "torque_offset_drift": lambda u: {"rate": 2 * u.level / u.duration},
    "backlash": lambda u: {"gap": GAP},
    "joint_elasticity": lambda u: {"stiffness": max(u.inertia * (2 * np.pi * RESONANCE) ** 2, 1.0)},
    "torque_ripple": lambda u: {"amplitude": u.level, "cycles": CYCLES[1], "phase": 0.5},
    "joint_spring": lambda u: {"stiffness": 4 * u.level / u.span, "rest": u.middle},
    "rotor_inertia": lambda u: {"armature": 0.15 * u.inertia},
    "torque_gain_error": lambda u: {"gain": 0.9},
    "torque_offset": lambda u: {"offset": u.level},
    "torque_delay": lambda u: {"delay": 0.01},
    "actuator_lag": lambda u: {"time_constant": 0.01},
    "torque_saturation": lambda u: {"limit": 1.5 * u.torque},
    "payload": lambda u: {
        "mass": 0.05 * float(np.asarray(u.robot.inertial)[:, 0].sum()),
        "com": np.array([0.02, 0.0, 0.05]),
        "inertia": np.zeros(6),
    },
    "link_inertia_error": lambda u: _link(0.2 * np.asarray(u.robot.inertial)[u.joint]),
    "base_tilt": lambda u: _tilt(u.robot),
    "encoder_offset": lambda u: {"offset": 0.03},
}


def typical(effect: AbstractEffect, joint: int | None, robot: Robot, usual: Usual, duration: float) -> dict[str, Any]:
    """Parameters of a typical size.

    Raises:
        UsageError: for an effect whose usual size is not known here.
    """
    j = 0 if joint is None else joint
    if effect.name not in SIZES:
        raise UsageError(
            f"{effect.name} has no typical size",
            advice=f"its parameters: {listed(effect.parameters)}, in its units",
        )
    ordinary = Ordinary(
        robot, j, SHARE * usual.torque[j], usual.torque[j], 0.3 * usual.speed[j], usual.range[j], usual.middle[j],
        usual.inertia[j], duration,
    )  # fmt: skip
    return SIZES[effect.name](ordinary)


def unplayable(
    effect: AbstractEffect, robot: Robot, parameters: Parameters | None = None, joint: str | None = None
) -> str:
    """Why no motion can be designed for an effect on a robot, and on this joint of it; "" if one can."""
    coupled = isinstance(effect, AbstractTorqueEffect) and effect.coupled
    if coupled and joint in robot.joints and not has_driver(robot, robot.joints.index(joint)):
        return f"there is no joint before {joint} that could share a gear with it"
    if effect.passing:
        return "it comes and goes, and no motion makes it come again"
    if effect.point not in POINTS:
        return f"it acts at the {effect.point}, which no motion asks for"
    if effect.name == "base_tilt" and not np.any(robot.gravity):
        return f"nothing pulls at {robot.name}"
    if parameters is None and effect.name not in SIZES:
        return "its usual size is not known"
    return ""


def left_out(effect: AbstractEffect, why: str) -> str:
    """That an effect is left out of a design, and what would tell it from others."""
    return f"{effect.title}: {why}" + (f"; what would tell: {effect.advice}" if effect.advice else "")


def refused(effect: AbstractEffect, parameters: Parameters) -> str:
    """Why these are no parameters of an effect, "" if they are: a name that lacks, no number, too few of them, or
    beyond what is physics."""
    for name in effect.parameters:
        if name not in parameters:
            return f"{name} is missing"
        shape = VECTORS.get(name, ()) if effect.point == "body" else ()
        try:
            value = np.asarray(parameters[name], float)
        except (TypeError, ValueError):
            return f"{name} is no number"
        if value.shape != shape or not np.all(np.isfinite(value)):
            return f"{name}={parameters[name]}; allowed: {shape[0] if shape else 'a'} finite number{'s' * bool(shape)}"
    return effect.refuse(parameters)


def _link(own: np.ndarray) -> dict[str, Any]:
    """Inertials (10,) as an error of a link has them."""
    return {"mass": float(own[0]), "moment": own[1:4], "inertia": own[4:]}


def _tilt(robot: Robot) -> dict[str, float]:
    """Gravity turned by 0.05 rad from where the model has it."""
    down = np.asarray(robot.gravity) / float(np.linalg.norm(robot.gravity))
    side = np.cross(down, np.eye(3)[np.argmin(np.abs(down))])
    down = down + 0.05 * (side / float(np.linalg.norm(side)))
    down = down / np.linalg.norm(down)
    return {"angle": float(np.arccos(np.clip(-down[2], -1, 1))), "azimuth": float(np.arctan2(down[1], down[0]))}
