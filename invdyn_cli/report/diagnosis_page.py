"""A diagnosis as one HTML file that needs nothing else: the verdict, every cause with its evidence, what the log could
not have shown, and how to use the better model."""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any

from invdyn_cli.diagnosis.decide.doubt import UNKNOWN
from invdyn_cli.diagnosis.decide.wording import PREDICTABLE, SINCE, in_table, units_of
from invdyn_cli.files import write_file
from invdyn_cli.report.better_simulation import better_simulation
from invdyn_cli.report.check_table import PILLS, check_table, pill, skipped_reasons
from invdyn_cli.report.diagnosis_figures import OVERVIEW
from invdyn_cli.report.diagnosis_plots import diagnosis_plots
from invdyn_cli.report.diagnosis_tables import ERROR_HEADS, errors_of
from invdyn_cli.report.html import document, folded, pairs, picture, row, section, table
from invdyn_cli.report.model_sections import standard_section, unclaimed_section
from invdyn_cli.report.overlay import OPENING, OVERLAY, caption
from invdyn_cli.report.quantities import best_gain, gain_text, in_degrees, quantity_text
from invdyn_cli.report.replay_figure import REPLAY
from invdyn_cli.report.residual_tests import RESIDUAL_TESTS, failing, tests_section
from invdyn_cli.report.tables import significant
from invdyn_cli.report.wording import (
    CAUTION,
    NO_BREAK,
    UNSEEN,
    advised,
    capital,
    cause,
    causes,
    claims,
    estimates,
    gaining,
    joints_of,
    law,
    place,
    places,
    rivals_of,
    text_of,
    verdict_words,
    when,
    words,
)
from invdyn_cli.report.wording import picture as picture_name
from invdyn_cli.types import Diagnosis, Finding, Gain

OVERLAY_CAPTION = (
    "Measured torque beside that of the nominal and of the extended model; in print, and without JavaScript, the "
    "held-out seconds in which the error of the nominal model is largest."
)
CAPTION = (
    "Measured torque minus the terms of all other effects, and the fitted term of this effect, which should follow it."
)
OVERVIEW_CAPTION = (
    "Errors on held-out data. A black line, if there is one, is the noise floor: how much the torque differs between "
    f"repetitions of a trajectory. Where a small neural network predicts over {100 * PREDICTABLE:g} % of the residual, "
    "a cause has no name here."
)
COMMAND = """\
invdyn run data=real_log data.path=log.h5 robot.path=arm.urdf model=extended model.path=extended_model.json"""
COMMAND_NOTE = """\
Run this in the folder of this report, with the paths of a log of this robot and of its URDF. A log that has the \
joint names of the URDF needs no robot.path: the model file contains the robot."""
CHECK = """\
invdyn check data=real_log data.path=log.h5 robot=urdf robot.path=arm.urdf"""
PYTHON = """\
from invdyn_cli import load_model

model = load_model("extended_model.json")
tau = model.predict(q, qd, qdd)   # one recording, (T, n) each, evenly sampled: N m for rad, rad/s, rad/s²"""
FOLD_FROM = 4
"""Rejected rivals, or notes, from which their list is folded."""

STYLE = """
.verdict { font-weight: 600; } .lead { margin-top: .6rem; }
.note-line { border-left: 4px solid var(--line); padding: .2rem .8rem; margin: .4rem 0; color: var(--soft); }
table.dense th { white-space: normal; vertical-align: bottom; } table.dense td, table.dense th { padding: .2rem .4rem; }
@media (min-width: 46rem) { table.causes { min-width: 58rem; } table.causes td:nth-child(4) { min-width: 13.5rem; } }
td small.name, .name { font-family: ui-monospace, monospace;
  font-size: .78rem; color: var(--soft); } td a { color: inherit; }
.law { font-size: 1.08rem; border-left: 4px solid #d55e00; padding: .25rem .9rem; margin: .7rem 0; }
.law i { font-family: Georgia, serif; } h3 { font-size: 1.05rem; margin: 2.4rem 0 .3rem; }
h3 .pill { margin-left: .5rem; vertical-align: .1em; font-weight: 400; } h3 + figure { margin-top: .6rem; }
.side { display: flex; flex-wrap: wrap; gap: .4rem 3rem; align-items: flex-start; } .side > div { min-width: 0; }
.bar { display: inline-block; height: .6em; background: #e69f00; margin-right: .5em; border-radius: 1px; }
caption { text-align: left; padding-bottom: .2rem; }
@media print { table.causes { min-width: 0; } h3 { break-after: avoid; } .cause { break-inside: avoid-page; } }
"""


def write_report(
    diagnosis: Diagnosis,
    robot_name: str,
    figures: Iterable[str | Path],
    path: str | Path,
    lacks: Mapping[str, Sequence[str]] | None = None,
    record_next: str = "",
) -> Path:
    """Write the report of a diagnosis to `path`, whole or not at all; of `figures` (those of `diagnosis_figures`), the
    PNG files are put inside; `lacks`: the files for simulators, and what each of them does not hold; `record_next`: the
    trajectory beside it that is to be recorded next, "" without."""
    return write_file(Path(path), page(diagnosis, robot_name, [Path(x) for x in figures], lacks or {}, record_next))


def page(
    diagnosis: Diagnosis,
    robot_name: str,
    figures: Sequence[Path],
    lacks: Mapping[str, Sequence[str]] | None = None,
    record_next: str = "",
) -> str:
    """The report as HTML text: what is wrong and what to do on the first screen, then the evidence."""
    drawn = {x.stem: x for x in figures if x.suffix == ".png"}
    found = claims(diagnosis)
    told = f'<p class="sub"><span class="verdict">{escape(_verdict(diagnosis))}</span></p>\n'
    told += f'<p class="lead">{escape(diagnosis.summary or _verdict(diagnosis) + ".")}</p>\n'
    told += picture(drawn[OPENING], caption(diagnosis)) if OPENING in drawn else ""
    told += _notes(diagnosis.notes)
    picked = picture(drawn[OVERVIEW], OVERVIEW_CAPTION) if OVERVIEW in drawn else ""
    evidence = "".join(_cause(diagnosis, k + 1, x, drawn) for k, x in enumerate(found))
    usable = diagnosis.verdict != "log_unusable"
    over_time = ""
    if OVERLAY in drawn:
        over_time = picture(drawn[OVERLAY], OVERLAY_CAPTION, live=diagnosis_plots(diagnosis))
    unseen = _blind_spots(diagnosis)
    sections = [
        ("What is wrong with the log", "" if usable else _checks(diagnosis) + _next_step()),
        ("What to do next", _to_do(diagnosis, record_next) if usable else ""),
        ("Changes" if SINCE in diagnosis.details else "Causes", _causes(diagnosis)),
        ("Standard terms", standard_section(diagnosis)),
        ("Also in the extended model", unclaimed_section(diagnosis)),
        ("Torques over time", over_time),
        ("Residual", tests_section(diagnosis, drawn.get(RESIDUAL_TESTS))),
        ("Improvement", picked + _errors(diagnosis)),
        ("The better simulation", better_simulation(diagnosis, drawn.get(REPLAY), lacks or {})),
        ("Using the extended model", _usage() if usable and (found or diagnosis.standard) else ""),
        ("The evidence", evidence),
        ("What this log cannot show", folded("effects that may or may not be present", unseen) if unseen else ""),
        ("The log", (_checks(diagnosis) if usable else "") + _excitation(diagnosis)),
        ("Method", folded("filter, rates, trials", pairs(diagnosis.details)) if diagnosis.details else ""),
    ]
    return document(_title(diagnosis, robot_name), told + "".join(section(*x) for x in sections), PILLS + STYLE)


def _notes(notes: Sequence[str]) -> str:
    """What the user should know; from FOLD_FROM notes on all but the first are folded."""
    lines = [f'<p class="note-line">{escape(x)}</p>\n' for x in notes]
    open_ones = len(lines) if len(lines) < FOLD_FROM else 1
    rest = "".join(lines[open_ones:])
    return "".join(lines[:open_ones]) + (folded(f"{len(lines) - open_ones} more notes", rest) if rest else "")


def _title(diagnosis: Diagnosis, robot_name: str) -> str:
    if diagnosis.verdict == "log_unusable":
        return f"The log of {robot_name} cannot be diagnosed"
    compares = SINCE in diagnosis.details
    return f"What has changed on {robot_name}" if compares else f"What the simulation of {robot_name} gets wrong"


def _verdict(diagnosis: Diagnosis) -> str:
    """A sentence such as 'Partly explained: 4 causes named, 1 ambiguous, 2 standard terms named'."""
    status = Counter(x.status for _, x in causes(diagnosis))
    named, open_ones, usual = status["named"], status["ambiguous"], len(in_table(diagnosis))
    counts = [f"{named} cause{'s' * (named != 1)} named"] * (named > 0)
    counts += [f"{open_ones} {'' if named else 'cause' + 's' * (open_ones != 1) + ' '}ambiguous"] * (open_ones > 0)
    counts += [f"{usual} standard term{'s' * (usual != 1)} named"] * (usual > 0)
    return ": ".join([verdict_words(diagnosis), *([", ".join(counts)] if counts else [])])


def _to_do(diagnosis: Diagnosis, record_next: str) -> str:
    """What a user can do now: record what distinguishes ambiguous causes, look at the residual, correct the log."""
    items = []
    if record_next:
        link = f'<a href="{escape(record_next)}">{escape(record_next)}</a>'
        options = "data.path=[LOG,NEXT]" + " data.reference=REFERENCE" * (SINCE in diagnosis.details)
        how = f"log it, and diagnose both logs together: <code>{options}</code>. {escape(CAUTION)}"
        items.append(f"Play {link}, {how}")
    items += map(escape, advised(diagnosis))
    left: dict[str, dict[str, None]] = {}
    for x in failing(diagnosis) if diagnosis.verdict != "explained" else ():
        left.setdefault(x.joint, {}).update(dict.fromkeys(map(words, x.points_at)))
    if left:
        few = {
            joint: f" (it may be {' or '.join(names)})" for joint, names in left.items() if 0 < len(names) < FOLD_FROM
        }
        said = ", ".join(joint + few.get(joint, "") for joint in left)
        items.append(escape(f"The residual is not noise on {said}: see the tests under Residual."))
    for check in diagnosis.examination.checks:
        if check.severity in ("warn", "fail") and check.advice:
            items.append(f"The log, {escape(check.check.replace('_', ' '))}: {escape(check.advice.rstrip('.'))}.")
    items = list(dict.fromkeys(items))
    if not items:
        return "<p>There are no open questions: use the extended model.</p>" if diagnosis.model is not None else ""
    return f"<ul>{''.join(f'<li>{x}</li>' for x in items)}</ul>"


def _causes(diagnosis: Diagnosis) -> str:
    """A row per claim: effect, joint, status, parameters with 95 % intervals, its window if it comes and goes, what it
    gains most, alternatives. What stands in the table of what every arm has does not stand here."""
    body = ""
    for number, finding in causes(diagnosis):
        rivals = escape("; ".join(rivals_of(finding))) or "-"
        values = "<br>".join(escape(x) for x in (*estimates(finding), when(finding)) if x) or "-"
        joint = best_gain(finding.gain)
        where = "" if joint is None else gaining(joint, finding)
        small = f"<small>{escape(where)}</small>" if where else ""
        gain = "-" if joint is None else escape(gain_text(finding.gain[joint])) + small
        body += (
            f'<tr><td class="whole"><a href="#finding-{number}">{escape(capital(words(finding.effect)))}</a>'
            f'<small class="name">{escape(finding.effect)}</small></td><td class="whole">{escape(place(finding))}</td>'
            f"<td>{pill(finding.status)}</td><td>{values}</td><td>{gain}</td><td>{rivals}</td></tr>"
        )
    if not body:
        none = "None was found beyond the standard terms." if in_table(diagnosis) else "None was found."
        return "" if diagnosis.verdict == "log_unusable" else f"<p>{none}</p>"
    unit = "; ".join(dict.fromkeys(units_of(diagnosis).values()))
    heads = (
        "effect",
        "joint",
        "status",
        "estimate [95 %]",
        f"held-out RMSE in motion falls by [{unit}]".replace("N m", f"N{NO_BREAK}m"),
        "alternatives",
    )
    return table(heads, body, "words causes")


def _cause(diagnosis: Diagnosis, number: int, finding: Finding, drawn: Mapping[str, Path]) -> str:
    """One claim: picture, law, parameters and gains, what else it could be, rivals, what to record."""
    status = pill(finding.status)
    said = f"{place(finding)}: {cause(finding)}"
    out = f'<div class="cause" id="finding-{number}"><h3>{escape(said)} {status}</h3>\n'
    text = text_of(finding)
    out += f'<p>{escape(text.meaning)} <span class="name">{escape(finding.effect)}</span></p>'
    out += f'<p class="law">{law(text)}</p>' if text.equation else ""
    name = picture_name(number, finding)
    out += picture(drawn[name], CAPTION, said) if name in drawn else ""
    out += "</div>"
    if finding.window is not None:
        out += f"<p>It acts from {escape(when(finding))}, counted from its first sample.</p>"
    out += f'<div class="side"><div>{_parameters(finding)}</div><div>{_gains(diagnosis, finding.gain)}</div></div>'
    out += _alternatives(finding)
    if finding.advice:
        head = "To be more certain" if finding.status == "ambiguous" else "A log that shows it best"
        out += f"<p><b>{head}:</b> {escape(finding.advice)}</p>"
    out += _rejected(finding.rejected)
    return out + (folded("supporting numbers", pairs(finding.evidence)) if finding.evidence else "")


def _alternatives(finding: Finding) -> str:
    """What could stand in the place of a cause; and whether most of what its joint misses has no name."""
    known = rivals_of(replace(finding, alternatives=tuple(x for x in finding.alternatives if x != UNKNOWN)))
    said = ""
    if known:
        sets = "; or by ".join(f"<b>{escape(x)}</b>" for x in known)
        said = f"On this log, {sets} would explain the torque equally well, within noise."
    if UNKNOWN in finding.alternatives:
        said += " Much of what the model misses here may come from an effect that is not in the catalogue, and this "
        said += "cause may be a part of that."
    return f'<p class="warning">{said.strip()}</p>' if said else ""


def _parameters(finding: Finding) -> str:
    body = ""
    for name, quantity in finding.parameters.items():
        degrees = in_degrees(quantity)
        small = f"<small>{escape(degrees)}</small>" if degrees else ""
        shown = "cannot be determined from this log" if quantity.value is None else quantity_text(quantity)
        body += row(escape(name), escape(shown) + small)
    return table(("parameter", "estimate [95 %]"), body, "") if body else ""


def _gains(diagnosis: Diagnosis, gains: Mapping[str, Gain]) -> str:
    units, body = units_of(diagnosis), ""
    for joint, x in gains.items():
        gain = f"{escape(gain_text(x))} {units.get(joint, 'N m')}"
        body += row(escape(joint), significant(x.rmse_before), significant(x.rmse_after), gain)
    heads = ("held-out RMSE in motion", "without it", "with it", "gain [95 %]")
    return table(heads, body, "") if body else ""


def _rejected(rejected: Sequence[tuple[str, str]]) -> str:
    if not rejected:
        return ""
    body = "".join(f'<tr><td class="whole">{escape(words(x))}</td><td>{escape(why)}</td></tr>' for x, why in rejected)
    count = f"{len(rejected)} alternative{'s' * (len(rejected) > 1)} tested and rejected"
    return folded(count, table(("alternative", "reason"), body), shown=len(rejected) < FOLD_FROM)


def _blind_spots(diagnosis: Diagnosis) -> str:
    """Effects that this log cannot show, joints with the same reason and the same advice in one row."""
    rows: dict[tuple[str, str, str], dict[str, None]] = {}
    for x in diagnosis.findings:
        if x.status in UNSEEN:
            rows.setdefault((x.effect, x.status, x.advice), {})[place(x)] = None
    body = ""
    for (effect, status, advice), found in rows.items():
        where = places(found, joints_of(diagnosis))
        body += (
            f'<tr><td>{escape(capital(words(effect)))}<small class="name">{escape(effect)}</small></td>'
            f"<td>{escape(where)}</td><td>{pill(status)}</td><td>{escape(advice)}</td></tr>"
        )
    note = '<p class="note">No claims are made: these effects may or may not be present.</p>'
    return note + table(("effect", "joint", "why", "what would show it"), body) if body else ""


def _errors(diagnosis: Diagnosis) -> str:
    if not diagnosis.baseline:
        return ""
    floor, units, body = diagnosis.noise_floor, units_of(diagnosis), ""
    for joint in joints_of(diagnosis):
        share = diagnosis.unexplained.get(joint, math.nan)
        bar = f'<span class="bar" style="width:{max(0.0, min(1.0, share)) * 5:.2f}em"></span>' if share == share else ""
        left = bar + ("-" if share != share else f"{100 * share:.0f} %")
        body += row(escape(joint), *map(significant, errors_of(diagnosis, joint)), left)
    heads = ("joint", *ERROR_HEADS[:-1], "unexplained")
    note = f"On held-out data; RMSE in {'; '.join(dict.fromkeys(units.values()))}. "
    note += "Friction line: offset, Coulomb and viscous friction by least squares, with the links as in the URDF. "
    note += "Standard model: these terms and errors of the links. NMSE: mean squared error over the torque's variance. "
    note += "Unexplained: the share of the residual that a small neural network predicts. These errors include samples "
    note += "at rest; the errors of single causes do not. "
    note += "" if floor else "No trajectory was recorded twice, so there is no noise floor."
    return table(heads, body, "") + f'<p class="note">{escape(note)}</p>'


def _checks(diagnosis: Diagnosis) -> str:
    """The findings of the checks, most severe first, and the number of checks."""
    order = ("fail", "warn", "note")
    told = [x for kind in order for x in diagnosis.examination.checks if x.severity == kind]
    fine = len({x.check for x in diagnosis.examination.checks if x.severity == "ok"})
    skipped = skipped_reasons(diagnosis.examination.checks)
    why = "; ".join(f"{', '.join(names).replace('_', ' ')} ({said})" for said, names in skipped.items())
    count = f'<p class="note">{fine} check{"s" * (fine != 1)} passed.</p>' if fine else ""
    count += f'<p class="note">Skipped: {escape(why)}.</p>' if why else ""
    return check_table(told) + count


def _excitation(diagnosis: Diagnosis) -> str:
    excitation = diagnosis.examination.excitation
    heads = list(dict.fromkeys(name for found in excitation.values() for name in found))
    if not heads:
        return ""
    body = ""
    for joint, found in excitation.items():
        body += row(escape(joint), *(escape(_cell(found.get(name))) for name in heads))
    return folded("what the log excites", table(("joint", *(x.replace("_", " ") for x in heads)), body, ""))


def _cell(value: Any) -> str:
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "-"}[value]
    if isinstance(value, float):
        return significant(value)
    if isinstance(value, Mapping):
        return "; ".join(map(_cell, value.values())) or "-"
    return ", ".join(map(_cell, value)) if isinstance(value, list | tuple) else str(value)


def _next_step() -> str:
    said = "The robot is not diagnosed before its log passes. Correct what fails, check again, then diagnose:"
    return f"<p>{said}</p><pre>{escape(CHECK)}</pre>"


def _usage() -> str:
    note = f'<p class="note">{escape(COMMAND_NOTE)}</p>'
    return f"<pre>{escape(COMMAND)}</pre>{note}<pre>{escape(PYTHON)}</pre>"
