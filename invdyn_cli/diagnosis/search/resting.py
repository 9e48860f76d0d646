"""Edges of time windows while the arm rests: friction can balance any torque up to its level, and an edge shows only by
what friction cannot balance.

At rest, a joint's torque minus that of the links is between the levels of its friction: before a load appears without
the load, and afterwards with it. Where this would need more friction than there is, the edge cannot be.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Evidence
from invdyn_cli.diagnosis.search.composed import Model, Refined
from invdyn_cli.diagnosis.search.coordinates import EDGES
from invdyn_cli.diagnosis.search.edges import BEYOND, lasting, together
from invdyn_cli.effects.composition import EffectInstance, joint_terms
from invdyn_cli.interfaces import JointState

SHORTEST = 0.05
"""[s] Shortest rest that hides an edge: a shorter one is bridged by the rows on both sides."""

ANSWER = 0.05
"""[s] Time in which a controller compensates what friction no longer balances: an edge is that much earlier than its
first sign."""

MARGIN = 0.1
"""Share of a friction by which it may be larger at rest than in motion."""


def edges(evidence: Evidence, model: Model, refined: Refined) -> tuple[Refined, list[dict[str, tuple]]]:
    """The same with every edge that falls into a rest in the middle of where it can be; and for each effect {edge:
    (value, lower, upper)} of these, in the first of its windows."""
    acting, known, left = list(refined.acting), [{} for _ in refined.acting], _left(evidence, refined)
    for i, one in enumerate(refined.acting):
        if one.when is None:
            continue
        others = refined.acting[:i] + refined.acting[i + 1 :]
        always = model.without(refined, others) - model.without(refined, (*others, lasting(one)))
        telling = np.any(evidence.valid & (np.abs(always) > left), axis=1)
        found = [_placed(evidence, model, replace(one, when=w), others, left, telling) for w in one.when.each]
        moved = [
            w._replace(**{edge: value for edge, (value, *_) in own.items()})
            for w, own in zip(one.when.each, found, strict=True)
        ]
        acting[i], known[i] = replace(one, when=together(moved)), found[0]
    return replace(refined, acting=tuple(acting)), known


def _placed(
    evidence: Evidence,
    model: Model,
    one: EffectInstance,
    others: Sequence[EffectInstance],
    left: np.ndarray,
    telling: np.ndarray,
) -> dict[str, tuple]:
    """{edge: (value, lower, upper)} of the edges of an effect's window that fall into rests."""
    known = {}
    for edge in EDGES:
        rest, ends = _rest(evidence, one, getattr(one.when, edge), telling)
        if rest is not None:
            low, high = _bearable(evidence, model, one, others, left, edge, rest)
            at_end = [x for x in ends if low <= x <= high]  # what may have been there from the start, or still is
            known[edge] = (at_end[0] if at_end else (low + high) / 2, low, high)
    return known


def _left(evidence: Evidence, refined: Refined) -> np.ndarray:
    """RMS (n,) [N m; N] of the residual on the rows that count."""
    used = evidence.valid
    return np.sqrt(np.sum(refined.residual**2 * used, axis=0) / np.maximum(used.sum(axis=0), 1))


def _rest(
    evidence: Evidence, one: EffectInstance, edge: float, telling: np.ndarray
) -> tuple[tuple[float, float] | None, tuple[float, float]]:
    """From when to when [s] no row of a trajectory tells of what comes or goes, around an edge; None: they do. And the
    trajectory's ends."""
    assert one.when is not None
    ends, names = evidence.recording.ends[one.when.trajectory], evidence.trajectory
    row = evidence.recording.filter.keep / evidence.recording.filter.rate
    t = evidence.on_rows("t")[telling & (names == one.when.trajectory)]
    for start, end in pairwise([ends[0], *t, ends[1]]):
        if end - start > SHORTEST and start - 2 * row <= edge <= end + 2 * row:
            return (float(start), float(end)), ends
    return None, ends


def _bearable(
    evidence: Evidence,
    model: Model,
    one: EffectInstance,
    others: Sequence[EffectInstance],
    left: np.ndarray,
    edge: str,
    rest: tuple[float, float],
) -> tuple[float, float]:
    """From when to when [s] within a rest an edge asks no more of any joint's friction than it can bear; all effects
    leave `left` (n,)."""
    assert one.when is not None
    start, end = rest
    smooth = [a for a in others if a.effect.point != "torque"]  # friction may have any value at rest: `_levels`
    ways = [[model.unfiltered(x, j) for j in range(evidence.dofs)] for x in (smooth, [*smooth, lasting(one)])]
    times, asked = [], []
    for number, piece in enumerate(evidence.recording.pieces):
        at = (piece.t >= start) & (piece.t <= end) & (piece.trajectory == one.when.trajectory)
        if not at.any():
            continue
        borne = [np.array([x[number] for x in way]) for way in ways]  # without the effect, and with it
        parents, states = evidence.robot.parents, evidence.states[number]
        low, high = np.array([_levels(others, j, states, parents) for j in range(evidence.dofs)]).swapaxes(0, 1)
        white = 1.05 * np.median(np.abs(np.diff(borne[0])), axis=1)  # noise, and the answer to it
        noise = np.hypot(left, white)[:, None]
        slack = MARGIN * (high - low) / 2 + 2 * left[:, None]
        over = [np.maximum(np.maximum(x - high, low - x) - slack, 0.0) / noise for x in borne]
        times.append(piece.t[at])
        asked.append(np.sum(np.square(over)[:, :, at], axis=1))
    if not times:  # a gap of the log
        return start, end
    t, (before, after) = np.concatenate(times), np.concatenate(asked, axis=1)[:: 1 if edge == "start" else -1]
    cost = np.append(0.0, np.cumsum(before)) + np.append(np.cumsum(after[::-1])[::-1], 0.0)
    possible = np.flatnonzero(cost <= cost.min() + BEYOND)  # the k-th: between the samples before and at k
    low, high = np.append(start, t)[possible[0]] - ANSWER, np.append(t, end)[possible[-1]]
    return float(max(start, low)), float(min(end, high + 1 / evidence.recording.filter.rate))


def _levels(
    acting: Sequence[EffectInstance], joint: int, states: Sequence[JointState], parents: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """(T,) each: the least and the most of a joint's friction, springs and offsets, whichever way it is pushed; of a
    gear that it shares, what its motion makes."""
    still = 0 * states[joint].qd
    either_way = [[s._replace(sign=still + sign) for s in states] for sign in (-1.0, 1.0)]
    levels = np.array([still + sum(joint_terms(acting, joint, x, parents)) for x in either_way])
    return levels.min(axis=0), levels.max(axis=0)
