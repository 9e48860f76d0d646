"""Factors between a unit in which motion is logged, or a clock, and that of SI, with their names."""

from collections.abc import Mapping

import numpy as np

DEGREE = 180 / np.pi
RPM = 30 / np.pi
RATES = {
    DEGREE: "degrees per second",
    1 / DEGREE: "rad/s that were converted from degrees once too often",
    DEGREE**2: "degrees per second, converted twice",
    RPM: "revolutions per minute",
    1 / RPM: "rad/s that were converted from revolutions per minute once too often",
    1 / (2 * np.pi): "revolutions per second",
    1e3: "mrad/s (or the clock is in ms)",
    1e-3: "krad/s (or the clock is off by 1000)",
}
"""Logged over SI for velocities and accelerations of joints that turn."""

POSITIONS = {1 / DEGREE: "radians that were converted from degrees once too often", 1 / (2 * np.pi): "revolutions"}
"""Logged over SI for positions too small to be seen by their limits; degrees are seen by these."""

SCALES = {
    1e3: "milliradians",
    200 / np.pi: "gradians",
    60 * DEGREE: "minutes of arc",
    3600 * DEGREE: "seconds of arc",
    **{2**k / (2 * np.pi): f"encoder counts, 2^{k} for a turn" for k in range(10, 25)},
}
"""Logged over SI for positions that are too large for degrees."""

TURNS = {2 * np.pi: "revolutions"}
"""qd over dq/dt where q, and not qd, is in another unit; qd in such a unit there is none."""

CLOCKS = {1e3: "milliseconds", 1e6: "microseconds", 1e9: "nanoseconds"}


def nearest(ratio: float, table: Mapping[float, str], within: float) -> float | None:
    """The factor of the table that a ratio equals within a relative distance."""
    if not np.isfinite(ratio):
        return None
    best = min(table, key=lambda k: abs(ratio / k - 1))
    return best if abs(ratio / best - 1) < within else None
