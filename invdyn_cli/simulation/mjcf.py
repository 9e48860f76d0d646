"""A robot with effects as an MJCF file that plain MuJoCo loads, and a sentence for everything that the format cannot
contain.

There is a motor for every joint, with its name, in the robot's order: `data.ctrl` takes what the log calls torque, and
`data.qpos` gives what it calls position. In the order of `drive`, ctrl is delayed (delay), low-pass filtered
(filterexact), multiplied (gain), limited (forcerange) and reduced by the offset (bias).

The text is written here and not by `MjSpec.to_xml`, which keeps six digits: a mass matrix would be off by 1e-6.
"""
# pyright: reportAttributeAccessIssue=false

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from invdyn_cli.errors import UsageError, listed
from invdyn_cli.joints import JOINT_TERMS, SimulatorTerms
from invdyn_cli.maths.pseudo_inertia import realisable
from invdyn_cli.simulation.arm import GEAR, build, mass_matrix, quaternion_of
from invdyn_cli.simulation.references import room
from invdyn_cli.types import Robot
from invdyn_cli.urdf import moving_links

TIMESTEP = 5e-4
"""[s] of the file."""

FINEST = 2.5e-4
"""[s] Smallest time step for which the memory of a late motor is long enough."""

STICK = {"solreffriction": (2 * TIMESTEP, 1), "solimpfriction": (0.9999, 0.9999, 0.001, 0.5, 2)}
"""Friction as stiff as the solver goes: a joint that sticks creeps at 1e-6 rad/s."""

STOP = {"solreflimit": (4 * TIMESTEP, 1), "solimplimit": (0.99, 0.999, 0.0001, 0.5, 2)}
"""Teeth in contact yield by a ten-thousandth of a radian."""

ROTOR = 0.03
"""[-] Rotor inertia of a compliant gear if it is unknown, as a share of what the joint carries."""

RINGING = 0.02
"""[-] Damping ratio of a link on its gear's spring if it is unknown: steel and grease."""


@dataclass(frozen=True)
class Part:
    """What an effect puts into the file: where (None: the whole arm), how a sentence calls it, and its terms."""

    joint: str | None
    title: str
    terms: SimulatorTerms


@dataclass
class _Numbers:
    """What is written: `joint` has (n,) of every term of joints, with the encoder's offset not yet in the others;
    `said` are the sentences."""

    robot: Robot
    inertial: np.ndarray
    joint: dict[str, np.ndarray]
    carried: np.ndarray
    loads: list[np.ndarray] = field(default_factory=list)
    drives: list[tuple[int, int, Mapping[str, float]]] = field(default_factory=list)
    said: list[str] = field(default_factory=list)

    def of(self, i: int) -> dict[str, float]:
        """The terms of one joint."""
        return {name: float(row[i]) for name, row in self.joint.items()}


def written(robot: Robot, parts: Sequence[Part] = ()) -> tuple[str, tuple[str, ...]]:
    """The MJCF text of a robot with effects, and what of them it does not hold, or holds only nearly.

    Args:
        robot: the arm with its inertials and gravity as they are to be; its `damping` and `friction` are written too.
        parts: everything else, several on one joint add up.

    Raises:
        UsageError: for a joint that the robot does not have.
    """
    joint = {name: np.zeros(robot.dofs) for name in JOINT_TERMS}
    joint |= {"damping": np.array(robot.damping, float), "friction": np.array(robot.friction, float)}
    joint |= {"gain": np.ones(robot.dofs), "limit": np.full(robot.dofs, np.inf)}
    made = _Numbers(robot, np.array(robot.inertial, float), joint, np.zeros(robot.dofs))
    for part in parts:
        if part.joint is not None and part.joint not in robot.joints:
            raise UsageError(f"{part.title} is on the unknown joint {part.joint!r}; allowed: {listed(robot.joints)}")
        _put(made, part, 0 if part.joint is None else robot.joints.index(part.joint))
    _make_consistent(made)
    return _text(made), tuple(made.said)


def _put(made: _Numbers, part: Part, i: int) -> None:
    """Add an effect to the numbers, and a sentence for what the file cannot contain of it, in place."""
    terms, lost = part.terms, [part.terms.lost]
    if terms.joint.get("lag") and made.joint["lag"][i]:
        lost.append("is combined with another one in series into one lag with the sum of their time constants")
    for name, value in terms.joint.items():
        row = made.joint[name]
        row[i] = row[i] * value if name == "gain" else min(row[i], value) if name == "limit" else row[i] + value
    if terms.drive:
        made.drives.append((i, made.robot.parents[i], terms.drive))
    if terms.body is not None:
        made.loads.append(np.asarray(terms.body, float))
    made.said += [f"{part.joint or 'whole arm'}: {part.title} {x}" for x in lost if x]


def _make_consistent(made: _Numbers) -> None:
    """Make bodies physically consistent, add rotors to compliant gears and missing inertia to joints; in place, with a
    sentence each."""
    made.inertial[-1] += sum((x for x in made.loads if not _solid(x)), np.zeros(10))
    made.loads = [x for x in made.loads if _solid(x)]
    for i, name in enumerate(_links(made.robot)):
        row = realisable(made.inertial[i])
        if not np.allclose(row, made.inertial[i], rtol=1e-9, atol=0):
            row[[4, 6, 9]] += 1e-9 * row[4:].max()  # the compiler refuses what lies on the edge
            made.said.append(
                f"{name}: its inertials are not physically consistent; the nearest consistent ones are written"
            )
            made.inertial[i] = row
    arm = build(made.robot, inertial=made.inertial, armature=made.joint["armature"])
    made.said += arm.notes
    armature = made.joint["armature"] = arm.model.dof_armature.copy()
    yields = (made.joint["gap"] > 0) | (made.joint["compliance"] > 0)
    if not yields.any():
        return
    made.carried = np.diag(mass_matrix(arm.model, mujoco.MjData(arm.model), room(made.robot)[0])) - armature
    for i in np.flatnonzero(yields & (armature == 0)):
        armature[i] = ROTOR * made.carried[i]
        made.said.append(
            f"{made.robot.joints[i]}: its rotor's inertia is not known; {armature[i]:.2g} kg m^2 is written, "
            f"{ROTOR:.0%} of what the joint carries"
        )


def _solid(load: np.ndarray) -> bool:
    """Whether a payload can be a body of its own; a point or a hole is a part of the last link."""
    return np.array_equal(realisable(load), load)


def _text(made: _Numbers) -> str:
    """The file."""
    robot = made.robot
    root = ET.Element("mujoco", model=robot.name)
    _tag(root, "compiler", angle="radian", autolimits="true")
    _tag(root, "option", timestep=TIMESTEP, gravity=robot.gravity, integrator="implicitfast")
    bodies: list[ET.Element] = []
    world = ET.SubElement(root, "worldbody")
    for i, name in enumerate(_links(robot)):
        parent = world if robot.parents[i] < 0 else bodies[robot.parents[i]]
        quaternion = quaternion_of(np.asarray(robot.rotation[i]))
        body = _tag(parent, "body", name=name, pos=robot.translation[i], quat=quaternion)
        _inertial(body, made.inertial[i])
        for joint in _joints(made, i):
            _tag(body, "joint", **joint)
        bodies.append(body)
    for i, load in enumerate(made.loads):
        _inertial(_tag(bodies[-1], "body", name=f"payload_{i + 1}" if i else "payload"), load)
    _tendons(root, made)
    motors = ET.SubElement(root, "actuator")
    for i in range(robot.dofs):
        _tag(motors, "general", **_motor(made, i))
    for line in made.said:
        root.insert(0, ET.Comment(f" {line.replace('--', '-')} "))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _tendons(root: ET.Element, made: _Numbers) -> None:
    """A fixed tendon over both joints of every drive that turns with two, with its friction, damping and inertia."""
    if not made.drives:
        return
    tendons = ET.SubElement(root, "tendon")
    for i, driver, p in made.drives:
        names = made.robot.joints[i], made.robot.joints[driver]
        given = {"frictionloss": p["coulomb"], "damping": p["damping"], "armature": p.get("armature", 0.0)}
        given = {k: v for k, v in given.items() if v} | (STICK if p["coulomb"] else {})
        drive = _tag(tendons, "fixed", name=f"{names[0]}_drive", **given)
        for name, factor in zip(names, (1.0, p["ratio"]), strict=True):
            _tag(drive, "joint", joint=name, coef=factor)


def _joints(made: _Numbers, i: int) -> Iterable[dict[str, Any]]:
    """The joint, and behind it a second one about the same axis where the gear yields."""
    robot, name, p = made.robot, made.robot.joints[i], made.of(i)
    place: dict[str, Any] = {"type": "slide" if robot.prismatic[i] else "hinge", "axis": robot.axis[i]}
    joint: dict[str, Any] = {"name": name, **place}
    if p["encoder"]:
        joint["ref"] = p["encoder"]  # the angle at which the bodies stand as they are written
    lower, upper = float(robot.lower[i]), float(robot.upper[i])
    if math.isfinite(lower) and math.isfinite(upper):
        joint["range"] = np.array([lower, upper]) + p["encoder"]
    if p["damping"] or p["drag"]:
        joint["damping"] = [p["damping"], p["drag"]] if p["drag"] else p["damping"]
    if p["friction"]:
        joint |= {"frictionloss": p["friction"], **STICK}
    if p["armature"]:
        joint["armature"] = p["armature"]
    if p["stiffness"]:
        rest = p["pull"] / p["stiffness"] + p["encoder"]
        joint |= {"stiffness": p["stiffness"], "springref": rest}
    yield joint
    if p["gap"]:
        yield {"name": name + GEAR, **place, "range": [-p["gap"] / 2, p["gap"] / 2], **STOP}
    if p["compliance"]:
        damping = p["gear_damping"] or 2 * RINGING * math.sqrt(made.carried[i] / p["compliance"])
        second = name + (GEAR + "_spring" if p["gap"] else GEAR)
        yield {"name": second, **place, "stiffness": 1 / p["compliance"], "damping": damping}


def _motor(made: _Numbers, i: int) -> dict[str, Any]:
    """From ctrl to torque, in the order of `drive`."""
    name, p = made.robot.joints[i], made.of(i)
    offset = p["offset"]
    motor: dict[str, Any] = {"name": name, "joint": name, "gainprm": p["gain"]}
    if offset:
        motor |= {"biastype": "affine", "biasprm": -offset}
    if p["lag"]:
        motor |= {"dyntype": "filterexact", "dynprm": p["lag"]}
    if p["delay"]:
        memory = math.ceil(p["delay"] / FINEST) + 2
        motor |= {"delay": p["delay"], "nsample": str(memory), "interp": "linear"}
    if np.isfinite(p["limit"]):  # the offset comes behind the limit in `drive`, before it in MuJoCo
        motor["forcerange"] = [-p["limit"] - offset, p["limit"] - offset]
    return motor


def _inertial(body: ET.Element, row: np.ndarray) -> None:
    """The <inertial> tag of ten parameters."""
    x, y, z = com = row[1:4] / row[0]
    point = row[0] * np.array([y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y])
    xx, xy, yy, xz, yz, zz = row[4:] - point
    _tag(body, "inertial", pos=com, mass=row[0], fullinertia=[xx, yy, zz, xy, xz, yz])


def _links(robot: Robot) -> list[str]:
    """The URDF's names of the links that move with the joints; link_0, … without a URDF."""
    names = moving_links(robot.urdf, robot.joints) if robot.urdf else [""] * robot.dofs
    return [name or f"link_{i}" for i, name in enumerate(names)]


def _tag(parent: ET.Element, kind: str, **given: Any) -> ET.Element:
    """A new tag with these attributes: texts, and numbers with all their digits."""
    return ET.SubElement(parent, kind, {k: x if isinstance(x, str) else _said(x) for k, x in given.items()})


def _said(numbers: Any) -> str:
    return " ".join(repr(float(x)) for x in np.atleast_1d(np.asarray(numbers, float)))
