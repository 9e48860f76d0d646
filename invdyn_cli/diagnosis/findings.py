"""From a hypothesis to findings: what is named, what stays ambiguous, what this log could not have shown, and in words.

A name is given only where data that did not choose it gain by it, no rival does as well, and what stays unexplained on
its joint does not outweigh it.
"""

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from invdyn_cli.diagnosis import naming
from invdyn_cli.diagnosis.evidence import Candidate, Evidence
from invdyn_cli.diagnosis.exact import Refined, intervals, refine
from invdyn_cli.diagnosis.recording import ROLES
from invdyn_cli.diagnosis.search import Hypothesis, _solve
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.composition import Acting
from invdyn_cli.interfaces import AbstractEffect
from invdyn_cli.types import Diagnosis, Examination, Finding, Gain, Quantity, Robot

if TYPE_CHECKING:
    from invdyn_cli.diagnosis.pipeline import Inquiry

OUTWEIGHED = 0.25
"""Share of the variance that stays unexplained on its joint, without which an effect explains too little to be named:
a column that is nearly orthogonal to an unknown cause still picks up a few percent of it."""

PICKED_UP = 0.1
"""And so much more for every further coefficient, each of which picks up as much."""

LIGHTER = 0.5
"""Share of the last link's nominal mass up to which an added mass may as well be an error of its inertials."""

MANY_LINKS = 3
"""Links with wrong inertials from which the model as a whole is in doubt."""

PREDICTABLE, SMALL = 0.15, 0.15
"""What is left counts as explained where the learner predicts less than this share of the residual's variance, or less
than this share of the nominal model's error, in N m."""

RARE = 0.1
"""Of its mean square, what an effect must have on the held-out rows to be judged there."""

DRAWS = 1000


@dataclass(frozen=True)
class Made:
    """Findings, the effects behind the claims among them with their terms (R, n), and residuals (R, n): `before` of the
    nominal model, `residual` of the extended model fitted on the data that chose it."""

    findings: tuple[Finding, ...]
    acting: tuple[Acting, ...]
    intervals: tuple[Mapping[str, tuple], ...]
    terms: tuple[np.ndarray, ...]
    before: np.ndarray
    residual: np.ndarray
    notes: tuple[str, ...]


def judged(evidence: Evidence) -> np.ndarray:
    """Rows (R,) bool that chose nothing; all but the reference's where there are none."""
    test = evidence.role == ROLES.index("test")
    return test if test.any() else evidence.role != ROLES.index("reference")


def report(inquiry: "Inquiry", effects: Mapping[str, AbstractEffect], examination: Examination, side: str) -> Made:
    """Everything that can be claimed of a log."""
    evidence, judge = inquiry.evidence, inquiry.judge
    hypothesis, dropped = _that_hold(inquiry)
    chosen, whole = inquiry.chosen, inquiry.whole
    if len(hypothesis) < len(inquiry.hypothesis):
        kept = [i for i, c in enumerate(inquiry.hypothesis) if c in hypothesis]
        chosen = _again(inquiry, [chosen.acting[i] for i in kept], judge.rows)
        whole = _again(inquiry, [whole.acting[i] for i in kept], np.ones_like(judge.rows))
    nothing = _again(inquiry, [], judge.rows)
    ends = intervals(evidence, whole)
    terms = [_term(inquiry, whole.acting, i) for i in range(len(whole.acting))]
    claims, acting, shown, used = [], [], [], set()
    for i, candidate in enumerate(hypothesis):
        if i in used:
            continue
        rivals = naming.rivals(judge, inquiry.always, hypothesis, i, inquiry.pool)
        finding = Finding(
            effect=candidate.effect.name,
            joint=None if candidate.joint is None else evidence.robot.joints[candidate.joint],
            status="named",
            alternatives=_alternatives(candidate.key, rivals),
            parameters=_quantities(candidate.effect, ends[i]),
            gain=_gains(inquiry, hypothesis, (i,)),
            rejected=_rejected(evidence.robot, candidate.key, rivals),
            advice=candidate.effect.advice,
            evidence=_facts(evidence, terms[i]),
        )
        partner = _partner(hypothesis, i)
        if partner is not None and abs(ends[partner][_OFFSET][0]) < ends[i][_COULOMB][0]:
            used.add(partner)
            finding = _asymmetric(inquiry, hypothesis, whole, finding, i, partner)
            terms[i] = terms[i] + terms[partner]
            acting += [whole.acting[i], whole.acting[partner]]
        elif _is_offset_of(hypothesis, i, ends):
            continue
        else:
            acting.append(whole.acting[i])
        if naming.blind_to_stribeck(judge, inquiry.always, hypothesis, i, inquiry.pool):
            finding = replace(finding, alternatives=(*finding.alternatives, ("stribeck_friction",)))
        finding = _body(finding, evidence.robot, candidate.joint, ends[i])
        if finding.alternatives:
            finding = replace(finding, status="ambiguous")
        claims.append(finding)
        shown.append(terms[i])
    claims, doubt = _other_robot(claims)
    dropped += doubt
    order = sorted(range(len(claims)), key=lambda k: -_worth(claims[k]))
    ordered = tuple(claims[k] for k in order)
    by_acting = {id(a): e for a, e in zip(whole.acting, ends, strict=True)}
    return Made(
        findings=(*ordered, *_blind(effects, ordered, examination, side)),
        acting=tuple(acting),
        intervals=tuple(by_acting[id(a)] for a in acting),
        terms=tuple(shown[k] for k in order),
        before=nothing.residual,
        residual=chosen.residual,
        notes=dropped,
    )


_OFFSET, _COULOMB = "offset", "coulomb"


def _again(inquiry: "Inquiry", acting: Sequence[Acting], rows: np.ndarray) -> Refined:
    return refine(inquiry.evidence, inquiry.model, acting, rows, inquiry.noise.weights, inquiry.always)


def _that_hold(inquiry: "Inquiry") -> tuple[Hypothesis, tuple[str, ...]]:
    """The candidates that gain on data that did not choose them, and explain more than what stays unknown; and a
    sentence for each of the others."""
    hypothesis, said = inquiry.hypothesis, []
    for _ in range(len(hypothesis)):
        worst = None
        for i in range(len(hypothesis)):
            why = _fails(inquiry, hypothesis, i)
            if why is not None and (worst is None or why[0] < worst[1][0]):
                worst = i, why
        if worst is None:
            break
        out = hypothesis[worst[0]]
        where = f" on {inquiry.evidence.robot.joints[out.joint]}" if out.joint is not None else ""
        said.append(f"{out.effect.title.capitalize()}{where} was tried and is not claimed: {worst[1][1]}.")
        hypothesis = hypothesis[: worst[0]] + hypothesis[worst[0] + 1 :]
    return hypothesis, tuple(said)


def _fails(inquiry: "Inquiry", hypothesis: Hypothesis, i: int) -> tuple[float, str] | None:
    """Why a candidate may not be claimed, with how much it explains; None if it may."""
    evidence, weights = inquiry.evidence, inquiry.noise.weights
    rows = judged(evidence)
    squares, unknown = _squares(inquiry, hypothesis, (i,))
    gain = float(np.sum(weights * squares))
    if gain <= 0 and not _is_rare(inquiry, hypothesis, i):
        return gain, "it does not hold on data that did not choose it"
    rest = float(np.sum(weights * unknown * rows.sum() * (np.abs(squares) > 1e-3 * np.abs(squares).max())))
    needed = OUTWEIGHED + PICKED_UP * (inquiry.judge.freedom(hypothesis[i]) - 1)
    if 0 < gain < needed * rest:
        return gain / rest, "most of what it would explain is something else that this catalogue does not know"
    late = {"torque_delay": "delay", "actuator_lag": "time_constant"}.get(hypothesis[i].effect.name)
    if late is not None:
        value = next(
            a.parameters[late] for a in inquiry.chosen.acting if (a.effect.name, a.joint) == hypothesis[i].key
        )
        if value < evidence.recording.period:
            return gain, f"{1e3 * value:.2g} ms are less than a sample of the log, which its own clock may have taken"
    if hypothesis[i].effect.name == "torque_saturation" and not _hugs_its_limit(inquiry, hypothesis[i]):
        return gain, "the arm moved as if it had got torques beyond that limit"
    place = next(k for k, c in enumerate(inquiry.hypothesis) if c is hypothesis[i])
    if not _is_exact(inquiry, place):
        return gain, "its formula, taken exactly, gains nothing on data that did not choose it"
    return None


def _is_rare(inquiry: "Inquiry", hypothesis: Hypothesis, i: int) -> bool:
    """Whether a candidate hardly comes up on the held-out rows."""
    after, before = _left(inquiry, hypothesis, (i,))
    change = ((after - before) * inquiry.evidence.valid) ** 2 @ inquiry.noise.weights
    return bool(np.mean(change[judged(inquiry.evidence)]) < RARE * np.mean(change))


def _hugs_its_limit(inquiry: "Inquiry", candidate: Candidate) -> bool:
    """Whether the torque that moved a joint stays within the limit of its saturation."""
    evidence, j = inquiry.evidence, candidate.joint
    moved = np.abs(evidence.tau[:, j] - inquiry.chosen.residual[:, j])
    limit = next(a.parameters["limit"] for a in inquiry.chosen.acting if (a.effect.name, a.joint) == candidate.key)
    nominal = np.abs(evidence.nominal[:, j])
    reach = min(float(np.quantile(moved, 0.99)), float(np.quantile(nominal, 0.99)))
    return limit > 0.75 * reach and limit > 3 * inquiry.noise.deviation[j]


def _is_exact(inquiry: "Inquiry", place: int) -> bool:
    """Whether the logged torque is predicted better on held-out rows with an effect than without it, the others staying
    as they are. Columns of a channel effect act on the measured torque, and calm its noise; the formula does not. An
    effect that hardly comes up on the held-out rows is judged on all."""
    evidence, acting = inquiry.evidence, inquiry.chosen.acting
    others = [a for k, a in enumerate(acting) if k != place]
    change = (inquiry.model.residual(others) - inquiry.model.residual(acting)) * evidence.valid
    rows = judged(evidence)
    if np.mean(change[rows] ** 2 @ inquiry.noise.weights) < RARE * np.mean(change**2 @ inquiry.noise.weights):
        rows = np.ones_like(rows)
    saved = ((2 * inquiry.chosen.residual + change) * change) @ inquiry.noise.weights
    per_block = np.bincount(evidence.block[rows], saved[rows])[np.unique(evidence.block[rows])]
    return bool(per_block.sum() > 0) and naming.chance(per_block, 0.0) < naming.DOUBT


def _squares(inquiry: "Inquiry", hypothesis: Hypothesis, without: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Per joint: sum of squares on held-out rows that some candidates of a hypothesis save, and the variance of what is
    structured in what it leaves there."""
    evidence = inquiry.evidence
    rows = judged(evidence)
    after, before = _left(inquiry, hypothesis, without)
    valid = evidence.valid & rows[:, None]
    return np.sum((before**2 - after**2) * valid, axis=0), naming.structure(after, valid, evidence.piece)


def _left(inquiry: "Inquiry", hypothesis: Hypothesis, without: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Residuals (R, n) of a hypothesis, and of what remains of it, both fitted on the data that chose."""
    judge = inquiry.judge
    out = []
    for kept in (hypothesis, tuple(c for k, c in enumerate(hypothesis) if k not in without)):
        theta = judge.verdict((*inquiry.always, *kept)).theta
        out.append(inquiry.evidence.left((*inquiry.always, *kept), theta))
    return out[0], out[1]


def _gains(inquiry: "Inquiry", hypothesis: Hypothesis, without: Sequence[int]) -> dict[str, Gain]:
    """Held-out error of every joint that gains by these candidates, without and with them."""
    evidence = inquiry.evidence
    rows = judged(evidence)
    after, before = _left(inquiry, hypothesis, without)
    numbers, of = np.unique(evidence.block[rows], return_inverse=True)
    draws = np.random.default_rng(0).multinomial(len(numbers), [1 / len(numbers)] * len(numbers), size=DRAWS)
    gains = {}
    own = [hypothesis[k] for k in without]
    local = all(c.effect.point in ("torque", "channel") for c in own)
    for j, name in enumerate(evidence.robot.joints):
        if local and j not in {c.joint for c in own}:
            continue
        a, b, tau = after[rows, j], before[rows, j], evidence.tau[rows, j]
        rms = [float(np.sqrt(np.mean(x**2))) for x in (b, a)]
        if abs(rms[0] - rms[1]) < 1e-3 * max(rms[0], 1e-12):
            continue
        per_block = [np.bincount(of, x**2, len(numbers)) for x in (b, a)]
        size = draws @ np.bincount(of, minlength=len(numbers))
        step = np.sqrt(draws @ per_block[0] / size) - np.sqrt(draws @ per_block[1] / size)
        variance = max(float(np.var(tau)), 1e-300)
        low, high = np.quantile(step, [0.025, 0.975])
        gains[name] = Gain(rms[0], rms[1], rms[0] ** 2 / variance, rms[1] ** 2 / variance, (float(low), float(high)))
    return gains


def _worth(finding: Finding) -> float:
    return max((g.nmse_before - g.nmse_after for g in finding.gain.values()), default=0.0)


def _facts(evidence: Evidence, term: np.ndarray) -> dict[str, Any]:
    rms = np.sqrt(np.mean(term**2, axis=0))
    strong = np.sqrt(np.mean(evidence.tau**2, axis=0))
    share = rms / np.maximum(strong, 1e-300)
    names = evidence.robot.joints
    return {
        "rms_of_term_N_m": {n: float(x) for n, x, s in zip(names, rms, share, strict=True) if s > 1e-4},
        "share_of_torque": {n: float(s) for n, s in zip(names, share, strict=True) if s > 1e-4},
    }


def _term(inquiry: "Inquiry", acting: Sequence[Acting], i: int) -> np.ndarray:
    """(R, n) what one effect adds to the torque, the others staying as they are."""
    others = [a for k, a in enumerate(acting) if k != i]
    return inquiry.model.residual(others) - inquiry.model.residual(acting)


def _quantities(effect: AbstractEffect, ends: Mapping[str, tuple]) -> dict[str, Quantity]:
    return {
        name: Quantity(_plain(value), effect.parameters[name].unit, [_plain(low), _plain(high)])
        for name, (value, low, high) in ends.items()
    }


def _plain(value: Any) -> Any:
    return np.asarray(value, float).tolist()


def _alternatives(key: tuple[str, int | None], rivals: Sequence[naming.Rival]) -> tuple[tuple[str, ...], ...]:
    return tuple(dict.fromkeys((r.candidate.effect.name,) for r in rivals if r.equal))


def _rejected(robot: Robot, key: tuple[str, int | None], rivals: Sequence[naming.Rival]) -> tuple[tuple[str, str], ...]:
    out = []
    for r in rivals:
        joint = r.candidate.joint
        where = "" if joint in (None, key[1]) else f"on {robot.joints[joint]}: "
        if not r.equal and (joint in (None, key[1]) or r.excess < 1e6):
            out.append((r.candidate.effect.name, where + r.why))
    return tuple(out[:6])


def _partner(hypothesis: Hypothesis, i: int) -> int | None:
    """Place of the torque offset beside a Coulomb friction."""
    if hypothesis[i].effect.name != "coulomb_friction":
        return None
    return next((k for k, c in enumerate(hypothesis) if c.key == ("torque_offset", hypothesis[i].joint)), None)


def _is_offset_of(hypothesis: Hypothesis, i: int, ends: Sequence[Mapping[str, tuple]]) -> bool:
    """Whether a torque offset is told with the Coulomb friction of its joint."""
    if hypothesis[i].effect.name != "torque_offset":
        return False
    k = next((k for k, c in enumerate(hypothesis) if c.key == ("coulomb_friction", hypothesis[i].joint)), None)
    return k is not None and abs(ends[i][_OFFSET][0]) < ends[k][_COULOMB][0]


def _asymmetric(inquiry, hypothesis, whole: Refined, finding: Finding, i: int, partner: int) -> Finding:
    """Coulomb friction beside an offset: the same torque as friction that differs by direction."""
    asymmetric = EFFECTS["asymmetric_coulomb_friction"]
    at = {(number, name): k for k, (number, name, _) in enumerate(whole.labels)}
    both = at[(i, "coulomb")], at[(partner, "offset")]
    count = len(whole.replicas)
    level = {}
    for name, sign in (("positive", 1.0), ("negative", -1.0)):
        value = whole.theta[both[0]] + sign * whole.theta[both[1]]
        each = whole.replicas[:, both[0]] + sign * whole.replicas[:, both[1]]
        reach = 2.1 * np.sqrt((count - 1) / count * np.sum((each - each.mean()) ** 2))
        level[name] = (value, value - reach, value + reach)
    return replace(
        finding,
        effect=asymmetric.name,
        alternatives=(("coulomb_friction", "torque_offset"), *(a for a in finding.alternatives)),
        parameters=_quantities(asymmetric, level),
        gain=_gains(inquiry, hypothesis, (i, partner)),
        advice=asymmetric.advice,
        evidence={
            **finding.evidence,
            "coulomb": float(whole.theta[both[0]]),
            "offset": float(whole.theta[both[1]]),
        },
    )


def _body(finding: Finding, robot: Robot, joint: int | None, ends: Mapping[str, tuple]) -> Finding:
    """Payloads and link errors: which of the two a change of the last link is, and what of it can be known."""
    if finding.effect == "payload":
        mass, nominal = float(ends["mass"][0]), float(robot.inertial[-1, 0])
        link = link_names(robot)[-1]
        x, y, z = com = np.asarray(ends["com"][0])
        if mass <= 0 or np.linalg.norm(com) > 1.0:
            point = np.array([y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y])
            return replace(
                finding,
                effect="link_inertia_error",
                joint=robot.joints[-1],
                parameters={
                    "link": Quantity(link, ""),
                    "mass": finding.parameters["mass"],
                    "moment": Quantity((mass * com).tolist(), "kg m"),
                    "inertia": Quantity((np.asarray(ends["inertia"][0]) + mass * point).tolist(), "kg m²"),
                },
                rejected=(("payload", f"its mass would be {mass:.3g} kg at {np.round(com, 3).tolist()} m"),)
                + finding.rejected,
                advice=EFFECTS["link_inertia_error"].advice,
            )
        if mass < LIGHTER * nominal:
            return replace(
                finding,
                alternatives=(*finding.alternatives, ("link_inertia_error",)),
                evidence={**finding.evidence, "mass_of_last_link_kg": nominal},
            )
    if finding.effect == "link_inertia_error" and joint is not None:
        scales = {"mass": 1.0, "moment": 0.2, "inertia": 0.06}
        shown = {
            name: q if np.all(np.asarray(q.interval95[1]) - np.asarray(q.interval95[0]) < 2 * scales[name]) else None
            for name, q in finding.parameters.items()
        }
        known = {name: q or replace(finding.parameters[name], value=None, interval95=None) for name, q in shown.items()}
        finding = replace(finding, parameters={"link": Quantity(link_names(robot)[joint], ""), **known})
    return finding


def _other_robot(claims: list[Finding]) -> tuple[list[Finding], tuple[str, ...]]:
    """Where many links seem wrong, none of them is named: the whole model may be another robot's."""
    links = [f for f in claims if f.effect == "link_inertia_error"]
    if len(links) < MANY_LINKS:
        return claims, ()
    said = f"The inertials of {len(links)} links seem wrong at once: this URDF may be of another robot or another tool."
    unsure = [
        replace(f, status="ambiguous", alternatives=(*f.alternatives, ("link_inertia_error",))) if f in links else f
        for f in claims
    ]
    return unsure, (said,)


def link_names(robot: Robot) -> tuple[str, ...]:
    """Names of the links that the joints move, from the URDF; the joints' own without one."""
    if not robot.urdf:
        return robot.joints
    children = {
        joint.get("name"): child.get("link", "")
        for joint in ET.fromstring(robot.urdf).findall("joint")
        if (child := joint.find("child")) is not None
    }
    return tuple(children.get(j) or j for j in robot.joints)


def _blind(
    effects: Mapping[str, AbstractEffect], claims: Sequence[Finding], examination: Examination, side: str
) -> list[Finding]:
    """What this log could not have shown: no claims, but where not to look for absence."""
    claimed = {(f.effect, f.joint) for f in claims}
    out = [
        Finding(
            name,
            None,
            "not_observable",
            advice=f"a torque from the {' or '.join(s for s in e.sides if s != 'unknown')} side",
            evidence={"why": f"a torque taken at the {side} does not contain it"},
        )
        for name, e in effects.items()
        if side not in e.sides
    ]
    for joint, numbers in examination.excitation.items():
        for name, why in dict(numbers.get("cannot_show", {})).items():
            if name in effects and side in effects[name].sides and (name, joint) not in claimed:
                advice = effects[name].advice
                out.append(Finding(name, joint, "not_excited", evidence={"why": why}, advice=advice))
    return out


def verdict(made: Made, learned: np.ndarray, floor: np.ndarray | None, extended: Mapping[str, Mapping[str, float]]) -> str:
    """explained, partly_explained or nothing_found."""
    if not any(f.status in ("named", "ambiguous") for f in made.findings):
        return "nothing_found"
    before = np.sqrt(np.mean(made.before**2, axis=0))
    after = np.array([x["rmse"] for x in extended.values()])
    left = np.sqrt(learned) * after
    fine = (learned < PREDICTABLE) | (left < SMALL * before)
    if floor is not None:
        fine |= after < 1.2 * floor
    return "explained" if np.all(fine) else "partly_explained"


def summary(diagnosis: Diagnosis) -> str:
    """The verdict in two sentences."""
    claims = [f for f in diagnosis.findings if f.status in ("named", "ambiguous")]
    before, after = (
        np.sqrt(np.mean([x["rmse"] ** 2 for x in table.values()])) for table in (diagnosis.baseline, diagnosis.extended)
    )
    rest = [j for j, s in diagnosis.unexplained.items() if s > PREDICTABLE]
    most = 100 * max(diagnosis.unexplained.values())
    unknown = f"something unknown remains on {', '.join(rest)}: a learner still predicts up to {most:.0f} % of the residual"
    if not claims:
        first = f"No cause was found: the nominal model leaves {before:.3g} N m RMS over all joints."
        return f"{first} {unknown[0].upper()}{unknown[1:]}." if rest else f"{first} What is left looks like noise."
    said = [
        f"{EFFECTS[f.effect].title}{' or its rivals' if f.status == 'ambiguous' else ''}"
        + (f" on {f.joint}" if f.joint else "")
        for f in claims[:4]
    ]
    more = f" and {len(claims) - 4} more" if len(claims) > 4 else ""
    first = f"The simulation lacks {_listed(said)}{more}; with that its held-out error falls from {before:.3g} to "
    first += f"{after:.3g} N m RMS over all joints."
    if diagnosis.verdict == "partly_explained" and rest:
        return f"{first} But {unknown}."
    return f"{first} What is left looks like noise."


def _listed(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1]
