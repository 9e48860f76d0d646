"""One joint as effects see it: its state over time, its usual values, and the terms of a simulator's file."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from invdyn_cli.types import Array, Robot

NO_PLACE = "is left out: the files for simulators cannot contain it"
NO_TIME = "is left out: the files for simulators do not change with time"


class JointUnits(NamedTuple):
    """What a joint's position and torque are measured in; `position`/s is that of its velocity."""

    position: str
    torque: str


def units(slides: bool) -> JointUnits:
    """rad and N m, m and N for a joint that slides."""
    return JointUnits("m", "N") if slides else JointUnits("rad", "N m")


class JointState(NamedTuple):
    """One joint over time, (T,) each or one sample: t [s], q, qd, qdd, sign(qd) without jumps at rest, and the rigid
    body's torque [N m; N] that the joint transmits; `before`, of what remembers: q (P,) until then, where it is
    known; `width` [rad/s; m/s] within which the sign goes straight through zero; `driver`: the joint before it in the
    chain, where there is one."""

    t: Array
    q: Array
    qd: Array
    qdd: Array
    sign: Array
    transmitted: Array
    before: Array | None = None
    width: Array | float = 1e-3
    driver: "JointState | None" = None


@dataclass(frozen=True)
class UsualJoint:
    """What a joint of a robot usually does, from which effects have a typical size.

    Attributes:
        joint: its number.
        level: [N m; N] of what a typical effect adds to its torque.
        torque: [N m; N] that it usually has.
        speed: [rad/s; m/s].
        span, middle: [rad; m] of its range.
        inertia: [kg m^2; kg] that it carries.
        duration: [s] of a recording.
    """

    robot: Robot
    joint: int
    level: float
    torque: float
    speed: float
    span: float
    middle: float
    inertia: float
    duration: float


@dataclass(frozen=True)
class SimulatorTerms:
    """What of an effect the file of a simulator (MJCF) holds.

    Attributes:
        joint: numbers that are added to those of its joint, by `JOINT_TERMS`; a gain multiplies, of limits the least
            counts.
        drive: of a drive that the joint shares with the one before it: coulomb, damping, armature, ratio.
        body: (10,) inertial parameters of a body that the last link carries.
        lost: what of the effect is not held, as the end of a sentence that begins with its name; "" if all is.
    """

    joint: Mapping[str, float] = field(default_factory=dict)
    drive: Mapping[str, float] = field(default_factory=dict)
    body: np.ndarray | None = None
    lost: str = ""


JOINT_TERMS: Mapping[str, str] = {
    "damping": "N m s/rad",
    "drag": "N m s^2/rad^2, times the square of the speed",
    "friction": "N m, dry",
    "armature": "kg m^2 of the rotor",
    "stiffness": "N m/rad of a spring beside the joint",
    "pull": "N m of that spring at q = 0",
    "offset": "N m that the joint does not receive",
    "gain": "-, from what is commanded to what the joint receives",
    "delay": "s",
    "lag": "s, time constant",
    "limit": "N m, of what the joint receives",
    "encoder": "rad that is added to the angle",
    "gap": "rad, full width of the gear's play",
    "compliance": "rad/(N m) of a spring between motor and link",
    "gear_damping": "N m s/rad beside that spring",
}
"""Numbers of a joint that an MJCF holds, and their units."""
