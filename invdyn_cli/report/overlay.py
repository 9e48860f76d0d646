"""Measured torque beside that of the nominal and of the extended model: of one joint, to open a report, and of all."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from invdyn_cli.diagnosis.decide.wording import units_of
from invdyn_cli.report.canvas import (
    MEASURED,
    add_legend,
    blank_figure,
    label_below,
    limit_around,
    panel_grid,
    plain,
    shape_of,
    thinned,
)
from invdyn_cli.report.exhibits import exhibits, telling_window, time_label
from invdyn_cli.report.overview import AFTER, BEFORE
from invdyn_cli.report.tables import significant
from invdyn_cli.report.wording import cause, causes, joints_of
from invdyn_cli.types import Diagnosis, Signals

OPENING, OVERLAY = "torque", "torques"
"""What the pictures' files are called."""

CAPTION = "Measured torque beside that of the nominal and of the extended model."
RESTING = (
    " Most of the error of the extended model is where joints rest or reverse: friction then holds any torque up to "
    "its level, and no model follows it."
)


def opening(diagnosis: Diagnosis) -> Figure:
    """The torque of the joint that the largest anomaly shows on, in the seconds in which its term varies most; without
    an anomaly, of the joint on which the nominal model is most at fault."""
    assert diagnosis.signals is not None
    signals, anomalies = diagnosis.signals, causes(diagnosis)
    if anomalies:
        number, finding = anomalies[0]
        shown = exhibits(diagnosis)[number - 1]
        column, seen = shown.column, {"where": finding.trajectory, "around": finding.window}
        rows = telling_window(signals, shown.term, [column], **seen)
    else:
        fault = _fault(signals)
        column = int(np.argmax(np.nanstd(fault, axis=0)))
        rows = telling_window(signals, fault, [column])
    figure = blank_figure(2.8)
    axes = figure.subplots()
    _curves(axes, diagnosis, signals, rows, column)
    axes.set_xlabel(time_label(signals, rows))
    add_legend(figure, axes)
    return figure


def caption(diagnosis: Diagnosis) -> str:
    """What the opening picture shows, and why that joint; also, if it is so, that joints rest where most of the squares
    are left."""
    assert diagnosis.signals is not None
    signals, anomalies = diagnosis.signals, causes(diagnosis)
    largest = "with the largest error of the nominal model in relation to its torque"
    why = f"of the largest cause: {cause(anomalies[0][1])}" if anomalies else largest
    left = ((signals.tau - signals.extended) / np.maximum(np.nanstd(signals.tau, axis=0), 1e-300)) ** 2
    left = np.nan_to_num(left) * signals.held_out[:, None]
    at_rest = bool(np.sum(left[~signals.valid]) > np.sum(left) / 2)
    return f"{CAPTION} Shown is the joint {why}.{RESTING * at_rest}"


def overlay(diagnosis: Diagnosis) -> Figure:
    """Every joint's torques in the held-out seconds in which the nominal model is most at fault."""
    assert diagnosis.signals is not None
    signals, n = diagnosis.signals, len(joints_of(diagnosis))
    rows = telling_window(signals, _fault(signals), range(n))
    figure = blank_figure(1.35 * shape_of(n)[0] + 1.0, "Measured and modelled torque", 11)
    panels = panel_grid(figure, n, sharex=True)
    for i, axes in enumerate(panels):
        _curves(axes, diagnosis, signals, rows, i)
        label_below(axes, time_label(signals, rows), i, n)
    add_legend(figure, panels[0])
    return figure


def _fault(signals: Signals) -> np.ndarray:
    """(R, n) what the nominal model misses, in standard deviations of the measured torque."""
    return (signals.tau - signals.nominal) / np.maximum(np.nanstd(signals.tau, axis=0), 1e-300)


def _curves(axes: Axes, diagnosis: Diagnosis, signals: Signals, rows: slice, i: int) -> None:
    """Joint i: the three torques, its held-out errors in the title."""
    joint, unit, t = joints_of(diagnosis)[i], list(units_of(diagnosis).values())[i], signals.t[rows]
    measured, nominal, extended = (x[rows, i] for x in (signals.tau, signals.nominal, signals.extended))
    axes.plot(*thinned(t, nominal), color=BEFORE, lw=1.6, label="nominal model")
    axes.plot(*thinned(t, measured), color=MEASURED, lw=1.6, label="measured")
    axes.plot(*thinned(t, extended), color=AFTER, lw=1.2, ls=(0, (4, 1.5)), label="extended model")
    limit_around(axes, measured, np.concatenate([nominal, extended]))
    before, after = (significant(x.get(joint, {}).get("rmse")) for x in (diagnosis.baseline, diagnosis.extended))
    axes.set_title(plain(f"{joint}    held-out RMSE {before} → {after} {unit}"))
    axes.set_ylabel(f"torque [{unit}]")
    axes.margins(x=0.01)
