"""What all figures share: colours with roles, the grid of panels, limits that survive zeros and NaN, thinned curves.

Colours are those of Okabe and Ito, which colour-blind readers can tell apart; a role keeps its colour in all figures.
Pure black is for data alone, text is dark grey.
"""

import io
import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from invdyn_cli.files import write_file
from invdyn_cli.report.tables import choice, significant
from invdyn_cli.types import RunRecord

BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
BLUE, VERMILLION, PURPLE, GREY = "#0072B2", "#D55E00", "#CC79A7", "#999999"
COLOURS = {"black": BLACK, "orange": ORANGE, "sky": SKY, "green": GREEN, "blue": BLUE, "vermillion": VERMILLION,
           "purple": PURPLE, "grey": GREY}  # fmt: skip
"""By the names that experiments/*.yaml call them."""
MEASURED, PREDICTED, RESIDUAL, SAMPLES = BLACK, VERMILLION, BLUE, SKY
KEPT, DROPPED = BLUE, VERMILLION
SET_COLOURS = {"train": BLUE, "validation": SKY, "test": VERMILLION, "test_clean": ORANGE}
OTHER_SETS = (GREEN, PURPLE, GREY)

WIDTH = 11.0
LEGEND_LETTERS = 150
"""Largest number of characters of a legend in a line as wide as the figure, including the handles."""
LINE_POINTS = 2000
CLOUD_POINTS = 4000
NUMBERED = 10
BAND = 0.25
INK = "0.25"
STYLE: dict[Any, Any] = {
    "font.size": 8.5,
    "axes.titlesize": 9,
    "axes.titlelocation": "left",
    "axes.titley": 1.0,  # else every axis is measured once more for it
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "0.92",
    "legend.frameon": False,
    "lines.linewidth": 1.0,
    **dict.fromkeys(("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color"), INK),
}


@contextmanager
def house_style() -> Iterator[None]:
    """Within it figures look the same everywhere: matplotlibrc files of users and folders are ignored."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(STYLE)
        yield


def save(figure: Figure, path: Path) -> Path:
    """Write a figure, whole or not at all, in the format that the path ends with."""
    drawn = io.BytesIO()
    if path.suffix == ".png":  # savefig would draw all of it twice
        figure.set_dpi(110)
        FigureCanvasAgg(figure).print_png(drawn, pil_kwargs={"compress_level": 2})
    else:
        figure.savefig(drawn, dpi=110, format=path.suffix[1:])
    return write_file(path, drawn.getvalue())


def save_all(figure: Figure, folder: Path, name: str, formats: Iterable[str]) -> list[Path]:
    """Write a figure in each of these formats (png, svg, pdf): its files."""
    return [save(figure, folder / f"{name}.{suffix}") for suffix in formats]


def plain(name: str) -> str:
    """A name as matplotlib shows it unchanged: a dollar sign starts no formula."""
    return name.replace("$", r"\$")


def shape_of(panels: int) -> tuple[int, int]:
    """Rows and columns of a grid that holds so many panels."""
    columns = min(panels, 2 if panels <= 8 else 3)
    return math.ceil(panels / columns), columns


def blank_figure(height: float, title: str = "", size: float = 10.5) -> Figure:
    """An empty figure of that height [in], below its title, if it has one, in letters of this size [pt]."""
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    if title:
        figure.suptitle(plain(title), x=0.01, ha="left", fontsize=size, fontweight="bold")
    return figure


def titled_figure(record: RunRecord, title: str, height: float) -> Figure:
    """An empty figure of that height [in] below a line that names the run and the content."""
    run = f"{choice(record, 'model')} on {choice(record, 'data')}, {choice(record, 'adaptation')}"
    return blank_figure(height, f"{run}: {title}")


def panel_grid(figure: Figure, panels: int, *, sharex: bool = False) -> list[Axes]:
    """So many panels in the rows and columns of `shape_of`, without empty cells."""
    grid = figure.subplots(*shape_of(panels), squeeze=False, sharex=sharex).ravel()
    for axes in grid[panels:]:
        axes.remove()
    return list(grid[:panels])


def name_joints(axes: Axes, joints: Sequence[str], room: int) -> None:
    """The joints as tick labels, turned if they have more letters than there is room for."""
    turned = len(joints) * max(map(len, joints)) > room
    axes.set_xticks(range(len(joints)), map(plain, joints), rotation=30 * turned, ha="right" if turned else "center")


def add_legend(figure: Figure, *panels: Axes) -> None:
    """One legend for the whole figure below the panels, in as many lines as it takes; each label once, samples large
    enough to see."""
    found = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    lines = math.ceil(sum(len(label) + 8 for label in found) / LEGEND_LETTERS)
    columns = math.ceil(len(found) / max(1, lines))
    legend = figure.legend(found.values(), found.keys(), loc="outside lower center", ncols=columns)
    for line in legend.get_lines():
        line.set(alpha=1, linewidth=1.8, markersize=max(5, line.get_markersize()))


def label_below(axes: Axes, label: str, i: int, panels: int, *, shared: bool = True) -> None:
    """Tick labels (unless every panel has its own) and an x label for panel i, if it is the last of its column.

    Above an empty cell they take no room in the layout, so that the rows stay close.
    """
    rows, columns = shape_of(panels)
    last = i + columns >= panels
    axes.tick_params(labelbottom=last or not shared)
    axes.set_xlabel(label if last else "")
    axes.xaxis.set_in_layout(i + columns >= rows * columns if last else not shared)


def limit_around(axes: Axes, measured: np.ndarray, other: np.ndarray, least: float = 0.0) -> None:
    """Limits for both curves. A curve that diverges from the measured one is shown up to the range of the measured one
    beyond it, or up to `least`."""
    measured, other = measured[np.isfinite(measured)], other[np.isfinite(other)]
    if not len(measured):
        return
    low, high = measured.min(), measured.max()
    span = max(high - low, least)
    both = np.concatenate([measured, other])
    if span > 0:
        both = np.clip(both, low - span, high + span)
    low, high = both.min(), both.max()
    margin = 0.06 * (high - low) or 0.1 * abs(high) or 1.0
    axes.set_ylim(low - margin, high + margin)


def limit_zero(axes: Axes, values: np.ndarray) -> None:
    """Limits symmetric about zero, with a tick of one digit either side."""
    values = np.abs(values[np.isfinite(values)])
    reach = float(values.max()) if len(values) and values.max() > 0 else 1.0
    scale = 10.0 ** math.floor(math.log10(reach))
    tick = math.floor(1.1 * reach / scale) * scale
    axes.set_ylim(-1.15 * reach, 1.15 * reach)
    axes.set_yticks([-tick, 0, tick], [f"\N{MINUS SIGN}{tick:.4g}", "0", f"{tick:.4g}"])


def log_axis(axes: Axes) -> None:
    """A log axis in plain numbers, 0.1, 1e-5 and 1e-27; between the decades 2 and 5 are named where few decades show.

    An axis without a positive value gets limits of its own: a logarithm finds none there.
    """

    def between(value: float, _: float) -> str:
        low, high = axes.get_ylim()
        return short(value) if high < 300 * low else ""

    def short(value: float) -> str:
        return f"{value:g}".replace("e-0", "e-").replace("e+0", "e+")

    if not np.isfinite(axes.dataLim.minposy):
        axes.set_ylim(0.1, 10)
    axes.set_yscale("log")
    axes.yaxis.set_minor_locator(LogLocator(subs=(2, 5)))
    axes.yaxis.set_major_formatter(lambda value, _: short(value))
    axes.yaxis.set_minor_formatter(between)


def number_bars(axes: Axes, where: np.ndarray, values: np.ndarray) -> None:
    """The value of each bar above it, of up to NUMBERED: bars begin at zero, and small ones hardly show."""
    for x, value in zip(where, values, strict=True) if len(where) <= NUMBERED else ():
        if np.isfinite(value):
            axes.annotate(significant(value), (x, value), xytext=(0, 2), textcoords="offset points", ha="center",
                          fontsize=6, rotation=0 if len(where) < 5 else 60)  # fmt: skip


def limit_bars(axes: Axes, values: np.ndarray, line: float) -> None:
    """A log axis under bars and a line: the lowest positive bar keeps a visible height."""
    visible = values[np.isfinite(values) & (values > 0)]
    low, high = min([line, *visible]), max([line, *visible])
    log_axis(axes)
    axes.set_ylim(low * min(0.5, (low / high) ** 0.12), high * max(1.6, (high / low) ** 0.04))


def thinned(t: np.ndarray, y: np.ndarray, most: int = LINE_POINTS) -> tuple[np.ndarray, np.ndarray]:
    """At most `most` points of a curve (T,), the lowest and the highest of every stretch, so that no peak is lost."""
    if len(t) <= most:
        return t, y
    stretch = math.ceil(2 * len(t) / most)
    padded = np.pad(y, (0, -len(y) % stretch), mode="edge").reshape(-1, stretch)
    first = stretch * np.arange(len(padded))
    ends = np.sort([first + padded.argmin(axis=1), first + padded.argmax(axis=1)], axis=0).T.ravel()
    ends = np.minimum(ends, len(t) - 1)
    return t[ends], y[ends]


def binned(x: np.ndarray, y: np.ndarray, most: int = 40, fewest: int = 10) -> np.ndarray:
    """Centre of x, and 10 %, 50 %, 90 % of y, in about `most` equal bins, fewer for few points: (4, bins).

    The bins cover 99 % of the points, and one edge lies at zero: no bin mixes both directions of motion. A bin with
    less than `fewest` points is NaN.
    """
    low, high = np.percentile(x, [0.5, 99.5]) if len(x) else (0.0, 0.0)
    if not high - low > 0:
        return np.empty((4, 0))
    step = (high - low) / min(most, max(6, len(x) // (5 * fewest)))
    first = math.floor(low / step)
    index = np.floor(x / step).astype(int) - first
    out = np.full((4, math.ceil(high / step) - first), np.nan)
    for k in range(out.shape[1]):
        inside = y[index == k]
        out[0, k] = (first + k + 0.5) * step
        if len(inside) >= fewest:
            out[1:, k] = np.percentile(inside, [10, 50, 90])
    return out
