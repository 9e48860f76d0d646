"""What is hidden and what is named: logs with an effect hidden in them, diagnosed, and counted (confusion.md)."""

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from experiments.cases import SIZES, WHOLE_ARM, Case, draw_case
from invdyn_cli.abstract_experiment import AbstractExperiment, chosen
from invdyn_cli.diagnosis import diagnose
from invdyn_cli.effects.catalogue import may_be_ambiguous
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.types import Diagnosis, Finding

LOUD = 3.0
"""Ratio of the hidden torque to the noise from which a log counts."""

MAIN = {
    "viscous_friction": ("damping",),
    "coulomb_friction": ("coulomb",),
    "asymmetric_coulomb_friction": ("positive", "negative"),
    "stribeck_friction": ("coulomb", "static"),
    "load_dependent_friction": ("mu",),
    "quadratic_friction": ("drag",),
    "thermal_friction_drift": ("cold", "warm"),
    "coupled_friction": ("coulomb", "damping"),
    "presliding_hysteresis": ("coulomb", "stiffness"),
    "torque_offset_drift": ("rate",),
    "backlash": ("gap",),
    "joint_elasticity": ("stiffness",),
    "torque_ripple": ("amplitude", "cycles"),
    "joint_spring": ("stiffness",),
    "rotor_inertia": ("armature",),
    "torque_gain_error": ("gain",),
    "torque_gain_change": ("gain",),
    "torque_offset": ("offset",),
    "torque_delay": ("delay",),
    "actuator_lag": ("time_constant",),
    "torque_saturation": ("limit",),
    "payload": ("mass",),
    "payload_change": ("mass",),
    "external_contact": ("force",),
    "link_inertia_error": (),
    "base_tilt": ("angle",),
    "encoder_offset": ("offset",),
}
"""The parameters that make an effect's size. Those of a gain are judged by their distance from one; what of a link's
inertials can be known differs from log to log, and is not judged."""


@dataclass(frozen=True)
class Outcome:
    """One log: what was hidden, what was said, and how right it is ("named", "ambiguous", "wrong", "nothing")."""

    seed: int
    hidden: tuple[str, ...]
    said: str
    share: float
    result: str
    named: tuple[str, ...]
    extra: tuple[str, ...]
    size_errors: tuple[float, ...]
    covered: tuple[bool, ...]
    seconds: float
    unexplained: float


ROUGH = {"backlash": 0.2, "joint_elasticity": 0.2}
"""Relative errors of sizes up to which they are right; 0.1 for all others."""

OVERLAP = 0.8
"""Share of two windows together that both must have to be the same."""


def claims(diagnosis: Diagnosis) -> list[Finding]:
    """Findings that claim something."""
    return [f for f in diagnosis.findings if f.status in ("named", "ambiguous")]


def matches(hidden: Hidden, finding: Finding) -> str:
    """How a finding speaks of a hidden effect: "named", "ambiguous" (within what theory allows), or ""."""
    whole = hidden.effect in WHOLE_ARM
    if finding.joint != hidden.joint and not (whole and finding.joint is None):
        return _elsewhere(hidden, finding)
    if not _together(hidden, finding):
        return ""
    if finding.effect == hidden.effect and finding.status == "named":
        return "named"
    sets = [(finding.effect,), *finding.alternatives]
    if finding.status == "ambiguous" and any(hidden.effect in one for one in sets):
        others = [one for one in sets if hidden.effect not in one]
        beyond = [one for one in others if not may_be_ambiguous(hidden.effect, tuple(one))]
        return "" if beyond else "ambiguous"
    return ""


def _together(hidden: Hidden, finding: Finding) -> bool:
    """Whether a finding is of the time at which the effect was there."""
    true = hidden.parameters.get("window")
    if true is None or finding.window is None:
        return true is None and finding.window is None
    ends = [*zip(true, finding.window, strict=True)]
    return min(ends[1]) - max(ends[0]) > OVERLAP * (max(ends[1]) - min(ends[0]))


def _elsewhere(hidden: Hidden, finding: Finding) -> str:
    """An ambiguous finding elsewhere may hold the hidden effect among its alternatives: payloads
    and links are told by bodies, which more than one joint feels."""
    bodies = {"payload", "link_inertia_error", "base_tilt", "encoder_offset", "payload_change", "external_contact"}
    sets = [(finding.effect,), *finding.alternatives]
    inside = any(hidden.effect in one for one in sets)
    allowed = all(may_be_ambiguous(hidden.effect, tuple(o)) for o in sets if hidden.effect not in o)
    if not _together(hidden, finding):
        return ""
    if finding.status == "ambiguous" and inside and allowed and (finding.effect in bodies or hidden.effect in bodies):
        return "ambiguous"
    return ""


def told_by(hidden: Hidden, found: Sequence[Finding]) -> Finding | None:
    """The finding that is what was hidden: the first that names it, else the first that has it among others."""
    how = {match: f for f in reversed(found) if (match := matches(hidden, f))}
    return how.get("named", how.get("ambiguous"))


def judge(case: Case, diagnosis: Diagnosis, seed: int, seconds: float) -> Outcome:
    """What a diagnosis of a case is worth."""
    found = claims(diagnosis)
    left = list(found)
    results, errors, covered = [], [], []
    for hidden in case.hidden:
        best = told_by(hidden, left)
        results.append(matches(hidden, best) if best else "")
        if best:
            left.remove(best)
            if best.effect == hidden.effect:
                more = _sizes(hidden, best)
                errors += [e for e, _ in more]
                covered += [c for _, c in more]
            partner = [f for f in left if f.effect == "torque_offset" and f.joint == hidden.joint]
            if hidden.effect == "asymmetric_coulomb_friction" and best.effect == "coulomb_friction" and partner:
                left.remove(partner[0])
            rotors = [f for f in left if "rotor" in hidden.parameters and _is_rotor(f, hidden)]
            left = [f for f in left if f not in rotors]  # a gear that yields has a rotor: right, and not asked for
    result = "nothing" if not found else "wrong"
    if all(results) and case.hidden:
        result = "ambiguous" if "ambiguous" in results else "named"
    if result in ("named", "ambiguous") and left:
        result = "wrong"
    return Outcome(
        seed=seed,
        hidden=tuple(map(name_of, case.hidden)),
        said=case.said,
        share=case.share,
        result=result,
        named=tuple(said_of(f) for f in found),
        extra=tuple(said_of(f) for f in left),
        size_errors=tuple(errors),
        covered=tuple(covered),
        seconds=seconds,
        unexplained=max(diagnosis.unexplained.values(), default=0.0),
    )


def _is_rotor(finding: Finding, hidden: Hidden) -> bool:
    """Whether a finding speaks of the rotor that an effect brings with it."""
    return finding.joint == hidden.joint and any(
        "rotor_inertia" in x for x in [(finding.effect,), *finding.alternatives]
    )


def name_of(hidden: Hidden | None) -> str:
    """What was hidden as effect@joint, or "none"."""
    return f"{hidden.effect}@{hidden.joint}" if hidden else "none"


def said_of(finding: Finding) -> str:
    """A finding as effect@joint, with its alternatives."""
    other = "".join("|" + "+".join(a) for a in finding.alternatives) if finding.status == "ambiguous" else ""
    return f"{finding.effect}{other}@{finding.joint}"


def _sizes(hidden: Hidden, finding: Finding) -> list[tuple[float, bool]]:
    """Error of each main parameter, as a share of what is allowed, and whether its interval holds the truth."""
    out = []
    for name in MAIN[hidden.effect]:
        quantity, true = finding.parameters[name], np.atleast_1d(np.asarray(hidden.parameters[name], float))
        if quantity.value is None or quantity.interval95 is None:
            continue
        off = relative_error(name, quantity.value, true)
        low, high = (np.atleast_1d(x) for x in quantity.interval95)
        inside = (low <= true) & (true <= high)
        rough = ROUGH.get(hidden.effect, 0.1)
        out += [(off / rough, bool(x)) for x in inside]
    return out


def relative_error(name: str, value: Any, true: Any) -> float:
    """Of a parameter, a number or a vector; of a gain, relative to its distance from one."""
    value, true = (np.atleast_1d(np.asarray(x, float)) for x in (value, true))
    return float(np.linalg.norm(value - true) / np.linalg.norm(true - 1 if name == "gain" else true))


def wilson(right: int, total: int) -> tuple[float, float]:
    """95 % interval of a share (Wilson 1927)."""
    if not total:
        return 0.0, 1.0
    z, p = 1.96, right / total
    middle, reach = p + z * z / (2 * total), z * math.sqrt(p * (1 - p) / total + z * z / (4 * total * total))
    return (middle - reach) / (1 + z * z / total), (middle + reach) / (1 + z * z / total)


def confused(loud: Sequence[Outcome], clean: Sequence[Outcome]) -> list[str]:
    """The confusion matrix off its diagonal: what was said that is not the hidden effect alone, on its joint."""
    logs: dict[tuple[str, str], list[bool]] = {}
    for o in (*loud, *clean):
        name, place = (*o.hidden, "nothing@None")[0].split("@")
        others = dict.fromkeys(_in_words(said, place) for said in o.named or ("nothing@None",))
        for other in others:
            logs.setdefault((name, other), []).append(o.result in ("named", "ambiguous"))
    lines = ["| hidden | said instead | logs | of these rightly |", "|---|---|---:|---:|"]
    told = ((*key, right) for key, right in logs.items() if key[0] != key[1])
    return lines + [f"| {name} | {other} | {len(right)} | {sum(right)} |" for name, other, right in told]


def _in_words(said: str, hidden: str) -> str:
    """The effects of a claim in words, and whether it is on another joint than `hidden`."""
    effects, joint = said.split("@")
    elsewhere = joint != hidden and "None" not in (joint, hidden)
    return effects.replace("|", " or ") + " on another joint" * elsewhere


@dataclass(frozen=True)
class Confusion(AbstractExperiment):
    """What is named of what is hidden; `only` may join effects with "+": both in one log."""

    row: ClassVar[type] = Outcome

    seed: int = 0
    logs: int = 10
    clean: int = 100
    only: Sequence[str] = ()

    def plan(self, rows: Sequence[Outcome]) -> Iterable[tuple]:
        """A job per log: its seed and what is hidden in it."""
        hidden = self.only or tuple(SIZES)
        chosen("only", [name for names in hidden for name in names.split("+")], SIZES)
        plan = [(1000 * self.seed + k, *names.split("+")) for k in range(self.logs) for names in hidden]
        return plan + [(1000 * self.seed + 500 + k,) for k in range(self.clean)]

    def run(self, folder: Path, seed: int, *names: str) -> Iterable[Outcome]:
        """Draw, diagnose, judge one log."""
        case = draw_case(seed, names)
        started = time.perf_counter()
        diagnosis = diagnose(case.log, case.robot)
        yield judge(case, diagnosis, seed, time.perf_counter() - started)

    def line(self, row: Outcome) -> str:
        """What was hidden and what was named."""
        return f"{row.result}: seed {row.seed} {row.hidden} -> {row.named} share {row.share:.1f} ({row.said})"

    def table(self, rows: Sequence[Outcome]) -> str:
        """The table of effects and what was said instead of them, as Markdown."""
        single = [o for o in rows if len(o.hidden) == 1]
        clean = [o for o in rows if not o.hidden]
        loud = [o for o in single if o.share >= LOUD]
        names = [n for n in MAIN if any(o.hidden[0].startswith(n + "@") for o in loud)]
        lines = [
            "| hidden | logs | named | ambiguous | nothing | wrong | recall | precision | size error, median | 90 % |"
        ]
        lines.append("|---|" + "---:|" * 9)
        for name in names:
            own = [o for o in loud if o.hidden[0].startswith(name + "@")]
            count = {r: sum(o.result == r for o in own) for r in ("named", "ambiguous", "nothing", "wrong")}
            right = count["named"] + count["ambiguous"]
            claimed = [o for o in rows for said in o.named if said.split("|")[0].split("@")[0] == name]
            true = sum(o in own and o.result in ("named", "ambiguous") for o in claimed)
            errors = [e for o in own for e in o.size_errors]
            percent = 100 * ROUGH.get(name, 0.1) * np.array(errors)
            size = f"{np.median(percent):.2g} % | {np.quantile(percent, 0.9):.2g} %" if errors else "- | -"
            precision = f"{true / len(claimed):.2f}" if claimed else "-"
            cells = (len(own), *count.values(), f"{right / max(len(own), 1):.2f}", precision, size)
            lines.append(f"| {name} | {' | '.join(map(str, cells))} |")
        right = sum(o.result in ("named", "ambiguous") for o in loud)
        unsure = sum(o.result == "ambiguous" for o in loud)
        errors = [e for o in loud for e in o.size_errors]
        covered = [c for o in loud for c in o.covered]
        false = sum(bool(o.named) for o in clean)
        low, high = wilson(right, len(loud))
        lines += [
            "",
            f"- Rightly named or rightly ambiguous: {right} of {len(loud)} loud logs "
            f"({100 * right / max(len(loud), 1):.1f} %, Wilson {100 * low:.1f} to {100 * high:.1f} %); ambiguous "
            f"{100 * unsure / max(len(loud), 1):.1f} %; {len(single) - len(loud)} logs below {LOUD:g} times the noise.",
            f"- Logs with nothing hidden: {false} of {len(clean)} with a name.",
        ]
        if errors:
            within = np.mean(np.array(errors) < 1)
            lines.append(
                f"- Sizes within 10 % (backlash and elasticity: 20 %): {100 * within:.1f} %. "
                f"Intervals that hold the truth: {100 * np.mean(covered):.1f} %."
            )
        lines.append(f"- Seconds per diagnosis: median {np.median([o.seconds for o in rows]):.1f}.")
        return "\n".join([*lines, "", *confused(loud, clean)])
