"""A motion in chunks of few shapes, so that a compiled function works for any length."""

from collections.abc import Callable

import jax
import numpy as np

from invdyn_cli import precision as precision
from invdyn_cli.types import Array, Motion

CHUNK = 1024
"""Samples that go through a jitted function at once: big enough to hide its call, small enough to stay in cache."""


def in_chunks(function: Callable[[Motion], Array], motion: Motion, most: int = CHUNK) -> np.ndarray:
    """`function` of a motion (T, n) in chunks padded to powers of four up to `most`, few compilations: (T, n)."""
    total = len(motion)
    size = min(most, 4 ** -(-max(0, total - 1).bit_length() // 2))
    out = [np.empty((0, motion.q.shape[1]))]
    for start in range(0, total, size):
        part = motion[slice(start, start + size)]
        out.append(np.asarray(function(padded(part, size)))[: len(part)])
    return np.concatenate(out).astype(float)


def padded(motion: Motion, size: int) -> Motion:
    """A motion of at most `size` samples, padded to `size` with its last sample."""
    missing = size - len(motion)
    return jax.tree.map(lambda x: np.pad(x, ((0, missing), (0, 0)), mode="edge"), motion) if missing else motion
