"""The band in which a joint is heard. Noise of encoders, a gear's resonance and the answers of a controller are dense
above the speed of the motion; what they leave there hides what acts at that speed."""

from collections.abc import Sequence

import numpy as np
import scipy

from invdyn_cli.diagnosis.standard_columns import Columns
from invdyn_cli.maths import ripple
from invdyn_cli.maths.signals import butterworth
from invdyn_cli.recording.filter import needed

DENSER = 3.0
"""How many times as dense as in a narrower band noise may be in the whole one: so much less is the evidence there for
what acts at the speed of the motion."""

LONG = 3.0
"""Length of the stretches whose spectra are compared, in periods of the lowest cut-off."""


def heard(columns: Columns, target: np.ndarray, possible: Sequence[float]) -> tuple[float, ...]:
    """The cut-off [Hz] of each joint's low-pass (n,): the highest of those `possible`, and no higher than now, up to
    which what the standard model leaves of `target` (R, n) is on average at most DENSER times as dense as in any
    narrower band. A torque ripple is not noise: the band is also found without the strongest line over the joint's
    angle, and the wider of both counts."""
    evidence, filter = columns.evidence, columns.evidence.recording.filter
    rows = evidence.of_role("train")
    left = target - columns.of(columns.fit(target, rows).theta)
    shortest = min(len(piece.t) for piece in evidence.recording.pieces)
    possible = [c for c in possible if shortest > needed(filter.rate, c)]
    rate = filter.rate / filter.keep
    length = round(LONG * rate / min(possible, default=np.inf))
    own = [(evidence.piece == number) & rows for number in np.unique(evidence.piece[rows])]
    own = [x for x in own if x.sum() >= 2 * length]  # of fewer stretches a jolt is the median
    if not (own and possible):
        return filter.cutoffs
    f = np.fft.rfftfreq(length, 1 / rate)
    smooth = [_without_line(*x, rows) for x in zip(left.T, evidence.on_rows("q").T, strict=True)]
    both = np.column_stack([left, *smooth])
    spectra = [scipy.signal.welch(both[x], rate, nperseg=length, average="median", axis=0)[1] for x in own]
    density = np.average(spectra, axis=0, weights=[x.sum() for x in own])
    made = []
    for dense, now in zip(density.T, 2 * tuple(filter.cutoffs), strict=True):
        passed = np.abs(scipy.signal.sosfreqz(butterworth(filter.rate, now), f, fs=filter.rate)[1]) ** 4
        mean = np.cumsum(dense / passed) / np.arange(1, len(f) + 1)
        bands = sorted({now, *(c for c in possible if c < now)})
        means = mean[np.searchsorted(f, bands, side="right") - 1]
        quiet = means <= DENSER * np.minimum.accumulate(means)
        made.append(max(c for c, good in zip(bands, quiet, strict=True) if good))
    return tuple(max(x) for x in zip(made[: evidence.dofs], made[evidence.dofs :], strict=True))


def _without_line(left: np.ndarray, q: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """A joint's residual (R,) without the line over its angle (R,) that explains most of it on some `rows` (R,)."""
    cycles, _ = ripple.strongest(left[rows], q[rows])
    plain = np.stack([np.cos(cycles * q), np.sin(cycles * q)], axis=1)
    waves = np.concatenate([plain, q[:, None] * plain], axis=1)  # the latter for what the cycles are off
    return left - waves @ np.linalg.lstsq(waves[rows], left[rows], rcond=None)[0]
