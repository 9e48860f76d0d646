"""Rows of a logged trajectory: which ones are usable, and how they are kept and divided. This module does not
judge defects."""

import bisect
import itertools
from collections.abc import Callable, Container
from dataclasses import replace
from typing import Any

import numpy as np

from invdyn_cli.log import CHANNELS, Log, RawTrajectory
from invdyn_cli.maths.signals import lattice

MAX_GAP = 0.1
"""[s] A longer step divides a trajectory, as `data.max_gap` does on reading."""

RESTART = 20
"""Number of rows after which a clock that jumped back counts as restarted: the window of the shortest filter. With
fewer rows it is a bad time stamp."""

STEPS, COARSEST = 4.0, 0.0065
"""Steps of an encoder between rows above which the steps do not count; and the largest step [rad; m] that counts as an
encoder's (ten bits a turn): rows that are poses on a grid have a step, too."""


def present(raw: RawTrajectory) -> dict[str, np.ndarray]:
    """The number channels (T, n) that a trajectory has."""
    return {name: getattr(raw, name) for name in CHANNELS if getattr(raw, name) is not None}


def taken(raw: RawTrajectory, rows: Any, name: str | None = None) -> RawTrajectory:
    """The trajectory with only these rows (a slice, indices or a mask)."""
    changed: dict[str, Any] = {c: x[rows] for c, x in present(raw).items()}
    changed |= {c: x[rows] for c in ("stage", "rows") if (x := getattr(raw, c)) is not None}
    return replace(raw, t=raw.t[rows], name=name or raw.name, **changed)


def parted(raw: RawTrajectory, pieces: list[np.ndarray]) -> list[RawTrajectory]:
    """The trajectory as pieces of row numbers; several get names of their own, "run.1", "run.2"."""
    pieces = [rows for rows in pieces if len(rows)]
    if len(pieces) == 1:
        return [taken(raw, pieces[0])]
    return [taken(raw, rows, f"{raw.name}.{i}") for i, rows in enumerate(pieces, start=1)]


def each(
    log: Log,
    change: Callable[[RawTrajectory], RawTrajectory | list[RawTrajectory]],
    names: Container[str | None] | None = None,
) -> Log:
    """The log with every trajectory, or every one with such a name, replaced by none, one or several."""
    made = [change(raw) if names is None or raw.name in names else raw for raw in log.trajectories]
    return replace(log, trajectories=tuple(x for one in made for x in (one if isinstance(one, list) else [one])))


def median_step(t: np.ndarray) -> float:
    """Median of the steps that go forward in t (T,) [s], NaN where there is none."""
    steps = np.diff(t)
    steps = steps[np.isfinite(steps) & (steps > 0)]
    return float(np.median(steps)) if len(steps) else float("nan")


def clock_pieces(t: np.ndarray) -> list[np.ndarray]:
    """Rows of t (T,) [s] that follow each other in time, apart where the clock starts anew for at least RESTART rows.

    Of each piece these are the longest sequence of rows with increasing time stamps: a stamp that is far too late costs
    only its own row, not all rows after it.
    """
    back = np.flatnonzero(np.diff(t) < 0) + 1
    starts = [int(row) for row in back if _starts_anew(t, int(row))]
    return [
        start + _longest_increasing(t[start:end])
        for start, end in itertools.pairwise([0, *starts, len(t)])
        if end > start
    ]


def forward_rows(t: np.ndarray) -> np.ndarray:
    """(T,) bool: rows of t (T,) [s] in time order, and later than all of a clock that started anew."""
    out, latest = np.zeros(len(t), bool), -np.inf
    for rows in clock_pieces(t):
        rows = rows[t[rows] > latest]
        out[rows] = True
        latest = float(t[rows[-1]]) if len(rows) else latest
    return out


def _starts_anew(t: np.ndarray, row: int) -> bool:
    """Whether the clock jumps back at a row: it continues from there, and stays behind the times of most rows
    before."""
    before, after = t[max(0, row - RESTART) : row], t[row : row + RESTART]
    if len(before) < RESTART or len(after) < RESTART or not np.all(np.diff(after) > 0):
        return False
    return bool(after[-1] <= np.nanmedian(before))


def _longest_increasing(t: np.ndarray) -> np.ndarray:
    """Indices of the longest sequence in t (T,) that strictly increases, numbers that are not finite left out."""
    rows = np.flatnonzero(np.isfinite(t))
    if np.all(np.diff(t[rows]) > 0):
        return rows
    values, ends, last, before = t[rows].tolist(), [], [], []
    for i, value in enumerate(values):  # ends[k]: the least value in which a sequence of k + 1 rows can end
        k = bisect.bisect_left(ends, value)
        if k == len(ends):
            ends.append(value)
            last.append(i)
        ends[k], last[k] = value, i
        before.append(last[k - 1] if k else -1)
    chosen, i = [], last[-1]
    while i >= 0:
        chosen.append(i)
        i = before[i]
    return rows[chosen[::-1]]


def usable_rows(raw: RawTrajectory) -> np.ndarray:
    """(T,) bool: finite in t, q and tau, and in time order."""
    return forward_rows(raw.t) & np.isfinite(raw.q).all(1) & np.isfinite(raw.tau).all(1)


def largest_ranges(log: Log, channel: str) -> np.ndarray:
    """(n,) what the columns of a channel range over in usable rows, in the trajectory where that is most."""
    parts = [getattr(raw, channel)[usable_rows(raw)] for raw in log.trajectories]
    return np.max([np.ptp(x, axis=0) if len(x) else np.zeros(len(log.joints)) for x in parts], axis=0)


def longest_step(steps: np.ndarray) -> float:
    """[s] The longest of these steps (T - 1,) [s] that does not divide a trajectory: MAX_GAP, or five median steps."""
    return max(MAX_GAP, 5 * float(np.median(steps))) if len(steps) else MAX_GAP


def without_gaps(t: np.ndarray, rows: np.ndarray, longest: float | None = None) -> list[np.ndarray]:
    """Row numbers, in the order of t (T,) [s], parted where a step is longer than `longest` [s], or `longest_step`."""
    steps = np.diff(t[rows])
    longest = longest_step(steps) if longest is None else longest
    return np.split(rows, np.flatnonzero(steps > longest) + 1) if len(rows) else []


def uninterrupted(raw: RawTrajectory) -> list[np.ndarray]:
    """Row numbers of the stretches of usable rows without a gap."""
    return without_gaps(raw.t, np.flatnonzero(usable_rows(raw)))


def runs(flags: np.ndarray) -> np.ndarray:
    """(R, 2) first row and row after the last of every run of True in flags (T,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    return edges.reshape(-1, 2)


def is_series(raw: RawTrajectory, *, moved: float = 0.05, roughness: float = 1.0) -> bool:
    """Whether rows follow each other as in a motion; single poses and shuffled rows do not.

    A joint's second differences are small compared with its first ones if it is sampled well. If rows are unrelated,
    the RMS of the second is sqrt(3) times that of the first (the variances of the differences of white noise are 6 and
    2). Judged are joints that move more than `moved` [rad]: for one of them the ratio must be below `roughness`. Where
    an encoder's steps come row by row, one at a time, they are sqrt(2) times the first: such a joint is judged by rows
    that are STEPS of them apart. Differences across gaps are left out.
    """
    rows = np.flatnonzero(usable_rows(raw))[:20_000]
    if len(rows) < 4:
        return False
    q, t = raw.q[rows], raw.t[rows]
    moving = np.flatnonzero(np.ptp(q, axis=0) > moved)
    return not len(moving) or any(_roughness(t, q[:, j]) < roughness for j in moving)


def _roughness(t: np.ndarray, x: np.ndarray) -> float:
    """RMS of the second differences of x (T,) over that of the first, on rows that are so far apart that an encoder's
    steps, if it has any as small as COARSEST, do not count."""
    step, first, second = lattice(x), 0.0, 0.0
    for apart in [n for n in 2 ** np.arange(10) if n == 1 or len(x) > 20 * n]:
        own, steps = x[::apart], np.diff(t[::apart])
        near = steps <= longest_step(steps)
        both = near[1:] & near[:-1]
        if not both.any():  # rows farther apart than a gap: poses, or a clock in other units
            near, both = np.ones_like(near), np.ones_like(both)
        first = float(np.sqrt(np.mean(np.diff(own)[near] ** 2)))
        second = float(np.sqrt(np.mean(np.diff(own, 2)[both] ** 2)))
        if first >= STEPS * step or step > COARSEST:
            break
    return second / max(first, 1e-300)
