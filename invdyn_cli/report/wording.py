"""What a diagnosis says of effects, in words: names, laws, headlines, statuses."""

import re
from collections.abc import Collection, Mapping, Sequence
from html import escape
from typing import Any

from invdyn_cli.diagnosis.decide.doubt import UNKNOWN
from invdyn_cli.diagnosis.decide.wording import CLAIMS, PREDICTABLE, in_table
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.log import CHANNELS
from invdyn_cli.report.quantities import quantity_text, unit_text
from invdyn_cli.report.tables import significant
from invdyn_cli.types import Diagnosis, EffectText, Finding, Quantity

CAUTION = "It keeps the joints' limits; collisions are not checked."
"""What has to be known before a designed trajectory is played."""

UNSEEN = ("not_excited", "not_observable")
"""Statuses of effects that a log cannot show."""

NO_BREAK = "\N{NO-BREAK SPACE}"

SHOWN_RIVALS = 2
"""Largest number of alternatives in a headline (one more if it is the last); the list has all."""


def words(effect: str) -> str:
    """The effect's name in a sentence; a name that is not known with its underscores as blanks."""
    return EFFECTS[effect].title if effect in EFFECTS else effect.replace("_", " ")


def text_of(finding: Finding) -> EffectText:
    """How its effect is spoken of: a user's own effect brings its text with it."""
    if finding.text is None and finding.effect in EFFECTS:
        return EFFECTS[finding.effect].text
    return finding.text or EffectText(words(finding.effect), "", "", (), False, ())


def law(text: EffectText) -> str:
    """The effect's equation as HTML: parameters in <i>, and what is added to the nominal torque behind "τ +="."""
    marked = escape(text.equation)
    for name in sorted(text.parameters, key=len, reverse=True):
        marked = re.sub(rf"\b{name}\b", f"<i>{name}</i>", marked)
    for name, symbol in (("qdd", "q̈"), ("qd", "q̇")):
        marked = re.sub(rf"\b{name}(?![a-z])", symbol, marked)
    return f"τ += {marked}" if text.adds else marked


def capital(text: str) -> str:
    """The text with a capital first letter, the others as they are; a symbol that begins it stays, and so does an
    option."""
    first = text.partition(" ")[0]
    return text if first in CHANNELS or "." in first or "=" in first else text[:1].upper() + text[1:]


def set_words(effects: Sequence[str]) -> str:
    """'torque offset + Coulomb friction': effects that act together."""
    return " + ".join(map(words, effects))


def rivals_of(finding: Finding) -> list[str]:
    """The alternatives on this log in words, each once; its own name among them means that of another joint."""
    special = {(finding.effect,): "the same on another joint", UNKNOWN: "an effect that is not in the catalogue"}
    return list(dict.fromkeys(special.get(tuple(x)) or set_words(x) for x in finding.alternatives))


def shortened(names: Sequence[str], most: int = SHOWN_RIVALS) -> list[str]:
    """The names, and instead of those beyond `most` their number: 'payload', 'base tilt', '3 others'."""
    return list(names) if len(names) <= most + 1 else [*names[:most], f"{len(names) - most} others"]


def cause(finding: Finding) -> str:
    """The effect in words; an ambiguous one with its alternatives: 'payload or base tilt'."""
    rivals = rivals_of(finding) if finding.status == "ambiguous" else []
    return " or ".join([words(finding.effect), *shortened(rivals)])


def advised(diagnosis: Diagnosis) -> list[str]:
    """What would decide the ambiguous claims, a sentence for each advice."""
    same: dict[str, list[Finding]] = {}
    for x in claims(diagnosis):
        if x.status == "ambiguous" and x.advice:
            same.setdefault(x.advice.rstrip("."), []).append(x)
    return [
        f"{place(found[0])}, {cause(found[0])}: {advice}."
        if len(found) == 1
        else f"{', '.join(f'{place(x)} ({words(x.effect)})' for x in found)}: {advice}."
        for advice, found in same.items()
    ]


def gaining(joint: str, finding: Finding) -> str:
    """On which joint a gain was made, if it is not obvious: 'joint2; 3 joints gain', joint2 the most."""
    if joint == finding.joint:
        return ""
    count = len(finding.gain)
    return joint if count == 1 else f"{joint}; {count} joints gain"


def verdict_words(diagnosis: Diagnosis) -> str:
    """The verdict; an explained log on which residual tests still fail is explained except for small effects, and a log
    whose residual a learner predicts has something that has no name."""
    said = capital(diagnosis.verdict.replace("_", " "))
    if diagnosis.verdict == "explained" and not all(x.passed for x in diagnosis.tests):
        return f"{said}, except for small effects"
    unknown = diagnosis.verdict == "nothing_found" and any(x > PREDICTABLE for x in diagnosis.unexplained.values())
    return f"{said} that is in the catalogue" if unknown else said


def place(finding: Finding) -> str:
    """The joint, or 'whole arm'."""
    return finding.joint or "whole arm"


def places(some: Collection[str], every: Collection[str]) -> str:
    """The places, or 'all joints' if all of these are among them."""
    return "all joints" if len(every) > 1 and set(some) >= set(every) else ", ".join(some)


def windows(finding: Finding) -> list[tuple[float, float]]:
    """All windows in which an effect acts, [] for one that always acts."""
    again = [(start, end) for start, end in finding.evidence.get("again", ())]
    return [] if finding.window is None else sorted([finding.window, *again])


def when(finding: Finding) -> str:
    """Time windows such as '8.00 to 14.0 s of trajectory_1'; empty for an effect that always acts."""
    spans = [f"{significant(start)} to {significant(end)} s" for start, end in windows(finding)]
    return ", ".join(spans) + (f" of {finding.trajectory}" if spans and finding.trajectory else "")


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
    """The findings that claim an effect, in their order: those that `Signals.terms` belong to."""
    return tuple(x for x in diagnosis.findings if x.status in CLAIMS)


def standard_rows(diagnosis: Diagnosis) -> tuple[dict[str, Mapping[str, Any]], list[str]]:
    """The standard terms of the written model by joint, and the names of all that any joint has."""
    rows = {joint: terms for joint, terms in diagnosis.standard.items() if joint != "inertials"}
    return rows, list(dict.fromkeys(name for terms in rows.values() for name in terms))


def each_log(diagnosis: Diagnosis) -> list[tuple[bool, tuple[str, ...]]]:
    """Whether it differs for sure, and the cells under EACH_LOG, of every offset and friction of a comparison's logs,
    each fitted by itself; none where there is no reference."""
    made = []
    for joint, terms in standard_rows(diagnosis)[0].items():
        for name, x in terms.items():
            if "differ" not in x:
                continue
            each = (Quantity([one[0]], "-", [[end] for end in one[1:]]) for one in (x["reference"], x["now"]))
            then, now = (quantity_text(one).strip("()") for one in each)
            friction = name != "offset" and x["reference"][0] > 0
            change = f"{100 * (x['now'][0] / x['reference'][0] - 1):+.0f} %" if friction else ""
            made.append(
                (
                    x["differ"],
                    (joint, f"{name} [{unit_text(x['unit'])}]", then, now, change.replace("-", "\N{MINUS SIGN}")),
                )
            )
    return made


def perhaps(diagnosis: Diagnosis) -> str:
    """'; *: or Stribeck friction' of the marks in the table of standard terms; nothing where there are none."""
    names = _named_in_table(diagnosis, "perhaps")
    return f"; *: or {' or '.join(map(words, names))}" if names else ""


def included(diagnosis: Diagnosis) -> str:
    """A sentence: which effects' Coulomb friction the table of standard terms counts, too; "" for none."""
    names = _named_in_table(diagnosis, "with")
    return f" Coulomb friction includes that of {' and '.join(map(words, names))} on the same joint." if names else ""


def _named_in_table(diagnosis: Diagnosis, key: str) -> list[str]:
    """The effects that stand under a key in the table of standard terms, each once."""
    found = (x.get(key, ()) for terms in standard_rows(diagnosis)[0].values() for x in terms.values())
    return list(dict.fromkeys(name for own in found for name in own))


EACH_LOG = ("joint", "term", "in the reference", "now", "change")


def causes(diagnosis: Diagnosis) -> list[tuple[int, Finding]]:
    """Claims with their numbers from 1, but for those that stand in the table of what every arm has."""
    elsewhere = in_table(diagnosis)
    numbered = enumerate(claims(diagnosis), start=1)
    return [(number, x) for number, x in numbered if not any(x is y for y in elsewhere)]


def joints_of(diagnosis: Diagnosis) -> tuple[str, ...]:
    """The joints in the order of the signals' columns."""
    return tuple(diagnosis.baseline)


def picture(number: int, finding: Finding) -> str:
    """File name (without suffix) of the picture of the `number`-th claim, counted from 1."""
    safe = "".join(x if x.isascii() and (x.isalnum() or x == "_") else "-" for x in finding.effect)
    return f"finding_{number:02d}_{safe}"
