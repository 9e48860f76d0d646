"""A checked log as one HTML file that needs nothing else: whether it is usable, what to do, every channel with its
defects, what the log excites and can therefore show, and every check."""

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from invdyn_cli.diagnosis.checks.excitation import OF_ROBOT
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.errors import listed
from invdyn_cli.log import Log
from invdyn_cli.report.check_table import PILLS, check_table, skipped_reasons
from invdyn_cli.report.html import document, folded, lively, pairs, picture, row, section, table
from invdyn_cli.report.tables import significant
from invdyn_cli.report.wording import capital, places, words
from invdyn_cli.types import Check, Examination, Robot

CAPTIONS = {
    "clock": "Steps of the clock as logged. Spikes are gaps; a wide band is jitter.",
    "q": "Positions over time, with the commanded ones where they are logged. Of long logs the lowest and "
    "the highest value of every stretch are drawn, so that no spike is lost. A note above a panel applies to "
    "the whole channel.",
    "qd": "Velocities over time.",
    "qdd": "Accelerations over time.",
    "tau": "Torques over time.",
    "model": "Left: measured torque and that of the URDF's rigid bodies, without friction, over time. Right: one over "
    "the other, row by row. Points along the grey line agree; another slope is a unit, a sign or a gain, a cloud "
    "without a slope a wrong column; two parallel bands are friction.",
    "excitation": "Velocity over position. This log cannot show what a joint never did.",
}
CHANNELS = (
    "Every channel as logged and, where that differs, as corrected, with its defects marked. A coloured note beside "
    "a title applies to the whole channel."
)
MODEL = "Measured torque, as corrected and filtered, and that of the URDF's rigid bodies, without friction."
TITLES = {"clock": "Clock", "q": "Positions", "qd": "Velocities", "qdd": "Accelerations", "tau": "Torques"}
CORRECTED = ("duplicates", "outliers", "saturation", "time_offset", "too_short", ("unit_error", "q_ref"),
             ("sign_error", "q_ref"), ("derivative_consistency", "q"))  # fmt: skip
"""Checks, or checks of a channel, whose warnings the doctor corrects; of the others it corrects failures alone."""

UNITS = (
    ("rad", "rad/s", "rad/s²", "N m"),
    ("rad; m", "rad/s; m/s", "rad/s²; m/s²", "N m; N"),
    ("m", "m/s", "m/s²", "N"),
)
"""Of position, speed, acceleration and torque, where no joint slides, some do, and all do."""

FOLD_FROM = 12
"""Number of advices or corrections above which the rest is folded."""

STYLE = """
.verdict { font-weight: 600; font-size: 1.1rem; } ul { padding-left: 1.3rem; }
.bar { display: inline-block; height: .6em; background: #56b4e9; margin-right: .5em; border-radius: 1px; }
h3 { font-size: 1rem; margin: 1.4rem 0 0; } h3 + figure { margin-top: .3rem; }
"""


def page(
    examination: Examination,
    log: Log,
    robot: Robot | None,
    figures: Sequence[Path],
    notes: Sequence[str] = (),
    live: Sequence[str] = ("", ""),
) -> str:
    """The page of a checked log as HTML text; `figures` are those of `check_figures.draw_all`, `notes` what else the
    reader should know, `live` the plots of `check_plots.all_plots`."""
    drawn = {x.stem: x for x in figures}
    channels, model = live
    shown = lively(channels, CHANNELS)
    for name in (x for x in TITLES if x in drawn):
        one = f"<h3>{TITLES[name]}</h3>{picture(drawn[name], CAPTIONS[name])}"
        shown += f'<div class="replaced">{one}</div>' if channels and name != "clock" else one
    missing = [TITLES[name].lower() for name in ("q", "tau") if shown and name not in drawn]
    shown += f"<p>Not drawn, for want of finite values: {' and '.join(missing)}.</p>" if missing else ""
    same = bool(model) and not examination.corrections
    torque = picture(drawn["model"], CAPTIONS["model"], replaced=same) if "model" in drawn else ""
    torque = lively(model, MODEL) + torque
    if not torque and shown:
        why = "there is no robot" if robot is None else "no stretch of this log is long enough to be filtered"
        torque = f"<p>The nominal torque was not computed: {why}.</p>"
    visited = (
        picture(drawn["excitation"], CAPTIONS["excitation"], replaced=bool(model)) if "excitation" in drawn else ""
    )
    sections = [
        ("What to do", _to_do(examination)),
        ("What was corrected", _corrections(examination)),
        ("The log over time", shown),
        ("Measured torque and the model's", torque),
        ("What the motion excites", visited + _excitation(examination, robot)),
        ("What this log can show", _can_show(examination, robot)),
        ("Every check", folded(f"{len(examination.checks)} lines", _all_checks(examination))),
        ("The file", pairs(_facts(log))),
    ]  # fmt: skip
    told = f'<p class="verdict">{escape(verdict(examination))}</p>\n'
    told += "".join(f'<p class="note">{escape(x)}</p>\n' for x in notes)
    name = f"The log of {log.robot}" if log.robot else "The log"
    return document(name, told + "".join(section(*x) for x in sections), PILLS + STYLE)


def verdict(examination: Examination) -> str:
    """One sentence: whether the log is usable, what is wrong, what was corrected."""
    wrong, corrected = _wrong(examination)
    left = [x for x in wrong if x not in corrected]
    count = len(examination.corrections)
    if examination.usable:
        said = f"The log is usable after {count} correction{'s' * (count != 1)}" if count else "The log is usable"
        said += f": {_named(corrected)}" if corrected else "" if wrong else ", no check warns"
        said += f"; not corrected: {_named(left)}" if left else ""
    else:
        said = f"The log is not usable: {_named([x for x in left if x.severity == 'fail'] or left)}"
        said += f"; {count} correction{'s' * (count != 1)} did not suffice" if count else ""
    return said + "."


def _wrong(examination: Examination) -> tuple[list[Check], list[Check]]:
    """Checks that fail or warn, the gravest first, and of these the ones that were corrected."""
    corrected = {one["check"] for one in examination.corrections}
    wrong = [x for x in examination.checks if x.severity in ("fail", "warn")]
    return wrong, [
        x for x in wrong if x.check in corrected and (_corrected(x) if x.severity == "warn" else examination.usable)
    ]


def _corrected(warning: Check) -> bool:
    """Whether a warning is one that the doctor corrects; of what fails, a usable log has nothing left."""
    return warning.check in CORRECTED or (warning.check, _channel(warning)) in CORRECTED


def _named(checks: Sequence[Check]) -> str:
    """'outliers (elbow, wrist), unit error (q)'."""
    where: dict[str, dict[str, None]] = {}
    for x in checks:
        place = " of ".join(str(y) for y in (_channel(x), x.joint) if y)
        where.setdefault(x.check.replace("_", " "), {})[place] = None
    return ", ".join(f"{name} ({listed([x for x in places if x], most=4)})" if any(places) else name
                     for name, places in where.items())  # fmt: skip


def _channel(check: Check) -> str:
    return str(check.threshold.get("channel", "")) if isinstance(check.threshold, Mapping) else ""


def _to_do(examination: Examination) -> str:
    """The most severe uncorrected findings first; the next commands; what the next recording should contain."""
    wrong, corrected = _wrong(examination)
    lines = _advice([x for x in wrong if x not in corrected])
    if examination.usable and examination.corrections:
        lines.append("<li>Write the corrected log: add <code>write=fixed.h5</code> to the command.</li>")
    if examination.usable:
        lines.append("<li>Ask what the simulation gets wrong: <code>invdyn diagnose</code> with the same options; it "
                     "makes the same corrections first.</li>")  # fmt: skip
    later = _advice(corrected)
    next_one = f"<p>So that the next log needs no correction:</p>{_list(later)}" if later else ""
    return _list(lines) + next_one


def _advice(checks: Sequence[Check]) -> list[str]:
    """A line per kind of finding and advice."""
    items: dict[tuple[str, str], list[Check]] = {}
    for x in checks:
        if x.advice:
            items.setdefault((x.check, x.advice.rstrip(".")), []).append(x)
    return [f"<li>{escape(capital(_named(x)))}: {escape(advice)}.</li>" for (_, advice), x in items.items()]


def _list(lines: Sequence[str]) -> str:
    """Items as a list, those after FOLD_FROM folded."""
    rest = lines[FOLD_FROM:]
    more = folded(f"{len(rest)} more", f"<ul>{''.join(rest)}</ul>") if rest else ""
    return f"<ul>{''.join(lines[:FOLD_FROM])}</ul>{more}" if lines else ""


def _corrections(examination: Examination) -> str:
    done = [
        f"<li>{escape(one['done'])} <small>({escape(one['check'].replace('_', ' '))})</small></li>"
        for one in examination.corrections
    ]
    return _list(done)


def _excitation(examination: Examination, robot: Robot | None) -> str:
    body = ""
    for j, (joint, x) in enumerate(examination.excitation.items()):
        low, high = x["q"]
        span = float(robot.upper[j] - robot.lower[j]) if robot is not None else np.inf
        share = (high - low) / span if np.isfinite(span) and span > 0 else None
        bar = "-" if share is None else f'<span class="bar" style="width:{5 * min(share, 1):.2f}em"></span>{share:.0%}'
        numbers = (*x["q"], max(map(abs, x["qd"])), max(map(abs, x["qdd"])), *x["torque"])
        rest = (f"{x[kind]:.0%}" for kind in ("rest_share", "slow_share"))
        body += row(escape(joint), *map(significant, numbers), bar, str(x["reversals"]), *rest)
    if not body:
        return ""
    slides = (False,) if robot is None else robot.prismatic
    q, qd, qdd, tau = UNITS[any(slides) + all(slides)]
    heads = ("joint", f"least q [{q}]", f"largest q [{q}]", f"max |qd| [{qd}]", f"max |qdd| [{qdd}]",
             f"least tau [{tau}]", f"largest tau [{tau}]", "of its range", "reversals", "at rest", "slow")  # fmt: skip
    condition = next(iter(examination.excitation.values())).get("condition")
    note = "After a low-pass filter of 6 Hz. "
    if condition is not None:
        note += f"The condition number of the whole arm's regressor is {significant(condition)}: below 100, the "
        note += "inertial parameters are well determined; above 1000, many are not (Gautier, Khalil 1992)."
    return table(heads, body, "") + f'<p class="note">{escape(note)}</p>'


def _can_show(examination: Examination, robot: Robot | None) -> str:
    """A row per effect: the joints on which this motion can show it, and why not on the others."""
    excitation = examination.excitation
    body = ""
    judged = {name: x.needs for name, x in EFFECTS.items() if x.needs} if excitation else {}
    unjudged = [name for name, needs in judged.items() if robot is None and not set(needs).isdisjoint(OF_ROBOT)]
    for effect in [name for name in judged if name not in unjudged]:
        reasons: dict[str, list[str]] = {}
        for joint, x in excitation.items():
            if effect in x["cannot_show"]:
                reasons.setdefault(x["cannot_show"][effect], []).append(joint)
        hidden = {joint for joints in reasons.values() for joint in joints}
        able = [joint for joint in excitation if joint not in hidden]
        said = "".join(
            f"<div>{escape(places(joints, excitation))}: {escape(why)}</div>" for why, joints in reasons.items()
        )
        body += f'<tr><td class="whole">{escape(capital(words(effect)))}</td>'
        body += f"<td>{escape(places(able, excitation)) if able else 'none'}</td><td>{said or '-'}</td></tr>"
    if not body:
        return ""
    note = "This table does not say whether an effect is present; invdyn diagnose does."
    if unjudged:
        note += f" Not judged without a robot: {', '.join(map(words, unjudged))}."
    return table(("effect", "can be shown on", "not on, and why"), body) + f'<p class="note">{escape(note)}</p>'


def _all_checks(examination: Examination) -> str:
    reasons = skipped_reasons(examination.checks)
    skipped = "".join(f"<li>{escape(', '.join(x).replace('_', ' '))}: {escape(why)}</li>" for why, x in reasons.items())
    lines = [x for x in examination.checks if x.severity != "skipped"]
    below = f"<p>Skipped, and why:</p><ul>{skipped}</ul>" if skipped else ""
    return check_table(lines) + below


def _facts(log: Log) -> dict[str, Any]:
    lengths = {x.name: f"{len(x.t)} rows" for x in log.trajectories}
    channels = [c for c in ("q", "qd", "qdd", "tau", "q_ref", "q_link")
                if any(getattr(x, c) is not None for x in log.trajectories)]  # fmt: skip
    names = dict(list(lengths.items())[:20])
    return {
        "joints": list(log.joints),
        "channels": channels,
        "nominal rate [Hz]": log.rate,
        "torque": f"{log.torque_unit}, side: {log.torque_side}",
        "recordings": len(lengths),
        "rows": names,
        "history": list(log.history),
    }
