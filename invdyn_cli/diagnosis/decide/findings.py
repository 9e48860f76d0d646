"""From a hypothesis to findings: what is named, what stays ambiguous, what this log could not have shown, and in words.

A name is given only where data that did not choose it gain by it, no rival does as well, and what stays unexplained on
its joint does not outweigh it.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Candidate, Evidence, held_out, judged
from invdyn_cli.diagnosis.columns.gears import inertia_on
from invdyn_cli.diagnosis.decide import bodies, claim, passing, sums
from invdyn_cli.diagnosis.decide.claim import left, refitted
from invdyn_cli.diagnosis.decide.doubt import BEYOND, UNKNOWN, or_else
from invdyn_cli.diagnosis.decide.gain import gains_of, lowers
from invdyn_cli.diagnosis.decide.intervals import intervals, reach, with_edges
from invdyn_cli.diagnosis.decide.not_shown import like_links, unseen
from invdyn_cli.diagnosis.decide.quantities import plain, quantities, tried
from invdyn_cli.diagnosis.decide.refusals import REFUSALS, Refusal, Refused, over_unknown, supported
from invdyn_cli.diagnosis.search import naming, resting
from invdyn_cli.diagnosis.search.composed import Refined
from invdyn_cli.diagnosis.search.coordinates import EDGES
from invdyn_cli.diagnosis.search.exact import refine
from invdyn_cli.diagnosis.search.inquiry import Inquiry
from invdyn_cli.diagnosis.search.judge import Hypothesis
from invdyn_cli.diagnosis.search.likely import is_plain
from invdyn_cli.diagnosis.search.realisable import realisable
from invdyn_cli.effects.composition import EffectInstance
from invdyn_cli.effects.friction import StribeckFriction
from invdyn_cli.interfaces import AbstractEffect
from invdyn_cli.types import Examination, Finding, Robot

NO_BODY = 0.1
"""Share of the evidence for a body that inertials which can be may lose at most: a slightly wrong model loses a percent
(`invdyn experiment confusion`), bristles that were told as a payload for 0.7 s lost a quarter."""

PLAINLY, ELSEWHERE = 0.8, 4.0
"""Share of another joint's error from which a gear plainly lowers it; and multiple of what a gear may save on its own
joint that it may save there, per inertia: one, but for the part that terms of its own joint take over."""

VAGUE = 0.1
"""Of a ripple's cycles, by which they may be unknown."""


@dataclass(frozen=True)
class Made:
    """Findings, the effects behind the claims among them with their terms (R, n), and residuals (R, n).

    Attributes:
        hypothesis: the effects behind the claims, as the search tried them.
        before: of the nominal model; `residual` of the effects fitted on the data that chose them, both beside what is
            allowed for; `alone` and `whole` of the effects without that, fitted on the data that chose them and on all.
        refused: the candidates of the search that are not claimed.
    """

    findings: tuple[Finding, ...]
    hypothesis: Hypothesis
    acting: tuple[EffectInstance, ...]
    intervals: tuple[Mapping[str, tuple], ...]
    terms: tuple[np.ndarray, ...]
    before: np.ndarray
    residual: np.ndarray
    alone: np.ndarray
    whole: np.ndarray
    refused: tuple[Refused, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Sized:
    """The effects behind claims with their final sizes.

    Attributes:
        whole: refined on all rows; payloads and links are bodies, and windows have the edges that rests allow.
        wanted, ends: {parameter: (value, lower, upper)} of each effect, before that and finally.
        notes: sentences on bodies that the data want otherwise.
        costs: what it costs in noise variances that these are bodies, by their places.
    """

    whole: Refined
    wanted: list[dict[str, tuple]]
    ends: list[dict[str, tuple]]
    notes: tuple[str, ...]
    costs: Mapping[int, float]


def report(
    inquiry: Inquiry,
    effects: Mapping[str, AbstractEffect],
    examination: Examination,
    side: str,
    position_side: str = "unknown",
    unsure: Hypothesis = (),
    refusals: Sequence[Refusal] = REFUSALS,
) -> Made:
    """Everything that can be claimed of a log. What is `unsure` takes no part in it, but the sizes are no surer than
    beside it."""
    inquiry, supporting, (whole, chosen), refused = supported(inquiry, refusals)
    hypothesis, nothing = tuple(x.candidate for x in supporting), refitted(inquiry, [], inquiry.judge.rows)
    after, sized = left(inquiry, hypothesis), sizes(inquiry, whole, unsure)
    terms = [_term(inquiry, sized.whole.acting, i) for i in range(len(hypothesis))]
    parts = {k: one for one in sums.standing(effects, hypothesis, sized.ends) for k in one.places}
    claims, places, shown = [], [], []
    for i, x in enumerate(supporting):
        one = parts.get(i)
        if one is not None and i != one.places[0]:
            continue
        finding = _finding(inquiry, x, sized, terms[i])
        if one is not None:
            finding = _summed(inquiry, hypothesis, sized.whole, finding, one, after)
        own = (i,) if one is None else one.places
        claims.append(_doubted(inquiry, effects, x, sized, finding))
        shown.append(np.sum([terms[k] for k in own], axis=0))
        places += own
    claims, doubt = bodies.other_robot(passing.doubted(claims, inquiry.evidence.recording.ends))
    order = sorted(range(len(claims)), key=lambda k: (claims[k].group == "standard", -lowers([claims[k]])))
    ordered = tuple(claims[k] for k in order)
    acting = tuple(sized.whole.acting[k] for k in places)
    remarks = filter(None, (a.effect.remark(a.parameters, inquiry.evidence.robot) for a in acting))
    return Made(
        findings=(
            *ordered,
            *unseen(effects, ordered, examination, side, position_side),
            *like_links(inquiry, ordered),
        ),
        hypothesis=hypothesis,
        acting=acting,
        intervals=tuple(sized.ends[k] for k in places),
        terms=tuple(shown[k] for k in order),
        before=nothing.residual + inquiry.worn(nothing),
        residual=chosen.residual + inquiry.worn(chosen),
        alone=inquiry.model.residual(chosen.acting),
        whole=inquiry.model.residual(acting),
        refused=refused,
        notes=(*doubt, *remarks, *_what_counts(inquiry), *sized.notes),
    )


def sizes(inquiry: Inquiry, whole: Refined, unsure: Hypothesis) -> Sized:
    """The final sizes of effects that were refined on all rows."""
    evidence, model = inquiry.evidence, inquiry.model
    if unsure:
        around, every = (*inquiry.beside(whole.acting), *unsure), np.ones_like(inquiry.judge.rows)
        beside = refine(evidence, model, whole.acting, every, inquiry.noise.weights, around, steps=0)
        whole = replace(whole, unknown=beside.unknown)
    compares = evidence.reference_rows is not None
    whole = replace(whole, acting=tuple(bodies.as_link(evidence.robot, a, compares) for a in whole.acting))
    wanted = intervals(evidence, whole)
    whole, notes, costs = realisable(evidence, model, whole, bodies.link_names(evidence.robot))
    whole, rested = resting.edges(evidence, model, whole)
    shown = with_edges(evidence, model, whole, inquiry.noise.weights)
    ends = [{**known, **at_rest} for known, at_rest in zip(shown, rested, strict=True)]
    return Sized(whole, wanted, ends, notes, costs)


def _finding(inquiry: Inquiry, claimed: claim.Claim, sized: Sized, term: np.ndarray) -> Finding:
    """A claim as a finding, before any doubt but that of its rivals; its effect adds a `term` (R, n)."""
    evidence, candidate, i, rivals = inquiry.evidence, claimed.candidate, claimed.place, claimed.rivals
    robot, acting = evidence.robot, sized.whole.acting[i]
    if candidate.key in inquiry.close:
        rivals = [_late(r, candidate, inquiry.close[candidate.key]) for r in rivals]
    found = Finding(
        effect=acting.effect.name,
        joint=None if acting.joint is None else robot.joints[acting.joint],
        status="named",
        alternatives=tuple(dict.fromkeys((r.candidate.effect.name,) for r in rivals if r.equal)),
        parameters=quantities(robot, acting.effect, candidate.joint, sized.ends[i]) | tried(robot, acting),
        gain=claimed.gains,
        rejected=_rejected(robot, candidate.key, rivals),
        advice=acting.effect.advice,
        evidence={
            **facts(evidence, term),
            **_equals(robot, rivals),
            "gain_over_unexplained": over_unknown(claimed),
        },
        group=acting.effect.group,
        text=acting.effect.text,
    )
    return found if candidate.when is None else _timed(found, acting, sized.ends[i])


def _doubted(
    inquiry: Inquiry,
    effects: Mapping[str, AbstractEffect],
    claimed: claim.Claim,
    sized: Sized,
    finding: Finding,
) -> Finding:
    """A finding with all that it may be instead; ambiguous if that is something."""
    hypothesis, i = claimed.hypothesis, claimed.place
    evidence, candidate, acting = inquiry.evidence, claimed.candidate, sized.whole.acting[i]
    others = sums.hidden(effects, hypothesis, i)
    around = (*inquiry.always, *hypothesis[:i], *hypothesis[i + 1 :])
    if naming.blind_to_stribeck(inquiry.judge, around, candidate, inquiry.pool):
        others.append(StribeckFriction.name)
    others += _special_cases(evidence, effects, acting, sized.ends[i])
    finding = replace(finding, alternatives=(*finding.alternatives, *((name,) for name in others)))
    finding = bodies.told(finding, acting, evidence.robot, sized.wanted[i])
    more = []
    if claimed.was_away:
        alike = (acting.effect, *(r.candidate.effect for r in claimed.rivals if r.equal))
        more += [(e.for_a_time,) for e in alike if e.for_a_time in effects]
    if acting.effect is not candidate.effect and bodies.may_be_payload(sized.wanted[i]):
        more.append((candidate.effect.name,))
    doubtful = acting.effect.group != "standard" and finding.evidence["gain_over_unexplained"] < BEYOND
    no_body = i in sized.costs and sized.costs[i] > NO_BODY * claimed.evidence
    elsewhere = acting.effect.yields and _moves_others_more(evidence, finding)
    if doubtful or no_body or elsewhere or _is_vague(finding) or not held_out(evidence):
        more.append(UNKNOWN)
    if not (finding.alternatives or more):
        return finding
    finding = or_else(finding, *more)
    possible = {name for one in finding.alternatives for name in one if len(one) == 1}
    return replace(finding, rejected=tuple(x for x in finding.rejected if x[0] not in possible))


def _moves_others_more(evidence: Evidence, finding: Finding) -> bool:
    """Whether a gear lowers the squares of another joint more than of its own, each over the inertia that it carries:
    torque by which a link's motion against its motor moves other links is less than that, whatever the arm. Gravity
    may turn that round on slow motion; then both joints still save alike shares of what the gear does there. Where more
    is saved than that, something else moved with it, and it does not count."""
    own, torque = str(finding.joint), Counter(finding.evidence["rms_of_term_N_m"])  # 0 where it does nothing

    def saved(joint: str) -> float:
        gain = finding.gain.get(joint)
        return 0.0 if gain is None else max(min(gain.rmse_before**2 - gain.rmse_after**2, torque[joint] ** 2), 0.0)

    def is_more(joint: str, weight: Callable[[str], float]) -> bool:
        return saved(joint) * weight(own) > ELSEWHERE * saved(own) * weight(joint)

    def carried(joint: str) -> float:
        return inertia_on(evidence, evidence.robot.joints.index(joint))

    plain = [j for j, x in finding.gain.items() if j != own and x.rmse_after < PLAINLY * x.rmse_before]
    return any(is_more(j, carried) and is_more(j, lambda joint: torque[joint] ** 2) for j in plain)


def _what_counts(inquiry: Inquiry) -> tuple[str, ...]:
    """Sentences on what errors are errors of, where it is not what one would think."""
    said = ()
    if not held_out(inquiry.evidence):
        said = ("No stretch of the log is long enough to be held out: all errors are those on the training data.",)
    elif still := _still(inquiry.evidence):
        said = (
            f"The held-out data contain no motion of {', '.join(still)}: gains there are those on the training data.",
        )
    if inquiry.evidence.reference_rows is not None:
        said += (
            "Sizes and gains are those of changes since the reference; standard terms and the extended model are those "
            "of the robot now.",
        )
    elif len(inquiry.always) > len(inquiry.wear):
        said += ("All errors include the known effects. The extended model does not include them.",)
    return said


def _still(evidence: Evidence) -> list[str]:
    """The joints that move in the training data alone."""
    moves, held = evidence.valid.any(axis=0), (evidence.valid & judged(evidence)[:, None]).any(axis=0)
    return [evidence.robot.joints[j] for j in np.flatnonzero(moves & ~held)]


def _special_cases(
    evidence: Evidence, effects: Mapping[str, AbstractEffect], one: EffectInstance, ends: Mapping[str, tuple]
) -> list[str]:
    """The effects that one contains and that cannot be told from it where its own parameters, which they have not, are
    as small as their intervals allow."""
    special = [effects[name] for name in one.effect.contains if name in effects]
    shared = {name for effect in special for name in effect.parameters}
    least = {name: low for name, (_, low, _) in ends.items() if name in one.effect.parameters and name not in shared}
    if one.joint is None or not special or is_plain(evidence, replace(one, parameters={**one.parameters, **least})):
        return []
    return [effect.name for effect in special]


def _late(rival: naming.Rival, own: Candidate, close: bool) -> naming.Rival:
    """A delay's lag, or a lag's delay, judged by their exact formulas."""
    if rival.candidate.joint != own.joint or not rival.candidate.effect.late_by:
        return rival
    why = "fits as well" if close else "fits worse on the same samples, both by their exact formulas"
    return replace(rival, equal=close, why=why)


def facts(evidence: Evidence, term: np.ndarray) -> dict[str, Any]:
    """What an effect that adds a `term` (R, n) makes of every joint's torque."""
    rms, strong = (np.sqrt(np.mean(x**2, axis=0)) for x in (term, evidence.tau))
    share = rms / np.maximum(strong, 1e-300)
    names = evidence.robot.joints
    return {
        "rms_of_term_N_m": {n: float(x) for n, x, s in zip(names, rms, share, strict=True) if s > 1e-4},
        "share_of_torque": {n: float(s) for n, s in zip(names, share, strict=True) if s > 1e-4},
    }


def _term(inquiry: Inquiry, acting: Sequence[EffectInstance], i: int) -> np.ndarray:
    """(R, n) what one effect adds to the torque, the others staying as they are."""
    others = [a for k, a in enumerate(acting) if k != i]
    return inquiry.model.without(inquiry.whole, others) - inquiry.model.without(inquiry.whole, acting)


def _timed(finding: Finding, acting: EffectInstance, ends: Mapping[str, tuple]) -> Finding:
    """A finding with its window, seconds from the trajectory's first sample; with several, with the first of them."""
    assert acting.when is not None
    edges = [[plain(x) for x in ends[name][1:]] for name in EDGES]
    again = {"again": [[w.start, w.end] for w in acting.when.again]} if acting.when.again else {}
    return replace(
        finding,
        trajectory=acting.when.trajectory,
        window=(acting.when.start, acting.when.end),
        evidence={**finding.evidence, "window_interval95": edges, **again},
    )


def _equals(robot: Robot, rivals: Sequence[naming.Rival]) -> dict[str, Any]:
    """The rivals that do as well, where and with which parameters."""
    equal = [
        {
            "effect": r.candidate.effect.name,
            "joint": None if r.candidate.joint is None else robot.joints[r.candidate.joint],
            "parameters": {k: plain(v) for k, v in r.parameters.items()},
        }
        for r in rivals
        if r.equal
    ]
    return {"rivals": equal} if equal else {}


def _rejected(robot: Robot, key: tuple[str, int | None], rivals: Sequence[naming.Rival]) -> tuple[tuple[str, str], ...]:
    def where(joint: int | None) -> str:
        return "" if joint in (None, key[1]) else f"on {robot.joints[joint]}: "

    return tuple((r.candidate.effect.name, where(r.candidate.joint) + r.why) for r in rivals if not r.equal)[:6]


def _summed(inquiry, hypothesis, whole: Refined, finding: Finding, one: sums.Sum, after) -> Finding:
    """The finding of an effect's parts as that effect, the same torque: Coulomb friction beside an offset is friction
    that differs by direction."""
    effect, parts = one.effect, [whole.acting[k].effect for k in one.places]
    at = {(number, name): k for k, (number, name, _) in enumerate(whole.labels)}
    before = claim.without(inquiry, hypothesis, one.places, after)
    names = [next(iter(part.parameters)) for part in parts]
    columns = [at[k, name] for k, name in zip(one.places, names, strict=True)]
    values = sums.sizes_of(effect, [whole.theta[k] for k in columns])
    each = [sums.sizes_of(effect, [x[:, k] for k in columns]) for x in whole.replicas]
    unknown = sums.sizes_of(effect, [whole.unknown[:, k] for k in columns])
    errors = {name: float(reach([x[name] for x in each], unknown[name])) for name in values}
    level = {name: (x, x - errors[name], x + errors[name]) for name, x in values.items()}
    return replace(
        finding,
        effect=effect.name,
        alternatives=(tuple(effect.sum_of), *finding.alternatives),
        parameters=quantities(inquiry.evidence.robot, effect, hypothesis[one.places[0]].joint, level),
        gain=gains_of(inquiry.evidence, [hypothesis[k] for k in one.places], before, after),
        advice=effect.advice,
        text=effect.text,
        evidence={
            **finding.evidence,
            **{name: float(whole.theta[k]) for name, k in zip(names, columns, strict=True)},
        },
    )


def _is_vague(finding: Finding) -> bool:
    """Whether a ripple's cycles are hardly known: another bend of the torque over the angle would do."""
    cycles = finding.parameters.get("cycles")
    return cycles is not None and cycles.interval95[1] - cycles.interval95[0] > 2 * VAGUE * cycles.value


def perhaps_stribeck(inquiry: Inquiry, claimed: Hypothesis, found: Finding) -> Finding:
    """A standard term of a worn arm, beside what was claimed; ambiguous if it is a Coulomb friction that may hide a
    drop, or in whose place a drop was found that may not be claimed."""
    place = {(c.effect.name, c.joint): c for c in inquiry.wear}
    own = place.get((found.effect, inquiry.evidence.robot.joints.index(str(found.joint))))
    if own is None:
        return found
    others = (*(c for c in inquiry.always if c is not own), *claimed)
    drops = [c for c in inquiry.hypothesis if c.effect.name == StribeckFriction.name and c.joint == own.joint]
    refused = own.effect.name in StribeckFriction.contains and any(c not in claimed for c in drops)
    if not refused and not naming.blind_to_stribeck(inquiry.judge, others, own, inquiry.pool):
        return found
    return or_else(found, (StribeckFriction.name,), advice=StribeckFriction.advice)


def joined(made: Made, found: Sequence[Finding], terms: Sequence[np.ndarray]) -> Made:
    """With further claims, and what each adds to the torque (R, n): anomalies behind those that are there, and standard
    terms behind all."""
    claimed = {(x.effect, x.joint) for x in found}
    count = len(made.terms)
    unseen = (x for x in made.findings[count:] if (x.effect, x.joint) not in claimed)
    every = [*zip(made.findings[:count], made.terms, strict=True), *zip(found, terms, strict=True)]
    every.sort(key=lambda x: x[0].group == "standard")
    return replace(made, findings=(*(x for x, _ in every), *unseen), terms=tuple(x for _, x in every))
