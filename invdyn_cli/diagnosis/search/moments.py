"""When a residual is largest, if most of it is of a few moments: what happens once, as a drive that reaches its limit
in a single motion. No test that compares many stretches of a log sees that."""

from typing import NamedTuple

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Evidence
from invdyn_cli.diagnosis.search.judge import RELEVANT
from invdyn_cli.effects.composition import TimeWindow

STRETCH = 0.5
"""[s] Length of the stretches that are compared."""

RARE = 8.0
"""Ratio of a residual's mean square to that of its median stretch, above which a few moments make up most of it. On
clean logs of worn arms it is 1.0 to 2.3."""

FEWEST = 8
"""Stretches of a log, below which nothing is said of its moments."""


class Moment(NamedTuple):
    """A short time [s] of a trajectory, and the residual in it: its RMS torque there, and over the whole log [N m;
    N]."""

    trajectory: str
    start: float
    end: float
    there: float
    torque: float


def moments(evidence: Evidence, residual: np.ndarray) -> dict[int, Moment]:
    """By joint: when its residual (R, n) is largest, if most of it is of a few stretches."""
    t, found = evidence.on_rows("t"), {}
    matters = RELEVANT * np.sqrt(np.mean(evidence.tau**2, axis=0))
    _, log = np.unique(evidence.trajectory, return_inverse=True)
    _, stretch = np.unique(log + 1j * np.floor(t / STRETCH), return_inverse=True)
    total = int(stretch.max(initial=0)) + 1
    for j in range(residual.shape[1]):
        used = evidence.valid[:, j]
        count = np.bincount(stretch[used], minlength=total)
        whole = np.flatnonzero(count >= 0.5 * count.max(initial=1))
        if len(whole) < FEWEST:
            continue
        squares = np.bincount(stretch[used], residual[used, j] ** 2, minlength=total)[whole] / count[whole]
        usual = np.median(squares)
        if np.mean(squares) <= RARE * usual:
            continue
        rare = np.zeros(total, bool)
        rare[whole] = squares > RARE * usual
        run = np.cumsum(np.diff(rare, prepend=False))  # odd where it is rare
        most = whole[np.argmax(squares)]
        rows = used & (run[stretch] == run[most]) & (log == log[stretch == most][0])
        squared = residual[rows, j] ** 2
        torque = float(np.sqrt(np.sum(squared) / used.sum()))
        if torque > matters[j]:
            first, last = np.flatnonzero(rows)[[0, -1]]
            name, there = str(evidence.trajectory[first]), float(np.sqrt(np.mean(squared)))
            found[j] = Moment(name, float(t[first]), float(t[last]), there, torque)
    return found


def on_one_side(evidence: Evidence, residual: np.ndarray) -> list[TimeWindow]:
    """Those of which all is in the data that choose, or nothing: what makes such a moment is not found, or not
    confirmed."""
    t, out = evidence.on_rows("t"), []
    for x in moments(evidence, residual).values():
        inside = (evidence.trajectory == x.trajectory) & (t >= x.start) & (t <= x.end)
        held_out = evidence.of_role("test")[inside]
        if held_out.all() or not held_out.any():
            out.append(TimeWindow(x.trajectory, x.start, x.end))
    return out
