"""Columns of gears that deflect under their load."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Candidate, Evidence, filtered
from invdyn_cli.diagnosis.columns.kind import AbstractKind, Beside, change, nominal
from invdyn_cli.effects.composition import LEAST_INERTIA, EffectInstance, identity, inertia_column, link_torque
from invdyn_cli.effects.rigid import rigid_torque
from invdyn_cli.interfaces import AbstractEffect, AbstractGearEffect, Parameters
from invdyn_cli.maths.threads import side_by_side
from invdyn_cli.types import Array

ANGLE_STEP = 1e-3
"""[rad; m] Step of the slope of a torque over a joint's angle."""

STRAIGHT = 0.005
"""[rad] Largest deflection of a gear up to which torques are linear in its angle."""

YIELD = 0.1
"""Relative step of finite differences in the compliance of a gear: play shows at its edges, which move by samples."""


class Yields(NamedTuple):
    """What a gear that yields changes of the torque with others, and the change with its compliance, (n, R) each; how
    far it yields [rad; m]."""

    fixed: np.ndarray
    slope: np.ndarray
    far: float


class Gears(AbstractKind[AbstractGearEffect]):
    """A gear with a compliance: the torque change that it makes together with other effects (fixed), and the derivative
    by its compliance (free)."""

    def gathered(self, evidence: Evidence, effects: Sequence[AbstractGearEffect]) -> list[Candidate]:
        places = [(effect, joint) for effect in effects for joint in range(evidence.dofs)]
        trials = [(*at, shape) for at in places for shape in shapes_of(evidence, *at)]
        yields = side_by_side(lambda at: _yields(evidence, *at), trials)
        return [self.candidate(evidence, *at, yields=one) for at, one in zip(trials, yields, strict=True)]

    def candidate(
        self,
        evidence: Evidence,
        effect: AbstractGearEffect,
        joint: int,
        trial: Parameters,
        beside: Beside = (),
        exact: bool = False,
        yields: Yields | None = None,
    ) -> Candidate:
        """`exact`: the fixed column from the full formula, also for a small deflection; `yields`: of these parameters,
        where they are known."""
        fixed, slope, _ = yields or _yields(evidence, effect, joint, trial, beside, exact)
        columns = {}
        for j in range(evidence.dofs):
            numbers = evidence.append(j, [fixed[j], slope[j]])
            columns[j] = numbers[:1], numbers[1:]
        return Candidate(effect, joint, trial, columns, np.array([1 / (0.3 * effect.compliance(trial)) ** 2]))

    def refined(
        self, evidence: Evidence, effect: AbstractGearEffect, joint: int, at: Parameters, beside: Beside = ()
    ) -> Candidate:
        return self.candidate(evidence, effect, joint, at, beside, exact=True)

    def slope(
        self,
        evidence: Evidence,
        effect: AbstractGearEffect,
        joint: int,
        before: Parameters,
        after: Parameters,
        beside: Beside,
    ) -> np.ndarray:
        softer = effect.compliance(after) - effect.compliance(before)
        return _columns(evidence, effect, joint, before, beside).slope * softer

    def step(self, effect: AbstractEffect, name: str, value: float) -> float:
        return max(3e-2 * value, 1e-6)


def shapes_of(evidence: Evidence, effect: AbstractGearEffect, joint: int) -> Sequence[Parameters]:
    """The trials of a gear on a joint."""
    load, inertia = (np.concatenate(x) for x in zip(*_carried(evidence, joint), strict=True))
    if inertia.min() <= LEAST_INERTIA:  # links without inertia follow any gear: nothing of it shows
        return []
    shapes, dragged = effect.shapes(load, inertia, evidence.recording.filter.rate), evidence.dragged.get(joint, {})
    own = {name: x for name, x in dragged.items() if name in effect.parameters}
    return [*shapes, *({**shape, **own} for shape in shapes if own)]


def torque(evidence: Evidence, effect: AbstractGearEffect, joint: int, parameters: Parameters) -> np.ndarray:
    """(n, R) what a gear that yields changes of the torque, to first order in its deflection."""
    parts = _yielded(evidence, effect, joint, parameters, _carried(evidence, joint))
    return filtered(evidence.recording, [x for x, _ in parts])


def load_on(evidence: Evidence, joint: int, beside: Beside = ()) -> np.ndarray:
    """(T,) of all pieces: the torque that a joint transmits with other effects."""
    return np.concatenate([load for load, _ in _carried(evidence, joint, beside)])


def inertia_on(evidence: Evidence, joint: int) -> float:
    """The mean inertia that a joint carries [kg m^2; kg], above zero."""
    every = np.concatenate([mass[joint] for mass, _ in _answers(evidence, joint)])
    return float(np.mean(np.maximum(every, LEAST_INERTIA)))


def _yields(
    evidence: Evidence,
    effect: AbstractGearEffect,
    joint: int,
    parameters: Parameters,
    beside: Beside = (),
    exact: bool = False,
) -> Yields:
    """What a gear changes to first order, or by the full formula where that is asked or it yields far."""
    made = _columns(evidence, effect, joint, parameters, beside)
    if exact or made.far > STRAIGHT:
        return made._replace(fixed=change(evidence, EffectInstance(effect, joint, parameters), beside))
    return made


def _columns(
    evidence: Evidence, effect: AbstractGearEffect, joint: int, parameters: Parameters, beside: Beside = ()
) -> Yields:
    """What a gear changes to first order: it goes with the acceleration of link against motor, and with their angle."""
    recording, carried = evidence.recording, _carried(evidence, joint, beside)
    compliance = effect.compliance(parameters)

    def yielded(factor: float) -> list[tuple[np.ndarray, float]]:
        return _yielded(evidence, effect, joint, effect.as_soft(parameters, factor * compliance), carried)

    softer = [more - less for (more, _), (less, _) in zip(yielded(1 + YIELD), yielded(1 - YIELD), strict=True)]
    parts, far = zip(*yielded(1.0), strict=True)
    return Yields(filtered(recording, parts), filtered(recording, softer) / (2 * YIELD * compliance), max(far))


def _yielded(
    evidence: Evidence,
    effect: AbstractGearEffect,
    joint: int,
    parameters: Parameters,
    carried: Sequence[tuple[Array, Array]],
) -> list[tuple[np.ndarray, float]]:
    """For every piece what the gear changes of the torque (n, T), not filtered, and how far it yields [rad; m]."""
    made = []
    pieces = evidence.recording.pieces
    for (load, inertia), (mass, slope), piece in zip(carried, _answers(evidence, joint), pieces, strict=True):
        load = load + effect.drag(parameters, piece.qd[joint])
        b, b2 = effect.deflection(parameters, load, inertia, evidence.recording.filter.rate)
        made.append((mass * b2 + slope * b, float(np.abs(b).max())))
    return made


def _carried(evidence: Evidence, joint: int, beside: Beside = ()) -> list[tuple[Array, Array]]:
    """For every piece the torque (T,) that a joint transmits with other effects, cached, and the inertia (T,) that it
    carries."""
    key = ("load", joint, identity(beside))
    if key not in evidence.kept:
        robot, recording = evidence.robot, evidence.recording
        evidence.kept[key] = [
            link_torque(robot, beside, p.motion, recording.stretch(p))[joint] if beside else s[joint].transmitted
            for p, s in zip(recording.pieces, evidence.states, strict=True)
        ]
    inertias = [mass[joint] for mass, _ in _answers(evidence, joint)]
    return list(zip(evidence.kept[key], inertias, strict=True))


def _answers(evidence: Evidence, joint: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """For every piece the torques (n, T) for unit acceleration of a joint, and their derivative by its angle;
    cached."""
    if ("answers", joint) not in evidence.kept:
        robot, own = evidence.robot, (np.arange(evidence.dofs) == joint)[:, None]
        evidence.kept["answers", joint] = [
            (
                inertia_column(robot, piece.q, joint),
                (rigid_torque(robot, replace(piece.motion, q=piece.q + ANGLE_STEP * own)) - nominal(states))
                / ANGLE_STEP,
            )
            for piece, states in zip(evidence.recording.pieces, evidence.states, strict=True)
        ]
    return evidence.kept["answers", joint]
