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
from invdyn_cli.diagnosis.columns.shown import beside_gain
from invdyn_cli.effects.composition import EffectInstance, TimeWindow, weight
from invdyn_cli.interfaces import AbstractEffect, Parameters
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

NOWHERE: Parameters = {}
"""Of an effect that no parameter places on its link, or whose place is not known."""


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
        return passing_candidate(evidence, acting.effect, acting.joint, acting.when, acting.parameters)
    return kind_of(acting.effect).refined(evidence, acting.effect, acting.joint, acting.parameters, beside)


def passing_candidate(
    evidence: Evidence, effect: AbstractEffect, joint: int | None, when: TimeWindow, at: Parameters = NOWHERE
) -> Candidate:
    """The candidate of an effect in a time window; of a force that is placed on its link, where these parameters place
    it."""
    columns = passing_columns(evidence, effect, joint, when, at)
    shape = effect.found([0.0] * len(columns), at, evidence.robot, joint) if effect.placed_by in at else {}
    felt = range(evidence.dofs) if effect.reaches_others or joint is None else (joint,)
    where = {j: ((), evidence.append(j, list(columns[:, j]))) for j in felt}
    return Candidate(effect, joint, shape, where, effect.precision(evidence.robot, joint, len(columns)), when=when)


def passing_columns(
    evidence: Evidence, effect: AbstractEffect, joint: int | None, when: TimeWindow | None, at: Parameters = NOWHERE
) -> np.ndarray:
    """Columns (k, n, R) of an effect in a time window (None: without one), placed as in `passing_candidate`."""
    recording = evidence.recording
    shares = [weight(when, recording.stretch(piece)) for piece in recording.pieces]
    parts = passing(evidence, effect, joint, at)
    columns = filtered(recording, [x * share for x, share in zip(parts, shares, strict=True)])
    if effect.factor and joint is not None and evidence.shown is not None:
        there = [share * np.ones_like(piece.t) for piece, share in zip(recording.pieces, shares, strict=True)]
        inside, shown = filtered(recording, there, joint), evidence.shown[:, joint]
        if when is not None and evidence.reference_rows is None:
            shown = beside_gain(evidence, joint, inside)
        columns[:, joint] += inside * shown
    return columns


def passing_torque(evidence: Evidence, acting: EffectInstance, factors: np.ndarray) -> list[np.ndarray]:
    """(n, T) of every piece: the torque of an effect in a time window, for the factors (k,) of its columns."""
    recording = evidence.recording
    parts = passing(evidence, acting.effect, acting.joint, acting.parameters)
    return [
        weight(acting.when, recording.stretch(piece)) * np.tensordot(factors, x, 1)
        for piece, x in zip(recording.pieces, parts, strict=True)
    ]


def passing(
    evidence: Evidence, effect: AbstractEffect, joint: int | None, at: Parameters = NOWHERE
) -> list[np.ndarray]:
    """Columns (k, n, T) of every piece for an effect in a time window. Cached: those where nothing places it, and what
    they change with its place."""
    key, pieces = (effect.name, joint), range(len(evidence.recording.pieces))
    if key not in evidence.kept:
        evidence.kept[key] = [kind_of(effect).basis(evidence, effect, joint, number, NOWHERE) for number in pieces]
    origin = evidence.kept[key]
    if effect.placed_by not in at:
        return origin
    key = (*key, "by place")
    if key not in evidence.kept:
        evidence.kept[key] = [np.stack(x) for x in zip(*by_place(evidence, effect, joint, origin), strict=True)]
    point = at[effect.placed_by]
    return [x + np.tensordot(point, slopes, 1) for x, slopes in zip(origin, evidence.kept[key], strict=True)]


def by_place(
    evidence: Evidence, effect: AbstractEffect, joint: int | None, origin: Sequence[np.ndarray]
) -> Iterable[list[np.ndarray]]:
    """What the columns (k, n, T) of every piece change by a metre along each axis of the joint's frame."""
    for axis in np.eye(3):
        place = {effect.placed_by: axis}
        there = (kind_of(effect).basis(evidence, effect, joint, number, place) for number in range(len(origin)))
        yield [x - before for x, before in zip(there, origin, strict=True)]
