"""The data for the picture of one finding: its term, the residual of all other effects, and the stretch of time that
shows it best."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from invdyn_cli.diagnosis.decide.wording import units_of
from invdyn_cli.report.canvas import plain
from invdyn_cli.report.wording import claims, joints_of, windows
from invdyn_cli.types import Diagnosis, Finding, Signals

GAP = 5.0
"""Steps of the clock, in median steps, above which a recording counts as interrupted."""


@dataclass(frozen=True)
class Exhibit:
    """A finding with its signals.

    Attributes:
        finding: the finding.
        number: which claim it is, counted from 1.
        joints, units: of the columns.
        signals: of the whole diagnosis.
        term: (R, n) [N m; N] what the effect adds to the torque.
        residual: (R, n) [N m; N] what the other effects leave for it: tau - extended + term.
        column: the joint that is looked at: the finding's own, else the one where the term is largest.
    """

    finding: Finding
    number: int
    joints: tuple[str, ...]
    units: tuple[str, ...]
    signals: Signals
    term: np.ndarray
    residual: np.ndarray
    column: int

    @property
    def unit(self) -> str:
        """Of the looked-at joint's torque."""
        return self.units[self.column]

    def own(self, values: np.ndarray, *, moving: bool = False) -> np.ndarray:
        """The looked-at joint's column (R,) of some (R, n); NaN where it rests if only motion counts."""
        column = np.asarray(values, float)[:, self.column]
        return np.where(self.signals.valid[:, self.column], column, np.nan) if moving else column


def exhibits(diagnosis: Diagnosis) -> list[Exhibit]:
    """One for every claim, in their order; none without signals."""
    if diagnosis.signals is None:
        return []
    joints, units = joints_of(diagnosis), tuple(units_of(diagnosis).values())
    signals, found = diagnosis.signals, []
    for k, (finding, term) in enumerate(zip(claims(diagnosis), signals.terms, strict=True)):
        size = np.sum(np.square(np.nan_to_num(term)), axis=0)
        column = joints.index(finding.joint) if finding.joint in joints else int(np.argmax(size))
        residual = signals.tau - signals.extended + term
        found.append(Exhibit(finding, k + 1, joints, units, signals, term, residual, column))
    return found


def time_label(signals: Signals, rows: slice) -> str:
    """Of the time axis under rows of one recording."""
    return f"time in {plain(str(signals.trajectory[rows.start]))} [s]"


def in_window(finding: Finding, signals: Signals) -> np.ndarray:
    """(R,) whether a row lies in one of the finding's windows; nowhere without one."""
    inside = np.zeros(len(signals.t), bool)
    for start, end in windows(finding):
        inside |= (signals.t >= start) & (signals.t <= end)
    return inside & (signals.trajectory == finding.trajectory) if finding.trajectory is not None else inside


def recordings(signals: Signals) -> Iterator[slice]:
    """Rows of every stretch without interruption: one trajectory, a clock that runs on without a gap."""
    t, name = signals.t, signals.trajectory
    if not len(t):
        return
    step = np.diff(t)
    usual = np.median(step[step > 0]) if (step > 0).any() else 0.0
    cuts = np.flatnonzero((name[1:] != name[:-1]) | (step <= 0) | (step > GAP * usual)) + 1
    for start, end in pairwise((0, *cuts.tolist(), len(t))):
        yield slice(start, end)


def telling_window(
    signals: Signals,
    changing: np.ndarray,
    columns: Sequence[int],
    *,
    length: float = 8.0,
    where: str | None = None,
    around: tuple[float, float] | None = None,
) -> slice:
    """Rows of the `length` seconds in which `changing` (R, n) varies most in these columns.

    Among held-out rows where there are any; with `around` [s], in the trajectory `where`, the time in question and a
    third of its length before and after it.
    """
    t, held_out = signals.t, signals.held_out
    if around is not None:
        margin = max(1.0, (around[1] - around[0]) / 3)
        inside = (t >= around[0] - margin) & (t <= around[1] + margin)
        inside &= signals.trajectory == where if where is not None else True
        for rows in recordings(signals):
            found = np.flatnonzero(inside[rows])
            if len(found) > 1:
                return slice(rows.start + int(found[0]), rows.start + int(found[-1]) + 1)
    for share in (0.9, 0.5, 0.0):
        best, most = slice(0, 0), -1.0
        for rows in recordings(signals):
            part, spread = _liveliest(t[rows], changing[rows][:, list(columns)], held_out[rows], length, share)
            if spread > most:
                best, most = slice(rows.start + part.start, rows.start + part.stop), spread
        if most >= 0:
            return best
    return slice(0, len(t))


def _liveliest(t: np.ndarray, y: np.ndarray, held_out: np.ndarray, length: float, share: float) -> tuple[slice, float]:
    """The `length` seconds of one recording in which y varies most, and its sum of squares about the mean; -1 where no
    stretch has that share of held-out rows."""
    y = np.nan_to_num(y)
    sums, squares = (np.vstack([0 * y[:1], np.cumsum(x, axis=0)]) for x in (y, y**2))
    kept = np.concatenate([[0], np.cumsum(held_out)])
    starts = np.arange(0, len(t), max(1, len(t) // 400))
    ends = np.searchsorted(t, t[starts] + length, side="right")
    count = ends - starts
    spread = np.sum((squares[ends] - squares[starts]) - (sums[ends] - sums[starts]) ** 2 / count[:, None], axis=1)
    whole = t[ends - 1] - t[starts] >= 0.9 * min(length, t[-1] - t[0])
    spread = np.where(whole & (kept[ends] - kept[starts] >= share * count), spread, -1.0)
    k = int(np.argmax(spread))
    return slice(int(starts[k]), int(ends[k])), float(spread[k])
