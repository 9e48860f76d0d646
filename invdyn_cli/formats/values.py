"""What the values of columns show if their names do not: clocks, derivatives, units. None: they do not show it."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from invdyn_cli.formats.units import TIME

FASTEST, SLOWEST = 1e-4, 0.5
"""[s] The steps that a robot's log may have: 10 kHz to 2 Hz."""

WINDOW = 0.02
"""[s] Half the stretch over which positions are differentiated: encoders' steps of 0.1 mrad are 5 mrad/s of it."""

ALIKE = 0.9
"""[-] Correlation from which a column counts as the derivative of another: currents reach 0.6 on real logs."""

NEAR = 0.2
"""[-] How far a ratio of units may be off; rad, deg and rpm are factors of 6 and more apart."""

TURNS = 2 * math.pi * 1.1
"""[rad] Positions beyond are hardly radians of a joint, below hardly degrees of a motion (if beyond LEAST)."""
LEAST, MOST = 0.35, 15.0
"""[rad] Between TURNS and MOST, and where nothing is beyond LEAST, positions tell no unit."""


def time_unit(t: np.ndarray) -> str | None:
    """The one unit in which a clock (T,) has steps that a robot's log has; whole numbers one apart may be indices."""
    steps = np.diff(t)
    steps = steps[steps > 0]
    if not len(steps):
        return None
    step = float(np.median(steps))
    fits = [u for u, x in TIME.items() if FASTEST <= step * x <= SLOWEST]
    return fits[0] if len(fits) == 1 and not (np.abs(steps - 1) < 1e-6).all() else None


def is_clock(x: np.ndarray) -> bool:
    """Whether a column (T,) only grows, in steps that are mostly alike."""
    steps = np.diff(x.astype(float))
    usual = np.median(steps) if len(steps) else 0.0
    return bool(usual > 0 and (steps >= 0).all() and np.mean(np.abs(steps - usual) < 0.5 * usual) > 0.8)


def angle_unit(q: np.ndarray) -> str | None:
    """ "rad" or "deg" by the largest position of (T, n), None where both may be."""
    largest = float(np.nanmax(np.abs(q))) if np.isfinite(q).any() else 0.0
    if largest > MOST:
        return "deg"
    return "rad" if LEAST < largest <= TURNS else None


def current_unit(i: np.ndarray) -> str | None:
    """ "A" or "mA" by the largest current of (T, n), None where both may be."""
    largest = float(np.nanmax(np.abs(i))) if np.isfinite(i).any() else 0.0
    if largest > 200:
        return "mA"
    return "A" if 0.1 < largest < 30 and (i != np.round(i)).any() else None


def continuous(q: np.ndarray) -> np.ndarray:
    """Positions (T, n) [rad; m] without jumps of a turn; those with missing values as they are."""
    return np.where(np.isfinite(q).all(0), np.unwrap(q, axis=0), q)


def derivative_ratio(t: np.ndarray, x: np.ndarray, y: np.ndarray) -> float | None:
    """The number by which y (T, n) is to be multiplied to be the derivative of x (T, n) over t [s].

    None where y is no derivative of x on most of the joints that move, or the joints disagree.
    """
    ratios, moving = [], 0
    for a, b in zip(x.T, y.T, strict=True):
        correlation, ratio = _compared(t, a[:, None], b[:, None])
        if np.isfinite(correlation[0, 0]):
            moving += 1
            if correlation[0, 0] > ALIKE:
                ratios.append(ratio[0, 0])
    if not ratios or len(ratios) < 0.6 * moving or np.ptp(ratios) > 2 * NEAR * np.median(ratios):
        return None
    return float(np.median(ratios))


def matching(ratio: float | None, factors: Mapping[str, float]) -> str | None:
    """The unit whose factor is a ratio, None where none is near."""
    near = [unit for unit, x in factors.items() if ratio is not None and abs(ratio / x - 1) < NEAR]
    return near[0] if near else None


def follows(x: np.ndarray, y: np.ndarray) -> bool:
    """Whether y (T, n) is a command for x (T, n) in the same unit: its distance to x is much smaller than the spread of
    x."""
    spread, off = np.nanstd(x, axis=0), np.sqrt(np.nanmean((y - x) ** 2, axis=0))
    return bool((spread > 0).any() and np.median(off[spread > 0] / spread[spread > 0]) < 0.5)


def position_blocks(t: np.ndarray, names: Sequence[str], columns: Mapping[str, np.ndarray]) -> tuple[list, list] | None:
    """The columns of positions and of velocities, n each, one block behind the other: the second are the derivatives of
    the first. None where there is no such pair, or more than one."""
    x = np.column_stack([columns[name] for name in names]).astype(float)
    correlation, _ = _compared(t, x, x)
    still = np.ptp(x, axis=0) == 0
    found: list[tuple[int, int]] = []
    for n in range(min(len(names) // 2, 12), 1, -1):
        for first in range(len(names) - 2 * n + 1):
            pairs = [(i, i + n) for i in range(first, first + n)]
            alike = [correlation[i, j] > ALIKE for i, j in pairs]
            quiet = [still[i] and still[j] for i, j in pairs]
            if all(a or b for a, b in zip(alike, quiet, strict=True)) and sum(alike) >= max(2, 0.6 * n):
                found.append((first, n))
        if found:
            break
    if len(found) == 2 and found[1][0] == found[0][0] + found[0][1]:  # velocities and accelerations follow
        found.pop()
    if len(found) != 1:
        return None
    first, n = found[0]
    return list(names[first : first + n]), list(names[first + n : first + 2 * n])


def _compared(t: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Correlations (n, m) of the derivatives of x (T, n) with y (T, m), NaN where one of them stands still, and the
    ratios of their sizes."""
    good = np.concatenate([[True], np.diff(t) > 0]) & np.isfinite(x).all(1) & np.isfinite(y).all(1)
    t, x, y = t[good], x[good], y[good]
    half = max(1, round(WINDOW / float(np.median(np.diff(t))))) if len(t) > 2 else 1
    if len(t) < 4 * half + 8:
        return np.full((x.shape[1], y.shape[1]), np.nan), np.full((x.shape[1], y.shape[1]), np.nan)
    slope = (x[2 * half :] - x[: -2 * half]) / (t[2 * half :] - t[: -2 * half])[:, None]
    sums = np.cumsum(np.vstack([np.zeros(y.shape[1]), y]), axis=0)
    mean = (sums[2 * half + 1 :] - sums[: -2 * half - 1]) / (2 * half + 1)
    a, b = slope - slope.mean(0), mean - mean.mean(0)
    with np.errstate(divide="ignore", invalid="ignore"):
        correlation = a.T @ b / np.sqrt(np.outer((a**2).sum(0), (b**2).sum(0)))
        return correlation, a.T @ b / (b**2).sum(0)
