"""Real logs raise no false alarm: what is said of them is known to be so."""

import numpy as np
import pytest

from invdyn_cli.diagnosis import doctor
from invdyn_cli.logfile import read_log, refuse_defects
from invdyn_cli.robots import load_urdf
from tests.diagnosis.sick import seen

LOGS = {
    "panda": None,
    "kuka_lwr4": None,
    "ur10e": ("pair1_loaded", "train_20_02_05_20sec_8harm", "jointwise_20_01_14_link_1"),
    "iiwa14": ("friction_joint_1_vel_p6", "friction_joint_5_vel_p8", "joint_2_to_7_dynamic_motion"),
    "iiwa14 friction 1": ("friction_joint_1_vel_p6",),
    "iiwa14 friction 5": ("friction_joint_5_vel_p9",),
    "sarcos": None,
}
ABOUT_THE_TORQUE = ("unit_error", "sign_error", "joint_order", "gravity_removed", "model_mismatch")


@pytest.mark.parametrize("name", LOGS)
def test_no_false_alarm(name, real_data):
    """No check fails, no unit, sign, order, gravity or model is doubted, and the corrected log can be computed with; on
    the LWR, whose joints move in phase, other orders are as likely, and are told."""
    log = read_log(real_data(f"{name.split()[0]}.h5"), LOGS[name])
    robot = load_urdf(log.urdf, joints=list(log.joints)) if log.urdf else None
    corrected, examination = doctor.correct(log, robot)
    assert [c for c in examination.checks if c.severity == "fail" or c.meaning == doctor.FAULT] == []
    doubted = [c for kind in ABOUT_THE_TORQUE for c in seen(examination, kind)]
    doubted = [c for c in doubted if (c.threshold or {}).get("channel") != "q_ref"]
    assert [c for c in doubted if (name, c.check, c.severity) != ("kuka_lwr4", "joint_order", "note")] == []
    assert examination.usable
    refuse_defects(corrected)


def test_what_is_known_of_them(real_data):
    """The Panda's stamps jitter and samples repeat; the iiwa's torques come 18 to 20 ms after the motion."""
    log = read_log(real_data("panda.h5"))
    examination = doctor.examine(log, None)
    assert seen(examination, "clock_jitter") and seen(examination, "duplicates")
    log = read_log(real_data("iiwa14.h5"), ["joint_2_to_7_dynamic_motion"])
    (found,) = seen(doctor.examine(log, load_urdf(log.urdf)), "time_offset", least="warn")
    assert 0.015 < found.value < 0.022


def test_what_the_lwr_says_of_its_commands(real_data):
    """On the LWR's two runs q_ref was converted from degrees once too often, and stands 1.41 s before q: correlating
    single joints by hand says 281 and 282 samples of 5 ms on all of them, and a slope of 57.30."""
    examination = doctor.examine(read_log(real_data("kuka_lwr4.h5")), None)
    units = seen(examination, "unit_error", least="warn")
    assert [c.threshold["factor"] for c in units] == pytest.approx([np.pi / 180] * 2)
    assert [c.value for c in seen(examination, "time_offset")] == pytest.approx([1.405, 1.411], abs=2e-3)
    assert seen(examination, "sign_error") == []


def test_poses_are_told_from_motions(real_data):
    """A log of static poses is no time series."""
    log = read_log(real_data("iiwa14.h5"), ["static_joints_2_to_7_b"])
    examination = doctor.examine(log, load_urdf(log.urdf))
    assert not examination.usable
    assert "poses" in seen(examination, "derivative_consistency")[0].meaning
