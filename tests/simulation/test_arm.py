"""The MuJoCo arm is the robot: its inverse dynamics are Pinocchio's."""

from dataclasses import replace

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from invdyn_cli.robots import load_urdf, pinocchio_model
from invdyn_cli.simulation.arm import LEAST_INERTIA, build, mass_matrix
from invdyn_cli.types import Robot


def difference(robot: Robot, model: mujoco.MjModel | None = None, encoder: float = 0.0) -> float:
    """Largest difference of MuJoCo's torques by a model of the robot (by default what is built) and Pinocchio's over
    random states, relative to the largest torque; the model's second angle is more by `encoder`."""
    model, reference = build(robot).model if model is None else model, pinocchio_model(robot)
    model.jnt_limited[:] = False
    data, buffer, draw = mujoco.MjData(model), reference.createData(), np.random.default_rng(0)
    worst = 0.0
    for _ in range(30):
        q, qd, qdd = draw.uniform(-2, 2, (3, robot.dofs))
        data.qpos[:], data.qvel[:], data.qacc[:] = q, qd, qdd
        data.qpos[1:2] += encoder
        mujoco.mj_inverse(model, data)
        tau = pin.rnea(reference, buffer, q, qd, qdd)
        worst = max(worst, np.abs(data.qfrc_inverse - tau).max() / np.abs(tau).max())
    return worst


def tree(seed: int = 0) -> Robot:
    """Six joints, turning and sliding, in two branches, with real bodies anywhere and gravity askew."""
    draw = np.random.default_rng(seed)
    axes = draw.normal(size=(6, 3))
    bodies = [
        pin.Inertia(m, c, pin.Inertia.Random().inertia) for m, c in zip(draw.uniform(1, 3, 6), axes / 5, strict=True)
    ]
    return Robot(
        name="tree",
        joints=tuple("abcdef"),
        parents=(-1, 0, 1, 0, 3, 4),
        prismatic=(False, True, False, False, True, False),
        rotation=np.array([pin.rpy.rpyToMatrix(draw.uniform(-2, 2, 3)) for _ in range(6)]),
        translation=draw.normal(size=(6, 3)),
        axis=axes / np.linalg.norm(axes, axis=1, keepdims=True),
        inertial=np.array([body.toDynamicParameters() for body in bodies]),
        gravity=np.array([1.0, -2.0, -9.0]),
        **{name: np.full(6, np.inf) for name in ("upper", "velocity_limit", "effort_limit")},
        lower=np.full(6, -np.inf),
        damping=np.full(6, 3.0),
        friction=np.full(6, 3.0),
    )


def test_the_built_in_arm():
    """MuJoCo's inverse dynamics of the built-in arm are Pinocchio's to rounding, and nothing was added."""
    robot = load_urdf("apollo_arm")
    assert difference(robot) < 1e-12
    assert build(robot).notes == ()


@pytest.mark.parametrize("name", ["panda", "iiwa14", "kuka_lwr4", "ur10e"])
def test_real_arms(name, real_data):
    """So are those of published URDFs of real arms."""
    assert difference(load_urdf(real_data(f"urdf/{name}.urdf"))) < 1e-12


def test_a_tree_that_slides():
    """So are those of branches and sliding joints; the URDF's damping and friction are left out."""
    assert difference(tree()) < 1e-12


def test_links_that_no_body_could_be():
    """Links without mass, or with inertias that break the triangle inequality, stay exactly as they are as long as
    the arm as a whole can move."""
    robot = load_urdf("apollo_arm")
    inertial = np.array(robot.inertial)
    inertial[2] = 0.0
    inertial[3, 4:] = [0.3, 0.0, 0.1, 0.0, 0.0, 0.1]  # moments 0.3, 0.1, 0.1 about the origin
    inertial[3, 1:4] = 0.0
    broken = replace(robot, inertial=inertial)
    assert difference(broken) < 1e-12
    assert build(broken).notes == ()


def test_a_joint_that_moves_nothing():
    """A joint with nothing to move gets the least inertia that can be integrated, and a note names it and no other."""
    robot = load_urdf("apollo_arm")
    empty = replace(robot, inertial=np.vstack([robot.inertial[:-1], np.zeros(10)]))
    arm = build(empty)
    (note,) = arm.notes
    assert "arm_joint_7" in note and "arm_joint_6" not in note
    np.testing.assert_allclose(arm.model.dof_armature, LEAST_INERTIA * np.eye(7)[6], atol=2 * LEAST_INERTIA)
    data = mujoco.MjData(arm.model)
    for q in np.random.default_rng(1).uniform(-3, 3, (20, 7)):
        assert np.linalg.eigvalsh(mass_matrix(arm.model, data, q)).min() > 0
