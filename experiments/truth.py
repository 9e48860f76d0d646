"""What was hidden in a simulated arm, as the model that a diagnosis of its log should write."""

from collections.abc import Sequence

import numpy as np

from invdyn_cli.diagnosis.extension import exported
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.composition import EffectInstance
from invdyn_cli.effects.description import ExtendedModel
from invdyn_cli.simulation.hidden import Hidden, assemble
from invdyn_cli.types import Robot


def model_of(robot: Robot, hidden: Sequence[Hidden]) -> ExtendedModel:
    """The robot with what was hidden: a payload as the sphere that it is, a link by its inertials' change."""
    gradual = {one.joint: float(one.parameters["transition"]) for one in hidden if "transition" in one.parameters}
    acting = tuple(_acting(robot, one) for one in hidden)
    return ExtendedModel(robot, acting, transition=tuple(gradual.get(joint, 0.0) for joint in robot.joints))


def mjcf_of(robot: Robot, hidden: Sequence[Hidden] = ()) -> tuple[str, tuple[str, ...]]:
    """The MJCF of that model, and what it does not hold."""
    out = exported(model_of(robot, hidden))
    return out.mjcf, out.mjcf_lacks


def _acting(robot: Robot, one: Hidden) -> EffectInstance:
    joint = None if one.joint is None else robot.joints.index(one.joint)
    made, effect = assemble(robot, [one]), EFFECTS[one.effect]
    if made.carried:
        (ball,) = made.carried
        sphere = 0.4 * ball.mass * ball.radius**2 * np.array([1, 0, 1, 0, 0, 1])
        return EffectInstance(effect, None, {"mass": ball.mass, "com": np.asarray(ball.com, float), "inertia": sphere})
    if joint is not None and not np.array_equal(made.inertial, robot.inertial):
        row = (made.inertial - robot.inertial)[joint]
        return EffectInstance(effect, joint, {"mass": row[0], "moment": row[1:4], "inertia": row[4:]})
    return EffectInstance(effect, joint, {name: x for name, x in one.parameters.items() if name in effect.parameters})
