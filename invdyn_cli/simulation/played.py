"""A reference from a file: a csv of positions over time, as `invdyn excite` writes it."""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy

from invdyn_cli import untrusted
from invdyn_cli.errors import UsageError, closest, listed
from invdyn_cli.files import write_file
from invdyn_cli.simulation.references import AbstractReference
from invdyn_cli.types import Motion, Robot

BEYOND = 1e-6
"""[rad; m] By how much rounding may move a position beyond its limit."""

TOO_FAST = 1.05
"""Factor of the velocity limit: the spline overshoots a little between samples."""


@dataclass(frozen=True)
class Played(AbstractReference):
    """The positions of a file, joined by a quintic spline, whole: the file decides how long it takes, and neither
    data.duration nor the seed plays a part.

    Attributes:
        path: a csv; its first row names the columns: t [s], increasing from any start, and every joint of the robot
            [rad; m], in any order. Lines that begin with # are passed over.
    """

    path: str

    def motion(self, robot: Robot, duration: float, rate: float, seed: int) -> Motion:
        """The motion (T, n) at 0, 1/rate, … up to the file's last time.

        Raises:
            UsageError: for a file that cannot be read, lacks a joint, or leaves the joints' limits.
        """
        t, q = read_csv(self.path, robot.joints)
        spline = scipy.interpolate.make_interp_spline(t, q, k=5)
        clock = np.arange(int(np.floor(t[-1] * rate + 1e-6)) + 1) / rate
        motion = Motion(*(spline(clock, k) for k in range(3)))
        self._refuse_beyond(robot, motion)
        return motion

    def _refuse_beyond(self, robot: Robot, motion: Motion) -> None:
        q, qd = np.asarray(motion.q), np.asarray(motion.qd)
        for i, name in enumerate(robot.joints):
            low, high, fastest = (float(np.asarray(x)[i]) for x in (robot.lower, robot.upper, robot.velocity_limit))
            if q[:, i].min() < low - BEYOND or q[:, i].max() > high + BEYOND:
                got = f"{self.path}: {name} goes from {q[:, i].min():.4g} to {q[:, i].max():.4g}"
                raise UsageError(f"{got}; allowed: {low:.4g} to {high:.4g}")
            if fastest > 0 and np.abs(qd[:, i]).max() > TOO_FAST * fastest:
                got = f"{self.path}: {name} moves at {np.abs(qd[:, i]).max():.4g} per second"
                raise UsageError(f"{got}; allowed: {fastest:.4g}", advice="the same positions over a longer time")


def read_csv(path: str | Path, joints: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Times (T,) [s] from 0 on and positions (T, n) [rad; m] of a csv, in the order of the joints.

    Raises:
        UsageError: for anything that is no such file.
    """
    text = untrusted.read_text(Path(path), UsageError, "the trajectory.csv of `invdyn excite`")
    lines = [x for x in text.splitlines() if x.strip() and not x.startswith("#")]
    rows = list(csv.reader(lines))
    names = [x.strip() for x in rows[0]] if rows else []
    for name in ("t", *joints):
        if names.count(name) != 1:
            got = f"{path}: {names.count(name)} columns {name!r}, in a file of {listed(names)}"
            raise UsageError(f"{got}; allowed: one column for t and one for each joint{closest(name, names)}")
    try:
        table = np.array([[float(x) for x in row] for row in rows[1:]])
    except ValueError as error:
        raise UsageError(f"{path}: {error}; allowed: a number in every field") from error
    if table.ndim != 2 or table.shape[1] != len(names) or len(table) < 6 or not np.isfinite(table).all():
        raise UsageError(f"{path}: a table of shape {table.shape}; allowed: 6 rows or more of {len(names)} numbers")
    t = table[:, names.index("t")]
    if np.any(np.diff(t) <= 0):
        late = int(np.argmax(np.diff(t) <= 0))
        raise UsageError(f"{path}: t goes from {t[late]:g} to {t[late + 1]:g} s; allowed: increasing times")
    return t - t[0], table[:, [names.index(name) for name in joints]]


def write_csv(path: Path, t: np.ndarray, q: np.ndarray, joints: tuple[str, ...]) -> None:
    """Times (T,) [s] and positions (T, n) [rad; m] as `read_csv` reads them."""
    head = "# t [s]; joint positions [rad; m]\n" + ",".join(("t", *joints))
    rows = (",".join([f"{time:.6f}", *(f"{x:.9f}" for x in row)]) for time, row in zip(t, q, strict=True))
    write_file(path, "\n".join([head, *rows]) + "\n")
