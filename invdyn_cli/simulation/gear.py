"""Joints with a compliant gear: motor and link turn on one axis, with play or a spring between them.

The motor's degree of freedom carries the rotor; all torques of the drive and all friction but the link's own act on it.
The gear's degree of freedom is the link's angle minus the motor's, and carries the link. At the ends of the play
MuJoCo's joint limits stop it, or compliant teeth push it back; MuJoCo's spring pulls it back.
"""
# pyright: reportAttributeAccessIssue=false

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from invdyn_cli.errors import UsageError
from invdyn_cli.simulation.arm import Arm, build, mass_matrix
from invdyn_cli.simulation.references import room
from invdyn_cli.types import Robot

ROTOR = 0.03
"""[-] Rotor inertia where none is given, of the inertia that the joint carries."""

DAMPED = 0.02
"""[-] Damping ratio of a link on its spring where no damping is given: steel, grease and bearings."""

RESOLVED = 0.3
"""[rad] Largest phase of a tooth's oscillation within a step of the physics."""

SLIDING = 5e-3
"""[rad/s; m/s] Velocity of a link at which its dry friction is three quarters of its level."""

NEAR = 1e-3
"""[-] Share of the play within which teeth count as in contact: they are held there even if they do not move yet."""


@dataclass(frozen=True)
class Gear:
    """What is between motor and link of one joint's column: play, or a spring.

    Attributes:
        joint: the column.
        rotor: [kg m^2; kg] inertia of the motor.
        gap: [rad; m] full width of the play; 0: a spring.
        stiffness, damping: [N m/rad], [N m s/rad] of the spring, or of the teeth of a gear with play, which then
            bounce; with a stiffness of 0 their flanks stop each other at once.
        link_coulomb, link_damping: [N m; N], [N m s/rad; N s/m] friction of the link itself.
    """

    joint: int
    rotor: float
    gap: float = 0.0
    stiffness: float = 0.0
    damping: float = 0.0
    link_coulomb: float = 0.0
    link_damping: float = 0.0


def carried(robot: Robot) -> np.ndarray:
    """(n,) [kg m^2; kg] inertia that each joint carries, all joints in the middle of their range, the others held."""
    model = build(robot).model
    return np.diagonal(mass_matrix(model, mujoco.MjData(model), room(robot)[0])).copy()


def chosen(
    robot: Robot,
    joint: int,
    *,
    gap: float = 0.0,
    stiffness: float = 0.0,
    damping: float | None = None,
    damping_ratio: float = DAMPED,
    rotor: float | None = None,
    link_coulomb: float = 0.0,
    link_damping: float = 0.0,
) -> Gear:
    """A gear of this robot, its defaults as DAMPED and ROTOR have them; teeth swing with the motor against the link."""
    inertia = carried(robot)[joint]
    turning = float(ROTOR * inertia) if rotor is None else rotor
    if damping is None:
        swinging = turning * inertia / (turning + inertia) if gap else inertia
        damping = 2 * damping_ratio * float(np.sqrt(stiffness * swinging))
    return Gear(joint, turning, gap, stiffness, damping, link_coulomb, link_damping)


def put(arm: Arm, gears: Sequence[Gear]) -> None:
    """Set springs and stops of an arm that was built with these gears."""
    model = arm.model
    for dof, gear in zip(arm.gear, gears, strict=True):
        if not gear.gap:
            model.jnt_stiffness[dof], model.qpos_spring[dof] = gear.stiffness, 0.0
            model.dof_damping[dof] = gear.damping
        elif not gear.stiffness:
            model.jnt_limited[dof], model.jnt_range[dof] = 1, (-gear.gap / 2, gear.gap / 2)
            model.jnt_solimp[dof] = model.dof_solimp[dof]


def loaded(arm: Arm, gears: Sequence[Gear], data: Any) -> None:
    """Put the gears where the weight of the links holds them at rest, with the motors in their present position."""
    for _ in range(10 if gears else 0):  # a spring yields by a hundredth of a radian: each round leaves a hundredth
        mujoco.mj_forward(arm.model, data)
        for dof, gear in zip(arm.gear, gears, strict=True):
            weight = data.qfrc_bias[dof]
            data.qpos[dof] = -np.sign(weight) * gear.gap / 2 if gear.gap else -weight / gear.stiffness


class Stops:
    """The ends of all plays: mutable, used for one simulation.

    MuJoCo stops a joint only when it is beyond its limit, by up to the motion of one step. Therefore, if the joint
    would pass the end within the next step, the limit is moved to its present position, with the damping that takes it
    exactly to the end. Compliant teeth push with their own force. Friction of a link itself acts on its angle, the sum
    of both degrees of freedom.

    Attributes:
        drag: (g,) [N m; N] friction of the links in the last step.

    Raises:
        UsageError: if teeth are too stiff for the steps of the physics.
    """

    def __init__(self, arm: Arm, gears: Sequence[Gear], data: Any) -> None:
        plays = [(dof, gear) for dof, gear in zip(arm.gear, gears, strict=True) if gear.gap]
        self._plays = [(dof, gear.gap / 2) for dof, gear in plays if not gear.stiffness]
        self._teeth = [(dof, gear) for dof, gear in plays if gear.stiffness]
        every = enumerate(zip(arm.motor[arm.geared], arm.gear, gears, strict=True))
        self._rubbing = [(k, *one) for k, one in every if one[-1].link_coulomb or one[-1].link_damping]
        self.drag = np.zeros(len(gears))
        self._model, self._gears = arm.model, arm.gear
        self._q, self._qd, self._applied = data.qpos, data.qvel, data.qfrc_applied  # each use makes a view anew
        self._step = float(arm.model.opt.timestep)
        for _, gear in self._teeth:
            most = gear.rotor * (RESOLVED / self._step) ** 2
            if gear.stiffness > most:
                got = f"backlash stiffness={gear.stiffness:.3g} N m/rad with steps of {1e6 * self._step:.3g} us"
                raise UsageError(f"{got}; allowed: at most {most:.3g}. Try more substeps")

    def __bool__(self) -> bool:
        return bool(self._plays or self._teeth or self._rubbing)

    def look_ahead(self) -> None:
        """Set the limits, and the forces of teeth and of the links' friction, for the next step."""
        model, h, applied = self._model, self._step, self._applied
        applied[self._gears] = 0.0
        for dof, gear in self._teeth:
            q, qd = float(self._q[dof]), float(self._qd[dof])
            deep = q - min(max(q, -gear.gap / 2), gear.gap / 2)
            push = gear.stiffness * deep + gear.damping * qd
            applied[dof] = -push if deep * push > 0 else 0.0
        for k, motor, dof, gear in self._rubbing:
            speed = float(self._qd[motor]) + float(self._qd[dof])
            drag = -gear.link_coulomb * np.tanh(speed / SLIDING) - gear.link_damping * speed
            applied[motor] += drag
            applied[dof] += drag
            self.drag[k] = drag
        for dof, half in self._plays:
            q, qd = float(self._q[dof]), float(self._qd[dof])
            model.jnt_margin[dof], model.jnt_solref[dof] = 0.0, (2 * h, 1.0)
            for left, way in ((half - q, qd * h), (half + q, -qd * h)):
                if 0 < left < max(way, NEAR * half):
                    model.jnt_margin[dof] = left + 1e-9 * half
                    model.jnt_solref[dof] = 0.0, -(max(0.0, 1 - left / way) if way > 0 else 1.0) / h
