"""What names of columns say."""

import pytest

from invdyn_cli.formats.units import canonical
from invdyn_cli.formats.words import meaning

NAMES = {
    # name: quantity, joint, commanded, unit
    "actual_q_0": ("q", "0", False, ""),
    "target_q_5": ("q", "5", True, ""),
    "actual_current_3": ("current", "3", False, ""),
    "target_moment_1": ("tau", "1", True, ""),
    "joint_1_position [deg]": ("q", "1", False, "deg"),
    "jnt1_angle": ("q", "1", False, ""),
    "j3_quill_pos": ("q", "j3_quill", False, ""),
    "joint1_base_torque": ("tau", "joint1_base", False, ""),
    "pos_j1": ("q", "1", False, ""),
    "q1": ("q", "1", False, ""),
    "dq1": ("qd", "1", False, ""),
    "ddq_2": ("qdd", "2", False, ""),
    "tau_1": ("tau", "1", False, ""),
    "tau_J_d_1": ("tau", "1", True, ""),
    "q_d_1": ("q", "1", True, ""),
    "effort": ("tau", "", False, ""),
    "current_mA": ("current", "", False, "mA"),
    "position/0": ("q", "0", False, ""),
    "q[3]": ("q", "3", False, ""),
    "shoulder_pan.pos": ("q", "shoulder_pan", False, ""),
    "observation.state/shoulder_pan.pos": ("q", "shoulder_pan", False, ""),
    "wrist_1_joint_position": ("q", "wrist_1_joint", False, ""),
    "JointPosition4": ("q", "4", False, ""),
    "elbow_velocity_deg_s": ("qd", "elbow", False, "deg/s"),
    "joint_2_acc_rad_s_2": ("qdd", "2", False, "rad/s^2"),
    "joint2_torque_Nm": ("tau", "2", False, "N m"),
    "torque (N m)": ("tau", "", False, "N m"),
    "time_ms": ("t", "", False, "ms"),
    "t [s]": ("t", "", False, "s"),
    "timestamp_ns": ("t", "", False, "ns"),
    "actual_TCP_pose_0": ("", "", False, ""),
    "joint_temperatures_2": ("", "", False, ""),
    "position_error_1": ("", "", False, ""),
    "/joint_states/shoulder_pan_joint/position": ("q", "shoulder_pan_joint", False, ""),
    "field.effort0": ("tau", "0", False, ""),
    "field.header.stamp": ("t", "", False, ""),
    "J2 Torque (Nm)": ("tau", "2", False, "N m"),
    "A2_Winkel_ist": ("q", "2", False, ""),
    "Winkel_A2_grad": ("q", "2", False, "deg"),
    "Zeit_ms": ("t", "", False, "ms"),
    "Achse3_Winkel_soll": ("q", "3", True, ""),
    "A1_Strom_mA": ("current", "1", False, "mA"),
    "axe_2_couple": ("tau", "2", False, ""),
    "Temperatur": ("", "", False, ""),
    "robot_state": ("", "", False, ""),
    "robot_mode": ("", "mode", False, ""),
    "unix_time": ("t", "", False, ""),
    "epoch": ("t", "", False, ""),
    "host_timestamp_ns": ("t", "", False, "ns"),
    "time_s": ("t", "", False, "s"),
    "t_ms": ("t", "", False, "ms"),
    "bend/eff": ("tau", "bend", False, ""),
    "j3_quill force [N]": ("tau", "j3_quill", False, "N"),
    "force_x": ("", "", False, ""),
    "force_3": ("", "", False, ""),
    "tcp_force_z": ("", "", False, ""),
    "T_position [deg]": ("q", "T", False, "deg"),
    "tau_T": ("tau", "T", False, ""),
    "tau_q2": ("tau", "q2", False, ""),
    "dq_q1x": ("qd", "q1x", False, ""),
    "q_q1x": ("q", "q1x", False, ""),
    "q_A": ("q", "A", False, ""),
    "current_A": ("current", "", False, "A"),
    "q_D": ("q", "D", False, ""),
    "Q_D": ("q", "", True, ""),
    "Desired_q_1": ("q", "1", True, ""),
    "joint_3_pos_mm": ("q", "3", False, "mm"),
    "lift_vel_m_s": ("qd", "lift", False, "m/s"),
    "joint_3_acc_mm_s2": ("qdd", "3", False, "mm/s^2"),
    "joint_3_torque_N": ("tau", "3", False, "N"),
    "tau_n": ("tau", "n", False, ""),
}


@pytest.mark.parametrize("name", NAMES)
def test_names(name):
    """Names of drivers and of people mean the quantity, joint, unit and side that their makers document."""
    found = meaning(name)
    assert (found.quantity, found.joint, found.commanded, found.unit) == NAMES[name]


def test_spellings_of_units():
    """Units are read as people write them."""
    written = {"°": "deg", "Degrees": "deg", "Nm": "N m", "N·m": "N m", "N*mm": "N mm", "µs": "us", "%": "percent",
               "deg/s": "deg/s", "rad/s²": "rad/s^2", "mA": "mA", "parsec": None}  # fmt: skip
    assert {text: canonical(text) for text in written} == written
