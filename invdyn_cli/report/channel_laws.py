"""Panels for effects of the torque's channel: what is delivered for what is logged. As in `laws`, a panel takes its
axes and an exhibit."""

import numpy as np
from matplotlib.axes import Axes

from invdyn_cli.report.canvas import BLACK, GREY, INK, MEASURED, PREDICTED, SAMPLES
from invdyn_cli.report.exhibits import Exhibit, in_window, recordings
from invdyn_cli.report.laws import cloud, joint_name, law, mark, name_axes, scalar


def over_nominal(axes: Axes, exhibit: Exhibit) -> None:
    """Over the nominal torque: a wrong scale is a line; if the effect acts in a time window, its samples have another
    colour."""
    x, y, term = (exhibit.own(a) for a in (exhibit.signals.nominal, exhibit.residual, exhibit.term))
    inside = in_window(exhibit.finding, exhibit.signals)
    if inside.any() and not inside.all():
        cloud(axes, x[~inside], y[~inside], GREY, "outside of the window")
        x, y, term = x[inside], y[inside], term[inside]
    law(axes, x, y, term)
    axes.set_title("over the nominal torque")
    name_axes(axes, exhibit, f"nominal torque of {joint_name(exhibit)} [{exhibit.unit}]")


def over_rate(axes: Axes, exhibit: Exhibit) -> None:
    """Over the time derivative of the nominal torque: a late torque leaves a residual in proportion to it."""
    nominal, t = exhibit.own(exhibit.signals.nominal), exhibit.signals.t
    rate = np.full(len(t), np.nan)
    for rows in recordings(exhibit.signals):
        if rows.stop - rows.start > 2:
            rate[rows] = np.gradient(nominal[rows], t[rows])
    law(axes, rate, exhibit.own(exhibit.residual), exhibit.own(exhibit.term))
    axes.set_title("over the slope of the torque")
    name_axes(axes, exhibit, f"d(nominal torque)/dt of {joint_name(exhibit)} [{exhibit.unit}/s]")


def misfit_over_shift(axes: Axes, exhibit: Exhibit) -> None:
    """RMS of what is left if the logged torque is shifted by so much: least at the delay.

    The model's torque is shifted in the other direction, because interpolation smooths noise and would favour half
    steps.
    """
    tau, t = exhibit.own(exhibit.signals.tau), exhibit.signals.t
    without = exhibit.own(exhibit.signals.extended) - exhibit.own(exhibit.term)
    delay = scalar(exhibit.finding, "delay", scalar(exhibit.finding, "time_constant", 0.0))
    size = abs(delay) or 0.01
    shifts = np.linspace(min(-size, delay - 1.5 * size), max(size, delay + 1.5 * size), 61)
    squares, count = np.zeros(len(shifts)), 0
    for rows in recordings(exhibit.signals):
        inner = rows.start + np.flatnonzero((t[rows] - t[rows][0] > 3 * size) & (t[rows][-1] - t[rows] > 3 * size))
        inner = inner[np.isfinite(tau[inner] + without[inner])]
        for k, shift in enumerate(shifts):
            squares[k] += np.sum((tau[inner] - np.interp(t[inner] + shift, t[rows], without[rows])) ** 2)
        count += len(inner)
    misfit = np.sqrt(squares / max(1, count))
    axes.plot(1000 * shifts, misfit, color=MEASURED, lw=1.4)
    k = int(np.argmin(misfit))
    axes.plot(1000 * shifts[k], misfit[k], "o", color=MEASURED, ms=6, label="smallest misfit")
    axes.axvline(0, color=INK, lw=0.8)
    axes.axvline(1000 * delay, color=PREDICTED, lw=2.2, alpha=0.35, zorder=0)
    axes.set_ylim(bottom=0)
    mark(axes, 1000 * delay, f"{1000 * delay:.3g} ms")
    axes.set_title("misfit if the logged torque is shifted")
    name_axes(axes, exhibit, "shift [ms]", y="RMS")


def clipping(axes: Axes, exhibit: Exhibit) -> None:
    """Torque that the motion took over the logged one: on the diagonal, and flat where the drive gives no more."""
    logged, took = exhibit.own(exhibit.signals.tau), exhibit.own(exhibit.signals.extended - exhibit.term)
    cloud(axes, logged, took, SAMPLES, "samples")
    limit = scalar(exhibit.finding, "limit")
    ends = np.array([np.nanmin(logged), np.nanmax(logged)])
    axes.plot(ends, ends, color=BLACK, lw=1, label="delivered as logged")
    for side in (-1, 1) if np.isfinite(limit) else ():
        axes.axhline(side * limit, color=PREDICTED, lw=2, label=f"limit ±{limit:.4g} {exhibit.unit}")
    axes.set_title("delivered over logged torque")
    name_axes(axes, exhibit, f"logged torque of {joint_name(exhibit)} [{exhibit.unit}]", y="delivered torque")
