"""Errors along a repetition: NMSE = MSE(S) / Var(T) of every 100 samples S, stage by stage (paper, section V-C).

Blocks are counted from the beginning of each stage in each repetition, so that repetitions of different lengths lie
over each other and no block belongs to two stages; what fills no block at a stage's end is left out. T is the whole
set. An error is the mean over joints. NaN is where a repetition has no such block; a block in which a prediction is not
finite has an infinite error.
"""

import warnings
from itertools import pairwise
from typing import Any

import numpy as np

from invdyn_cli.maths.metrics import ACCURATE, BLOCK, nmse_in_blocks
from invdyn_cli.types import Prediction, Trajectory

LEVELS = (ACCURATE, 0.01)
"""NMSE that a stage's error is said to come down to: accurate, and a tenth of it (paper, section V-C)."""


def errors(judged: Prediction) -> dict[str, np.ndarray]:
    """NMSE of each stage's blocks, the mean over joints: (repetitions, blocks), NaN behind a repetition's last; without
    stages the whole is one, "all"."""
    return {name: _mean(found, axis=2) for name, found in by_joint(judged).items()}


def by_joint(judged: Prediction) -> dict[str, np.ndarray]:
    """The same for every joint: (repetitions, blocks, n)."""
    variance, row = np.var(judged.data.tau, axis=0), 0
    found: dict[str, list[np.ndarray]] = {}
    for x in judged.data.trajectories:
        said = judged.tau[row : row + len(x.t)]
        row += len(x.t)
        for name, rows in parts(x):
            found.setdefault(name, []).append(nmse_in_blocks(np.asarray(x.tau)[rows], said[rows], BLOCK, variance))
    return {name: padded(every) for name, every in found.items()}


def begins(judged: Prediction) -> dict[str, float]:
    """[samples] from a repetition's start at which each stage begins, the median over repetitions."""
    found: dict[str, list[int]] = {}
    for x in judged.data.trajectories:
        for name, rows in parts(x):
            found.setdefault(name, []).append(rows.start)
    return {name: float(np.median(every)) for name, every in found.items()}


def line(errors: np.ndarray) -> np.ndarray:
    """The median over repetitions, as far as at least half of them go, (blocks,) of (repetitions, blocks)."""
    kept = reached(errors)
    return np.nanmedian(errors[:, kept], axis=0) if kept.any() else np.empty(0)


def reached(errors: np.ndarray) -> np.ndarray:
    """Which blocks half of the repetitions have, (blocks,) of (repetitions, blocks)."""
    return (~np.isnan(errors)).mean(axis=0) >= 0.5


def until_below(errors: np.ndarray, level: float) -> int | None:
    """Samples from a stage's beginning until the median over repetitions is below the level and stays there until the
    stage ends; None where it never does."""
    above = np.flatnonzero(~(line(errors) < level))
    last = above[-1] + 1 if len(above) else 0
    return None if last == len(line(errors)) else int(last) * BLOCK


def scores(judged: Prediction) -> dict[str, Any]:
    """Over all blocks and by stage: `mean`; `peak`, the highest block of all repetitions; `line_peak`, the highest of
    the median over repetitions; by stage `samples_below` each of `LEVELS`, as `until_below` has it.

    A set with a prediction that is not finite has infinite errors, and None for `samples_below`."""
    found = {name: _judged(x) for name, x in errors(judged).items() if x.shape[1]}
    if not found:
        return {}
    joints = np.concatenate([x.reshape(-1, x.shape[2]) for x in by_joint(judged).values()])
    every = np.concatenate([x.ravel() for x in found.values()])
    lines = np.concatenate([line(x) for x in found.values()])
    return {
        "nmse": {
            "mean": float(_mean(every, axis=0)),
            "peak": _highest(every),
            "line_peak": _highest(lines),
            "joint": dict(zip(judged.data.joints, _mean(joints, axis=0), strict=True)),
        },
        "stages": {
            name: {
                "mean": float(_mean(x.ravel(), axis=0)),
                "peak": _highest(x),
                "line_peak": _highest(line(x)),
                "samples_below": {f"{level:g}": until_below(x, level) for level in LEVELS},
            }
            for name, x in found.items()
        },
    }


def parts(x: Trajectory) -> list[tuple[str, slice]]:
    """A recording's stages in time, and the rows of each."""
    if x.stage is None:
        return [("all", slice(0, len(x.t)))]
    stage = np.asarray(x.stage)
    edges = [0, *(np.flatnonzero(stage[1:] != stage[:-1]) + 1), len(stage)]
    return [(str(stage[a]), slice(int(a), int(b))) for a, b in pairwise(edges)]


def padded(every: list[np.ndarray]) -> np.ndarray:
    """Arrays of different lengths (blocks, ...) as one array, with NaN after the end of the shorter ones."""
    out = np.full((len(every), max(map(len, every)), *every[0].shape[1:]), np.nan)
    for row, x in zip(out, every, strict=True):
        row[: len(x)] = x
    return out


def _judged(errors: np.ndarray) -> np.ndarray:
    """The same, infinite in all blocks where it is in any: a repetition that diverged is not hidden by a median."""
    return np.where(np.isinf(errors).any() & ~np.isnan(errors), np.inf, errors)


def _highest(values: np.ndarray) -> float:
    """The highest of the numbers that exist, NaN where there is none."""
    return float(np.fmax.reduce(values, axis=None, initial=np.nan))


def _mean(values: np.ndarray, axis: int) -> Any:
    """The mean of the numbers that exist, NaN where there is none, without a warning of numpy."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.nanmean(values, axis=axis)
