"""How well a motion distinguishes causes: the distance between the torque of the true one and the best imitation by a
rival (Atkinson and Fedorov 1975: T-optimal designs for discrimination).

    D^2 = min over the rival's parameters, and those of nuisances, of sum (true - rival - nuisances)^2 / noise variance

in standard errors, with the autocorrelation of the noise, after the low-pass filter of the diagnosis. Scenes are scored
by their Gram matrices, which add up, so that hundreds of candidates are cheap.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np

from invdyn_cli.design.causes import Cause, Column, Scenes, Usual, columns, link_columns, term
from invdyn_cli.design.sizes import SHARE, typical
from invdyn_cli.diagnosis.columns.evidence import REST_SPEED
from invdyn_cli.effects.actuator import TorqueOffset
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.friction import CoulombFriction, ViscousFriction
from invdyn_cli.effects.load import LinkInertiaError
from invdyn_cli.interfaces import AbstractTorqueEffect
from invdyn_cli.maths.signals import lowpass
from invdyn_cli.types import Robot

Side = tuple[Cause, ...]
"""A set of causes that together explain a log: one of the alternatives of an ambiguous finding."""

NUISANCES = (TorqueOffset.name, CoulombFriction.name, ViscousFriction.name)
"""Effects that every joint has to some degree, and for which a diagnosis must allow."""

LEAST_SIZE, LARGEST_FACTOR = 0.3, 1e3
"""Least size of a side, as a share of that of the largest side; and the largest factor that is used for this."""

MOST_TRIALS = 9
"""Combinations of a rival's nonlinear parameters that are tried."""

MODEL_ERROR = 0.002
"""Share of a joint's usual torque that errors of clocks, interpolation and filters leave in the residual of any model
(`search.RELEVANT`)."""


@dataclass(frozen=True)
class Pair:
    """A true side and a rival, as numbers of sides of the question `question`."""

    question: int
    true: int
    rival: int


@dataclass(frozen=True)
class Contest:
    """The causes to distinguish, and how their columns are scored.

    Attributes:
        questions: for each the sides between which it is open, every cause with parameters.
        known: causes that are allowed for beside them.
        usual: what the joints usually do.
        weights: (n,) 1 / (noise variance x samples that its low-pass binds together), per sample at `rate`.
        cutoffs: (n,) [Hz] of the low-pass.
        pairs: what is compared.
        factors: (question, side) -> factor by which a side's term is taken larger than its parameters say.
    """

    robot: Robot
    questions: Sequence[Sequence[Side]]
    known: Sequence[Cause]
    usual: Usual
    weights: np.ndarray
    cutoffs: np.ndarray
    pairs: tuple[Pair, ...] = ()
    factors: Mapping[tuple[int, int], float] = field(default_factory=dict)


@dataclass(frozen=True)
class Evaluation:
    """Gram matrices (S, K, K) of all columns per scene; which are the terms (question, side) -> number, and the trials
    of every pair: column numbers and precisions."""

    grams: np.ndarray
    terms: dict[tuple[int, int], int]
    trials: dict[tuple[int, int, int], list[tuple[np.ndarray, np.ndarray]]]


def pairs_of(questions: Sequence[Sequence[Side]]) -> tuple[Pair, ...]:
    """Every ordered pair of sides, except those whose rival contains the true one as a special case."""
    return tuple(
        Pair(number, a, b)
        for number, sides in enumerate(questions)
        for a, b in product(range(len(sides)), repeat=2)
        if a != b and not _holds(sides[b], sides[a])
    )


def sized(contest_questions: Sequence[Sequence[Side]], robot: Robot, usual: Usual, duration: float, scenes: Scenes):
    """The questions with parameters for every cause: those that lack them get typical ones, scaled to the RMS torque
    of the others in their question that have some."""
    made = []
    for sides in contest_questions:
        given = [_rms(term(robot, c, scenes)) for side in sides for c in side if c.parameters is not None]
        size = max(given, default=None)
        made.append([tuple(_with_size(c, robot, usual, duration, scenes, size) for c in side) for side in sides])
    return made


def factors(contest: Contest, evaluation: Evaluation) -> dict[tuple[int, int], float]:
    """Factors that make the sides of a question nearly equal in size: what a poor log says of a rival's size, where it
    stands in the place of the true cause, may be next to nothing."""
    whole = evaluation.grams.sum(0)
    sizes = {key: float(np.sqrt(max(whole[k, k], 0.0))) for key, k in evaluation.terms.items()}
    out = {}
    for (question, side), size in sizes.items():
        largest = max(x for (q, _), x in sizes.items() if q == question)
        out[question, side] = float(np.clip(LEAST_SIZE * largest / max(size, 1e-300), 1.0, LARGEST_FACTOR))
    return out


def is_time_varying(contest: Contest, scenes: Scenes) -> bool:
    """Whether any of the causes is another one later in the recording."""
    later = replace(scenes, t=scenes.t + 10.0)
    causes = [c for sides in contest.questions for side in sides for c in side]
    both = (
        (term(contest.robot, c, scenes), term(contest.robot, c, later)) for c in causes if c.effect.point == "torque"
    )
    return any(not np.array_equal(a[j], b[j]) for a, b in both for j in a)


def _with_size(cause: Cause, robot: Robot, usual: Usual, duration: float, scenes: Scenes, size: float | None) -> Cause:
    if cause.parameters is not None:
        return cause
    parameters = typical(cause.effect, cause.joint, robot, usual, duration)
    made = replace(cause, parameters=parameters)
    if not size or not isinstance(cause.effect, AbstractTorqueEffect):
        return made
    ratio = size / max(_rms(term(robot, made, scenes)), 1e-12)
    kept = (*cause.effect.shape_of(parameters), "phase", "rest")
    linear = [k for k in parameters if k not in kept]
    return replace(cause, parameters={**parameters, **{k: ratio * parameters[k] for k in linear}})


def evaluated(contest: Contest, scenes: Scenes) -> Evaluation:
    """The Gram matrices of scenes."""
    robot, level = contest.robot, SHARE * contest.usual.torque
    table: list[Column] = []
    cache: dict[Any, Any] = {}

    def numbers(made: Sequence[Column]) -> np.ndarray:
        table.extend(made)
        return np.arange(len(table) - len(made), len(table))

    def trials_of(cause: Cause, exact: bool = False) -> list[tuple[np.ndarray, np.ndarray]]:
        key = (*cause.key, exact, bool(cause.effect.scanned) and id(cause.parameters))
        if key not in cache:
            cache[key] = [(numbers(x), p) for x, p in columns(robot, cause, scenes, level, exact)]
        return cache[key]

    def link(joint: int) -> tuple[np.ndarray, np.ndarray]:
        if ("link", joint) not in cache:
            made, precision = link_columns(robot, joint, scenes)
            cache["link", joint] = numbers(made), precision
        return cache["link", joint]

    terms = {}
    for number, sides in enumerate(contest.questions):
        for k, side in enumerate(sides):
            terms[number, k] = int(numbers([_sum([term(robot, c, scenes) for c in side])])[0])
    trials = {}
    for pair in contest.pairs:
        sides = contest.questions[pair.question]
        beside: list[tuple[np.ndarray, np.ndarray]] = [
            (trial[0], trial[1] + 1 / np.maximum(level[cause.joint or 0], 1e-9) ** 2 * (cause.effect.name in NUISANCES))
            for cause in _nuisances(sides[pair.true], sides[pair.rival])
            for trial in trials_of(cause)[:1]
        ]
        own = {c.key for c in (*sides[pair.true], *sides[pair.rival])}
        beside += [trial for c in contest.known if c.key not in own for trial in trials_of(c, exact=True)[:1]]
        beside += [link(j) for j in _links(sides[pair.true], sides[pair.rival])]
        every = [trials_of(c) for c in sides[pair.rival]]
        combined = list(product(*every))
        combined = combined[:: max(1, len(combined) // MOST_TRIALS)]
        key = (pair.question, pair.true, pair.rival)
        trials[key] = [
            (np.concatenate([x for x, _ in (*one, *beside)]), np.concatenate([p for _, p in (*one, *beside)]))
            for one in combined
        ]
    return Evaluation(_grams(contest, scenes, table), terms, trials)


def distances(contest: Contest, evaluation: Evaluation, grams: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Squared distances (P, …) of all pairs for Gram matrices (…, K, K), and the squares (P, …) that the true terms
    have by themselves."""
    out, whole = [], []
    for pair in contest.pairs:
        sides = contest.questions[pair.question]
        if _parts(sides[pair.true]) == _parts(sides[pair.rival]):
            out.append(np.zeros(grams.shape[:-2]))
            whole.append(np.zeros(grams.shape[:-2]))
            continue
        a = evaluation.terms[pair.question, pair.true]
        best = None
        s = grams[..., a, a]
        for ids, precision in evaluation.trials[pair.question, pair.true, pair.rival]:
            normal = grams[..., ids[:, None], ids]
            r = grams[..., ids, a]
            unit = np.sqrt(np.maximum(np.einsum("...ii->...i", normal), 1e-30))
            scaled = normal / (unit[..., :, None] * unit[..., None, :])
            scaled[..., np.arange(len(ids)), np.arange(len(ids))] += precision / unit**2 + 1e-10
            theta = np.linalg.solve(scaled, (r / unit)[..., None])[..., 0] / unit
            left = np.maximum(s - np.einsum("...i,...i->...", theta, r), 0.0)
            best = left if best is None else np.minimum(best, left)
        assert best is not None
        square = contest.factors.get((pair.question, pair.true), 1.0) ** 2
        out.append(square * best)
        whole.append(square * s)
    return np.array(out), np.array(whole)


def _grams(contest: Contest, scenes: Scenes, table: Sequence[Column]) -> np.ndarray:
    n, count, length = scenes.shape
    out = np.zeros((count, len(table), len(table)))
    for j in range(n):
        ids = np.array([k for k, column in enumerate(table) if j in column])
        if not len(ids):
            continue
        x = np.stack([np.broadcast_to(table[k][j], (count, length)) for k in ids])
        x = lowpass(x, scenes.rate, float(min(contest.cutoffs[j], 0.45 * scenes.rate)), axis=-1)
        moving = np.abs(np.asarray(scenes.motion.qd)[j]) > REST_SPEED  # at rest its friction can be anything
        x = (x * moving).transpose(1, 0, 2)
        out[:, ids[:, None], ids] += contest.weights[j] * (x @ x.transpose(0, 2, 1))
    return out


def _nuisances(true: Side, rival: Side) -> list[Cause]:
    """The nuisance effects on the joints of two sides, except those that one side is or that the rival contains."""
    taken = {(name, c.joint) for c in rival for name in (c.effect.name, *c.effect.contains)}
    taken |= {part for part in _parts(true)}
    joints = {c.joint for c in (*true, *rival) if c.joint is not None}
    return [Cause(EFFECTS[x], j) for j in sorted(joints) for x in NUISANCES if (x, j) not in taken]


def _links(true: Side, rival: Side) -> list[int]:
    """Joints whose link inertials are nuisances: those where neither side is such an error itself."""
    both = (*true, *rival)
    if any(c.effect.point != "torque" or (LinkInertiaError.name,) in c.effect.confounders for c in both):
        return []
    return sorted({c.joint for c in both if c.joint is not None})


def _parts(side: Side) -> set[tuple[str, int | None]]:
    """Pairs of effects and joints that no motion distinguishes, because one is the sum of two others."""
    return {(name, c.joint) for c in side for name in c.effect.sum_of or (c.effect.name,)}


def _holds(general: Side, special: Side) -> bool:
    if _parts(special) == _parts(general):
        return False  # no case of it, but the same
    return all(
        any(g.key == s.key or (g.joint == s.joint and s.effect.name in g.effect.contains) for g in general)
        for s in special
    )


def _sum(parts: Sequence[Column]) -> Column:
    joints = {j for p in parts for j in p}
    return {j: sum((p[j] for p in parts if j in p), start=np.zeros(())) for j in joints}


def _rms(column: Column) -> float:
    return float(np.sqrt(sum(np.mean(np.square(x)) for x in column.values())))
