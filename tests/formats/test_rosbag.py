"""Bags: which topic, which message, which joints."""

import numpy as np
import pytest

from invdyn_cli.errors import LogError
from invdyn_cli.formats import rosbag
from invdyn_cli.formats.reading import read_log
from tests.formats.recordings import EPOCH, JOINTS, bag2, recording

STATE = "control_msgs/msg/JointTrajectoryControllerState"
POINTS = "std_msgs/Header header\nstring[] joint_names\n" + "\n".join(
    f"trajectory_msgs/JointTrajectoryPoint {name}" for name in ("desired", "actual", "error")
)
RELEASES = {"first": POINTS, "later": f"{POINTS}\ntrajectory_msgs/JointTrajectoryPoint output\nstring[] multi_dof\n"}
"""The message before and after it grew behind its first fields."""


def controller_bag(path, release: str, ros1: bool):
    """A bag of a trajectory controller: desired positions 0.01 rad beside the measured ones."""
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    data = recording()
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(RELEASES[release], STATE))
    kinds = store.types
    point, duration = kinds["trajectory_msgs/msg/JointTrajectoryPoint"], kinds["builtin_interfaces/msg/Duration"]
    writer = rosbag1.Writer(path) if ros1 else rosbag2.Writer(path, version=8)
    none = np.zeros(0)
    with writer as bag:
        connection = bag.add_connection("/controller/state", STATE, typestore=store)
        for k, t in enumerate(data["t"]):
            stamp = EPOCH + round(t * 1e9)
            time = kinds["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
            head = kinds["std_msgs/msg/Header"](**{"seq": k} if ros1 else {}, stamp=time, frame_id="base")
            q, qd, tau = (data[x][k] for x in ("q", "qd", "tau"))
            points = [point(x, qd, none, tau, duration(0, 0)) for x in (q + 0.01, q, q * 0)]
            more = [points[0], ["x"]] if release == "later" else []
            message = kinds[STATE](head, list(JOINTS), *points, *more)
            raw = store.serialize_ros1(message, STATE) if ros1 else store.serialize_cdr(message, STATE)
            bag.write(connection, stamp, raw)
    return path


@pytest.mark.parametrize("release", RELEASES)
@pytest.mark.parametrize("ros1", [True, False])
def test_controller_states(release, ros1, tmp_path):
    """A controller's state gives measured q, qd, tau and the desired positions as q_ref, in any release."""
    data = recording()
    (one,) = read_log(controller_bag(tmp_path / "run.bag", release, ros1)).trajectories
    np.testing.assert_allclose(one.q_ref, data["q"] + 0.01, atol=1e-12)
    for channel in ("t", "q", "qd", "tau"):
        np.testing.assert_allclose(getattr(one, channel), data[channel], atol=1e-9)


def test_topics(tmp_path):
    """/joint_states is taken beside others; without it one must be named, and a wrong name is told with the right."""
    data = {name: x[:20] for name, x in recording().items()}
    known = bag2(tmp_path / "a", data, topics=("/left/joint_states", "/joint_states"))
    assert len(rosbag.read(known, 1e9)[0].columns["stamp"]) == 20
    two = bag2(tmp_path / "b", data, topics=("/left/joint_states", "/right/joint_states"))
    with pytest.raises(LogError, match=r"several topics .*/left/joint_states, /right/joint_states.*topic="):
        rosbag.read(two, 1e9)
    assert rosbag.read(two, 1e9, "/left/joint_states")
    with pytest.raises(LogError, match="did you mean '/left/joint_states'"):
        rosbag.read(two, 1e9, "/lft/joint_states")


def test_damaged_bags(tmp_path):
    """A bag that is cut off or is none is one line."""
    folder = bag2(tmp_path, {name: x[:200] for name, x in recording().items()})
    file = next(folder.glob("*.db3"))
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    with pytest.raises(LogError, match="cannot be read"):
        rosbag.read(folder, 1e9)
    for name in ("run.bag", "run.mcap"):
        (tmp_path / name).write_bytes(b"nothing of a bag" * 20)
        with pytest.raises(LogError, match="cannot be read"):
            rosbag.read(tmp_path / name, 1e9)


def test_a_compressed_file(tmp_path):
    """A bag that is compressed as a whole, which may inflate to any size, is refused with the way out."""
    folder = bag2(tmp_path, {name: x[:20] for name, x in recording().items()})
    meta = folder / "metadata.yaml"
    text = meta.read_text().replace("compression_mode: ''", "compression_mode: FILE")
    meta.write_text(text.replace("compression_format: ''", "compression_format: zstd"))
    assert "FILE" in meta.read_text()
    with pytest.raises(LogError, match="ros2 bag convert"):
        rosbag.read(folder, 1e9)


def test_a_real_bag(real_data):
    """A UR10's bag is read whole: 3441 messages at 125 Hz, positions and velocities that agree."""
    log = read_log(real_data("rosbag2/ur10_exciting_trajectory"))
    (one,) = log.trajectories
    assert one.q.shape == (3441, 6) and log.rate == pytest.approx(125, rel=1e-3)
    assert log.joints[0] == "shoulder_pan_joint" and one.t[-1] == pytest.approx(27.52, abs=0.01)
    off = np.gradient(one.q, one.t, axis=0) - one.qd
    assert np.sqrt((off**2).mean()) < 0.05 * one.qd.std()
