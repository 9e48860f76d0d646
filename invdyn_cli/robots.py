"""URDF -> types.Robot; the only module that uses Pinocchio.

Pinocchio reads the tree, merges fixed joints and locks others; `urdf` adds what Pinocchio does not keep: axes, limits
as written, `<dynamics>` and mimic tags.
"""
# pyright: reportAttributeAccessIssue=false

import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin  # pyright: ignore[reportMissingImports]: its wheel lies behind a .pth file

from invdyn_cli import urdf, urdf_checks
from invdyn_cli.errors import RobotError, closest, listed, shortened
from invdyn_cli.types import Robot
from invdyn_cli.urdf import MOVING

DOWN = (0.0, 0.0, -9.81)
"""Gravity of an upright base [m/s^2]."""

GRIPPER = re.compile("finger|gripper|knuckle|jaw", re.IGNORECASE)
"""Joints with these names are assumed to belong to a gripper, unless `joints` or `tip` says which joints move."""

FINGER_JOINTS = 2
"""Branches behind a longer arm with at most this number of moving joints are assumed to be fingers."""


def load_urdf(
    path: str | Path | None,
    *,
    joints: Sequence[str] | None = None,
    tip: str | None = None,
    dofs: int | None = None,
    gravity: Sequence[float] | None = None,
    base_rpy: Sequence[float] | None = None,
    payload: Mapping[str, Any] | None = None,
    dynamics_tags: str = "ignore",
) -> Robot:
    """A robot from a URDF or xacro file.

    Joints that are not chosen to move are locked at zero, or at the limit nearest to it, and named in `Robot.notes`.

    Args:
        path: a .urdf or .xacro file (xacro may run Python code), or the name of a built-in robot.
        joints: names of the joints that move, in any order; None: all except those of a gripper (mimic joints and the
            joints that they follow, names with finger, gripper, knuckle or jaw, short branches at the arm's end).
            Columns of a log that have no names are read in this order.
        tip: a link or joint; the joints between it and the base move.
        dofs: keeps that many of these joints, from the base, and drops all bodies behind them (paper, section V-A).
        gravity: [m/s^2] (3,) in the base frame; None: [0,0,-9.81].
        base_rpy: [rad] (3,) roll, pitch and yaw of a base that does not stand upright, instead of gravity.
        payload: body on the last moving link: {mass: kg, com: [x,y,z] m in the last moving joint's frame}, and inertia:
            [xx,xy,xz,yy,yz,zz] about its com [kg m^2] (or (3, 3)) if it is no point mass.
        dynamics_tags: use fills `Robot.damping` and `Robot.friction` from the URDF's <dynamics> tags; ignore leaves
            them zero.

    Raises:
        RobotError: if the file cannot be read, or cannot be the robot that is asked for.
    """
    if dynamics_tags not in ("ignore", "use"):
        raise RobotError(f"robot.dynamics_tags={dynamics_tags!r}; allowed: ignore, use")
    text = urdf.read(path)
    root = urdf.parse(text, path)
    urdf_checks.refuse(root, path)
    urdf_checks.renamed(root)
    tags = {x.get("name", ""): x for x in root.findall("joint")}
    whole, notes = _model(root, path)
    named, why = _moving(whole, tags, joints, tip)
    moving = _parents_first(whole, named)
    model, locked = _locked(whole, tags, moving)
    names = [whole.names[i] for i in moving]
    parents = _parents(model, names)
    if dofs is not None and not (isinstance(dofs, int) and 1 <= dofs <= len(names)):
        raise RobotError(f"robot.dofs={dofs!r}; allowed: 1 to {len(names)}, the number of moving joints")
    names, dropped = names[:dofs], names[dofs:] if dofs else []
    bodies = [model.getJointId(x) for x in names]
    used = [tags[x] for x in names]

    inertial = np.array([model.inertias[i].toDynamicParameters() for i in bodies])
    if not inertial[:, 0].sum() > 0:
        raise RobotError(f"the moving links of {path} have no mass", advice="a URDF whose links have <inertial> tags")
    if payload is not None:
        inertial[-1] += _payload(payload)
    limits = np.array([urdf.limits(x) for x in used])
    notes += urdf_checks.doubts(root)
    dynamics = np.array([urdf.dynamics_of(x) for x in used])
    if locked:
        notes.append(f"locked ({why}): {', '.join(locked)}")
    if dropped:
        notes.append(f"keeping the first {dofs} joint{'s' * (dofs != 1)}; dropped: {', '.join(dropped)}")
    if dynamics_tags == "ignore" and dynamics.any():
        notes.append("ignored: <dynamics> damping and friction")
        dynamics[:] = 0.0
    robot = Robot(
        name=shortened(root.get("name") or Path(str(path)).stem, urdf_checks.LONGEST_NAME),
        joints=tuple(names),
        parents=tuple(parents[:dofs]),
        prismatic=tuple(x.get("type") == "prismatic" for x in used),
        rotation=np.array([model.jointPlacements[i].rotation for i in bodies]),
        translation=np.array([model.jointPlacements[i].translation for i in bodies]),
        axis=np.array([urdf.axis(x) for x in used]),
        inertial=inertial,
        gravity=_gravity(gravity, base_rpy),
        lower=limits[:, 0],
        upper=limits[:, 1],
        velocity_limit=limits[:, 2],
        effort_limit=limits[:, 3],
        damping=dynamics[:, 0],
        friction=dynamics[:, 1],
        urdf=urdf.without(text, dropped),
        notes=tuple(notes),
        columns=() if moving == named or dropped else tuple(whole.names[i] for i in named),
    )
    return replace(robot, notes=(*robot.notes, *urdf_checks.inertialess(_inertias(robot, path))))


def _inertias(robot: Robot, path: str | Path | None) -> dict[str, float]:
    """For each joint, the inertia of everything that it moves at zero angles, about its axis [kg m^2; kg].

    Raises:
        RobotError: if a number of the robot is not finite.
    """
    arrays = (robot.rotation, robot.translation, robot.axis, robot.inertial, robot.gravity, robot.damping)
    model = pinocchio_model(replace(robot, gravity=np.zeros(3)))
    data, still = model.createData(), np.zeros(robot.dofs)
    mass = np.array([pin.rnea(model, data, still, still, unit)[i] for i, unit in enumerate(np.eye(robot.dofs))])
    if not all(np.isfinite(x).all() for x in (*arrays, mass)):
        raise RobotError(f"{path} gives numbers that are not finite", advice="finite origins, axes and inertials")
    return dict(zip(robot.joints, mass.tolist(), strict=True))


def pinocchio_model(robot: Robot) -> pin.Model:
    """Pinocchio's model of the robot, made from its arrays alone: the reference for rigid-body dynamics.

    nq = nv = n, joints in the robot's order. Pinocchio's `rnea` holds for any order; its `crba` wants the joints of a
    branch to follow each other. Damping and friction are not in it.
    """
    model = pin.Model()
    model.name = robot.name
    model.gravity.linear = np.asarray(robot.gravity)
    for i, name in enumerate(robot.joints):
        kind = pin.JointModelPrismaticUnaligned if robot.prismatic[i] else pin.JointModelRevoluteUnaligned
        placement = pin.SE3(np.asarray(robot.rotation[i]), np.asarray(robot.translation[i]))
        bounds = [np.atleast_1d(x[i]) for x in (robot.effort_limit, robot.velocity_limit, robot.lower, robot.upper)]
        joint = model.addJoint(robot.parents[i] + 1, kind(np.asarray(robot.axis[i])), placement, name, *bounds)
        model.addJointFrame(joint)  # buildReducedModel of pin 4.1 fails without
        model.appendBodyToJoint(joint, _inertia(np.asarray(robot.inertial[i])), pin.SE3.Identity())
    return model


def _inertia(parameters: np.ndarray) -> pin.Inertia:
    """Ten parameters as Pinocchio's inertia; its own conversion divides by the mass, which may be zero."""
    if parameters[0] > 0:
        return pin.Inertia.FromDynamicParameters(parameters)
    xx, xy, yy, xz, yz, zz = parameters[4:]
    return pin.Inertia(0.0, np.zeros(3), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))


def _model(root: ET.Element, path: str | Path | None) -> tuple[pin.Model, list[str]]:
    """Pinocchio's model of all joints, and what its URDF parser complained about."""
    said: list[str] = []
    try:
        with urdf.overheard(said):
            model = pin.buildModelFromXML(ET.tostring(root, encoding="unicode"))
    except (ValueError, RuntimeError) as error:
        reason = (said[0] if said else str(error)).rstrip(".")
        raise RobotError(
            f"{path} is not a valid URDF: {reason}", advice="check_urdf on this file, or a new export"
        ) from error
    if model.njoints == 1:
        raise RobotError(f"{path} has no moving joint; allowed types: {listed(MOVING)}", advice="the URDF of an arm")
    return model, [f"urdfdom: {x}" for x in said]


def _moving(
    model: pin.Model, tags: Mapping[str, ET.Element], joints: Sequence[str] | None, tip: str | None
) -> tuple[list[int], str]:
    """The joints that move, in the order of columns, and why the others are locked."""
    if joints is not None and tip is not None:
        raise RobotError("both robot.joints and robot.tip are given; allowed: one of them")
    if joints is not None:
        moving, why = _named(model, joints), "not in robot.joints"
    elif tip is not None:
        moving, why = _up_to(model, tip), f"not between the base and {tip}"
    else:
        urdf.refuse_types([tags[x] for x in model.names[1:]], MOVING)
        moving, why = _arm(model, tags), "like a gripper's: mimic tag, name or short branch; robot.joints=[…] overrides"
    urdf.refuse_types([tags[model.names[i]] for i in moving], MOVING)
    return moving, why


def _named(model: pin.Model, joints: Sequence[str]) -> list[int]:
    """The joints of these names."""
    allowed = list(model.names[1:])
    if not isinstance(joints, str | Sequence):
        raise RobotError(f"robot.joints={joints!r}; allowed: names of {listed(allowed)}")
    joints = [joints] if isinstance(joints, str) else list(joints)
    if not joints or len(set(joints)) < len(joints):
        raise RobotError(f"robot.joints is empty or names a joint twice: {listed(joints)}; allowed: {listed(allowed)}")
    for name in joints:
        if name not in allowed:
            raise RobotError(
                f"no moving joint {name!r}{closest(name, allowed)}; allowed: {listed(allowed)}",
                advice=f"robot.joints=[{','.join(allowed[: len(joints)])}], in any order",
            )
    return [model.getJointId(x) for x in joints]


def _up_to(model: pin.Model, tip: str) -> list[int]:
    """The joints from the base to a link or joint."""
    last = next((x.parentJoint for x in model.frames if x.name == tip), None)
    if last is None:
        links = [x.name for x in model.frames if x.type == pin.FrameType.BODY]
        raise RobotError(f"robot.tip={tip!r} is not a link or joint{closest(str(tip), links)}; links: {listed(links)}")
    if last == 0:
        raise RobotError(f"no moving joint between the base and robot.tip={tip}", advice="a link farther out")
    return list(model.supports[last])[1:]


def _arm(model: pin.Model, tags: Mapping[str, ET.Element]) -> list[int]:
    """The moving joints without grippers, if they are one chain."""
    every = set(range(1, model.njoints))
    mimics = {i: tags[model.names[i]].find("mimic") for i in every}
    mimics = {i: model.getJointId(x.get("joint", "")) for i, x in mimics.items() if x is not None}
    free = every - set(mimics)
    followed = free & set(mimics.values())
    free -= {i for i in followed if not free & set(model.subtrees[i]) - followed}  # those that carry an arm stay
    free -= {i for i in free if GRIPPER.search(model.names[i])}
    for i in sorted(free, key=lambda i: len(model.supports[i]), reverse=True):
        fingers = [free & set(model.subtrees[j]) for j in _children(model, free, i)]
        longest = max(map(len, fingers), default=0)
        if len(fingers) > 1 and longest <= FINGER_JOINTS and longest < len(free & set(model.supports[i])):
            free = free.difference(*fingers)
    if not free:
        raise RobotError(
            "no joint of an arm was found: all moving joints look like those of a gripper",
            advice=f"robot.joints=[…] with names of {listed(model.names[1:])}",
        )
    if any(len(_children(model, free, i)) > 1 for i in {0} | free):
        tips = [model.names[i] for i in sorted(free) if not _children(model, free, i)]
        raise RobotError(
            f"the robot branches into {len(tips)} arms; allowed: one", advice=f"robot.tip=NAME, one of {listed(tips)}"
        )
    return sorted(free)


def _children(model: pin.Model, free: set[int], joint: int) -> list[int]:
    """The free joints that follow next after a joint (0: the base)."""
    return [i for i in free if max(free & set(model.supports[i]) - {i}, default=0) == joint]


def _locked(model: pin.Model, tags: Mapping[str, ET.Element], moving: list[int]) -> tuple[pin.Model, list[str]]:
    """The model with all other joints locked, and sentences that say where they are locked."""
    ids = [i for i in range(1, model.njoints) if i not in moving]
    q, words = pin.neutral(model), []
    for i in ids:
        lower, upper, *_ = urdf.limits(tags[model.names[i]])
        at = min(max(0.0, lower), upper)
        words.append(f"{model.names[i]} at {at:g}")
        if at != 0:  # continuous, floating and planar joints have no limits: neutral is their zero
            q[model.joints[i].idx_q] = at
    return pin.buildReducedModel(model, ids, q), words


def _parents_first(model: pin.Model, moving: list[int]) -> list[int]:
    """The joints as they are if parents stand before children, otherwise from the base on."""
    place = {i: k for k, i in enumerate(moving)}
    if all(place.get(above, -1) <= place[i] for i in moving for above in model.supports[i]):
        return moving
    return sorted(moving, key=lambda i: len(model.supports[i]))


def _parents(model: pin.Model, names: list[str]) -> list[int]:
    """Column of each joint's parent, -1 for the base."""
    ids = [model.getJointId(x) for x in names]
    return [ids.index(model.parents[i]) if model.parents[i] else -1 for i in ids]


def _gravity(gravity: Sequence[float] | None, base_rpy: Sequence[float] | None) -> np.ndarray:
    """(3,) [m/s^2] in the base frame."""
    if gravity is not None and base_rpy is not None:
        raise RobotError("both robot.gravity and robot.base_rpy are given; allowed: one of them")
    if base_rpy is not None:
        return pin.rpy.rpyToMatrix(urdf.finite(base_rpy, "robot.base_rpy", (3,))).T @ np.array(DOWN)
    return np.array(DOWN) if gravity is None else urdf.finite(gravity, "robot.gravity", (3,))


def _payload(payload: Mapping[str, Any]) -> np.ndarray:
    """(10,) inertial parameters of a declared body about the joint frame's origin."""
    if not isinstance(payload, Mapping) or not {"mass", "com"} <= set(payload) <= {"mass", "com", "inertia"}:
        raise RobotError(f"robot.payload={payload!r}; allowed: mass and com; also inertia, unless it is a point mass")
    mass = float(urdf.finite(payload["mass"], "robot.payload.mass", ()))
    com = urdf.finite(payload["com"], "robot.payload.com", (3,))
    inertia = np.zeros((3, 3))
    if payload.get("inertia") is not None:
        inertia = urdf.finite(payload["inertia"], "robot.payload.inertia", (3, 3), (6,))
    if inertia.shape == (6,):
        inertia = inertia[[[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
    if mass < 0 or not np.array_equal(inertia, inertia.T) or np.linalg.eigvalsh(inertia)[0] < 0:
        raise RobotError(
            f"robot.payload={payload!r}; allowed: mass and moments of inertia >= 0, and a symmetric inertia"
        )
    return pin.Inertia(mass, com, inertia).toDynamicParameters()
