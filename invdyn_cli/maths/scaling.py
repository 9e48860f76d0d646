"""Inputs and targets in units of their own spread, as regression from the state to the torque needs them."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from invdyn_cli.types import Array, Motion


def standardisation(motion: Motion, tau: Array) -> dict[str, Array]:
    """Mean and standard deviation of inputs (3 n,) and targets (n,); a column that never changes keeps its unit."""
    inputs = (motion.q, motion.qd, motion.qdd)
    means = np.concatenate([x.mean(0) for x in inputs]), tau.mean(0)
    scales = np.concatenate([x.std(0) for x in inputs]), tau.std(0)
    scales = [np.where(s > 1e-12 * (1 + np.abs(m)), s, 1.0) for m, s in zip(means, scales, strict=True)]
    return {"input_mean": means[0], "input_scale": scales[0], "target_mean": means[1], "target_scale": scales[1]}


def standardised_state(scales: Mapping[str, Any], motion: Motion) -> jax.Array:
    """Inputs (3 n,) of one sample in those units; pure jax."""
    return (jnp.concatenate([motion.q, motion.qd, motion.qdd]) - scales["input_mean"]) / scales["input_scale"]


def standardised(scales: Mapping[str, Array], motion: Motion, tau: Array) -> tuple[np.ndarray, np.ndarray]:
    """Inputs (T, 3 n) and targets (T, n) in those units."""
    x = (np.concatenate([motion.q, motion.qd, motion.qdd], axis=1) - scales["input_mean"]) / scales["input_scale"]
    return np.asarray(x), np.asarray((tau - scales["target_mean"]) / scales["target_scale"])


def spread_rows(total: int, most: int) -> np.ndarray:
    """Indices of at most that many of `total` rows, evenly spread."""
    return np.linspace(0, total - 1, min(most, total)).astype(int)
