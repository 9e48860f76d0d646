"""The effects that can be hidden in the arm, by name, with the parameters and signs of docs/plant.md.

Logged torque = nominal torque + the effect's term: the joint receives the logged torque minus the term. `assemble`
turns effects into numbers per joint that MuJoCo integrates itself (damping, dry friction, springs, inertias, bodies,
gears), and into the few laws and events that it does not have, which `drive` applies in every step.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from invdyn_cli.errors import UsageError, closest, listed
from invdyn_cli.simulation import gear
from invdyn_cli.simulation.arm import Body, Coupling
from invdyn_cli.simulation.bristles import Bristle
from invdyn_cli.simulation.events import Contact, Events, GainChange, Load, window_of
from invdyn_cli.types import Robot

ABOVE, FROM, NUMBER, VECTOR, FUNCTION = "a number above 0", "a number from 0", "a number", "three numbers", "a function"
WINDOW, NAME = "two times [s], [from, to]", "a trajectory's name"
STANDARD_GRAVITY = 9.81
"""[m/s^2] of a tilted base."""


@dataclass(frozen=True)
class Kind:
    """The parameters of an effect: those that are needed and the optional ones, with the allowed values, and whether it
    names a joint (None: it may)."""

    needed: Mapping[str, str]
    optional: Mapping[str, str] = field(default_factory=dict)
    of_joint: bool | None = True


def _event(needed: Mapping[str, str], optional: Mapping[str, str] | None = None, of_joint: bool = True) -> Kind:
    return Kind({**needed, "window": WINDOW}, {"trajectory": NAME, **(optional or {})}, of_joint)


KINDS = {
    "viscous_friction": Kind({"damping": FROM}),
    "coulomb_friction": Kind({"coulomb": FROM}, {"transition": ABOVE}),
    "asymmetric_coulomb_friction": Kind({"positive": FROM, "negative": FROM}),
    "stribeck_friction": Kind({"coulomb": FROM, "static": FROM, "velocity": ABOVE}, {"exponent": ABOVE}),
    "load_dependent_friction": Kind({"mu": FROM}),
    "quadratic_friction": Kind({"drag": FROM}),
    "presliding_hysteresis": Kind({"coulomb": FROM, "stiffness": ABOVE}),
    "thermal_friction_drift": Kind({"cold": FROM, "warm": FROM, "time_constant": ABOVE}),
    "coupled_friction": Kind({"coulomb": FROM, "damping": FROM, "ratio": NUMBER}, {"armature": FROM}),
    "backlash": Kind(
        {"gap": ABOVE},
        {"rotor": ABOVE, "stiffness": ABOVE, "damping_ratio": FROM, "link_coulomb": FROM, "link_damping": FROM},
    ),
    "joint_elasticity": Kind(
        {"stiffness": ABOVE}, {"damping": FROM, "rotor": ABOVE, "link_coulomb": FROM, "link_damping": FROM}
    ),
    "torque_ripple": Kind({"amplitude": NUMBER, "cycles": ABOVE, "phase": NUMBER}),
    "joint_spring": Kind({"stiffness": FROM, "rest": NUMBER}),
    "rotor_inertia": Kind({"armature": FROM}),
    "torque_gain_error": Kind({"gain": ABOVE}),
    "torque_gain_change": _event({"gain": ABOVE}),
    "torque_offset": Kind({"offset": NUMBER}),
    "torque_offset_drift": Kind({"rate": NUMBER}),
    "torque_delay": Kind({"delay": NUMBER}),
    "actuator_lag": Kind({"time_constant": NUMBER}),
    "torque_saturation": Kind({"limit": ABOVE}),
    "payload": Kind({"mass": ABOVE, "com": VECTOR}, {"radius": FROM}, of_joint=False),
    "payload_change": _event({"mass": ABOVE, "com": VECTOR}, {"radius": FROM, "ramp": FROM}, of_joint=False),
    "external_contact": _event({"force": VECTOR}, {"point": VECTOR}),
    "link_inertia_error": Kind({}, {"mass": NUMBER, "com": VECTOR, "inertia": NUMBER}),
    "base_tilt": Kind({"angle": NUMBER, "azimuth": NUMBER}, of_joint=False),
    "encoder_offset": Kind({"offset": NUMBER}),
    "custom": Kind({"force": FUNCTION}, of_joint=None),
}


@dataclass(frozen=True)
class Hidden:
    """One effect that is hidden in the arm.

    `custom` is any effect that the catalogue lacks, from Python only: its `force(t, q, qd)` gives the term [N m; N] at
    t [s], for the joint's own true angle and velocity, or for those of all joints (n,) if `joint` is None.

    Attributes:
        effect: its name, one of `KINDS`.
        joint: the joint it acts on; None for the whole arm (payload, base_tilt). link_inertia_error names the joint
            that moves the link.
        parameters: by name, in the units of docs/plant.md. payload: also `radius` [m] of the sphere that it is (0.02).
            link_inertia_error: `mass` [kg] and `com` (3,) [m, in the joint's frame] are what is added to the nominal
            ones, `inertia` [-] is the relative change of the inertia about the centre of mass. An effect in
            a time window has `window` (2,) [s], and `trajectory` if it is not in all.
    """

    effect: str
    joint: str | None = None
    parameters: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Build:
    """All effects of an arm with n joints, as numbers (n,) per joint and laws.

    Attributes:
        inertial: (n, 10) as in `types.Robot`.
        gravity: (3,) [m/s^2].
        carried: bodies on the last link.
        armature, damping, friction, stiffness: [kg m^2], [N m s/rad], [N m], [N m/rad]; zero without effects.
        pull: stiffness times rest angle [N m].
        offset: [N m] that the joint does not receive.
        gain, delay, lag, limit: [-], [s], [s], [N m] of the way from logged to delivered torque; 1, 0, 0, infinity.
        encoder: [rad; m] added to what is measured.
        behind, smoothed: [s] by which the log has the torque after it acted; time constant of a filter before the log.
        levels: (joint, law(qd, load) -> dry friction [N m]), load: torque [N m] that the joint transmits.
        drags: (joint, law(t, qd) -> damping [N m s/rad]).
        forces: (joint, law(t, q, qd) -> term [N m]), known to a commissioned controller.
        customs: likewise, (None: all joints at once), unknown to any controller.
        bristles: friction that is a spring before it slides.
        couplings: drives that turn with two joints.
        gears: play and springs between motor and link, one on a joint at most.
        events: effects in time windows, unknown to any controller.
    """

    inertial: np.ndarray
    gravity: np.ndarray
    armature: np.ndarray
    damping: np.ndarray
    friction: np.ndarray
    stiffness: np.ndarray
    pull: np.ndarray
    offset: np.ndarray
    gain: np.ndarray
    delay: np.ndarray
    lag: np.ndarray
    limit: np.ndarray
    encoder: np.ndarray
    behind: np.ndarray
    smoothed: np.ndarray
    carried: list[Body] = field(default_factory=list)
    levels: list[tuple[int, Callable]] = field(default_factory=list)
    drags: list[tuple[int, Callable]] = field(default_factory=list)
    forces: list[tuple[int, Callable]] = field(default_factory=list)
    customs: list[tuple[int | None, Callable]] = field(default_factory=list)
    bristles: list[Bristle] = field(default_factory=list)
    couplings: list[Coupling] = field(default_factory=list)
    gears: list[gear.Gear] = field(default_factory=list)
    events: Events = field(default_factory=Events)


def assemble(robot: Robot, hidden: Sequence[Hidden] = (), trajectory: str | None = None) -> Build:
    """The effects as numbers and laws; several of one kind on one joint add up, but gears.

    `trajectory` leaves out what happens in others only.

    Raises:
        UsageError: for an effect, a joint or a parameter that is not known, is missing, or out of range.
    """
    absent = [
        "armature",
        "damping",
        "friction",
        "stiffness",
        "pull",
        "offset",
        "delay",
        "lag",
        "encoder",
        "behind",
        "smoothed",
    ]
    none: dict[str, Any] = {name: np.zeros(robot.dofs) for name in absent}
    build = Build(
        inertial=np.array(robot.inertial, float),
        gravity=np.array(robot.gravity, float),
        gain=np.ones(robot.dofs),
        limit=np.full(robot.dofs, np.inf),
        **none,
    )
    for one in hidden:
        refuse(one, robot)
        if trajectory is None or one.parameters.get("trajectory") in (None, trajectory):
            _put(build, one, None if one.joint is None else robot.joints.index(one.joint), robot)
    return build


def refuse(one: Hidden, robot: Robot | None = None) -> None:
    """Raise a UsageError if this effect cannot be built (into this robot, where one is given)."""
    if one.effect not in KINDS:
        got = f"no effect {one.effect!r} can be hidden{closest(one.effect, KINDS)}"
        raise UsageError(f"{got}; allowed: {listed(KINDS, most=30)}")
    kind, joints = KINDS[one.effect], robot.joints if robot else ()
    if kind.of_joint is False and one.joint is not None:
        raise UsageError(f"{one.effect} on joint {one.joint!r}; allowed: no joint, because it acts on the whole arm")
    if kind.of_joint and one.joint is None:
        raise UsageError(f"{one.effect} names no joint; allowed: {listed(joints) if robot else 'a joint of the robot'}")
    if robot and one.joint is not None and one.joint not in joints:
        got = f"{one.effect}: no joint {one.joint!r}{closest(one.joint, joints)}"
        raise UsageError(f"{got}; allowed: {listed(joints)}")
    known = {**kind.needed, **kind.optional}
    for name in one.parameters:
        if name not in known:
            raise UsageError(f"{one.effect} has no parameter {name!r}{closest(name, known)}; allowed: {listed(known)}")
    if missing := [name for name in kind.needed if name not in one.parameters]:
        raise UsageError(f"{one.effect} lacks {listed(missing)}; it takes {listed(known)}")
    for name, value in one.parameters.items():
        if not _suits(value, known[name]):
            raise UsageError(f"{one.effect}: {name}={value}; allowed: {known[name]}")
    if "window" in one.parameters:
        window_of(one.effect, one.parameters["window"], float(one.parameters.get("ramp", 0.0)))


def _suits(value: Any, allowed: str) -> bool:
    if allowed == FUNCTION:
        return callable(value)
    if allowed == NAME:
        return value is None or isinstance(value, str)
    try:
        numbers = np.asarray(value, float)
    except (TypeError, ValueError):
        return False
    if numbers.shape != {VECTOR: (3,), WINDOW: (2,)}.get(allowed, ()) or not np.isfinite(numbers).all():
        return False
    return bool(np.all(numbers > 0 if allowed == ABOVE else numbers >= 0 if allowed == FROM else True))


def _put(build: Build, one: Hidden, i: Any, robot: Robot) -> None:
    """Add an effect to the build, in place; `i` is the joint's column."""
    given = {k: v for k, v in one.parameters.items() if k not in ("window", "trajectory")}
    p: dict[str, Any] = {k: v if callable(v) or np.ndim(v) else float(v) for k, v in given.items()}
    if "window" in one.parameters:
        return _put_event(build.events, one, i, p)
    match one.effect:
        case "viscous_friction":
            build.damping[i] += p["damping"]
        case "coulomb_friction":
            if "transition" in p:
                build.drags.append((i, partial(_gradual, **p)))
            else:
                build.friction[i] += p["coulomb"]
        case "asymmetric_coulomb_friction":  # within [-negative, positive] nothing moves: a shifted symmetric friction
            build.friction[i] += (p["positive"] + p["negative"]) / 2
            build.offset[i] += (p["positive"] - p["negative"]) / 2
        case "stribeck_friction":
            build.levels.append((i, partial(_stribeck, **p)))
        case "load_dependent_friction":
            build.levels.append((i, partial(_load_dependent, **p)))
        case "quadratic_friction":
            build.drags.append((i, partial(_quadratic, **p)))
        case "thermal_friction_drift":
            build.drags.append((i, partial(_thermal, **p)))
        case "presliding_hysteresis":
            if p["coulomb"] > 0:
                build.bristles.append(Bristle(i, **p))
        case "coupled_friction":
            if robot.parents[i] < 0:
                got = f"coupled_friction on {one.joint}: it is the first joint"
                raise UsageError(f"{got}; allowed: a joint further from the base")
            build.couplings.append(Coupling(i, robot.parents[i], **{"armature": 0.0, **p}))
        case "backlash" | "joint_elasticity":
            if any(x.joint == i for x in build.gears):
                got = f"{one.effect} on {one.joint}, which has backlash or joint_elasticity already"
                raise UsageError(f"{got}; allowed: one of the two on each joint")
            build.gears.append(gear.chosen(robot, i, **p))
            build.armature[i] += build.gears[-1].rotor
        case "torque_ripple":
            build.forces.append((i, partial(_ripple, **p)))
        case "joint_spring":
            build.stiffness[i] += p["stiffness"]
            build.pull[i] += p["stiffness"] * p["rest"]
        case "rotor_inertia":
            build.armature[i] += p["armature"]
        case "torque_gain_error":
            build.gain[i] *= p["gain"]
        case "torque_offset":
            build.offset[i] += p["offset"]
        case "torque_offset_drift":
            build.forces.append((i, partial(_drift, **p)))
        case "torque_delay":
            (build.delay if p["delay"] > 0 else build.behind)[i] += abs(p["delay"])
        case "actuator_lag":
            (build.lag if p["time_constant"] > 0 else build.smoothed)[i] += abs(p["time_constant"])
        case "torque_saturation":
            build.limit[i] = min(build.limit[i], p["limit"])
        case "payload":
            build.carried.append(Body(p["mass"], p["com"], p.get("radius", 0.02)))
        case "link_inertia_error":
            build.inertial[i] = _changed(build.inertial[i], one.joint, **p)
        case "base_tilt":
            sine, cosine = np.sin(p["angle"]), np.cos(p["angle"])
            direction = sine * np.cos(p["azimuth"]), sine * np.sin(p["azimuth"]), -cosine
            build.gravity[:] = STANDARD_GRAVITY * np.array(direction)
        case "encoder_offset":
            build.encoder[i] += p["offset"]
        case "custom":
            build.customs.append((i, p["force"]))


def _put_event(events: Events, one: Hidden, i: Any, p: dict[str, Any]) -> None:
    """Add an effect with a time window, in place."""
    window = window_of(one.effect, one.parameters["window"], p.get("ramp", 0.0))
    match one.effect:
        case "torque_gain_change":
            events.gains.append(GainChange(i, p["gain"], window))
        case "payload_change":
            events.loads.append(Load(Body(p["mass"], p["com"], p.get("radius", 0.02)), window))
        case "external_contact":
            events.contacts.append(Contact(i, np.asarray(p["force"], float), window, p.get("point", (0.0, 0.0, 0.0))))


def _stribeck(qd, load, coulomb: float, static: float, velocity: float, exponent: float = 2.0):
    return coulomb + (static - coulomb) * np.exp(-(np.abs(qd / velocity) ** exponent))


def _load_dependent(qd, load, mu: float):
    return mu * abs(load)


def _gradual(t, qd, coulomb: float, transition: float):
    """coulomb tanh(qd / transition), as damping."""
    x = np.abs(qd) / transition + 1e-9
    return coulomb / transition * np.tanh(x) / x


def _quadratic(t, qd, drag: float):
    return drag * abs(qd)


def _thermal(t, qd, cold: float, warm: float, time_constant: float):
    return warm + (cold - warm) * np.exp(-np.maximum(t, 0.0) / time_constant)


def _ripple(t, q, qd, amplitude: float, cycles: float, phase: float):
    return amplitude * np.sin(cycles * q + phase)


def _drift(t, q, qd, rate: float):
    return rate * max(t, 0.0)


def _changed(row: np.ndarray, joint: str | None, mass: float = 0.0, com: Any = (0, 0, 0), inertia: float = 0.0):
    """A link's ten parameters with another mass, centre of mass and inertia about it."""
    if row[0] + mass <= 0:
        got = f"link_inertia_error of {joint}: mass={mass:g} leaves {row[0] + mass:.3g} kg"
        raise UsageError(f"{got}; allowed: above {-row[0]:.3g}")
    before = row[1:4] / row[0] if row[0] else np.zeros(3)
    after = before + np.asarray(com, float)
    central = row[4:] - row[0] * _steiner(before)
    whole = row[0] + mass
    return np.concatenate([[whole], whole * after, (1 + inertia) * central + whole * _steiner(after)])


def _steiner(c: np.ndarray) -> np.ndarray:
    """(6,) xx xy yy xz yz zz of a unit mass at c (3,) about the origin."""
    x, y, z = c
    return np.array([y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y])
