"""The figure of an experiment: test errors as bars on a log scale, with the paper's statements as boxes behind them."""

import itertools
import textwrap
from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from invdyn_cli.maths.metrics import ACCURATE
from invdyn_cli.report.canvas import (
    BLACK,
    BLUE,
    COLOURS,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PURPLE,
    SKY,
    VERMILLION,
    add_legend,
    blank_figure,
    house_style,
    limit_bars,
    plain,
)
from invdyn_cli.report.comparison import Job, band_of, matches, merged, values_of

OF_MODEL = {"PEST": GREEN, "NN": BLUE, "DBM": PURPLE}
"""The hues of the paper's Fig. 3."""

OTHERS = (ORANGE, SKY, VERMILLION, GREY, BLACK)

LETTERS = 118
"""Largest number of characters of tick labels in a line as wide as the figure."""


def draw(spec: Mapping[str, Any], statements: Sequence[Mapping[str, Any]], jobs: Sequence[Job]) -> Figure:
    """An experiment's `figure`: a panel per value of the label `panels`, a group of bars per combination of the labels
    `groups`, a bar per entry of `bars` ({shown: the labels it picks; `set`, else "test"; `colour`}).

    A bar is the mean NMSE over joints (the median of the seeds, a whisker for their range), a diamond the same on clean
    test inputs, dots the single joints where `joints` is true.
    """
    key = spec.get("panels")
    jobs = [job for job in jobs if any(matches(job[0], _labels(bar)) for bar in spec["bars"].values())]
    panels = _values(jobs, key) if key else [""]
    groups = [
        dict(zip(spec["groups"], values, strict=True))
        for values in itertools.product(*(_values(jobs, key) for key in spec["groups"]))
    ]
    sets = list(dict.fromkeys(bar.get("set", "test") for bar in spec["bars"].values()))
    everything = np.array([x for name in sets for _, metrics in jobs for x in _shown(spec, metrics, name)])
    with house_style():
        figure = blank_figure(0.9 + 2.9 * len(panels), spec["title"])
        every = figure.subplots(len(panels), 1, squeeze=False, sharex=True, sharey=True)[:, 0]
        for axes, panel in zip(every, panels, strict=True):
            limit_bars(axes, everything, ACCURATE)
            label = f"NMSE {ACCURATE}: accurate, in the paper's words"
            axes.axhline(ACCURATE, color=BLACK, lw=1.1, label=label, zorder=1.5)
            axes.grid(False, axis="x")
            axes.set_ylabel(f"{'test ' * (sets == ['test'])}NMSE, mean over joints")
            inside = [job for job in jobs if not key or job[0][key] == panel]
            _bars(axes, spec, statements, inside, groups)
            if key:
                axes.set_title(plain(f"{key}={panel}"))
        letters = LETTERS // len(groups)
        names = ["\n".join(plain(textwrap.fill(x, letters)) for x in group.values()) for group in groups]
        every[-1].set_xticks(range(len(groups)), names)
        every[-1].set_xlim(-0.55, len(groups) - 0.45)
        add_legend(figure, *every)
    return figure


def _bars(
    axes: Axes,
    spec: Mapping[str, Any],
    statements: Sequence[Mapping[str, Any]],
    jobs: Sequence[Job],
    groups: Sequence[Mapping[str, str]],
) -> None:
    width = 0.8 / len(spec["bars"])
    others = iter(OTHERS)
    boxes: list[tuple[float, float, float]] = []  # drawn last, so that the legend names them after all bars
    for k, (shown, bar) in enumerate(spec["bars"].items()):
        picked = _labels(bar)
        colour, of = COLOURS.get(bar.get("colour")) or OF_MODEL.get(shown) or next(others), bar.get("set", "test")
        for (i, group), (labels, several) in itertools.product(enumerate(groups), merged(jobs)):
            if not (matches(labels, picked) and matches(labels, group)):
                continue
            where, metrics = i + (k - (len(spec["bars"]) - 1) / 2) * width, several[0]
            values = [x for one in several for x in values_of(one, of)]
            axes.bar(where, median(values), 0.8 * width, color=colour, label=shown, zorder=2)
            if len(values) > 1:
                label = "seeds, lowest to highest"
                axes.vlines(where, min(values), max(values), color=INK, lw=1.6, label=label, zorder=3)
            for clean in values_of(metrics, "test_clean")[:1] if of == "test" else ():
                axes.plot(where, clean, "D", ms=4.5, mfc="white", mec=INK, label="on clean test inputs", zorder=4)
            if dots := _joints(spec, metrics, of):
                axes.plot([where] * len(dots), dots, ".", ms=5, color=INK, label="single joints", zorder=3)
            if (band := band_of(statements, labels, of)) is not None:
                boxes.append((where, *band))
    for where, low, high in boxes:
        _box(axes, where, width, low, high)


def _box(axes: Axes, where: float, width: float, low: float, high: float) -> None:
    """The expected range of a bar, behind it."""
    bottom, top = axes.get_ylim()
    low, high = max(low, bottom), min(high, top)
    look = {"color": "0.9", "edgecolor": "0.55", "lw": 0.8, "hatch": "///", "zorder": 1}
    axes.bar(where, high - low, width, bottom=low, label="expected", **look)


def _shown(spec: Mapping[str, Any], metrics: Mapping[str, Any], of: str) -> list[float]:
    """All numbers that a bar shows of one set."""
    clean = values_of(metrics, "test_clean")[:1] if of == "test" else []
    return [*values_of(metrics, of), *clean, *_joints(spec, metrics, of)]


def _joints(spec: Mapping[str, Any], metrics: Mapping[str, Any], of: str) -> list[float]:
    found = metrics[of]["nmse"]["joint"].values() if spec.get("joints") else ()
    return [x for x in found if x is not None]


def _labels(bar: Mapping[str, Any]) -> dict[str, Any]:
    """The labels by which a bar selects its jobs."""
    return {key: value for key, value in bar.items() if key not in ("set", "colour")}


def _values(jobs: Sequence[Job], key: str) -> list[str]:
    """The values of a label, in the order of the jobs."""
    return list(dict.fromkeys(labels[key] for labels, _ in jobs))
