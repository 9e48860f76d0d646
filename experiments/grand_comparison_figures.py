"""The figures of grand_comparison: error against time with the Pareto front, and learning curves."""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from invdyn_cli.report.canvas import BLACK, BLUE, GREEN, ORANGE, PURPLE, VERMILLION, house_style

FAMILIES: Mapping[str, tuple[str, Sequence[str]]] = {
    "rigid body and friction": (BLUE, ("pest", "pest_coulomb", "pest_friction", "standard", "dbm")),
    "kernels": (GREEN, ("gip", "lip", "gpr", "rff", "svr")),
    "local models": (ORANGE, ("local_gp", "lwpr")),
    "nets": (VERMILLION, ("ffnn", "ffnn_deep", "lagrangian_net", "gru")),
    "hybrids": (
        PURPLE,
        ("pest_coulomb + ffnn", "standard + gpr", "standard + gpr sparse", "pest_friction + gpr", "lip + gpr"),
    ),
}
MARKERS = "osD^v"
LOOK = {model: (colour, MARKERS[k]) for colour, models in FAMILIES.values() for k, model in enumerate(models)}
TIMES = {"predict_us": "time of a prediction [µs]", "fit_s": "time to learn [s]"}


def styled(draw: Callable[..., Figure]) -> Callable[..., Figure]:
    """A figure in the house style, axes and labels too."""

    @wraps(draw)
    def drawn(*arguments: Any) -> Figure:
        with house_style():
            return draw(*arguments)

    return drawn


@styled
def error_against_time(rows: Sequence[Any], time: str) -> Figure:
    """A panel per data set; the line joins the models that no other one beats in both."""
    figure, panels = grid(rows, f"Held-out error against {TIMES[time]}; the line is the Pareto front")
    for name, axes in panels.items():
        own = [row for row in rows if row.data == name]
        for row in own:
            axes.scatter(getattr(row, time), row.nmse, color=LOOK[row.model][0], marker=LOOK[row.model][1], s=30,
                         edgecolors="white", linewidths=0.4, zorder=3)  # fmt: skip
        front = pareto([(getattr(row, time), row.nmse) for row in own])
        axes.plot(*zip(*front, strict=True), color=BLACK, lw=0.9, drawstyle="steps-post", zorder=2)
        axes.set(xscale="log", yscale="log", xlabel=TIMES[time], title=name)
    legend(figure, rows)
    return figure


def pareto(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """The points with less error than every faster one, from the fastest on."""
    front: list[tuple[float, float]] = []
    for point in sorted(points):
        if not front or point[1] < front[-1][1]:
            front.append(point)
    return front


@styled
def curves(rows: Sequence[Any]) -> Figure:
    """A panel per data set: error over the number of rows."""
    figure, panels = grid(rows, "Learning curves: held-out error over the number of rows learned from")
    for name, axes in panels.items():
        for model in LOOK:
            own = sorted((row.samples, row.nmse) for row in rows if row.data == name and row.model == model)
            if own:
                colour, marker = LOOK[model]
                axes.plot(*zip(*own, strict=True), color=colour, marker=marker, ms=4, lw=0.9, mec="white", mew=0.4)
        axes.set(xscale="log", yscale="log", xlabel="rows", title=name)
        low, high = axes.get_ylim()
        axes.set_ylim(low, min(high, 10.0))
    legend(figure, rows)
    return figure


def grid(rows: Sequence[Any], title: str) -> tuple[Figure, dict[str, Axes]]:
    """A panel per data set, titled."""
    names = list(dict.fromkeys(row.data for row in rows))
    columns = min(4, len(names))
    lines = math.ceil(len(names) / columns)
    figure = Figure(figsize=(max(3.0 * columns, 7.0), 2.7 * lines + 1.4), layout="constrained")
    figure.suptitle(title, x=0.01, ha="left", fontweight="bold")
    panels = figure.subplots(lines, columns, squeeze=False)
    for axes in panels.flat[len(names) :]:
        axes.set_visible(False)
    for line in panels:
        line[0].set_ylabel("NMSE, mean of the joints")
    return figure, dict(zip(names, panels.flat, strict=False))


def legend(figure: Figure, rows: Sequence[Any]) -> None:
    """Every model that was drawn, colours by family, below."""
    axes, drawn = figure.axes[0], {row.model for row in rows}
    keys = [
        axes.plot([], [], color=colour, marker=marker, ls="", ms=5, label=model)[0]
        for model, (colour, marker) in LOOK.items()
        if model in drawn
    ]
    figure.legend(handles=keys, loc="outside lower center", ncols=7, fontsize=8)
