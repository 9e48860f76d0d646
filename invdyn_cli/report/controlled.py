"""The value of a learned feedforward in a control loop: figure, table, sentences, JSON (invdyn-control/1), CSV."""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich import box
from rich.table import Table
from rich.text import Text

from invdyn_cli.control import ADAPTED, ALONE, KIND_WORDS, LEARNED, Case, ControlRecord
from invdyn_cli.maths.metrics import rms
from invdyn_cli.report.canvas import BLACK, BLUE, ORANGE, add_legend, blank_figure, house_style, log_axis, save
from invdyn_cli.report.tables import csv_text, significant

SCHEMA = "invdyn-control/1"
COLOURS = {ALONE: BLACK, LEARNED: ORANGE, ADAPTED: BLUE}
MARKERS = {ALONE: "s", LEARNED: "^", ADAPTED: "o"}
WIDTHS = {ALONE: 1.6, LEARNED: 4.0, ADAPTED: 1.6}
"""What has nothing to adapt to lies on what was learned: the lower line is the wider."""
OBJECT = {False: "without the object", True: "with the object"}

POOR = 5.0
"""[deg] Feedforwards are compared in words at the gain where the error with feedback alone is nearest to this value."""

IN_TIMES, SEEN = 1.2, 1.0
"""Ratio of errors from which they are told in times, below it in per cent; [%] below which they are told as equal."""


SAME = "the same"
"""Word for two errors that differ by less."""


def draw(record: ControlRecord, named: str, paths: Sequence[Path]) -> None:
    """The figure, in the formats that the paths end with."""
    with house_style():
        figure = _figure(record, named)
        for path in paths:
            save(figure, path)


def _figure(record: ControlRecord, named: str) -> Figure:
    """Tracking error and the feedback's share over the gain, without and with the object."""
    figure = blank_figure(6.4, f"{named}: tracking error and feedback torque")
    panels = figure.subplots(2, 2, sharex=True, sharey="row")
    gains = sorted(record.sweep.gains)
    for column, loaded in enumerate((False, True)):
        for row, values in enumerate((record.rms, record.share)):
            axes = panels[row, column]
            for kind in record.kinds:
                said = np.array([values(gain, loaded, kind) for gain in gains]) * (100.0 if row else 1.0)
                look = {
                    "color": COLOURS[kind],
                    "marker": MARKERS[kind],
                    "lw": WIDTHS[kind],
                    "ms": 3 + 1.2 * WIDTHS[kind],
                }
                axes.plot(gains, said, label=KIND_WORDS[kind], **look)
            log_axis(axes)
        panels[0, column].set_title(OBJECT[loaded])
        panels[1, column].set_xlabel("gain Kp / standard deviation of the joint's torque [1/rad]")
        _gain_axis(panels[1, column], gains)
    panels[0, 0].set_ylabel("tracking error, RMS over joints [deg]")
    panels[1, 0].set_ylabel("feedback torque, share of the total [%]")
    add_legend(figure, panels[0, 0])
    return figure


def _gain_axis(axes: Axes, gains: Sequence[float]) -> None:
    """A log axis with a tick at each gain that was tried, the stiffest left."""
    axes.set_xscale("log")
    axes.set_xticks(gains, [f"{x:g}" for x in gains])
    axes.set_xticks([], minor=True)
    axes.set_xlim(max(gains) * 1.15, min(gains) / 1.15)


def table(record: ControlRecord) -> Table:
    """A line for each gain, without and with the object: error [deg] and the feedback's share [%] of each kind."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, caption="error: RMS over time and joints; feedback: RMS share")
    table.add_column("object")
    table.add_column(Text("gain\n[1/rad]"), justify="right")
    for kind in record.kinds:
        table.add_column(Text(f"{KIND_WORDS[kind]}\nerror [deg]"), justify="right")
    for kind in record.kinds[1:]:
        table.add_column(Text(f"{KIND_WORDS[kind]}\nfeedback [%]"), justify="right")
    for loaded in (False, True):
        for i, gain in enumerate(record.sweep.gains):
            errors = [significant(record.rms(gain, loaded, kind)) for kind in record.kinds]
            shares = [significant(100 * record.share(gain, loaded, kind)) for kind in record.kinds[1:]]
            table.add_row("" if i else OBJECT[loaded].split()[0], f"{gain:g}", *errors, *shares)
        table.add_section()
    return table


def sentences(record: ControlRecord) -> list[str]:
    """How much smaller the errors with the feedforwards are at the gain where the error with feedback alone is nearest
    to POOR; and failures."""
    out = []
    for loaded in (False, True):
        alone = {gain: record.rms(gain, loaded, ALONE) for gain in record.sweep.gains}
        finite = {gain: x for gain, x in alone.items() if math.isfinite(x)}
        if not finite:
            continue
        gain = min(finite, key=lambda g: abs(math.log(finite[g] / POOR)))
        told = f"{OBJECT[loaded].capitalize()}, gain {gain:g}: the error is {significant(finite[gain])} deg with "
        told += "feedback alone"
        learned, *adapted = (record.rms(gain, loaded, kind) for kind in record.kinds[1:])
        if math.isfinite(learned):
            told += f"; with the model it is {_times(finite[gain], learned)}"
        if adapted and math.isfinite(adapted[0]):
            told += f"; with the adapted model it is {_times(finite[gain], adapted[0])}"
            if math.isfinite(learned):
                compared = _times(learned, adapted[0])
                told += f", {compared} {'as' if compared == SAME else 'than'} without adaptation"
        out.append(f"{told}.")
    for case in record.cases:
        if case.failed:
            kind = KIND_WORDS[case.kind]
            out.append(f"{OBJECT[case.loaded].capitalize()}, gain {case.gain:g}, {kind}: {case.failed}.")
    return out


def _times(before: float, after: float) -> str:
    times, where = (before / after, "smaller") if before > after else (after / before, "larger")
    if times >= IN_TIMES:
        return f"{times:.1f} times {where}"
    change = 100 * abs(after / before - 1)
    return f"{change:.0f} % {where}" if change >= SEEN else SAME


def as_json(record: ControlRecord, choices: Mapping[str, Any]) -> str:
    """All runs with every joint, schema invdyn-control/1; null for what there is no number for."""

    def joints(values: np.ndarray) -> dict[str, float | None]:
        return {name: _number(x) for name, x in zip(record.joints, values, strict=True)}

    def case(one: Case) -> dict[str, Any]:
        stages = {name: {"rms": _number(float(rms(x))), "joint": joints(x)} for name, x in one.stages.items()}
        return {
            "object": one.loaded,
            "feedforward": one.kind.replace(" ", "_"),
            "gain": one.gain,
            "repetition": one.repetition,
            "error_deg": {"rms": _number(one.rms), "peak": _number(float(one.peak.max())), "joint": joints(one.error)},
            "peak_deg": joints(one.peak),
            "stages_deg": stages,
            "feedback_N_m": joints(one.feedback),
            "feedback_share": {"mean": _number(one.share), "joint": joints(one.feedback / one.torque)},
            "seconds_per_tick": {"p50": _number(one.tick[0]), "p99": _number(one.tick[1])},
            "failed": one.failed or None,
        }

    said = {
        "schema": SCHEMA,
        **choices,
        "joints": list(record.joints),
        "torque_spread_N_m": joints(record.spread),
        **{name: value for name, value in vars(record.sweep).items() if name != "gains"},
        "gains": list(record.sweep.gains),
        "cases": [case(x) for x in record.cases],
        "seconds": dict(record.seconds),
    }
    return json.dumps(said, indent=2, allow_nan=False) + "\n"


def as_csv(record: ControlRecord) -> str:
    """A line for each run, numbers unrounded; errors of the joints in columns of their own."""
    columns = ("object", "feedforward", "gain", "repetition", "error_deg", "peak_deg", "feedback_share")
    rows: list[list] = [[*columns, *(f"error_deg[{x}]" for x in record.joints)]]
    for one in record.cases:
        what = int(one.loaded), one.kind.replace(" ", "_"), one.gain, one.repetition
        rows.append([*what, *map(_number, (one.rms, one.peak.max(), one.share, *one.error))])
    return csv_text(rows)


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
