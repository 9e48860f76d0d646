"""Rows that a program held back, and stamped together when it wrote them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from invdyn_cli.diagnosis.checks.stamps import AbstractLateStamps, Followed, precision
from invdyn_cli.log import RawTrajectory

LONG, SHORT = 3.0, 0.5
"""Periods: a step in which rows may have been held back is longer, those between such rows are shorter."""

FEWEST = 3
"""Short steps, from which on they are no chance."""

NEAR = 10
"""Number of rows on either side from which the regular clock is taken."""

SMOOTH, TINY = 6, 1e-18
"""Degree of the polynomial that a joint follows for the time of held rows; least mean square of what it leaves."""

MOST_LOST, LONGEST = 5, 0.5
"""Lost rows, and [s] of held ones, up to which the positions tell where: of more the polynomial knows nothing, and all
places would take minutes."""

LEFT = 0.25
"""Share of the time by which the first of such rows is late that the last one may be late, beside a period: a lost row
makes it a period later."""


@dataclass(frozen=True)
class HeldRows(AbstractLateStamps):
    """A long step, and then as many short ones as make up for it: rows that waited for a busy computer or network, and
    got their stamps when they were written.

    A row that was sampled at its stamp moves by the speed times its step; one that was held back moves by the speed
    times the period.
    """

    def followed(self, raw: RawTrajectory) -> Followed | None:
        asked, seen, longest, count = [], [], 0.0, 0
        for rows in held(raw.t):
            t, q = raw.t[rows], raw.q[rows]
            speed, even = (q[-1] - q[0]) / (t[-1] - t[0]), (t[-1] - t[0]) / (len(t) - 1)
            asked.append(speed * (np.diff(t) - even)[:, None])
            seen.append(np.diff(q, axis=0) - speed * even)
            longest, count = max(longest, t[1] - t[0]), count + 1
        if not asked:
            return None
        x, y = np.concatenate(asked), np.concatenate(seen)
        weights = precision(x, y)
        squares = float(np.sum(x * x @ weights))
        if not np.isfinite(squares) or not squares > 0:
            return None
        said = f"{count} times no row for up to {longest:.3g} s, and then the missing rows at once"
        return Followed(float(np.sum(x * y @ weights)) / squares, squares**-0.5, said)

    def regular(self, raw: RawTrajectory) -> tuple[np.ndarray, str]:
        """For the rows that were held back."""
        t, period, groups = raw.t.copy(), _period(raw.t), list(held(raw.t))
        for rows in groups:
            t[rows.start + 1 : rows.stop] = _in_time(raw, rows, period)
        return t, f"rows that were written together ({len(groups)} times) moved to a regular clock"


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
        last = k + 1 + int(np.argmax(behind <= behind.min() + SHORT * period))  # the first of those that are least late
        if last - k <= FEWEST or np.median(steps[k + 1 : last]) >= SHORT * period:
            continue
        if behind.min() <= LEFT * late + period:
            end = last
            yield slice(int(k), last + 1)


def _in_time(raw: RawTrajectory, rows: slice, period: float) -> np.ndarray:
    """Regular stamps [s] for all but the first of some rows that were `held`. Of the NEAR rows on either side, which
    vary, the earliest for its place counts. If a few rows were lost among a few, the positions tell where; else it
    were the first ones."""
    t, first, last = raw.t, rows.start, rows.stop - 1
    ahead, behind = t[max(0, first - NEAR) : first + 1], t[last : last + NEAR + 1]
    before = np.min(ahead + period * np.arange(len(ahead))[::-1])
    after = np.min(behind - period * np.arange(len(behind)))
    count = last - first
    lost = [0] * max(0, round((after - before) / period) - count)
    outside = slice(max(0, first - 2 * NEAR), last + 1 + 2 * NEAR)
    q = raw.q[outside]

    def stamps(lost: Sequence[int]) -> np.ndarray:
        return before + period * (1 + np.arange(count) + np.sum([np.arange(count) >= k for k in lost], axis=0))

    def rough(lost: Sequence[int]) -> float:
        """How far the positions are from a smooth course, with one more step before each of these rows."""
        moved = np.concatenate([t[outside.start : first + 1], stamps(lost), t[last + 1 : outside.stop]]) - before
        course = np.vander(moved / np.abs(moved).max(), SMOOTH + 1)
        left = q - course @ np.linalg.lstsq(course, q, rcond=None)[0]
        return float(np.sum(np.log(np.mean(left**2, axis=0) + TINY)))

    for i in range(len(lost) if len(lost) <= MOST_LOST and count * period <= LONGEST else 0):
        lost[i] = min(range(count), key=lambda k: rough([*lost[:i], k, *lost[i + 1 :]]))
    return stamps(lost)


def _period(t: np.ndarray) -> float:
    """[s] The median step, or the mean one if most rows were written together."""
    usual, mean = float(np.median(np.diff(t))), float(t[-1] - t[0]) / (len(t) - 1)
    return usual if usual > SHORT * mean else mean
