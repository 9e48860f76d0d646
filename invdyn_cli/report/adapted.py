"""The figure of a run that adapts: errors along a repetition, with and without adapting (the paper's Fig. 4)."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from invdyn_cli.maths.metrics import ACCURATE, BLOCK, nmse_in_blocks
from invdyn_cli.report.canvas import (
    BLACK,
    GREY,
    INK,
    PREDICTED,
    RESIDUAL,
    add_legend,
    log_axis,
    plain,
    titled_figure,
)
from invdyn_cli.types import Prediction, RunRecord


def adaptation(record: RunRecord) -> Figure | None:
    """NMSE of every 100 samples over time, the mean over joints: median over the test trajectories, and their range."""
    if "test_adapted" not in record.predictions:
        return None
    figure = titled_figure(record, f"errors of {BLOCK} samples, as it goes on learning", 3.6)
    axes = figure.add_subplot()
    shown = ("test", "as it was learned", GREY), ("test_adapted", "adapted", RESIDUAL)
    for name, label, colour in shown:
        if (curves := _curves(record.predictions[name])) is not None:
            t, errors = curves
            axes.fill_between(t, errors.min(0), errors.max(0), color=colour, alpha=0.25, lw=0)
            axes.plot(t, np.median(errors, axis=0), color=colour, lw=1.6, label=label)
    if not axes.lines:
        return None
    axes.axhline(ACCURATE, color=BLACK, lw=1.0, label=f"NMSE {ACCURATE}")
    log_axis(axes)
    _mark_stages(axes, record.predictions["test_adapted"])
    axes.margins(x=0.01)
    axes.set_xlabel("time in a trajectory [s]")
    axes.set_ylabel("NMSE, mean over joints")
    add_legend(figure, axes)
    return figure


def _curves(judged: Prediction) -> tuple[np.ndarray, np.ndarray] | None:
    """Times (blocks,) [s] from each trajectory's start, and NMSE (trajectories, blocks) as far as all of them go."""
    lengths = [len(x.t) for x in judged.data.trajectories]
    blocks = min(lengths) // BLOCK
    if not blocks:
        return None
    starts = np.cumsum([0, *lengths[:-1]])
    rows = [slice(start, start + blocks * BLOCK) for start in starts]
    tau = judged.data.tau
    errors = [nmse_in_blocks(tau[r], judged.tau[r], BLOCK, np.var(tau, axis=0)) for r in rows]
    first = np.asarray(judged.data.trajectories[0].t)
    return first[: blocks * BLOCK : BLOCK] - first[0], np.nanmean(errors, axis=2)


def _mark_stages(axes: Axes, judged: Prediction) -> None:
    """Where stages begin, in the median over trajectories, with their names above."""
    staged = [x for x in judged.data.trajectories if x.stage is not None]
    stages = [(x.t - x.t[0], np.asarray(x.stage)) for x in staged]
    for name in dict.fromkeys(str(s) for _, stage in stages for s in stage):
        begins = float(np.median([t[stage == name][0] for t, stage in stages if (stage == name).any()]))
        axes.axvline(begins, color=PREDICTED, lw=0.9, ls="--")
        axes.annotate(plain(name), (begins, 1), xycoords=("data", "axes fraction"), xytext=(3, -10),
                      textcoords="offset points", color=INK)  # fmt: skip
