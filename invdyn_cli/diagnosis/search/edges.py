"""Edges of time windows, from sums of squares with the effect and without it.

The derivative of a loss by an edge reaches only as far as the filters, some hundredths of a second. But before a window
begins the residual without the effect is smaller, and within it the residual with the effect: in the cumulative sum of
the difference of their squares, one edge is the lowest point and the other the highest.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Evidence
from invdyn_cli.diagnosis.search.composed import Model, Refined
from invdyn_cli.diagnosis.search.coordinates import EDGES
from invdyn_cli.effects.composition import EffectInstance, TimeWindow

REACH = 0.25
"""Share of a window's length by which its edges move at most in one step."""

BEYOND = 9.0
"""Difference of the loss from that at the best position, in noise variances, above which an edge is excluded: three
standard errors."""

Squares = Callable[[Sequence[EffectInstance]], np.ndarray]
"""The weighted squares (R,) that effects leave of every row."""


def summed(evidence: Evidence, acting: Sequence[EffectInstance], squares: Squares) -> tuple[EffectInstance, ...]:
    """Effects with the edges of their windows where the sums say, one window after the other."""
    acting, names = list(acting), evidence.trajectory
    for number, one in enumerate(acting):
        if one.when is None:
            continue
        at = names == one.when.trajectory
        saved = _saved(acting, number, squares)[at]
        t, total = evidence.on_rows("t")[at], np.append(0.0, np.cumsum(saved))
        times = np.concatenate([t[:1], (t[1:] + t[:-1]) / 2, t[-1:]])
        moved = []
        for when in one.when.each:
            found, reach = {}, REACH * (when.end - when.start)
            for name, sign in zip(EDGES, (1.0, -1.0), strict=True):
                away = np.abs(times - getattr(when, name))
                near = np.flatnonzero(away <= reach)
                if len(near):  # among rows that do not count the nearest
                    found[name] = float(times[near[np.lexsort((away[near], sign * total[near]))[0]]])
            moved.append(when._replace(**found))
        acting[number] = replace(one, when=together(moved))
    return tuple(acting)


def together(windows: Sequence[TimeWindow]) -> TimeWindow:
    """The windows of one effect as one."""
    return windows[0]._replace(again=tuple(windows[1:]))


def _saved(acting: Sequence[EffectInstance], number: int, squares: Squares) -> np.ndarray:
    """(R,) what an effect that is there all the time saves of every row's squares."""
    before, behind = acting[:number], acting[number + 1 :]
    return squares([*before, *behind]) - squares([*before, lasting(acting[number]), *behind])


def lasting(one: EffectInstance) -> EffectInstance:
    """An effect in a time window as it would be all the time."""
    assert one.when is not None
    return replace(one, when=one.when._replace(start=-np.inf, end=np.inf, again=()))


def possible(
    evidence: Evidence, model: Model, refined: Refined, weights: np.ndarray
) -> list[dict[str, tuple[float, float]]]:
    """For each effect {edge: (earliest, latest)} [s] of its window: an edge anywhere else contradicts the rows between
    it and the one that was found. Where the torque is near zero at an edge, its slope does not tell that.
    `weights` (n,) are 1 / (noise variance x autocorrelation time) of every row."""

    def squares(there: Sequence[EffectInstance]) -> np.ndarray:
        return np.sum(weights * evidence.valid * model.without(refined, there) ** 2, axis=1)

    out: list[dict[str, tuple[float, float]]] = [{} for _ in refined.acting]
    for number, one in enumerate(refined.acting):
        if one.when is None:
            continue
        at = evidence.trajectory == one.when.trajectory
        saved, t = _saved(refined.acting, number, squares)[at], evidence.on_rows("t")[at]
        for name, sign in zip(EDGES, (1.0, -1.0), strict=True):
            edge = getattr(one.when, name)
            own = t <= one.when.end if name == "start" else t >= one.when.start  # a window has some length
            before, behind = own & (t < edge), own & (t >= edge)
            early = t[before][-sign * np.cumsum(saved[before][::-1])[::-1] <= BEYOND]
            late = t[behind][sign * np.cumsum(saved[behind]) <= BEYOND]
            out[number][name] = float(min([edge, *early[:1]])), float(max([edge, *late[-1:]]))
    return out


def within(acting: Sequence[EffectInstance], labels, move: np.ndarray) -> np.ndarray:
    """A move (k,) of the parameters that takes no edge farther than REACH: beyond, its slope says nothing."""
    farthest = np.full(len(move), np.inf)
    for i, (number, name, _) in enumerate(labels):
        when = acting[number].when
        if name in EDGES and when is not None:
            farthest[i] = REACH * (when.end - when.start)
    return np.clip(move, -farthest, farthest)
