"""Motions that are repeated. Between recordings they show the noise floor, the error that no model can avoid; within
the data they make held-out rows equal to training rows, so that errors on them say little about other motions."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import scipy

from invdyn_cli.recording.pieces import Piece, Recording

ALIKE = 0.02
"""Share of a joint's range by which two recordings of one motion may differ, RMS, and a state another."""

MOVES = 0.02
"""[rad; m] Range below which a joint counts as resting."""

LATEST = 0.5
"""[s] Largest time shift between them."""

SEEN = 0.5
"""Share of the held-out motion that repeats the training motion, from which the report says so."""

ASKED = 500
"""Number of held-out states that are compared with all training states."""


def floor_of_repeats(recording: Recording) -> np.ndarray | None:
    """RMS (n,) of half the difference of repeated stretches' filtered torques [N m; N]; None without repeats."""
    halves = []
    pieces = [p for p in recording.pieces if len(p.t) > 2 * recording.filter.rate]
    for a, b in combinations(pieces, 2):
        if a.trajectory == b.trajectory or (a.role == "reference") != (b.role == "reference"):
            continue  # what has changed since the reference is no noise
        shift = _shift(a.q, b.q, round(LATEST * recording.filter.rate))
        if shift is None:
            continue
        first, second = (a.tau[:, max(shift, 0) :], b.tau[:, max(-shift, 0) :])
        length = min(first.shape[1], second.shape[1])
        halves.append(recording.filter([first[:, :length] - second[:, :length]])[0] / 2)
    return np.sqrt(np.mean(np.concatenate(halves, axis=1) ** 2, axis=1)) if halves else None


def note_of(recording: Recording) -> tuple[str, ...]:
    """What is to be said if the held-out motion is the training motion once more."""
    share = seen_before(recording)
    if share < SEEN:
        return ()
    return (
        f"{100 * share:.0f} % of the held-out motion repeats the training motion: the errors say little about other "
        "motions. Test the extended model on a recording of another motion.",
    )


def seen_before(recording: Recording) -> float:
    """Share of the held-out states (q, qd) that lie within ALIKE of a training state: RMS over what moves, in units of
    its range. 0 without held-out data."""
    known, asked = (_states(recording.pieces, role) for role in ("train", "test"))
    if not len(asked):
        return 0.0
    reach = np.ptp(known, axis=0)
    n = len(recording.joints)
    moving = np.tile(reach[:n] > MOVES, 2)
    if not moving.any():
        return 0.0
    known, asked = (x[:, moving] / reach[moving] for x in (known, asked))
    asked = asked[:: -(-len(asked) // ASKED)]
    farthest = ALIKE * np.sqrt(moving.sum())
    distance, _ = scipy.spatial.cKDTree(known).query(asked, distance_upper_bound=farthest)
    return float(np.mean(np.isfinite(distance)))


def _states(pieces: Sequence[Piece], role: str) -> np.ndarray:
    """q and qd (samples, 2 n) of all pieces of a role."""
    own = [np.concatenate([p.q, p.qd]).T for p in pieces if p.role == role]
    return np.concatenate(own) if own else np.empty((0, 0))


def _shift(a: np.ndarray, b: np.ndarray, most: int) -> int | None:
    """Samples by which the motion a (n, T) lies behind b, if they are the same motion."""
    length = min(a.shape[1], b.shape[1]) - most
    if length < 2 * most or abs(a.shape[1] - b.shape[1]) > most:
        return None
    reach = np.maximum(np.ptp(a, axis=1), 1e-9)
    moved = reach > MOVES
    best = None
    for shift in range(-most, most + 1):
        first, second = a[:, max(shift, 0) :], b[:, max(-shift, 0) :]
        n = min(first.shape[1], second.shape[1])
        step = max(1, n // 400)
        error = np.sqrt(np.mean((first[:, :n:step] - second[:, :n:step]) ** 2, axis=1)) / reach
        worst = float(np.max(error[moved], initial=0.0))
        if moved.any() and worst < ALIKE and (best is None or worst < best[0]):
            best = worst, shift
    return None if best is None else best[1]
