"""types.Robot -> MuJoCo: the same joints, frames, inertials and gravity; no friction, no limits, no contacts. A joint
whose gear yields is two in series on one axis: the motor's, and behind it the gear's.

MuJoCo's compiler refuses impossible links (no mass, a violated triangle inequality), which are common in URDFs. It
therefore gets placeholders, and the true numbers are set afterwards: the equations of motion only need a positive
definite mass matrix. If even that fails, a joint gets the missing `LEAST_INERTIA`, with a note.
"""
# pyright: reportAttributeAccessIssue=false

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import mujoco
import numpy as np

from invdyn_cli.types import Robot

LEAST_INERTIA = 1e-6
"""[kg m^2; kg] Smallest inertia about a joint that is integrated unchanged; that of a wrist is a hundred times as
large."""

POSTURES = 64
"""Number of random postures in which the smallest inertia is searched."""

GEAR = "_gear"
"""Suffix of a joint's name: the unmotored joint of its gear, with play or a spring between motor and link."""


@dataclass(frozen=True)
class Body:
    """A solid sphere, mass [kg] and radius [m], its centre at `com` (3,) [m] in the frame of a joint, of the last one
    unless `joint` is another column."""

    mass: float
    com: Sequence[float]
    radius: float
    joint: int = -1


@dataclass(frozen=True)
class Coupling:
    """A drive that turns with qd of a joint + `ratio` qd of the one before it, `driver` (columns): its dry friction,
    damping and inertia."""

    joint: int
    driver: int
    coulomb: float
    damping: float
    armature: float
    ratio: float


@dataclass(frozen=True)
class Arm:
    """A MuJoCo model of a robot with n joints, g of which have a gear that yields.

    Attributes:
        model: its n + g degrees of freedom are the robot's joints, in its order, a gear's behind its motor's.
        motor: (n,) the degree of freedom of each joint's motor, whose angle is the link's unless the gear yields.
        geared, gear: (g,) columns of the joints that have a gear, and its degree of freedom: link less motor angle.
        notes: what was added.
    """

    model: mujoco.MjModel
    motor: np.ndarray
    geared: np.ndarray
    gear: np.ndarray
    notes: tuple[str, ...] = ()


def build(
    robot: Robot,
    *,
    inertial: np.ndarray | None = None,
    gravity: np.ndarray | None = None,
    carried: Sequence[Body] = (),
    armature: np.ndarray | None = None,
    geared: Sequence[int] = (),
    couplings: Sequence[Coupling] = (),
    timestep: float = 2.5e-4,
) -> Arm:
    """The arm.

    Args:
        robot: kinematics, and inertials and gravity unless the next two are given.
        inertial: (n, 10) in place of the robot's, as `types.Robot` has them.
        gravity: (3,) [m/s^2] in place of the robot's.
        carried: bodies welded to links, "carried_0" and so on.
        armature: (n,) [kg m^2; kg] rotor inertias.
        geared: columns of the joints with a gear that yields, as yet by any angle and without force.
        couplings: drives that turn with two joints.
        timestep: [s].
    """
    spec = mujoco.MjSpec()
    spec.modelname = robot.name
    inertial = np.asarray(robot.inertial if inertial is None else inertial)
    solids = [_solid(row) for row in inertial]
    bodies = []
    for i, name in enumerate(robot.joints):
        parent = spec.worldbody if robot.parents[i] < 0 else bodies[robot.parents[i]]
        frame = {"pos": np.asarray(robot.translation[i]), "quat": quaternion_of(np.asarray(robot.rotation[i]))}
        bodies.append(_body(parent, f"link_{i}", solids[i], **frame))
        slides = mujoco.mjtJoint.mjJNT_SLIDE if robot.prismatic[i] else mujoco.mjtJoint.mjJNT_HINGE
        bodies[i].add_joint(name=name, type=slides, axis=np.asarray(robot.axis[i]), armature=float(i in geared))
        if i in geared:
            bodies[i].add_joint(name=f"{name}{GEAR}", type=slides, axis=np.asarray(robot.axis[i]), armature=1.0)
    for i, body in enumerate(carried):
        sphere = np.full(3, 0.4 * body.mass * body.radius**2)
        solids.append((body.mass, np.asarray(body.com, float), np.array([1.0, 0, 0, 0]), sphere))
        _body(bodies[body.joint], f"carried_{i}", solids[-1])
    for i, one in enumerate(couplings):
        _add_coupling(spec, robot.joints, i, one)
    spec.option.timestep = timestep
    spec.option.gravity = np.asarray(robot.gravity if gravity is None else gravity)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    model = spec.compile()
    names = [*(f"link_{i}" for i in range(robot.dofs)), *(f"carried_{i}" for i in range(len(carried)))]
    for name, (mass, _, _, principal) in zip(names, solids, strict=True):
        body = model.body(name).id
        model.body_mass[body], model.body_inertia[body] = mass, principal
    motor = np.array([model.joint(name).dofadr[0] for name in robot.joints], int)
    gear = np.array([model.joint(f"{robot.joints[i]}{GEAR}").dofadr[0] for i in geared], int)
    model.dof_armature[:] = 0.0
    if armature is not None:
        model.dof_armature[motor] = armature
    # Friction as stiff as the solver goes: a joint that shall stick creeps at 1e-6 rad/s, not at 1e-2 as by default.
    model.dof_solref[:] = 2 * timestep, 1
    model.dof_solimp[:] = 0.9999, 0.9999, 0.001, 0.5, 2
    model.tendon_damping[:] = [one.damping for one in couplings]  # in the spec a polynomial, in older MuJoCo a number
    model.tendon_solref_fri[:] = 2 * timestep, 1
    model.tendon_solimp_fri[:] = 0.9999, 0.9999, 0.001, 0.5, 2
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return Arm(model, motor, np.array(geared, int), gear, _least_inertia_added(model, gear))


def set_joints(arm: Arm, *, damping: np.ndarray, stiffness: np.ndarray, pull: np.ndarray) -> None:
    """Damping [N m s/rad], springs [N m/rad] and their torque at zero [N m] of the motors, (n,) each, which MuJoCo
    integrates by itself."""
    arm.model.dof_damping[arm.motor] = damping
    arm.model.jnt_stiffness[arm.motor] = stiffness
    arm.model.qpos_spring[arm.motor] = pull / np.where(stiffness > 0, stiffness, 1.0)


def _add_coupling(spec: mujoco.MjSpec, names: Sequence[str], number: int, one: Coupling) -> None:
    """A tendon over both joints, whose length is the drive's angle."""
    tendon = spec.add_tendon(name=f"coupling_{number}", frictionloss=one.coulomb, armature=one.armature)
    tendon.wrap_joint(names[one.joint], 1.0)
    tendon.wrap_joint(names[one.driver], one.ratio)


def mass_matrix(model: mujoco.MjModel, data: mujoco.MjData, q: np.ndarray) -> np.ndarray:
    """(n, n) [kg m^2; kg] at q (n,), rotor inertias included."""
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_crb(model, data)
    full = np.empty((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return full


def mass_matrices(model: mujoco.MjModel, gear: np.ndarray) -> np.ndarray:
    """(POSTURES, nv, nv) [kg m^2; kg] at random postures of the joints, the gears straight."""
    data, draw = mujoco.MjData(model), np.random.default_rng(0)
    span = np.where(model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE, 0.5, np.pi)
    span[gear] = 0.0
    return np.array([mass_matrix(model, data, draw.uniform(-span, span)) for _ in range(POSTURES)])


@contextmanager
def quiet() -> Iterator[None]:
    """MuJoCo's warnings of diverging states are replaced by our own; MuJoCo would write them to a file."""
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(None)


def lightest(arm: Arm) -> np.ndarray:
    """(n,) [kg m^2; kg] the least inertia that each motor moves when all other joints are free."""
    inverse = np.linalg.inv(mass_matrices(arm.model, arm.gear))
    return (1 / np.diagonal(inverse, axis1=1, axis2=2).max(0))[arm.motor]


def _solid(row: np.ndarray) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
    """Ten parameters about the frame's origin -> mass, com (3,), principal axes (a quaternion) and moments (3,)."""
    mass = float(row[0])
    com = row[1:4] / mass if mass > 1e-9 else np.zeros(3)
    xx, xy, yy, xz, yz, zz = row[4:]
    about_origin = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    moments, axes = np.linalg.eigh(about_origin - mass * (com @ com * np.eye(3) - np.outer(com, com)))
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    return mass, com, quaternion_of(axes), moments


def _body(parent, name: str, solid: tuple, **frame):
    """A child body with the solid's place, and placeholders for its mass and moments of inertia."""
    _, com, axes, _ = solid
    return parent.add_body(
        name=name, ipos=com, iquat=axes, mass=1.0, inertia=np.ones(3), explicitinertial=True, **frame
    )


def quaternion_of(rotation: np.ndarray) -> np.ndarray:
    """(4,) w, x, y, z of a rotation matrix (3, 3)."""
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(rotation, float).reshape(9))
    return quaternion


def _least_inertia_added(model: mujoco.MjModel, gear: np.ndarray) -> tuple[str, ...]:
    """Add in place the inertia that joints lack for a positive definite mass matrix; sentences on what was added."""
    found = mass_matrices(model, gear)
    lack = np.maximum(0.0, LEAST_INERTIA - np.diagonal(found, axis1=1, axis2=2).min(0))
    lack += max(0.0, LEAST_INERTIA / 10 - float(np.linalg.eigvalsh(found + np.diag(lack)).min()))
    if not lack.any():
        return ()
    model.dof_armature[:] += lack
    mujoco.mj_setConst(model, mujoco.MjData(model))
    added = ", ".join(f"{model.joint(i).name} {x:.2g}" for i, x in enumerate(lack) if x)
    return (f"inertia added to joints whose links have too little [kg m^2; kg]: {added}",)
