"""Time stamps that vary while the samples do not: positions tell which of both it is."""

import abc
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import ClassVar, NamedTuple

import numpy as np

from invdyn_cli.interfaces import AbstractCheck
from invdyn_cli.log import Log, RawTrajectory
from invdyn_cli.recording.rows import each, uninterrupted
from invdyn_cli.recording.thinning import windows
from invdyn_cli.types import Check, Robot

ORDER = 4
"""Order of the differences in which a motion is far smaller than what a sample at another time adds to it."""

NEAR = 10
"""Number of stamps on either side of a long step that tell whether some are missing in it."""

LONG = 1.25
"""Periods of a step above which stamps may be missing in it; those around it tell how many."""

WANDERS = 2.0
"""Deviation from a regular clock, in standard deviations of the steps, above which the clock wanders: stamps that are
late by chance deviate by 0.7, and somewhat more if they do so for a part of the time."""

BLOCKS = 20
"""Number of parts of a recording, each left out once, from which the standard error is taken."""


class Followed(NamedTuple):
    """How far positions follow the variations of their stamps: the share, 1 for samples at these times and 0 for
    samples at regular times, its standard error, and what varies, in words."""

    share: float
    error: float
    said: str


@dataclass(frozen=True)
class AbstractLateStamps(AbstractCheck):
    """Stamps that vary though the samples were taken at regular times, which least squares on the positions tell.

    Attributes:
        share: from which, by three standard errors, the positions are nearer to regular samples than to their stamps.
    """

    name: ClassVar[str] = "clock_jitter"
    share: float = 0.5

    @abc.abstractmethod
    def followed(self, raw: RawTrajectory) -> Followed | None:
        """How far positions follow such stamps of a trajectory; None where there are none, or where it is too short or
        does not move enough to tell."""

    @abc.abstractmethod
    def regular(self, raw: RawTrajectory) -> tuple[np.ndarray, str]:
        """Stamps (T,) [s] at regular times, and what was done, in words."""

    def examine(self, log: Log, robot: Robot | None) -> list[Check]:
        """Per trajectory; the value is the share."""
        found = []
        for raw in log.trajectories:
            told = self.followed(raw)
            if told is None or abs(told.share) + 3 * told.error > self.share:
                continue
            found.append(
                Check(
                    self.name,
                    "note",
                    raw.name,
                    value=told.share,
                    threshold=self.share,
                    seen=f"{told.said}, but positions show only {100 * abs(told.share):.2g} % of this (standard error "
                    f"{100 * told.error:.2g} %)",
                    meaning="samples were taken regularly and stamped late: with these stamps, speeds and "
                    "accelerations are noise",
                    advice="time stamps from the controller, not from the program that writes the log",
                    source="least squares on differences of positions; limit: halfway between regular times and stamps",
                )
            )
        return found

    def correct(self, log: Log, found: Sequence[Check], robot: Robot | None) -> tuple[Log, list[str]]:
        """Regular stamps."""
        notes = []

        def change(raw: RawTrajectory) -> RawTrajectory:
            t, done = self.regular(raw)
            notes.append(f"{raw.name}: {done}")
            return replace(raw, t=t)

        return each(log, change, {c.trajectory for c in found}), notes


@dataclass(frozen=True)
class IrregularStamps(AbstractLateStamps):
    """Stamps that vary about a regular clock: a program wrote them late. To believe them makes accelerations of speed
    times their variation.

    Differences of q of order ORDER are nothing but noise where samples are regular; where they were taken at their
    stamps, they are the speed times the same differences of the stamps.
    """

    def followed(self, raw: RawTrajectory) -> Followed | None:
        return followed(raw, [rows for _, rows in windows((raw,))])

    def regular(self, raw: RawTrajectory) -> tuple[np.ndarray, str]:
        """Between gaps."""
        t = raw.t.copy()
        for rows in uninterrupted(raw):
            if len(rows) > ORDER:
                t[rows] = regular(t[rows])
        return t, "time stamps moved to the regular clock about which they vary"


def regular(t: np.ndarray) -> np.ndarray:
    """The regular clock nearest to stamps t (T,) [s], of which single ones may be missing: then all later ones are
    later, and after a late stamp they are not."""
    steps = np.diff(t)
    period, rows = float(np.median(steps)), np.arange(len(t))
    late = t - period * rows
    starts = [0, *(np.flatnonzero(steps > LONG * period) + 1).tolist()]
    missing, before = np.zeros(len(starts)), float(np.median(late[:NEAR]))
    for i, (start, end) in enumerate(pairwise([*starts, len(t)])):
        missing[i] = np.round((np.median(late[start : min(end, start + NEAR)]) - before) / period)
        if end - start >= NEAR:
            before = float(np.median(late[end - NEAR : end])) - period * missing[i]
    missing = np.minimum.accumulate(np.maximum(missing, 0.0)[::-1])[::-1]
    places = rows + np.repeat(missing, np.diff([*starts, len(t)]))
    slope, start = np.polyfit(places, t, 1)
    return start + slope * places


def followed(raw: RawTrajectory, stretches: Sequence[np.ndarray]) -> Followed | None:
    """How far the positions of a trajectory, in these uninterrupted stretches of its rows, follow the variations of
    their stamps; None where these do not vary about a regular clock, or where it is too short or does not move enough
    to tell."""
    speeds, changes, off, steps = [], [], [], []
    for rows in stretches:
        t, q = raw.t[rows], raw.q[rows]
        if len(t) <= ORDER:
            continue
        step = np.diff(t)
        even = np.abs(step / np.median(step) - 1) < 0.5
        whole = np.lib.stride_tricks.sliding_window_view(even, ORDER).all(1)
        speed = (q[ORDER:] - q[:-ORDER]) / (t[ORDER:] - t[:-ORDER])[:, None]
        speeds.append((speed * np.diff(t, ORDER)[:, None])[whole])
        changes.append(np.diff(q, ORDER, axis=0)[whole])
        off.append(t - regular(t))
        steps.append(step[even])
    if not speeds or sum(map(len, speeds)) < 2 * BLOCKS:
        return None
    x, y, away, step = (np.concatenate(parts) for parts in (speeds, changes, off, steps))
    deviation = float(np.std(away))
    if not 0 < deviation <= WANDERS * np.std(step):  # a clock that wanders, or one without variations
        return None
    weights = precision(x, y)
    towards, squares = (np.array([p.sum() for p in np.array_split(z @ weights, BLOCKS)]) for z in (x * y, x * x))
    if not squares.sum() > 0:
        return None
    share = towards.sum() / squares.sum()
    others = (towards.sum() - towards) / np.maximum(squares.sum() - squares, 1e-300)
    error = float(np.sqrt((BLOCKS - 1) / BLOCKS * np.sum((others - others.mean()) ** 2)))
    said = f"time stamps vary by {1e3 * deviation:.2g} ms about a regular clock"
    return Followed(float(share), error, said)


def precision(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """One over the variance of every column of y (T, n) about its least-squares line through zero over that of x."""
    slopes = np.sum(x * y, axis=0) / np.maximum(np.sum(x * x, axis=0), 1e-300)
    return 1 / np.maximum(np.mean((y - x * slopes) ** 2, axis=0), 1e-300)
