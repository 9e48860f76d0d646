"""The clock of a log: rows that repeat, jitter, the nominal rate, gaps, and whether enough is left."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from invdyn_cli.interfaces import AbstractCheck
from invdyn_cli.log import Log, RawTrajectory
from invdyn_cli.recording.rows import (
    clock_pieces,
    each,
    is_series,
    longest_step,
    median_step,
    parted,
    uninterrupted,
    usable_rows,
)
from invdyn_cli.types import Check, Robot

NO_SERIES = "no time series: no clock to judge"


@dataclass(frozen=True)
class Duplicates(AbstractCheck):
    """Time stamps that repeat or run backwards, and rows that repeat the one before while the arm moves.

    A row counts as repeated if q and tau of all joints equal those of the row before exactly, although a joint moves by
    more than `moving` in the `reach` rows around it: two noisy samples of a moving arm do not agree by chance. A clock
    that restarts is another trajectory, not a defect of single rows (`rows.clock_pieces`).

    Attributes:
        share: of repeated rows that is worth a warning (ours: at 1 % linear interpolation still restores them).
        moving: [rad; m] over `reach` rows (ours: ten times the resolution of a 16 bit encoder on a turn).
        reach: rows.
    """

    name: ClassVar[str] = "duplicates"
    share: float = 0.01
    moving: float = 1e-3
    reach: int = 11

    def examine(self, log: Log, robot: Robot | None) -> list[Check]:
        """Per trajectory."""
        found = []
        for raw in log.trajectories:
            pieces = clock_pieces(raw.t)
            if len(pieces) > 1:
                times = "once" if len(pieces) == 2 else f"{len(pieces) - 1} times"
                found.append(
                    Check(
                        self.name,
                        "fail",
                        raw.name,
                        value=len(pieces) - 1,
                        threshold=0,
                        seen=f"the clock restarts {times}, first in row {pieces[1][0]}",
                        meaning=f"the trajectory contains {len(pieces)} recordings; they are read separately",
                        advice="a file, or a trajectory, for each recording",
                        source="a clock increases",
                    )
                )
            stuck = np.isfinite(raw.t)
            stuck[np.concatenate(pieces)] = False
            if stuck.any():
                found.append(
                    Check(
                        self.name,
                        "fail",
                        raw.name,
                        value=int(stuck.sum()),
                        threshold=0,
                        seen=f"in {stuck.sum()} of {len(stuck)} rows the time stamp does not increase, "
                        f"first in row {np.argmax(stuck)}",
                        meaning="rows were written twice, or out of order",
                        advice="stamp each sample where it is taken, and write the samples in order",
                        source="a clock increases",
                    )
                )
            repeated = self.repeated(raw)
            if repeated.any():
                part = float(repeated.mean())
                found.append(
                    Check(
                        self.name,
                        "warn" if part > self.share else "note",
                        raw.name,
                        value=int(repeated.sum()),
                        threshold=self.share,
                        seen=f"{repeated.sum()} rows ({100 * part:.2g} %) have exactly the q and tau of the row "
                        "before, although the arm moves",
                        meaning="the log is written at a higher rate than its source, or each lost sample is replaced "
                        "by a copy of the last one",
                        advice="logging at the source's own rate",
                        source="own choice: noise on all channels does not repeat by chance",
                    )
                )
        return found

    def correct(self, log: Log, found: Sequence[Check], robot: Robot | None) -> tuple[Log, list[str]]:
        """Drop such rows; divide a trajectory where its clock starts anew."""
        notes = []

        def change(raw: RawTrajectory) -> list[RawTrajectory]:
            drop = self.repeated(raw)
            pieces = [rows[~drop[rows]] for rows in clock_pieces(raw.t)]
            gone = len(raw.t) - sum(map(len, pieces))
            done = [f"dropped {gone} rows whose stamps are out of order or whose values repeat"] if gone else []
            if len(pieces) > 1:
                done.append(f"read as {len(pieces)} recordings, parted where the clock restarts")
            notes.append(f"{raw.name}: {'; '.join(done)}")
            return parted(raw, pieces)

        return each(log, change, {c.trajectory for c in found}), notes

    def repeated(self, raw: RawTrajectory) -> np.ndarray:
        """(T,) bool."""
        out = np.zeros(len(raw.t), bool)
        if len(raw.t) <= self.reach:
            return out
        same = (raw.q[1:] == raw.q[:-1]).all(1) & (raw.tau[1:] == raw.tau[:-1]).all(1)
        rows = np.flatnonzero(same) + 1
        low, high = np.maximum(rows - self.reach // 2, 0), np.minimum(rows + self.reach // 2, len(raw.t) - 1)
        moves = np.abs(raw.q[high] - raw.q[low]).max(1, initial=0) > self.moving
        out[rows[moves]] = True
        return out


@dataclass(frozen=True)
class ClockJitter(AbstractCheck):
    """How regular the clock is, and whether it has the nominal rate.

    Attributes:
        note, warn: standard deviation of the steps in median steps (first order: linear interpolation over a step errs
            by qdd dt^2 / 8, below encoder noise for regular steps; half a step of doubt is as much as a hold's).
        rate: relative difference of nominal and median rate (ours: `data.real_log` believes the median from there on).
    """

    name: ClassVar[str] = "clock_jitter"
    note: float = 0.1
    warn: float = 0.5
    rate: float = 0.2

    def examine(self, log: Log, robot: Robot | None) -> list[Check]:
        """Per trajectory; trajectories of poses have no clock to speak of."""
        found = []
        series = [raw for raw in log.trajectories if is_series(raw)]
        if not series:
            return [self.skipped(NO_SERIES)]
        for raw in series:
            step = median_step(raw.t)
            if not np.isfinite(step):
                continue
            steps = np.diff(raw.t[usable_rows(raw)])
            steps = steps[steps <= longest_step(steps)]
            jitter = float(steps.std() / step) if len(steps) else 0.0
            if jitter > self.note:
                found.append(
                    Check(
                        self.name,
                        "warn" if jitter > self.warn else "note",
                        raw.name,
                        value=jitter,
                        threshold=self.warn if jitter > self.warn else self.note,
                        seen=f"steps of {1e3 * step:.3g} ms vary by {1e3 * jitter * step:.2g} ms (standard deviation), "
                        f"from {1e3 * steps.min():.2g} to {1e3 * steps.max():.3g} ms",
                        meaning="the log is interpolated to a uniform clock, which attenuates fast signals",
                        advice="time stamps from the controller, not from the program that writes the log",
                        source="own choice: half a step, as much as the delay of a zero-order hold",
                    )
                )
            off = log.rate * step - 1
            if not abs(off) <= self.rate:
                found.append(
                    Check(
                        self.name,
                        "warn",
                        raw.name,
                        value=1 / step,
                        threshold=self.rate,
                        seen=f"the nominal rate is {log.rate:g} Hz, the median step corresponds to {1 / step:.4g} Hz",
                        meaning="the rate attribute or the time stamps are wrong; the time stamps are used",
                        advice="set the log's rate attribute to the rate of its clock",
                        source="own choice: if both rates differ by over 20 %, data=real_log uses the median step",
                    )
                )
        return found

    def correct(self, log: Log, found: Sequence[Check], robot: Robot | None) -> tuple[Log, list[str]]:
        """The median rate instead of an impossible nominal one."""
        rates = [1 / step for raw in log.trajectories if np.isfinite(step := median_step(raw.t))]
        if (np.isfinite(log.rate) and log.rate > 0) or not rates:
            return log, []
        rate = float(np.median(rates))
        return replace(log, rate=rate), [f"nominal rate taken from the stamps, {rate:.4g} Hz"]


@dataclass(frozen=True)
class Gaps(AbstractCheck):
    """Steps longer than `rows.longest_step`: reading parts a trajectory there.

    Attributes:
        share: of the time that is missing, from which on it is a warning (ours: a tenth of the data).
    """

    name: ClassVar[str] = "gaps"
    share: float = 0.1

    def examine(self, log: Log, robot: Robot | None) -> list[Check]:
        """Per trajectory; the value is the longest gap [s]."""
        found = []
        series = [raw for raw in log.trajectories if is_series(raw)]
        if not series:
            return [self.skipped(NO_SERIES)]
        for raw in series:
            pieces = uninterrupted(raw)
            if len(pieces) < 2:
                continue
            lengths = np.array([raw.t[b[0]] - raw.t[a[-1]] for a, b in itertools.pairwise(pieces)])
            whole = raw.t[pieces[-1][-1]] - raw.t[pieces[0][0]]
            missing = float(lengths.sum() / whole)
            worst = int(np.argmax(lengths))
            found.append(
                Check(
                    self.name,
                    "warn" if missing > self.share else "note",
                    raw.name,
                    value=float(lengths.max()),
                    threshold=longest_step(np.diff(raw.t[usable_rows(raw)])),
                    seen=f"{len(lengths)} gap{'s' * (len(lengths) > 1)}, the longest {lengths.max():.3g} s at "
                    f"t = {raw.t[pieces[worst][-1]]:.3f} s, {100 * missing:.2g} % of the time is missing",
                    meaning="nothing is interpolated across a gap: the trajectory is divided there",
                    advice="a buffer or a faster disk for the logger" if missing > self.share else "",
                    source="own choice, as data.max_gap",
                )
            )
        return found


@dataclass(frozen=True)
class TooShort(AbstractCheck):
    """Whether trajectories, and the log as a whole, are long enough to filter and to learn from.

    Attributes:
        log: [s] (ours: less than one slow movement of an arm).
        trajectory: [s] (first order: a 10 Hz zero-phase Butterworth of order 4 unsettles 0.1 s at either end, thrice
            that has to be left between them).
    """

    name: ClassVar[str] = "too_short"
    log: float = 2.0
    trajectory: float = 0.5

    def examine(self, log: Log, robot: Robot | None) -> list[Check]:
        """Per trajectory, and for the log; the value is the length [s]."""
        lengths = {raw.name: _seconds(raw) for raw in log.trajectories}
        short = {name: x for name, x in lengths.items() if x < self.trajectory}
        total = sum(x for name, x in lengths.items() if name not in short)
        found = [
            Check(
                self.name,
                "warn",
                name,
                value=x,
                threshold=self.trajectory,
                seen=f"{x:.3g} s without a break",
                meaning="too short to be filtered and differentiated; it is left out",
                advice="a longer recording",
                source="first order: transients of a 10 Hz zero-phase low-pass of order 4 at both ends",
            )
            for name, x in short.items()
        ]
        if total < self.log:
            found.append(
                Check(
                    self.name,
                    "fail",
                    value=total,
                    threshold=self.log,
                    seen=f"{total:.3g} s of motion in the whole log",
                    meaning="too little to compute with",
                    advice="a recording of a minute or more in which all joints move back and forth"
                    + ("; or another unit of its clock, such as time: {unit: ms}" if short else ""),
                    source="own choice: less than one slow movement of an arm",
                )
            )
        return found

    def correct(self, log: Log, found: Sequence[Check], robot: Robot | None) -> tuple[Log, list[str]]:
        """Leave short trajectories out."""
        short = {c.trajectory: c for c in found if c.trajectory}
        notes = [f"{name}: left out, {c.seen}" for name, c in short.items()]
        return replace(log, trajectories=tuple(x for x in log.trajectories if x.name not in short)), notes


def _seconds(raw: RawTrajectory) -> float:
    """Length [s] of the longest uninterrupted stretch."""
    return max((float(raw.t[rows[-1]] - raw.t[rows[0]]) for rows in uninterrupted(raw)), default=0.0)
