"""Values of a log that cannot be: missing ones, and single samples far off their neighbours."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from invdyn_cli.diagnosis.checks.samples import SLOW
from invdyn_cli.interfaces import AbstractCheck
from invdyn_cli.log import Log, RawTrajectory
from invdyn_cli.recording.rows import each, is_series, parted, present, runs, without_gaps
from invdyn_cli.types import Check, Robot


@dataclass(frozen=True)
class NotFinite(AbstractCheck):
    """Values that are missing: NaN, infinite, rows or columns that a channel does not have.

    Attributes:
        hole: steps without values across which interpolation would invent a motion; longer ones part the trajectory
            (ours: an arm's motion stays below 6 Hz, five samples at 100 Hz are a third of its period).
    """

    name: ClassVar[str] = "not_finite"
    hole: int = 5

    def examine(self, log: Log, robot: Robot | None) -> list[Check]:
        """Per trajectory and channel; the value is the number of rows."""
        found = []
        for raw in log.trajectories:
            stages = {} if raw.stage is None else {"stage": np.zeros(np.shape(raw.stage))}
            for channel, x in {"t": raw.t, **present(raw), **stages}.items():
                if not _fits(log, raw, channel):
                    seen = (
                        f"{channel} has shape {np.shape(x)}, t has {len(raw.t)} rows, the log {len(log.joints)} joints"
                    )
                    found.append(self._seen(raw.name, None, channel, 0, seen))
                    continue
                bad = ~np.isfinite(x)
                rows = bad if bad.ndim == 1 else bad.any(1)
                if not rows.any():
                    continue
                columns = np.flatnonzero(bad.any(0)) if bad.ndim > 1 else []
                joint = log.joints[columns[0]] if len(columns) == 1 else None
                if channel == "tau" and bad.all():
                    found.append(self._no_torque(raw.name, len(rows)))
                    continue
                seen = f"{channel} is not finite in {rows.sum()} of {len(rows)} rows, first in row {np.argmax(rows)}"
                found.append(self._seen(raw.name, joint, channel, int(rows.sum()), seen))
        return found

    def correct(self, log: Log, found: Sequence[Check], robot: Robot | None) -> tuple[Log, list[str]]:
        """Drop channels that are worth nothing and rows that lack a value; leave out what has then nothing left."""
        notes = []

        def change(raw: RawTrajectory) -> list[RawTrajectory]:
            if not all(_fits(log, raw, c) for c in ("t", "q", "tau")):
                notes.append(f"{raw.name}: left out, its channels do not belong together")
                return []
            lost = [
                c
                for c in ("qd", "qdd", "q_ref", "q_link", "stage")
                if getattr(raw, c) is not None and not (_fits(log, raw, c) and (c == "stage" or self._mostly(raw, c)))
            ]
            raw = replace(raw, **dict.fromkeys(lost))
            good = np.isfinite(raw.t) & np.all([np.isfinite(x).all(1) for x in present(raw).values()], axis=0)
            holes = [(a, b) for a, b in runs(~good) if b - a > self.hole and a > 0 and b < len(good)]
            edges = [0, *(b for _, b in holes), len(good)]
            pieces = [np.flatnonzero(good[a:b]) + a for a, b in itertools.pairwise(edges)]
            pieces = [rows for rows in pieces if len(rows)]
            words = [f"without the channel{'s' * (len(lost) > 1)} {', '.join(lost)}"] if lost else []
            if not good.all() and pieces:
                words.append(f"dropped {np.sum(~good)} rows with values that are not finite")
            if len(pieces) > 1:
                words.append(f"divided into {len(pieces)} trajectories at these rows")
            if not pieces:
                words = ["left out, because no row has a value for every joint"]
            notes.append(f"{raw.name}: {', '.join(words)}")
            return parted(raw, pieces) if pieces else []

        return each(log, change, {c.trajectory for c in found}), notes

    def _no_torque(self, trajectory: str, rows: int) -> Check:
        return replace(
            self._seen(trajectory, None, "tau", rows, "there are no torques"),
            meaning="nothing can be said of the arm's dynamics without them",
            advice="'data.columns={tau: {columns: FIRST:LAST, unit: N m}}', where a file has them in columns that were "
            "not recognised",
        )

    def _mostly(self, raw: RawTrajectory, channel: str) -> bool:
        """Whether at least half of a channel's rows have a value for every joint."""
        return bool(np.isfinite(getattr(raw, channel)).all(1).mean() >= 0.5)

    def _seen(self, trajectory: str, joint: str | None, channel: str, rows: int, seen: str) -> Check:
        return Check(
            self.name,
            "fail",
            trajectory,
            joint,
            value=rows,
            threshold={"channel": channel, "rows": 0},
            seen=seen,
            meaning="rows without a value cannot be used",
            advice="a logger that leaves a row out rather than write NaN",
            source="arithmetic",
        )


def _fits(log: Log, raw: RawTrajectory, channel: str) -> bool:
    """Whether a channel has a row for every stamp and a column for every joint."""
    x, n = getattr(raw, channel), len(log.joints)
    shape = (len(raw.t),) if channel in ("t", "stage") else (len(raw.t), n)
    return np.shape(x) == shape and np.size(x) > 0


@dataclass(frozen=True)
class Outliers(AbstractCheck):
    """Single samples far off their neighbours: a Hampel test (Hampel 1974; Pearson 2002) whose scale is local.

    A sample counts where it lies off the median of the `width` samples around it by `deviations` robust standard
    deviations of such distances nearby, and by a share of the channel's range; its run is no longer than `longest`
    samples, and the samples beside it are not off. A median follows steps (Coulomb friction at a reversal)
    and slopes, so that these do not count. Positions and their derivatives of a joint that stands still are left alone,
    and so are torques where the arm stops or sets off: there a drive jerks.

    Attributes:
        deviations: (ours: Pearson's 3 flags one sample in 400 of Gaussian noise; 20 none in an hour, and torque noise
            has heavy tails).
        least: of the range from the 1st to the 99th percentile, twice that for derivatives (ours: impacts and
            stick-slip of real arms mostly stay below; a smaller one does not bend a fit).
        position: the same for positions, which have no such bursts.
        still: [rad; m] range of q below which a joint stands still; also the least jump of a position, over 10.
        width, longest: samples.
        alone: of its distance that the samples beside it may have (ours: a filter's answer to a step is a peak of
            several samples).
        jolt: [s] before or after a stop of the arm (ours: a UR10e that is stopped brakes for 60 ms).
        most: share of samples (ours: what is more frequent is no outlier but the noise).
    """

    name: ClassVar[str] = "outliers"
    deviations: float = 20.0
    least: float = 0.25
    position: float = 0.01
    still: float = 0.01
    width: int = 7
    longest: int = 2
    alone: float = 0.5
    jolt: float = 0.1
    most: float = 0.01

    def examine(self, log: Log, robot: Robot | None) -> list[Check]:
        """Per trajectory, channel and joint; the value is the number of samples."""
        found = []
        series = [raw for raw in log.trajectories if len(raw.t) >= 50 and is_series(raw, roughness=0.5)]
        if not series:
            return [self.skipped("no time series of 50 rows")]
        for raw in series:
            for channel in present(raw):
                for joint, name in enumerate(log.joints):
                    rows = self.rows_of(raw, channel, joint)
                    if len(rows):
                        found.append(self._outlying(raw, channel, joint, name, rows))
        return found

    def correct(self, log: Log, found: Sequence[Check], robot: Robot | None) -> tuple[Log, list[str]]:
        """Replace them by the line between their neighbours."""
        notes = []

        def change(raw: RawTrajectory) -> RawTrajectory:
            mine = [c for c in found if c.trajectory == raw.name and c.severity == "warn"]
            for check in mine:
                channel, joint = check.threshold["channel"], log.joints.index(str(check.joint))
                x = getattr(raw, channel).copy()
                rows = self.rows_of(raw, channel, joint)
                keep = np.setdiff1d(np.arange(len(x)), rows)
                x[rows, joint] = np.interp(raw.t[rows], raw.t[keep], x[keep, joint])
                raw = replace(raw, **{channel: x})
                number = "1 outlier" if len(rows) == 1 else f"{len(rows)} outliers"
                notes.append(f"{raw.name}: {number} in {channel} of {check.joint} interpolated")
            return raw

        return each(log, change), notes

    def _outlying(self, raw: RawTrajectory, channel: str, joint: int, name: str, rows: np.ndarray) -> Check:
        noise = len(rows) > max(3, self.most * len(raw.t))
        at, value = raw.t[rows[0]], getattr(raw, channel)[rows[0], joint]
        count = f"1 sample of {channel} is" if len(rows) == 1 else f"{len(rows)} samples of {channel} are"
        return Check(
            self.name,
            "note" if noise else "warn",
            raw.name,
            name,
            value=len(rows),
            threshold={"channel": channel, "deviations": self.deviations},
            seen=f"{count} more than {self.deviations:g} robust standard deviations from the neighbours, "
            f"first at t = {at:.3f} s: {value:.4g}",
            meaning="so many outliers are noise of this channel; they are kept"
            if noise
            else "likely transmission errors; a single one can distort a least-squares fit",
            advice="check the bus or the driver of this channel",
            source="Hampel 1974; Pearson 2002; 20 instead of 3 is an own choice: torque noise has heavy tails",
        )

    def rows_of(self, raw: RawTrajectory, channel: str, joint: int) -> np.ndarray:
        """Row numbers of the outliers of a channel's joint."""
        x = getattr(raw, channel)[:, joint]
        starts = np.array([rows[0] for rows in without_gaps(raw.t, np.arange(len(raw.t)))])
        if channel == "tau":
            rows = self.rows(x, self.least, 0.0, starts)
            return rows[~self._stops(raw, raw.t[rows])]
        low, high = np.quantile(raw.q[:: max(1, len(x) // 100_000), joint], [0.01, 0.99])
        if high - low < self.still:
            return np.arange(0)
        position = channel in ("q", "q_ref", "q_link")
        return self.rows(x, self.position if position else 2 * self.least, self.still / 10, starts)

    def _stops(self, raw: RawTrajectory, t: np.ndarray) -> np.ndarray:
        """(R,) bool: whether the arm moves before and rests after these times (R,) [s], or the reverse."""

        def moves(*window: float) -> np.ndarray:
            begin, end = (np.clip(t + x, raw.t[0], raw.t[-1]) for x in window)
            way = [np.interp(end, raw.t, q) - np.interp(begin, raw.t, q) for q in raw.q.T]
            return np.abs(way).max(0) - SLOW * (end - begin)

        return moves(-3 * self.jolt, -self.jolt) * moves(self.jolt, 3 * self.jolt) < 0

    def rows(self, x: np.ndarray, share: float, floor: float, starts: np.ndarray) -> np.ndarray:
        """Row numbers of the outliers of a series x (T,), by at least a share of its range and `floor`; `starts`: first
        rows of its uninterrupted stretches, across which no sample has neighbours."""
        second = np.zeros(len(x))
        second[1:-1] = np.abs(x[1:-1] - (x[:-2] + x[2:]) / 2)
        second[[0, -1]] = np.abs(x[[0, -1]] - x[[1, -2]])
        low, high = np.quantile(x[:: max(1, len(x) // 100_000)], [0.01, 0.99])
        least = max(share * (high - low), floor, 1e-9 * np.abs(x).max())
        rows = np.flatnonzero(second > least / 2)
        if not len(rows):
            return rows
        if len(rows) > 10_000:  # a channel of jumps; a sample of them tells enough
            rows = rows[:: len(rows) // 10_000]
        around = rows[:, None] + np.arange(-50, 51)
        stretch = np.searchsorted(starts, rows, side="right")
        ends = np.append(starts, len(x))
        near = x[np.clip(around, ends[stretch - 1][:, None], ends[stretch][:, None] - 1)]
        half = self.width // 2
        spans = np.lib.stride_tricks.sliding_window_view(near, self.width, axis=1)
        off = np.abs(near[:, half:-half] - np.median(spans, axis=2))
        here = off[:, off.shape[1] // 2]
        scale = 1.4826 * np.median(off, axis=1)
        bulk = np.quantile(off, 0.9, axis=1)  # of torques at rest the median distance may be no more than rounding
        flagged = rows[(here > least) & (here > self.deviations * scale) & (here > 5 * bulk)]
        flags = np.zeros(len(x), bool)
        flags[flagged] = True
        for a, b in runs(flags):
            if b - a > self.longest or not self._alone(x, a, b):
                flags[a:b] = False
        return np.flatnonzero(flags)

    def _alone(self, x: np.ndarray, a: int, b: int) -> bool:
        """Whether samples a to b of x (T,) are off the line through those `width` / 2 further out, and the ones beside
        them are not."""
        ends, beside = ([k for k in (a - 1 - out, b + out) if 0 <= k < len(x)] for out in (self.width // 2, 0))
        off, near = (np.abs(x[k] - np.interp(k, ends, x[ends])) for k in (np.arange(a, b), beside))
        return bool(near.max() < self.alone * off.min())
