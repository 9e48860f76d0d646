"""The commanded positions q_ref compared with the measured ones: unit, sign and lag together, one lag per recording."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from invdyn_cli.diagnosis.checks.fits import lowest
from invdyn_cli.diagnosis.checks.unit_factors import DEGREE, POSITIONS
from invdyn_cli.interfaces import AbstractCheck
from invdyn_cli.log import Log, RawTrajectory
from invdyn_cli.recording.memory import once_for_a_log
from invdyn_cli.recording.rows import each
from invdyn_cli.recording.stretches import Stretch, stretches
from invdyn_cli.types import Check, Robot

UNITS = {DEGREE: "degrees", **POSITIONS}
"""q_ref over SI; each with both signs."""

WIDEST = 5.0
"""[s] of lags that are tried, and no more than a third of a stretch."""

EXPLAINED = 0.95
"""Least share of the variance of q (median over joints) that q_ref explains at the best lag; below it nothing is
reported."""

MOVED = 0.02
"""[rad; m] RMS of q about its mean below which a joint is not used."""

PEAKS, ALIKE = 6, 4.0
"""Number of best lags of the first scan that are examined closely; and by how much another lag may leave more of q
unexplained and still count as equally good. Of equally good lags the one with the same sign of q_ref and q is taken,
then the shortest: half a period later a sine fits with the opposite sign."""

COARSE = 25.0
"""[Hz] of the first scan; the second, around its best lag, has every sample."""


@dataclass(frozen=True)
class Following:
    """How q of one recording follows q_ref.

    `lag` [s] positive: q later; `least`, `most` [s] the lags of single joints; `factor` (n,) slope of q on q_ref at the
    lag, NaN where a joint does not move; `explained` share of variance, median over the joints; `others` [s] further
    lags that explain q as well.
    """

    trajectory: str
    lag: float
    least: float
    most: float
    factor: np.ndarray
    explained: float
    others: tuple[float, ...] = ()


@once_for_a_log
def following(log: Log) -> list[Following]:
    """The result for each recording that has q_ref and in which a joint moves."""
    parts = [x for x in stretches(log) if "q_ref" in x.extra]
    found = []
    for name in dict.fromkeys(x.trajectory for x in parts):
        one = _follow(max((x for x in parts if x.trajectory == name), key=lambda x: len(x.q)))
        if one is not None:
            found.append(one)
    return found


def _follow(part: Stretch) -> Following | None:
    q, ref, rate = part.q, part.extra["q_ref"], part.rate
    moving = np.flatnonzero((q.std(0) > MOVED) & (ref.std(0) > 1e-12))
    most = min(int(WIDEST * rate), len(q) // 3)
    if not len(moving) or most < 2:
        return None
    step = max(1, int(rate / COARSE))
    lags = np.arange(-(most // step), most // step + 1) * step
    pooled = np.mean(np.log(_missed(q[:, moving], ref[:, moving], lags, step)), axis=1)
    lowest = [k for k in range(len(lags)) if pooled[k] == pooled[max(0, k - 1) : k + 2].min()]
    lowest = sorted(lowest, key=lambda k: pooled[k])[:PEAKS]
    tried = [_near(q[:, moving], ref[:, moving], int(lags[k]), step, most) for k in lowest]
    least = min(x.missed for x in tried)
    alike = [x for x in tried if x.missed < ALIKE * least]
    best = min(alike, key=lambda x: (np.median(x.factor) < 0, abs(x.lag)))
    factor = np.full(q.shape[1], np.nan)
    factor[moving] = best.factor
    others = tuple(x.lag / rate for x in alike if abs(x.lag - best.lag) > 2 * step)
    single = best.single / rate
    lag = best.lag / rate
    return Following(part.trajectory, lag, single.min(), single.max(), factor, best.explained, others)


@dataclass(frozen=True)
class _Peak:
    """A lag [samples] at which q_ref explains q best for some around: the geometric mean over joints of what it leaves
    of the variance, each joint's own lag and slope, the median share that is explained."""

    lag: float
    missed: float
    single: np.ndarray
    factor: np.ndarray
    explained: float


def _near(q: np.ndarray, ref: np.ndarray, lag: int, step: int, most: int) -> _Peak:
    """The best lag within a step of a given one."""
    fine = np.arange(max(-most, lag - step), min(most, lag + step) + 1)
    missed = _missed(q, ref, fine, 1)
    pooled = np.mean(np.log(missed), axis=1)
    at = int(fine[np.argmin(pooled)])
    y, x = q[max(0, at) : len(q) + min(0, at)], ref[max(0, -at) : len(q) - max(0, at)]
    y, x = y - y.mean(0), x - x.mean(0)
    factor = np.sum(y * x, axis=0) / np.maximum(np.sum(x**2, axis=0), 1e-300)
    single = np.array([lowest(fine, column) for column in np.log(missed).T])
    explained = 1 - float(np.median(missed[np.argmin(pooled)]))
    return _Peak(lowest(fine, pooled), float(np.exp(pooled.min())), single, factor, explained)


def _missed(q: np.ndarray, ref: np.ndarray, lags: np.ndarray, step: int) -> np.ndarray:
    """(lags, joints) 1 - squared correlation of q with q_ref so many samples before it, over the same rows."""
    most = int(np.abs(lags).max())
    rows = np.arange(most, len(q) - most, step)
    rows = rows[:: max(1, len(rows) // 1500)]
    y = q[rows] - q[rows].mean(0)
    power = np.sum(y**2, axis=0)
    out = np.ones((len(lags), q.shape[1]))
    for k, lag in enumerate(lags):
        x = ref[rows - lag]
        x = x - x.mean(0)
        scale = power * np.sum(x**2, axis=0)
        out[k] = 1 - np.divide(np.sum(x * y, axis=0) ** 2, scale, out=np.zeros_like(scale), where=scale > 0)
    return np.maximum(out, 1e-9)


@dataclass(frozen=True)
class CommandUnits(AbstractCheck):
    """q_ref in another unit or with the opposite sign: the slope of q on q_ref at their common lag.

    Attributes:
        within: relative distance of a slope from a unit's (ours: a controller tracks well-moved joints to 2 %).
        most: share of the moving joints that have to agree on a unit.
    """

    name: ClassVar[str] = "unit_error"
    within: float = 0.03
    most: float = 0.8

    def examine(self, log: Log, robot: Robot | None) -> list[Check]:
        """Per recording; the value is q_ref over q."""
        fits, found = _followed(self, log)
        for one in fits:
            ratios = 1 / one.factor[np.isfinite(one.factor)]
            unit = next((u for u in UNITS if np.mean(np.abs(np.abs(ratios) / u - 1) < self.within) >= self.most), None)
            if unit is not None:
                found.append(self._seen(one, float(np.median(np.abs(ratios))), unit, UNITS[unit]))
        return found

    def correct(self, log: Log, found: Sequence[Check], robot: Robot | None) -> tuple[Log, list[str]]:
        """Divide q_ref by the exact factor."""
        by = {c.trajectory: c.threshold["factor"] for c in found}
        notes = [f"{name}: q_ref divided by {factor:.7g}, it is in {UNITS[factor]}" for name, factor in by.items()]
        slides = np.array(robot.prismatic) if robot else np.zeros(len(log.joints), bool)

        def change(raw: RawTrajectory) -> RawTrajectory:
            if raw.q_ref is None:
                return raw
            return replace(raw, q_ref=raw.q_ref / np.where(slides, 1.0, by[raw.name]))

        return each(log, change, by), notes

    def _seen(self, one: Following, value: float, unit: float, words: str) -> Check:
        return Check(
            self.name,
            "warn",
            one.trajectory,
            value=value,
            threshold={"channel": "q_ref", "factor": unit, "within": self.within},
            seen=f"q_ref is {value:.4g} times q at a lag of {1e3 * one.lag:.4g} ms; this "
            f"explains {100 * one.explained:.4g} % of q (median of the joints)",
            meaning=f"q_ref is in {words}",
            advice="convert q_ref to rad",
            source="exact ratio of two units",
        )


@dataclass(frozen=True)
class CommandSigns(AbstractCheck):
    """Joints whose q_ref has the opposite sign of q.

    Attributes:
        within: distance of the slope of q on q_ref from -1.
    """

    name: ClassVar[str] = "sign_error"
    within: float = 0.1

    def examine(self, log: Log, robot: Robot | None) -> list[Check]:
        """Per recording and joint; the value is the slope."""
        fits, found = _followed(self, log)
        for one in fits:
            for j in np.flatnonzero(np.abs(one.factor + 1) < self.within):
                found.append(
                    Check(
                        self.name,
                        "warn",
                        one.trajectory,
                        log.joints[j],
                        value=float(one.factor[j]),
                        threshold={"channel": "q_ref", "within": self.within},
                        seen=f"q is {one.factor[j]:.3g} times q_ref at a lag of {1e3 * one.lag:.4g} ms",
                        meaning="q_ref has the opposite sign of q on this joint",
                        advice="check the sign convention of the commanded positions",
                        source="own choice: a controller tracks moving joints to 10 %",
                    )
                )
        return found

    def correct(self, log: Log, found: Sequence[Check], robot: Robot | None) -> tuple[Log, list[str]]:
        """Turn q_ref of these joints round."""
        turned = [(c.trajectory, c.joint) for c in found]

        def change(raw: RawTrajectory) -> RawTrajectory:
            if raw.q_ref is None:
                return raw
            sign = np.array([-1.0 if (raw.name, joint) in turned else 1.0 for joint in log.joints])
            return replace(raw, q_ref=raw.q_ref * sign)

        changed = each(log, change, {name for name, _ in turned})
        return changed, [f"{name}: sign of q_ref turned: {joint}" for name, joint in turned]


@dataclass(frozen=True)
class CommandLag(AbstractCheck):
    """How much later q comes than q_ref, by cross-correlation over seconds and all joints.

    Attributes:
        lag: [s] that is worth a note (ours), or `samples` where these are longer.
    """

    name: ClassVar[str] = "time_offset"
    lag: float = 0.01
    samples: float = 1.5

    def examine(self, log: Log, robot: Robot | None) -> list[Check]:
        """Per recording; the value is the lag [s]."""
        fits, found = _followed(self, log)
        for one in fits:
            limit = max(self.lag, self.samples / log.rate if log.rate > 0 else 0.0)
            word = "later" if one.lag > 0 else "earlier"
            seen = f"q follows q_ref {1e3 * abs(one.lag):.4g} ms {word} (single joints {1e3 * one.least:.4g} to "
            seen += f"{1e3 * one.most:.4g} ms; {100 * one.explained:.5g} % of q explained)"
            if one.others:
                seen += f"; {', '.join(f'{x:.3g}' for x in one.others)} s fit as well: the motion repeats"
            found.append(
                Check(
                    self.name,
                    "note" if abs(one.lag) > limit else "ok",
                    one.trajectory,
                    value=one.lag,
                    threshold={"channel": "q_ref", "seconds": limit},
                    seen=seen,
                    meaning=_meaning(one.lag, limit),
                    source="own choice",
                )
            )
        return found


def _meaning(lag: float, limit: float) -> str:
    if abs(lag) <= limit:
        return ""
    if lag < 0 or lag > 0.5:
        return "the lag is longer than a controller's, or q leads: q_ref and q have different clocks or buffers"
    return "it is the controller's tracking lag, or q and q_ref have different clocks; q_ref cannot replace q"


def _followed(check: AbstractCheck, log: Log) -> tuple[list[Following], list[Check]]:
    """The recordings whose q follows q_ref, and why the check was skipped for the others."""
    if all(raw.q_ref is None for raw in log.trajectories):
        return [], [check.skipped("q_ref is not logged", "q_ref")]
    fits = following(log)
    if not fits:
        return [], [check.skipped("no joint with q_ref moves", "q_ref")]
    skipped = [check.skipped(_unlike(one), "q_ref", one.trajectory) for one in fits if one.explained < EXPLAINED]
    return [one for one in fits if one.explained >= EXPLAINED], skipped


def _unlike(one: Following) -> str:
    return (
        f"at the best lag q_ref explains only {100 * one.explained:.2g} % of q (needed: {100 * EXPLAINED:g} %): unit, "
        "sign and lag of q_ref are not checked"
    )
