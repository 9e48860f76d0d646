"""What is wrong with a log as a whole: several recordings in one, channels that are empty."""

import numpy as np
import pytest

from invdyn_cli.diagnosis import doctor
from invdyn_cli.robots import load_urdf
from tests.diagnosis.sick import changed, seen, sound


@pytest.fixture(scope="module")
def arm(apollo4):
    """What is wrong here is the same for any number of joints."""
    return apollo4


@pytest.fixture(scope="module")
def log(arm):
    """A sound log of it, 30 s at 200 Hz."""
    return sound(arm)


def test_a_clock_that_restarts(log, arm):
    """Three recordings in one are read apart, and every row of them is kept; no row is told as defective."""
    t = log.trajectories[0].t
    bad = changed(log, t=np.where(t < 9, t, np.where(t < 20, t - 9, t - 20)))
    corrected, examination = doctor.correct(bad, arm)
    (found,) = seen(examination, "duplicates")
    assert (found.severity, found.value) == ("fail", 2) and "restarts 2 times, first in row 1800" in found.seen
    assert doctor.done(examination)[0] == "run: read as 3 recordings, parted where the clock restarts"
    assert [len(x.t) for x in corrected.trajectories] == [1800, 2200, 2000] and examination.usable


def test_no_torques(log, arm):
    """A log without any torque is told so, not to leave rows out."""
    none = changed(log, tau=np.full_like(log.trajectories[0].tau, np.nan))
    (found,) = seen(doctor.examine(none, arm), "not_finite")
    assert found.seen == "there are no torques" and "data.columns" in found.advice


def test_an_arm_under_a_ceiling():
    """Torques of several joints run against those of an upright arm: the mounting is told, no sign, and it fits."""
    upright, hanging = load_urdf("apollo_arm", dofs=6), load_urdf("apollo_arm", dofs=6, base_rpy=[np.pi, 0, 0])
    slow = sound(upright, truth=hanging, seconds=60.0)
    examination = doctor.examine(slow, upright)
    assert not seen(examination, "sign_error")
    (said,) = doctor.doubts(examination)
    assert "robot.gravity=[0,0,9.81], or robot.base_rpy" in said
    assert not seen(doctor.examine(slow, hanging), "sign_error")
