"""Defects of a log, marked in a panel: samples, spans, and defects of a whole channel."""

from dataclasses import replace
from textwrap import shorten

import numpy as np
from matplotlib.axes import Axes

from invdyn_cli.recording.rows import runs
from invdyn_cli.report.canvas import GREEN, GREY, INK, ORANGE, PURPLE, SKY, VERMILLION, plain
from invdyn_cli.report.checked_log import CheckedLog, Pieces, joined

MOST_MARKS = 400
"""Drawn samples of one mark."""

MOST_GAPS = 100
"""Drawn gaps, the longest first."""

LOOKS = {"outliers": (VERMILLION, "x"), "not_finite": (PURPLE, "v"), "duplicates": (SKY, "v")}
"""Colour and marker of marks of single samples."""

SEVERITY = {"fail": VERMILLION, "warn": "#9A5B00", "note": INK, "": INK}


def draw_recordings(drawn: CheckedLog, axes: Axes, names: bool = False) -> None:
    """A line between recordings; their names where there is room."""
    count = len(drawn.log.trajectories)
    for k, raw in enumerate(drawn.log.trajectories):
        if not len(raw.t) or count < 2:
            continue
        at = float(drawn.time[drawn.starts[k]])
        if k:
            axes.axvline(at, color=GREY, lw=0.8, ls=":")
        if names and count <= 6:
            axes.text(at, 1.0, f" {plain(raw.name)}", transform=axes.get_xaxis_transform(), va="bottom", fontsize=7.5)


def draw_marks(drawn: CheckedLog, axes: Axes, name: str, joint: int | None, pieces: Pieces | None = None) -> None:
    """The marks of a channel's joint: samples, spans, and what holds of the whole channel above the panel."""
    whole, level = [], 0
    low, high = axes.get_ylim()
    rows, values = joined(pieces or [])
    for one in drawn.marks:
        if one.check == "gaps" and one.rows is not None:
            for a, b in drawn.time[longest_gaps(drawn, one.rows)].tolist():
                axes.axvspan(a, b, color=GREY, alpha=0.35, lw=0, label="gap")
        if one.channel == "q_ref" and name == "q":
            one = replace(one, channel="q", label=one.label if one.label.startswith("q") else f"q_ref: {one.label}")
        if one.channel != name or one.joint not in (None, joint):
            continue
        if one.rows is None or one.check not in (*LOOKS, "saturation", "at_rest", "gaps"):
            whole.append(one)
            continue
        if not len(one.rows) or one.check == "gaps":
            whole += [one] if one.check == "gaps" else []
            continue
        at = one.rows[:: max(1, len(one.rows) // MOST_MARKS)]
        x = drawn.time[at]
        colour = LOOKS.get(one.check, (GREEN if one.check == "at_rest" else ORANGE,))[0]
        word = one.check.replace("_", " ")
        if one.check in LOOKS:
            y = np.interp(at, rows, values) if len(rows) and one.check == "outliers" else np.full(len(at), high)
            axes.plot(x, np.clip(y, low, high), LOOKS[one.check][1], color=colour, ms=6, mew=1.6, clip_on=False,
                      label=word)  # fmt: skip
        else:
            _spans(drawn, axes, one.rows, colour, low if one.check == "at_rest" else None, rows, values, word)
        side = "left" if x[0] < np.mean(axes.get_xlim()) else "right"
        axes.text(x[0], 0.97 - 0.13 * level, f" {plain(one.label)} ", ha=side, va="top", fontsize=7.5,
                  transform=axes.get_xaxis_transform(),
                  bbox={"facecolor": "white", "alpha": 0.75, "lw": 0, "pad": 0.5})  # fmt: skip
        level += 1
    if whole:
        worst = max(whole, key=lambda x: ("", "note", "warn", "fail").index(x.severity))
        said = ", ".join(dict.fromkeys(x.label for x in whole))
        room = 80 - len(axes.get_title()) - len(axes.get_title("left"))
        axes.set_title(
            plain(shorten(said, max(30, room), placeholder=" …")),
            loc="right",
            fontsize=8,
            color=SEVERITY[worst.severity],
        )


def _spans(
    drawn: CheckedLog, axes: Axes, at: np.ndarray, colour: str, level: float | None, rows, values, word: str
) -> None:
    """Thick segments where rows follow each other: on the curve, or at one level."""
    ends = spans(at)
    y = np.interp(ends, rows, values) if level is None else np.full(ends.shape, level)
    lines = np.full((2, len(ends), 3), np.nan)
    lines[:, :, :2] = drawn.time[ends], y
    axes.plot(*lines.reshape(2, -1), color=colour, lw=4, alpha=0.8, solid_capstyle="butt", label=word, zorder=3)


def spans(rows: np.ndarray) -> np.ndarray:
    """(k, 2) first and last one of rows that follow each other, the first MOST_MARKS such spans."""
    flags = np.zeros(rows.max() + 1, bool)
    flags[rows] = True
    return runs(flags)[:MOST_MARKS] - np.array([0, 1])


def longest_gaps(drawn: CheckedLog, rows: np.ndarray) -> np.ndarray:
    """(k, 2) rows at the ends of gaps, the longest MOST_GAPS, of the rows of all."""
    ends = rows.reshape(-1, 2)
    return ends[np.argsort(drawn.time[ends[:, 0]] - drawn.time[ends[:, 1]])[:MOST_GAPS]]
