"""What a log could not have shown: effects that may or may not be present."""

from collections.abc import Mapping, Sequence

import numpy as np

from invdyn_cli.diagnosis.checks.excitation import cannot_show
from invdyn_cli.diagnosis.search.equations import inverted
from invdyn_cli.diagnosis.search.feigned import EVIDENCE
from invdyn_cli.diagnosis.search.inquiry import Inquiry
from invdyn_cli.diagnosis.search.judge import Hypothesis, HypothesisScorer
from invdyn_cli.diagnosis.search.shared_part import precision_of
from invdyn_cli.interfaces import AbstractEffect
from invdyn_cli.joints import UsualJoint
from invdyn_cli.types import Examination, Finding

LIKE_LINKS = "links that are as wrong as those of this arm, or of URDFs usually, make the same torque on this motion"


def unseen(
    effects: Mapping[str, AbstractEffect],
    claims: Sequence[Finding],
    examination: Examination,
    side: str,
    position_side: str,
) -> list[Finding]:
    """What this log could not have shown: no claims, but where not to look for absence."""
    claimed = {(f.effect, f.joint) for f in claims}
    out = [
        Finding(
            name,
            None,
            "not_observable",
            advice=f"a torque measured at the {' or '.join(s for s in e.sides if s != 'unknown')} side",
            evidence={"why": f"a torque measured at the {side} does not contain it"},
        )
        for name, e in effects.items()
        if side not in e.sides
    ]
    out += [
        Finding(
            name,
            None,
            "not_observable",
            advice="angles of the motor, or on both sides of the gear",
            evidence={"why": f"angles measured at the {position_side} do not contain it"},
        )
        for name, e in effects.items()
        if position_side not in e.position_sides and side in e.sides
    ]
    for joint, numbers in examination.excitation.items():
        for name, why in cannot_show(numbers.get("lacks", {}), effects).items():
            if (name, joint) in claimed or name in {f.effect for f in out if f.joint is None}:
                continue
            advice = effects[name].advice
            out.append(Finding(name, joint, "not_excited", evidence={"why": why}, advice=advice))
    return out


def like_links(inquiry: Inquiry, claims: Sequence[Finding]) -> list[Finding]:
    """Errors of a joint's angle, and a payload, that would not be found on a worn arm: of a typical size they make,
    beside links that may be as wrong as the others are or as they usually are, less evidence than a claim needs."""
    judge, robot, made = inquiry.judge, inquiry.evidence.robot, list[Finding]()
    claimed = {(f.effect, f.joint) for f in claims}
    for c in inquiry.pool if inquiry.wear else ():
        joint = None if c.joint is None else robot.joints[c.joint]
        like = c.when is None and (c.effect.bends or c.effect.load)
        if not like or c.is_trial or (c.effect.name, joint) in claimed:
            continue
        usual = UsualJoint(robot, robot.dofs - 1 if c.joint is None else c.joint, *[1.0] * 7)
        typical = c.effect.typical(usual) or {}
        size = np.array(c.effect.coordinates(typical, robot, c.joint) or [*typical.values()])
        others = [x for x in inquiry.hypothesis if x.key != c.key]
        needed = ((EVIDENCE, inquiry.always), (judge.price((c,)), inquiry.always_usual))
        if any(_evidence(judge, (*always, *others, c), size) < least for least, always in needed):
            where = c.effect.name, joint
            made.append(Finding(*where, "not_excited", evidence={"why": LIKE_LINKS}, advice=c.effect.advice))
    return made


def _evidence(judge: HypothesisScorer, hypothesis: Hypothesis, size: np.ndarray) -> float:
    """Squares, in noise variances, that the last of a hypothesis makes with these coefficients (k,) and the others
    cannot."""
    own = inverted(judge.equations(hypothesis)[1], precision_of(hypothesis))[-len(size) :, -len(size) :]
    return float(size @ np.linalg.solve(own, size))
