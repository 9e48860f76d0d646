"""What every arm has beside its URDF, fitted beside what was found: the written model has it, named or not.

A name is a statement and needs proof; a model that leaves out a real offset because its name is unsure costs its user
accuracy. So the terms of the standard model (`maths/standard.py`) are fitted to what the findings leave, and go into
the extended model with them.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Evidence, held_out, judged
from invdyn_cli.diagnosis.decide.findings import Made
from invdyn_cli.diagnosis.decide.gain import gain_of, lowers
from invdyn_cli.diagnosis.decide.quantities import unit_of
from invdyn_cli.diagnosis.standard_columns import LINK, TERMS, Columns, has_part, least_of
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.composition import EffectInstance
from invdyn_cli.maths.standard import Standard
from invdyn_cli.types import Finding, Quantity

CLAIMED = 0.01
"""Share of its joint's RMS torque that a standard term must be worth to be claimed."""


@dataclass(frozen=True)
class Beside:
    """What stands in the written model beside the findings: nothing where the evidence is for them alone.

    Attributes:
        columns: the standard model's, as they are logged behind the channels that were found.
        acting: all of it and the findings' effects; a standard term of a joint where one was found is added to it.
        asked: whether the log asks for more than the findings.
        intervals: like `acting`, {parameter: (value, lower, upper)}.
        residual: (R, n) what is left on all rows after a fit on those that chose.
        before: (R, n) what the nominal model leaves.
        learned, found: the standard model beside the findings, of what chose and of all rows.
        reach: (p,) half of the 95 % interval of each coefficient of `found`.
        worth: (n,) RMS torque of the links' change [N m; N].
    """

    columns: Columns
    acting: tuple[EffectInstance, ...]
    asked: bool
    intervals: tuple[Mapping[str, tuple], ...]
    residual: np.ndarray
    before: np.ndarray
    learned: Standard
    found: Standard
    reach: np.ndarray
    worth: np.ndarray


def told(
    evidence: Evidence,
    made: Beside,
    claimed: Mapping[tuple[str, str | None], Sequence[Sequence[str]]],
    more: Mapping[str, Mapping[str, Mapping[str, Any]]],
) -> dict[str, Any]:
    """The standard terms of every joint in the written model, as diagnosis.json has them; empty where the findings
    say all of it. What bristles or Stribeck friction have of a term is in it.

    Args:
        claimed: alternatives of what was claimed, by (effect, joint).
        more: what else is told of a joint's term, if anything.
    """
    if not made.asked:
        return {}
    out: dict[str, Any] = {}
    every = list(zip(made.acting, made.intervals, strict=True))
    for j, joint in enumerate(evidence.robot.joints):
        row = {}
        for term, (effect, name) in TERMS.items():
            parts = [(a, x) for a, x in every if has_part(a, term, j)]
            if not parts:
                continue
            value, *ends = np.sum([x.get(name, (a.parameters[name],) * 3) for a, x in parts], axis=0).tolist()
            unit = unit_of(EFFECTS[effect], name, evidence.robot.prismatic[j])
            others = claimed.get((effect, joint), ())
            row[term] = {"effect": effect, "value": value, "unit": unit, "interval95": ends}
            row[term]["claimed"] = (effect, joint) in claimed and not others
            if shares := [a.effect.name for a, _ in parts if a.effect.name != effect]:
                row[term]["with"] = shares
            general = [x[0] for x in others if len(x) == 1 and x[0] in EFFECTS and effect in EFFECTS[x[0]].contains]
            if others and len(general) == len(others):
                row[term]["perhaps"] = general
            row[term] |= more.get(joint, {}).get(term, {})
        out[joint] = row
    worth = dict(zip(evidence.robot.joints, made.worth.tolist(), strict=True))
    return out | {"inertials": {"worth": worth, "share": made.found.share, "chosen": made.found.chosen}}


def _choosing(evidence: Evidence) -> np.ndarray:
    """The rows (R,) bool that choose, the reference's among them."""
    choosing = evidence.of_role("train")
    return choosing if evidence.reference_rows is None else choosing | evidence.reference_rows


def baselines(columns: Columns, evidence: Evidence, before: np.ndarray) -> dict[str, np.ndarray]:
    """(R, n) what a friction line and the standard model alone leave of what the nominal model does (`before`), fitted
    on the rows that choose."""
    choosing = _choosing(evidence)
    fitted = {"friction": columns.line(before, choosing), "standard": columns.fit(before, choosing).theta}
    return {name: before - columns.of(theta) for name, theta in fitted.items()}


def beside(columns: Columns, evidence: Evidence, made: Made) -> Beside:
    """The standard model beside what was found; where a reference is, what it shows as well."""
    before, chosen, whole, acting, intervals = made.before, made.residual, made.whole, made.acting, made.intervals
    choosing = _choosing(evidence)
    if evidence.reference_rows is not None:  # beside which what was found is a change
        before, chosen = evidence.residual((), np.zeros(0)), made.alone
    least = least_of(columns, acting)
    columns = columns.behind(acting)
    learned = columns.fit(chosen, choosing, least)
    every = np.ones_like(choosing)
    found = columns.fit(whole, every, least)
    if evidence.reference_rows is None and held_out(evidence):
        plain = columns.without_links(learned, chosen, choosing, least)
        linked, free = (errors(evidence, chosen - columns.of(x.theta)) for x in (learned, plain))
        if np.mean(free - linked) < 0:
            learned, found = plain, columns.without_links(found, whole, every, least)
    asked = learned.gain > 0
    half = columns.reach(found, whole, every)
    together, ends = _merged(columns, found, half, acting, intervals) if asked else (acting, intervals)
    return Beside(
        columns=columns,
        acting=tuple(together),
        asked=asked,
        intervals=tuple(ends),
        residual=chosen - columns.of(learned.theta) if asked else chosen,
        before=before,
        learned=learned,
        found=found,
        reach=half,
        worth=np.sqrt(np.mean(columns.of(np.where(columns.inertial, found.theta, 0.0)) ** 2, axis=0)),
    )


def errors(evidence: Evidence, residual: np.ndarray) -> np.ndarray:
    """(n,) logarithm of the mean of each joint's squared residuals (R, n) on the held-out rows."""
    return np.log(np.maximum(np.mean(residual[judged(evidence)] ** 2, axis=0), 1e-300))


def claims(
    evidence: Evidence, more: Beside, named: Collection[tuple[str, str | None]]
) -> tuple[tuple[Finding, ...], tuple[np.ndarray, ...]]:
    """The standard terms that the log proves, the largest gain first: away from zero by an interval that counts the
    autocorrelation, worth CLAIMED of their joint's torque, and missed on data that did not choose them; and what each
    adds to the torque (R, n).

    Args:
        named: (effect, joint) of the anomalies that were claimed; a special case of one is part of it.
    """
    n, rows, columns, made = evidence.dofs, judged(evidence), more.columns, []
    value, half, learned = (columns.split(x)[1] for x in (more.found.theta, more.reach, more.learned.theta))
    special = {(x, joint) for name, joint in named if name in EFFECTS for x in EFFECTS[name].contains}
    for t, term in enumerate(columns.terms):
        effect, name = TERMS[term]
        for j, joint in enumerate(evidence.robot.joints):
            low, high = float(value[t, j] - half[t, j]), float(value[t, j] + half[t, j])
            own = np.outer(learned[t, j] * columns.own[t, j], np.eye(n)[j])
            torque, whole = (float(np.sqrt(np.mean(x[rows, j] ** 2))) for x in (own, evidence.tau))
            if low <= 0 <= high or torque < CLAIMED * whole or (effect, joint) in {*named, *special}:
                continue
            gain = gain_of(evidence, j, more.residual + own, more.residual)
            if gain is None or gain.interval95[0] <= 0:
                continue
            own = np.outer(value[t, j] * columns.own[t, j], np.eye(n)[j])
            torque = float(np.sqrt(np.mean(own[rows, j] ** 2)))
            size = Quantity(
                float(value[t, j]), unit_of(EFFECTS[effect], name, evidence.robot.prismatic[j]), [low, high]
            )
            facts = {"rms_of_term_N_m": {joint: torque}, "share_of_torque": {joint: torque / whole}}
            told = {"parameters": {name: size}, "gain": {joint: gain}, "evidence": facts, "group": "standard"}
            made.append((Finding(effect, joint, "named", **told), own))
    made.sort(key=lambda x: -lowers([x[0]]))
    return tuple(x for x, _ in made), tuple(own for _, own in made)


def _merged(
    columns: Columns,
    found: Standard,
    half: np.ndarray,
    acting: Sequence[EffectInstance],
    intervals: Sequence[Mapping[str, tuple]],
) -> tuple[Sequence[EffectInstance], Sequence[Mapping[str, tuple]]]:
    """The effects that were found and the standard model's, terms of the same joint added up; and their intervals.
    `half` (p,): half of the 95 % interval of each coefficient."""
    (links, values), (link_spread, wide_of) = columns.split(found.theta), columns.split(half)
    together: list[EffectInstance] = list(acting)
    ends: list[dict[str, tuple]] = [dict(x) for x in intervals]
    for t, term in enumerate(columns.terms):
        effect, name = TERMS[term]
        for j in range(columns.evidence.dofs):
            value, wide = float(values[t, j]), float(wide_of[t, j])
            place = next((k for k, a in enumerate(acting) if a.key == (effect, j)), None)
            if place is None:
                together.append(EffectInstance(EFFECTS[effect], j, {name: value}))
                ends.append({name: (value, value - wide, value + wide)})
                continue
            old = together[place]
            total = float(old.parameters[name]) + value
            together[place] = replace(old, parameters={**old.parameters, name: total})
            if name in ends[place]:  # the finding's own width, about the value that is written
                _, low, high = ends[place][name]
                ends[place][name] = (total, low + value, high + value)
    for j, (row, spread) in enumerate(zip(links, link_spread, strict=True)):
        if not row.any():
            continue
        split = {"mass": 0, "moment": slice(1, 4), "inertia": slice(4, 10)}
        plain = {k: float(row[at]) if k == "mass" else row[at] for k, at in split.items()}
        together.append(EffectInstance(LINK, j, plain))
        ends.append({k: (plain[k], row[at] - spread[at], row[at] + spread[at]) for k, at in split.items()})
    return together, ends
