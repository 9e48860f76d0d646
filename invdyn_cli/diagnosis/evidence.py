"""Evidence: every candidate cause as columns beside the logged torque, filtered alike, as Gram matrices of blocks.

Row j of the arm has a table X_j (rows, columns). Column 0 is the logged torque less the nominal one. A candidate is a
set of columns: fixed ones, which enter with factor one (a delay of 6 ms, tried), and free ones, whose factors are to be
fitted (its small correction). All that the search asks can be answered from the tables' Gram matrices, by blocks.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from invdyn_cli.diagnosis.recording import ROLES, Piece, Recording
from invdyn_cli.effects.composition import Acting, changed, chunked, kinematics_of, rebuilt, rigid_torque, sign_of
from invdyn_cli.interfaces import (
    AbstractBodyEffect,
    AbstractChannelEffect,
    AbstractEffect,
    AbstractMotionEffect,
    AbstractTorqueEffect,
    JointState,
    Parameters,
)
from invdyn_cli.maths import rigid_body
from invdyn_cli.types import Array, Robot

BLOCK, SHORTEST, FEWEST, MOST = 2.0, 0.5, 16, 120
"""Length of a block [s]: longer than what friction, control and filter remember of a residual. Short logs have shorter
blocks, of SHORTEST at least, to have FEWEST of them; long ones have longer blocks, to have no more than MOST."""

REST_SPEED, REST_SHARE = 0.004, 0.02
"""Speed [rad/s; m/s], and share of a joint's usual speed (its 90 % quantile), below which the joint rests if it stays
so for REST_TIME; its friction can then be anything."""

HELD = 0.01
"""Range [rad; m] within which a joint is held: it creeps, and its friction holds what it likes."""

REST_TIME = 0.05
DRY = ("coulomb_friction", "stribeck_friction", "load_dependent_friction")
"""Effects that jump where a joint turns back."""

STICK_TIME = 0.005
"""[s] A joint that turns back sticks for some milliseconds, in which its friction is anything between: such a shift of
the jump is allowed for, as a free column of its own."""

ZEROS = (-0.04, 0.04)
"""[rad] Encoder offsets at which the torque is taken anew: far from zero it is no straight line of the offset."""

STEP = 1e-3
"""Relative step of finite differences in a channel's parameters, and the step [rad] in an encoder's zero."""


@dataclass(frozen=True)
class Candidate:
    """An effect on a joint with a trial's nonlinear parameters: which columns of which rows it takes.

    `columns[j]` = (fixed columns, free columns) of row j; free columns are in the order of the coefficients, one for
    each; behind those that the effect reads there may be one that only mends the timing of its reversals. `precision`
    (k,) is what is known of the coefficients beforehand: 1 / scale^2. `quiet` is the share of a white noise's variance
    that a channel effect takes away, which is no merit of it.
    """

    effect: AbstractEffect
    joint: int | None
    shape: Parameters
    columns: dict[int, tuple[tuple[int, ...], tuple[int, ...]]]
    precision: np.ndarray
    quiet: float = 0.0

    @property
    def key(self) -> tuple[str, int | None]:
        """The effect's name and its joint."""
        return self.effect.name, self.joint

    @property
    def is_trial(self) -> bool:
        """Whether some of its columns are fixed: it does something by itself, whatever the coefficients."""
        return any(fixed for fixed, _ in self.columns.values())


@dataclass
class Evidence:
    """Tables of columns, and the candidates that take them; `append` adds columns.

    Attributes:
        tables: per row (R, columns).
        valid: (R, n) rows at which a joint moved (its friction is known).
        block, role, piece: (R,) block number, index into ROLES, piece number.
    """

    robot: Robot
    recording: Recording
    tables: list[np.ndarray]
    valid: np.ndarray
    block: np.ndarray
    role: np.ndarray
    piece: np.ndarray
    tau: np.ndarray
    nominal: np.ndarray
    candidates: list[Candidate] = field(default_factory=list)
    states: list[list[JointState]] = field(default_factory=list)
    reference_rows: np.ndarray | None = None

    def left(self, candidates: Sequence[Candidate], theta: np.ndarray) -> np.ndarray:
        """(R, n) what candidates with these coefficients leave of the logged torque less the nominal one."""
        out = np.column_stack([table[:, 0] for table in self.tables])
        for c, own in shared_out(candidates, theta):
            for j, (fixed, free) in c.columns.items():
                out[:, j] -= self.tables[j][:, list(fixed)].sum(1) + self.tables[j][:, list(free)] @ own
        return out

    def on_rows(self, name: str) -> np.ndarray:
        """(R,) or (R, n) of the pieces' `t`, `q`, `qd` or `qdd`."""
        pieces, filter = self.recording.pieces, self.recording.filter
        return np.concatenate([getattr(p, name)[..., filter.rows(len(p.t))].T for p in pieces])

    @property
    def dofs(self) -> int:
        """Number of joints."""
        return len(self.tables)

    def append(self, row: int, columns: Sequence[np.ndarray]) -> tuple[int, ...]:
        """Add columns (R,) to a row's table; their numbers."""
        if self.reference_rows is not None:
            columns = [np.where(self.reference_rows, 0.0, x) for x in columns]
        first = self.tables[row].shape[1]
        self.tables[row] = np.column_stack([self.tables[row], *columns]) if len(columns) else self.tables[row]
        return tuple(range(first, first + len(columns)))


def shared_out(candidates: Sequence[Candidate], theta: np.ndarray) -> Iterator[tuple[Candidate, np.ndarray]]:
    """Every candidate with its own of all coefficients (k,)."""
    start = 0
    for c in candidates:
        yield c, theta[start : start + len(c.precision)]
        start += len(c.precision)


def gather(robot: Robot, recording: Recording, effects: Sequence[AbstractEffect], side: str) -> Evidence:
    """The evidence of a recording for all effects that show on this torque side."""
    n = robot.dofs
    rows, states, nominal = [], [], []
    total = sum(p.t[-1] - p.t[0] for p in recording.pieces)
    length = max(SHORTEST, min(BLOCK, total / FEWEST), total / MOST)
    block = 0
    for number, piece in enumerate(recording.pieces):
        torque = rigid_torque(robot, piece.motion)
        nominal.append(torque)
        states.append(joint_states(piece, torque, recording))
        kept = recording.filter.rows(len(piece.t))
        of = block + np.minimum(
            (piece.t[kept] - piece.t[kept[0]]) // length, _last_block(piece.t[kept], length)
        ).astype(int)
        block = of[-1] + 1
        rows.append((of, np.full(len(kept), ROLES.index(piece.role)), np.full(len(kept), number)))
    blocks, role, piece_of = (np.concatenate(x) for x in zip(*rows, strict=True))
    tau = filtered(recording, [p.tau for p in recording.pieces])
    torque = filtered(recording, nominal)
    angles, speeds = (np.concatenate([getattr(p, x) for p in recording.pieces], axis=1) for x in ("q", "qd"))
    rest = np.minimum(REST_SPEED, REST_SHARE * np.quantile(np.abs(speeds), 0.9, axis=1))
    rest[np.ptp(angles, axis=1) < HELD] = np.inf
    moving = np.concatenate([_moving(p, recording, rest) for p in recording.pieces], axis=1)
    evidence = Evidence(
        robot, recording, [np.array((tau[j] - torque[j])[:, None]) for j in range(n)], moving.T, blocks, role, piece_of,
        tau.T, torque.T, states=states,
    )  # fmt: skip
    falls = np.linalg.norm(robot.gravity) > 0
    effects = [e for e in effects if side in e.sides and (falls or e.name != "base_tilt")]
    _add_bodies(evidence, effects)
    for effect in effects:
        for joint in range(n):
            if isinstance(effect, AbstractTorqueEffect):
                # what the shapes depend on is the same for all pieces: the longest one tells
                longest = max((s[joint] for s in states), key=lambda s: len(s.t))
                for shape in effect.shapes(longest):
                    evidence.candidates.append(torque_candidate(evidence, effect, joint, shape))
            elif isinstance(effect, AbstractChannelEffect):
                logged = np.concatenate([p.tau[joint] for p in recording.pieces])
                for shape in effect.shapes(logged, recording.filter.rate):
                    if shape.get("limit", np.inf) < 6 * recording.torque_noise[joint]:
                        continue  # a limit within the noise
                    evidence.candidates.append(channel_candidate(evidence, effect, joint, shape))
    return evidence


def torque_candidate(evidence: Evidence, effect: AbstractTorqueEffect, joint: int, shape: Parameters) -> Candidate:
    """A joint's torque effect with these nonlinear parameters, its columns added to the table."""
    parts, precision = [], np.zeros(len(effect.basis(evidence.states[0][joint], shape)))
    for s in evidence.states:
        columns = list(effect.basis(s[joint], shape))
        if effect.name in DRY:
            columns.append(np.gradient(columns[0]) * evidence.recording.filter.rate)
        parts.append(np.stack(columns))
    numbers = evidence.append(joint, list(filtered(evidence.recording, parts, joint)))
    if len(numbers) > len(precision):
        level = np.sqrt(np.mean(evidence.tables[joint][:, 0] ** 2))
        unit = np.sqrt(np.mean(np.concatenate([p[0] for p in parts], axis=-1) ** 2))
        precision = np.append(precision, 1 / max(STICK_TIME * level / max(unit, 1e-12), 1e-12) ** 2)
    return Candidate(effect, joint, shape, {joint: ((), numbers)}, precision)


def channel_candidate(evidence: Evidence, effect: AbstractChannelEffect, joint: int, shape: Parameters) -> Candidate:
    """A joint's channel effect at these parameters: what it changes of the logged torque (fixed), and the change with
    each parameter (free). A gain acts on the model's torque, which has no noise."""
    rate = evidence.recording.filter.rate
    if effect.name == "torque_gain_error":
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
    acting = (Acting(effect, joint, at),)
    changes = [
        rigid_torque(*changed(evidence.robot, acting, piece.motion)) - np.stack([s.transmitted for s in states])
        for piece, states in zip(evidence.recording.pieces, evidence.states, strict=True)
    ]
    change = filtered(evidence.recording, changes)
    columns = {j: (evidence.append(j, [change[j]]), free) for j, (_, free) in base.columns.items()}
    return replace(base, shape=at, columns=columns)


def _add_bodies(evidence: Evidence, effects: Sequence[AbstractEffect]) -> None:
    robot, recording, n = evidence.robot, evidence.recording, evidence.dofs
    bodies = [e for e in effects if isinstance(e, AbstractBodyEffect)]
    if bodies:
        _add_changes(evidence, bodies)
    for effect in effects:
        if isinstance(effect, AbstractMotionEffect):
            for joint in range(n):
                change = []
                for piece in recording.pieces:
                    ends = [rigid_torque(robot, effect.true({"offset": x}, piece.motion, joint)) for x in (STEP, -STEP)]
                    change.append((ends[0] - ends[1]) / (2 * STEP))
                columns = filtered(recording, change)
                where = {j: ((), evidence.append(j, [columns[j]])) for j in range(n)}
                evidence.candidates.append(Candidate(effect, joint, {}, where, np.array([1 / 0.3**2])))
                for offset in ZEROS:
                    evidence.candidates.append(body_candidate(evidence, effect, joint, {"offset": offset}))


def _add_changes(evidence: Evidence, bodies: Sequence[AbstractBodyEffect]) -> None:
    """Candidates that change inertials or gravity."""
    robot, recording, n = evidence.robot, evidence.recording, evidence.dofs
    places = [(e, j) for e in bodies for j in (range(n) if e.name == "link_inertia_error" else (None,))]
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


def joint_states(piece: Piece, torque: np.ndarray, recording: Recording) -> list[JointState]:
    """Every joint's state; sign(qd) is averaged over a sample's length, and no sharper than the noise of the speed."""
    step = 1 / recording.filter.rate
    width = np.maximum(np.abs(piece.qdd) * step / 2, np.maximum(2 * piece.motion_noise, 1e-6)[:, None])
    sign = sign_of(piece.qd, width)
    return [JointState(piece.t, piece.q[j], piece.qd[j], piece.qdd[j], sign[j], torque[j]) for j in range(len(torque))]


def _moving(piece: Piece, recording: Recording, rest_speed: np.ndarray) -> np.ndarray:
    """(n, rows) where no rest is within the filter's reach."""
    slow = np.abs(piece.qd) < np.maximum(rest_speed, 4 * piece.motion_noise)[:, None]
    length = max(2, round(REST_TIME * recording.filter.rate))
    rest = np.zeros_like(slow)
    for j in range(len(slow)):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], slow[j], [False]]).astype(int)))
        for start, end in zip(edges[::2], edges[1::2], strict=True):
            rest[j, start:end] = end - start >= length
    return ~recording.filter.spread(rest)


def filtered(recording: Recording, parts: Sequence[Array], joint: int | None = None) -> np.ndarray:
    """(..., T) of every piece, filtered as a joint's torque is, one behind the other: (..., R); without a joint
    (..., n, T) -> (..., n, R)."""
    arrays = [np.asarray(x) for x in parts]
    each = [recording.filter(x) if joint is None else recording.filter.of(joint, x) for x in arrays]
    return np.concatenate(each, axis=-1)


def _last_block(t: np.ndarray, length: float) -> int:
    """Number of the last block of a piece: an incomplete one belongs to the one before."""
    return max(0, int((t[-1] - t[0] + 1e-9) // length) - 1)


def trial_at(evidence: Evidence, acting: Acting) -> Candidate:
    """The candidate of an effect at parameters that were found: its nonlinear ones tried there and nowhere else."""
    effect, joint = acting.effect, acting.joint
    if isinstance(effect, AbstractBodyEffect | AbstractMotionEffect):
        return body_candidate(evidence, effect, joint, acting.parameters)
    assert joint is not None
    if isinstance(effect, AbstractChannelEffect):
        return channel_candidate(evidence, effect, joint, acting.parameters)
    assert isinstance(effect, AbstractTorqueEffect)
    shape = {name: acting.parameters[name] for name in effect.nonlinear}
    if not shape:
        return next(c for c in evidence.candidates if c.key == (effect.name, joint))
    return torque_candidate(evidence, effect, joint, shape)
