"""Evidence: every candidate cause as columns beside the logged torque, all filtered alike, as Gram matrices of blocks.

Row j of the arm has a table X_j (rows, columns). Column 0 is the logged torque minus the nominal one. A candidate is a
set of columns: fixed ones with factor one (a trial delay of 6 ms), and free ones whose factors are fitted (its small
correction). Everything in the search is computed from the Gram matrices of the tables, by blocks.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy

from invdyn_cli.effects.composition import EffectInstance, Span, TimeWindow, channel, channels, in_chain, sign_of
from invdyn_cli.effects.rigid import rigid_torque
from invdyn_cli.interfaces import AbstractEffect, JointState, Parameters
from invdyn_cli.maths.signals import lowpass, settling
from invdyn_cli.recording.pieces import ROLES, Piece, Recording
from invdyn_cli.recording.rows import runs
from invdyn_cli.types import Array, Robot

BLOCK, SHORTEST, FEWEST, MOST = 2.0, 0.5, 16, 120
"""Length of a block [s]: longer than what friction, control and filter remember of a residual. Short logs have shorter
blocks, of SHORTEST at least, to have FEWEST of them; long ones have longer blocks, to have no more than MOST."""

REST_SPEED, REST_SHARE = 0.004, 0.02
"""Speed [rad/s; m/s], and share of a joint's usual speed (its 90 % quantile), below which the joint counts as resting
if it stays so for REST_TIME; its friction is then indeterminate."""

HELD = 0.01
"""Range [rad; m] within which a joint counts as held: it creeps, and its friction is indeterminate."""

REST_TIME = 0.05

STICKS, CREEPS = 0.025, 0.25
"""[s] Shortest time for which a joint sticks before it turns back; and how far it moves then at most, as a share of the
way at the highest speed of a rest: a joint that turns back without friction moves as much while it is that slow."""

SPARE = 64
"""Number of columns for which there is space before a table is copied."""

SLOW = 0.25
"""Part of a joint's frequency band in which the arm moves; for a gear, whose resonance lies above, also as far as the
joint's motion is real (`Recording.real`)."""

ADJOINING = 0.2
"""[s] Longest gap between two pieces of a trajectory across which the state of an effect with a memory continues."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect on a joint with a trial's nonlinear parameters: which columns of which rows it takes. Each is equal to
    itself alone, so that results can be kept by it.

    `columns[j]` = (fixed columns, free columns) of row j; free columns are in the order of the coefficients, one for
    each; behind those that the effect reads there may be two that only correct the timing of its reversals. `precision`
    (k,) is what is known of the coefficients beforehand: 1 / scale^2. `noise_reduction` is the share of a white noise's
    variance that a channel effect takes away, which is no merit of it. `when` is the window of what comes and goes.
    """

    effect: AbstractEffect
    joint: int | None
    shape: Parameters
    columns: dict[int, tuple[tuple[int, ...], tuple[int, ...]]]
    precision: np.ndarray
    noise_reduction: float = 0.0
    when: TimeWindow | None = None

    @cached_property
    def key(self) -> tuple:
        """The effect's name and its joint; for an effect in a time window also its number."""
        return EffectInstance(self.effect, self.joint, {}, self.when).key

    @property
    def is_trial(self) -> bool:
        """Whether some of its columns are fixed: they have an effect for any coefficients."""
        return any(fixed for fixed, _ in self.columns.values())


@dataclass
class Evidence:
    """Tables of columns, and the candidates that take them; `append` adds columns.

    Attributes:
        tables: per row (R, columns).
        valid: (R, n) rows at which a joint moved (its friction is known).
        block, role, piece: (R,) block number, index into ROLES, piece number.
        kept: what candidates are made from and is dear to compute.
        base: of every piece what the nominal torque (n, T) has more than that of `robot`, if that has other links.
        given: part of every hypothesis, and no finding.
        loaded: effects whose candidates depend on the torque that a joint transmits, made or not.
        reference_rows: (R,) those of a reference, on which the columns of changes vanish, where there is one.
        shown: (R, n) friction above all, which a drive's gain in a window of time scales, too: what the reference shows
            beside the nominal model, or without one what each joint's standard terms explain.
        dragged: of a joint, parameters of a gear whose link has friction of its own, tried beside none.
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
    kept: dict[tuple, list] = field(default_factory=dict)
    base: list[np.ndarray] | None = None
    given: tuple[Candidate, ...] = ()
    loaded: tuple[AbstractEffect, ...] = ()
    shown: np.ndarray | None = None
    dragged: Mapping[int, Parameters] = field(default_factory=dict)

    def residual(self, candidates: Sequence[Candidate], theta: np.ndarray) -> np.ndarray:
        """(R, n) residual of the logged torque minus the nominal one, for candidates with these coefficients."""
        out = np.column_stack([table[:, 0] for table in self.tables])
        for c, own in shared_out(candidates, theta):
            for j, (fixed, free) in c.columns.items():
                out[:, j] -= _of(self.tables[j], fixed).sum(1) + _of(self.tables[j], free) @ own
        return out

    def logged(self, acting: Sequence[EffectInstance], columns: np.ndarray) -> np.ndarray:
        """Torque (m, R, n) that reaches the joints as it is logged, behind the channels among `acting`."""
        out = columns
        for j in {a.joint for a in channels(acting) if a.effect.invertible and a.joint is not None}:
            out = out.copy() if out is columns else out
            out[:, :, j] = self.logged_on(j, acting, columns[:, :, j])
        return out

    def logged_on(self, joint: int, acting: Sequence[EffectInstance], columns: np.ndarray) -> np.ndarray:
        """The same (m, R) of one joint: at the full rate again, since rows are so few that a slope between them is
        none."""
        through = [a for a in channels(acting) if a.effect.invertible and a.joint == joint]
        if not through or not len(columns):
            return columns
        out, filter = columns.copy(), self.recording.filter
        for number, piece in enumerate(self.recording.pieces):
            at = np.flatnonzero(self.piece == number)
            if self.reference_rows is not None and self.reference_rows[at].any():
                continue
            fine = scipy.signal.resample_poly(columns[:, at].T, filter.keep, 1, padtype="line")
            t = piece.t[filter.rows(len(piece.t))[0] :][: len(fine)]
            fine = channel(through, joint, fine, Span(piece.trajectory, t, filter.rate))
            out[:, at] = np.asarray(fine)[:: filter.keep].T
        return out

    def of_role(self, role: str) -> np.ndarray:
        """(R,) bool: the rows of a role, one of ROLES."""
        return self.role == ROLES.index(role)

    def on_rows(self, name: str) -> np.ndarray:
        """(R,) or (R, n) of the pieces' `t`, `q`, `qd` or `qdd`."""
        pieces, filter = self.recording.pieces, self.recording.filter
        return np.concatenate([getattr(p, name)[..., filter.rows(len(p.t))].T for p in pieces])

    @property
    def trajectory(self) -> np.ndarray:
        """(R,) name of every row's trajectory."""
        return np.array([p.trajectory for p in self.recording.pieces])[self.piece]

    @property
    def dofs(self) -> int:
        """Number of joints."""
        return len(self.tables)

    def append(self, row: int, columns: Sequence[np.ndarray]) -> tuple[int, ...]:
        """Add columns (R,) to a row's table; their numbers."""
        if self.reference_rows is not None:
            columns = [np.where(self.reference_rows, 0.0, x) for x in columns]
        table, first = self.tables[row], self.tables[row].shape[1]
        last = first + len(columns)
        room = table if table.base is None else table.base
        if last > room.shape[1]:
            room = np.empty((len(table), last + SPARE), order="F")  # columns are written, and taken, one by one
            room[:, :first] = table
        for number, x in enumerate(columns, start=first):
            room[:, number] = x
        self.tables[row] = room[:, :last]
        return tuple(range(first, last))


def _of(table: np.ndarray, columns: tuple[int, ...]) -> np.ndarray:
    """Some columns of a table (R, C), without a copy where they stand side by side."""
    first, count = (columns[0], len(columns)) if columns else (0, 0)
    beside = columns == tuple(range(first, first + count))
    return table[:, first : first + count] if beside else table[:, list(columns)]


def shared_out(candidates: Sequence[Candidate], theta: np.ndarray) -> Iterator[tuple[Candidate, np.ndarray]]:
    """Every candidate with its own part of all coefficients (k,)."""
    start = 0
    for c in candidates:
        yield c, theta[start : start + len(c.precision)]
        start += len(c.precision)


def started(robot: Robot, recording: Recording) -> Evidence:
    """The evidence of a recording before any candidate: the logged and the nominal torque."""
    n = robot.dofs
    rows, states, nominal = [], [], []
    total = sum(p.t[-1] - p.t[0] for p in recording.pieces)
    length = max(SHORTEST, min(BLOCK, total / FEWEST), total / MOST)
    block = 0
    for number, piece in enumerate(recording.pieces):
        torque = rigid_torque(robot, piece.motion)
        nominal.append(torque)
        states.append(joint_states(piece, torque, recording, robot.parents))
        kept = recording.filter.rows(len(piece.t))
        t = piece.t[kept] - piece.t[kept[0]]
        last = max(0, int((t[-1] + 1e-9) // length) - 1)  # an incomplete block belongs to the one before
        of = block + np.minimum(t // length, last).astype(int)
        block = of[-1] + 1
        rows.append((of, np.full(len(kept), ROLES.index(piece.role)), np.full(len(kept), number)))
    blocks, role, piece_of = (np.concatenate(x) for x in zip(*rows, strict=True))
    tau = filtered(recording, [p.tau for p in recording.pieces])
    torque = filtered(recording, nominal)
    angles, speeds = (np.concatenate([getattr(p, x) for p in recording.pieces], axis=1) for x in ("q", "qd"))
    rest = np.minimum(REST_SPEED, REST_SHARE * np.quantile(np.abs(speeds), 0.9, axis=1))
    rest[np.ptp(angles, axis=1) < HELD] = np.inf
    moving = np.concatenate([_moving(p, recording, rest) for p in recording.pieces], axis=1)
    return Evidence(
        robot, recording, [np.array((tau[j] - torque[j])[:, None]) for j in range(n)], moving.T, blocks, role, piece_of,
        tau.T, torque.T, states=states,
    )  # fmt: skip


def joint_states(piece: Piece, torque: np.ndarray, recording: Recording, parents: Sequence[int]) -> list[JointState]:
    """Every joint's state; sign(qd) is averaged over a sample's length, and no sharper than the noise of the speed or
    than its friction changes side."""
    step = 1 / recording.filter.rate
    width = np.maximum(np.abs(piece.qdd) * step / 2, np.maximum(2 * piece.motion_noise, 1e-6)[:, None])
    sign = [sign_of(*of_joint) for of_joint in zip(piece.qd, width, recording.transition, strict=True)]
    before = [
        p.q for p in recording.pieces if p.trajectory == piece.trajectory and 0 < piece.t[0] - p.t[-1] < ADJOINING
    ]
    memory = before[0] if before else [None] * len(torque)
    rows = zip(piece.q, piece.qd, piece.qdd, sign, torque, memory, width, strict=True)
    return in_chain([JointState(piece.t, *row) for row in rows], parents)


def _moving(piece: Piece, recording: Recording, rest_speed: np.ndarray) -> np.ndarray:
    """(n, rows) bool: rows that no rest reaches through the filter. Speeds are means over REST_TIME: one that creeps
    from one step of its encoder to the next seems to stop and go. A joint that stays where it is for STICKS rests, too:
    its friction balances what is to turn it back."""
    length = max(2, round(REST_TIME * recording.filter.rate))
    mean = scipy.ndimage.uniform_filter1d(piece.qd, length, axis=1)
    slowest = np.maximum(rest_speed, 4 * piece.motion_noise)[:, None]
    slow = np.abs(mean) < slowest
    size = (1, max(3, round(STICKS * recording.filter.rate)))
    moves = scipy.ndimage.maximum_filter(piece.q, size) - scipy.ndimage.minimum_filter(piece.q, size)
    rest = scipy.ndimage.maximum_filter(moves < CREEPS * slowest * STICKS, size)
    for j in range(len(slow)):
        for start, end in runs(slow[j]):
            rest[j, start:end] |= end - start >= length
    return ~recording.filter.spread(rest)


def filtered(recording: Recording, parts: Sequence[Array], joint: int | None = None) -> np.ndarray:
    """(..., T) of every piece, filtered as a joint's torque is, one behind the other: (..., R); without a joint
    (..., n, T) -> (..., n, R)."""
    arrays = [np.asarray(x) for x in parts]
    each = recording.filter(arrays) if joint is None else recording.filter.of(joint, arrays)
    return np.concatenate(each, axis=-1)


def judged(evidence: Evidence) -> np.ndarray:
    """Held-out rows (R,) bool; where there are none, all rows but the reference's."""
    test = evidence.of_role("test")
    return test if held_out(evidence) else ~evidence.of_role("reference")


def held_out(evidence: Evidence) -> bool:
    """Whether there are held-out rows."""
    return bool(np.any(evidence.of_role("test")))


def slow(evidence: Evidence, x: np.ndarray, joint: int, gear: bool = False) -> np.ndarray:
    """(R,) of x (R,) the part of a joint's band where the arm, or a `gear`, moves, piece by piece: the noise of
    differentiated positions is small there. 0 on pieces that are shorter than the filter's memory."""
    out, (rate, cutoff, pieces) = np.zeros(len(x)), _long(evidence, joint, gear)
    for at in pieces:
        out[at] = lowpass(x[at], rate, cutoff)
    return out


def slow_squares(evidence: Evidence, residual: np.ndarray, joint: int, gear: bool = False) -> np.ndarray:
    """(2,) sums of squares of a joint's residual (R,) on pieces that are long enough: of its slow part, and whole."""
    moving = np.zeros(len(residual))
    for at in _long(evidence, joint, gear)[2]:
        moving[at] = residual[at] * evidence.valid[at, joint]
    return np.array([np.sum(slow(evidence, moving, joint, gear) ** 2), np.sum(moving**2)])


def slow_saved(
    evidence: Evidence, joints: Iterable[int], gear: bool, before: np.ndarray, after: np.ndarray, weights: np.ndarray
) -> np.ndarray:
    """(2,) what an effect, a `gear` or not, saves on some joints, from the residuals (R, n) without and with it, in
    noise variances: where the arm moves, and everywhere."""

    def squares(x: np.ndarray) -> np.ndarray:
        return np.sum([weights[j] * slow_squares(evidence, x[:, j], j, gear) for j in joints], axis=0)

    return squares(before) - squares(after)


def slow_share(saved: np.ndarray) -> float:
    """The share, 0 to 1, of what is saved where the arm moves, from `slow_squares` (2,) that are saved; 1 where all
    pieces are too short to tell. Above, what goes with the noise of encoders looks like a delay or a spring."""
    return float(np.clip(saved[0] / saved[1], 0.0, 1.0)) if saved[1] > 0 else 1.0


def _long(evidence: Evidence, joint: int, gear: bool) -> tuple[float, float, list[np.ndarray]]:
    """Rate of the rows and cut-off [Hz] of the part of a joint's band where the arm moves, and the rows (R,) bool of
    each piece that is longer than that filter's memory."""
    filter = evidence.recording.filter
    rate = filter.rate / filter.keep
    moving = max(SLOW * filter.widest[joint], evidence.recording.real[joint] if gear else 0.0)
    cutoff = min(moving, filter.cutoffs[joint], 0.45 * rate)
    pieces = [evidence.piece == number for number in np.unique(evidence.piece)]
    return rate, cutoff, [at for at in pieces if at.sum() > settling(rate, cutoff)]
