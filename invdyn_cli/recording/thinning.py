"""A long log thinned: stretches spread evenly over it, in which every joint moves."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TypeVar

import numpy as np

from invdyn_cli.log import RawTrajectory
from invdyn_cli.recording.rows import median_step, uninterrupted
from invdyn_cli.recording.selection import LEARNED, STEP, STILL

T = TypeVar("T")

MOST = 120_000
"""Number of rows of a log that the expensive checks use: two minutes at 1 kHz."""

LENGTH = 20.0
"""[s] of a stretch for them: long enough for the slow joints of an arm to turn back."""

SHORTER = 1, 2, 4
"""Parts of a stretch's length that are tried: all of it, or less and more stretches where joints move one after the
other, and one of them would cover less than LEARNED of its distance."""


def windows(trajectories: Iterable[RawTrajectory], most: int = MOST) -> Iterator[tuple[RawTrajectory, np.ndarray]]:
    """These trajectories with row numbers of uninterrupted stretches, together not many more than `most` rows."""
    pieces = [(raw, rows) for raw in trajectories for rows in uninterrupted(raw)]
    total = sum(len(rows) for _, rows in pieces)
    for raw, rows in pieces:
        share = int(most * len(rows) / max(total, 1))
        for window in [rows] if total <= most or share >= len(rows) else _windows(raw, rows, share):
            yield raw, window


def thinned(cut: Sequence[tuple], longest: float, train_share: float, length: float) -> tuple[float, list[tuple]]:
    """Of stretches (trajectory, role, t (T,), q (n, T), tau (n, T)) together `longest` [s], of every role a share:
    parts of long ones, and short ones that are left out or stay whole; and about how long such a part is [s], `length`
    or less."""
    totals = dict.fromkeys((role for _, role, *_ in cut), 0.0)
    for _, role, t, *_ in cut:
        totals[role] += t[-1] - t[0]
    share = _shares(totals, longest, train_share)

    def motions(role: str, of: Sequence[tuple]) -> list[tuple[np.ndarray, np.ndarray]]:
        return [(t, q.T) for _, own, t, q, _ in of if own == role]

    def tried() -> Iterator[tuple[float, tuple[float, list[tuple]]]]:
        for shorter in SHORTER:
            made = list(_parts(cut, share, length / shorter))
            covered = min(_covered(motions(role, cut), motions(role, made)) / share[role] for role in share)
            yield covered, (length / shorter, made)

    return _enough(tried())


def _windows(raw: RawTrajectory, rows: np.ndarray, share: int) -> list[np.ndarray]:
    """Parts of these rows, `share` of them together."""

    def tried() -> Iterator[tuple[float, list[np.ndarray]]]:
        for shorter in SHORTER:
            length = max(1, min(len(rows), int(LENGTH / shorter / median_step(raw.t))))
            starts = np.linspace(0, len(rows) - length, max(1, share // length)).astype(int)
            parts = [rows[start : start + length] for start in starts]
            covered = _covered([(raw.t[rows], raw.q[rows])], [(raw.t[x], raw.q[x]) for x in parts])
            yield covered * len(rows) / max(share, 1), parts

    return _enough(tried())


def _enough(tried: Iterable[tuple[float, T]]) -> T:
    """The first of what is tried in which every joint covers LEARNED of its part of the distance, else that in which
    the one that covers least covers most."""
    best = None
    for covered, made in tried:
        if best is None or covered > best[0]:
            best = covered, made
        if covered >= LEARNED:
            break
    assert best is not None
    return best[1]


def _covered(whole: Sequence[tuple[np.ndarray, np.ndarray]], parts: Sequence[tuple[np.ndarray, np.ndarray]]) -> float:
    """Of the joints that do not rest, the least share of its distance that one covers in parts of a motion, each t (T,)
    [s] and q (T, n)."""
    total, moved = (
        np.sum([np.zeros(whole[0][1].shape[1]), *(_distance(*one) for one in x)], 0) for x in (whole, parts)
    )
    moves = total > STILL * np.max(total)
    return float(np.min(moved[moves] / total[moves], initial=1.0))


def _distance(t: np.ndarray, q: np.ndarray) -> np.ndarray:
    """(n,) what every joint of q (T, n) moves."""
    thin = max(1, int(STEP * len(t) / max(np.ptp(t), 1e-9)))
    return np.abs(np.diff(q[::thin], axis=0)).sum(axis=0)


def _shares(totals: Mapping[str, float], longest: float, train_share: float) -> dict[str, float]:
    """Of every role's time [s] the share that is used. What a role has less than its part is left to the others: of one
    recording to learn from and many that judge, it is these that are thinned."""
    parts = {role: 1 - train_share if role == "test" else train_share for role in totals}
    made, left, open_ = {}, longest, sum(parts.values())
    for role in sorted(totals, key=lambda role: totals[role] / parts[role]):
        used = min(totals[role], left * parts[role] / open_)
        made[role], left, open_ = used / max(totals[role], 1e-300), left - used, open_ - parts[role]
    return made


def _parts(cut: Sequence[tuple], share: Mapping[str, float], length: float) -> Iterator[tuple]:
    """A share of every role's time: parts of long stretches, and short ones that are left out or stay whole."""
    owed = dict.fromkeys(share, 0.0)
    for piece in cut:
        _, role, t, *_ = piece
        span = t[-1] - t[0]
        if span * share[role] >= length:
            yield from _spread(piece, share[role], length)
            continue
        owed[role] += span * share[role]
        if owed[role] > 0:
            used = t < t[0] + length
            owed[role] -= min(span, length)
            yield piece[0], role, t[used], piece[3][:, used], piece[4][:, used]


def _spread(piece: tuple, share: float, length: float) -> Iterator[tuple]:
    """Evenly spread parts of a stretch, none longer than from one to the next, that make up a share of it."""
    name, role, t, q, tau = piece
    span = t[-1] - t[0]
    count = max(1, round(share * span / length))
    for start in t[0] + span * np.arange(count) / count:
        rows = slice(*np.searchsorted(t, [start, start + share * span / count]))
        yield name, role, t[rows], q[:, rows], tau[:, rows]
