"""The picture of a designed trajectory: positions and speeds of every joint against their limits."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from invdyn_cli.design.trajectory import Design
from invdyn_cli.joints import units
from invdyn_cli.report.canvas import BLUE, GREY, LINE_POINTS, VERMILLION, blank_figure, house_style, plain, save

ROW = 1.1
"""[in] of a joint's row of panels."""


def draw(design: Design, path: Path) -> Path:
    """Write the picture as png."""
    with house_style():
        figure = picture(design)
        return save(figure, path)


def picture(design: Design) -> Figure:
    """A row of two panels for each joint: its position between its limits, and its speed."""
    robot = design.robot
    title = f"{robot.name}: a trajectory of {design.t[-1]:.4g} s that distinguishes causes"
    figure = blank_figure(ROW * robot.dofs + 0.8, title)
    axes = figure.subplots(robot.dofs, 2, sharex=True, squeeze=False)
    rows = np.linspace(0, len(design.t) - 1, min(len(design.t), LINE_POINTS)).astype(int)
    for i, name in enumerate(robot.joints):
        unit = units(robot.prismatic[i]).position
        panels = (
            (axes[i, 0], np.asarray(design.motion.q)[:, i], (robot.lower, robot.upper), f"{name} [{unit}]"),
            (axes[i, 1], np.asarray(design.motion.qd)[:, i], (-np.asarray(robot.velocity_limit), robot.velocity_limit),
             f"{name} [{unit}/s]"),
        )  # fmt: skip
        for axis, line, limits, title in panels:
            axis.plot(design.t[rows], line[rows], color=BLUE)
            for limit in (float(np.asarray(x)[i]) for x in limits):
                if np.isfinite(limit):
                    axis.axhline(limit, color=VERMILLION, linestyle="--", linewidth=0.8)
            axis.axhline(0.0, color=GREY, linewidth=0.5)
            axis.set_title(plain(title))
    for axis in axes[-1]:
        axis.set_xlabel("t [s], limits dashed")
    return figure
