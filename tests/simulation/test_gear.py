"""Teeth of a gear with play that yield: they carry the load on a spring, and bounce."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from invdyn_cli.errors import UsageError
from invdyn_cli.simulation import gear
from invdyn_cli.simulation.arm import build

GAP, STIFFNESS, STEP = 0.01, 1e4, 2e-5


def swing(robot, damping_ratio, start, gravity, seconds):
    """Angle and speed (T,) of the last joint's link against its motor, which an endless rotor holds; the other joints
    have endless rotors, too."""
    robot, last = replace(robot, gravity=gravity), robot.dofs - 1
    heavy = np.full(robot.dofs, 1e9)
    arm = build(robot, geared=[last], armature=heavy, timestep=STEP)
    made = gear.chosen(robot, last, gap=GAP, stiffness=STIFFNESS, damping_ratio=damping_ratio, rotor=1e9)
    gear.put(arm, [made])
    data = mujoco.MjData(arm.model)
    stops, dof = gear.Stops(arm, [replace(made, rotor=gear.carried(robot)[last])], data), int(arm.gear[0])
    data.qpos[dof], data.qvel[dof] = start
    rows = []
    for _ in range(round(seconds / STEP)):
        stops.look_ahead()
        mujoco.mj_step(arm.model, data)
        rows.append((data.qpos[dof], data.qvel[dof]))
    return np.array(rows).T


@pytest.mark.parametrize("damping_ratio", [0.02, 0.1, 0.3])
def test_teeth_bounce(apollo4, damping_ratio):
    """A link that meets the teeth leaves them with the speed that a spring and a damper, followed on paper, give it
    back until their push ends: a flank does not pull."""
    speed = swing(apollo4, damping_ratio, (0.0, 1.0), np.zeros(3), 0.01)[1]
    r, root = damping_ratio, np.sqrt(1 - damping_ratio**2)
    until = np.arctan2(2 * r * root, 2 * r**2 - 1)  # [rad] where stiffness x + damping v = 0
    left = np.exp(-r * until / root) * (np.cos(until) - r / root * np.sin(until))
    assert speed[-1] == pytest.approx(left, rel=0.02)  # 0.02: a hundred steps in a swing


def test_a_link_rubs_itself(apollo4):
    """Within its play, which it does not cross here, a link slows down as its dry and its viscous friction have it,
    followed on paper; a motor that turns with it, too."""
    robot, last = replace(apollo4, gravity=np.zeros(3)), apollo4.dofs - 1
    coulomb, damping, seconds = 0.3, 0.2, 0.02
    arm = build(robot, geared=[last], armature=np.full(robot.dofs, 1e9), timestep=STEP)
    made = gear.chosen(robot, last, gap=1.0, rotor=1e9, link_coulomb=coulomb, link_damping=damping)
    gear.put(arm, [made])
    data = mujoco.MjData(arm.model)
    stops, dof, motor = gear.Stops(arm, [made], data), int(arm.gear[0]), int(arm.motor[last])
    for turning in (0.0, 2.0):  # of the motor
        data.qpos[dof], data.qvel[dof], data.qvel[motor] = -0.4, 1.0, turning
        first = 1.0 + turning
        for _ in range(round(seconds / STEP)):
            data.qfrc_applied[motor] = 0.0
            stops.look_ahead()
            mujoco.mj_step(arm.model, data)
        slowed = np.exp(-damping * seconds / gear.carried(robot)[last])
        expected = (first + coulomb / damping) * slowed - coulomb / damping
        assert data.qvel[dof] + data.qvel[motor] == pytest.approx(expected, rel=2e-3)


def test_teeth_carry_the_load_on_a_spring(apollo4):
    """Under the weight of the link the teeth yield by the weight over their stiffness."""
    gravity = np.array([6.0, 6.0, -5.0])
    angle = swing(apollo4, 0.5, (0.0, 0.0), gravity, 0.4)[0]
    arm = build(replace(apollo4, gravity=gravity))
    data = mujoco.MjData(arm.model)
    mujoco.mj_forward(arm.model, data)
    weight = float(data.qfrc_bias[-1])
    assert abs(weight) > 0.1
    assert angle[-1] == pytest.approx(-np.sign(weight) * GAP / 2 - weight / STIFFNESS, rel=1e-3)


def test_teeth_too_stiff_for_the_steps_are_refused(apollo4):
    """They would throw the arm about: refused, with what the steps can follow."""
    arm = build(apollo4, geared=[3], timestep=1e-3)
    made = gear.chosen(apollo4, 3, gap=GAP, stiffness=1e6)
    with pytest.raises(
        UsageError, match=r"stiffness=1e\+06 N m/rad with steps of 1e\+03 us; allowed: at most .*substeps"
    ):
        gear.Stops(arm, [made], mujoco.MjData(arm.model))
