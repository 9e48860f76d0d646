"""Candidates: the columns that every effect of the library puts beside the logged torque, for each kind of effect its
own way to make them.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Candidate, Evidence, filtered, started
from invdyn_cli.effects.composition import (
    LEAST_INERTIA,
    EffectInstance,
    TimeWindow,
    chunked,
    has_driver,
    identity,
    inertia_column,
    kinematics_of,
    link_torque,
    rebuilt,
    rigid_torque,
    weight,
)
from invdyn_cli.effects.friction import STICK_TIME, about_reversals
from invdyn_cli.interfaces import (
    AbstractBodyEffect,
    AbstractChannelEffect,
    AbstractEffect,
    AbstractForceEffect,
    AbstractGearEffect,
    AbstractMotionEffect,
    AbstractTorqueEffect,
    JointState,
    Parameters,
)
from invdyn_cli.maths import rigid_body
from invdyn_cli.recording.pieces import Recording
from invdyn_cli.types import Array, Robot

ZEROS = (-0.04, 0.04)
"""[rad] Encoder offsets at which the torque is taken anew: far from zero it is no straight line of the offset."""

STEP = 1e-3
"""Relative step of finite differences in a channel's parameters, and the step [rad] in an encoder's zero."""

STRAIGHT = 0.005
"""[rad] As far as a gear may yield for torques to go with its angle as a line does."""

FAR_LESS = 0.5
"""Of the least limit that is tried anyway, below which that of a drive always at its limit is tried as well."""

YIELD = 0.1
"""Relative step of finite differences in how far a gear yields: play shows at its edges, which move by samples."""


def gather(
    robot: Robot, recording: Recording, effects: Sequence[AbstractEffect], side: str, position_side: str = "unknown"
) -> Evidence:
    """The evidence of a recording for all lasting effects that show on this torque side and this position side."""
    evidence, n = started(robot, recording), robot.dofs
    states = evidence.states
    falls = np.linalg.norm(robot.gravity) > 0
    shown = [e for e in effects if side in e.sides and position_side in e.position_sides and not e.passing]
    shown = [e for e in shown if not e.sum_of]  # its parts are there
    effects = [e for e in shown if falls or not e.turns_gravity]
    _add_bodies(evidence, effects)
    for effect in effects:
        for joint in range(n):
            if isinstance(effect, AbstractTorqueEffect):
                if effect.coupled and not has_driver(robot, joint):
                    continue
                # what the shapes depend on is the same for all pieces: the longest one tells
                longest = max((s[joint] for s in states), key=lambda s: len(s.t))
                shapes = effect.shapes(longest)
            elif isinstance(effect, AbstractChannelEffect):
                shapes = _channel_shapes(evidence, effect, joint)
            elif isinstance(effect, AbstractGearEffect):
                load, inertia = (np.concatenate(x) for x in zip(*_carried(evidence, joint), strict=True))
                if inertia.min() <= LEAST_INERTIA:  # links without inertia follow any gear: nothing of it shows
                    continue
                shapes = effect.shapes(load, inertia, recording.filter.rate)
            else:
                continue
            evidence.candidates += [joint_candidate(evidence, effect, joint, shape) for shape in shapes]
    return evidence


def joint_candidate(evidence: Evidence, effect: AbstractEffect, joint: int, shape: Parameters) -> Candidate:
    """The trial of an effect of one joint's torque, channel or gear at these parameters."""
    if isinstance(effect, AbstractGearEffect):
        return gear_candidate(evidence, effect, joint, shape)
    if isinstance(effect, AbstractChannelEffect):
        return channel_candidate(evidence, effect, joint, shape)
    assert isinstance(effect, AbstractTorqueEffect)
    return torque_candidate(evidence, effect, joint, shape)


def _channel_shapes(evidence: Evidence, effect: AbstractChannelEffect, joint: int) -> list[Parameters]:
    """The trials of a channel effect; limits beyond the noise, and what the motion took where that is far less than all
    of them: a drive that is at its limit most of the time."""
    recording = evidence.recording
    logged = np.concatenate([p.tau[joint] for p in recording.pieces])
    shapes = list(effect.shapes(logged, recording.filter.rate))
    if effect.invertible:
        return shapes
    least = min((shape["limit"] for shape in shapes), default=0.0)
    taken = np.quantile(np.abs(load_on(evidence, joint)), [0.9, 0.95, 0.99])
    shapes += [{"limit": float(x)} for x in taken if x < FAR_LESS * least]
    return [shape for shape in shapes if shape["limit"] > 6 * recording.torque_noise[joint]]


def trial_at(evidence: Evidence, acting: EffectInstance, beside: Sequence[EffectInstance] = ()) -> Candidate:
    """The candidate of an effect at parameters that were found, beside others: its nonlinear ones tried there and
    nowhere else."""
    effect, joint = acting.effect, acting.joint
    if acting.when is not None:
        return passing_candidate(evidence, effect, joint, acting.when)
    if isinstance(effect, AbstractBodyEffect | AbstractMotionEffect):
        return body_candidate(evidence, effect, joint, acting.parameters)
    assert joint is not None
    if isinstance(effect, AbstractGearEffect):
        return gear_candidate(evidence, effect, joint, acting.parameters, beside, exact=True)
    if isinstance(effect, AbstractChannelEffect):
        return channel_candidate(evidence, effect, joint, acting.parameters)
    assert isinstance(effect, AbstractTorqueEffect)
    shape = effect.shape_of(acting.parameters)
    if not shape:
        return next(c for c in evidence.candidates if c.key == (effect.name, joint))
    return torque_candidate(evidence, effect, joint, shape)


def torque_candidate(evidence: Evidence, effect: AbstractTorqueEffect, joint: int, shape: Parameters) -> Candidate:
    """A joint's torque effect with these nonlinear parameters, its columns added to the table; those of a coupled one
    to that of the joint before it, too, with the same coefficients."""
    parts, precision = [], np.zeros(len(effect.basis(evidence.states[0][joint], shape)))
    for s in evidence.states:
        columns = list(effect.basis(s[joint], shape))
        if effect.jumps:
            columns += about_reversals(effect.jump(columns), evidence.recording.filter.rate)
        parts.append(np.stack(columns))
    numbers = evidence.append(joint, list(filtered(evidence.recording, parts, joint)))
    where: dict[int, tuple] = {joint: ((), numbers)}
    if effect.coupled:
        driver, share = evidence.robot.parents[joint], effect.share_on_driver(shape)
        where[driver] = (), evidence.append(driver, list(share * filtered(evidence.recording, parts, driver)))
    if len(numbers) > len(precision):
        level = np.sqrt(np.mean(evidence.tables[joint][:, 0] ** 2))
        unit = np.sqrt(np.mean(np.concatenate([p[0] for p in parts], axis=-1) ** 2))
        known = 1 / max(STICK_TIME * level / max(unit, 1e-12), 1e-12) ** 2
        precision = np.append(precision, np.full(len(numbers) - len(precision), known))
    return Candidate(effect, joint, shape, where, precision)


def channel_candidate(evidence: Evidence, effect: AbstractChannelEffect, joint: int, shape: Parameters) -> Candidate:
    """A joint's channel effect at these parameters: what it changes of the logged torque (fixed), and the change with
    each parameter (free). A gain acts on the model's torque, which has no noise."""
    rate = evidence.recording.filter.rate
    if effect.factor:
        made = [c for c in evidence.candidates if c.key == (effect.name, joint)]
        if made:
            return made[0]
        parts = [s[joint].transmitted[None] for s in evidence.states]
        (column,) = evidence.append(joint, list(filtered(evidence.recording, parts, joint)))
        return Candidate(effect, joint, shape, {joint: ((), (column,))}, np.zeros(1))

    def changed(parameters: Parameters) -> np.ndarray:
        parts = [p.tau[joint] - effect.delivered(parameters, p.tau[joint], rate) for p in evidence.recording.pieces]
        return filtered(evidence.recording, parts, joint)

    fixed = changed(shape)
    # its correction may take it farther than the trial
    quiet = _quiet(evidence, effect, joint, {k: 1.5 * v + 0.006 if k != "limit" else v for k, v in shape.items()})
    free = []
    for name, value in shape.items():
        step = max(STEP * abs(value), 2e-4)
        up, down = value + step, max(value - step, effect.parameters[name].lower)
        free.append((changed({**shape, name: up}) - changed({**shape, name: down})) / (up - down))
    numbers = evidence.append(joint, [fixed, *free])
    # the correction reaches about as far as the next trial; beyond, the straight line is no longer true
    reach = [0.3 * v + 0.004 if effect.parameters[name].unit == "s" else 0.15 * v for name, v in shape.items()]
    return Candidate(effect, joint, shape, {joint: (numbers[:1], numbers[1:])}, 1 / np.square(reach), quiet)


def _quiet(evidence: Evidence, effect: AbstractChannelEffect, joint: int, shape: Parameters) -> float:
    """Share of white noise that a channel effect takes away from a joint's logged torque."""
    rate, noise = evidence.recording.filter.rate, np.random.default_rng(0)
    before, after = [], []
    for p in evidence.recording.pieces:
        size = 1e-6 * (np.std(p.tau[joint]) + 1e-12)
        e = size * noise.normal(size=len(p.t))
        change = effect.delivered(shape, p.tau[joint] + e, rate) - effect.delivered(shape, p.tau[joint], rate)
        before.append(e)
        after.append(change)
    spread = [np.var(filtered(evidence.recording, x, joint)) for x in (after, before)]
    return float(max(0.0, 1 - spread[0] / max(spread[1], 1e-300)))


def body_candidate(
    evidence: Evidence, effect: AbstractBodyEffect | AbstractMotionEffect, joint: int | None, at: Parameters
) -> Candidate:
    """A body or motion effect linearised at parameters that were found already: the change so far is fixed."""
    base = next(c for c in evidence.candidates if c.key == (effect.name, joint) and not c.shape)
    change = _change(evidence, EffectInstance(effect, joint, at))
    columns = {j: (evidence.append(j, [change[j]]), free) for j, (_, free) in base.columns.items()}
    return replace(base, shape=at, columns=columns)


def nominal(states: Sequence[JointState]) -> np.ndarray:
    """(n, T) torques of the nominal model in a piece's states."""
    return np.stack([np.asarray(s.transmitted) for s in states])


def _change(evidence: Evidence, acting: EffectInstance, beside: Sequence[EffectInstance] = ()) -> np.ndarray:
    """(n, R) what a body, motion or gear effect changes of the torque with others."""
    robot, recording = evidence.robot, evidence.recording
    changes = []
    for piece, states in zip(recording.pieces, evidence.states, strict=True):
        stretch = recording.stretch(piece)
        before = link_torque(robot, beside, piece.motion, stretch) if beside else nominal(states)
        changes.append(link_torque(robot, (*beside, acting), piece.motion, stretch) - before)
    return filtered(recording, changes)


def gear_candidate(
    evidence: Evidence,
    effect: AbstractGearEffect,
    joint: int,
    shape: Parameters,
    beside: Sequence[EffectInstance] = (),
    exact: bool = False,
) -> Candidate:
    """A gear that yields so far to what it carries with others: what that changes (fixed), and the change with its
    compliance (free); `exact`: the fixed one as it is, however small."""
    fixed, slope, far = gear_columns(evidence, EffectInstance(effect, joint, shape), beside)
    if exact or far > STRAIGHT:
        fixed = _change(evidence, EffectInstance(effect, joint, shape), beside)
    columns = {}
    for j in range(evidence.dofs):
        numbers = evidence.append(j, [fixed[j], slope[j]])
        columns[j] = numbers[:1], numbers[1:]
    return Candidate(effect, joint, shape, columns, np.array([1 / (0.3 * effect.compliance(shape)) ** 2]))


def gear_columns(
    evidence: Evidence, acting: EffectInstance, beside: Sequence[EffectInstance] = ()
) -> tuple[np.ndarray, np.ndarray, float]:
    """(n, R) what a gear that yields changes of the torque with others, and the change with its compliance, to first
    order: it goes with the link's acceleration against the motor's, and with its angle; how far it yields [rad; m]."""
    effect, joint, recording = acting.effect, acting.joint, evidence.recording
    assert isinstance(effect, AbstractGearEffect) and joint is not None
    compliance, carried = effect.compliance(acting.parameters), _carried(evidence, joint, beside)

    def change(factor: float) -> list[tuple[np.ndarray, float]]:
        own, made = effect.from_compliance(factor * compliance), []
        for (load, inertia), (mass, slope) in zip(carried, _answers(evidence, joint), strict=True):
            b, b2 = effect.deflection(own, load, inertia, recording.filter.rate)
            made.append((mass * b2 + slope * b, float(np.abs(b).max())))
        return made

    softer = [more - less for (more, _), (less, _) in zip(change(1 + YIELD), change(1 - YIELD), strict=True)]
    parts, far = zip(*change(1.0), strict=True)
    return filtered(recording, parts), filtered(recording, softer) / (2 * YIELD * compliance), max(far)


def _carried(evidence: Evidence, joint: int, beside: Sequence[EffectInstance] = ()) -> list[tuple[Array, Array]]:
    """Of every piece the torque (T,) that a joint transmits with other effects, and the inertia (T,) that it carries;
    kept."""
    key = ("carried", joint, identity(beside))
    if key not in evidence.kept:
        robot, recording = evidence.robot, evidence.recording
        loads = [link_torque(robot, beside, p.motion, recording.stretch(p))[joint] for p in recording.pieces]
        inertias = [mass[joint] for mass, _ in _answers(evidence, joint)]
        evidence.kept[key] = list(zip(loads, inertias, strict=True))
    return evidence.kept[key]


def load_on(evidence: Evidence, joint: int, beside: Sequence[EffectInstance] = ()) -> np.ndarray:
    """(T,) of all pieces: the torque that a joint transmits with other effects."""
    return np.concatenate([load for load, _ in _carried(evidence, joint, beside)])


def _answers(evidence: Evidence, joint: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Of every piece the torques (n, T) for unit acceleration of a joint, and their change with its angle; kept."""
    if ("answers", joint) not in evidence.kept:
        robot, own = evidence.robot, (np.arange(evidence.dofs) == joint)[:, None]
        evidence.kept["answers", joint] = [
            (
                inertia_column(robot, piece.q, joint),
                (rigid_torque(robot, replace(piece.motion, q=piece.q + STEP * own)) - nominal(states)) / STEP,
            )
            for piece, states in zip(evidence.recording.pieces, evidence.states, strict=True)
        ]
    return evidence.kept["answers", joint]


def passing_candidate(evidence: Evidence, effect: AbstractEffect, joint: int | None, when: TimeWindow) -> Candidate:
    """What comes and goes, in a window."""
    columns = passing_columns(evidence, effect, joint, when)
    own = isinstance(effect, AbstractChannelEffect)
    precision = beforehand(evidence.robot, effect, joint, len(columns))
    where = {j: ((), evidence.append(j, list(columns[:, j]))) for j in range(evidence.dofs) if not own or j == joint}
    return Candidate(effect, joint, {}, where, precision, when=when)


def beforehand(robot: Robot, effect: AbstractEffect, joint: int | None, count: int) -> np.ndarray:
    """(count,) what is known of the factors of an effect's columns: 1 / scale^2."""
    if isinstance(effect, AbstractBodyEffect):
        return np.array([1 / scale**2 for *_, scale in effect.directions(robot, joint)])
    return np.full(count, 1 / effect.scale**2 if isinstance(effect, AbstractForceEffect) else 0.0)


def passing_columns(
    evidence: Evidence, effect: AbstractEffect, joint: int | None, when: TimeWindow | None
) -> np.ndarray:
    """Columns (k, n, R) of what comes and goes, in a window; None: of what it would be always."""
    recording = evidence.recording
    shares = [weight(when, recording.stretch(piece)) for piece in recording.pieces]
    parts = _passing(evidence, effect, joint)
    return filtered(recording, [x * share for x, share in zip(parts, shares, strict=True)])


def passing_torque(evidence: Evidence, acting: EffectInstance, factors: np.ndarray) -> list[np.ndarray]:
    """(n, T) of every piece: what comes and goes, of its columns' factors (k,)."""
    recording = evidence.recording
    parts = _passing(evidence, acting.effect, acting.joint)
    return [
        weight(acting.when, recording.stretch(piece)) * np.tensordot(factors, x, 1)
        for piece, x in zip(recording.pieces, parts, strict=True)
    ]


def _passing(evidence: Evidence, effect: AbstractEffect, joint: int | None) -> list[np.ndarray]:
    """Columns (k, n, T) of every piece of what comes and goes, kept."""
    if (effect.name, joint) not in evidence.kept:
        count = len(evidence.recording.pieces)
        evidence.kept[effect.name, joint] = [_basis(evidence, effect, joint, number) for number in range(count)]
    return evidence.kept[effect.name, joint]


def _basis(evidence: Evidence, effect: AbstractEffect, joint: int | None, number: int) -> np.ndarray:
    """Columns (k, n, T) of an effect on a piece."""
    robot, piece = evidence.robot, evidence.recording.pieces[number]
    if isinstance(effect, AbstractForceEffect):
        return np.asarray(effect.basis(robot, joint, piece.motion))
    if isinstance(effect, AbstractBodyEffect):
        moves = np.stack([inertial.reshape(-1) for inertial, *_ in effect.directions(robot, joint)])
        linear = partial(body_columns, kinematics_of(robot), jnp.asarray(robot.gravity), jnp.asarray(moves))
        return chunked(linear, piece.q, piece.qd, piece.qdd)
    assert joint is not None
    row = (np.arange(robot.dofs) == joint)[:, None] * evidence.states[number][joint].transmitted
    return row[None]


def _add_bodies(evidence: Evidence, effects: Sequence[AbstractEffect]) -> None:
    robot, recording, n = evidence.robot, evidence.recording, evidence.dofs
    bodies = [e for e in effects if isinstance(e, AbstractBodyEffect)]
    if bodies:
        _add_changes(evidence, bodies)
    for effect in effects:
        if isinstance(effect, AbstractMotionEffect):
            for joint in range(n):
                (name,), change = effect.parameters, []
                for piece in recording.pieces:
                    ends = [rigid_torque(robot, effect.true({name: x}, piece.motion, joint)) for x in (STEP, -STEP)]
                    change.append((ends[0] - ends[1]) / (2 * STEP))
                columns = filtered(recording, change)
                where = {j: ((), evidence.append(j, [columns[j]])) for j in range(n)}
                evidence.candidates.append(Candidate(effect, joint, {}, where, np.array([1 / 0.3**2])))
                evidence.candidates += [body_candidate(evidence, effect, joint, {name: x}) for x in ZEROS]


def _add_changes(evidence: Evidence, bodies: Sequence[AbstractBodyEffect]) -> None:
    """Candidates that change inertials or gravity."""
    robot, recording, n = evidence.robot, evidence.recording, evidence.dofs
    places = [(e, j) for e in bodies for j in (range(n) if e.of_joint else (None,))]
    directions = [e.directions(robot, j) for e, j in places]
    moves = np.stack([inertial.reshape(-1) for d in directions for inertial, _, _ in d])
    falls = np.stack([gravity for d in directions for _, gravity, _ in d])
    own = moves.any(axis=1)
    kinematics, inertial = kinematics_of(robot), jnp.asarray(robot.inertial)
    linear = partial(body_columns, kinematics, jnp.asarray(robot.gravity), jnp.asarray(moves[own]))
    gravity = partial(gravity_columns, kinematics, inertial, jnp.asarray(falls[~own]))
    parts: list[np.ndarray] = []
    for piece in recording.pieces:
        motion = piece.q, piece.qd, piece.qdd
        columns = np.empty((len(moves), n, len(piece.t)))
        columns[own] = chunked(linear, *motion)
        columns[~own] = chunked(gravity, *motion)
        parts.append(columns)
    columns = filtered(recording, parts)  # (directions, n, rows)
    k = 0
    for (effect, joint), direction in zip(places, directions, strict=True):
        precision = np.array([1 / scale**2 for *_, scale in direction])
        where = {j: ((), evidence.append(j, list(columns[k : k + len(direction), j]))) for j in range(n)}
        evidence.candidates.append(Candidate(effect, joint, {}, where, precision))
        k += len(direction)


@jax.jit
def body_columns(kinematics, gravity, moves, q, qd, qdd):
    """Torque (k, n, T) of unit moves (k, 10 n) of the inertials."""
    robot = rebuilt(kinematics, jnp.zeros((q.shape[0], 10)), gravity)
    rows = rigid_body.regressor(robot, q, qd, qdd)
    return jnp.tensordot(moves, rows.reshape(-1, *rows.shape[2:]), 1)


@jax.jit
def gravity_columns(kinematics, inertial, falls, q, qd, qdd):
    """Torque (k, n, T) at rest of unit moves (k, 3) of gravity."""
    still = jnp.zeros_like(q)
    return jax.vmap(lambda g: rigid_body.inverse_dynamics(rebuilt(kinematics, inertial, g), inertial, q, still, still))(
        falls
    )
