"""A log as recorded and as corrected on one time axis, with its defects, as the figures of a check draw it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from invdyn_cli.diagnosis.marks import Mark
from invdyn_cli.joints import JointUnits, units
from invdyn_cli.log import Log
from invdyn_cli.recording.rows import forward_rows, median_step, without_gaps
from invdyn_cli.types import Robot

COMPARABLE = 5.0
"""Ratio of ranges up to which a channel as logged and as corrected share a panel; beyond it only the first is drawn."""

Pieces = list[tuple[np.ndarray, np.ndarray]]
"""(rows, values) of stretches of a channel."""


def joined(pieces: Pieces) -> tuple[np.ndarray, np.ndarray]:
    """Rows and values of all stretches together."""
    rows, values = zip((np.zeros(0, int), np.zeros(0)), *pieces, strict=True)
    return np.concatenate(rows), np.concatenate(values)


@dataclass(frozen=True)
class CheckedLog:
    """A log as recorded and as corrected (`marks.located`), its marks and its robot, ready to be drawn."""

    log: Log
    corrected: Log
    marks: tuple[Mark, ...]
    robot: Robot | None

    @cached_property
    def time(self) -> np.ndarray:
        """(rows of the log,) [s] on the corrected clock; several recordings stand one after another."""
        known = {}
        for raw in self.corrected.trajectories:
            known |= {int(raw.rows[0]): raw} if raw.rows is not None and len(raw.t) else {}
        out, start, at = [], 0, 0.0
        for raw in self.log.trajectories:
            n = len(raw.t)
            t, latest = np.full(n, np.nan), -np.inf
            for first in sorted(x for x in known if start <= x < start + n):
                piece = known[first]
                shift = max(0.0, latest - piece.t[0])
                t[np.asarray(piece.rows, int) - start] = piece.t + shift
                latest = piece.t[-1] + shift
            if not np.isfinite(t).any():
                good = forward_rows(raw.t) & (np.abs(np.nan_to_num(raw.t)) < 1e10)
                t = np.where(good, raw.t, np.nan)
            rows = np.flatnonzero(np.isfinite(t))
            step = median_step(t[rows])
            t = np.interp(np.arange(n), rows, t[rows]) if len(rows) > 1 and step > 0 else np.arange(n) / self.rate
            if len(self.log.trajectories) > 1 or (n and abs(t[0]) > 1e4):
                t = t - t[0] + at if n else t
            at, start = (float(t[-1]) if n else at), start + n
            out.append(t)
        return np.concatenate([np.zeros(0), *out])

    @cached_property
    def starts(self) -> np.ndarray:
        """(trajectories + 1,) first row of each, and the number of all rows."""
        return np.cumsum([0, *(len(raw.t) for raw in self.log.trajectories)], dtype=int)

    @property
    def rate(self) -> float:
        """[Hz] nominal, 1 where there is none."""
        return self.log.rate if np.isfinite(self.log.rate) and self.log.rate > 0 else 1.0

    @property
    def time_label(self) -> str:
        """Label of the x axis."""
        several = len(self.log.trajectories) > 1
        return "time, recordings one after another [s]" if several else "time [s]"

    def unit(self, channel: str, joint: int) -> str:
        """The unit of a channel in this log."""
        own = self._units(joint)
        if channel == "tau":
            return "A" if self.log.torque_unit == "A" else own.torque
        if channel == "t":
            return "s"
        return own.position + {"qd": "/s", "qdd": "/s²"}.get(channel, "")

    def torque_unit(self, joint: int) -> str:
        """The unit of a joint's torque once drive gains, where the log has any, turn currents into it."""
        return self.unit("tau", joint) if self.log.drive_gain is None else self._units(joint).torque

    def _units(self, joint: int) -> JointUnits:
        return units(self.robot is not None and self.robot.prismatic[joint])

    def logged_unit(self, channel: str, joint: int) -> str:
        """The unit of a channel as logged, which is not known if a check found a unit error in it."""
        wrong = any(x.check == "unit_error" and x.channel == channel and x.joint in (None, joint) for x in self.marks)
        return "as logged" if wrong else self.unit(channel, joint)

    def column(self, log: Log, channel: str, joint: int) -> Pieces:
        """(rows, values) of every uninterrupted stretch of a channel, values that are not finite left out."""
        out = []
        for raw, start in zip(log.trajectories, self.starts, strict=False):
            x = getattr(raw, channel)
            if x is None or np.ndim(x) != 2 or np.shape(x) != (len(raw.t), len(log.joints)):
                continue
            rows = np.arange(len(raw.t)) + start if log is self.log else np.asarray(raw.rows, int)
            good = np.isfinite(x[:, joint]) & (np.abs(x[:, joint]) < 1e100)
            pieces = [p[good[p]] for p in without_gaps(self.time[rows], np.arange(len(rows)))]
            out += [(rows[p], np.asarray(x[p, joint], float)) for p in pieces if len(p)]
        return out

    def dense(self, pieces: Pieces) -> np.ndarray:
        """(rows of the log,) of a channel's values, NaN where it has none."""
        rows, values = joined(pieces)
        out = np.full(int(self.starts[-1]), np.nan)
        out[rows] = values
        return out

    def corrected_share(self, channel: str, joint: int) -> tuple[float, bool]:
        """Share of a column's values that were corrected, and whether both can be drawn on one axis."""
        logged, new = self.column(self.log, channel, joint), self.column(self.corrected, channel, joint)
        if not logged or not new:
            return 0.0, False
        rows, y = joined(new)
        was = self.dense(logged)[rows]
        both = np.isfinite(was)
        was, y = was[both], y[both]
        if not len(y):
            return 0.0, False
        ranges = [float(np.ptp(np.quantile(x, [0.01, 0.99]))) for x in (was, y)]
        share = float(np.mean(np.abs(was - y) > 1e-9 * max(*ranges, 1e-300)))
        return share, min(ranges) * COMPARABLE > max(ranges)
