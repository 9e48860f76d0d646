"""Joints are found by their names, in any order of columns, of `joints` and of the robot."""

import itertools

import numpy as np
import pytest

from invdyn_cli.data.recorded import RealLog
from invdyn_cli.errors import RobotError
from invdyn_cli.formats.joint_names import matched
from invdyn_cli.functions.inputs import robot_of
from invdyn_cli.robots import load_urdf
from tests.formats.recordings import write_csv

JOINTS = ("j1_arm", "j2_fore", "j3_quill")
ORDER = (2, 0, 1)
ORDERS = list(itertools.permutations(range(3)))
BODY = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
T = np.arange(0, 4, 0.01)


def value(k):
    """(T,) the position of joint k; ten times that is its torque."""
    return (k + 1) * np.sin(2 * T + k)


@pytest.fixture
def urdf(tmp_path):
    """An arm of the joints JOINTS from the base on."""
    text = f'<robot name="a"><link name="l0">{BODY}</link>'
    for k, name in enumerate(JOINTS):
        text += f'<link name="l{k + 1}">{BODY}</link><joint name="{name}" type="revolute"><parent link="l{k}"/>'
        text += f'<child link="l{k + 1}"/><axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="9" velocity="9"/>'
        text += "</joint>"
    path = tmp_path / "arm.urdf"
    path.write_text(text + "</robot>")
    return path


def csv(folder, pattern=lambda name: name):
    """A table whose columns stand in the order ORDER, the joints' names written as `pattern` does."""
    columns = {"t": T}
    columns |= {f"{pattern(JOINTS[k])}_pos": value(k) for k in ORDER}
    columns |= {f"{pattern(JOINTS[k])}_torque": 10 * value(k) for k in ORDER}
    return write_csv(folder / "log.csv", columns)


def read(path, urdf, columns=None, **robot):
    """The log in the robot's order of joints, as `invdyn check` reads it, and its notes."""
    source = RealLog(str(path), columns=columns)
    made = load_urdf(urdf, **robot) if robot else robot_of(urdf, source.recorded(None).log)
    found = source.recorded(made)
    assert found.log.joints == JOINTS
    return found


def assert_right(found):
    one = found.log.trajectories[0]
    for k in range(3):
        np.testing.assert_allclose(one.q[:, k], value(k))
        np.testing.assert_allclose(one.tau[:, k], 10 * value(k))


WRITTEN = {
    "as in the URDF": lambda name: name,
    "other case and separators": lambda name: name.upper().replace("_", "-"),
    "a cut prefix": lambda name: name[3:],
    "a longer prefix": lambda name: f"cell/{name}",
}


@pytest.mark.parametrize("how", WRITTEN)
def test_columns_in_any_order(how, tmp_path, urdf):
    """Columns are put in the robot's order by name, also with a prefix or without the URDF's."""
    assert_right(read(csv(tmp_path, WRITTEN[how]), urdf))


@pytest.mark.parametrize("order", ORDERS, ids=str)
def test_joints_of_the_robot_in_any_order(order, tmp_path, urdf):
    """robot.joints chooses joints; which column each of them is, the columns' names say."""
    assert_right(read(csv(tmp_path), urdf, joints=[JOINTS[k] for k in order]))


@pytest.mark.parametrize("order", ORDERS, ids=str)
@pytest.mark.parametrize("how", ["as in the URDF", "a cut prefix"])
def test_joints_of_the_map_in_any_order(order, how, tmp_path, urdf):
    """`joints` of a column map that are the columns' own names, or nearly, are an order and not new names."""
    assert_right(read(csv(tmp_path, WRITTEN[how]), urdf, {"joints": [JOINTS[k] for k in order]}))


@pytest.mark.parametrize("order", ORDERS, ids=str)
def test_torques_given_in_another_order(order, tmp_path, urdf):
    """Given columns of torques are put beside the positions of the same joints, with their signs; a note says so."""
    given = {"columns": [f"{JOINTS[k]}_torque" for k in order], "sign": [-1 if k == 0 else 1 for k in order]}
    found = read(csv(tmp_path), urdf, {"tau": given})
    np.testing.assert_allclose(
        found.log.trajectories[0].tau, np.stack([-10 * value(0), 10 * value(1), 10 * value(2)]).T
    )
    assert ("put in the order of the joints" in " ".join(found.log.history)) == (order != ORDER)


def test_unnamed_columns_in_the_order_of_the_robots_joints(tmp_path, urdf):
    """Columns with numbers alone are the joints in the order in which robot.joints names them; a note says which."""
    columns = {"t": T} | {f"q{i}": value(k) for i, k in enumerate(ORDER)}
    columns |= {f"tau{i}": 10 * value(k) for i, k in enumerate(ORDER)}
    found = read(write_csv(tmp_path / "log.csv", columns), urdf, joints=[JOINTS[k] for k in ORDER])
    assert_right(found)
    assert "are read as the robot's j3_quill, j1_arm, j2_fore, in this order" in " ".join(found.notes)


def test_names_against_the_order_are_refused(tmp_path, urdf):
    """Names of which one is like a joint at another place are not taken by position."""
    path = csv(tmp_path, lambda name: {"j1_arm": "first", "j2_fore": "second", "j3_quill": "quill"}[name])
    with pytest.raises(RobotError, match=r"quill resembles j3_quill.*data.columns=\{joints"):
        read(path, urdf, joints=list(JOINTS))


def test_names_that_leave_it_open():
    """Two joints like one name, and counts from 0 beside counts from 1, are no match."""
    assert matched(["wrist_1", "arm_1"], ["1", "2"]) is None
    assert matched(["0", "1"], ["j1", "j2"]) is None
    assert matched(["arm_1", "arm_2"], ["axis1", "axis2"]) is None  # another robot's
    assert matched(["joint_a2", "joint_a1"], ["a1", "a2"]) == [1, 0]
