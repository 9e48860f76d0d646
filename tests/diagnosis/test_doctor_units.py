"""Positions that are neither in radians nor in degrees, of all joints or of one, are corrected or said to be wrong."""

from dataclasses import replace

import numpy as np
import pytest

from invdyn_cli.diagnosis import doctor
from invdyn_cli.diagnosis.checks.units import MotionUnits
from invdyn_cli.diagnosis.checks.values import Outliers
from invdyn_cli.recording.rows import taken
from invdyn_cli.robots import load_urdf
from tests.diagnosis.sick import changed, delayed, seen, sound


@pytest.fixture(scope="module")
def arm():
    """Four joints of the built-in arm, the others locked."""
    return load_urdf("apollo_arm", joints=[f"arm_joint_{i}" for i in (1, 2, 3, 4)])


@pytest.fixture(scope="module")
def log(arm):
    return sound(arm, seconds=15)


def told(log, robot):
    """{(channel, joint): factor} of what fails."""
    found = [c for c in MotionUnits().examine(log, robot) if c.severity == "fail"]
    assert all(c.check == "unit_error" and c.seen and c.meaning and c.advice for c in found)
    return {(c.threshold["channel"], c.joint): c.threshold["factor"] for c in found}


COUNTS = 2**13 / (2 * np.pi)


@pytest.mark.parametrize("with_robot", [True, False])
@pytest.mark.parametrize("factor", [1e3, COUNTS])
def test_large_units_are_found_and_corrected(factor, with_robot, log, arm):
    """Milliradians, and counts of a 13 bit encoder: by the torque, or without a robot by the velocities."""
    robot = arm if with_robot else None
    bad = changed(log, q=factor * log.trajectories[0].q)
    assert told(bad, robot) == {("q", None): pytest.approx(factor)}
    corrected, _ = MotionUnits().correct(bad, MotionUnits().examine(bad, robot), robot)
    np.testing.assert_allclose(corrected.trajectories[0].q, log.trajectories[0].q)


def test_velocities_in_another_unit_do_not_mislead(log, arm):
    """q in milliradians and qd in revolutions per minute: the torque tells the first, its derivative the second."""
    raw = log.trajectories[0]
    assert raw.qd is not None
    bad = changed(log, q=1e3 * raw.q, qd=30 / np.pi * raw.qd)
    assert told(bad, arm) == {("q", None): 1e3, ("qd", None): pytest.approx(30 / np.pi)}


def test_torques_of_the_opposite_sign_do_not_mislead(log, arm):
    """A torque turned round, and counts of a 13 bit encoder with velocities beside them: the scale is that of the
    velocities, though a larger one makes the motion so small that one joint alone is judged."""
    raw = log.trajectories[0]
    bad = changed(log, q=COUNTS * raw.q, tau=raw.tau * np.array([1, 1, -1, 1]))
    assert told(bad, arm) == {("q", None): pytest.approx(COUNTS)}


def test_unknown_units_are_said_to_be_wrong(log):
    """Counts of another scale, without a robot and without velocities: a failure, and nothing is changed."""
    bad = changed(log, q=12345.6 * log.trajectories[0].q, qd=None)
    assert told(bad, None) == {("q", None): None}
    corrected, notes = MotionUnits().correct(bad, MotionUnits().examine(bad, None), None)
    assert notes == [] and corrected.trajectories == bad.trajectories


@pytest.mark.parametrize(("factor", "channel"), [(0.5 / np.pi, "q"), (180 / np.pi, "qd"), (30 / np.pi, "qd")])
def test_one_joint_in_another_unit(factor, channel, log, arm):
    """A position in revolutions, and velocities in degrees per second or rpm, of one joint among sound ones."""
    x = np.array(getattr(log.trajectories[0], channel))
    x[:, 2] *= factor
    assert told(changed(log, **{channel: x}), arm) == {
        ("q" if channel == "q" else "qd", log.joints[2]): pytest.approx(factor)
    }


def test_all_joints_in_revolutions(log):
    """Without a robot velocities tell that positions are in revolutions."""
    assert told(changed(log, q=log.trajectories[0].q / (2 * np.pi)), None) == {("q", None): pytest.approx(0.5 / np.pi)}


def test_single_wild_positions_are_no_unit(log, arm):
    """Five samples of a million are left for the outliers."""
    q = log.trajectories[0].q.copy()
    q[100::600] = 1e6
    assert told(changed(log, q=q), arm) == {}


def test_gaps_do_not_hide_outliers(log):
    """A log that was interrupted twenty times is a time series still: its outliers are found."""
    raw = log.trajectories[0]
    tau = raw.tau.copy()
    tau[777, 1] += 20 * np.ptp(tau[:, 1])
    rows = np.flatnonzero(np.arange(3000) % 150 < 60)
    one = taken(replace(raw, tau=tau), rows)
    found = [c for c in Outliers().examine(replace(log, trajectories=(one,)), None) if c.severity == "warn"]
    assert [(c.joint, c.value) for c in found] == [(log.joints[1], 1)]


@pytest.mark.parametrize("with_robot", [True, False])
def test_degrees_of_all_joints_of_which_some_hardly_tell(with_robot, log, arm):
    """All q in degrees beside qd in rad/s; one joint stays within its limits and its qd is 10 % too small, as a slow
    filter of the drive makes it; one stands still: the unit is that of all joints."""
    raw = log.trajectories[0]
    q, qd = np.degrees(raw.q), np.array(raw.qd)
    q[:, 2], qd[:, 2] = 0.05 * q[:, 2], 0.9 * 0.05 * qd[:, 2]
    q[:, 3], qd[:, 3] = q[0, 3], 0.0
    bad = changed(log, q=q, qd=qd)
    found = [c for c in MotionUnits().examine(bad, arm if with_robot else None) if c.severity == "fail"]
    assert [(c.joint, c.threshold["factor"]) for c in found] == [(None, pytest.approx(180 / np.pi))]


@pytest.mark.parametrize("torque", ["as it is", "noise"])
def test_degrees_of_one_joint_beside_velocities_in_radians(torque, log, arm):
    """Its position is in degrees: limits and velocity tell, even where no torque does. Its velocity is not blamed."""
    raw = log.trajectories[0]
    q, tau = raw.q.copy(), raw.tau
    q[:, 1] *= 180 / np.pi
    if torque == "noise":
        tau = np.random.default_rng(0).normal(size=tau.shape)
    assert told(changed(log, q=q, tau=tau), arm) == {("q", log.joints[1]): pytest.approx(180 / np.pi)}


def test_a_velocity_that_was_converted_twice(log, arm):
    """The position is within its limits and the torque fits: the velocity is wrong. Without a robot both are named, and
    nothing is changed."""
    raw = log.trajectories[0]
    assert raw.qd is not None
    bad = changed(log, qd=raw.qd * np.array([1, np.pi / 180, 1, 1]))
    assert told(bad, arm) == {("qd", log.joints[1]): pytest.approx(np.pi / 180)}
    found = MotionUnits().examine(bad, None)
    (doubted,) = (c for c in found if c.severity == "warn")
    assert doubted.joint == log.joints[1] and "or qd is too small" in doubted.meaning
    assert MotionUnits().correct(bad, found, None) == (bad, [])


@pytest.mark.parametrize("factor", [180 / np.pi, 0.5 / np.pi])
def test_a_joint_that_hardly_moves(factor, log):
    """A joint that moves by hundredths of a radian, its q alone in degrees or revolutions, is told by qd and qdd, which
    come 40 ms late as a filter makes them."""
    raw = log.trajectories[0]
    small = np.where(np.arange(len(log.joints)) == 0, 0.005, 1.0)
    assert raw.qd is not None
    q = raw.q * small
    qd, qdd = (delayed(x * small, raw.t, 0.04) for x in (raw.qd, np.gradient(raw.qd, raw.t, axis=0)))
    bad = changed(log, q=q * np.where(small < 1, factor, 1.0), qd=qd, qdd=qdd)
    corrected, examination = doctor.correct(bad, None)
    (found,) = seen(examination, "unit_error", least="warn")
    assert (found.joint, found.threshold["channel"]) == (log.joints[0], "q")
    np.testing.assert_allclose(corrected.trajectories[0].q, q, rtol=1e-6)


def test_commands_keep_their_own_unit(log, arm):
    """q in degrees beside q_ref in radians: q alone is corrected, and nothing is said of q_ref."""
    raw = log.trajectories[0]
    corrected, examination = doctor.correct(changed(log, q=raw.q * 180 / np.pi, q_ref=raw.q), arm)
    assert [c.threshold["channel"] for c in seen(examination, "unit_error", least="warn")] == ["q"]
    np.testing.assert_array_equal(corrected.trajectories[0].q_ref, raw.q)


def test_positions_of_a_fifth_of_a_second(log, arm):
    """Too few rows for a derivative: counts are found by the limits alone, and said to be no unit that is known."""
    few = replace(log, trajectories=(taken(log.trajectories[0], np.arange(40)),))
    bad = changed(few, q=1e5 * few.trajectories[0].q)
    (found,) = [c for c in MotionUnits().examine(bad, arm) if c.severity == "fail"]
    assert found.threshold["channel"] == "q" and "encoder counts" in found.meaning
