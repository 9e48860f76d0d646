"""The low-pass filter that the torque of a joint and all its columns pass alike."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from invdyn_cli.maths.signals import lowpass_each, settling


@dataclass(frozen=True)
class Filter:
    """The zero-phase low-passes, one for each joint, that its torque and all its columns pass alike; then every
    `keep`-th sample, the ends cut off.

    Attributes:
        rate: [Hz] of the working clock.
        cutoffs: (n,) [Hz].
        keep: samples of which one is kept.
        widest: (n,) [Hz] what the noise of the positions alone would allow: `cutoffs` or more.
    """

    rate: float
    cutoffs: tuple[float, ...]
    keep: int
    widest: tuple[float, ...]

    @property
    def inset(self) -> int:
        """Samples that are cut off at either end."""
        return settling(self.rate, min(self.cutoffs))

    def rows(self, samples: int) -> np.ndarray:
        """Which samples are kept."""
        return np.arange(self.inset, max(self.inset, samples - self.inset), self.keep)

    def independent(self, joint: int) -> float:
        """Samples of filtered white noise that a row counts for, one at most: twice the bandwidth for a second."""
        return min(1.0, 2 * self.cutoffs[joint] * self.keep / self.rate)

    def of(self, joint: int, parts: Sequence[np.ndarray]) -> list[np.ndarray]:
        """A joint's columns (..., T) in every piece -> (..., rows)."""
        return [x[..., self.rows(x.shape[-1])] for x in self.slowed(joint, parts)]

    def slowed(self, joint: int, parts: Sequence[np.ndarray]) -> list[np.ndarray]:
        """The same on all samples: (..., T)."""
        return lowpass_each([np.asarray(x) for x in parts], self.rate, self.cutoffs[joint])

    def __call__(self, parts: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Columns of all joints (..., n, T) in every piece -> (..., n, rows)."""
        cutoffs = np.array(self.cutoffs)
        out = [np.empty((*x.shape[:-1], len(self.rows(x.shape[-1])))) for x in parts]
        for cutoff in set(self.cutoffs):
            joints = np.flatnonzero(cutoffs == cutoff)
            for made, x in zip(out, self.of(int(joints[0]), [x[..., joints, :] for x in parts]), strict=True):
                made[..., joints, :] = x
        return out

    def spread(self, mask: np.ndarray) -> np.ndarray:
        """Rows (n, rows) that any True of a mask (n, T) reaches through the filters."""
        out = []
        for row, cutoff in zip(mask, self.cutoffs, strict=True):
            reach = max(1, round(0.5 * self.rate / cutoff))
            out.append(scipy.signal.convolve(row.astype(float), np.ones(2 * reach + 1), mode="same") > 0.5)
        return np.array(out)[:, self.rows(mask.shape[-1])]


def needed(rate: float, cutoff: float) -> int:
    """Number of samples. Only pieces with more than that are used, where a low-pass has this cut-off [Hz]."""
    return 3 * settling(rate, cutoff) + 8
