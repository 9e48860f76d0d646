"""What to record next: from the findings that stay ambiguous to the questions of a design, and its answer in words."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from invdyn_cli.diagnosis.causes import Cause
from invdyn_cli.diagnosis.contest import Side
from invdyn_cli.diagnosis.design import TRIES, Design, Told, design
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.errors import UsageError
from invdyn_cli.interfaces import AbstractBodyEffect, AbstractMotionEffect, Progress, silent
from invdyn_cli.types import Diagnosis, Finding, Robot

DURATION = 30.0
"""[s] of a designed recording."""

LARGE_ARM = 6
"""Joints from which only half of the variations are tried: a diagnosis waits for them."""

FILE = "record_next.csv"
"""What the trajectory is called."""


POINTS = ("torque", "channel", "body", "motion")
"""Where what a design can play acts: all along, and from the motion alone."""


@dataclass(frozen=True)
class Open:
    """An ambiguous finding, by its number, and the sides between which it is open."""

    finding: int
    sides: tuple[Side, ...]


def open_questions(findings: Sequence[Finding], robot: Robot) -> list[Open]:
    """The ambiguous findings that have two names or more in the catalogue."""
    made = []
    for number, finding in enumerate(findings):
        if finding.status == "ambiguous" and finding.effect in EFFECTS and finding.window is None:
            sides = sides_of(finding, robot)
            if len(sides) > 1:
                made.append(Open(number, sides))
    return made


def sides_of(finding: Finding, robot: Robot) -> tuple[Side, ...]:
    """A finding's own cause and its rivals, with the sizes that the log gave them, or none."""
    own = cause_of(finding.effect, finding.joint, _values(finding), robot)
    sides: dict[Any, Side] = {(own.key,): (own,)}
    told = [x for x in finding.evidence.get("rivals", ()) if _can_be_played(x["effect"])]
    for one in told:
        cause = cause_of(one["effect"], one["joint"], one["parameters"], robot)
        sides.setdefault((cause.key,), (cause,))
    found = {one["effect"] for one in told}
    for names in finding.alternatives:
        if len(names) == 1 and names[0] in found:
            continue
        if all(map(_can_be_played, names)):
            side = tuple(cause_of(name, finding.joint, None, robot) for name in names)
            sides.setdefault(tuple(c.key for c in side), side)
    return tuple(sides.values())


def _can_be_played(name: str) -> bool:
    return name in EFFECTS and EFFECTS[name].point in POINTS


def known_beside(findings: Sequence[Finding], robot: Robot) -> list[Cause]:
    """What the log says for sure: a new one will have it too."""
    named = [f for f in findings if f.status == "named" and f.effect in EFFECTS and f.window is None]
    return [cause_of(f.effect, f.joint, _values(f), robot) for f in named]


def after(
    diagnosis: Diagnosis,
    robot: Robot,
    *,
    duration: float = DURATION,
    rate: float = 250.0,
    seed: int = 0,
    progress: Progress = silent,
) -> tuple[Diagnosis, Design | None]:
    """The diagnosis with, in the advice of every ambiguous finding, whether one more recording would settle it; and
    that recording, for all of them together (None: nothing is open, or no motion would)."""
    questions = open_questions(diagnosis.findings, robot)
    if not questions:
        return diagnosis, None
    names = diagnosis.details
    noise = np.array([names["noise_N_m"][j] for j in robot.joints])
    cutoffs = np.array([names["filter_cutoff_Hz"][j] for j in robot.joints])
    try:
        made = design(
            robot,
            [x.sides for x in questions],
            duration=duration,
            rate=rate,
            noise=noise,
            cutoffs=cutoffs,
            seed=seed,
            known=known_beside(diagnosis.findings, robot),
            tries=TRIES // 2 if robot.dofs >= LARGE_ARM else TRIES,
            progress=progress,
        )
    except UsageError as error:
        return replace(diagnosis, notes=(*diagnosis.notes, f"No further recording was designed: {error}")), None
    findings = list(diagnosis.findings)
    for k, one in enumerate(questions):
        findings[one.finding] = _advised(findings[one.finding], made.of(k), duration)
    useful = any(pair.possible for pair in made.pairs)
    return replace(diagnosis, findings=tuple(findings)), made if useful else None


def _advised(finding: Finding, pairs: Sequence[Told], duration: float) -> Finding:
    """The finding with what the design says of it."""
    can = [p for p in pairs if p.possible]
    cannot = [p for p in pairs if not p.possible]
    said = []
    if can:
        least = min(p.distance for p in can)
        said.append(f"play {FILE} ({duration:g} s): it parts {_names(can)} by {least:.2g} standard errors or more")
    if cannot:
        said.append(f"no motion tells {_names(cannot)} apart; {finding.advice}" if finding.advice else "")
    evidence = {
        **finding.evidence,
        "distances": [
            {"true": words(p.true), "rival": words(p.rival), "standard_errors": p.distance, "possible": p.possible}
            for p in pairs
        ],
    }
    return replace(finding, advice=". ".join(x for x in said if x), evidence=evidence)


def words(side: Side) -> str:
    """A side by its effects' names."""
    return " + ".join(c.effect.name for c in side)


def _names(pairs: Sequence[Told]) -> str:
    titles = dict.fromkeys(" with ".join(c.effect.title for c in side) for p in pairs for side in (p.true, p.rival))
    *first, last = titles
    return f"{', '.join(first)} and {last}" if first else last


def _values(finding: Finding) -> dict[str, Any] | None:
    """The parameters of a finding, None where one of them is not known."""
    own = {k: q.value for k, q in finding.parameters.items() if k in EFFECTS[finding.effect].parameters}
    return own if len(own) == len(EFFECTS[finding.effect].parameters) and None not in own.values() else None


def cause_of(name: str, joint: str | None, parameters: Mapping[str, Any] | None, robot: Robot) -> Cause:
    """A cause by its names; what acts on the whole arm has no joint, and the joint of what needs one is the last."""
    effect = EFFECTS[name]
    arm = isinstance(effect, AbstractBodyEffect) and name != "link_inertia_error"
    number = None if arm else robot.dofs - 1 if joint is None else robot.joints.index(joint)
    if isinstance(effect, AbstractBodyEffect | AbstractMotionEffect) and parameters is not None:
        parameters = {k: np.asarray(v, float) if np.ndim(v) else float(v) for k, v in parameters.items()}
    return Cause(effect, number, parameters)
