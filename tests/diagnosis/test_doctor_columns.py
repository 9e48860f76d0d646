"""Order and signs of columns come from the physics: what is stated is right, and what cannot be told is not changed."""

import xml.etree.ElementTree as ET
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from experiments.arms import random_robot
from invdyn_cli.diagnosis import doctor
from invdyn_cli.diagnosis.checks.columns import JointOrder, SignError
from invdyn_cli.diagnosis.checks.description import Description
from invdyn_cli.diagnosis.checks.placeholders import doubtful_inertias
from invdyn_cli.diagnosis.checks.samples import nominal_torque
from invdyn_cli.diagnosis.checks.torques import GravityRemoved
from invdyn_cli.robots import load_urdf
from invdyn_cli.types import Check, Motion
from tests.commands import usually
from tests.diagnosis.sick import changed, seen, sound

COLUMNS = (JointOrder(), SignError())


@pytest.fixture(scope="module", params=usually([0], range(2)))
def drawn(request):
    """A generator, an arm of five joints, and a log of one that is up to 15 % off, with friction on every joint."""
    draw = np.random.default_rng(40 + request.param)
    robot = random_robot(draw, 5)
    truth = replace(robot, inertial=robot.inertial * draw.uniform(0.85, 1.15, robot.dofs)[:, None])
    return draw, robot, sound(robot, request.param, seconds=20, coulomb=0.2, truth=truth, channels=("qd",))


def put(log, order=None, q: Any = 1.0, tau: Any = 1.0, columns=None):
    """The log with its columns in another order, and signs."""
    raw = log.trajectories[0]
    order = np.arange(raw.q.shape[1]) if order is None else order
    columns = order if columns is None else columns
    return changed(log, q=raw.q[:, order] * q, qd=raw.qd[:, order] * q, tau=raw.tau[:, columns] * tau)


def right_or_ambiguous(found, order, columns):
    """Whether a finding states these orders, or names them among the likely ones."""
    known = [c.threshold for c in found if c.check == "joint_order" and isinstance(c.threshold, dict)]
    pairs = [(x["order"], x["columns"]) for x in known if "order" in x]
    pairs += [(x["order"], x["columns"]) for one in known for x in one.get("alike", ())]
    return (list(order), list(columns)) in pairs


def test_a_sound_log_states_nothing(drawn):
    """Friction on every joint and masses 15 % off are no other order and no sign."""
    _, robot, log = drawn
    found = doctor.examine(log, robot, COLUMNS)
    assert [c for c in found.checks if c.severity in ("warn", "fail")] == []


@pytest.mark.parametrize("down", [(0, 0, 1), (1, 0, 0)])
@pytest.mark.parametrize("seed", usually([3], range(3, 7)))
def test_a_base_that_is_mounted_otherwise(seed, down):
    """A log of an arm under a ceiling, or at a wall, read with the URDF of one on the floor: no column is turned or
    exchanged, the direction of gravity is told, and with it nothing is left to tell."""
    draw = np.random.default_rng(seed)
    robot = random_robot(draw, 6)
    hung = replace(robot, gravity=9.81 * np.array(down, float))
    truth = replace(hung, inertial=robot.inertial * draw.uniform(0.95, 1.05, robot.dofs)[:, None])
    log = sound(robot, seed, seconds=20, coulomb=0.2, truth=truth, channels=("qd",))
    checks = (*COLUMNS, Description())
    _, examination = doctor.correct(log, robot, checks=checks)
    assert not examination.corrections
    (said,) = doctor.doubts(examination)
    assert str(np.round(hung.gravity, 2).tolist()) in said
    assert doctor.doubts(doctor.examine(log, hung, checks)) == ()


def test_an_arm_under_a_ceiling():
    """Torques of several joints run against those of an upright arm: the mounting is told, no sign, and it fits."""
    upright, hanging = load_urdf("apollo_arm", dofs=6), load_urdf("apollo_arm", dofs=6, base_rpy=[np.pi, 0, 0])
    slow = sound(upright, truth=hanging, seconds=60.0)
    examination = doctor.examine(slow, upright)
    assert not seen(examination, "sign_error")
    (said,) = doctor.doubts(examination)
    assert "robot.gravity=[0,0,9.81], or robot.base_rpy" in said
    assert not seen(doctor.examine(slow, hanging), "sign_error")


def test_exchanged_joints(drawn):
    """Two joints exchanged, in the torques alone and in all columns: stated, or ambiguous with the truth; what is
    stated is corrected to the log as it was."""
    draw, robot, log = drawn
    straight = np.arange(robot.dofs)
    for whole in (True, False):
        a, b = draw.choice(robot.dofs, 2, replace=False)
        order = straight.copy()
        order[[a, b]] = order[[b, a]]
        bad = put(log, order) if whole else put(log, columns=order)
        corrected, found = doctor.correct(bad, robot, COLUMNS)
        assert right_or_ambiguous(found.checks, order if whole else straight, order), found.checks
        if any(c.check == "joint_order" and c.severity == "fail" for c in found.checks):
            np.testing.assert_array_equal(corrected.trajectories[0].tau, log.trajectories[0].tau)
            np.testing.assert_array_equal(corrected.trajectories[0].q, log.trajectories[0].q)


def test_positions_and_torques_in_orders_of_their_own(drawn):
    """Both are put in order, and both are told."""
    _, robot, log = drawn
    order, columns = [1, 0, 2, 3, 4], [0, 2, 1, 3, 4]
    found = [Check("joint_order", "fail", threshold={"order": order, "columns": columns})]
    corrected, told = JointOrder().correct(put(log, order, columns=columns), found, robot)
    np.testing.assert_array_equal(corrected.trajectories[0].q, log.trajectories[0].q)
    np.testing.assert_array_equal(corrected.trajectories[0].tau, log.trajectories[0].tau)
    a, b, c, *_ = robot.joints
    assert told == [
        f"position columns put in the robot's order: {b} -> {a}, {a} -> {b}",
        f"torque columns put in the robot's order: {c} -> {b}, {b} -> {c}",
    ]


def test_alphabetical_order_is_named(drawn):
    """Columns in the order in which ROS 2 publishes joint states are called that."""
    _, robot, log = drawn
    names = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2")
    robot, log = replace(robot, joints=names), replace(log, joints=names)
    alphabet = np.argsort(names)
    found = doctor.examine(put(log, alphabet), robot, COLUMNS)
    seen = [c for c in found.checks if c.check == "joint_order" and c.severity in ("warn", "fail")]
    assert len(seen) == 1 and "alphabetical, as ROS 2 publishes joint states" in seen[0].seen


@pytest.mark.parametrize("channel", ["tau", "q", "q, tau"])
def test_one_joint_with_the_opposite_sign(channel, drawn):
    """The torque, the position with its velocity, or all of one joint turned round: that joint and channel are named,
    or it is left, and named as one whose sign the motion does not show; no other joint is touched."""
    draw, robot, log = drawn
    joint = int(draw.integers(robot.dofs))
    sign = np.where(np.arange(robot.dofs) == joint, -1.0, 1.0)
    bad = put(log, q=sign if "q" in channel else 1.0, tau=sign if "tau" in channel else 1.0)
    found = doctor.examine(bad, robot, COLUMNS)
    mine = [c for c in found.checks if c.check == "sign_error"]
    stated = [(c.joint, c.threshold["channel"]) for c in mine if c.severity == "fail"]
    assert stated in ([(robot.joints[joint], channel)], [])
    if not stated:
        assert any(robot.joints[joint] in c.seen for c in mine if c.severity == "skipped") or (
            robot.joints[joint] in [c.joint for c in mine if c.severity == "warn"]
        ), found.checks


def test_placeholder_inertias(drawn):
    """Zero, round and repeated inertias are doubtful, those of a CAD program are not."""
    _, robot, _ = drawn
    assert not doubtful_inertias(robot).any()
    rows = np.array(robot.inertial)
    rows[1, 4:] = np.diag([0.1, 0.1, 0.1])[np.tril_indices(3)]
    rows[1, 1:4] = 0
    rows[2, 1:] = 0
    assert doubtful_inertias(replace(robot, inertial=rows)).tolist() == [False, True, True, False, False]


def test_placeholders_of_a_file_are_those_of_the_fit(drawn):
    """The URDF's text is judged by the same criterion: a sphere that is a hair off is one, as is a link's copy."""
    _, robot, _log = drawn
    root = ET.fromstring(robot.urdf)
    inertias = [x for x in root.iter("inertia")]
    inertias[1].attrib.update(ixx="0.1", iyy="0.1", izz="0.10000001", ixy="0", ixz="0", iyz="0")
    inertias[4].attrib.update(inertias[3].attrib)
    told = {c.seen.split(":")[0]: c.value for c in Description()._written(replace(robot, urdf=ET.tostring(root)))}
    assert told["equal moments of inertia on all axes"] == ["link2"]
    assert told["the same inertia as another link"] == ["link4", "link5"]


def test_gravity_is_missed_on_a_worn_arm(drawn):
    """Gravity taken out of torques with friction on every joint, of an arm that is 15 % off, is declared; with gravity
    in it nothing is."""
    _, robot, log = drawn
    raw = log.trajectories[0]
    still = np.zeros_like(raw.q)
    bad = changed(log, tau=raw.tau - nominal_torque(robot, Motion(raw.q, still, still))[0])
    check = (GravityRemoved(),)
    assert [c.severity for c in doctor.examine(bad, robot, check).checks] == ["fail"]
    assert [c.severity for c in doctor.examine(log, robot, check).checks] == ["ok"]


def test_a_tool_that_the_robot_lacks(drawn):
    """A URDF with a tool of 1 to 1.5 kg at the end, that the robot lacks, is told, its mass within a third; so are a
    base that leans by 15 to 40 degrees, and links without an inertia."""
    _, robot, log = drawn
    draw = np.random.default_rng(robot.dofs)  # that of the arm has been used by other tests, or has not
    mass = float(draw.uniform(1.0, 1.5))
    rows = np.array(robot.inertial)
    rows[-1] += mass * np.array([1, 0, 0, 0.1, 0.01, 0, 0.01, 0, 0, 0])
    found = doctor.examine(log, replace(robot, inertial=rows), (Description(),)).checks
    masses = [c.value for c in found if "end weighs" in c.seen]
    assert len(masses) == 1 and masses[0] == pytest.approx(-mass, rel=0.33), (masses, mass)
    angle = float(np.radians(draw.uniform(15, 40)))
    leaning = replace(robot, gravity=9.81 * np.array([np.sin(angle), 0.0, -np.cos(angle)]))
    tilts = [c.value for c in doctor.examine(log, leaning, (Description(),)).checks if "gravity fits" in c.seen]
    assert tilts == pytest.approx([np.degrees(angle)], abs=6)
    text = robot.urdf
    for name in ("ixx", "iyy", "izz"):
        text = text.replace(f'{name}="', f'{name}="0" {name}_was="', 1)
    found = doctor.examine(log, replace(robot, urdf=text), (Description(),)).checks
    assert [c.joint for c in found if "zero inertia" in c.seen] == [robot.joints[0]]


@pytest.mark.parametrize("seed", range(4))
def test_gravity_that_is_removed_from_three_joints(seed):
    """On an arm of three joints, 15 % off its URDF, that gravity loads more than its motion: gravity removed by the
    URDF's model is found; the same log with gravity raises nothing."""
    draw = np.random.default_rng(70 + seed)
    robot = random_robot(draw, 3)
    truth = replace(robot, inertial=robot.inertial * draw.uniform(0.85, 1.15, 3)[:, None])
    log = sound(robot, seed, seconds=20, truth=truth)
    raw = log.trajectories[0]
    _, gravity = nominal_torque(robot, Motion(raw.q, 0 * raw.q, 0 * raw.q))
    for bad, said in ((log, ["ok"]), (changed(log, tau=raw.tau - gravity), ["fail"])):
        found = doctor.examine(bad, robot, (GravityRemoved(),))
        assert [c.severity for c in found.checks] == said


def test_what_is_ambiguous_has_the_best_order_first():
    """Joints that move in phase, two of them exchanged: orders as likely are listed, the best of them first, and the
    log is left as it is."""
    draw = np.random.default_rng(3)
    robot = random_robot(draw, 5)
    t = np.arange(4000) / 200
    size = draw.uniform(0.2, 0.5, 5)
    q, qd, qdd = (x[:, None] * size for x in (np.sin(t), np.cos(t), -np.sin(t)))
    truth = replace(robot, inertial=robot.inertial * draw.uniform(0.7, 1.3, 5)[:, None])
    tau, _ = nominal_torque(truth, Motion(q, qd, qdd))
    tau += tau.std(0) * (0.3 * np.tanh(qd / 0.01) + 0.02 * draw.normal(size=tau.shape))
    order = np.array([0, 1, 2, 4, 3])
    log = changed(sound(robot, seconds=20), q=q[:, order], qd=qd[:, order], tau=tau[:, order])
    corrected, found = doctor.correct(log, robot, (JointOrder(),))
    (one,) = [c for c in found.checks if c.severity in ("note", "warn")]
    assert one.seen.startswith("ambiguous") and len(one.threshold["alike"]) > 1
    assert right_or_ambiguous(found.checks, order, order), one
    assert corrected.trajectories[0].q is log.trajectories[0].q
