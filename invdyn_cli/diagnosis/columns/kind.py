"""What the diagnosis needs of a kind of effects: how they become columns beside the logged torque."""

import abc
from collections.abc import Sequence
from typing import Any, Generic, TypeVar

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Candidate, Evidence, filtered
from invdyn_cli.effects.composition import EffectInstance, identity, link_torque
from invdyn_cli.errors import UsageError
from invdyn_cli.interfaces import AbstractEffect, JointState, Parameters

E = TypeVar("E", bound=AbstractEffect)

Beside = Sequence[EffectInstance]
"""The other effects at work."""


class AbstractKind(abc.ABC, Generic[E]):
    """How effects that act at one point become columns; `candidates.KINDS` lists all of them."""

    at_once: bool = False
    """Whether `gathered` processes all effects of the kind together, before those of other kinds."""

    @abc.abstractmethod
    def gathered(self, evidence: Evidence, effects: Sequence[E]) -> list[Candidate]:
        """Every trial of effects without a time window, on all joints where they are observable."""

    @abc.abstractmethod
    def candidate(self, evidence: Evidence, effect: E, joint: Any, trial: Parameters, beside: Beside = ()) -> Candidate:
        """The trial of an effect at these parameters, together with others."""

    def refined(self, evidence: Evidence, effect: E, joint: Any, at: Parameters, beside: Beside = ()) -> Candidate:
        """The candidate of an effect at parameters that were found, together with others."""
        return self.candidate(evidence, effect, joint, at, beside)

    def basis(self, evidence: Evidence, effect: E, joint: Any, piece: int, place: Parameters) -> np.ndarray:
        """Columns (k, n, T) of a piece, for an effect that may act in a time window, where `place` has it; UsageError
        for one that cannot."""
        got = f"{effect.name} acts on {effect.point}, and such an effect cannot act in a time window (passing = True)"
        raise UsageError(f"{got}; allowed in a window: effects on bodies, forces, and channels that have a factor")

    def slope(
        self, evidence: Evidence, effect: E, joint: Any, before: Parameters, after: Parameters, beside: Beside
    ) -> np.ndarray | None:
        """(n, R) change of the torque from one set of parameters to a near one; None where the formula itself gives it
        best."""
        return None

    def step(self, effect: AbstractEffect, name: str, value: float) -> float:
        """The step of a parameter in finite differences."""
        if name == effect.late_by:
            return 2e-4
        if name in ("velocity", "stiffness"):
            return max(1e-2 * abs(value), 1e-6)
        return 1e-4 * max(abs(value), 1e-2)


def known(evidence: Evidence, effect: AbstractEffect, joint: int | None) -> Candidate:
    """The candidate of an effect that is tried once, without parameters."""
    return next(c for c in evidence.candidates if c.key == (effect.name, joint) and not c.shape)


def nominal(states: Sequence[JointState]) -> np.ndarray:
    """(n, T) torques of the nominal model in a piece's states."""
    return np.stack([np.asarray(s.transmitted) for s in states])


def change(evidence: Evidence, acting: EffectInstance, beside: Beside = ()) -> np.ndarray:
    """(n, R) torque change by an effect that acts on several joints, together with others."""
    robot, recording = evidence.robot, evidence.recording
    key, changes = ("change", identity(beside)), []
    common = evidence.kept.setdefault(key, [{} for _ in recording.pieces])
    for piece, states, kept in zip(recording.pieces, evidence.states, common, strict=True):
        stretch = recording.stretch(piece)
        before = link_torque(robot, beside, piece.motion, stretch, kept) if beside else nominal(states)
        changes.append(link_torque(robot, (*beside, acting), piece.motion, stretch, kept) - before)
    return filtered(recording, changes)
