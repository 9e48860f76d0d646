"""One simulated recording, written in every format by the libraries that users write them with."""

from collections.abc import Callable, Mapping
from pathlib import Path

import h5py
import numpy as np
import scipy.io

from tests.logs import motion

JOINTS = ("shoulder", "elbow")
EPOCH = 1_700_000_000_000_000_000
"""[ns] since 1970 at t = 0, where a format counts from then."""

Recording = Mapping[str, np.ndarray]


def recording() -> Recording:
    """Two joints, 10 s at 100 Hz: t (T,), q, qd, tau (T, 2)."""
    return {name: x for name, x in motion().items() if name != "qdd"}


def named(data: Recording, head: str = "t", **names: str) -> dict[str, np.ndarray]:
    """Columns by name: `names` are patterns with a {} for the joint, by channel."""
    columns = {head: data["t"]}
    for channel, pattern in names.items():
        columns |= {pattern.format(joint): data[channel][:, k] for k, joint in enumerate(JOINTS)}
    return columns


def write_csv(path: Path, columns: Mapping[str, np.ndarray], delimiter: str = ",", header: bool = True) -> Path:
    """A text table with every digit that a float has."""
    rows = [delimiter.join(columns)] if header else []
    rows += [delimiter.join(repr(x.item()) for x in row) for row in zip(*columns.values(), strict=True)]
    path.write_text("\n".join(rows) + "\n")
    return path


def csv(folder: Path, data: Recording) -> Path:
    """A csv with a header."""
    return write_csv(folder / "run.csv", named(data, q="q_{}", qd="dq_{}", tau="tau_{}"))


def npz(folder: Path, data: Recording) -> Path:
    """Arrays by numpy."""
    np.savez(folder / "run.npz", **data)
    return folder / "run.npz"


def mat(folder: Path, data: Recording) -> Path:
    """A structure `log` in a compressed file of version 5 by scipy."""
    scipy.io.savemat(folder / "run.mat", {"log": dict(data)}, do_compression=True)
    return folder / "run.mat"


def mat73(folder: Path, data: Recording) -> Path:
    """Version 7.3 as MATLAB lays it out: HDF5 after 512 bytes of text, axes reversed."""
    path = folder / "run.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, x in data.items():
            file[name] = np.atleast_2d(x) if x.ndim == 1 else x.T
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    return path


def parquet(folder: Path, data: Recording) -> Path:
    """A table by pyarrow."""
    import pyarrow
    from pyarrow import parquet as writer

    writer.write_table(pyarrow.table(named(data, q="q_{}", qd="dq_{}", tau="tau_{}")), folder / "run.parquet")
    return folder / "run.parquet"


def lerobot(folder: Path, data: Recording) -> Path:
    """A LeRobot dataset of one episode: lists of float64, names in meta/info.json."""
    import pyarrow
    from pyarrow import parquet as writer

    root, rows = folder / "dataset", len(data["t"])
    (root / "meta").mkdir(parents=True)
    names = str([f"{joint}.pos" for joint in JOINTS]).replace("'", '"')
    parts = ", ".join(f'"observation.{x}": {{"names": {names}}}' for x in ("state", "velocity", "effort"))
    (root / "meta" / "info.json").write_text(f'{{"features": {{{parts}}}}}')
    (root / "data" / "chunk-000").mkdir(parents=True)
    columns = {f"observation.{to}": list(data[x]) for to, x in (("state", "q"), ("velocity", "qd"), ("effort", "tau"))}
    columns |= {"timestamp": data["t"], "episode_index": np.zeros(rows, int), "frame_index": np.arange(rows)}
    writer.write_table(pyarrow.table(columns), root / "data" / "chunk-000" / "episode_000000.parquet")
    return root


def bag1(folder: Path, data: Recording) -> Path:
    """A bag of ROS 1 by rosbags."""
    from rosbags import rosbag1
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    with rosbag1.Writer(folder / "run.bag") as bag:
        connection = bag.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=store)
        for stamp, message in joint_states(store, data):
            bag.write(connection, stamp, store.serialize_ros1(message, "sensor_msgs/msg/JointState"))
    return folder / "run.bag"


def bag2(folder: Path, data: Recording, plugin: str = "SQLITE3", topics: tuple[str, ...] = ("/joint_states",)) -> Path:
    """A bag of ROS 2 by rosbags."""
    from rosbags import rosbag2
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    with rosbag2.Writer(folder / "bag", version=8, storage_plugin=rosbag2.StoragePlugin[plugin]) as bag:
        for topic in topics:
            connection = bag.add_connection(topic, "sensor_msgs/msg/JointState", typestore=store)
            for stamp, message in joint_states(store, data):
                bag.write(connection, stamp, store.serialize_cdr(message, "sensor_msgs/msg/JointState"))
    return folder / "bag"


def mcap(folder: Path, data: Recording) -> Path:
    """The file of a bag of ROS 2 in mcap, without its folder."""
    return next(bag2(folder, data, "MCAP").glob("*.mcap"))


def joint_states(store, data: Recording):
    """(stamp [ns], message) for each row; every second message names its joints in the other order."""
    kinds = store.types
    time, header = kinds["builtin_interfaces/msg/Time"], kinds["std_msgs/msg/Header"]
    state = kinds["sensor_msgs/msg/JointState"]
    sequence = {"seq": 0} if "seq" in header.__dataclass_fields__ else {}
    for k, t in enumerate(data["t"]):
        stamp = EPOCH + round(t * 1e9)
        order = [0, 1] if k % 2 == 0 else [1, 0]
        head = header(**sequence, stamp=time(sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id="")
        values = (np.ascontiguousarray(data[channel][k, order]) for channel in ("q", "qd", "tau"))
        yield stamp, state(head, [JOINTS[i] for i in order], *values)


WRITERS: dict[str, Callable[[Path, Recording], Path]] = {
    "csv": csv, "npz": npz, "mat": mat, "mat73": mat73, "parquet": parquet, "lerobot": lerobot, "bag1": bag1,
    "bag2": bag2, "mcap": mcap,
}  # fmt: skip
