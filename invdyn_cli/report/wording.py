"""Effects in words, and what a diagnosis says of them: names, equations, headlines, statuses."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from invdyn_cli.diagnosis.decide.wording import in_table
from invdyn_cli.report.quantities import quantity_text
from invdyn_cli.report.tables import significant
from invdyn_cli.types import Diagnosis, Finding


@dataclass(frozen=True)
class Effect:
    """How an effect is spoken of.

    Attributes:
        words: its name in a sentence.
        law: its term as HTML, parameters in <i>: what it adds to the torque of the nominal model, or for a channel
            effect what is delivered for what is logged.
        meaning: one sentence for who never met it.
    """

    words: str
    law: str
    meaning: str


EFFECTS: dict[str, Effect] = {
    "viscous_friction": Effect("viscous friction", "τ += <i>damping</i> q̇", "A drag that grows with the speed."),
    "coulomb_friction": Effect(
        "Coulomb friction", "τ += <i>coulomb</i> sign(q̇)", "A drag against the motion that is the same at every speed."
    ),
    "asymmetric_coulomb_friction": Effect(
        "asymmetric Coulomb friction",
        "τ += <i>positive</i> where q̇ &gt; 0, −<i>negative</i> where q̇ &lt; 0",
        "A constant drag that is stronger in one direction than in the other.",
    ),
    "stribeck_friction": Effect(
        "Stribeck friction",
        "τ += (<i>coulomb</i> + (<i>static</i> − <i>coulomb</i>) exp(−(q̇/<i>velocity</i>)²)) sign(q̇)",
        "A drag that is higher near standstill and falls off as the joint gets going.",
    ),
    "load_dependent_friction": Effect(
        "load-dependent friction",
        "τ += <i>mu</i> |τ<sub>transmitted</sub>| sign(q̇)",
        "A drag that grows with the torque that the gear has to carry.",
    ),
    "quadratic_friction": Effect(
        "quadratic friction", "τ += <i>drag</i> q̇ |q̇|", "A drag that grows with the square of the speed."
    ),
    "presliding_hysteresis": Effect(
        "presliding hysteresis",
        "τ += <i>stiffness</i> z, dz/dt = q̇ − (<i>stiffness</i>/<i>coulomb</i>) |q̇| z",
        "A friction that first yields like a spring after every reversal.",
    ),
    "coupled_friction": Effect(
        "coupled friction",
        "s = q̇ + <i>ratio</i> q̇<sub>driver</sub>; τ += <i>coulomb</i> sign(s) + <i>damping</i> s + <i>armature</i> ṡ, "
        "τ<sub>driver</sub> += <i>ratio</i> times as much",
        "Friction and inertia of a drive that the joint before its own turns as well, as in a wrist whose joints share "
        "a gear.",
    ),
    "thermal_friction_drift": Effect(
        "friction that warms up",
        "τ += (<i>warm</i> + (<i>cold</i> − <i>warm</i>) exp(−t/<i>time_constant</i>)) q̇",
        "A viscous friction that falls as the gear gets warm.",
    ),
    "torque_offset_drift": Effect("torque offset drift", "τ += <i>rate</i> t", "A torque zero that walks off."),
    "backlash": Effect("backlash", "the link is free of the motor within <i>gap</i> (full width)", "Play in the gear."),
    "joint_elasticity": Effect(
        "joint elasticity", "a spring of <i>stiffness</i> between motor and link", "A gear that winds up under load."
    ),
    "torque_ripple": Effect(
        "torque ripple",
        "τ += <i>amplitude</i> sin(<i>cycles</i> q + <i>phase</i>)",
        "A torque that waves with the joint's angle: cogging, or a gear that is not round.",
    ),
    "joint_spring": Effect(
        "joint spring",
        "τ += <i>stiffness</i> (q − <i>rest</i>)",
        "Something that pulls the joint back to a rest angle: a cable, a hose, a balancer.",
    ),
    "rotor_inertia": Effect(
        "rotor inertia", "τ += <i>armature</i> q̈", "The motor's own inertia, as felt through the gear."
    ),
    "torque_gain_error": Effect(
        "torque gain error",
        "delivered = <i>gain</i> × logged",
        "A torque sensor or constant whose scale is off: the joint delivers another multiple of what is logged.",
    ),
    "torque_gain_change": Effect(
        "torque gain change",
        "delivered = <i>gain</i> × logged, within the window",
        "An actuator that gets weaker or stronger on the way.",
    ),
    "torque_offset": Effect("torque offset", "τ += <i>offset</i>", "A constant torque: a sensor's zero, say."),
    "torque_delay": Effect(
        "torque delay",
        "delivered(t) = logged(t − <i>delay</i>)",
        "The torque reaches the joint later than the log says.",
    ),
    "actuator_lag": Effect(
        "actuator lag",
        "<i>time_constant</i> · d(delivered)/dt + delivered = logged",
        "The torque follows the logged one like a first-order filter.",
    ),
    "torque_saturation": Effect(
        "torque saturation",
        "delivered = clip(logged, ±<i>limit</i>)",
        "The drive gives no more than a limit, whatever is asked of it.",
    ),
    "payload": Effect(
        "payload",
        "τ += Y<sub>last link</sub>(q, q̇, q̈) · (<i>mass</i>, <i>mass</i> <i>com</i>, …)",
        "A body on the last link that the URDF does not have: a tool, a load.",
    ),
    "payload_change": Effect(
        "payload change",
        "τ += Y<sub>last link</sub>(q, q̇, q̈) · (<i>mass</i>, <i>mass</i> <i>com</i>, …), within the window",
        "Something that the arm picked up or put down.",
    ),
    "external_contact": Effect(
        "external contact", "τ −= J(q)ᵀ <i>force</i>, within the window", "Something that the arm touched."
    ),
    "link_inertia_error": Effect(
        "link inertia error",
        "τ += Y<sub>link</sub>(q, q̇, q̈) Δφ",
        "One link's mass, centre of mass or inertia is not what the URDF says.",
    ),
    "base_tilt": Effect(
        "base tilt",
        "gravity = 9.81 (sin <i>angle</i> cos <i>azimuth</i>, sin <i>angle</i> sin <i>azimuth</i>, −cos <i>angle</i>)",
        "The base does not stand level.",
    ),
    "encoder_offset": Effect(
        "encoder offset", "logged q = true q + <i>offset</i>", "The joint's zero is not where the URDF has it."
    ),
}

STATUS_WORDS = {
    "named": "named",
    "ambiguous": "ambiguous",
    "not_excited": "not excited",
    "not_observable": "not observable",
}
NO_BREAK = "\N{NO-BREAK SPACE}"
SHOWN_RIVALS = 2
"""Alternatives that a headline names, one more if it is the last; the list has them all."""

CLAIMS = ("named", "ambiguous")
"""Statuses of findings that say something is there; the others say what could not be seen."""

VERDICT_WORDS = {
    "explained": "explained",
    "partly_explained": "partly explained",
    "nothing_found": "nothing found",
    "log_unusable": "log unusable",
}


def words(effect: str) -> str:
    """The effect's name in a sentence; a name that is not known with its underscores as blanks."""
    return EFFECTS[effect].words if effect in EFFECTS else effect.replace("_", " ")


def capital(text: str) -> str:
    """The text with a capital first letter, the others as they are."""
    return text[:1].upper() + text[1:]


def set_words(effects: Sequence[str]) -> str:
    """'torque offset + Coulomb friction': effects that act together."""
    return " + ".join(map(words, effects))


def rivals_of(finding: Finding) -> list[str]:
    """What could replace it on this log, each once, in words; its own name among them is that of another joint."""
    said = ("the same on another joint" if x == (finding.effect,) else set_words(x) for x in finding.alternatives)
    return list(dict.fromkeys(said))


def shortened(names: Sequence[str], most: int = SHOWN_RIVALS) -> list[str]:
    """The names, and instead of those beyond `most` their number: 'payload', 'base tilt', '3 others'."""
    return list(names) if len(names) <= most + 1 else [*names[:most], f"{len(names) - most} others"]


def cause(finding: Finding) -> str:
    """The effect in words; where data leave it open with its alternatives: 'payload or base tilt'."""
    rivals = rivals_of(finding) if finding.status == "ambiguous" else []
    return " or ".join([words(finding.effect), *shortened(rivals)])


def place(finding: Finding) -> str:
    """The joint, or 'whole arm'."""
    return finding.joint or "whole arm"


def when(finding: Finding) -> str:
    """'8.00 to 14.0 s of trajectory_1': the window of what comes and goes, nothing for what lasts."""
    if finding.window is None:
        return ""
    start, end = map(significant, finding.window)
    return f"{start} to {end} s" + (f" of {finding.trajectory}" if finding.trajectory else "")


def estimates(finding: Finding) -> list[str]:
    """Every parameter that could be known with its name, as 'coulomb 2.00 N m [1.98, 2.02]'; one that stands alone is
    known by its unit."""
    shown = {name: quantity_text(x) for name, x in finding.parameters.items() if x.value is not None}
    alone = len(shown) == len(finding.parameters) == 1 and next(iter(finding.parameters.values())).unit != "-"
    return list(shown.values()) if alone else [f"{name.replace('_', ' ')} {text}" for name, text in shown.items()]


def headline_of(finding: Finding) -> str:
    """'Coulomb friction 2.00 N m [1.98, 2.02]', or 'torque ripple, amplitude 0.45 N m [0.43, 0.47], cycles …'; what
    comes and goes with its window."""
    said, every = cause(finding), estimates(finding)
    every += [x for x in (when(finding),) if x]
    alone = len(every) == 1 and not every[0][:1].isalpha() and finding.status != "ambiguous"
    return (" " if alone else ", ").join([said, *(x.replace(" ", NO_BREAK) for x in every)])


def claims(diagnosis: Diagnosis) -> tuple[Finding, ...]:
    """The findings that say something is there, in their order: those that `Signals.terms` belong to."""
    return tuple(x for x in diagnosis.findings if x.status in CLAIMS)


def standard_rows(diagnosis: Diagnosis) -> tuple[dict[str, Mapping[str, Any]], list[str]]:
    """The standard terms of the written model by joint, and the names of all that any joint has."""
    rows = {joint: terms for joint, terms in diagnosis.standard.items() if joint != "inertials"}
    return rows, list(dict.fromkeys(name for terms in rows.values() for name in terms))


def causes(diagnosis: Diagnosis) -> list[tuple[int, Finding]]:
    """Claims with their numbers from 1, but for those that stand in the table of what every arm has."""
    elsewhere = in_table(diagnosis)
    numbered = enumerate(claims(diagnosis), start=1)
    return [(number, x) for number, x in numbered if not any(x is y for y in elsewhere)]


def joints_of(diagnosis: Diagnosis) -> tuple[str, ...]:
    """The joints in the order of the signals' columns."""
    return diagnosis.fit.joints if diagnosis.fit else tuple(diagnosis.baseline)


def units_of(diagnosis: Diagnosis) -> dict[str, str]:
    """Unit of every joint's torque: N for a joint known to slide, else N m; A where a drive's gain is not known."""
    robot = diagnosis.fit.robot if diagnosis.fit else None
    slides = dict(zip(robot.joints, robot.prismatic, strict=True)) if robot else {}
    currents = diagnosis.details.get("torque_in_A", ())
    units = {joint: "N" if slides.get(joint) else "N m" for joint in joints_of(diagnosis)}
    return {joint: "A" if joint in currents else unit for joint, unit in units.items()}


def picture(number: int, finding: Finding) -> str:
    """File name (without suffix) of the picture of the `number`-th claim, counted from 1."""
    safe = "".join(x if x.isascii() and (x.isalnum() or x == "_") else "-" for x in finding.effect)
    return f"finding_{number:02d}_{safe}"
