"""Candidates: the trials of all effects beside the logged torque. Each kind of effects makes its columns in a file of
its own; `KINDS` is the table of them.
"""

from collections.abc import Sequence
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
"""By the point at which effects act."""


def kind_of(effect: AbstractEffect) -> AbstractKind[Any]:
    """How this effect becomes columns."""
    return KINDS[effect.point]


def gather(
    robot: Robot, recording: Recording, effects: Sequence[AbstractEffect], side: str, position_side: str = "unknown"
) -> Evidence:
    """The evidence of a recording for all lasting effects that show on this torque side and this position side."""
    evidence = started(robot, recording)
    falls = np.linalg.norm(robot.gravity) > 0
    shown = [e for e in effects if side in e.sides and position_side in e.position_sides and not e.passing]
    shown = [e for e in shown if not e.sum_of]  # its parts are there
    shown = [e for e in shown if falls or not e.turns_gravity]
    order = list(KINDS.values())
    shown.sort(key=lambda e: order.index(kind_of(e)) if kind_of(e).at_once else len(order))
    for kind, own in groupby(shown, kind_of):
        evidence.candidates += kind.gathered(evidence, list(own))
    return evidence


def trial_at(evidence: Evidence, acting: EffectInstance, beside: Sequence[EffectInstance] = ()) -> Candidate:
    """The candidate of an effect at parameters that were found, beside others: its nonlinear ones tried there and
    nowhere else."""
    if acting.when is not None:
        return passing_candidate(evidence, acting.effect, acting.joint, acting.when)
    return kind_of(acting.effect).refined(evidence, acting.effect, acting.joint, acting.parameters, beside)


def passing_candidate(evidence: Evidence, effect: AbstractEffect, joint: int | None, when: TimeWindow) -> Candidate:
    """What comes and goes, in a window."""
    columns = passing_columns(evidence, effect, joint, when)
    felt = range(evidence.dofs) if effect.reaches_others or joint is None else (joint,)
    where = {j: ((), evidence.append(j, list(columns[:, j]))) for j in felt}
    return Candidate(effect, joint, {}, where, effect.precision(evidence.robot, joint, len(columns)), when=when)


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
        pieces, kind = range(len(evidence.recording.pieces)), kind_of(effect)
        evidence.kept[effect.name, joint] = [kind.basis(evidence, effect, joint, number) for number in pieces]
    return evidence.kept[effect.name, joint]
