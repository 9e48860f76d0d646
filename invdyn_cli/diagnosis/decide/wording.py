"""The verdict, in one word and in two sentences."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from invdyn_cli.diagnosis.decide.findings import Made
from invdyn_cli.diagnosis.decide.passing import perhaps_unknown
from invdyn_cli.interfaces import AbstractEffect
from invdyn_cli.types import Diagnosis, Finding

PREDICTABLE, SMALL = 0.15, 0.05
"""The residual counts as explained if the learner predicts less than this share of its variance, or less than this
share of the nominal model's error, in N m (docs/decisions/060); residual tests that find less are not in the summary
if it tells of a learner."""

MOST_SAID, MOST_TESTS = 4, 3
"""Numbers of effects in the summary's first sentence, and of residual tests in its last one, that are named where there
are at least two more."""

CLAIMS = ("named", "ambiguous")
"""Statuses of findings that claim an effect; the others say what the log cannot show."""

SINCE = "since_reference"
"""Among a diagnosis's details, where only changes since a reference were looked for: errors of a model of both logs,
without the changes and with them."""

FEW = 2
"""Largest number of named standard terms that are listed one by one."""

LITTLE = 0.9
"""If more than this share of the error of all joints is left, and less on one joint, the summary tells that joint's."""

TEST_WORDS = {
    "level": "constant offset",
    "ripple": "periodic in the angle",
    "load": "load torque",
    "load_zeros": "load sign changes",
    "torque_slope": "torque rate",
    "neighbours": "neighbouring joints",
}
"""Names of residual tests in tables and sentences, if they differ from the tests' own."""


def verdict(
    made: Made,
    learned: np.ndarray,
    structured_joints: np.ndarray,
    structured: np.ndarray,
    floor: np.ndarray | None,
    extended: Mapping[str, Mapping[str, float]],
) -> str:
    """explained, partly_explained or nothing_found; partly where an anomaly may be of an unknown effect.

    Args:
        learned: share of the residual (n,) that a learner predicts.
        structured_joints: whether (n,) it is no noise.
        structured: RMS torque (n,) of what residual tests find in it.
    """
    if not any(f.status in CLAIMS for f in made.findings):
        return "nothing_found"
    before = np.sqrt(np.mean(made.before**2, axis=0))
    after = np.array([x["rmse"] for x in extended.values()])
    left = np.maximum(np.where(structured_joints, 1.0, np.sqrt(np.nan_to_num(learned))) * after, structured)
    fine = ~(structured_joints | (learned > PREDICTABLE) | (structured > 0)) | (left < SMALL * before)
    if floor is not None:
        fine |= after < 1.2 * np.sqrt(2) * floor
    return "explained" if np.all(fine) and not perhaps_unknown(made.findings) else "partly_explained"


def summary(diagnosis: Diagnosis, effects: Mapping[str, AbstractEffect]) -> str:
    """The verdict in two or three sentences; `effects` by name."""
    still = [j for j, share in diagnosis.unexplained.items() if np.isnan(share)]
    said = _summary(diagnosis, effects)
    return f"{said} Not assessed (too little motion in this log): {', '.join(still)}." if still else said


def _summary(diagnosis: Diagnosis, effects: Mapping[str, AbstractEffect]) -> str:
    claims = [f for f in diagnosis.findings if f.status in CLAIMS]
    units = units_of(diagnosis)
    ((unit, _),) = Counter(units.values()).most_common(1)
    apart = [joint for joint, own in units.items() if own != unit]
    tables = diagnosis.details.get(SINCE, (diagnosis.baseline, diagnosis.extended))
    before, after = (
        np.sqrt(np.mean([x["rmse"] ** 2 for joint, x in table.items() if joint not in apart])) for table in tables
    )
    compares = SINCE in diagnosis.details
    over = "all joints" if not apart else f"all joints except {_listed(apart)}"
    rest = _rest(diagnosis)
    if not claims:
        first = "No cause was found: the held-out RMS error of the nominal model"
        if compares:
            first = "No change since the reference was identified: the held-out RMS error of one model of both logs"
        written = ""
        if after < before and not compares:
            written = f"; with its unclaimed links and standard terms, the written model has {after:.3g} {unit}"
        return f"{first} is {before:.3g} {unit} over {over}{written}. {rest or 'The residual looks like noise.'}"
    usual = in_table(diagnosis)
    new = [f for f in claims if compares and f.window is not None]
    shown = [f for f in claims if not any(f is x for x in (*usual, *new))]
    said = _grouped(shown, effects)
    said = _first(said, MOST_SAID, "other effects")
    if usual:
        joints = len({f.joint for f in usual})
        several = f"standard terms (friction and the like) on {joints} joint{'s' * (joints > 1)}"
        few = [f"{effects[f.effect].title} on {f.joint}" for f in usual]
        terms = few if len(few) <= FEW else [several]
        said = [*said, *terms]
    others = len(diagnosis.unclaimed)
    more = f", and {others} less certain one{'s' * (others > 1)} only in the written model," if others else ","
    if not compares:
        first = f"The simulation lacks {_listed(said)}. With these effects{more} its held-out RMS error"
    else:
        has = "has" if len(said) == 1 else "have"
        changed = [f"Since the reference, {_listed(said)} {has} changed."] if said else []
        if new:
            changed.append(f"In this log only, and only for a time, there is {_listed(_grouped(new, effects))}.")
        first = f"{' '.join(changed)} With that, the held-out RMS error of a model of both logs"
    first += f" {'falls' if after < before else 'goes'} from {before:.3g} to {after:.3g} {unit} over {over}"
    ratios = {j: tables[1][j]["rmse"] / x["rmse"] for j, x in tables[0].items() if x["rmse"] > 0}
    best = min(ratios, key=lambda j: ratios[j], default="")
    if after > LITTLE * before and best and ratios[best] < LITTLE:
        was, now = (x[best]["rmse"] for x in tables)
        first += f", on {best} from {was:.3g} to {now:.3g} {units[best]}"
    first += "."
    if diagnosis.verdict == "explained" and rest:
        return f"{first} The residual is not pure noise, but it is small compared with these effects."
    rubs = all(f.group == "standard" or effects[f.effect].friction for f in claims)
    if rubs and diagnosis.verdict != "explained" and not compares:
        first += " No other cause than friction was found."
    doubted = _grouped([replace(f, status="named") for f in perhaps_unknown(claims)], effects)
    doubt = f" An effect that is not in the catalogue may act instead of {_listed(doubted)}." if doubted else ""
    return f"{first} {rest or 'The residual looks like noise.'}{doubt}"


def units_of(diagnosis: Diagnosis) -> dict[str, str]:
    """Unit of every joint's torque: N for a joint that slides, A where a drive's gain is not known, else N m."""
    terms = {joint: diagnosis.standard.get(joint, {}).get("offset", {}) for joint in diagnosis.baseline}
    return {joint: own.get("unit", "N m") for joint, own in terms.items()}


def _grouped(findings: Sequence[Finding], effects: Mapping[str, AbstractEffect]) -> list[str]:
    """Effects with their joints, in the order of the findings: 'Coulomb friction on joint1 and joint2', 'viscous
    friction on 7 joints'."""
    joints: dict[str, list[str]] = {}
    for f in findings:
        doubt = " (or an alternative)" if f.status == "ambiguous" else ""
        joints.setdefault(effects[f.effect].title + doubt, []).extend([f.joint] if f.joint else [])
    where = {title: list(dict.fromkeys(own)) for title, own in joints.items()}
    return [
        title + (f" on {_listed(own) if len(own) <= FEW else f'{len(own)} joints'}" if own else "")
        for title, own in where.items()
    ]


def in_table(diagnosis: Diagnosis) -> tuple[Finding, ...]:
    """The claims in the table of standard terms: those of the standard model, named or with alternatives that have
    them as a special case."""
    rows = ((joint, terms) for joint, terms in diagnosis.standard.items() if joint != "inertials")
    there = {(x["effect"], joint) for joint, terms in rows for x in terms.values() if x["claimed"] or "perhaps" in x}
    lasting = (x for x in diagnosis.findings if x.status in CLAIMS and x.window is None)
    return tuple(x for x in lasting if (x.effect, x.joint) in there)


def _rest(diagnosis: Diagnosis) -> str:
    """A sentence on the structured part of the residual, "" if there is none."""
    shares = {j: share for j, share in diagnosis.unexplained.items() if share > PREDICTABLE}
    moments = diagnosis.details.get("moments", {})
    swings = [j for j in diagnosis.details.get("beyond_noise", ()) if j not in shares and j not in moments]
    said = []
    units = units_of(diagnosis)
    for joint, x in moments.items():
        when = f"from {x['start']:.1f} to {x['end']:.1f} s of {x['trajectory']}"
        said.append(
            f"Most of what remains on {joint} is {when} ({x['there']:.3g} {units[joint]}); its cause is unknown."
        )
    if shares:
        most = f"a learner still predicts up to {100 * max(shares.values()):.0f} % of the residual"
        said.append(f"An unknown effect remains on {', '.join(shares)}: {most}.")
    if swings:
        where = ", ".join(swings)
        said.append(f"The residual on {where} has a pattern in time, but no learner predicts it from the motion.")
    told, least = {*moments, *shares, *swings}, PREDICTABLE if said else 0.0
    failed = [x for x in diagnosis.tests if not x.passed and x.share >= least and x.joint not in told]
    if failed:
        failed.sort(key=lambda x: -x.torque)
        where = _listed(list(dict.fromkeys(x.joint for x in failed)))
        names = _first(list(dict.fromkeys(test_words(x.against) for x in failed)), MOST_TESTS, "others")
        said.append(f"The residual on {where} is not noise according to these tests: {_listed(names)}.")
    return " ".join(said)


def test_words(against: str) -> str:
    """What a residual test examines, in words."""
    return TEST_WORDS.get(against, against.replace("_", " "))


def _first(words: Sequence[str], most: int, others: str) -> Sequence[str]:
    """The words, or the first of them and the number of the others, if these are at least two."""
    return words if len(words) <= most + 1 else [*words[:most], f"{len(words) - most} {others}"]


def _listed(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1]
