"""Sampled signals: derivatives and zero-phase filters, time along the first axis.

Everything here is numpy and SciPy on whole trajectories, before learning starts; nothing is jitted.
"""

import itertools
import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import scipy

DERIVATIVES = ("backward", "central", "savgol")
"""Ways to differentiate: x_t - x_{t-1}; (x_{t+1} - x_{t-1}) / 2; a local polynomial's slope (Savitzky, Golay 1964)."""


def differentiate(
    x: np.ndarray, rate: float, *, method: str = "central", window: int = 3, order: int = 2
) -> np.ndarray:
    """Time derivative of x (T, ...) sampled at `rate` [Hz], same shape; one-sided at the ends.

    `backward` and `central` are convolutions with a window of 3 samples, [1, -1, 0] and [1, 0, -1] / 2 (paper, section
    V-A.1: "a convolution filter with a window size of 3"; its weights are not given there). `savgol` takes the slope of
    a polynomial of degree `order` over `window` samples.

    Raises:
        ValueError: on an unknown method, or fewer samples than the window.
    """
    if method not in DERIVATIVES:
        raise ValueError(f"derivative {method!r}; allowed: {', '.join(DERIVATIVES)}")
    if len(x) < max(window, 3):
        raise ValueError(f"{len(x)} samples; a window of {max(window, 3)} needs at least as many")
    if method == "savgol":
        return np.asarray(scipy.signal.savgol_filter(x, window, order, deriv=1, delta=1 / rate, axis=0, mode="interp"))
    if method == "central":
        return np.gradient(x, 1 / rate, axis=0)
    steps = np.diff(x, axis=0) * rate
    return np.concatenate([steps[:1], steps])


TOGETHER = 2**16
"""Numbers that pass a filter together, about: more do not fit into a processor's cache."""


@lru_cache(maxsize=256)
def settling(rate: float, cutoff: float, order: int = 4) -> int:
    """Samples until the Butterworth low-pass has forgotten all but 1 %: how far into a block its ends reach.

    Accelerations from filtered positions are wrong by over 100 % at a block's ends, by about 1 % this far inside.

    Raises:
        ValueError: if the cut-off is not between 0 and half the rate, or the order is below 1.
    """
    if not 0 < cutoff < rate / 2:
        raise ValueError(f"cut-off {cutoff:g} Hz; allowed: above 0 and below half the rate, {rate / 2:g} Hz")
    if order < 1:
        raise ValueError(f"filter order {order}; allowed: 1 and more")
    zpk: Any = scipy.signal.butter(order, cutoff, fs=rate, output="zpk")
    slowest = np.max(np.abs(zpk[1]), initial=1e-9)
    return int(np.ceil(np.log(0.01) / np.log(slowest)))


def lowpass(
    x: np.ndarray, rate: float, cutoff: float, order: int = 4, causal: bool = False, axis: int = 0
) -> np.ndarray:
    """x at `rate` [Hz] through a Butterworth low-pass along `axis`, forth and back: no phase, -6 dB at `cutoff` [Hz];
    forth alone where `causal`, from a past at the first sample.

    It is linear: signals that are filtered alike stay in proportion. The ends are point-reflected over `settling`
    samples (`scipy.signal.sosfiltfilt`, which would compute the filter's state at rest each time).

    Raises:
        ValueError: as `settling` does, or with no more than `settling` samples.
    """
    x = np.moveaxis(np.asarray(x), axis, -1)
    if causal:
        _long_enough(x, rate, cutoff, order)
        first = at_rest(rate, cutoff, order).reshape(-1, *[1] * (x.ndim - 1), 2) * x[..., :1]
        return np.moveaxis(scipy.signal.sosfilt(butterworth(rate, cutoff, order), x, zi=first)[0], -1, axis)
    (made,) = lowpass_each([x], rate, cutoff, order)
    return np.moveaxis(made, -1, axis)


def lowpass_each(parts: Sequence[np.ndarray], rate: float, cutoff: float, order: int = 4) -> list[np.ndarray]:
    """Signals (..., T) of any shapes and lengths through `lowpass` along their last axis. Those of similar lengths pass
    it together: on short ones a call costs more than its numbers.

    Raises:
        ValueError: as `lowpass` does.
    """
    for x in parts:
        _long_enough(x, rate, cutoff, order)
    made: dict[int, np.ndarray] = {}
    left = sorted(range(len(parts)), key=lambda k: parts[k].shape[-1])
    while left:
        longest, size, some = parts[left[-1]].shape[-1], 0, []
        while left and (not some or (parts[left[-1]].shape[-1] > longest / 2 and size < TOGETHER)):
            some.append(left.pop())
            size += longest * math.prod(parts[some[-1]].shape[:-1])
        made |= zip(some, _forth_and_back([parts[k] for k in some], rate, cutoff, order), strict=True)
    return [made[k] for k in range(len(parts))]


def _long_enough(x: np.ndarray, rate: float, cutoff: float, order: int) -> None:
    padding = settling(rate, cutoff, order)
    if x.shape[-1] <= padding:
        raise ValueError(f"{x.shape[-1]} samples at {rate:g} Hz; a low-pass at {cutoff:g} Hz needs more than {padding}")


def _forth_and_back(parts: Sequence[np.ndarray], rate: float, cutoff: float, order: int) -> list[np.ndarray]:
    """Signals (..., T) as rows of one table that is filtered twice; each is turned round at its own end."""
    padding = settling(rate, cutoff, order)
    sections, rest = butterworth(rate, cutoff, order), at_rest(rate, cutoff, order)[:, None]
    rows = [_reflected(x.reshape(math.prod(x.shape[:-1]), x.shape[-1]), padding) for x in parts]
    edges = np.cumsum([0, *map(len, rows)])
    places = [(slice(a, b), slice(x.shape[1])) for x, (a, b) in zip(rows, itertools.pairwise(edges), strict=True)]
    table = rows[0]
    if len(rows) > 1:
        table = np.zeros((edges[-1], max(x.shape[1] for x in rows)))
        for x, at in zip(rows, places, strict=True):
            table[at] = x
    for _ in range(2):
        table = scipy.signal.sosfilt(sections, table, zi=rest * table[:, :1])[0]
        if len(rows) > 1:
            for at in places:
                table[at] = table[at][:, ::-1].copy()
        else:
            table = table[:, ::-1]
    return [table[at][:, padding:-padding].reshape(x.shape) for x, at in zip(parts, places, strict=True)]


def _reflected(x: np.ndarray, padding: int) -> np.ndarray:
    """x (M, T) with so many samples before and after, reflected about its ends."""
    before, after = x[:, padding:0:-1], x[:, -2 : -padding - 2 : -1]
    return np.concatenate([2 * x[:, :1] - before, x, 2 * x[:, -1:] - after], axis=1)


@lru_cache(maxsize=256)
def butterworth(rate: float, cutoff: float, order: int = 4) -> np.ndarray:
    """Second-order sections (S, 6) of the low-pass filter, as SciPy has them."""
    return np.asarray(scipy.signal.butter(order, cutoff, fs=rate, output="sos"))


@lru_cache(maxsize=256)
def at_rest(rate: float, cutoff: float, order: int = 4) -> np.ndarray:
    """The state (S, 2) of the low-pass filter after a constant input of 1."""
    return np.asarray(scipy.signal.sosfilt_zi(butterworth(rate, cutoff, order)))


def resample(
    t: np.ndarray, x: np.ndarray, rate: float, degree: int = 1, tolerance: float = 1e-6
) -> tuple[np.ndarray, np.ndarray]:
    """A uniform clock (S,) [s] at `rate` [Hz] from t[0] to t[-1], and x (S, ...) on it by splines of `degree` 1 or 3.

    t (T,) [s] increases, x is (T, ...). A clock that is already uniform within a share `tolerance` of a period is
    returned unchanged.
    """
    ticks = t[0] + np.arange(int(np.floor((t[-1] - t[0]) * rate + 1e-6)) + 1) / rate
    if len(ticks) == len(t) and np.all(np.abs(t - ticks) * rate <= tolerance):
        return t, x
    return ticks, scipy.interpolate.make_interp_spline(t, x, k=degree, axis=0)(ticks)


def lattice(x: np.ndarray, most: int = 100_000) -> float:
    """The step of which all values of x (T,) are multiples, 0 if there is none (T is cut to `most`)."""
    values = np.unique(x[:most])
    if len(values) < 3 or len(values) > 0.9 * min(len(x), most):
        return 0.0
    steps = np.diff(values)
    steps = steps[steps > 1e-6 * np.median(steps)]  # float32 rounding of one and the same value
    if not len(steps):
        return 0.0
    step = float(np.quantile(steps, 0.01))
    small = steps[steps < 20.5 * step] / step
    on = np.abs(small - np.round(small)) < 0.1
    return step if on.mean() > 0.95 and len(small) > 0.5 * len(steps) else 0.0
