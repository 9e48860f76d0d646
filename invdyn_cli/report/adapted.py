"""The figure of a run that adapts: errors along a repetition, with and without adaptation (the paper's Fig. 4)."""

import numpy as np
from matplotlib.figure import Figure

from invdyn_cli.maths.metrics import ACCURATE, BLOCK
from invdyn_cli.report.canvas import BLACK, GREY, RESIDUAL, add_legend, log_axis, titled_figure
from invdyn_cli.report.curves import course, joined, mark_stages
from invdyn_cli.types import RunRecord


def adaptation(record: RunRecord) -> Figure | None:
    """NMSE of every 100 samples over time, the mean over joints: median over the test trajectories, and their range."""
    if "test_adapted" not in record.predictions:
        return None
    data, run = record.predictions["test_adapted"].data, course(record)
    step = float(np.median(np.concatenate([np.diff(x.t) for x in data.trajectories])))
    figure = titled_figure(record, f"errors of {BLOCK} samples during adaptation", 3.6)
    axes = figure.add_subplot()
    for name, label, colour in (("test", "not adapted", GREY), ("test_adapted", "adapted", RESIDUAL)):
        at, errors = joined(run, run.errors[name])
        if not len(at):
            return None
        axes.fill_between(step * at, np.nanmin(errors, 0), np.nanmax(errors, 0), color=colour, alpha=0.25, lw=0)
        axes.plot(step * at, np.nanmedian(errors, axis=0), color=colour, lw=1.6, label=label)
    axes.axhline(ACCURATE, color=BLACK, lw=1.0, label=f"NMSE {ACCURATE}")
    log_axis(axes)
    if data.stage is not None:
        mark_stages(axes, {name: step * begins for name, begins in run.begins.items()})
    axes.margins(x=0.01)
    axes.set_xlabel("time in a trajectory [s]")
    axes.set_ylabel("NMSE, mean over joints")
    add_legend(figure, axes)
    return figure
