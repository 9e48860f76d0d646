"""One run as one HTML file that needs nothing else: figures inside, good in light, dark and print."""

import math
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from invdyn_cli.files import write_file
from invdyn_cli.report.html import document, folded, pairs, picture, row, section, table
from invdyn_cli.report.run_plots import run_plots
from invdyn_cli.report.tables import (
    LOAD_HEADS,
    choice,
    load_rows,
    member_spread,
    robot_of,
    round_by_error,
    score_rows,
    scored_sets,
    significant,
    units,
    units_said,
)
from invdyn_cli.types import RunRecord

CAPTIONS = {
    "torques": (
        "Measured and predicted torque of the test set, with the residual below. A residual that "
        "steps when a joint reverses indicates friction; one that follows the slope of the torque indicates a delay; "
        "one that is constant for some time indicates a load."
    ),
    "errors": (
        "Errors per joint of every scored set. If the test bars are well above the train bars, the model does not "
        "generalise to the test set. A high NMSE with a low RMSE means that the joint has little torque to explain."
    ),
    "loss": (
        "Loss over epochs; the band spans the members. If the validation loss rises while the train loss falls, the "
        "model overfits. If the curves still fall at the end, more epochs would help."
    ),
    "adaptation": (
        "Errors of every hundred samples along a repetition: median and range over all of them. Where the grey line "
        "rises and the blue one does not, adaptation helps. Where the blue line rises and the grey one falls, the "
        "adapted model forgets."
    ),
    "residual_velocity": (
        "Residual over the joint's own velocity, test set. A step at zero indicates Coulomb friction, a slope viscous "
        "friction, and a peak near zero Stribeck friction. A horizontal line that is not at zero is a torque offset."
    ),
    "singular_values": (
        "Singular values of the regressor. A clear gap at the threshold means that the rank is clear; values close "
        "to it belong to directions that this motion hardly excites."
    ),
}

EXACT = 1e-12
"""Mean NMSE below which errors are rounding errors: their ratios have no meaning."""

APART = 2.0
"""Ratio of test to training NMSE from which the two are called different; below it they differ as much as two sets of
one kind."""


def write_page(record: RunRecord, figures: Iterable[str | Path], path: str | Path) -> Path:
    """Write the report of a run to `path`, whole or not at all; of `figures`, the PNG files are put inside."""
    return write_file(Path(path), page(record, [Path(x) for x in figures]))


def page(record: RunRecord, figures: Sequence[Path]) -> str:
    """The report as HTML text."""
    title = f"{choice(record, 'model')} on {choice(record, 'data')}"
    seed = f", seed {record.choices['seed']}" if record.choices.get("seed") is not None else ""
    robot = robot_of(record)
    under = f"{choice(record, 'adaptation')}{seed}" + (f", robot {robot.name}" if robot else "")
    sections = [
        ("Scores", _scores(record)),
        ("Loads", _loads(record)),
        ("Figures", _figures(record, figures)),
        ("Fit", pairs(_fit_facts(record)) + _base_parameters(record.fit.details.get("base_parameters"))),
        ("Robot", _robot(record)),
        ("Data", pairs({"samples": record.samples, **record.split, "hash": record.digest})),
        ("Provenance", pairs({"overrides": record.overrides, **record.provenance})),
        ("Config", folded("the resolved config", f"<pre>{escape(record.config)}</pre>") if record.config else ""),
    ]
    return document(
        title,
        f'<p class="sub">{escape(under)}</p>\n<p class="lead">{escape(summary(record))}</p>\n'
        + "".join(f'<p class="warning">{escape(x)}</p>\n' for x in remarks(record))
        + "".join(section(name, content) for name, content in sections),
    )


def summary(record: RunRecord) -> str:
    """How large the test error is and where it is largest; how it compares with the training error; how adaptation
    changes it."""
    adapted = record.scores["test_adapted"].mean("nmse") if "test_adapted" in record.scores else math.nan
    more = "" if math.isnan(adapted) else f" During adaptation the mean NMSE is {significant(adapted)}."
    return _as_learned(record) + more


def _as_learned(record: RunRecord) -> str:
    if "test" not in record.scores:
        return "This run was not evaluated on a test set."
    score = record.scores["test"]
    mean = score.mean("nmse")
    if not np.isfinite(score.rmse).all():
        return "Predictions on the test set are not finite, so no NMSE can be given."
    if math.isnan(mean):
        return "No joint's torque changes in the test set, so no NMSE can be given."
    worst = int(np.nanargmax(score.nmse))
    where = f"{score.joints[worst]} (NMSE {significant(score.nmse[worst])}, "
    where += f"RMSE {significant(score.rmse[worst])} {units(record)[worst]})"
    useless = ", no better than a constant torque," if mean >= 1 else ""
    first = f"The mean NMSE on the test set is {significant(mean)}{useless}"
    first += f" and the worst joint is {where}." if len(score.joints) > 1 else f", at {where}."
    train = record.scores["train"].mean("nmse") if "train" in record.scores else math.nan
    if math.isnan(train):
        return f"{first} There is no training error to compare it with."
    if max(train, mean) < EXACT:
        both = f"The mean and the training error ({significant(train)}) are rounding errors"
        return f"{first} {both}: the model is exact here."
    ratio = mean / train if train > 0 else math.inf
    if ratio >= APART:
        times = f"{significant(ratio)} times the training error ({significant(train)})"
        return f"{first} The mean is {times}: the model does not fully generalise to the test set."
    if ratio <= 1 / APART:
        return f"{first} The mean is less than the training error ({significant(train)}): the test set is easier."
    return f"{first} The training error is about the same ({significant(train)})."


def remarks(record: RunRecord) -> list[str]:
    """What the reader must know before believing the numbers: warnings of the fit, joints without a usable score."""
    found = [*record.fit.warnings, *record.split.get("notes", ())]
    for name, score in record.scores.items():
        still = [
            j
            for j, x, y in zip(score.joints, score.nmse, score.rmse, strict=True)
            if math.isnan(x) and math.isfinite(y)
        ]
        broken = [j for j, y in zip(score.joints, score.rmse, strict=True) if not math.isfinite(y)]
        if still:
            found.append(
                f"In {name} the torque of {', '.join(still)} never changes: no NMSE, and the mean is over the others."
            )
        if broken:
            found.append(f"In {name} the prediction of {', '.join(broken)} is not finite.")
    return found


def _scores(record: RunRecord) -> str:
    names = scored_sets(record)
    *joints, mean = score_rows(record)
    worst = [None if math.isnan(x) else _worst([values[c] for _, values in joints]) for c, x in enumerate(mean[1])]
    head = "".join(f'<th colspan="2">{escape(x)}</th>' for x in names)
    body = ""
    for j, (joint, values) in enumerate(joints):
        shown = (
            f'<b class="worst">{significant(v)}</b>' if worst[c] == j else significant(v) for c, v in enumerate(values)
        )
        body += row(escape(joint), *shown)
    body += '<tr class="mean"><td>mean</td>' + "".join(f"<td>{significant(v)}</td>" for v in mean[1]) + "</tr>"
    note = "NMSE is the mean squared error over the variance of the measured torque; "
    note += f"RMSE is in {units_said(record)}. The worst joint of a column is marked. {member_spread(record)}"
    return (
        f'<div class="wide"><table class="scores"><thead><tr><th rowspan="2">joint</th>{head}</tr>'
        f"<tr>{'<th>NMSE</th><th>RMSE</th>' * len(names)}</tr></thead><tbody>{body}</tbody></table></div>"
        f'<p class="note">{escape(note)}</p>'
    )


def _loads(record: RunRecord) -> str:
    rows = load_rows(record)
    body = "".join(row(*map(escape, cells)) for cells in rows)
    note = "Loads that the adaptation estimated during the test set, before a release showed, ± standard error."
    return table(LOAD_HEADS, body, "") + f'<p class="note">{note}</p>' if rows else ""


def _worst(values: Sequence[float]) -> int | None:
    """Row of the largest value, None if the printed digits do not distinguish it from another."""
    shown = [significant(x) for x in values]
    row = max(range(len(values)), key=lambda i: -math.inf if math.isnan(values[i]) else values[i])
    return row if len(values) > 1 and shown.count(shown[row]) == 1 else None


def _fit_facts(record: RunRecord) -> dict[str, Any]:
    """Details of the fit that fit into one line each: numbers, and arrays with an entry per joint."""
    facts: dict[str, Any] = {"parameters learned": record.fit.parameters}
    facts |= {f"seconds, {name}": significant(x) for name, x in record.seconds.items()}
    for name, value in record.fit.details.items():
        shape = None if isinstance(value, Mapping) or name == "singular_values" else np.shape(value)
        if shape == ():
            facts[name.replace("_", " ")] = np.asarray(value).item()
        elif shape == (len(record.fit.joints),):
            each = zip(record.fit.joints, value, strict=True)
            facts[name.replace("_", " ")] = [f"{joint} {significant(float(x))}" for joint, x in each]
    if "rank" in facts and "singular_values" in record.fit.details:
        facts["rank"] = f"{facts['rank']} of {np.size(record.fit.details['singular_values'])}"
    return facts


def _base_parameters(found: Mapping[str, Any] | None) -> str:
    """Names, expressions (where given), values and standard errors of what the data determine, rounded by the error."""
    if not found:
        return ""
    names, values = found["names"], np.asarray(found["values"], float)
    std = np.asarray(found.get("std", np.full(len(values), np.nan)), float)
    expressions = found.get("expressions", names)
    body = ""
    for name, expression, value, error in zip(names, expressions, values, std, strict=True):
        label = escape(str(name)) + (f"<small>{escape(str(expression))}</small>" if expression != name else "")
        share = f"{significant(100 * error / abs(value))} %" if value else "-"
        body += row(label, round_by_error(value, error), share)
    shown = table(("base parameter", "value ± standard error", "relative"), body, "")
    return folded(f"{len(values)} base parameters", shown, shown=True)


def _robot(record: RunRecord) -> str:
    robot = robot_of(record)
    if robot is None:
        return "<p>No robot description was used.</p>"
    kinds = [x + " (slides)" * slides for x, slides in zip(robot.joints, robot.prismatic, strict=True)]
    notes = "".join(f"<li>{escape(x)}</li>" for x in robot.notes)
    return pairs({"name": robot.name, "joints": kinds}) + (f"<ul>{notes}</ul>" if notes else "")


def _figures(record: RunRecord, figures: Sequence[Path]) -> str:
    """The PNG files; plots that zoom replace those of the torques and of the residual over velocity."""
    drawn = {x.stem: x for x in figures if x.suffix == ".png"}
    live = run_plots(record, CAPTIONS["residual_velocity"]) if "torques" in drawn else ""
    return "".join(
        picture(
            path,
            CAPTIONS.get(name, name.replace("_", " ")),
            live=live if name == "torques" else "",
            replaced=bool(live) and name == "residual_velocity",
        )
        for name, path in drawn.items()
    )
