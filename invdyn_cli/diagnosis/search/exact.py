"""The composed model against the record: all parameters of a hypothesis refined together, by the effects' formulas.

Linear columns chose the hypothesis; here a gain scales the friction behind it, a payload changes the load of the gear,
and nothing is straightened any more. Gauss and Newton's steps with numerical slopes, a few times.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from invdyn_cli.diagnosis.columns.candidates import beforehand, gear_columns, passing_columns, passing_torque
from invdyn_cli.diagnosis.columns.evidence import DRY, STICK_TIME, Candidate, Evidence, filtered
from invdyn_cli.diagnosis.search.equations import LEAST_PRECISION, solved
from invdyn_cli.diagnosis.search.steps import WHOLE
from invdyn_cli.effects.composition import Acting, channel, felt_by, identity, joint_terms, link_torque
from invdyn_cli.interfaces import (
    AbstractBodyEffect,
    AbstractChannelEffect,
    AbstractForceEffect,
    AbstractGearEffect,
    AbstractTorqueEffect,
)

STEPS = 4
"""Newton steps at most: columns start within a few percent."""


FACTORS = (0.6, 0.67, 0.75, 0.82, 0.9, 1.0, 1.1, 1.21, 1.33, 1.5, 1.7)
"""Sizes that are tried of a gear's play or stiffness, over the one from where it is refined."""

NEAR = 0.06
"""Share of it by which it differs from one that was found like that, and is not tried again."""

MOTIONS = 40
"""Of links behind gears that are kept of every piece, so that one gear more or less is not all of them."""

EDGES = ("start", "end")
"""Coordinates of a window [s]."""


@dataclass(frozen=True)
class Refined:
    """Effects with refined parameters, what each moves by, and the residual that they leave.

    Attributes:
        acting: the effects.
        theta: (k,) all parameters in one row; `labels` (effect number, parameter, index) says which.
        replicas: (B, k) parameters with one block left out each: their spread is the uncertainty (jackknife).
        unknown: (m, k) independent moves of the parameters by a standard error each, from the noise alone and what was
            known beforehand: what the data do not show moves as far as it may.
        residual: (R, n) logged less modelled torque, filtered, without what is allowed for.
        allowed: (m,) coefficients of what is allowed for.
    """

    acting: tuple[Acting, ...]
    theta: np.ndarray
    labels: tuple[tuple[int, str, int], ...]
    replicas: np.ndarray
    unknown: np.ndarray
    residual: np.ndarray
    allowed: np.ndarray = field(default_factory=lambda: np.zeros(0))


class Model:
    """The residual of composed effects on all rows of the evidence; body torques are kept while bodies stay."""

    def __init__(self, evidence: Evidence) -> None:
        self.evidence = evidence
        self.rate = evidence.recording.filter.rate
        self._bodies: dict[tuple, list[np.ndarray]] = {}
        self._rows: dict[tuple, np.ndarray] = {}
        self._gears: list[dict] = [{} for _ in evidence.recording.pieces]
        self.scanned: dict[tuple, float] = {}
        """What each gear, by its key and the number of rows, was last refined to, from sizes far and near."""

    def residual(self, acting: Sequence[Acting]) -> np.ndarray:
        """(R, n) [N m; N] logged (its channel undone) less modelled torque."""
        bodies = self._moved(acting)
        out = np.column_stack([self._row(acting, bodies, j) for j in range(self.evidence.dofs)])
        compared = self.evidence.reference_rows
        if compared is not None and len(acting):  # what was hidden since is not in the reference
            out[compared] = self.residual(())[compared]
        return out

    def _moved(self, acting: Sequence[Acting]) -> tuple:
        """The key of the inverse dynamics (n, T) of every piece with the effects that reach more than one joint, which
        are there. What comes and goes adds to that of the nominal motion, its columns being at hand; but a gear yields
        to it."""
        whole = [a for a in acting if a.effect.point in WHOLE]
        key = identity(whole)
        if key not in self._bodies:
            if len(self._bodies) > 40:
                self._bodies.clear()
            lasting = [a for a in whole if a.when is None]
            if lasting == whole or any(a.effect.point == "gear" for a in whole):
                robot, recording = self.evidence.robot, self.evidence.recording
                made = []
                for piece, kept in zip(recording.pieces, self._gears, strict=True):
                    if len(kept) > MOTIONS:
                        kept.clear()
                    made.append(link_torque(robot, whole, piece.motion, recording.stretch(piece), kept))
            else:
                made = self._bodies[self._moved(lasting)]
                for one in whole:
                    if one.when is not None:
                        torques = passing_torque(self.evidence, one, np.array(coordinates(self.evidence, one)))
                        made = [body + x for body, x in zip(made, torques, strict=True)]
            self._bodies[key] = made
        return key

    def _row(self, acting: Sequence[Acting], bodies: tuple, j: int) -> np.ndarray:
        own = self._own(acting, j)
        key = (bodies, j, identity(own))
        if key not in self._rows:
            if len(self._rows) > 400:
                self._rows.clear()
            self._rows[key] = filtered(self.evidence.recording, self._parts(own, bodies, j), j)
        return self._rows[key]

    def unfiltered(self, acting: Sequence[Acting], j: int) -> list[np.ndarray]:
        """A joint's residual (T,) in every piece, as it is before the filter."""
        return self._parts(self._own(acting, j), self._moved(acting), j)

    def _own(self, acting: Sequence[Acting], joint: int) -> list[Acting]:
        """The torque and channel effects that a joint feels."""
        parents = self.evidence.robot.parents
        return [a for a in acting if a.effect.point in ("torque", "channel") and joint in felt_by(a, parents)]

    def _parts(self, own: Sequence[Acting], bodies: tuple, j: int) -> list[np.ndarray]:
        parts = []
        pieces, moved = self.evidence.recording.pieces, self._bodies[bodies]
        for piece, states, body in zip(pieces, self.evidence.states, moved, strict=True):
            loaded = [s._replace(transmitted=x) for s, x in zip(states, body, strict=True)]
            tau = body[j] + sum(joint_terms(own, j, loaded, self.evidence.robot.parents))
            logged = piece.tau[j]
            for a in own:
                if not isinstance(a.effect, AbstractChannelEffect):
                    continue
                if a.effect.name == "torque_saturation":  # what was asked for beyond the limit, no model can know
                    logged = a.effect.delivered(a.parameters, logged, self.rate)
                else:
                    tau = np.asarray(channel([a], j, tau, self.evidence.recording.stretch(piece)))
            parts.append(logged - tau)
        return parts


def refine(
    evidence: Evidence,
    model: Model,
    acting: Sequence[Acting],
    rows: np.ndarray,
    weights: np.ndarray,
    always: Sequence[Candidate] = (),
    steps: int = STEPS,
) -> Refined:
    """The parameters of least weighted squares on the chosen rows (R,) bool, from where they are.

    Friction that jumps has the time of its jump free, as in the search, and so have the columns of `always`; they have
    no parameter, and the residual is that without the latter.
    """
    theta, labels = _flat(evidence, acting)
    if not acting and not always:
        return Refined((), theta, labels, np.zeros((2, 0)), np.zeros((0, 0)), model.residual(()))
    used = rows[:, None] & evidence.valid
    scale = np.sqrt(weights)[None, :] * used
    theta, acting = _scanned(evidence, model, acting, theta, labels, scale, rows.sum())
    timing, timing_precision = _timing(evidence, acting)
    allowed, allowed_precision = _allowed(evidence, always)
    timing = np.concatenate([allowed, timing])
    timing_precision = np.concatenate([allowed_precision, timing_precision])
    precision = np.concatenate([precision_of(evidence, acting, labels), timing_precision])
    extra = np.zeros(len(timing))

    def weighed(theta: np.ndarray, extra: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        residual = model.residual(with_parameters(evidence, acting, labels, theta))
        y = ((residual - np.tensordot(extra, timing, 1)) * scale).ravel()
        return float(y @ y + precision @ np.concatenate([theta, extra]) ** 2), residual, y

    gears = np.array([acting[n].effect.point == "gear" for n, *_ in labels] + [False] * len(extra))
    loss, residual, y = weighed(theta, extra)
    for _ in range(steps):
        slopes = np.concatenate([_jacobian(evidence, model, acting, theta, labels, residual), timing])
        x = (slopes * scale).reshape(len(slopes), -1)
        normal, moment = x @ x.T, x @ y - precision * np.concatenate([theta, extra])
        for free in (np.ones_like(gears), ~gears):  # a gear's slope may lead astray, and the others with it
            move = np.zeros(len(free))
            move[free] = solved(normal[np.ix_(free, free)], moment[free], precision[free])
            there = _inside(evidence, acting, labels, theta + move[: len(theta)]), extra + move[len(theta) :]
            after = weighed(*there)
            if after[0] < loss or not gears.any():
                break
        if not after[0] < loss:
            break
        (theta, extra), (loss, residual, y) = there, after
        acting = with_parameters(evidence, acting, labels, theta)
    model.scanned |= {
        (*acting[n].key, rows.sum()): theta[i] for i, (n, *_) in enumerate(labels) if acting[n].effect.point == "gear"
    }
    spread = _spread(evidence, model, acting, theta, labels, extra, timing, precision, scale, rows, residual)
    left = residual - np.tensordot(extra[: len(allowed)], allowed, 1)
    return Refined(tuple(acting), theta, labels, *spread, left, extra[: len(allowed)])


def _scanned(evidence: Evidence, model: Model, acting: Sequence[Acting], theta, labels, scale, rows: int):
    """Parameters and effects with each gear at the best of a few sizes, unless one of these was it before: flanks meet
    or do not, and slopes say little of what comes next."""
    for i, (number, *_) in enumerate(labels):
        before = model.scanned.get((*acting[number].key, rows), np.inf)
        if acting[number].effect.point == "gear" and abs(theta[i] / before - 1) > NEAR:
            tried = []
            for factor in FACTORS:
                one = theta.copy()
                one[i] *= factor
                there = with_parameters(evidence, acting, labels, one)
                tried.append((float(np.sum((model.residual(there) * scale) ** 2)), one, there))
            _, theta, acting = min(tried, key=lambda x: x[0])
    return theta, acting


def _spread(evidence, model, acting, theta, labels, extra, timing, precision, scale, rows, residual):
    """`replicas` and `unknown` of what was refined."""
    slopes = np.concatenate([_jacobian(evidence, model, acting, theta, labels, residual), timing])
    residual = residual - np.tensordot(extra, timing, 1)
    blocks = np.unique(evidence.block[rows])
    normals, moments = [], []
    for b in blocks:
        at = rows & (evidence.block == b)
        x = (slopes[:, at] * scale[at]).reshape(len(slopes), -1)
        normals.append(x @ x.T)
        moments.append(x @ (residual[at] * scale[at]).ravel())
    normal, moment = np.array(normals), np.array(moments)
    centre = solved(normal.sum(0), moment.sum(0), precision)
    others = ~np.eye(len(blocks), dtype=bool)  # summed anew: of what is in one block alone a difference leaves rounding
    moves = [solved(normal[o].sum(0), moment[o].sum(0), precision) - centre for o in others]
    curvature = normal.sum(0) + np.diag(precision)
    unit = np.sqrt(np.maximum(np.diag(curvature), 1e-300))
    values, vectors = np.linalg.eigh(curvature / np.outer(unit, unit))
    unknown = (vectors / np.sqrt(np.maximum(values, LEAST_PRECISION)) / unit[:, None]).T
    return theta + np.array(moves)[:, : len(theta)], unknown[:, : len(theta)]


def moved(evidence: Evidence, model: Model, refined: Refined, move: np.ndarray) -> Refined:
    """The same with parameters moved by (k,), as far as they are physics, replicas and all; windows stay."""
    move = np.where([name in EDGES for _, name, _ in refined.labels], 0.0, move)
    theta = _inside(evidence, refined.acting, refined.labels, refined.theta + move)
    acting = with_parameters(evidence, refined.acting, refined.labels, theta)
    residual = refined.residual + model.residual(acting) - model.residual(refined.acting)
    there = refined.replicas + (theta - refined.theta)
    return replace(refined, acting=acting, theta=theta, replicas=there, residual=residual)


def _jacobian(evidence: Evidence, model: Model, acting, theta, labels, residual) -> np.ndarray:
    """(k, R, n): change of the modelled torque with each parameter; what reaches more than a joint as it is before the
    channel, but for gains: a delay or a lag changes its slopes by some percent, and not where they lead."""
    out = np.zeros((len(theta), *residual.shape))
    gains = np.ones(evidence.dofs)
    for a in acting:
        if a.effect.name == "torque_gain_error":
            gains[a.joint] /= a.parameters["gain"]
    for i, (number, name, index) in enumerate(labels):
        a = acting[number]
        if not name and a.when is not None:
            if index == 0:
                passing = passing_columns(evidence, a.effect, a.joint, a.when)
            out[i] = (gains[:, None] * passing[index]).T
            continue
        if not name:  # torque is linear in a body's coordinates, and its columns are there already
            columns = next(c.columns for c in evidence.candidates if c.key == (a.effect.name, a.joint))
            for j, (_, free) in columns.items():
                out[i, :, j] = gains[j] * evidence.tables[j][:, free[index]]
            continue
        step = _step(a, name, theta[i], evidence.recording.filter.rate)
        moved = theta.copy()
        moved[i] += step
        there = with_parameters(evidence, acting, labels, moved)
        if isinstance(a.effect, AbstractGearEffect):
            others = [x for x in acting if x is not a and x.effect.point in WHOLE]
            softer = a.effect.softness(there[number].parameters) - a.effect.softness(a.parameters)
            out[i] = (gains[:, None] * gear_columns(evidence, a, others)[1] * softer / step).T
        elif name in EDGES and a.effect.point in WHOLE:
            factors = np.array(coordinates(evidence, a))
            ends = [passing_torque(evidence, x, factors) for x in (there[number], a)]
            change = filtered(evidence.recording, [x - y for x, y in zip(*ends, strict=True)])
            out[i] = (gains[:, None] * change / step).T
        else:
            out[i] = (residual - model.residual(there)) / step
    return out


def _step(acting: Acting, name: str, value: float, rate: float) -> float:
    if name in EDGES:
        return 1 / rate
    if acting.effect.point == "gear":
        return max(3e-2 * value, 1e-6)
    if name in ("delay", "time_constant") and acting.effect.point == "channel":
        return 2e-4
    if acting.effect.point == "motion":
        return 1e-4
    if name in ("velocity", "stiffness"):
        return max(1e-2 * abs(value), 1e-6)
    return 1e-4 * max(abs(value), 1e-2)


def _allowed(evidence: Evidence, always: Sequence[Candidate]) -> tuple[np.ndarray, np.ndarray]:
    """Columns (m, R, n) of what is allowed for, and their precision (m,)."""
    columns = np.zeros((sum(len(c.precision) for c in always), *evidence.tau.shape))
    start = 0
    for c in always:
        for j, (_, free) in c.columns.items():
            columns[start : start + len(free), :, j] = evidence.tables[j][:, list(free)].T
        start += len(c.precision)
    return columns, np.concatenate([c.precision for c in always]) if always else np.zeros(0)


def _timing(evidence: Evidence, acting: Sequence[Acting]) -> tuple[np.ndarray, np.ndarray]:
    """Columns (m, R, n) that shift the jump of each dry friction, and their precision (m,)."""
    columns, precision = [], []
    for a in acting:
        if a.effect.name not in (*DRY, "asymmetric_coulomb_friction"):
            continue
        assert isinstance(a.effect, AbstractTorqueEffect) and a.joint is not None
        states = [s[a.joint] for s in evidence.states]
        terms = [np.asarray(a.effect.term(a.parameters, s)) for s in states]
        parts = [np.gradient(x) * evidence.recording.filter.rate for x in terms]
        column = np.zeros(evidence.tau.shape)
        for j in felt_by(a, evidence.robot.parents):
            assert j is not None
            share = 1.0 if j == a.joint else a.effect.share_on_driver(a.parameters)
            column[:, j] = share * filtered(evidence.recording, parts, j)
        columns.append(column)
        precision.append(1 / STICK_TIME**2)
    return np.array(columns).reshape(len(columns), *evidence.tau.shape), np.array(precision)


def _flat(evidence: Evidence, acting: Sequence[Acting]) -> tuple[np.ndarray, tuple[tuple[int, str, int], ...]]:
    """All coordinates in one row, and what each is: (effect number, parameter or "" for what torque is linear in,
    index)."""
    values, labels = [], []
    for number, a in enumerate(acting):
        row = coordinates(evidence, a)
        if row is not None:
            values += row
            labels += [(number, "", index) for index in range(len(row))]
        else:
            refined = {name: x for name, x in a.parameters.items() if name not in a.effect.chosen}
            values += [float(x) for x in refined.values()]
            labels += [(number, name, 0) for name in refined]
        if a.when is not None:
            values += [a.when.start, a.when.end]
            labels += [(number, name, 0) for name in EDGES]
    return np.array(values), tuple(labels)


def coordinates(evidence: Evidence, acting: Acting) -> list[float] | None:
    """What the torque is linear in, of bodies and forces."""
    if isinstance(acting.effect, AbstractBodyEffect):
        return acting.effect.coefficients(acting.parameters, evidence.robot, acting.joint)
    if isinstance(acting.effect, AbstractForceEffect):
        return acting.effect.coefficients(acting.parameters)
    return None


def with_parameters(evidence: Evidence, acting: Sequence[Acting], labels, theta: np.ndarray) -> tuple[Acting, ...]:
    """The effects with parameters from one row of coordinates."""
    made = []
    for number, a in enumerate(acting):
        own = {(name, index): x for (k, name, index), x in zip(labels, theta, strict=True) if k == number}
        linear = [x for (name, _), x in own.items() if not name]
        if a.when is not None:
            a = replace(a, when=a.when._replace(**{name: float(own[name, 0]) for name in EDGES}))
        if isinstance(a.effect, AbstractBodyEffect):
            made.append(replace(a, parameters=a.effect.read(linear, evidence.robot, a.joint)))
        elif isinstance(a.effect, AbstractForceEffect):
            made.append(replace(a, parameters=a.effect.read(linear)))
        else:
            refined = {name: float(x) for (name, _), x in own.items() if name not in EDGES}
            made.append(replace(a, parameters={**a.parameters, **refined}))
    return tuple(made)


def _inside(evidence: Evidence, acting: Sequence[Acting], labels, theta: np.ndarray) -> np.ndarray:
    """Parameters moved back to where they are physics at all, and windows to their trajectory."""
    lower, upper = np.full(len(theta), -np.inf), np.full(len(theta), np.inf)
    for i, (number, name, _) in enumerate(labels):
        a = acting[number]
        if name in EDGES and a.when is not None:
            times = [p.t[[0, -1]] for p in evidence.recording.pieces if p.trajectory == a.when.trajectory]
            lower[i], upper[i] = np.min(times), np.max(times)
        elif name in a.effect.parameters:
            lower[i], upper[i] = a.effect.parameters[name].lower, a.effect.parameters[name].upper
    return np.clip(theta, lower, upper)


def precision_of(evidence: Evidence, acting: Sequence[Acting], labels) -> np.ndarray:
    """What is known of coordinates beforehand: what the data do not show of a body or a force stays near zero."""
    out = np.zeros(len(labels))
    for number, a in enumerate(acting):
        own = [k for k, (of, name, _) in enumerate(labels) if of == number and not name]
        if own:
            out[own] = beforehand(evidence.robot, a.effect, a.joint, len(own))
    return out
