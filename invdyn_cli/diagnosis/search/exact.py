"""All parameters of a hypothesis, which was chosen with linear columns, refined together with the exact formulas of its
effects: a few Gauss-Newton steps with numerical derivatives."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from invdyn_cli.diagnosis.columns.candidates import kind_of, passing_columns, passing_torque
from invdyn_cli.diagnosis.columns.evidence import Candidate, Evidence, filtered
from invdyn_cli.diagnosis.columns.joint_torques import reversal_columns
from invdyn_cli.diagnosis.search.composed import Model, Refined
from invdyn_cli.diagnosis.search.coordinates import EDGES, coordinates, flat, inside, precision_of, with_parameters
from invdyn_cli.diagnosis.search.edges import summed, within
from invdyn_cli.diagnosis.search.equations import inverse_root, solved
from invdyn_cli.diagnosis.search.shared_part import precision_of as precision_of_candidates
from invdyn_cli.diagnosis.search.slopes import Slopes
from invdyn_cli.effects.composition import EffectInstance, channels
from invdyn_cli.effects.friction import STICK_TIME

STEPS = 4
"""Largest number of Newton steps: the columns' estimates are within a few percent."""

ROUNDING = 1e-12
"""Share of the loss by which rounding may raise it at its minimum, where a step of 1e-6 standard errors still has
digits."""

FACTORS = (0.6, 0.67, 0.75, 0.82, 0.9, 1.0, 1.1, 1.21, 1.33, 1.5, 1.7)
"""Sizes of a gear's play or stiffness that are tried, relative to the one from which it is refined."""

NEAR = 0.06
"""Relative difference up to which a size counts as one that was found in this way, and is not tried again."""

RECORDINGS = 3
"""Number of recordings from which on sizes are also compared between them: two do not show the scatter."""


def refine(
    evidence: Evidence,
    model: Model,
    acting: Sequence[EffectInstance],
    rows: np.ndarray,
    weights: np.ndarray,
    always: Sequence[Candidate] = (),
    steps: int = STEPS,
) -> Refined:
    """The parameters of least weighted squares on the chosen rows (R,) bool, from where they are.

    Friction that jumps has the time of its jump free, as in the search, and the columns of `always` have their
    coefficients; these are no parameters, and the residual is that without the latter.
    """
    theta, labels = flat(evidence, acting)
    if not acting and not always:
        return Refined((), theta, labels, (), np.zeros((0, 0)), model.residual(()))
    used = rows[:, None] & evidence.valid
    scale = np.sqrt(weights)[None, :] * used
    beside = Slopes.free(evidence, always).with_more(_timing(evidence, acting))
    known = np.full(beside.count, 1 / STICK_TIME**2)
    known[: sum(len(c.precision) for c in always)] = precision_of_candidates(always)
    theta, acting = _scanned(evidence, model, acting, theta, labels, scale, rows.sum(), beside, known)
    precision = np.concatenate([precision_of(evidence, acting, labels), known])
    first = beside.logged(evidence, acting).weighed(scale)
    extra = solved(first.normal(), first.moment(model.residual(acting) * scale), known)

    def left_by(extra: np.ndarray, there: Sequence[EffectInstance]) -> np.ndarray:
        return model.residual(there) - evidence.logged(there, beside.torque(extra)[None])[0]

    def weighed(theta: np.ndarray, extra: np.ndarray) -> tuple[float, np.ndarray]:
        left = left_by(extra, with_parameters(evidence, acting, labels, theta))
        return float(np.sum((left * scale) ** 2) + precision @ np.concatenate([theta, extra]) ** 2), left

    def squares(extra: np.ndarray, there: Sequence[EffectInstance]) -> np.ndarray:
        return np.sum((left_by(extra, there) * scale) ** 2, axis=1)

    gears = np.array([acting[n].effect.yields for n, *_ in labels] + [False] * len(extra))
    edges = np.array([name in EDGES for _, name, _ in labels] + [False] * len(extra))
    ways = [~(g & gears | e & edges) for e in {False, bool(edges.any())} for g in {False, bool(gears.any())}]
    loss, left = weighed(theta, extra)
    for _ in range(steps):
        if edges.any():
            timed = summed(evidence, acting, partial(squares, extra))
            at = flat(evidence, timed)[0]
            if (after := weighed(at, extra))[0] < loss:
                theta, acting, (loss, left) = at, timed, after
        slopes = _jacobian(evidence, model, acting, theta, labels, beside, extra)
        x = slopes.weighed(scale)
        normal, moment = x.normal(), x.moment(left * scale) - precision * np.concatenate([theta, extra])
        for free in ways:  # slopes of a gear or an edge may lead astray, and the others with them
            move = np.zeros(len(free))
            move[free] = solved(normal[np.ix_(free, free)], moment[free], precision[free])
            near = within(acting, labels, move[: len(theta)])
            there = inside(evidence, acting, labels, theta + near), extra + move[len(theta) :]
            after = weighed(*there)
            if after[0] < loss:
                break
        arrived = not after[0] < loss
        if arrived and after[0] > loss * (1 + ROUNDING):
            break
        (theta, extra), (loss, left) = there, after  # the last step, too small for the loss, is right in its digits
        acting = with_parameters(evidence, acting, labels, theta)
        if arrived:
            break
    model.scanned |= {
        (*acting[n].key, rows.sum()): theta[i] for i, (n, *_) in enumerate(labels) if acting[n].effect.yields
    }
    spread = _spread(evidence, model, acting, theta, labels, extra, beside, precision, scale, rows, left)
    allowed = extra[: sum(len(c.precision) for c in always)]
    refined = Refined(tuple(acting), theta, labels, *spread, left, tuple(always), allowed)
    return replace(refined, residual=model.without(refined, acting))


def _scanned(evidence: Evidence, model: Model, acting, theta, labels, scale, rows: int, beside, precision):
    """Parameters and effects with each gear at the best of a few sizes, unless one of these was it before: flanks meet
    or do not, and slopes say little of what comes next. The coefficients of `beside` are fitted with each."""
    new = [
        i
        for i, (number, *_) in enumerate(labels)
        if acting[number].effect.yields
        and abs(theta[i] / model.scanned.get((*acting[number].key, rows), np.inf) - 1) > NEAR
    ]
    if not new:
        return theta, acting
    x = beside.weighed(scale)
    normal = x.normal()

    def left(there: Sequence[EffectInstance]) -> float:
        y = model.residual(there) * scale
        return float(np.sum((y - x.torque(solved(normal, x.moment(y), precision))) ** 2))

    for i in new:
        tried = []
        for factor in FACTORS:
            one = theta.copy()
            one[i] *= factor
            there = with_parameters(evidence, acting, labels, one)
            tried.append((left(there), one, there))
        _, theta, acting = min(tried, key=lambda x: x[0])
    return theta, acting


def _spread(evidence, model, acting, theta, labels, extra, beside, precision, scale, rows, residual):
    """`replicas` and `unknown` of what was refined, and leaves this `residual` (R, n)."""
    slopes = _jacobian(evidence, model, acting, theta, labels, beside, extra)
    blocks = np.unique(evidence.block[rows])
    normals, moments = [], []
    for b in blocks:
        at = np.flatnonzero(rows & (evidence.block == b))
        x = slopes.weighed(scale, at)
        normals.append(x.normal())
        moments.append(x.moment(residual[at] * scale[at]))
    normal, moment = np.array(normals), np.array(moments)
    centre, replicas = solved(normal.sum(0), moment.sum(0), precision), []
    recording = evidence.trajectory[[np.argmax(evidence.block == b) for b in blocks]]
    for numbers in [blocks, recording] if len(np.unique(recording)) >= RECORDINGS else [blocks]:
        # summed anew: of what is in one alone a difference leaves rounding
        others = [numbers != k for k in np.unique(numbers)]
        moves = [solved(normal[o].sum(0), moment[o].sum(0), precision) - centre for o in others]
        replicas.append(theta + np.array(moves)[:, : len(theta)])
    return tuple(replicas), inverse_root(normal.sum(0), precision).T[:, : len(theta)]


def moved(evidence: Evidence, model: Model, refined: Refined, move: np.ndarray) -> Refined:
    """The same with parameters moved by (k,), as far as they are physics, replicas and all; windows stay."""
    move = np.where([name in EDGES for _, name, _ in refined.labels], 0.0, move)
    theta = inside(evidence, refined.acting, refined.labels, refined.theta + move)
    acting = with_parameters(evidence, refined.acting, refined.labels, theta)
    residual = refined.residual + model.residual(acting) - model.residual(refined.acting)
    replicas = tuple(x + (theta - refined.theta) for x in refined.replicas)
    return replace(refined, acting=acting, theta=theta, replicas=replicas, residual=residual)


def _jacobian(evidence: Evidence, model: Model, acting, theta, labels, beside: Slopes, extra) -> Slopes:
    """Change of the modelled torque with each parameter (k,), and with each coefficient `extra` (m,) of what is free
    `beside` these."""
    before, behind = [], []  # what was made before the channel, and what is logged
    residual, free = model.residual(acting), beside.torque(extra)[None]
    logged = evidence.logged(acting, free)[0]
    for i, (number, name, index) in enumerate(labels):
        a = acting[number]
        if not name and a.when is not None:
            if index == 0:
                passing = passing_columns(evidence, a.effect, a.joint, a.when, a.parameters)
            before += _parts(i, passing[index])
            continue
        if not name:  # torque is linear in a body's coordinates, and its columns are there already
            columns = next(c.columns for c in evidence.candidates if c.key == (a.effect.name, a.joint))
            before += [(i, j, evidence.tables[j][:, free[index]]) for j, (_, free) in columns.items()]
            continue
        kind, rate = kind_of(a.effect), evidence.recording.filter.rate
        step = 1 / rate if name in EDGES else kind.step(a.effect, name, theta[i])
        moved = theta.copy()
        moved[i] += step
        there = with_parameters(evidence, acting, labels, moved)
        others = [x for x in acting if x is not a and x.effect.reaches_others]
        slope = kind.slope(evidence, a.effect, a.joint, a.parameters, there[number].parameters, others)
        if slope is not None:
            before += _parts(i, slope / step)
        elif name in EDGES and a.effect.reaches_others:
            factors = np.array(coordinates(evidence, a))
            ends = [passing_torque(evidence, x, factors) for x in (there[number], a)]
            change = filtered(evidence.recording, [x - y for x, y in zip(*ends, strict=True)])
            before += _parts(i, change / step)
        else:
            change = residual - model.residual(there)
            if channels([a]) and free.any():
                change += evidence.logged(there, free)[0] - logged
            behind += _parts(i, change.T / step)
    made = Slopes.of(evidence, len(labels), before).with_more(beside).logged(evidence, acting)
    return made.and_of(Slopes.of(evidence, made.count, behind))


def _parts(number: int, change: np.ndarray) -> Iterator[tuple[int, int, np.ndarray]]:
    """What a coefficient changes (n, R), joint by joint."""
    return ((number, j, x) for j, x in enumerate(change) if x.any())


def _timing(evidence: Evidence, acting: Sequence[EffectInstance]) -> Slopes:
    """What shifts the jump of each dry friction."""
    parts = [part for a in acting if a.effect.jumps for part in reversal_columns(evidence, a)]
    made = [(i, j, column) for i, part in enumerate(parts) for j, column in part.items()]
    return Slopes.of(evidence, len(parts), made)
