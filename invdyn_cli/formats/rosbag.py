"""ROS bags: version 1 (.bag) and 2 (a folder, .db3, .mcap), one topic of joint states, a trajectory."""

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from invdyn_cli.errors import LogError, closest, listed, shortened
from invdyn_cli.formats import ros_messages
from invdyn_cli.formats.map_file import plain_yaml
from invdyn_cli.formats.ros_messages import CONTROLLER_STATE, JOINT_STATE
from invdyn_cli.formats.table import Table, Told, missing, refuse_size

READERS = {JOINT_STATE: ros_messages.joint_state, CONTROLLER_STATE: ros_messages.controller_state}
CHANNELS = {
    "position": Told("q", unit="rad"),
    "velocity": Told("qd", unit="rad/s"),
    "effort": Told("tau", unit="N m"),
    "command": Told("q_ref", unit="rad"),
}
BY = "the message's definition"


def is_bag(folder: Path) -> bool:
    """Whether a folder is a bag of ROS 2."""
    return (folder / "metadata.yaml").is_file() and any(x.suffix in (".db3", ".mcap") for x in folder.iterdir())


def read(path: Path, limit: float, topic: str = "") -> tuple[Table, ...]:
    """The table of one topic: columns "stamp" and "received" [ns], "position/JOINT", "velocity/JOINT", "effort/JOINT".

    Raises:
        LogError: if it cannot be read, holds more than `limit` [bytes], or no topic, or several, may be meant.
    """
    files = [x for x in path.iterdir() if x.is_file()] if path.is_dir() else [path]
    refuse_size(path, sum(x.stat().st_size for x in files), limit)
    ros1 = path.suffix == ".bag" and path.is_file()
    with _opened(path, ros1) as bag:
        chosen = _topic(path, bag, topic)
        read_one = READERS[chosen[0].msgtype.rpartition("/")[2]]
        size = 0
        rows = []
        for _, received, data in bag.messages(connections=chosen):
            size += len(data)
            refuse_size(path, size, limit)
            rows.append((received, *read_one(data, ros1)))
    if not rows:
        raise LogError(f"{path}: no messages on {chosen[0].topic}")
    return (_table(path, chosen[0].topic, rows),)


@contextmanager
def _opened(path: Path, ros1: bool) -> Iterator[Any]:
    """The bag, opened by the library; its errors are raised as LogError."""
    try:
        from rosbags import rosbag1, rosbag2
    except ImportError:
        raise missing(path, "rosbags") from None
    _refuse_compressed(path)
    try:
        with rosbag1.Reader(path) if ros1 else rosbag2.Reader(path) as bag:
            yield bag
    except LogError:
        raise
    except Exception as error:  # the library, sqlite and the decompressors raise nearly anything on a damaged bag
        told = "a message is cut off" if isinstance(error, ros_messages.Damaged) else f"{type(error).__name__}: {error}"
        raise LogError(f"the bag {path} cannot be read: {told}", advice="a new copy of it") from error


def _refuse_compressed(path: Path) -> None:
    """Raise a LogError for a bag that is compressed as a whole: the library would inflate it to any size."""
    meta = path / "metadata.yaml"
    tree = plain_yaml(meta, LogError) if meta.is_file() else {}
    inner = tree.get("rosbag2_bagfile_information") if isinstance(tree, dict) else None
    if isinstance(inner, dict) and str(inner.get("compression_mode")).lower() == "file":
        raise LogError(f"{path} is compressed as a whole file", advice="ros2 bag convert without compression")


def _topic(path: Path, bag: Any, topic: str) -> list[Any]:
    """The connections of the requested topic, or of the only one with joint states."""
    usable = [x for x in bag.connections if x.msgtype.rpartition("/")[2] in READERS]
    names = sorted({shortened(x.topic, 200) for x in usable})
    states = sorted({x.topic for x in usable if x.msgtype.endswith(JOINT_STATE)})
    if topic and topic not in names:
        raise LogError(f"{path}: no topic {topic!r} of joint states{closest(topic, names)}; allowed: {listed(names)}")
    if not names:
        kinds = listed(sorted({f"{x.topic} ({x.msgtype})" for x in bag.connections}))
        got = f"{path} has no joint states; it has {kinds}"
        raise LogError(f"{got}; allowed: sensor_msgs/JointState, control_msgs/JointTrajectoryControllerState")
    if not topic:
        found = names if len(names) == 1 else [x for x in states if x.strip("/") == "joint_states"] or states
        if len(found) != 1:
            raise LogError(f"{path} has several topics of joint states; allowed: {listed(names)}", advice="topic=…")
        topic = found[0]
    return [x for x in usable if x.topic == topic]


def _table(path: Path, topic: str, rows: list[tuple[int, int, list[str], Any]]) -> Table:
    """Messages with the joints that most of them name, in the order of the first."""
    most = Counter(frozenset(names) for _, _, names, _ in rows).most_common(1)[0][0]
    kept = [row for row in rows if frozenset(row[2]) == most]
    joints = kept[0][2]
    present = [f for f in CHANNELS if f in kept[0][3] and len(kept[0][3][f]) == len(joints)]
    kept = [row for row in kept if all(len(row[3][f]) == len(joints) for f in present)]
    notes = [f"{len(rows) - len(kept)} of {len(rows)} messages on {topic} name other joints or lack channels."]
    stamps = np.array([row[1] for row in kept], np.int64)
    columns = {"stamp": stamps, "received": np.array([row[0] for row in kept], np.int64)}
    told = {"stamp" if (stamps > 0).all() else "received": Told("t", unit="ns")}
    orders = {tuple(row[2]): [row[2].index(joint) for joint in joints] for row in kept}
    for name in present:
        matrix = np.array([row[3][name][orders[tuple(row[2])]] for row in kept], float)
        for k, joint in enumerate(joints):
            column = f"{name}/{shortened(joint, 200)}"
            columns[column] = matrix[:, k]
            told[column] = replace(CHANNELS[name], joint=shortened(joint, 200))
    return Table(path.stem, columns, told, tuple(notes if len(kept) < len(rows) else ()), BY)
