"""The noise of a log's positions and torques, and the bandwidths that it leaves."""

from collections.abc import Sequence

import numpy as np

SMALL, NEGLIGIBLE = 0.3, 0.0001
"""Share of the torque's noise, and of a joint's RMS torque, that the noise of the positions may cost."""

CLEAR, SPEED_OVER = 0.1, 0.05
"""Share that the noise of a joint's speed may have of its usual speed while it moves, the 90 % quantile of means over
SPEED_OVER [s]: a joint rests below four times that noise (`columns.evidence`), and one of 14 bits that moves at 0.05
rad/s would rest all of the time."""

ANSWER = 5
"""Number of samples of positions to which a controller's torque is assumed to react immediately."""

FEWEST = 4 * ANSWER
"""Number of samples that a stretch must exceed for its noise to be known."""


def of_positions(positions: Sequence[np.ndarray]) -> np.ndarray:
    """Standard deviation (n,) of white noise on the positions (n, T) of all stretches."""
    return _white([np.diff(q, 4, axis=1) for q in positions])


def of_torques(positions: Sequence[np.ndarray], torques: Sequence[np.ndarray]) -> np.ndarray:
    """The same of torques (n, T)."""
    return _white([_unanswered(q, tau) for q, tau in zip(positions, torques, strict=True)])


def _white(fourth: Sequence[np.ndarray]) -> np.ndarray:
    """Standard deviation (n,) of white noise on smooth signals from their fourth differences (n, T): the lower quartile
    over stretches, so that jumps do not count."""
    together = np.concatenate(fourth, axis=1)
    parts = np.array_split(together, min(20, together.shape[1]), axis=1)
    return np.quantile([np.sqrt(np.mean(part**2, axis=1)) for part in parts], 0.25, axis=0) / np.sqrt(70)


def of_positions_in_motion(positions: Sequence[np.ndarray]) -> np.ndarray:
    """Standard deviation (n,) of white noise on the positions (n, T) of each joint where it moves faster than usual:
    stamps that are a little off make it there, and speed times as much."""
    fourth = np.concatenate([np.diff(q, 4, axis=1) for q in positions], axis=1)
    ways = np.concatenate([q[:, 4:] - q[:, :-4] for q in positions], axis=1)
    fast = np.abs(ways) >= (1 - 1e-9) * np.sqrt(np.mean(ways**2, axis=1, keepdims=True))  # or all as fast, rounded
    return np.array([_white([x[None, where]])[0] for x, where in zip(fourth, fast, strict=True)])


def _unanswered(q: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """Fourth differences of torques (n, T) without what answers to the noise of the positions in the last samples: that
    is torque which the controller asked for and the joint got."""
    x, y = np.diff(q, 4, axis=1), np.diff(tau, 4, axis=1)
    past = np.concatenate([x[:, ANSWER - k : x.shape[1] - k] for k in range(ANSWER + 1)])
    gram = past @ past.T
    factors = np.linalg.lstsq(gram, past @ y[:, ANSWER:].T, rcond=1e-12)[0]
    return y[:, ANSWER:] - factors.T @ past


def cutoff(
    position_noise: float,
    torque_noise: float,
    strongest: float,
    inertia: float,
    period: float,
    rate: float,
    cutoffs: Sequence[float],
) -> float:
    """A joint's cut-off frequency [Hz], as `Preparation` describes.

    Args:
        position_noise, torque_noise: [rad; m], [N m; N] at the log's own `period` [s].
        strongest: [N m; N] RMS of the joint's torque.
        inertia: [kg m^2; kg] that the joint carries.
        rate: [Hz] of the working clock.
        cutoffs: [Hz] candidates, the highest first.
    """
    possible = [f for f in cutoffs if f <= 0.2 * rate] or [min(cutoffs[-1], 0.2 * rate)]
    for f in possible:
        acceleration = position_noise * (2 * np.pi) ** 2 * f**2.5 * np.sqrt(2 * period / 5)
        if inertia * acceleration <= max(SMALL * torque_noise * np.sqrt(2 * f * period), NEGLIGIBLE * strongest):
            return f
    return possible[-1]


def bandwidths(
    positions: Sequence[np.ndarray], noise: np.ndarray, period: float, least: np.ndarray, sharpness: float
) -> np.ndarray:
    """(n,) [Hz] of each joint's motion signals, as `Preparation` describes: `sharpness`, or where the noise of the
    positions (n, T) would hide a joint's speed, as little as keeps it clear, but no less than `least` (n,)."""
    over = max(1, round(SPEED_OVER / period))
    ways = np.concatenate([np.abs(q[:, over:] - q[:, :-over]) for q in positions], axis=1)
    seen = [way[way > 4 * np.sqrt(2) * x] for way, x in zip(ways, noise, strict=True)]  # a joint may seldom move
    usual = [np.quantile(x if len(x) else way, 0.9) for x, way in zip(seen, ways, strict=True)]
    clear = CLEAR * np.array(usual) / (over * period)
    highest = (clear / np.maximum(of_speeds(noise, 1.0, period), 1e-300)) ** (2 / 3)
    return np.clip(highest, least, np.maximum(least, sharpness))


def of_speeds(noise: np.ndarray, bandwidth: np.ndarray | float, period: float) -> np.ndarray:
    """[rad/s; m/s] Standard deviation of a joint's speed, after a low-pass at this bandwidth [Hz], where its positions
    have white noise and are sampled with this period [s]."""
    return noise * 2 * np.pi * bandwidth**1.5 * np.sqrt(2 * period / 3)
