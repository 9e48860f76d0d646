"""The picture of the better simulation: the unconstrained simulated arm and the measured motion."""

import numpy as np
from matplotlib.figure import Figure

from invdyn_cli.diagnosis.decide.wording import units_of
from invdyn_cli.report.canvas import MEASURED, add_legend, blank_figure, limit_around, name_joints, plain
from invdyn_cli.report.overview import AFTER, BEFORE, paired_bars
from invdyn_cli.report.tables import position_unit
from invdyn_cli.report.wording import joints_of
from invdyn_cli.types import Diagnosis

REPLAY = "replay"
"""What the picture's file is called."""

LEAST = 0.001
"""[rad; m] either way of a joint that rests, within which a simulated one is shown."""


def replay_figure(diagnosis: Diagnosis) -> Figure:
    """A few windows of the joint that gains most, and the error of every joint, nominal and extended."""
    replay = diagnosis.replay
    figure = blank_figure(5.6, f"Unconstrained replay, {replay.length:g} s under the logged torques", 11)
    columns = max(1, len(replay.traces))
    grid = figure.add_gridspec(2, columns, height_ratios=(1.1, 1))
    panels, bars = [figure.add_subplot(grid[0, k]) for k in range(columns)], figure.add_subplot(grid[1, :])
    unit = angle_unit(diagnosis)
    for axes, trace in zip(panels, replay.traces, strict=False):
        t = 1000 * (trace.t - trace.t[0])
        axes.plot(t, trace.before, color=BEFORE, lw=1.8, label="nominal arm")
        axes.plot(t, trace.after, color=AFTER, lw=1.8, label="extended arm")
        axes.plot(t, trace.measured, color=MEASURED, lw=1.2, ls="--", label="measured")
        limit_around(axes, trace.measured, np.concatenate([trace.before, trace.after]), LEAST)
        axes.set_title(f"{plain(trace.name)}\nfrom {trace.t[0]:.4g} s")
        axes.set_xlabel("time in the window [ms]")
        axes.margins(x=0.01)
    if replay.traces:
        panels[0].set_ylabel(f"position of {plain(replay.traces[0].joint)} [{unit[replay.traces[0].joint]}]")
    paired_bars(bars, (replay.before, replay.after), ("nominal arm", "extended arm"))
    bars.margins(y=0.12)
    bars.set_ylim(bottom=0)
    name_joints(bars, replay.joints, 110)
    bars.grid(False, axis="x")
    bars.set_title(f"error of every joint, RMS over {replay.windows} windows")
    bars.set_ylabel(f"position error [{'; '.join(dict.fromkeys(unit.values()))}]")
    add_legend(figure, *panels, bars)
    return figure


def angle_unit(diagnosis: Diagnosis) -> dict[str, str]:
    """rad, or m for a joint that slides, by joint."""
    torque = units_of(diagnosis)
    return {x: position_unit(torque.get(x, "")) for x in joints_of(diagnosis)}
