"""Edges of time windows, from sums of squares with the effect and without it.

The derivative of a loss by an edge reaches only as far as the filters, some hundredths of a second. But before a window
begins the residual without the effect is smaller, and within it the residual with the effect: in the cumulative sum of
the difference of their squares, one edge is the lowest point and the other the highest.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Evidence
from invdyn_cli.diagnosis.search.coordinates import EDGES
from invdyn_cli.effects.composition import EffectInstance

REACH = 0.25
"""Share of a window's length by which its edges move at most in one step."""


def summed(
    evidence: Evidence, acting: Sequence[EffectInstance], squares: Callable[[Sequence[EffectInstance]], np.ndarray]
) -> tuple[EffectInstance, ...]:
    """Effects with the edges of their windows where the sums say, one window after the other.

    Args:
        squares: the weighted squares (R,) that effects leave of every row.
    """
    acting, names = list(acting), evidence.trajectory
    for number, one in enumerate(acting):
        if one.when is None:
            continue
        there = replace(one, when=one.when._replace(start=-np.inf, end=np.inf))
        before, behind = acting[:number], acting[number + 1 :]
        at = names == one.when.trajectory
        saved = (squares([*before, *behind]) - squares([*before, there, *behind]))[at]
        t, total = evidence.on_rows("t")[at], np.append(0.0, np.cumsum(saved))
        times = np.concatenate([t[:1], (t[1:] + t[:-1]) / 2, t[-1:]])
        reach = REACH * (one.when.end - one.when.start)
        found = {}
        for name, sign in zip(EDGES, (1.0, -1.0), strict=True):
            away = np.abs(times - getattr(one.when, name))
            near = np.flatnonzero(away <= reach)
            if len(near):  # among rows that do not count the nearest
                found[name] = float(times[near[np.lexsort((away[near], sign * total[near]))[0]]])
        acting[number] = replace(one, when=one.when._replace(**found))
    return tuple(acting)


def within(acting: Sequence[EffectInstance], labels, move: np.ndarray) -> np.ndarray:
    """A move (k,) of the parameters that takes no edge farther than REACH: beyond, its slope says nothing."""
    farthest = np.full(len(move), np.inf)
    for i, (number, name, _) in enumerate(labels):
        when = acting[number].when
        if name in EDGES and when is not None:
            farthest[i] = REACH * (when.end - when.start)
    return np.clip(move, -farthest, farthest)
