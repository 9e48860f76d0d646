"""Two ROS messages from their bytes: sensor_msgs/JointState and control_msgs/JointTrajectoryControllerState.

They are decoded here, because a library would make Python code of the definitions that a bag contains. Of the second
message only the beginning is read, which is the same in all releases of ROS: header, names, commanded and measured
point.
"""

from collections.abc import Mapping

import numpy as np

JOINT_STATE, CONTROLLER_STATE = "JointState", "JointTrajectoryControllerState"


class Damaged(Exception):
    """A message ends before it should."""


class _Bytes:
    """Reads a message: CDR (ROS 2: a head of 4 bytes, numbers aligned to their size) or ROS 1's (packed)."""

    def __init__(self, data: bytes, ros1: bool) -> None:
        self.data, self.ros1 = memoryview(data), ros1
        self.start = self.at = 0 if ros1 else 4
        self.order = "<" if ros1 or (len(data) > 1 and data[1] & 1) else ">"

    def numbers(self, kind: str, count: int) -> np.ndarray:
        """`count` numbers of a numpy type."""
        size = int(kind[1:])
        if not self.ros1 and count:
            self.at += -(self.at - self.start) % size
        end = self.at + size * count
        if end > len(self.data):
            raise Damaged
        out = np.frombuffer(self.data[self.at : end], f"{self.order}{kind}")
        self.at = end
        return out

    def whole(self) -> int:
        """An unsigned number of 32 bits."""
        return int(self.numbers("u4", 1)[0])

    def text(self) -> str:
        """A text; in CDR its length counts a zero at the end."""
        raw = self.numbers("u1", self.whole()).tobytes()
        return raw.rstrip(b"\0").decode(errors="replace")

    def texts(self) -> list[str]:
        """A sequence of texts."""
        count = self.whole()
        if count > len(self.data):
            raise Damaged
        return [self.text() for _ in range(count)]

    def floats(self) -> np.ndarray:
        """A sequence of float64."""
        return self.numbers("f8", self.whole())

    def header(self) -> int:
        """std_msgs/Header -> [ns] its stamp."""
        if self.ros1:
            self.whole()  # seq
        seconds = int(self.numbers("u4" if self.ros1 else "i4", 1)[0])
        nanoseconds = self.whole()
        self.text()
        return 1_000_000_000 * seconds + nanoseconds

    def point(self) -> dict[str, np.ndarray]:
        """trajectory_msgs/JointTrajectoryPoint."""
        out = {name: self.floats() for name in ("positions", "velocities", "accelerations", "effort")}
        self.numbers("i4", 2)  # time_from_start
        return out


def joint_state(data: bytes, ros1: bool) -> tuple[int, list[str], Mapping[str, np.ndarray]]:
    """sensor_msgs/JointState -> stamp [ns], names, and "position" [rad; m], "velocity", "effort" [N m; N], each (n,) or
    (0,).

    Raises:
        Damaged: if it is cut off.
    """
    message = _Bytes(data, ros1)
    stamp, names = message.header(), message.texts()
    return stamp, names, {name: message.floats() for name in ("position", "velocity", "effort")}


def controller_state(data: bytes, ros1: bool) -> tuple[int, list[str], Mapping[str, np.ndarray]]:
    """control_msgs/JointTrajectoryControllerState -> stamp [ns], names, and "position", "velocity", "effort" of the
    measured point, "command" (positions of the commanded one).

    Raises:
        Damaged: if it is cut off.
    """
    message = _Bytes(data, ros1)
    stamp, names = message.header(), message.texts()
    commanded, measured = message.point(), message.point()
    return stamp, names, {
        "position": measured["positions"],
        "velocity": measured["velocities"],
        "effort": measured["effort"],
        "command": commanded["positions"],
    }  # fmt: skip
