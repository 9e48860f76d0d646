"""Candidates: the trials of all effects, as columns beside the logged torque."""

from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import Any

import numpy as np

from invdyn_cli.diagnosis.columns.bodies import Bodies, Forces, Motions
from invdyn_cli.diagnosis.columns.channels import Channels
from invdyn_cli.diagnosis.columns.evidence import Candidate, Evidence, filtered, started
from invdyn_cli.diagnosis.columns.gears import Gears
from invdyn_cli.diagnosis.columns.joint_torques import JointTorques
from invdyn_cli.diagnosis.columns.kind import AbstractKind
from invdyn_cli.effects.composition import EffectInstance, TimeWindow, weight
from invdyn_cli.interfaces import AbstractEffect
from invdyn_cli.recording.pieces import Recording
from invdyn_cli.types import Robot

KINDS: dict[str, AbstractKind[Any]] = {
    "body": Bodies(),
    "motion": Motions(),
    "gear": Gears(),
    "force": Forces(),
    "torque": JointTorques(),
    "channel": Channels(),
}
"""Kinds by the point at which their effects act."""


def kind_of(effect: AbstractEffect) -> AbstractKind[Any]:
    """How this effect becomes columns."""
    return KINDS[effect.point]


def gather(
    robot: Robot, recording: Recording, effects: Sequence[AbstractEffect], side: str, position_side: str = "unknown"
) -> Evidence:
    """The evidence of a recording for all effects without a time window that this torque side and position side show.
    Those that depend on the torque that a joint transmits, which other links change, are its `loaded` effects; their
    candidates are made by `add_loaded`."""
    evidence = started(robot, recording)
    falls = np.linalg.norm(robot.gravity) > 0
    shown = [e for e in shown_by(effects, side, position_side) if not e.passing and not e.sum_of]  # its parts are there
    shown = [e for e in shown if falls or not e.turns_gravity]
    order = list(KINDS.values())
    shown.sort(key=lambda e: order.index(kind_of(e)) if kind_of(e).at_once else len(order))
    evidence.loaded = tuple(e for e in shown if e.loaded)
    _add(evidence, [e for e in shown if not e.loaded])
    return evidence


def shown_by(effects: Iterable[AbstractEffect], side: str, position_side: str) -> list[AbstractEffect]:
    """Those that a torque and an angle show that were taken on these sides of the gear."""
    return [e for e in effects if side in e.sides and position_side in e.position_sides]


def add_loaded(evidence: Evidence) -> None:
    """Make the candidates of the effects that `gather` has left out, where nobody has."""
    if not any(c.effect.loaded for c in evidence.candidates):
        _add(evidence, evidence.loaded)


def _add(evidence: Evidence, effects: Sequence[AbstractEffect]) -> None:
    for kind, own in groupby(effects, kind_of):
        evidence.candidates += kind.gathered(evidence, list(own))


def trial_at(evidence: Evidence, acting: EffectInstance, beside: Sequence[EffectInstance] = ()) -> Candidate:
    """The candidate of an effect at parameters that were found, together with others: its nonlinear parameters are
    tried only there."""
    if acting.when is not None:
        return passing_candidate(evidence, acting.effect, acting.joint, acting.when)
    return kind_of(acting.effect).refined(evidence, acting.effect, acting.joint, acting.parameters, beside)


def passing_candidate(evidence: Evidence, effect: AbstractEffect, joint: int | None, when: TimeWindow) -> Candidate:
    """The candidate of an effect in a time window."""
    columns = passing_columns(evidence, effect, joint, when)
    felt = range(evidence.dofs) if effect.reaches_others or joint is None else (joint,)
    where = {j: ((), evidence.append(j, list(columns[:, j]))) for j in felt}
    return Candidate(effect, joint, {}, where, effect.precision(evidence.robot, joint, len(columns)), when=when)


def passing_columns(
    evidence: Evidence, effect: AbstractEffect, joint: int | None, when: TimeWindow | None
) -> np.ndarray:
    """Columns (k, n, R) of an effect in a time window; None: of the effect without one."""
    recording = evidence.recording
    shares = [weight(when, recording.stretch(piece)) for piece in recording.pieces]
    parts = _passing(evidence, effect, joint)
    columns = filtered(recording, [x * share for x, share in zip(parts, shares, strict=True)])
    if effect.factor and joint is not None and evidence.shown is not None:
        there = [share * np.ones_like(piece.t) for piece, share in zip(recording.pieces, shares, strict=True)]
        columns[:, joint] += filtered(recording, there, joint) * evidence.shown[:, joint]
    return columns


def passing_torque(evidence: Evidence, acting: EffectInstance, factors: np.ndarray) -> list[np.ndarray]:
    """(n, T) of every piece: the torque of an effect in a time window, for the factors (k,) of its columns."""
    recording = evidence.recording
    parts = _passing(evidence, acting.effect, acting.joint)
    return [
        weight(acting.when, recording.stretch(piece)) * np.tensordot(factors, x, 1)
        for piece, x in zip(recording.pieces, parts, strict=True)
    ]


def _passing(evidence: Evidence, effect: AbstractEffect, joint: int | None) -> list[np.ndarray]:
    """Columns (k, n, T) of every piece for an effect in a time window, cached."""
    if (effect.name, joint) not in evidence.kept:
        pieces, kind = range(len(evidence.recording.pieces)), kind_of(effect)
        evidence.kept[effect.name, joint] = [kind.basis(evidence, effect, joint, number) for number in pieces]
    return evidence.kept[effect.name, joint]
