"""Measured torques of a repetition with and one without an object (the paper's Fig. 2)."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from invdyn_cli.maths import stages
from invdyn_cli.report.canvas import SKY, VERMILLION, add_legend, blank_figure, house_style, plain, thinned
from invdyn_cli.report.curves import mark_stages
from invdyn_cli.report.tables import units
from invdyn_cli.types import RunRecord, Trajectory


def draw(spec: Mapping[str, Any], record: RunRecord) -> Figure:
    """The first repetition of the validation set (without the object, red) and of the test set (with it, blue), over
    samples, a panel per joint of `joints` (numbers from 1); stages are those of the repetition with it."""
    numbers = spec.get("joints", [1])
    without, loaded = (record.predictions[name].data.trajectories[0] for name in ("validation", "test"))
    with house_style():
        figure = blank_figure(0.9 + 2.3 * max(1.2, len(numbers)), spec["title"])
        panels = figure.subplots(len(numbers), 1, squeeze=False, sharex=True)[:, 0]
        for axes, number in zip(panels, numbers, strict=True):
            for x, colour, label in ((without, VERMILLION, "without object"), (loaded, SKY, "with object")):
                axes.plot(*thinned(*_course(x, number - 1)), color=colour, lw=1.6, label=label)
            mark_stages(axes, {name: rows.start for name, rows in stages.parts(loaded)}, named=axes is panels[0])
            axes.margins(x=0.01)
            if axes is panels[0]:  # room for the names of the stages
                low, high = axes.get_ylim()
                axes.set_ylim(low, high + 0.12 * (high - low))
            axes.set_title(plain(record.fit.joints[number - 1]))
            axes.set_ylabel(f"torque [{units(record)[number - 1]}]")
        panels[-1].set_xlabel("samples of a repetition (1 kHz)")
        add_legend(figure, *panels)
    return figure


def _course(x: Trajectory, joint: int) -> tuple[np.ndarray, np.ndarray]:
    return np.arange(len(x.t)), np.asarray(x.tau)[:, joint]
