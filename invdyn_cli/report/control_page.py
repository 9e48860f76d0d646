"""Control runs as one HTML file that needs nothing else: the figure, all numbers, every joint, and how it was run."""

from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

from invdyn_cli.control import KIND_WORDS, ControlRecord
from invdyn_cli.report.controlled import OBJECT, sentences
from invdyn_cli.report.html import document, folded, pairs, picture, row, section, table
from invdyn_cli.report.tables import significant

CAPTION = (
    "Above: tracking error over the feedback gain, stiff on the left, soft on the right; a good feedforward keeps it "
    "low with soft feedback. Below: how much of the torque the feedback still makes."
)

UNITS = {"damping_time": " [s]", "velocity_cutoff": " [Hz]", "settle": " [s]", "largest_error": " [rad]"}
"""Of the options that have one."""


def page(record: ControlRecord, choices: Mapping[str, Any], figure: Path) -> str:
    """The page of control runs as HTML text; `choices` are the names of the command line."""
    told = "".join(f'<p class="lead">{escape(x)}</p>\n' for x in sentences(record))
    told += "".join(f'<p class="warning">{escape(x)}</p>\n' for x in record.warnings)
    options = {f"{name}{UNITS.get(name, '')}": x for name, x in vars(record.sweep).items() if name != "gains"}
    seconds = {name: significant(value) for name, value in record.seconds.items()}
    sections = [
        ("Error and feedback over the gain", picture(figure, CAPTION)),
        ("All numbers", _numbers(record)),
        ("Joints", folded("tracking error of every joint", _joints(record))),
        ("Run", pairs({**choices, **options, "seconds": seconds})),
    ]
    title = f"{choices['model']}, {choices['adaptation']} in the control loop"
    return document(title, told + "".join(section(*x) for x in sections))


def _numbers(record: ControlRecord) -> str:
    """A row for each gain, without and with the object."""
    body = ""
    for loaded in (False, True):
        for gain in record.sweep.gains:
            errors = (significant(record.rms(gain, loaded, kind)) for kind in record.kinds)
            shares = (significant(100 * record.share(gain, loaded, kind)) for kind in record.kinds[1:])
            body += row(OBJECT[loaded], f"{gain:g}", *errors, *shares)
    heads = ("", "gain [1/rad]", *(f"error [deg], {KIND_WORDS[x]}" for x in record.kinds))
    heads += tuple(f"feedback torque [%], {KIND_WORDS[x]}" for x in record.kinds[1:])
    note = "Error: RMS over time and joints. Feedback torque: RMS share of the whole torque."
    return table(heads, body, "") + f'<p class="note">{note}</p>'


def _joints(record: ControlRecord) -> str:
    """A row for each run, a column for each joint."""
    body = ""
    for x in record.cases:
        cells = [OBJECT[x.loaded], KIND_WORDS[x.kind], f"{x.gain:g}", str(x.repetition)]
        cells += [significant(float(value)) for value in x.error]
        body += row(*map(escape, cells))
    heads = ("", "feedforward", "gain [1/rad]", "repetition", *(f"{x} [deg]" for x in record.joints))
    return table(heads, body, "")
