"""Effects in time windows: all windows are tried in which another effect would explain the residual.

Cumulative sums over rows are stored, so that the explained squares of an effect in any window need one small solve.
Windows on a coarse grid come first, then each edge at every row; the exact refinement then moves the edges.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from invdyn_cli.diagnosis.columns.candidates import passing_candidate, passing_columns
from invdyn_cli.diagnosis.columns.evidence import BLOCK, Candidate, Evidence
from invdyn_cli.diagnosis.search.edges import together
from invdyn_cli.diagnosis.search.judge import PRICE_OF_COEFFICIENT, Hypothesis
from invdyn_cli.diagnosis.search.noise import Noise
from invdyn_cli.diagnosis.search.placed import at_best_point
from invdyn_cli.diagnosis.search.windowed import Lasting, Windowed, times_carried
from invdyn_cli.effects.composition import TimeWindow
from invdyn_cli.interfaces import AbstractEffect
from invdyn_cli.maths.statistics import effective_number
from invdyn_cli.recording.pieces import ROLES

GRID, CELL = 120, 0.1
"""Number of window edges that are tried in a trajectory, and the shortest step between them [s]."""

SHORTEST = 0.4
"""[s] Shortest window: a shorter event is an impact, of which only the momentum is known."""

PRICE = 40.0
"""Noise variances that a window must explain, beyond the price of its coefficients, to be tried: the best of ten
thousand in white noise has 25 (one coefficient) to 50 (ten)."""

SHARE, LARGE = 0.01, 0.2
"""Share of the squares of the residual that a window must explain, because a slightly wrong model leaves structure; and
the share for the first search."""

WITHIN = 0.2
"""The same of what is left in the window beyond noise: what comes and goes is there all the time between."""

EVEN = 0.35
"""Share of the window over which it must be spread, as far as its joints move: blows of a gear's flanks, reversals that
a friction does not hit and the like leave pulses."""

MOST, ROUNDS = 3, 3
"""Number of windows that are searched in one residual, and of repetitions with the found ones removed."""

SAME = SHORTEST / 2
"""[s] Difference of the edges, in sum, up to which two windows count as the same: what differs is no event."""

EDGE = 1.0
"""[s] A window whose edge is nearer to an end of its trajectory begins or ends there; one that does both is no
window."""

SEEN = 0.5
"""Share of what a window explains that must be of joints which also move outside it, for longer than EDGE: of a joint
that moves in it alone, nothing says that it comes and goes."""

PARTS, FINEST = 6, 0.2
"""Blocks that a window is parted into, and the shortest of them [s], so that some choose and others judge; at least
TURN of them."""

TURN = 3
"""Every so many blocks one judges."""


Windows = dict[TimeWindow, Sequence[Candidate]]
"""Windows of time, with every effect that may come and go in each."""


@dataclass(frozen=True)
class Place:
    """An effect that may act in a time window, on a joint: its columns (k, n, R) and the prior of their factors
    (k,)."""

    effect: AbstractEffect
    joint: int | None
    columns: np.ndarray
    precision: np.ndarray


def places(evidence: Evidence, effects: Mapping[str, AbstractEffect], side: str) -> list[Place]:
    """Every effect that may act in a time window, on all joints where it is observable; if it is equal on several
    joints, it is taken on the outermost."""
    made: list[Place] = []
    loud = np.sqrt(np.mean(evidence.tau**2))
    for effect in effects.values():
        if not effect.passing or side not in effect.sides:
            continue
        whole = not effect.of_joint
        own: list[Place] = []
        for joint in (None,) if whole else reversed(range(evidence.dofs)):
            columns = passing_columns(evidence, effect, joint, None)
            precision = effect.precision(evidence.robot, joint, len(columns))
            felt = np.abs(columns).max() > 1e-6 * loud
            if felt and not any(np.allclose(columns, x.columns, atol=1e-6 * np.abs(columns).max()) for x in own):
                own.append(Place(effect, joint, columns, precision))
        made += own
    return made


def proposed(
    evidence: Evidence,
    everywhere: Sequence[Place],
    residuals: Sequence[np.ndarray],
    measured: Noise,
    known: Sequence[TimeWindow] = (),
    lasting: Hypothesis = (),
    share: float = SHARE,
) -> Windows:
    """For each window in which something comes and goes, every effect that may be it; the windows that explain most
    first.

    Args:
        residuals: (R, n) each, in which windows are looked for.
        known: windows that need not be proposed.
        lasting: what the residuals were fitted with; it is fitted anew beside every window.
        share: of a residual's squares that a window must explain.
    """
    if not everywhere:
        return {}
    made: dict[TimeWindow, np.ndarray] = {}
    first = 1 + max((when.number for when in known), default=-1)
    used = evidence.valid * measured.weights * ~evidence.of_role("reference")[:, None]
    beside = Lasting.beside(evidence, lasting, used)
    for residual in residuals:
        left = residual.copy()
        squares = float(np.sum(used * residual**2))
        least, each = (max(PRICE, x * squares) for x in (share, SHARE))
        for _ in range(MOST):
            refit = beside.explained(left)
            tries = [_window(evidence, p, left, refit, measured, beside, each) for p in everywhere]
            value, when, after = max(tries, key=lambda x: x[0], default=(0.0, None, left))
            if value <= least or when is None:
                break
            for one in (when, *_other_end(evidence, when)):
                if not any(_alike(one, other) for other in (*known, *made)):
                    number = first + len(made)
                    made[together([w._replace(number=number) for w in one.each])] = left
            left = after
    windows: Windows = {}
    for when, left in made.items():  # a drive does not become as weak again and again
        some = [p for p in everywhere if not (when.again and p.effect.factor)]
        own = [passing_candidate(evidence, p.effect, p.joint, when) for p in some]
        forces = {c.effect.name: c for c in own if c.effect.placed_by}
        moved = (at_best_point(evidence, c, when, lasting, used, left) for c in forces.values())
        windows[when] = [*own, *(c for c in moved if c)]
    return windows


def _alike(one: TimeWindow, other: TimeWindow) -> bool:
    """Whether two effects have the same windows, except for some rows at their edges."""
    pairs = zip(one.each, other.each, strict=False)
    near = all(abs(a.start - b.start) + abs(a.end - b.end) < SAME for a, b in pairs)
    return one.trajectory == other.trajectory and len(one.again) == len(other.again) and near


def _other_end(evidence: Evidence, when: TimeWindow) -> list[TimeWindow]:
    """What is left of the trajectory, if the window is at one of its ends: a change until then is one from then on."""
    if when.again:
        return []
    first, last = evidence.recording.ends[when.trajectory]
    if when.start - first < EDGE < last - when.end:
        return [when._replace(start=when.end, end=last)]
    if last - when.end < EDGE < when.start - first:
        return [when._replace(start=first, end=when.start)]
    return []


def interleaved(evidence: Evidence, windows: Iterable[TimeWindow]) -> Evidence:
    """The evidence with training and held-out blocks in turn, in every window and outside: an event that occurs once
    must be in both. Blocks at an edge choose, or nothing would say where it is."""
    block, role = evidence.block.copy(), evidence.role.copy()
    t, first, short = evidence.on_rows("t"), 0, 0
    for number, piece in enumerate(evidence.recording.pieces):
        at = evidence.piece == number
        own = [w for one in windows for w in one.each if w.trajectory == piece.trajectory]
        edges = np.unique([-np.inf, *(x for w in own for x in (w.start, w.end)), np.inf])
        part = np.searchsorted(edges, t[at], side="right") - 1
        mine = np.zeros(at.sum(), int)
        judge = np.zeros(at.sum(), bool)
        for segment in np.unique(part):
            here = part == segment
            time = t[at][here]
            inside = any(w.start < time.mean() < w.end for w in own)
            length = time[-1] - time[0] + 1e-9
            count = max(1, int(length / BLOCK))
            if inside:
                count = max(TURN, min(PARTS, int(length / FINEST)), count)
            turn = np.minimum((time - time[0]) / length * count, count - 1).astype(int)
            mine[here] = first + turn
            if count >= TURN:
                judge[here] = (turn % TURN == 1) & (turn < count - 1)
            else:  # short stretches between windows take turns
                judge[here] = (short + turn) % TURN == TURN - 1
                short += count
            first += count
        block[at] = mine
        if piece.role != "reference":
            role[at] = np.where(judge, ROLES.index("test"), ROLES.index("train"))
    return replace(evidence, block=block, role=role)


def _window(
    evidence: Evidence,
    place: Place,
    left: np.ndarray,
    refit: np.ndarray,
    measured: Noise,
    lasting: Lasting,
    each: float,
) -> tuple[float, TimeWindow | None, np.ndarray]:
    """The explained squares of an effect in its best window, minus its price; the window, and what is then left
    (R, n). A load may be there several times, if each explains `each`."""
    t, k = evidence.on_rows("t"), len(place.columns)
    names, used = evidence.trajectory, lasting.used
    best: tuple[float, TimeWindow | None, np.ndarray] = -np.inf, None, left
    for name in dict.fromkeys(names):
        rows = np.flatnonzero((names == name) & ~evidence.of_role("reference"))
        if len(rows) < 2 * k:
            continue
        windowed, time = Windowed(lasting, place.columns, place.precision, left, refit, rows), t[rows]
        moves = used[rows][:, windowed.felt] > 0
        span = _span(windowed, time, moves)
        if span is None:
            continue
        spans, value = [span], windowed.gained([span])
        if place.effect.load:
            several = times_carried(windowed, span, time, each, SHORTEST)
            gained = windowed.gained(several) - each * (len(several) - 1)
            spans, value = (several, gained) if gained > value else (spans, value)
        value -= PRICE_OF_COEFFICIENT * k
        (a, b), *more = spans
        lasts = time[a] < time[0] + EDGE and time[b - 1] > time[-1] - EDGE
        if value <= best[0] or (lasts and not more):
            continue
        factors, made, after = windowed.fitted(spans)
        if place.effect.refuse(place.effect.found(factors.tolist(), {}, evidence.robot, place.joint)):
            continue
        inside = np.concatenate([np.arange(a, b) for a, b in spans])
        there, own = rows[inside], used[rows[inside]]
        of_joints = own * ((after + made)[there] ** 2 - after[there] ** 2)
        seen = np.median(np.diff(time)) * (moves.sum(axis=0) - moves[inside].sum(axis=0)) >= EDGE
        if of_joints[:, windowed.felt][:, seen].sum() < SEEN * of_joints.sum():
            continue
        gained = of_joints.sum(axis=1)
        excess = np.sum((own * ((after + made)[there] ** 2 - measured.deviation**2))[:, windowed.felt])
        moving = gained[moves[inside].any(axis=1)]
        if gained.sum() - PRICE_OF_COEFFICIENT * k > WITHIN * excess and _spread(moving) > EVEN:
            between = np.concatenate([time[:1], (time[1:] + time[:-1]) / 2, time[-1:]])
            when = together([TimeWindow(str(name), float(between[a]), float(between[b])) for a, b in spans])
            best = value, when, after
    return best


def _span(windowed: Windowed, time: np.ndarray, moves: np.ndarray) -> tuple[int, int] | None:
    """The rows from one to another in which an effect explains most; None: no window is possible. `moves` (R, m) says
    whether each joint that feels it moves."""
    step = max(CELL, (time[-1] - time[0]) / GRID)
    grid = np.unique(np.searchsorted(time, np.append(np.arange(time[0], time[-1], step), np.inf)))
    first, last = np.triu_indices(len(grid), 1)
    a, b = grid[first], grid[last]
    long = time[b - 1] - time[a] >= SHORTEST
    count = np.concatenate([np.zeros((1, moves.shape[1])), np.cumsum(moves, axis=0)])[grid]
    outside = np.median(np.diff(time)) * (moves.sum(axis=0) - count[last] + count[first])
    long &= (time[a] >= time[0] + EDGE) | (time[b - 1] <= time[-1] - EDGE)
    long &= outside.mean(axis=1) >= EDGE
    if not long.any():
        return None
    at = np.flatnonzero(long)[np.argmax(windowed.gains(grid, first[long], last[long]))]
    return _sharpened(windowed, int(a[at]), int(b[at]), time, 2 * step)


def _spread(gained: np.ndarray) -> float:
    """Over which share of a window the gain is spread: 1 if it is uniform, less for impacts."""
    parts = np.array([x.sum() for x in np.array_split(gained, PARTS)])
    return effective_number(parts) / PARTS


def _sharpened(windowed: Windowed, a: int, b: int, time: np.ndarray, reach: float) -> tuple[int, int]:
    """Edges of a window moved in turn to the rows that explain most; the window does not become shorter than
    SHORTEST."""
    for _ in range(2):
        near = np.flatnonzero(np.abs(time - time[min(a, len(time) - 1)]) <= reach)
        near = near[time[near] <= time[b - 1] - SHORTEST]
        if len(near):
            edges = windowed.before(near[0], near[-1])
            a = int(near[np.argmax(windowed.gain(windowed.between(0, b) - edges))])
        near = np.flatnonzero(np.abs(time - time[b - 1]) <= reach) + 1
        near = near[time[near - 1] >= time[a] + SHORTEST]
        if len(near):
            edges = windowed.before(near[0], near[-1])
            b = int(near[np.argmax(windowed.gain(edges - windowed.between(0, a)))])
    return a, b
