"""Rows that a program held back, and stamped together when it wrote them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from invdyn_cli.diagnosis.checks.stamps import precision
from invdyn_cli.interfaces import AbstractCheck
from invdyn_cli.log import Log, RawTrajectory
from invdyn_cli.recording.rows import each
from invdyn_cli.types import Check, Robot

LONG, SHORT = 3.0, 0.5
"""Periods: a step in which rows may have been held back is longer, those between such rows are shorter."""

FEWEST = 3
"""Short steps, from which on they are no chance."""

NEAR = 10
"""Number of rows on either side from which the regular clock is taken."""

LEFT = 0.25
"""Share of the time by which the first of such rows is late that the last one may be late, beside a period: a lost row
makes it a period later."""


@dataclass(frozen=True)
class HeldRows(AbstractCheck):
    """A long step, and then as many short ones as make up for it: rows that waited for a busy computer or network, and
    got their stamps when they were written.

    A row that was sampled at its stamp moves by the speed times its step; one that was held back moves by the speed
    times the period. Least squares tell the share of the former.

    Attributes:
        share: from which, by three standard errors, the positions are nearer to regular samples than to their stamps.
    """

    name: ClassVar[str] = "clock_jitter"
    share: float = 0.5

    def examine(self, log: Log, robot: Robot | None) -> list[Check]:
        """Per trajectory; the value is the share."""
        found = []
        for raw in log.trajectories:
            groups = list(held(raw.t))
            told = _followed(raw, groups)
            if told is None or abs(told[0]) + 3 * told[1] > self.share:
                continue
            longest = max(raw.t[rows.start + 1] - raw.t[rows.start] for rows in groups)
            found.append(
                Check(
                    self.name,
                    "note",
                    raw.name,
                    value=told[0],
                    threshold=self.share,
                    seen=f"{len(groups)} times no row for up to {longest:.3g} s, and then the missing rows at once; "
                    f"positions show only {100 * abs(told[0]):.2g} % of this (standard error {100 * told[1]:.2g} %)",
                    meaning="samples were taken regularly and stamped late: there are no gaps",
                    advice="time stamps from the controller, not from the program that writes the log",
                    source="least squares on steps of the positions; halfway between both",
                )
            )
        return found

    def correct(self, log: Log, found: Sequence[Check], robot: Robot | None) -> tuple[Log, list[str]]:
        """Regular stamps for the rows that were held back."""
        where, notes = {c.trajectory for c in found}, []

        def change(raw: RawTrajectory) -> RawTrajectory:
            if raw.name not in where:
                return raw
            t, period, groups = raw.t.copy(), _period(raw.t), list(held(raw.t))
            for rows in groups:
                t[rows.start + 1 : rows.stop] = _in_time(raw.t, rows, period)
            notes.append(f"{raw.name}: rows that were written together ({len(groups)} times) put on a regular clock")
            return replace(raw, t=t)

        return each(log, change), notes


def held(t: np.ndarray) -> Iterator[slice]:
    """Rows of stamps t (T,) [s] that were written together, each time with the row before them, which was in time."""
    steps = np.diff(t)
    if not len(steps) or not np.isfinite(steps).all():
        return
    period, end = _period(t), 0
    for k in np.flatnonzero(steps > LONG * period):
        if k < end:
            continue
        late = steps[k] - period
        after = t[k + 1 : k + 1 + int(2 * late / period)]
        behind = np.maximum(after - t[k] - period * np.arange(1, len(after) + 1), period)
        last = k + 1 + int(np.argmin(behind))
        if last - k <= FEWEST or np.median(steps[k + 1 : last]) >= SHORT * period:
            continue
        if behind.min() <= LEFT * late + period:
            end = last
            yield slice(int(k), last + 1)


def _in_time(t: np.ndarray, rows: slice, period: float) -> np.ndarray:
    """Regular stamps, before the last one, for all but the first of some rows that were `held`: if rows were lost, the
    first ones. Of the NEAR rows on either side, which vary, the earliest for its place counts."""
    first, last = rows.start, rows.stop - 1
    ahead, behind = t[max(0, first - NEAR) : first + 1], t[last : last + NEAR + 1]
    before = np.min(ahead + period * np.arange(len(ahead))[::-1])
    after = np.min(behind - period * np.arange(len(behind)))
    lost = max(0.0, np.round((after - before) / period) - (last - first))
    return before + period * (lost + np.arange(1, last - first + 1))


def _period(t: np.ndarray) -> float:
    """[s] The median step, or the mean one if most rows were written together."""
    usual, mean = float(np.median(np.diff(t))), float(t[-1] - t[0]) / (len(t) - 1)
    return usual if usual > SHORT * mean else mean


def _followed(raw: RawTrajectory, groups: Sequence[slice]) -> tuple[float, float] | None:
    """The share of the steps of its stamps that the positions of a trajectory show in these rows, and its standard
    error; None without such rows or motion."""
    asked, seen = [], []
    for rows in groups:
        t, q = raw.t[rows], raw.q[rows]
        speed, even = (q[-1] - q[0]) / (t[-1] - t[0]), (t[-1] - t[0]) / (len(t) - 1)
        asked.append(speed * (np.diff(t) - even)[:, None])
        seen.append(np.diff(q, axis=0) - speed * even)
    if not groups:
        return None
    x, y = np.concatenate(asked), np.concatenate(seen)
    weights = precision(x, y)
    squares = float(np.sum(x * x @ weights))
    if not np.isfinite(squares) or not squares > 0:
        return None
    return float(np.sum(x * y @ weights)) / squares, squares**-0.5
