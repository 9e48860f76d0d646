"""The composed model compared with the record: all parameters of a hypothesis are refined together, with the exact
formulas of the effects.

The hypothesis was chosen with linear columns; here a gain scales the friction behind it, a payload changes the load of
the gear, and nothing is linearised. A few Gauss-Newton steps with numerical derivatives.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from invdyn_cli.diagnosis.columns.candidates import kind_of, passing_columns, passing_torque
from invdyn_cli.diagnosis.columns.evidence import Candidate, Evidence, filtered
from invdyn_cli.diagnosis.columns.joint_torques import reversal_columns
from invdyn_cli.diagnosis.search.coordinates import EDGES, coordinates, flat, inside, precision_of, with_parameters
from invdyn_cli.diagnosis.search.edges import summed, within
from invdyn_cli.diagnosis.search.equations import LEAST_PRECISION, solved
from invdyn_cli.diagnosis.search.judge import Hypothesis
from invdyn_cli.effects.composition import (
    EffectInstance,
    channel,
    channels,
    delivered,
    identity,
    joint_terms,
    link_torque,
    shares,
)
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

MOTIONS = 40
"""Number of link motions behind gears that are cached for every piece, so that a change of one gear does not empty the
cache."""


@dataclass(frozen=True)
class Refined:
    """Effects with refined parameters, what each moves by, and the residual that they leave.

    Attributes:
        acting: the effects.
        theta: (k,) all parameters in one row; `labels` (effect number, parameter, index) says which.
        replicas: parameters (B, k) with one block left out each, and (B, k) with one recording where there are some:
            their spread is the uncertainty (jackknife).
        unknown: (m, k) independent moves of the parameters by a standard error each, from the noise alone and what was
            known beforehand: what the data do not show moves as far as it may.
        residual: (R, n) logged less modelled torque, filtered, without what is allowed for.
        allowed: (m,) coefficients of what is allowed for, `always`.
    """

    acting: tuple[EffectInstance, ...]
    theta: np.ndarray
    labels: tuple[tuple[int, str, int], ...]
    replicas: tuple[np.ndarray, ...]
    unknown: np.ndarray
    residual: np.ndarray
    always: Hypothesis = ()
    allowed: np.ndarray = field(default_factory=lambda: np.zeros(0))


class Model:
    """The residual of composed effects on all rows of the evidence; torques of bodies are cached while the bodies stay
    the same."""

    def __init__(self, evidence: Evidence) -> None:
        self.evidence = evidence
        self.rate = evidence.recording.filter.rate
        self._base = evidence.base or [np.zeros_like(p.q) for p in evidence.recording.pieces]
        self._bodies: dict[tuple, list[np.ndarray]] = {}
        self._rows: dict[tuple, np.ndarray] = {}
        self._gears: list[dict] = [{} for _ in evidence.recording.pieces]
        self.scanned: dict[tuple, float] = {}
        """The last refined value of each gear, by its key and the number of rows, from distant and near start
        values."""

    def residual(self, acting: Sequence[EffectInstance]) -> np.ndarray:
        """(R, n) [N m; N] logged torque (with its channel inverted) minus modelled torque."""
        bodies = self._moved(acting)
        out = np.column_stack([self._row(acting, bodies, j) for j in range(self.evidence.dofs)])
        compared = self.evidence.reference_rows
        if compared is not None and len(acting):  # what was hidden since is not in the reference
            out[compared] = self.residual(())[compared]
        return out

    def without(self, refined: Refined, acting: Sequence[EffectInstance]) -> np.ndarray:
        """(R, n) the residual with these effects instead of the refined ones; the effects that are allowed for stay the
        same."""
        return self.residual(acting) - self.allowed(refined, acting)

    def allowed(self, refined: Refined, acting: Sequence[EffectInstance], count: int | None = None) -> np.ndarray:
        """(R, n) logged torque of what is allowed for, or of the last `count` coefficients of it, where these effects
        act."""
        theta = refined.allowed.copy()
        theta[: 0 if count is None else len(theta) - count] = 0.0
        torque = np.tensordot(theta, _allowed(self.evidence, refined.always)[0], 1)
        return self.evidence.logged(acting, torque[None])[0]

    def _moved(self, acting: Sequence[EffectInstance]) -> tuple:
        """The key of the inverse dynamics (n, T) of every piece with the effects that reach more than one joint, which
        are there. What comes and goes adds to that of the nominal motion, its columns being at hand; but a gear yields
        to it."""
        whole = [a for a in acting if a.effect.reaches_others]
        key = identity(whole)
        if key not in self._bodies:
            if len(self._bodies) > 40:
                self._bodies.clear()
            lasting = [a for a in whole if a.when is None]
            if lasting == whole or any(a.effect.yields for a in whole):
                robot, recording = self.evidence.robot, self.evidence.recording
                made = []
                for piece, kept, base in zip(recording.pieces, self._gears, self._base, strict=True):
                    if len(kept) > MOTIONS:
                        kept.clear()
                    made.append(base + link_torque(robot, whole, piece.motion, recording.stretch(piece), kept))
            else:
                made = self._bodies[self._moved(lasting)]
                for one in whole:
                    if one.when is not None:
                        torques = passing_torque(self.evidence, one, np.array(coordinates(self.evidence, one)))
                        made = [body + x for body, x in zip(made, torques, strict=True)]
            self._bodies[key] = made
        return key

    def _row(self, acting: Sequence[EffectInstance], bodies: tuple, j: int) -> np.ndarray:
        own = self._own(acting, j)
        key = (bodies, j, identity(own))
        if key not in self._rows:
            if len(self._rows) > 400:
                self._rows.clear()
            self._rows[key] = filtered(self.evidence.recording, self._parts(own, bodies, j), j)
        return self._rows[key]

    def unfiltered(self, acting: Sequence[EffectInstance], j: int) -> list[np.ndarray]:
        """A joint's residual (T,) in every piece before the filter."""
        return self._parts(self._own(acting, j), self._moved(acting), j)

    def _own(self, acting: Sequence[EffectInstance], joint: int) -> list[EffectInstance]:
        """The torque and channel effects that act on a joint."""
        parents = self.evidence.robot.parents
        return [a for a in acting if not a.effect.reaches_others and joint in shares(a, parents)]

    def _parts(self, own: Sequence[EffectInstance], bodies: tuple, j: int) -> list[np.ndarray]:
        parts = []
        pieces, moved = self.evidence.recording.pieces, self._bodies[bodies]
        back = [a for a in own if a.effect.invertible]
        forth = [a for a in own if not a.effect.invertible]
        for piece, states, body, base in zip(pieces, self.evidence.states, moved, self._base, strict=True):
            loaded = [s._replace(transmitted=x) for s, x in zip(states, body - base, strict=True)]
            tau = body[j] + sum(joint_terms(own, j, loaded, self.evidence.robot.parents))
            tau = np.asarray(channel(back, j, tau, self.evidence.recording.stretch(piece)))
            parts.append(delivered(forth, j, piece.tau[j], self.rate) - tau)
        return parts


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
    beside = [np.concatenate(x) for x in zip(_allowed(evidence, always), _timing(evidence, acting), strict=True)]
    timing, timing_precision = beside
    theta, acting = _scanned(evidence, model, acting, theta, labels, scale, rows.sum(), *beside)
    precision = np.concatenate([precision_of(evidence, acting, labels), timing_precision])
    extra = _fitted(model.residual(acting), evidence.logged(acting, timing), scale, timing_precision)

    def left_by(extra: np.ndarray, there: Sequence[EffectInstance]) -> np.ndarray:
        return model.residual(there) - evidence.logged(there, np.tensordot(extra, timing, 1)[None])[0]

    def weighed(theta: np.ndarray, extra: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        left = left_by(extra, with_parameters(evidence, acting, labels, theta))
        y = (left * scale).ravel()
        return float(y @ y + precision @ np.concatenate([theta, extra]) ** 2), left, y

    def squares(extra: np.ndarray, there: Sequence[EffectInstance]) -> np.ndarray:
        return np.sum((left_by(extra, there) * scale) ** 2, axis=1)

    gears = np.array([acting[n].effect.yields for n, *_ in labels] + [False] * len(extra))
    edges = np.array([name in EDGES for _, name, _ in labels] + [False] * len(extra))
    ways = [~(g & gears | e & edges) for e in {False, bool(edges.any())} for g in {False, bool(gears.any())}]
    loss, left, y = weighed(theta, extra)
    for _ in range(steps):
        if edges.any():
            timed = summed(evidence, acting, partial(squares, extra))
            at = flat(evidence, timed)[0]
            if (after := weighed(at, extra))[0] < loss:
                theta, acting, (loss, left, y) = at, timed, after
        slopes = _jacobian(evidence, model, acting, theta, labels, timing, extra)
        x = (slopes * scale).reshape(len(slopes), -1)
        normal, moment = x @ x.T, x @ y - precision * np.concatenate([theta, extra])
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
        (theta, extra), (loss, left, y) = there, after  # the last step, too small for the loss, is right in its digits
        acting = with_parameters(evidence, acting, labels, theta)
        if arrived:
            break
    model.scanned |= {
        (*acting[n].key, rows.sum()): theta[i] for i, (n, *_) in enumerate(labels) if acting[n].effect.yields
    }
    spread = _spread(evidence, model, acting, theta, labels, extra, timing, precision, scale, rows, left)
    allowed = extra[: sum(len(c.precision) for c in always)]
    refined = Refined(tuple(acting), theta, labels, *spread, left, tuple(always), allowed)
    return replace(refined, residual=model.without(refined, acting))


def _fitted(residual: np.ndarray, columns: np.ndarray, scale: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """Coefficients (m,) of free columns (m, R, n) beside a residual (R, n), rows weighted by `scale` (R, n)."""
    x = (columns * scale).reshape(-1, scale.size)
    return solved(x @ x.T, x @ (residual * scale).ravel(), precision)


def _scanned(evidence: Evidence, model: Model, acting, theta, labels, scale, rows: int, columns, precision):
    """Parameters and effects with each gear at the best of a few sizes, unless one of these was it before: flanks meet
    or do not, and slopes say little of what comes next. Free `columns` are fitted beside each."""
    new = [
        i
        for i, (number, *_) in enumerate(labels)
        if acting[number].effect.yields
        and abs(theta[i] / model.scanned.get((*acting[number].key, rows), np.inf) - 1) > NEAR
    ]

    x = (columns[: len(columns) if new else 0] * scale).reshape(-1, scale.size)
    normal = x @ x.T

    def left(there: Sequence[EffectInstance]) -> float:
        y = (model.residual(there) * scale).ravel()
        return float(np.sum((y - solved(normal, x @ y, precision[: len(x)]) @ x) ** 2))

    for i in new:
        tried = []
        for factor in FACTORS:
            one = theta.copy()
            one[i] *= factor
            there = with_parameters(evidence, acting, labels, one)
            tried.append((left(there), one, there))
        _, theta, acting = min(tried, key=lambda x: x[0])
    return theta, acting


def _spread(evidence, model, acting, theta, labels, extra, timing, precision, scale, rows, residual):
    """`replicas` and `unknown` of what was refined, and leaves this `residual` (R, n)."""
    slopes = _jacobian(evidence, model, acting, theta, labels, timing, extra)
    blocks = np.unique(evidence.block[rows])
    normals, moments = [], []
    for b in blocks:
        at = rows & (evidence.block == b)
        x = (slopes[:, at] * scale[at]).reshape(len(slopes), -1)
        normals.append(x @ x.T)
        moments.append(x @ (residual[at] * scale[at]).ravel())
    normal, moment = np.array(normals), np.array(moments)
    centre, replicas = solved(normal.sum(0), moment.sum(0), precision), []
    recording = evidence.trajectory[[np.argmax(evidence.block == b) for b in blocks]]
    for numbers in [blocks, recording] if len(np.unique(recording)) >= RECORDINGS else [blocks]:
        others = [
            numbers != k for k in np.unique(numbers)
        ]  # summed anew: of what is in one alone a difference leaves rounding
        moves = [solved(normal[o].sum(0), moment[o].sum(0), precision) - centre for o in others]
        replicas.append(theta + np.array(moves)[:, : len(theta)])
    curvature = normal.sum(0) + np.diag(precision)
    unit = np.sqrt(np.maximum(np.diag(curvature), 1e-300))
    values, vectors = np.linalg.eigh(curvature / np.outer(unit, unit))
    unknown = (vectors / np.sqrt(np.maximum(values, LEAST_PRECISION)) / unit[:, None]).T
    return tuple(replicas), unknown[:, : len(theta)]


def moved(evidence: Evidence, model: Model, refined: Refined, move: np.ndarray) -> Refined:
    """The same with parameters moved by (k,), as far as they are physics, replicas and all; windows stay."""
    move = np.where([name in EDGES for _, name, _ in refined.labels], 0.0, move)
    theta = inside(evidence, refined.acting, refined.labels, refined.theta + move)
    acting = with_parameters(evidence, refined.acting, refined.labels, theta)
    residual = refined.residual + model.residual(acting) - model.residual(refined.acting)
    replicas = tuple(x + (theta - refined.theta) for x in refined.replicas)
    return replace(refined, acting=acting, theta=theta, replicas=replicas, residual=residual)


def _jacobian(evidence: Evidence, model: Model, acting, theta, labels, timing, extra) -> np.ndarray:
    """(k + m, R, n): change of the modelled torque with each parameter, and with each coefficient `extra` (m,) of the
    free columns `timing` (m, R, n)."""
    out = np.zeros((len(theta), *evidence.tau.shape))
    residual, beside = model.residual(acting), np.tensordot(extra, timing, 1)[None]
    behind = evidence.logged(acting, beside)[0]
    unlogged = []  # what was made before the channel
    for i, (number, name, index) in enumerate(labels):
        a = acting[number]
        if not name and a.when is not None:
            if index == 0:
                passing = passing_columns(evidence, a.effect, a.joint, a.when)
            out[i] = passing[index].T
            unlogged.append(i)
            continue
        if not name:  # torque is linear in a body's coordinates, and its columns are there already
            columns = next(c.columns for c in evidence.candidates if c.key == (a.effect.name, a.joint))
            for j, (_, free) in columns.items():
                out[i, :, j] = evidence.tables[j][:, free[index]]
            unlogged.append(i)
            continue
        kind, rate = kind_of(a.effect), evidence.recording.filter.rate
        step = 1 / rate if name in EDGES else kind.step(a.effect, name, theta[i])
        moved = theta.copy()
        moved[i] += step
        there = with_parameters(evidence, acting, labels, moved)
        others = [x for x in acting if x is not a and x.effect.reaches_others]
        slope = kind.slope(evidence, a.effect, a.joint, a.parameters, there[number].parameters, others)
        if slope is not None:
            out[i] = (slope / step).T
            unlogged.append(i)
        elif name in EDGES and a.effect.reaches_others:
            factors = np.array(coordinates(evidence, a))
            ends = [passing_torque(evidence, x, factors) for x in (there[number], a)]
            change = filtered(evidence.recording, [x - y for x, y in zip(*ends, strict=True)])
            out[i] = (change / step).T
            unlogged.append(i)
        else:
            out[i] = (residual - model.residual(there)) / step
            if channels([a]) and beside.any():
                out[i] += (evidence.logged(there, beside)[0] - behind) / step
    out[unlogged] = evidence.logged(acting, out[unlogged])
    return np.concatenate([out, evidence.logged(acting, timing)])


def _allowed(evidence: Evidence, always: Sequence[Candidate]) -> tuple[np.ndarray, np.ndarray]:
    """Columns (m, R, n) of the effects that are allowed for, and their precision (m,)."""
    columns = np.zeros((sum(len(c.precision) for c in always), *evidence.tau.shape))
    start = 0
    for c in always:
        for j, (_, free) in c.columns.items():
            columns[start : start + len(free), :, j] = evidence.tables[j][:, list(free)].T
        start += len(c.precision)
    return columns, np.concatenate([c.precision for c in always]) if always else np.zeros(0)


def _timing(evidence: Evidence, acting: Sequence[EffectInstance]) -> tuple[np.ndarray, np.ndarray]:
    """Columns (m, R, n) that shift the jump of each dry friction, and their precision (m,)."""
    columns, precision = [], []
    for a in acting:
        if not a.effect.jumps:
            continue
        for part in reversal_columns(evidence, a):
            column = np.zeros(evidence.tau.shape)
            for j, own in part.items():
                column[:, j] = own
            columns.append(column)
            precision.append(1 / STICK_TIME**2)
    return np.array(columns).reshape(len(columns), *evidence.tau.shape), np.array(precision)
