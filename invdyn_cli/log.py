"""A log as it was recorded, and the parts of it that a diagnosis uses: plain objects; `logfile` reads and writes
them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from invdyn_cli.errors import listed
from invdyn_cli.frames import frame

if TYPE_CHECKING:
    from pandas import DataFrame

TORQUE_UNITS = ("N m", "A")
TORQUE_SIDES = ("link", "motor", "command", "unknown")
POSITION_SIDES = ("motor", "link", "unknown")
CHANNELS = ("q", "tau", "qd", "qdd", "q_ref", "q_link")

Window = tuple[str, float, float]
"""A stretch of a trajectory: its name, start and end [s]."""


@dataclass(frozen=True)
class RawTrajectory:
    """One trajectory as logged: torques belong to their own t, and nothing is shifted, filtered or resampled.

    Attributes:
        name: its name in the log.
        t: (T,) [s].
        q, qd, qdd: (T, n) [rad; m], and per second; None where not logged.
        tau: (T, n) in the log's torque unit.
        q_ref, q_link: (T, n) [rad; m] commanded, and measured behind the gear; None where not logged.
        stage: (T,) names or numbers of stages, None where there are none.
        payload_mass: [kg], NaN if unknown.
        notes: what the reader should know.
        rows: (T,) where its rows stood in the log as recorded, counted over all trajectories; None where nobody counted
            (`diagnosis.marks`). Not written.
    """

    name: str
    t: np.ndarray
    q: np.ndarray
    tau: np.ndarray
    qd: np.ndarray | None = None
    qdd: np.ndarray | None = None
    q_ref: np.ndarray | None = None
    q_link: np.ndarray | None = None
    stage: np.ndarray | None = None
    payload_mass: float = float("nan")
    notes: str = ""
    rows: np.ndarray | None = None


@dataclass(frozen=True, repr=False)
class Log:
    """A recording of one robot with n joints: the attributes of the log format (docs/logs.md), and its trajectories.

    `urdf` is a path that can be opened from here ("": none); `rate` [Hz] is nominal; `drive_gain` (n,) [N m/A] converts
    torques in "A" to "N m" (None: unknown); `compensated` names effects that are already subtracted from the torque;
    `history` lists corrections, one sentence each.
    """

    robot: str
    joints: tuple[str, ...]
    torque_side: str
    torque_unit: str
    rate: float
    trajectories: tuple[RawTrajectory, ...]
    urdf: str = ""
    drive_gain: np.ndarray | None = None
    source: str = ""
    licence: str = ""
    position_side: str = "unknown"
    compensated: tuple[str, ...] = ()
    history: tuple[str, ...] = ()

    def __repr__(self) -> str:
        count, rows = len(self.trajectories), sum(len(one.t) for one in self.trajectories)
        size = f"{count} {'trajectory' if count == 1 else 'trajectories'}, {rows} rows at {self.rate:.4g} Hz"
        return f"Log of {self.robot}: {listed(self.joints)}; {size}; {self.torque_side} torque in {self.torque_unit}"

    def to_pandas(self) -> "DataFrame":
        """All rows under trajectory and t [s] as index, columns q_JOINT [rad; m], tau_JOINT [N m; N, or A] and so on;
        LogError for channels of other shapes, UsageError without pandas."""
        return frame(self, CHANNELS)


@dataclass(frozen=True)
class Recorded:
    """What a data source has recorded, for `invdyn check` and `invdyn diagnose`.

    Attributes:
        log: as it was recorded, defects and all, its columns in the robot's order.
        reference: an earlier log that it is compared with, or None.
        windows: role ("train", or "test": held out) -> stretches; None: shares of time decide.
        notes: what the user should know.
    """

    log: Log
    reference: Log | None = None
    windows: Mapping[str, Sequence[Window]] | None = None
    notes: tuple[str, ...] = ()
