"""The tests of the extended model's residual: a table of joints and tests, and a picture of every failed test."""

import math
from html import escape
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from invdyn_cli.diagnosis.decide.wording import test_words, units_of
from invdyn_cli.report.canvas import INK, RESIDUAL, blank_figure, plain
from invdyn_cli.report.html import picture, row, table
from invdyn_cli.report.tables import significant
from invdyn_cli.report.wording import words
from invdyn_cli.types import Diagnosis, ResidualTest

RESIDUAL_TESTS = "residual_tests"
"""What the picture's file is called."""

SHOWN = 9
"""Largest number of failed tests that are drawn, those with the largest torques."""

NOTE = (
    "RMS torque of the part of the residual that each quantity explains; -: the log is too short for the test. Bold: "
    "the test failed, because noise reaches this value in at most one of a hundred logs, and the value is more than "
    "0.2 % of the joint's torque. A failed test rules out the verdict “explained”, unless its torque is below "
    "5 % of the nominal model's error."
)
CAPTION = "Mean residual over the quantity of each failed test, with two standard errors (autocorrelation included)."


def failing(diagnosis: Diagnosis) -> list[ResidualTest]:
    """Tests that failed, the largest torque first."""
    return sorted((x for x in diagnosis.tests if not x.passed), key=lambda x: -x.torque)


def tests_section(diagnosis: Diagnosis, drawn: Path | None) -> str:
    """The table, the likely causes of each failed test, and the picture."""
    if not diagnosis.tests:
        return ""
    units, body, heads = units_of(diagnosis), "", list(dict.fromkeys(x.against for x in diagnosis.tests))
    for joint in dict.fromkeys(x.joint for x in diagnosis.tests):
        own = {x.against: x for x in diagnosis.tests if x.joint == joint}
        body += row(escape(joint), *(_cell(own.get(name)) for name in heads))
    out = table(("joint", *map(test_words, heads)), body, "dense")
    out += f'<p class="note">[{"; ".join(dict.fromkeys(units.values()))}] {escape(NOTE)}</p>'
    rows = "".join(
        f'<tr><td class="whole">{escape(x.joint)}</td><td>{escape(test_words(x.against))}</td>'
        f"<td>{significant(x.torque)} {units.get(x.joint, 'N m')}, {100 * x.share:.0f} % of the squared residual</td>"
        f"<td>{escape(', '.join(map(words, x.points_at)) or '-')}</td></tr>"
        for x in failing(diagnosis)
    )
    if not rows:
        return out + "<p>All tests passed.</p>"
    out += table(("joint", "failed test", "torque", "possible causes"), rows)
    return out + (picture(drawn, CAPTION) if drawn else "")


def _cell(test: ResidualTest | None) -> str:
    if test is None:
        return "-"
    return significant(test.torque) if test.passed else f"<b>{significant(test.torque)}</b>"


def tests_figure(diagnosis: Diagnosis) -> Figure:
    """The residual over the quantity of each failed test, one panel each."""
    shown = failing(diagnosis)[:SHOWN]
    columns = min(3, len(shown))
    rows, units = math.ceil(len(shown) / columns), units_of(diagnosis)
    figure = blank_figure(2.3 * rows + 0.7, "The residual is not noise: failed tests", 11)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, x in zip(panels, shown, strict=False):
        over, mean, error = np.asarray(x.curve)
        axes.axhline(0, color=INK, lw=0.8)
        axes.errorbar(over, mean, 2 * error, color=RESIDUAL, marker="o", ms=3, lw=1.2, elinewidth=0.8)
        axes.set_title(plain(f"{x.joint}: {test_words(x.against)}"))
        axes.set_xlabel(plain(x.quantity))
        axes.xaxis.set_major_locator(MaxNLocator(5))
        axes.set_ylabel(f"residual [{units.get(x.joint, 'N m')}]")
    for axes in panels[len(shown) :]:
        axes.remove()
    return figure
