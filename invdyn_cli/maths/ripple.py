"""Ripple: periodic lines in a residual over a joint's angle, with an unknown number of cycles c per revolution: teeth,
magnets, strain waves."""

import numpy as np

MOST = 400.0
"""Cycles of a turn that are sought."""
EXACT_EVERY = 64
"""Every so many cycles the wave is an exponential; a product makes those between, ten times as fast."""


def grid(q: np.ndarray, most: float = MOST) -> np.ndarray:
    """Cycles (C,) to test, a quarter of a period of the joint's range apart: from two periods within the range of q
    (T,)."""
    reach = float(np.ptp(q))
    return np.arange(4 * np.pi / reach, most, 0.5 * np.pi / reach) if reach > 4 * np.pi / most else np.zeros(0)


def power(
    residual: np.ndarray, q: np.ndarray, cycles: np.ndarray, qd: np.ndarray | float = 0.0, cutoff: float = np.inf
) -> np.ndarray:
    """Squares (C,) of the residual (T,) that a sine over the angle q (T,) explains, for each of the evenly spaced
    cycles (C,); attenuated as a low-pass at `cutoff` [Hz] does at the speed qd [rad/s]."""
    out, blocked = np.empty(len(cycles)), (qd / (2 * np.pi * cutoff)) ** 8
    step = np.diff(cycles[:2]).sum()  # 0 of one
    wave = turn = np.exp(1j * step * q)
    for k, c in enumerate(cycles):
        wave = wave * turn if k % EXACT_EVERY else np.exp(1j * c * q)
        gain = np.broadcast_to(1 / (1 + c**8 * blocked), q.shape)
        out[k] = 2 * np.abs(wave @ (gain * residual)) ** 2 / max(float(gain @ gain), 1e-9)
    return out


def sharpened(
    residual: np.ndarray, q: np.ndarray, cycles: float, qd: np.ndarray | float = 0.0, cutoff: float = np.inf
) -> tuple[float, float]:
    """The best cycles near one on the grid, and their power."""
    fine = cycles + np.linspace(-1, 1, 21) * 0.5 * np.pi / float(np.ptp(q))
    found = power(residual, q, fine, qd, cutoff)
    return float(fine[np.argmax(found)]), float(found.max())


def strongest(residual: np.ndarray, q: np.ndarray) -> tuple[float, float]:
    """Cycles of the line that explains most of a residual (T,) over the angle q (T,), and its share of the squares;
    0, 0 where the joint hardly turns."""
    asked = grid(q) if len(q) else np.zeros(0)
    if not len(asked):
        return 0.0, 0.0
    cycles, squares = sharpened(residual, q, float(asked[np.argmax(power(residual, q, asked))]))
    return cycles, squares / max(float(np.sum(residual**2)), 1e-300)
