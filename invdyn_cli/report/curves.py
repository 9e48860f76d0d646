"""Errors of several methods along a repetition (the paper's Fig. 4), and the estimated mass of the load."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from invdyn_cli.maths import stages
from invdyn_cli.maths.metrics import ACCURATE, BLOCK
from invdyn_cli.report.canvas import BLACK, COLOURS, INK, add_legend, blank_figure, house_style, log_axis, plain
from invdyn_cli.report.comparison import matches
from invdyn_cli.types import RunRecord

SHOWN = (10, 90)
"""Percentiles of all repetitions and seeds between which a curve's band lies."""


@dataclass(frozen=True)
class Course:
    """A run as its curves show it.

    Attributes:
        begins: [samples] from a repetition's start at which each stage begins.
        errors: of "test" and, where the run adapts, "test_adapted": by stage (repetitions, blocks), NMSE.
        mass, mass_std: by stage (repetitions, blocks), of the load believed in at a block's end [kg], NaN: none; empty
            for a run that weighs none.
    """

    begins: Mapping[str, float]
    errors: Mapping[str, Mapping[str, np.ndarray]]
    mass: Mapping[str, np.ndarray]
    mass_std: Mapping[str, np.ndarray]


Run = tuple[Mapping[str, str], Course]
"""The labels of a job, and its run."""


def course(record: RunRecord) -> Course:
    """What is drawn of a run."""
    judged = {name: record.predictions[name] for name in ("test", "test_adapted") if name in record.predictions}
    mass, spread = ({}, {}) if "mass" not in record.trace else (_at_ends(record, x) for x in ("mass", "mass_std"))
    errors = {name: stages.errors(found) for name, found in judged.items()}
    return Course(stages.begins(judged["test"]), errors, mass, spread)


def draw(spec: Mapping[str, Any], runs: Sequence[Run]) -> Figure:
    """A figure of `lines` ({shown: {each: labels, set: test or test_adapted, colour, dashed}}): NMSE of 100 samples
    along a repetition, the median over repetitions, and over seeds; their band where it is not dashed.

    With `mass` ({each: labels, kg: the true one, shares of it between which is drawn}) a panel below shows what the
    load is taken for.
    """
    weighed = spec.get("mass")
    with house_style():
        figure = blank_figure(5.6 if weighed else 3.9, spec["title"])
        panels = figure.subplots(2 if weighed else 1, 1, squeeze=False, sharex=True,
                                 height_ratios=(3, 1.3) if weighed else (1,))[:, 0]  # fmt: skip
        axes = panels[0]
        for shown, line in spec["lines"].items():
            picked = [x for labels, x in runs if matches(labels, line["each"]) and line["set"] in x.errors]
            _curve(axes, shown, line, picked)
        axes.axhline(ACCURATE, color=BLACK, lw=1.1, label=f"NMSE {ACCURATE}", zorder=1.5)
        log_axis(axes)
        if limits := spec.get("limits"):
            axes.set_ylim(*limits)
        axes.set_ylabel(f"NMSE of {BLOCK} samples,\nmean over joints")
        if weighed:
            _weights(panels[1], weighed, [x for labels, x in runs if matches(labels, weighed["each"])])
        begins = runs[0][1].begins if runs else {}
        for panel in panels:
            mark_stages(panel, begins, named=panel is axes)
            panel.margins(x=0.01)
        panels[-1].set_xlabel("samples of a repetition" if len(begins) > 1 else "samples")
        add_legend(figure, *panels)
    return figure


def mark_stages(axes: Axes, begins: Mapping[str, float], *, named: bool = True) -> None:
    """Where stages begin, dotted, with their names at the top, where there are several."""
    for name, at in begins.items() if len(begins) > 1 else ():
        axes.axvline(at, color=INK, lw=0.8, ls=(0, (1, 2)), zorder=1.4)
        if named:
            axes.annotate(plain(name), (at, 1), xycoords=("data", "axes fraction"), xytext=(3, -10),
                          textcoords="offset points", color=INK)  # fmt: skip


def _curve(axes: Axes, shown: str, look: Mapping[str, Any], picked: Sequence[Course]) -> None:
    """The line of a method through all stages, unbroken, and its band."""
    if not picked:
        return
    found = [joined(x, x.errors[look["set"]]) for x in picked]
    t, middle, low, high = _together(found)
    colour = COLOURS[look["colour"]]
    style: dict[str, Any] = {"ls": (0, (4, 2)), "lw": 1.3} if look.get("dashed") else {"lw": 1.7}
    axes.plot(t, middle, color=colour, label=plain(shown), zorder=3, **style)
    if not look.get("dashed"):
        axes.fill_between(t, low, high, color=colour, alpha=0.16, lw=0, zorder=2)


def _weights(axes: Axes, spec: Mapping[str, Any], picked: Sequence[Course]) -> None:
    """The load's mass where at least half of the repetitions report one."""
    for x in picked[:1]:
        t, every = joined(x, x.mass)
        _, spread = joined(x, x.mass_std)
        believed = np.isfinite(every).mean(axis=0) >= 0.5
        middle, low, high, std = np.full((4, len(t)), np.nan)
        middle[believed], std[believed] = (np.nanmedian(y[:, believed], axis=0) for y in (every, spread))
        low[believed], high[believed] = np.nanpercentile(every[:, believed], SHOWN, axis=0)
        colour = COLOURS[spec.get("colour", "black")]
        axes.fill_between(t, low, high, color=colour, alpha=0.2, lw=0)
        axes.plot(t, middle, color=colour, lw=1.5, label="load, estimated mass")
        label = "mass ± its standard error"
        for sign in (1, -1):
            axes.plot(t, middle + sign * std, color=colour, lw=0.8, ls=":", label=label)
    axes.axhline(spec["kg"], color=INK, lw=0.9, label=f"true mass, {spec['kg']:g} kg")
    axes.set_ylim(*(share * spec["kg"] for share in spec.get("shares", (0.8, 1.2))))
    axes.set_ylabel("mass [kg]")


def joined(x: Course, by_stage: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Middles of blocks (blocks,) [samples], and all stages' (repetitions, blocks), as far as half of the repetitions
    go in each."""
    reached = {name: stages.reached(errors) for name, errors in x.errors["test"].items()}
    t = [x.begins[name] + BLOCK * (np.flatnonzero(kept) + 0.5) for name, kept in reached.items()]
    return np.concatenate(t), np.concatenate([by_stage[name][:, kept] for name, kept in reached.items()], axis=1)


def _together(found: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Times; the median over runs of the median over repetitions; the band of all of them."""
    t = found[0][0]
    middle = np.median([np.nanmedian(x, axis=0) for _, x in found], axis=0)
    with np.errstate(invalid="ignore"):  # between infinite errors a percentile is NaN, and is not drawn
        low, high = np.nanpercentile(np.concatenate([x for _, x in found]), SHOWN, axis=0)
    return t, middle, low, high


def _at_ends(record: RunRecord, name: str) -> dict[str, np.ndarray]:
    """A trace at the end of every block, by stage: (repetitions, blocks)."""
    values, row = np.asarray(record.trace[name]), 0
    found: dict[str, list[np.ndarray]] = {}
    for x in record.predictions["test_adapted"].data.trajectories:
        for stage, rows in stages.parts(x):
            found.setdefault(stage, []).append(values[row + rows.start : row + rows.stop][BLOCK - 1 :: BLOCK])
        row += len(x.t)
    return {stage: stages.padded(every) for stage, every in found.items()}
