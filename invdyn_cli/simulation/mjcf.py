"""A robot with effects as an MJCF file that plain MuJoCo loads, and a sentence for everything that the format lacks.

There is a motor for every joint, called like it, in the robot's order: `data.ctrl` takes what the log calls torque, and
`data.qpos` gives what it calls position. In the order of `drive`: ctrl comes late (delay), slow (filterexact), is
multiplied (gain), limited (forcerange) and less by the offset (bias).

The text is written here and not by `MjSpec.to_xml`, which keeps six digits: a mass matrix would be off by 1e-6.
"""
# pyright: reportAttributeAccessIssue=false

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from invdyn_cli.errors import UsageError, listed
from invdyn_cli.maths.pseudo_inertia import realisable
from invdyn_cli.simulation.arm import build, mass_matrix
from invdyn_cli.simulation.hidden import Hidden
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
"""Teeth that meet give way by a ten-thousandth of a radian."""

GEAR = "_gear"
"""What is behind the name of a joint's second, unmotored joint: gear play, or a spring between motor and link."""

ROTOR = 0.03
"""[-] Rotor inertia that is written where a gear yields and none is known, of what the joint carries."""

RINGING = 0.02
"""[-] Damping ratio of a link on its gear's spring, where nothing is known of it: steel and grease."""

RADIUS = 0.02
"""[m] of a payload of which no inertia is said: a sphere, as `hidden` makes it."""

POINT = np.zeros(6)


@dataclass
class _Numbers:
    """What is written, (n,) per joint, with the encoder's offset not yet in it; `said` are the sentences."""

    robot: Robot
    inertial: np.ndarray
    gravity: np.ndarray
    damping: np.ndarray
    drag: np.ndarray
    friction: np.ndarray
    armature: np.ndarray
    stiffness: np.ndarray
    pull: np.ndarray
    offset: np.ndarray
    encoder: np.ndarray
    delay: np.ndarray
    lag: np.ndarray
    gain: np.ndarray
    limit: np.ndarray
    gap: np.ndarray
    gear: np.ndarray
    ringing: np.ndarray
    carried: np.ndarray
    loads: list[np.ndarray] = field(default_factory=list)
    couplings: list[tuple[int, int, Any]] = field(default_factory=list)
    said: list[str] = field(default_factory=list)


def written(robot: Robot, effects: Sequence[Hidden] = ()) -> tuple[str, tuple[str, ...]]:
    """The MJCF text of a robot with effects, and what of them it does not hold, or holds only nearly.

    Args:
        robot: the nominal robot; its `damping` and `friction` are written too.
        effects: names and parameters as in docs/effects.md. `link_inertia_error` may say its change as "mass",
            "moment" (3,) and "inertia" (6,) about the joint frame's origin, `payload` an "inertia" (6,) about its
            centre of mass (xx xy yy xz yz zz).

    Raises:
        UsageError: for a joint that the robot does not have.
    """
    none = np.zeros((11, robot.dofs))
    made = _Numbers(
        robot=robot,
        inertial=np.array(robot.inertial, float),
        gravity=np.array(robot.gravity, float),
        damping=np.array(robot.damping, float),
        friction=np.array(robot.friction, float),
        drag=none[0],
        armature=none[1],
        stiffness=none[2],
        pull=none[3],
        offset=none[4],
        encoder=none[5],
        delay=none[6],
        lag=none[7],
        gap=none[8],
        ringing=none[9],
        carried=none[10],
        gain=np.ones(robot.dofs),
        limit=np.full(robot.dofs, np.inf),
        gear=np.full(robot.dofs, np.inf),
    )
    for one in effects:
        if one.joint is not None and one.joint not in robot.joints:
            raise UsageError(f"{one.effect} is on no joint {one.joint!r}; allowed: {listed(robot.joints)}")
        said = _put(made, one, 0 if one.joint is None else robot.joints.index(one.joint))
        if said:
            made.said.append(f"{one.joint or 'whole arm'}: {said}")
    _mend(made)
    return _text(made), tuple(made.said)


def _put(made: _Numbers, one: Hidden, i: int) -> str:
    """Put an effect into the numbers, in place; what is not held of it, "" if it is held."""
    p = one.parameters
    match one.effect:
        case "viscous_friction":
            made.damping[i] += p["damping"]
        case "quadratic_friction":
            made.drag[i] += p["drag"]
        case "coulomb_friction":
            made.friction[i] += p["coulomb"]
        case "asymmetric_coulomb_friction":  # within [-negative, positive] nothing moves: a shifted symmetric friction
            made.friction[i] += (p["positive"] + p["negative"]) / 2
            made.offset[i] += (p["positive"] - p["negative"]) / 2
        case "stribeck_friction":
            made.friction[i] += p["coulomb"]
            return f"Stribeck friction is held by its level at speed, {p['coulomb']:.3g}: MJCF has no static level"
        case "presliding_hysteresis":
            made.friction[i] += p["coulomb"]
            return f"hysteresis is held as dry friction of {p['coulomb']:.3g}: MJCF's friction has no memory"
        case "thermal_friction_drift":
            made.damping[i] += p["warm"]
            return f"friction that warms up is held warm, {p['warm']:.3g}: MJCF has no temperature"
        case "load_dependent_friction":
            return "friction that grows with the load is left out: MJCF's friction is constant"
        case "torque_ripple":
            return "torque ripple is left out: MJCF has no torque that is periodic in an angle"
        case "joint_spring":
            made.stiffness[i] += p["stiffness"]
            made.pull[i] += p["stiffness"] * p["rest"]
        case "rotor_inertia":
            made.armature[i] += p["armature"]
        case "coupled_friction":
            made.couplings.append((i, made.robot.parents[i], p))
        case "torque_offset":
            made.offset[i] += p["offset"]
        case "torque_gain_error":
            made.gain[i] *= p["gain"]
        case "torque_delay":
            made.delay[i] += p["delay"]
        case "actuator_lag":
            if made.lag[i]:
                made.lag[i] += p["time_constant"]
                return "two lags in series are held as one of their time constants' sum"
            made.lag[i] = p["time_constant"]
        case "torque_saturation":
            made.limit[i] = min(made.limit[i], float(p["limit"]))
        case "payload":
            made.loads.append(_body_of(p))
        case "link_inertia_error":
            made.inertial[i] += _change_of(made.inertial[i], p)
        case "base_tilt":
            sine, cosine = math.sin(p["angle"]), math.cos(p["angle"])
            down = np.array([sine * math.cos(p["azimuth"]), sine * math.sin(p["azimuth"]), -cosine])
            made.gravity = np.linalg.norm(np.asarray(made.robot.gravity)) * down
        case "encoder_offset":
            made.encoder[i] += p["offset"]
        case "backlash":
            made.gap[i] += p["gap"]
            made.armature[i] += p.get("rotor", 0.0)
        case "joint_elasticity":
            made.gear[i] = 1 / (1 / made.gear[i] + 1 / p["stiffness"])
            made.armature[i] += p.get("rotor", 0.0)
            made.ringing[i] += p.get("damping", 0.0)
        case "torque_offset_drift" | "torque_gain_change" | "payload_change" | "external_contact":
            return f"{one.effect.replace('_', ' ')} is left out: an MJCF does not change with time"
        case _:
            return f"{one.effect.replace('_', ' ')} is left out: it has no place in an MJCF"
    return ""


def _body_of(p) -> np.ndarray:
    """(10,) of a payload about the frame's origin."""
    x, y, z = com = np.asarray(p["com"], float)
    about = p["mass"] * np.array([y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y])
    sphere = 0.4 * p["mass"] * p.get("radius", RADIUS) ** 2 * np.array([1, 0, 1, 0, 0, 1.0])
    own = np.asarray(p.get("inertia", sphere), float)
    return np.concatenate([[p["mass"]], p["mass"] * com, about + own])


def _change_of(row: np.ndarray, p) -> np.ndarray:
    """(10,) that a link_inertia_error adds to a link's row."""
    if "moment" in p or np.ndim(p.get("inertia", 0.0)):
        parts = (p.get("mass", 0.0), p.get("moment", np.zeros(3)), p.get("inertia", np.zeros(6)))
        return np.concatenate([np.atleast_1d(np.asarray(x, float)) for x in parts])
    mass, inertia = float(p.get("mass", 0.0)), float(p.get("inertia", 0.0))
    before = row[1:4] / row[0] if row[0] else np.zeros(3)
    own = row - _body_of({"mass": row[0], "com": before, "inertia": POINT})
    after = before + np.asarray(p.get("com", np.zeros(3)), float)
    return _body_of({"mass": row[0] + mass, "com": after, "inertia": (1 + inertia) * own[4:]}) - row


def _mend(made: _Numbers) -> None:
    """Bodies that can be, rotors where a gear yields, and inertia that joints lack; in place, with a sentence each."""
    made.inertial[-1] += sum((x for x in made.loads if not _solid(x)), np.zeros(10))
    made.loads = [x for x in made.loads if _solid(x)]
    for i, name in enumerate(_links(made.robot)):
        row = realisable(made.inertial[i])
        if not np.allclose(row, made.inertial[i], rtol=1e-9, atol=0):
            row[[4, 6, 9]] += 1e-9 * row[4:].max()  # the compiler refuses what lies on the edge
            made.said.append(f"{name}: its inertials are not of a real body; the nearest ones of one are written")
            made.inertial[i] = row
    arm = build(made.robot, inertial=made.inertial, armature=made.armature)
    made.said += arm.notes
    made.armature = arm.model.dof_armature.copy()
    yields = (made.gap > 0) | np.isfinite(made.gear)
    if not yields.any():
        return
    made.carried = np.diag(mass_matrix(arm.model, mujoco.MjData(arm.model), room(made.robot)[0])) - made.armature
    for i in np.flatnonzero(yields & (made.armature == 0)):
        made.armature[i] = ROTOR * made.carried[i]
        made.said.append(
            f"{made.robot.joints[i]}: its rotor's inertia is not known; {made.armature[i]:.2g} kg m^2 is written, "
            f"{ROTOR:.0%} of what the joint carries"
        )


def _solid(load: np.ndarray) -> bool:
    """Whether a payload can be a body of its own; a point or a hole is a part of the last link."""
    return np.array_equal(realisable(load), load)


def _text(made: _Numbers) -> str:
    """The file."""
    robot = made.robot
    root = ET.Element("mujoco", model=robot.name)
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    option = {"timestep": TIMESTEP, "gravity": made.gravity}
    ET.SubElement(root, "option", {k: _said(v) for k, v in option.items()}, integrator="implicitfast")
    bodies: list[ET.Element] = []
    world = ET.SubElement(root, "worldbody")
    for i, name in enumerate(_links(robot)):
        parent = world if robot.parents[i] < 0 else bodies[robot.parents[i]]
        frame = {"pos": robot.translation[i], "quat": _quaternion(np.asarray(robot.rotation[i]))}
        body = ET.SubElement(parent, "body", {"name": name, **{k: _said(v) for k, v in frame.items()}})
        _inertial(body, made.inertial[i])
        for joint in _joints(made, i):
            ET.SubElement(body, "joint", {k: x if isinstance(x, str) else _said(x) for k, x in joint.items()})
        bodies.append(body)
    for i, load in enumerate(made.loads):
        _inertial(ET.SubElement(bodies[-1], "body", name=f"payload_{i + 1}" if i else "payload"), load)
    _tendons(root, made)
    motors = ET.SubElement(root, "actuator")
    for i in range(robot.dofs):
        motor = _motor(made, i)
        ET.SubElement(motors, "general", {k: x if isinstance(x, str) else _said(x) for k, x in motor.items()})
    for line in made.said:
        root.insert(0, ET.Comment(f" {line.replace('--', '-')} "))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _tendons(root: ET.Element, made: _Numbers) -> None:
    """A fixed tendon over both joints of every drive that turns with two, with its friction, damping and inertia."""
    if not made.couplings:
        return
    tendons = ET.SubElement(root, "tendon")
    for i, driver, p in made.couplings:
        names = made.robot.joints[i], made.robot.joints[driver]
        given = {"frictionloss": p["coulomb"], "damping": p["damping"], "armature": p.get("armature", 0.0)}
        stick = STICK if p["coulomb"] else {}
        numbers = {k: _said(v) for k, v in {**given, **stick}.items() if np.any(v)}
        drive = ET.SubElement(tendons, "fixed", {"name": f"{names[0]}_drive", **numbers})
        for name, factor in zip(names, (1.0, p["ratio"]), strict=True):
            ET.SubElement(drive, "joint", joint=name, coef=_said(factor))


def _joints(made: _Numbers, i: int) -> Iterable[dict[str, Any]]:
    """The joint, and behind it a second one about the same axis where the gear yields."""
    robot, name = made.robot, made.robot.joints[i]
    place: dict[str, Any] = {"type": "slide" if robot.prismatic[i] else "hinge", "axis": robot.axis[i]}
    joint: dict[str, Any] = {"name": name, **place}
    if made.encoder[i]:
        joint["ref"] = made.encoder[i]  # the angle at which the bodies stand as they are written
    lower, upper = float(robot.lower[i]), float(robot.upper[i])
    if math.isfinite(lower) and math.isfinite(upper):
        joint["range"] = np.array([lower, upper]) + made.encoder[i]
    if made.damping[i] or made.drag[i]:
        joint["damping"] = [made.damping[i], made.drag[i]] if made.drag[i] else made.damping[i]
    if made.friction[i]:
        joint |= {"frictionloss": made.friction[i], **STICK}
    if made.armature[i]:
        joint["armature"] = made.armature[i]
    if made.stiffness[i]:
        rest = made.pull[i] / made.stiffness[i] + made.encoder[i]
        joint |= {"stiffness": made.stiffness[i], "springref": rest}
    yield joint
    if made.gap[i]:
        yield {"name": name + GEAR, **place, "range": [-made.gap[i] / 2, made.gap[i] / 2], **STOP}
    if np.isfinite(made.gear[i]):
        damping = made.ringing[i] or 2 * RINGING * math.sqrt(made.gear[i] * made.carried[i])
        second = name + (GEAR + "_spring" if made.gap[i] else GEAR)
        yield {"name": second, **place, "stiffness": made.gear[i], "damping": damping}


def _motor(made: _Numbers, i: int) -> dict[str, Any]:
    """From ctrl to torque, in the order of `drive`."""
    name, offset = made.robot.joints[i], made.offset[i]
    motor: dict[str, Any] = {"name": name, "joint": name, "gainprm": made.gain[i]}
    if offset:
        motor |= {"biastype": "affine", "biasprm": -offset}
    if made.lag[i]:
        motor |= {"dyntype": "filterexact", "dynprm": made.lag[i]}
    if made.delay[i]:
        memory = math.ceil(made.delay[i] / FINEST) + 2
        motor |= {"delay": made.delay[i], "nsample": str(memory), "interp": "linear"}
    if np.isfinite(made.limit[i]):  # the offset comes behind the limit in `drive`, before it in MuJoCo
        motor["forcerange"] = [-made.limit[i] - offset, made.limit[i] - offset]
    return motor


def _inertial(body: ET.Element, row: np.ndarray) -> None:
    """The <inertial> tag of ten parameters."""
    com = row[1:4] / row[0]
    xx, xy, yy, xz, yz, zz = row[4:] - _body_of({"mass": row[0], "com": com, "inertia": POINT})[4:]
    given = {"pos": com, "mass": row[0], "fullinertia": [xx, yy, zz, xy, xz, yz]}
    ET.SubElement(body, "inertial", {k: _said(v) for k, v in given.items()})


def _links(robot: Robot) -> list[str]:
    """The URDF's names of the links that move with the joints; link_0, … without a URDF."""
    names = moving_links(robot.urdf, robot.joints) if robot.urdf else [""] * robot.dofs
    return [name or f"link_{i}" for i, name in enumerate(names)]


def _said(numbers: Any) -> str:
    """Numbers with all their digits."""
    return " ".join(repr(float(x)) for x in np.atleast_1d(np.asarray(numbers, float)))


def _quaternion(rotation: np.ndarray) -> np.ndarray:
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(rotation, float).reshape(9))
    return quaternion
