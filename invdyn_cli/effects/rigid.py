"""Rigid-body torques of long motions, numpy in and out: two compiled programs for each number of joints, which take
parts of one length. Compiling a program takes a second, and a log's diagnosis calls them some hundred times."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from invdyn_cli.maths import rigid_body
from invdyn_cli.types import Array, Motion, Robot

PART = 1024
"""Samples of a part: the pieces of a log have some thousand samples, and the last part is padded."""


def rigid_torque(robot: Robot, motion: Motion) -> np.ndarray:
    """Inverse dynamics (n, T) [N m; N] of a motion (n, T)."""
    gravity = np.asarray(robot.gravity, float)
    return _in_parts(partial(_dynamics, _kinematics(robot), np.asarray(robot.inertial, float), gravity), motion)


def regressor(robot: Robot, motion: Motion) -> np.ndarray:
    """Torque (10 n, n, T) of unit inertial parameters of all links, for a motion (n, T)."""
    return _in_parts(_columns(robot), motion)


def body_columns(robot: Robot, moves: np.ndarray, motion: Motion) -> np.ndarray:
    """Torque (k, n, T) of unit changes (k, 10 n) of the inertials, for a motion (n, T)."""
    columns = _columns(robot)
    return _in_parts(lambda *part: np.tensordot(moves, np.asarray(columns(*part)), 1), motion)


def force_columns(robot: Robot, link: int, point: np.ndarray, motion: Motion) -> np.ndarray:
    """Torques (3, n, T) that hold unit forces along the base's axes at a point (3,) [m] of a link's frame, in the
    postures of a motion (n, T)."""
    return _in_parts(partial(_force_columns, _kinematics(robot), link, point), motion)


def gravity_columns(robot: Robot, falls: np.ndarray, q: Array) -> np.ndarray:
    """Torque (k, n, T) at rest of unit changes (k, 3) of gravity, in postures q (n, T)."""
    held = Motion(q, np.zeros_like(q), np.zeros_like(q))
    return np.array([rigid_torque(replace(robot, gravity=g), held) for g in falls]).reshape(-1, *np.shape(q))


def _in_parts(function: Callable[..., Array], motion: Motion) -> np.ndarray:
    """A function of q, qd and qdd (n, PART), applied to parts of a motion (n, T) and joined along the last axis."""
    rows = [np.asarray(x, float) for x in (motion.q, motion.qd, motion.qdd)]
    total, out = rows[0].shape[-1], []
    for start in range(0, total, PART):
        part = [x[..., start : start + PART] for x in rows]
        missing = PART - part[0].shape[-1]
        if missing:
            part = [np.pad(x, ((0, 0), (0, missing)), mode="edge") for x in part]
        out.append(np.asarray(function(*part))[..., : PART - missing])
    return np.concatenate(out, axis=-1)


def _columns(robot: Robot) -> Callable[..., Array]:
    return partial(_regressor, _kinematics(robot), np.asarray(robot.gravity, float))


@jax.jit
def _dynamics(kinematics: tuple, inertial, gravity, q, qd, qdd):
    return rigid_body.inverse_dynamics(_robot(kinematics, inertial, gravity), inertial, q, qd, qdd)


@jax.jit
def _regressor(kinematics: tuple, gravity, q, qd, qdd):
    rows = rigid_body.regressor(_robot(kinematics, jnp.zeros((len(q), 10)), gravity), q, qd, qdd)
    return rows.reshape(-1, *q.shape)


@jax.jit
def _force_columns(kinematics: tuple, link, point, q, qd, qdd):
    n = len(q)
    return rigid_body.force_columns(_robot(kinematics, jnp.zeros((n, 10)), jnp.zeros(3)), link, point, q)


@jax.tree_util.register_static
@dataclass(frozen=True)
class _Static:
    """The fields of a robot that are not arrays, compared by value: robots that differ only in arrays share a compiled
    program."""

    parents: tuple[int, ...]
    prismatic: tuple[bool, ...]


def _kinematics(robot: Robot) -> tuple:
    """Structure and arrays of a robot's kinematics, as jitted functions take them."""
    arrays = (np.asarray(x, float) for x in (robot.rotation, robot.translation, robot.axis))
    return _Static(robot.parents, robot.prismatic), *arrays


def _robot(kinematics: tuple, inertial: Array, gravity: Array) -> Robot:
    """The robot of `_kinematics` with these inertials and gravity."""
    static, rotation, translation, axis = kinematics
    n = len(static.parents)
    blank = jnp.zeros(n)
    return Robot(
        "", tuple(map(str, range(n))), static.parents, static.prismatic, rotation, translation, axis, inertial, gravity,
        blank, blank, blank, blank, blank, blank,
    )  # fmt: skip
