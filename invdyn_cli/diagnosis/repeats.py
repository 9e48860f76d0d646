"""The noise floor: the error that no model can avoid, from trajectories that were repeated."""

from itertools import combinations

import numpy as np

from invdyn_cli.recording.pieces import Recording

ALIKE = 0.02
"""Share of a joint's range by which two recordings of one motion may differ, RMS."""

LATEST = 0.5
"""[s] Largest time shift between them."""


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
        halves.append(recording.filter(first[:, :length] - second[:, :length]) / 2)
    return np.sqrt(np.mean(np.concatenate(halves, axis=1) ** 2, axis=1)) if halves else None


def _shift(a: np.ndarray, b: np.ndarray, most: int) -> int | None:
    """Samples by which the motion a (n, T) lies behind b, if they are the same motion."""
    length = min(a.shape[1], b.shape[1]) - most
    if length < 2 * most or abs(a.shape[1] - b.shape[1]) > most:
        return None
    reach = np.maximum(np.ptp(a, axis=1), 1e-9)
    moved = reach > 0.02
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
