"""A robot with effects on it: from a motion to the torque that is logged, effects composed in one fixed order.

logged = channel(torque terms + inverse dynamics of (changed bodies, true motion)).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from invdyn_cli.interfaces import (
    CHUNK,
    AbstractBodyEffect,
    AbstractChannelEffect,
    AbstractEffect,
    AbstractMotionEffect,
    AbstractTorqueEffect,
    JointState,
    Parameters,
)
from invdyn_cli.maths import rigid_body
from invdyn_cli.types import Array, Motion, Robot


@dataclass(frozen=True)
class Acting:
    """An effect at work: on a joint (None: the whole arm), with these parameters."""

    effect: AbstractEffect
    joint: int | None
    parameters: Parameters


def changed(robot: Robot, acting: Sequence[Acting], motion: Motion) -> tuple[Robot, Motion]:
    """The robot with the body effects among `acting`, and the true motion (n, *batch) of a logged one; numpy or jax."""
    for one in acting:
        if isinstance(one.effect, AbstractMotionEffect):
            assert one.joint is not None
            motion = one.effect.true(one.parameters, motion, one.joint)
        elif isinstance(one.effect, AbstractBodyEffect):
            robot = one.effect.changed(one.parameters, robot, one.joint)
    return robot, motion


def body_torque(robot: Robot, acting: Sequence[Acting], motion: Motion) -> Array:
    """Inverse dynamics (n, *batch) [N m; N] with the motion and body effects among `acting`; pure jax."""
    robot, motion = changed(robot, acting, motion)
    return rigid_body.inverse_dynamics(robot, robot.inertial, motion.q, motion.qd, motion.qdd)


def joint_terms(acting: Sequence[Acting], joint: int, state: JointState) -> list[Array]:
    """What each torque effect on a joint adds, shape of the state's arrays."""
    return [
        one.effect.term(one.parameters, state)
        for one in acting
        if isinstance(one.effect, AbstractTorqueEffect) and one.joint == joint
    ]


def channel(acting: Sequence[Acting], joint: int, tau: Array, rate: float) -> Array:
    """What is logged where tau (T,) reaches a joint, at `rate` [Hz]."""
    for one in acting:
        if isinstance(one.effect, AbstractChannelEffect) and one.joint == joint:
            tau = one.effect.logged(one.parameters, tau, rate)
    return tau


def sign_of(qd: Array, width: Array | float) -> Array:
    """sign(qd) with a straight line through zero, `width` [rad/s] to either side."""
    return qd.__array_namespace__().clip(qd / width, -1, 1)


def chunked(function, *arrays: np.ndarray) -> np.ndarray:
    """A jitted function of (n, T) arrays in chunks of one length (one compilation), joined along the last axis."""
    total = arrays[0].shape[-1]
    out = []
    for start in range(0, total, CHUNK):
        part = [x[..., start : start + CHUNK] for x in arrays]
        missing = CHUNK - part[0].shape[-1]
        if missing:
            part = [np.pad(x, ((0, 0), (0, missing)), mode="edge") for x in part]
        out.append(np.asarray(function(*part))[..., : CHUNK - missing])
    return np.concatenate(out, axis=-1)


@jax.jit
def _dynamics(kinematics: tuple, inertial, gravity, q, qd, qdd):
    robot = rebuilt(kinematics, inertial, gravity)
    return rigid_body.inverse_dynamics(robot, inertial, q, qd, qdd)


def rigid_torque(robot: Robot, motion: Motion) -> np.ndarray:
    """Inverse dynamics (n, T) of a long motion (n, T), numpy in and out."""
    inertial, gravity = jnp.asarray(robot.inertial), jnp.asarray(robot.gravity)
    function = partial(_dynamics, kinematics_of(robot), inertial, gravity)
    return chunked(function, *(np.asarray(x) for x in (motion.q, motion.qd, motion.qdd)))


class _Static:
    """What of a robot is not an array, compared by value: two robots that differ in arrays alone share a program."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.key = (robot.parents, robot.prismatic)

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other) -> bool:
        return isinstance(other, _Static) and self.key == other.key


jax.tree_util.register_static(_Static)


def kinematics_of(robot: Robot) -> tuple:
    """Arrays and structure of a robot's kinematics, as jitted functions take them."""
    arrays = tuple(jnp.asarray(x) for x in (robot.rotation, robot.translation, robot.axis))
    return _Static(robot), *arrays


def rebuilt(kinematics: tuple, inertial: Array, gravity: Array) -> Robot:
    """The robot of `kinematics_of` with these inertials and gravity."""
    static, rotation, translation, axis = kinematics
    n = len(static.robot.parents)
    blank = jnp.zeros(n)
    return Robot(
        "", tuple(map(str, range(n))), static.key[0], static.key[1], rotation, translation, axis, inertial, gravity,
        blank, blank, blank, blank, blank, blank,
    )  # fmt: skip
