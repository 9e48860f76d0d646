"""Estimates for readers: rounded by their interval, with a unit in proper type."""

import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from invdyn_cli.report.tables import significant
from invdyn_cli.types import Gain, Quantity

SUPERSCRIPTS = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")
MILLISECONDS_BELOW = 0.2
"""Times [s] below this are shown in ms."""

MOST_DECIMALS = 5
"""Numbers that would need more decimals are shown in scientific notation."""


def unit_text(unit: str) -> str:
    """'N m s²/rad²' for 'N m s^2/rad^2'; nothing for a pure number ('-')."""
    if unit == "-":
        return ""
    return re.sub(r"\^(-?\d+)", lambda found: found[1].translate(SUPERSCRIPTS), unit)


def quantity_text(quantity: Quantity, *, interval: bool = True) -> str:
    """'2.00 N m [1.98, 2.02]'; lists as '(0.00 ± 0.01, 0.02 ± 0.01) m'; names as they are.

    A value is rounded to the first significant digit of half its interval, or to the second if the first is a one.
    """
    value, unit = quantity.value, quantity.unit
    if value is None or isinstance(value, str | bool | Mapping):
        return "-" if value is None else str(value)
    bounds = component_intervals(value, quantity.interval95)
    scale = 1.0
    size = float(np.max(np.abs(np.asarray(value, float)), initial=0.0))
    if unit == "s" and 0 < size < MILLISECONDS_BELOW:
        unit, scale = "ms", 1000.0
    values = scale * np.atleast_1d(np.asarray(value, float)).ravel()
    bounds = None if bounds is None else scale * bounds
    decimals = _decimals(values, bounds)
    shown = [_cut(x, decimals) for x in values]
    bounds = bounds if interval else None
    if np.ndim(value) > 0:
        halves = [] if bounds is None else [f" ± {_cut((high - low) / 2, decimals)}" for low, high in bounds]
        each = [x + (halves[i] if halves else "") for i, x in enumerate(shown)]
        return f"({', '.join(each)}) {unit_text(unit)}".rstrip()
    ends = "" if bounds is None else f" [{_cut(bounds[0, 0], decimals)}, {_cut(bounds[0, 1], decimals)}]"
    return f"{shown[0]} {unit_text(unit)}".rstrip() + ends


def in_degrees(quantity: Quantity) -> str:
    """The same estimate in degrees if it is a single angle [rad], otherwise nothing."""
    if quantity.unit != "rad" or np.ndim(quantity.value) > 0 or isinstance(quantity.value, str | None):
        return ""
    bounds = component_intervals(quantity.value, quantity.interval95)
    ends = None if bounds is None else np.rad2deg(bounds[0])
    return quantity_text(Quantity(np.rad2deg(quantity.value), "°", ends)).replace(" °", "°")


def component_intervals(value: Any, interval: Any) -> np.ndarray | None:
    """(components, 2) from an interval given as [low, high], as one such pair per component, or as two lists; None
    where there is none, or none that fits the value."""
    if interval is None or isinstance(value, str):
        return None
    try:
        bounds = np.asarray(interval, float)
    except (TypeError, ValueError):
        return None
    values = np.atleast_1d(np.asarray(value, float)).ravel()
    if bounds.shape == (2,) and len(values) == 1:
        bounds = bounds[None]
    elif bounds.shape == (2, len(values)) and (
        len(values) != 2 or np.all((bounds[0] <= values) & (values <= bounds[1]))
    ):
        bounds = bounds.T
    return bounds if bounds.shape == (len(values), 2) and np.isfinite(bounds).any() else None


def gain_text(gain: Gain) -> str:
    """'0.51 [0.45, 0.57]': by how much an effect lowers the held-out RMSE of a joint.

    An interval without width is left out: a single held-out block does not show the scatter of gains.
    """
    low, high = gain.interval95
    interval = gain.interval95 if high > low else None
    return quantity_text(Quantity(gain.rmse_before - gain.rmse_after, "-", interval))


def best_gain(gains: Mapping[str, Gain]) -> str | None:
    """The joint that gains most [N m; N]; None where there is none."""
    change = {joint: x.rmse_before - x.rmse_after for joint, x in gains.items()}
    change = {joint: x for joint, x in change.items() if math.isfinite(x)}
    return max(change, key=lambda joint: change[joint]) if change else None


def _decimals(values: np.ndarray, bounds: np.ndarray | None) -> int | None:
    """Where to cut, None for three significant digits each."""
    half = np.array([]) if bounds is None else (bounds[:, 1] - bounds[:, 0]) / 2
    half = half[np.isfinite(half) & (half > 0)]
    if not len(half):
        size = np.abs(values[np.isfinite(values) & (values != 0)])
        if np.size(values) == 1 or not len(size):
            return None
        return _within(2 - math.floor(math.log10(size.max())))
    first = math.floor(math.log10(half.min()) + 1e-9)
    leading = half.min() / 10.0**first
    return _within(-first + (leading < 1.95))


def _within(decimals: int) -> int | None:
    return max(0, decimals) if decimals <= MOST_DECIMALS else None


def _cut(value: float, decimals: int | None) -> str:
    if not math.isfinite(value):
        return "-" if math.isnan(value) else f"{value:g}".replace("inf", "∞")
    if decimals is None:
        return significant(value).replace("-", "−")
    return f"{round(value, decimals) + 0.0:.{decimals}f}".replace("-", "−")
