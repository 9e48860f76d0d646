"""The composed model compared with the record, with the exact formulas of the effects: a gain scales the friction
behind it, a payload changes the load of the gear, and nothing is linearised."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from invdyn_cli.diagnosis.columns.candidates import passing_torque
from invdyn_cli.diagnosis.columns.evidence import Evidence, filtered
from invdyn_cli.diagnosis.columns.joint_torques import carrying
from invdyn_cli.diagnosis.search.coordinates import coordinates
from invdyn_cli.diagnosis.search.judge import Hypothesis
from invdyn_cli.diagnosis.search.slopes import Slopes
from invdyn_cli.effects.composition import (
    EffectInstance,
    channel,
    delivered,
    identity,
    joint_terms,
    link_torque,
    shares,
)
from invdyn_cli.types import Array

MOTIONS = 40
"""Number of link motions behind gears that are cached for every piece, so that a change of one gear does not empty the
cache."""

TERMS = 60
"""Number of terms of torque effects that are cached: parameters are moved one by one, and bristles are slow."""


@dataclass(frozen=True)
class Refined:
    """Effects with refined parameters, what each moves by, and the residual that they leave.

    Attributes:
        acting: the effects.
        theta: (k,) all parameters in one row; `labels` (effect number, parameter, index) says which.
        replicas: parameters (B, k) with one block left out each, and (B, k) with one recording where there are some:
            their spread is the uncertainty (jackknife).
        unknown: (m, k) independent moves of the parameters by a standard error each, from the noise alone and what was
            known beforehand: what the data do not show moves as far as it may.
        residual: (R, n) logged less modelled torque, filtered, without what is allowed for.
        allowed: (m,) coefficients of what is allowed for, `always`.
    """

    acting: tuple[EffectInstance, ...]
    theta: np.ndarray
    labels: tuple[tuple[int, str, int], ...]
    replicas: tuple[np.ndarray, ...]
    unknown: np.ndarray
    residual: np.ndarray
    always: Hypothesis = ()
    allowed: np.ndarray = field(default_factory=lambda: np.zeros(0))


class Model:
    """The residual of composed effects on all rows of the evidence; torques of bodies are cached while the bodies stay
    the same."""

    def __init__(self, evidence: Evidence) -> None:
        self.evidence = evidence
        self.rate = evidence.recording.filter.rate
        self._base = evidence.base or [np.zeros_like(p.q) for p in evidence.recording.pieces]
        self._bodies: dict[tuple, list[np.ndarray]] = {}
        self._rows: dict[tuple, np.ndarray] = {}
        self._gears: list[dict] = [{} for _ in evidence.recording.pieces]
        self._terms: dict[tuple, list[Array]] = {}
        self.scanned: dict[tuple, float] = {}
        """The last refined value of each gear, by its key and the number of rows, from distant and near start
        values."""

    def residual(self, acting: Sequence[EffectInstance]) -> np.ndarray:
        """(R, n) [N m; N] logged torque (with its channel inverted) minus modelled torque."""
        bodies = self._moved(acting)
        out = np.column_stack([self._row(acting, bodies, j) for j in range(self.evidence.dofs)])
        compared = self.evidence.reference_rows
        if compared is not None and len(acting):  # what was hidden since is not in the reference
            out[compared] = self.residual(())[compared]
        return out

    def without(self, refined: Refined, acting: Sequence[EffectInstance]) -> np.ndarray:
        """(R, n) the residual with these effects instead of the refined ones; the effects that are allowed for stay the
        same."""
        return self.residual(acting) - self.allowed(refined, acting)

    def allowed(self, refined: Refined, acting: Sequence[EffectInstance], count: int | None = None) -> np.ndarray:
        """(R, n) logged torque of what is allowed for, or of the last `count` coefficients of it, where these effects
        act."""
        theta = refined.allowed.copy()
        theta[: 0 if count is None else len(theta) - count] = 0.0
        torque = Slopes.free(self.evidence, refined.always).torque(theta)
        return self.evidence.logged(acting, torque[None])[0]

    def _moved(self, acting: Sequence[EffectInstance]) -> tuple:
        """The key of the inverse dynamics (n, T) of every piece with the effects that reach more than one joint, which
        are there. What comes and goes adds to that of the nominal motion, its columns being at hand; but a gear yields
        to it."""
        whole = [a for a in acting if a.effect.reaches_others]
        key = identity(whole)
        if key not in self._bodies:
            if len(self._bodies) > 40:
                self._bodies.clear()
            lasting = [a for a in whole if a.when is None]
            if lasting == whole or any(a.effect.yields for a in whole):
                robot, recording = self.evidence.robot, self.evidence.recording
                made = []
                for piece, kept, base in zip(recording.pieces, self._gears, self._base, strict=True):
                    if len(kept) > MOTIONS:
                        kept.clear()
                    made.append(base + link_torque(robot, whole, piece.motion, recording.stretch(piece), kept))
            else:
                made = self._bodies[self._moved(lasting)]
                for one in whole:
                    if one.when is not None:
                        torques = passing_torque(self.evidence, one, np.array(coordinates(self.evidence, one)))
                        made = [body + x for body, x in zip(made, torques, strict=True)]
            self._bodies[key] = made
        return key

    def _row(self, acting: Sequence[EffectInstance], bodies: tuple, j: int) -> np.ndarray:
        own = self._own(acting, j)
        key = (bodies, j, identity(own))
        if key not in self._rows:
            if len(self._rows) > 400:
                self._rows.clear()
            self._rows[key] = filtered(self.evidence.recording, self._parts(own, bodies, j), j)
        return self._rows[key]

    def unfiltered(self, acting: Sequence[EffectInstance], j: int) -> list[np.ndarray]:
        """A joint's residual (T,) in every piece before the filter."""
        return self._parts(self._own(acting, j), self._moved(acting), j)

    def _own(self, acting: Sequence[EffectInstance], joint: int) -> list[EffectInstance]:
        """The torque and channel effects that act on a joint."""
        parents = self.evidence.robot.parents
        return [a for a in acting if not a.effect.reaches_others and joint in shares(a, parents)]

    def _parts(self, own: Sequence[EffectInstance], bodies: tuple, j: int) -> list[np.ndarray]:
        parts = []
        pieces, moved = self.evidence.recording.pieces, self._bodies[bodies]
        back = [a for a in own if a.effect.invertible]
        forth = [a for a in own if not a.effect.invertible]
        terms = self._unloaded([a for a in own if not a.effect.loaded], j)
        for one in own:
            if one.effect.loaded:
                terms = [x + y for x, y in zip(terms, self._loaded(one, moved, j), strict=True)]
        for piece, body, term in zip(pieces, moved, terms, strict=True):
            tau = np.asarray(channel(back, j, body[j] + term, self.evidence.recording.stretch(piece)))
            parts.append(delivered(forth, j, piece.tau[j], self.rate) - tau)
        return parts

    def _loaded(self, one: EffectInstance, moved: Sequence[np.ndarray], j: int) -> list[Array]:
        """For every piece the torque (T,) on a joint of an effect that depends on what its own joint transmits, which
        is that of these inverse dynamics."""
        own, robot = one.joint, self.evidence.robot
        assert own is not None
        loads = [body[own] - base[own] for body, base in zip(moved, self._base, strict=True)]
        states = carrying(self.evidence, [s[own] for s in self.evidence.states], loads, own)
        there = [[*s[:own], x, *s[own + 1 :]] for s, x in zip(self.evidence.states, states, strict=True)]
        return [np.asarray(sum(joint_terms([one], j, x, robot.parents))) for x in there]

    def _unloaded(self, own: Sequence[EffectInstance], j: int) -> list[Array]:
        """For every piece the torque (T,) on a joint of those torque effects that do not depend on what it transmits;
        cached."""
        parents, all_states = self.evidence.robot.parents, self.evidence.states
        total: list[Array] = [np.zeros_like(states[j].q) for states in all_states]
        for one in own:
            key = j, identity([one])
            if key not in self._terms:
                if len(self._terms) > TERMS:
                    self._terms.clear()
                self._terms[key] = [np.asarray(sum(joint_terms([one], j, x, parents))) for x in all_states]
            total = [a + b for a, b in zip(total, self._terms[key], strict=True)]
        return total
