"""Typical sizes of effects, for causes whose size is not known from a log, and whether a design can use an effect at
all."""

from typing import Any

import numpy as np

from invdyn_cli.design.causes import Usual
from invdyn_cli.effects.composition import has_driver
from invdyn_cli.errors import UsageError, listed
from invdyn_cli.interfaces import AbstractEffect, Parameters
from invdyn_cli.joints import UsualJoint
from invdyn_cli.types import Robot

SHARE = 0.08
"""Torque of a typical effect, as a share of the joint's usual torque."""

POINTS = ("torque", "channel", "body", "motion", "gear")
"""Points of action that a design can compute from the motion alone."""

VECTORS = {"com": (3,), "moment": (3,), "inertia": (6,)}
"""Shapes of parameters that are no single number."""


def typical(effect: AbstractEffect, joint: int | None, robot: Robot, usual: Usual, duration: float) -> dict[str, Any]:
    """Parameters of a typical size.

    Raises:
        UsageError: for an effect whose usual size is not known.
    """
    j = 0 if joint is None else joint
    level, speed, span, middle = SHARE * usual.torque[j], 0.3 * usual.speed[j], usual.range[j], usual.middle[j]
    one = UsualJoint(robot, j, level, usual.torque[j], speed, span, middle, usual.inertia[j], duration)
    made = effect.typical(one)
    if made is None:
        raise UsageError(
            f"{effect.name} has no typical size",
            advice=f"values of {listed(effect.parameters)}, in the units listed by `invdyn effects {effect.name}`",
        )
    return made


def unplayable(
    effect: AbstractEffect, robot: Robot, parameters: Parameters | None = None, joint: str | None = None
) -> str:
    """Why no motion can be designed for an effect on a robot, and on this joint of it; "" if one can."""
    coupled = effect.coupled
    if coupled and joint in robot.joints and not has_driver(robot, robot.joints.index(joint)):
        return f"there is no joint before {joint} that could share a gear with it"
    if effect.passing:
        return "it acts only in a time window, and no motion reproduces it"
    if effect.point not in POINTS:
        return f"it acts at the {effect.point}, and no motion can be designed for such effects"
    if effect.turns_gravity and not np.any(robot.gravity):
        return f"no gravity acts on {robot.name}"
    if parameters is None and effect.typical(UsualJoint(robot, 0, *[1.0] * 7)) is None:
        return "its typical size is not known"
    return ""


def left_out(effect: AbstractEffect, why: str) -> str:
    """A sentence: an effect is left out of a design, and what would distinguish it from others."""
    return f"{effect.title}: {why}" + (f"; use instead: {effect.advice}" if effect.advice else "")


def refused(effect: AbstractEffect, parameters: Parameters) -> str:
    """Why these are not parameters of an effect, "" if they are: a missing name, a value that is not a number or has
    the wrong shape, or one that is physically impossible."""
    for name in effect.parameters:
        if name not in parameters:
            return f"{name} is missing"
        shape = VECTORS.get(name, ()) if effect.point == "body" else ()
        try:
            value = np.asarray(parameters[name], float)
        except (TypeError, ValueError):
            return f"{name} is not a number"
        if value.shape != shape or not np.all(np.isfinite(value)):
            return f"{name}={parameters[name]}; allowed: {shape[0] if shape else 'a'} finite number{'s' * bool(shape)}"
    return effect.refuse(parameters)
