"""Columns of effects that act on all joints: bodies, gravity, the motion itself, forces from outside."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Candidate, Evidence, filtered
from invdyn_cli.diagnosis.columns.kind import AbstractKind, Beside, change, known
from invdyn_cli.effects.composition import EffectInstance
from invdyn_cli.effects.rigid import body_columns, gravity_columns, rigid_torque
from invdyn_cli.interfaces import (
    AbstractBodyEffect,
    AbstractEffect,
    AbstractForceEffect,
    AbstractMotionEffect,
    Parameters,
)

ZEROS = (-0.04, 0.04)
"""[rad] Encoder offsets at which the torque is computed anew: far from zero it is not linear in the offset."""

STEP = 1e-3
"""[rad; m] Step of finite differences in an encoder's zero."""

MOST = 0.3
"""[rad; m] Prior scale of an encoder offset."""


class Bodies(AbstractKind[AbstractBodyEffect]):
    """The torque is linear in inertials and in gravity: a column for each direction in which an effect changes them."""

    at_once = True

    def gathered(self, evidence: Evidence, effects: Sequence[AbstractBodyEffect]) -> list[Candidate]:
        robot, recording, n = evidence.robot, evidence.recording, evidence.dofs
        places = [(e, j) for e in effects for j in (range(n) if e.of_joint else (None,))]
        directions = [e.directions(robot, j) for e, j in places]
        moves = np.stack([inertial.reshape(-1) for d in directions for inertial, _, _ in d])
        falls = np.stack([gravity for d in directions for _, gravity, _ in d])
        own = moves.any(axis=1)
        parts: list[np.ndarray] = []
        for piece in recording.pieces:
            columns = np.empty((len(moves), n, len(piece.t)))
            columns[own] = body_columns(robot, moves[own], piece.motion)
            columns[~own] = gravity_columns(robot, falls[~own], piece.q)
            parts.append(columns)
        columns = filtered(recording, parts)  # (directions, n, rows)
        made, k = [], 0
        for (effect, joint), direction in zip(places, directions, strict=True):
            count = len(direction)
            where = {j: ((), evidence.append(j, list(columns[k : k + count, j]))) for j in range(n)}
            made.append(Candidate(effect, joint, {}, where, effect.precision(robot, joint, count)))
            k += count
        return made

    def candidate(
        self, evidence: Evidence, effect: AbstractBodyEffect, joint: int | None, trial: Parameters, beside: Beside = ()
    ) -> Candidate:
        return _linearised(evidence, effect, joint, trial)

    def basis(
        self, evidence: Evidence, effect: AbstractBodyEffect, joint: int | None, piece: int, place: Parameters
    ) -> np.ndarray:
        moves = np.stack([inertial.reshape(-1) for inertial, *_ in effect.directions(evidence.robot, joint)])
        return body_columns(evidence.robot, moves, evidence.recording.pieces[piece].motion)


class Motions(AbstractKind[AbstractMotionEffect]):
    """The derivative of all torques by the error of the motion."""

    at_once = True

    def gathered(self, evidence: Evidence, effects: Sequence[AbstractMotionEffect]) -> list[Candidate]:
        made = []
        for effect in effects:
            for joint in range(evidence.dofs):
                straight, (name,) = _slope(evidence, effect, joint), effect.parameters
                made += [straight, *(_linearised(evidence, effect, joint, {name: x}, straight) for x in ZEROS)]
        return made

    def candidate(
        self, evidence: Evidence, effect: AbstractMotionEffect, joint: int, trial: Parameters, beside: Beside = ()
    ) -> Candidate:
        return _linearised(evidence, effect, joint, trial)

    def step(self, effect: AbstractEffect, name: str, value: float) -> float:
        return 1e-4


class Forces(AbstractKind[AbstractForceEffect]):
    """Torques that balance unit forces on the arm."""

    def gathered(self, evidence: Evidence, effects: Sequence[AbstractForceEffect]) -> list[Candidate]:
        places = [(e, j) for e in effects for j in (range(evidence.dofs) if e.of_joint else (None,))]
        return [self.candidate(evidence, effect, joint, {}) for effect, joint in places]

    def candidate(
        self, evidence: Evidence, effect: AbstractForceEffect, joint: int | None, trial: Parameters, beside: Beside = ()
    ) -> Candidate:
        count = len(evidence.recording.pieces)
        columns = filtered(evidence.recording, [self.basis(evidence, effect, joint, k, trial) for k in range(count)])
        where = {j: ((), evidence.append(j, list(columns[:, j]))) for j in range(evidence.dofs)}
        return Candidate(effect, joint, {}, where, effect.precision(evidence.robot, joint, len(columns)))

    def refined(
        self, evidence: Evidence, effect: AbstractForceEffect, joint: int | None, at: Parameters, beside: Beside = ()
    ) -> Candidate:
        return known(evidence, effect, joint)

    def basis(
        self, evidence: Evidence, effect: AbstractForceEffect, joint: int | None, piece: int, place: Parameters
    ) -> np.ndarray:
        return np.asarray(effect.placed(place, evidence.robot, joint, evidence.recording.pieces[piece].motion))


def _slope(evidence: Evidence, effect: AbstractMotionEffect, joint: int) -> Candidate:
    """A motion effect about zero."""
    (name,), slopes = effect.parameters, []
    for piece in evidence.recording.pieces:
        ends = [rigid_torque(evidence.robot, effect.true({name: x}, piece.motion, joint)) for x in (STEP, -STEP)]
        slopes.append((ends[0] - ends[1]) / (2 * STEP))
    columns = filtered(evidence.recording, slopes)
    where = {j: ((), evidence.append(j, [columns[j]])) for j in range(evidence.dofs)}
    return Candidate(effect, joint, {}, where, np.array([1 / MOST**2]))


def _linearised(
    evidence: Evidence, effect: AbstractEffect, joint: int | None, at: Parameters, about: Candidate | None = None
) -> Candidate:
    """An effect in addition to parameters that were already found: the change so far is fixed, its derivatives are
    those `about` zero."""
    base, made = about or known(evidence, effect, joint), change(evidence, EffectInstance(effect, joint, at))
    columns = {j: (evidence.append(j, [made[j]]), free) for j, (_, free) in base.columns.items()}
    return replace(base, shape=at, columns=columns)
