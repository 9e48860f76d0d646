"""Logs with something hidden in them: arm, motion, effect, size, joint and noise drawn at random, played by MuJoCo.

What is hidden is known here alone; nothing in this file shares code with what looks for it. Sizes are drawn in shares
of the torque that the joint has anyway, so that they suit every arm.
"""

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin  # pyright: ignore[reportMissingImports]
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, sosfiltfilt

from experiments.arms import random_robot
from invdyn_cli.log import Log
from invdyn_cli.robots import load_urdf, pinocchio_model
from invdyn_cli.simulation import plant
from invdyn_cli.simulation.hidden import Hidden, assemble
from invdyn_cli.simulation.references import AbstractReference, ConstantSpeed, Multisine, PickPlace
from invdyn_cli.simulation.sensors import Noise
from invdyn_cli.types import Robot

STANDSTILL = 0.2
"""Share of a joint's RMS speed, below which dry friction is not counted."""

WHOLE_ARM = ("payload", "payload_change", "base_tilt")
"""Effects without a joint."""


@dataclass(frozen=True)
class Case:
    """A log, the robot that everybody believes it is of, what was hidden, and by how much it is above the noise.

    `share` is the largest ratio, over joints, of the RMS torque that the hidden effects make to that of the noise.
    `faint` are those of a worn arm of which little is left beyond what every arm has.
    """

    robot: Robot
    log: Log
    hidden: tuple[Hidden, ...]
    share: float
    said: str
    faint: tuple[Hidden, ...] = ()


@dataclass(frozen=True)
class Scene:
    """What a case is drawn on: the arm and its motion, and per joint the RMS of nominal torque, speed, acceleration."""

    robot: Robot
    reference: AbstractReference
    duration: float
    seed: int
    torque: np.ndarray
    q: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    tau: np.ndarray


def draw_scene(draw: np.random.Generator, joints: int | None = None) -> Scene:
    """An arm (one in three the built-in one, one in three of the others not upright) and its motion, 20 to 60 s."""
    if joints is None and draw.random() < 1 / 3:
        robot = load_urdf("apollo_arm")
    else:
        tilted = list(draw.uniform([-1.5, -1.5, 0], [1.5, 1.5, 0])) if draw.random() < 1 / 3 else None
        robot = random_robot(draw, joints or int(draw.integers(3, 8)), tilted)
    kind = draw.choice(3, p=[0.6, 0.25, 0.15])
    way = draw.spawn(1)[0].choice(3, p=[0.5, 0.25, 0.25])  # of sweeps: all joints at once, in turn, joint by joint
    speed = draw.uniform(0.3, 0.6)
    reference = (
        Multisine(speed=speed, amplitude=draw.uniform(0.5, 0.8)),
        PickPlace(speed=speed, amplitude=draw.uniform(0.5, 0.8)),
        ConstantSpeed(speed=speed, together=way == 0, by_joint=way == 2),
    )[kind]
    duration, seed = float(round(draw.uniform(20, 60))), int(draw.integers(1 << 30))
    return scene_of(robot, reference, duration, seed)


def scene_of(robot: Robot, reference: AbstractReference, duration: float, seed: int) -> Scene:
    """An arm on a motion, with what it takes."""
    motion = reference.motion(robot, duration, 100.0, seed)
    q, qd, qdd = (np.asarray(x) for x in (motion.q, motion.qd, motion.qdd))
    tau = inverse_dynamics(robot, q, qd, qdd)
    rms = [np.sqrt(np.mean(x**2, axis=0)) for x in (tau, qd, qdd)]
    return Scene(robot, reference, duration, seed, rms[0], q, rms[1], rms[2], tau)


def inverse_dynamics(robot: Robot, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
    """Nominal torques (T, n) by Pinocchio."""
    model = pinocchio_model(robot)
    data = model.createData()
    return np.array([pin.rnea(model, data, *x) for x in zip(q, qd, qdd, strict=True)])


def draw_effect(draw: np.random.Generator, scene: Scene, name: str, joint: int | None = None) -> Hidden:
    """One effect on a random joint, its size a random share of what the joint has anyway."""
    j = int(draw.choice(felt(scene, name))) if joint is None else joint
    j = max(j, 1) if name == "coupled_friction" else j  # the first joint has none before it
    return Hidden(name, None if name in WHOLE_ARM else scene.robot.joints[j], SIZES[name](draw, scene, j))


def felt(scene: Scene, name: str) -> np.ndarray:
    """Joints on which an effect may be hidden: those that have some torque; where a gear has play, the load must change
    its sign, and a contact needs joints before it that feel it."""
    strong = scene.torque > 0.02 * scene.torque.max()
    low, high = np.quantile(scene.tau, [0.1, 0.9], axis=0)
    if name == "backlash" and np.any(strong & (low < 0) & (high > 0)):
        strong &= (low < 0) & (high > 0)
    if name == "external_contact":
        strong = np.arange(scene.robot.dofs) >= min(2, scene.robot.dofs - 1)
    return np.flatnonzero(strong)


ATTEMPTS = 60
"""How often a case is drawn: an arm that loses control is no log."""


def play(draw: np.random.Generator, scene: Scene, hidden: Sequence[Hidden]) -> Case:
    """The log of a scene with these effects, and noise: torque 0.2 to 2 % of each joint's, encoders of 17 to 21 bit."""
    torque = np.maximum(scene.torque, 0.02 * scene.torque.max()) * np.exp(draw.uniform(np.log(0.002), np.log(0.02)))
    noise = Noise(position=float(np.exp(draw.uniform(np.log(1e-6), np.log(1.5e-5)))), torque=tuple(torque))
    options: dict[str, Any] = {"duration": scene.duration, "seed": scene.seed, "position_side": "motor"}
    log = plant.record(scene.robot, [scene.reference], hidden, noise=noise, **options)
    share = excess(scene.robot, log, hidden)[0] / torque
    said = f"{scene.robot.name} {scene.robot.dofs} joints, {type(scene.reference).__name__} {scene.duration:g} s"
    return Case(scene.robot, log, tuple(hidden), float(share.max()), said)


def draw_case(seed: int, names: Sequence[str], joints: int | None = None, same_joint: bool | None = None) -> Case:
    """A case with these effects hidden, all from one seed; `same_joint`: all on one, or all on different joints."""
    for attempt in range(ATTEMPTS):
        draw = np.random.default_rng([seed, attempt, zlib.crc32("+".join(names).encode())])
        scene = draw_scene(draw, joints)
        strong = felt(scene, "")
        chosen: list[int | None] = [None] * len(names)
        if same_joint is not None:
            if not same_joint and len(strong) < len(names):
                continue
            chosen = [int(draw.choice(strong))] * len(names) if same_joint else list(draw.permutation(strong))
        hidden = [draw_effect(draw, scene, name, chosen[i]) for i, name in enumerate(names)]
        try:
            return play(draw, scene, hidden)
        except plant.UsageError:
            continue
    raise RuntimeError(f"no stable case from seed {seed} for {names}")


def excess(robot: Robot, log: Log, hidden: Sequence[Hidden], wear: Sequence[Hidden] = ()) -> np.ndarray:
    """RMS torque (2, n) by which a log's torque differs from that of an arm with nothing but its `wear` (wrong links,
    Coulomb and viscous friction), above its noise [N m]: at 20 Hz, where the noise of 1 kHz is a seventh; noise is put
    back to its full size by the caller's ratio. The rotor that a gear brings with it is not counted: it may be found,
    and is not what was hidden. Nor are samples near standstill, where friction is what it must be. First all of
    it, then what an offset, Coulomb and viscous friction and a rotor of each joint, fitted to it, do not take up."""
    raw = log.trajectories[0]
    sections = butter(4, 20.0, fs=log.rate, output="sos")
    q = sosfiltfilt(sections, raw.q, axis=0)[::5]
    tau = sosfiltfilt(sections, raw.tau, axis=0)[::5]
    spline = make_interp_spline(raw.t[::5], q, k=5)
    qdd = spline.derivative(2)(raw.t[::5])
    qd, built = spline.derivative(1)(raw.t[::5]), assemble(robot, wear)
    known = inverse_dynamics(replace(robot, inertial=built.inertial), q, qd, qdd)
    known += built.damping * qd + built.friction * np.sign(qd)
    for one in hidden:
        if "rotor" in one.parameters:
            j = robot.joints.index(str(one.joint))
            known[:, j] += one.parameters["rotor"] * qdd[:, j]
    speed = abs(qd[40:-40])
    moves = speed > STANDSTILL * np.sqrt(np.mean(speed**2, axis=0)) * (built.friction > 0)
    left = np.where(moves, (tau - known)[40:-40], 0.0)
    terms, beyond = np.stack([np.ones_like(qd), np.sign(qd), qd, qdd], axis=2)[40:-40], left.copy()
    for j, own in enumerate(moves.T):
        columns = terms[own, j]
        beyond[own, j] -= columns @ np.linalg.lstsq(columns, left[own, j], rcond=None)[0]
    return np.sqrt(np.sum(np.stack([left, beyond]) ** 2, axis=1) / np.maximum(moves.sum(0), 1))


def _share(draw: np.random.Generator) -> float:
    return float(np.exp(draw.uniform(np.log(0.04), np.log(0.25))))


def _sign(draw: np.random.Generator) -> float:
    return float(draw.choice([-1.0, 1.0]))


def _com(draw: np.random.Generator) -> list[float]:
    return [float(x) for x in draw.uniform([-0.06, -0.06, 0.0], [0.06, 0.06, 0.15])]


def _thermal(d: np.random.Generator, s: Scene, j: int) -> dict[str, float]:
    cold = 2 * _share(d) * s.torque[j] / s.speed[j]
    return {"cold": cold, "warm": cold * d.uniform(0.25, 0.6), "time_constant": s.duration * d.uniform(0.15, 0.5)}


def _stribeck(d: np.random.Generator, s: Scene, j: int) -> dict[str, float]:
    coulomb = _share(d) * s.torque[j]
    velocity = s.speed[j] * d.uniform(0.05, 0.3)
    return {"coulomb": coulomb, "static": coulomb * d.uniform(1.3, 2.0), "velocity": velocity}


def _spring(d: np.random.Generator, s: Scene, j: int) -> dict[str, float]:
    return {
        "stiffness": _share(d) * s.torque[j] / s.q[:, j].std(),
        "rest": s.q[:, j].mean() + d.uniform(-1, 1) * s.q[:, j].std(),
    }


def _link(d: np.random.Generator, s: Scene, j: int) -> dict[str, Any]:
    mass = s.robot.inertial[j, 0]
    return {
        "mass": _sign(d) * d.uniform(0.2, 0.5) * mass,
        "com": [float(x) for x in d.uniform(-0.03, 0.03, 3)],
        "inertia": float(d.uniform(-0.3, 0.5)),
    }


def _coupled(d: np.random.Generator, s: Scene, j: int) -> dict[str, float]:
    """A drive's friction as shares of what the stronger of both joints has, its inertia a tenth of its joint's."""
    torque = max(s.torque[j], s.torque[j - 1])
    ratio, both = _sign(d), s.speed[j] + s.speed[j - 1]
    friction = {"coulomb": _share(d) * torque, "damping": _share(d) * torque / both}
    return {**friction, "armature": 0.1 * _inertia(s, j), "ratio": ratio}


def _bristles(d: np.random.Generator, s: Scene, j: int) -> dict[str, float]:
    coulomb = _share(d) * s.torque[j]
    return {"coulomb": coulomb, "stiffness": coulomb / float(np.exp(d.uniform(np.log(1e-3), np.log(2e-2))))}


def _inertia(s: Scene, j: int) -> float:
    """What a joint carries in the middle of its motion [kg m^2]."""
    model = pinocchio_model(s.robot)
    return float(pin.crba(model, model.createData(), np.median(s.q, axis=0))[j, j])


def _play(d: np.random.Generator, s: Scene, j: int) -> dict[str, float]:
    gap = float(np.exp(d.uniform(np.log(5e-4), np.log(8e-3))))
    return {"gap": gap, "rotor": _inertia(s, j) * d.uniform(0.03, 0.3)}


def _spring_gear(d: np.random.Generator, s: Scene, j: int) -> dict[str, float]:
    inertia = _inertia(s, j)
    return {"stiffness": inertia * (2 * np.pi * d.uniform(5, 15)) ** 2, "rotor": inertia * d.uniform(0.05, 0.5)}


def _window(d: np.random.Generator, s: Scene, shortest: float, longest: float) -> list[float]:
    """From some time on, for a time; one in three until the end."""
    length = d.uniform(shortest, longest) * s.duration
    start = d.uniform(0.1, 0.9) * (s.duration - length)
    return [float(start), s.duration if d.random() < 1 / 3 else float(start + length)]


def _contact(d: np.random.Generator, s: Scene, j: int) -> dict[str, Any]:
    """A force as large as some share of the torque of the joint that feels it most, half a metre away; of two arms, one
    is touched at the joint frame's origin, the other up to 0.15 m from it along each axis."""
    force = d.normal(size=3)
    size = 4 * _share(d) * s.torque.max() / np.linalg.norm(force)
    start = d.uniform(0.05, 0.9) * s.duration
    end = min(start + d.uniform(0.5, 4.0), s.duration)
    where = np.random.default_rng([19, s.seed])
    point = {"point": where.uniform(-0.15, 0.15, 3).tolist()} if where.random() < 0.5 else {}
    return {"force": [float(size * x) for x in force], "window": [float(start), float(end)], **point}


SIZES: Mapping[str, Callable[[np.random.Generator, Scene, int], dict[str, Any]]] = {
    "viscous_friction": lambda d, s, j: {"damping": _share(d) * s.torque[j] / s.speed[j]},
    "coulomb_friction": lambda d, s, j: {"coulomb": _share(d) * s.torque[j]},
    "asymmetric_coulomb_friction": lambda d, s, j: {
        "positive": (c := _share(d) * s.torque[j]) * d.uniform(1.2, 1.8),
        "negative": c * d.uniform(0.3, 0.8),
    },
    "stribeck_friction": _stribeck,
    "load_dependent_friction": lambda d, s, j: {"mu": float(d.uniform(0.04, 0.2))},
    "quadratic_friction": lambda d, s, j: {"drag": _share(d) * s.torque[j] / (1.7 * s.speed[j] ** 2)},
    "thermal_friction_drift": _thermal,
    "coupled_friction": _coupled,
    "presliding_hysteresis": _bristles,
    "torque_offset_drift": lambda d, s, j: {"rate": 3 * _sign(d) * _share(d) * s.torque[j] / s.duration},
    "backlash": _play,
    "joint_elasticity": _spring_gear,
    "torque_ripple": lambda d, s, j: {
        "amplitude": 1.4 * _share(d) * s.torque[j],
        "cycles": float(np.exp(d.uniform(np.log(max(8, 2.5 * 2 * np.pi / np.ptp(s.q[:, j]))), np.log(80)))),
        "phase": float(d.uniform(-np.pi, np.pi)),
    },
    "joint_spring": _spring,
    "rotor_inertia": lambda d, s, j: {"armature": _share(d) * s.torque[j] / s.acceleration[j]},
    "torque_gain_error": lambda d, s, j: {"gain": float(1 + _sign(d) * d.uniform(0.05, 0.3))},
    "torque_gain_change": lambda d, s, j: {
        "gain": float(1 - d.uniform(0.08, 0.4)),
        "window": _window(d, s, 0.2, 0.6),
    },
    "torque_offset": lambda d, s, j: {"offset": _sign(d) * _share(d) * s.torque[j]},
    "torque_delay": lambda d, s, j: {"delay": float(d.uniform(0.004, 0.02)) * _sign(d)},
    "actuator_lag": lambda d, s, j: {"time_constant": float(d.uniform(0.004, 0.02)) * _sign(d)},
    "torque_saturation": lambda d, s, j: {"limit": float(np.quantile(abs(s.tau[:, j]), d.uniform(0.8, 0.96)))},
    "payload": lambda d, s, j: {
        "mass": float(s.robot.inertial[:, 0].sum() * np.exp(d.uniform(np.log(0.02), np.log(0.15)))),
        "com": _com(d),
    },
    "payload_change": lambda d, s, j: {
        "mass": float(s.robot.inertial[:, 0].sum() * np.exp(d.uniform(np.log(0.02), np.log(0.12)))),
        "com": _com(d),
        "window": _window(d, s, 0.1, 0.5),
    },
    "external_contact": _contact,
    "link_inertia_error": _link,
    "base_tilt": lambda d, s, j: _tilted(d, s.robot),
    "encoder_offset": lambda d, s, j: {"offset": _sign(d) * float(d.uniform(0.01, 0.06))},
}


def _tilted(d: np.random.Generator, robot: Robot) -> dict[str, float]:
    """The direction of gravity, turned by 0.03 to 0.12 rad from the nominal one."""
    down = np.asarray(robot.gravity) / np.linalg.norm(robot.gravity)
    side = np.cross(down, d.normal(size=3))
    down = down + np.tan(d.uniform(0.03, 0.12)) * side / np.linalg.norm(side)
    down /= np.linalg.norm(down)
    return {"angle": float(np.arccos(-down[2])), "azimuth": float(np.arctan2(down[1], down[0]))}
