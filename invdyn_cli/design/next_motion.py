"""What to record next: ambiguous findings become questions of a design, and its answer becomes sentences."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from invdyn_cli.design.causes import Cause
from invdyn_cli.design.contest import Side
from invdyn_cli.design.sizes import left_out, refused, unplayable
from invdyn_cli.design.trajectory import APART, CHANCE, TRIES, Design, Told, design
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


@dataclass(frozen=True)
class Open:
    """An ambiguous finding, by its number.

    Attributes:
        sides: between which it is open, as far as a motion can be designed for them.
        said: what its advice says of those for which none can.
        notes: what is said of those that are not known here.
    """

    finding: int
    sides: tuple[Side, ...]
    said: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def playable(self) -> bool:
        """Whether there are causes to distinguish."""
        return len(self.sides) > 1


def all_open(findings: Sequence[Finding], robot: Robot) -> list[Open]:
    """All ambiguous findings, also those for which no motion can be designed."""
    return [_opened(number, one, robot) for number, one in enumerate(findings) if one.status == "ambiguous"]


def _opened(number: int, finding: Finding, robot: Robot) -> Open:
    """The cause of a finding and its rivals, with the sizes that the log gave, or none. A rival for which no motion can
    be designed, or that is unknown here, is left out with a message."""
    own = _found_cause(finding, robot)
    if isinstance(own, str):
        known = finding.effect in EFFECTS
        return Open(number, (), (own,) if known else (), () if known else (own,))
    sides: dict[Any, Side] = {(own.key,): (own,)}
    missed: dict[str, str] = {}
    found = set()
    for name, joint, parameters in _rivals(finding):
        made = _told_cause(name, joint, parameters, robot)
        if isinstance(made, str):
            missed[name] = made
        else:
            found.add(name)
            sides.setdefault((made.key,), (made,))
    for names in finding.alternatives:
        if len(names) == 1 and names[0] in found:
            continue
        each = {name: _told_cause(name, finding.joint, None, robot) for name in names if name != "unknown"}
        side = tuple(x for x in each.values() if isinstance(x, Cause))
        missed |= {name: made for name, made in each.items() if isinstance(made, str)}
        if side and len(side) == len(names):
            sides.setdefault(tuple(c.key for c in side), side)
    said = tuple(dict.fromkeys(x for name, x in missed.items() if name in EFFECTS))
    notes = tuple(dict.fromkeys(x for name, x in missed.items() if name not in EFFECTS))
    return Open(number, tuple(sides.values()), said, notes)


def _rivals(finding: Finding) -> list[tuple[str, Any, Any]]:
    """Effect, joint and parameters of the equally good alternatives, as far as the evidence contains them."""
    listed_ones = finding.evidence.get("rivals", ())
    listed_ones = listed_ones if isinstance(listed_ones, list | tuple) else ()
    each = [x for x in listed_ones if isinstance(x, Mapping) and isinstance(x.get("effect"), str)]
    return [(x["effect"], x.get("joint"), x.get("parameters")) for x in each]


def _found_cause(finding: Finding, robot: Robot) -> Cause | str:
    return _told_cause(finding.effect, finding.joint, {k: q.value for k, q in finding.parameters.items()}, robot)


def _told_cause(name: str, joint: Any, parameters: Any, robot: Robot) -> Cause | str:
    """A cause from a finding, without parameters if they are incomplete; or the reason why it is not one."""
    if name not in EFFECTS:
        return f"{name} is not in the catalogue: no motion can be designed for it."
    if joint is not None and joint not in robot.joints:
        return left_out(EFFECTS[name], f"{robot.name} has no joint {joint!r}")
    whole = isinstance(parameters, Mapping) and not refused(EFFECTS[name], parameters)
    own = {k: parameters[k] for k in EFFECTS[name].parameters} if whole else None
    why = unplayable(EFFECTS[name], robot, own, joint)
    return left_out(EFFECTS[name], why) if why else cause_of(name, joint, own, robot)


def known_beside(findings: Sequence[Finding], robot: Robot) -> list[Cause]:
    """The causes that the log shows with certainty; a new log will contain them too."""
    named = [f for f in findings if f.status == "named"]
    return [x for x in (_found_cause(f, robot) for f in named) if isinstance(x, Cause)]


def after(
    diagnosis: Diagnosis,
    robot: Robot,
    *,
    duration: float = DURATION,
    seed: int = 0,
    progress: Progress = silent,
) -> tuple[Diagnosis, Design | None]:
    """The diagnosis with, in the advice of every ambiguous finding, whether one more recording would settle it; and
    that recording, for all of them together (None: nothing is open, or no motion would)."""
    every = all_open(diagnosis.findings, robot)
    findings = list(diagnosis.findings)
    for one in every:
        if one.said and not one.playable:
            findings[one.finding] = _said(findings[one.finding], one.said)
    notes = tuple(dict.fromkeys((*diagnosis.notes, *(x for one in every for x in one.notes))))
    diagnosis = replace(diagnosis, findings=tuple(findings), notes=notes)
    questions = [x for x in every if x.playable]
    if not questions:
        return diagnosis, None
    noise, cutoffs = (_each(diagnosis.details, x, robot) for x in ("noise_N_m", "filter_cutoff_Hz"))
    try:
        made = design(
            robot,
            [x.sides for x in questions],
            duration=duration,
            noise=noise,
            cutoffs=cutoffs,
            seed=seed,
            known=known_beside(diagnosis.findings, robot),
            tries=TRIES // 2 if robot.dofs >= LARGE_ARM else TRIES,
            progress=progress,
        )
    except UsageError as error:
        return replace(diagnosis, notes=(*diagnosis.notes, f"No further recording was designed: {error}")), None
    for k, one in enumerate(questions):
        findings[one.finding] = _said(_advised(findings[one.finding], made.of(k), duration), one.said)
    useful = any(pair.useful for pair in made.pairs)
    return replace(diagnosis, findings=tuple(findings)), made if useful else None


def _each(details: Mapping[str, Any], name: str, robot: Robot) -> np.ndarray:
    """A number of every joint (n,), nan where the diagnosis has none."""
    told = details.get(name, {})
    return np.array([float(told.get(j, np.nan)) for j in robot.joints])


def _said(finding: Finding, said: Sequence[str]) -> Finding:
    """The finding with these sentences added to its advice, if they are new."""
    own = "" if any(finding.advice in x for x in said) else finding.advice
    return replace(finding, advice=". ".join(x for x in (own, *said) if x))


def _advised(finding: Finding, pairs: Sequence[Told], duration: float) -> Finding:
    """The finding with the answer of the design in its advice."""
    can = [p for p in pairs if p.useful]
    cannot = [p for p in pairs if not p.useful]
    said = []
    if can:
        separates, by = "separates", f"{APART:g} standard errors or more"
        if not all(p.apart for p in can):
            separates, by = "probably separates", f"{CHANCE:g} to {APART:g} standard errors"
        said.append(f"play and log {FILE} ({duration:g} s): it {separates} {_names(can)} ({by})")
    if cannot and finding.advice:
        motion = f"motion of {duration:g} s" if any(p.possible for p in cannot) else "motion"
        said.append(f"no {motion} separates {_names(cannot)}; use instead: {finding.advice}")
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


def cause_of(name: str, joint: str | None, parameters: Mapping[str, Any] | None, robot: Robot) -> Cause:
    """A cause by its names; what acts on the whole arm has no joint, and the joint of what needs one is the last."""
    effect = EFFECTS[name]
    number = None if not effect.of_joint else robot.dofs - 1 if joint is None else robot.joints.index(joint)
    if isinstance(effect, AbstractBodyEffect | AbstractMotionEffect) and parameters is not None:
        parameters = {k: np.asarray(v, float) if np.ndim(v) else float(v) for k, v in parameters.items()}
    return Cause(effect, number, parameters)
