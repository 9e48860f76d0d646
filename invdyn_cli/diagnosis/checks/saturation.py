"""Torques at a limit, of which the log holds the limit and not the torque."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from invdyn_cli.diagnosis.checks.samples import gravity_torque
from invdyn_cli.interfaces import AbstractCheck
from invdyn_cli.log import Log, RawTrajectory
from invdyn_cli.recording.channels import newton_metres
from invdyn_cli.recording.rows import MAX_GAP, each, is_series, runs, taken, uninterrupted
from invdyn_cli.types import Check, Robot

HALF_WIDTH = 4.0
"""Standard deviations of noise within which a torque is at a limit."""

NEAR = 0.6 * MAX_GAP
"""[s] Time on both sides of a row at a limit that is left out with it: the trajectory is parted there."""


class Limit(NamedTuple):
    """The share of the samples of a trajectory that are at a torque [N m; N], within a half width of it, on one side or
    on both."""

    share: float
    value: float
    within: float
    both: bool
    trajectory: str


NOTHING = Limit(0.0, 0.0, 0.0, False, "")


@dataclass(frozen=True)
class Saturation(AbstractCheck):
    """Torques that stay at one extreme value while the arm moves, or at the URDF's effort limit.

    They stay there in successive rows or, if the noise is larger than the motion, return to this value more often than
    to any other. Where noise is added behind the limit, they scatter by no more than that, at one value again and
    again, while the gravity of the motion changes by more.

    Attributes:
        run: samples with the very same extreme value, in a row, or times as many as any other value has (ours: noise
            does not repeat a maximum five times, and rounded values are seldom at the extreme).
        share: of the samples that are so (ours: below, they do not bend a fit).
        limit: of the effort limit that counts as reached (a torque that goes as far beyond it knows no such limit).
        flat: samples in a row that scatter as noise does at a limit.
        scatter: their standard deviation, at most, in those of the noise.
        bend: of the parabola through them, likewise (theory: 0.17 for `flat` samples of a constant; ours: of smooth
            maxima 0.3 to 0.7, once 0.06).
        times: how often they do so while gravity changes by more than their width.
        left: share of the samples, at least, in stretches of `whole` [s] without those at limits; else these stay.
    """

    name: ClassVar[str] = "saturation"
    run: int = 5
    share: float = 0.002
    limit: float = 0.995
    flat: int = 100
    scatter: float = 1.2
    bend: float = 0.25
    times: int = 2
    left: float = 0.3
    whole: float = 2.0

    def examine(self, log: Log, robot: Robot | None) -> list[Check]:
        """Per joint, over all trajectories; the value is the torque [N m; N]."""
        found = []
        raws = [raw for raw in log.trajectories if is_series(raw) and len(raw.t) > 10 * self.run]
        if not raws:
            return [self.skipped("no time series")]
        loads = None if "gravity" in log.compensated else robot  # whose gravity the torques have in them
        for joint, name in enumerate(log.joints):
            noises = [] if loads is None else [_noise(newton_metres(log, raw)[:, joint]) for raw in raws]
            for side, word in ((1, "highest"), (-1, "lowest")):
                seen = [self._flat(log, raw, joint, side) for raw in raws]
                if loads is not None and max(seen).share <= self.share:
                    of = zip(raws, noises, strict=True)
                    seen = [self._noisy(log, raw, loads, joint, side, noise) for raw, noise in of]
                limit = max(seen)
                if limit.share > self.share and not any(c.joint == name and c.threshold["both"] for c in found):
                    found.append(self._seen(name, limit, "its limits" if limit.both else f"its {word} value"))
            if robot is None or not np.isfinite(robot.effort_limit[joint]) or robot.effort_limit[joint] <= 0:
                continue
            bound = float(robot.effort_limit[joint])
            near = [(raw, np.abs(newton_metres(log, raw)[:, joint]) / bound) for raw in raws]
            if not near or max(x.max() for _, x in near) > 2 - self.limit:
                continue  # it goes beyond: then this limit is none
            part, raw = max(((float(np.mean(x >= self.limit)), raw) for raw, x in near), key=lambda x: x[0])
            if part > self.share and not any(c.joint == name for c in found):
                limit = Limit(part, bound, (1 - self.limit) * bound, True, raw.name)
                found.append(self._seen(name, limit, "the URDF's effort limit"))
        return found

    def correct(self, log: Log, found: Sequence[Check], robot: Robot | None) -> tuple[Log, list[str]]:
        """Leave out the rows at a limit, where enough of a trajectory stays."""
        notes = []

        def change(raw: RawTrajectory) -> RawTrajectory:
            at = np.any([self.rows_of(log, raw, one) for one in found], axis=0)
            for out in (_with_neighbours(raw.t, at), at):
                kept = taken(raw, ~out)
                ends = [kept.t[rows[[0, -1]]] for rows in uninterrupted(kept)]
                whole = sum(b - a for a, b in ends if b - a >= self.whole)
                if at.any() and whole >= self.left * np.ptp(raw.t):
                    share = f"{100 * np.mean(out):.2g} % of the rows left out"
                    notes.append(f"{raw.name}: {share}, where a torque is at its limit")
                    return kept
            return raw

        return each(log, change) if found else log, notes

    def rows_of(self, log: Log, raw: RawTrajectory, one: Check) -> np.ndarray:
        """(T,) bool: rows of a trajectory that are at the limit that was found."""
        x: np.ndarray = newton_metres(log, raw)[:, log.joints.index(str(one.joint))]
        x = np.abs(x) if one.threshold["both"] else x
        return np.abs(x - one.value) <= one.threshold["within"]

    def _flat(self, log: Log, raw: RawTrajectory, joint: int, side: int) -> Limit:
        """Values at the extreme on one side."""
        x = side * newton_metres(log, raw)[:, joint]
        top, width = np.nanmax(x), 1e-6 * max(np.ptp(x), 1e-300)
        at = x >= top - width
        if np.ptp(x) <= 0 or at.sum() < self.run:
            return NOTHING
        # At rest a torque may repeat for good reasons; quantised ones repeat everywhere.
        moving = np.abs(np.gradient(raw.q, axis=0)).max(1) > 1e-3 * np.ptp(raw.q, axis=0).max() / 20
        long = [(a, b) for a, b in runs(at) if b - a >= self.run and moving[a:b].mean() > 0.5]
        held = sum(b - a for a, b in long)
        repeats = np.mean(np.diff(x[~at]) == 0) if np.sum(~at) > 1 else 1.0
        share = held / len(x) if repeats < 0.2 else 0.0
        often = np.sum(at & moving)
        if share <= self.share < often / len(x):
            _, counts = np.unique(x[~at], return_counts=True)
            share = often / len(x) if often > self.run * counts.max(initial=1) else 0.0
        return Limit(share, float(side * top), float(width), False, raw.name)

    def _noisy(self, log: Log, raw: RawTrajectory, robot: Robot, joint: int, side: int, noise: float) -> Limit:
        """Values that scatter about a limit on one side; on both if those of the other side go as far."""
        x = side * newton_metres(log, raw)[:, joint]
        width = HALF_WIDTH * noise
        long = [(a, b) for a, b in runs(x >= np.nanmax(x) - 2 * width) if b - a >= self.flat]
        long = [
            (a, b) for a, b in long if _scatter(x[a:b]) < self.scatter * noise and _bend(x[a:b]) < self.bend * noise
        ]
        top = max((float(np.median(x[a:b])) for a, b in long), default=0.0)
        held = [(a, b) for a, b in long if top - np.median(x[a:b]) < noise]
        if sum(np.ptp(_gravity(robot, raw.q[a:b])[:, joint]) > 2 * width for a, b in held) < self.times:
            return NOTHING
        share = sum(b - a for a, b in held) / len(x)
        both = bool(abs(np.nanmax(-x) - top) < 2 * width)
        return Limit(share, top if both else side * top, width, both, raw.name)

    def _seen(self, joint: str, limit: Limit, what: str) -> Check:
        value, percent = f"{'±' * limit.both}{limit.value:.4g}", f"{100 * limit.share:.2g} %"
        return Check(
            self.name,
            "warn",
            limit.trajectory,
            joint,
            value=limit.value,
            threshold={"channel": "tau", "share": self.share, "within": limit.within, "both": limit.both},
            seen=f"the torque is at {what}, {value}, in {percent} of the samples",
            meaning="the drive, the sensor or the message is limited to this value: the true torque is not in the log",
            advice="record slower motion or smaller loads; these rows are left out if enough others remain",
            source="own choice: noise does not repeat a maximum",
        )


def _with_neighbours(t: np.ndarray, at: np.ndarray) -> np.ndarray:
    """(T,) bool: some rows, and all between two of them that are at most MAX_GAP apart. Runs that are still short get
    NEAR on both sides, so that nothing is interpolated over them: where a torque jitters about a limit, the readings
    in between are too low."""

    def lasts(a: int, b: int) -> bool:
        return t[min(b, len(t) - 1)] - t[max(a - 1, 0)] > MAX_GAP

    out = at.copy()
    for a, b in runs(~at):
        out[a:b] = a > 0 and b < len(t) and not lasts(a, b)
    short = t[[k for a, b in runs(out) if not lasts(a, b) for k in range(a, b)]]
    before, after = (np.searchsorted(short, t + step) for step in (-NEAR, NEAR))
    return out | (before < after)


def _scatter(x: np.ndarray) -> float:
    """Standard deviation of normal x by the median deviation."""
    return 1.48 * float(np.median(np.abs(x - np.median(x))))


def _noise(x: np.ndarray) -> float:
    """Standard deviation of white noise on a smooth x (T,), by its fourth differences."""
    return _scatter(np.diff(x, 4)) / np.sqrt(70)


def _bend(x: np.ndarray) -> float:
    """Standard deviation of the parabola through x (T,), its first and last parts, where it may rise and fall, left
    out."""
    middle = x[int(0.15 * len(x)) : int(np.ceil(0.85 * len(x)))]
    at = np.linspace(-1.0, 1.0, len(middle))
    return float(np.std(np.polyval(np.polyfit(at, middle, 2), at)))


def _gravity(robot: Robot, q: np.ndarray) -> np.ndarray:
    """(50, n) torque [N m; N] that holds the arm at positions of q (T, n)."""
    return gravity_torque(robot, q[np.linspace(0, len(q) - 1, 50).astype(int)])
