"""Columns of effects that add to one joint's torque: those of `basis`, for every trial of the nonlinear parameters."""

from collections.abc import Sequence

import numpy as np

from invdyn_cli.diagnosis.checks.excitation import Excitation
from invdyn_cli.diagnosis.columns.evidence import Candidate, Evidence, filtered
from invdyn_cli.diagnosis.columns.kind import AbstractKind, Beside, known
from invdyn_cli.effects.composition import EffectInstance, has_driver, joint_terms, shares
from invdyn_cli.effects.friction import STICK_TIME, about_reversals
from invdyn_cli.interfaces import AbstractTorqueEffect, JointState, Parameters
from invdyn_cli.types import Array

TOGETHER = Excitation.together
"""Part of the time in which either of two joints moves, in which both have to."""


class JointTorques(AbstractKind[AbstractTorqueEffect]):
    """Friction, springs, rotors, offsets."""

    def gathered(self, evidence: Evidence, effects: Sequence[AbstractTorqueEffect]) -> list[Candidate]:
        made = []
        for effect in effects:
            for joint in range(evidence.dofs):
                if not effect.coupled or (has_driver(evidence.robot, joint) and _together(evidence, joint)):
                    # what the shapes depend on is the same for all pieces: the longest one tells
                    longest = max((s[joint] for s in evidence.states), key=lambda s: len(s.t))
                    made += [self.candidate(evidence, effect, joint, shape) for shape in effect.shapes(longest)]
        return made

    def candidate(
        self, evidence: Evidence, effect: AbstractTorqueEffect, joint: int, trial: Parameters, beside: Beside = ()
    ) -> Candidate:
        """The columns are added to the joint's table; those of a coupled effect also to that of the joint before it,
        with the same coefficients."""
        parts, precision = [], np.zeros(len(effect.basis(evidence.states[0][joint], trial)))
        states = [s[joint] for s in evidence.states]
        if effect.loaded:
            states = carrying(evidence, states, [s.transmitted for s in states], joint)
        for s in states:
            columns = list(effect.basis(s, trial))
            if effect.jumps:
                columns += about_reversals(effect.jump(columns), evidence.recording.filter.rate)
            parts.append(np.stack(columns))
        numbers = evidence.append(joint, list(filtered(evidence.recording, parts, joint)))
        where: dict[int, tuple] = {joint: ((), numbers)}
        if effect.coupled:
            driver, share = evidence.robot.parents[joint], effect.share_on_driver(trial)
            where[driver] = (), evidence.append(driver, list(share * filtered(evidence.recording, parts, driver)))
        if len(numbers) > len(precision):
            level = np.sqrt(np.mean(evidence.tables[joint][:, 0] ** 2))
            unit = np.sqrt(np.mean(np.concatenate([p[0] for p in parts], axis=-1) ** 2))
            timing = 1 / max(STICK_TIME * level / max(unit, 1e-12), 1e-12) ** 2
            precision = np.append(precision, np.full(len(numbers) - len(precision), timing))
        return Candidate(effect, joint, trial, where, precision)

    def refined(
        self, evidence: Evidence, effect: AbstractTorqueEffect, joint: int, at: Parameters, beside: Beside = ()
    ) -> Candidate:
        shape = effect.shape_of(at)
        return self.candidate(evidence, effect, joint, shape) if shape else known(evidence, effect, joint)


def carrying(
    evidence: Evidence, states: Sequence[JointState], torques: Sequence[Array], joint: int
) -> list[JointState]:
    """A joint's state in every piece with the torque (T,) that its gear transmits, in the joint's band: above it the
    noise of accelerations, of which an absolute value has a mean, may be larger than the load."""
    heard = evidence.recording.filter.slowed(joint, [np.asarray(x) for x in torques])
    return [s._replace(transmitted=x) for s, x in zip(states, heard, strict=True)]


def _together(evidence: Evidence, joint: int) -> bool:
    """Whether a joint and the one before it move at the same time for a part of that in which either does: where they
    move one after the other, friction of a drive that both turn is that of each."""
    own, before = (evidence.valid[:, j] for j in (joint, evidence.robot.parents[joint]))
    return bool(np.sum(own & before) > TOGETHER * np.sum(own | before))


def reversal_columns(evidence: Evidence, one: EffectInstance) -> list[dict[int, np.ndarray]]:
    """The corrections of an effect that jumps, for jumps that are late or spread (`about_reversals`): for each a column
    (R,) on every joint that the effect acts on."""
    assert one.joint is not None
    parents, rate = evidence.robot.parents, evidence.recording.filter.rate
    terms = [np.asarray(sum(joint_terms([one], one.joint, states, parents))) for states in evidence.states]
    return [
        {
            j: share * filtered(evidence.recording, list(parts), j)
            for j, share in shares(one, parents).items()
            if j is not None
        }
        for parts in zip(*(about_reversals(x, rate) for x in terms), strict=True)
    ]
