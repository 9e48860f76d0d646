"""Plots that zoom: panels over one time axis, clouds of points linked to it, and the arm in its posture at the cursor.

Here they are plain data, written into the page as JSON; `plots.js` draws them. Long recordings are thinned: of every
stretch the lowest and the highest value are kept, in their order, so that no peak is lost.
"""

import base64
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

SCRIPT, STYLES = (Path(__file__).with_name(name) for name in ("plots.js", "plots.css"))
"""What a page with plots has in it once (`html.document`)."""

MOST_VALUES = 150_000
"""Largest number of values of all lines of a figure: 0.4 MB of its page."""

MOST_POINTS = 2500
"""Points of a cloud."""

WIDE = 20.0
"""Range of a line over that of nine in ten of its values from which on it is kept as float32."""

GAP = 5.0
"""Steps of the clock, in median steps, above which lines are interrupted."""


@dataclass(frozen=True)
class Line:
    """A curve over the rows of the figure.

    Attributes:
        name: in the key.
        y: (T,), NaN where there is none.
        colour: its name in `html.STYLE`.
        width: [px].
        frames: whether the panel's axis is fitted to it; the others widen it by at most its range either way.
    """

    name: str
    y: np.ndarray
    colour: str
    width: float = 1.2
    frames: bool = True


@dataclass(frozen=True)
class Mark:
    """Marks in a panel: spans (k, 2) of rows, or single rows (k,) at y (k,); NaN: at the top."""

    name: str
    colour: str
    rows: np.ndarray
    y: np.ndarray | None = None


@dataclass(frozen=True)
class Panel:
    """Lines over time; `quantity` has its unit, `note` stands at the right, `joint` is lit in the arm."""

    title: str
    quantity: str
    lines: Sequence[Line]
    marks: Sequence[Mark] = ()
    note: str = ""
    joint: int | None = None
    height: int = 150
    zero: bool = False


@dataclass(frozen=True)
class Cloud:
    """Points (x, y) of the figure's rows, both (T,), a colour each; `curves` have an x (k,) of their own; `diagonal`
    draws y = x."""

    title: str
    x_label: str
    y_label: str
    points: Sequence[tuple[str, np.ndarray, np.ndarray, str]]
    curves: Sequence[tuple[str, np.ndarray, np.ndarray, str]] = ()
    diagonal: bool = False
    joint: int | None = None


@dataclass(frozen=True)
class Posture:
    """The arm at times t (F,) [s] of the figure's axis: points (F, k, 3) [m] with z up, the point that each one hangs
    on (-1: none); point 0 is the base, those after it the joints."""

    t: np.ndarray
    points: np.ndarray
    parents: Sequence[int]
    joints: Sequence[str]


@dataclass(frozen=True)
class Timeline:
    """The rows that all plots of a figure share.

    Attributes:
        t: (T,) [s], of each recording its own.
        names: (row at which it begins, its name) of every recording, in their order.
        label: of the time axis.
        stages: (row, name) of what begins within a recording.
    """

    t: np.ndarray
    names: Sequence[tuple[int, str]]
    label: str = "time [s]"
    stages: Sequence[tuple[int, str]] = field(default_factory=tuple)

    def joined(self) -> tuple[np.ndarray, list[tuple[str, float, float]]]:
        """(T,) [s] with recordings one after another, from the first one's start; of each its name, where it begins
        there, and what to add for its own time."""
        ends = [*(row for row, _ in self.names[1:]), len(self.t)]
        out, at, parts = np.array(self.t, float), 0.0, []
        for (row, name), end in zip(self.names, ends, strict=True):
            if end <= row:
                continue
            own = self.t[row:end]
            at = float(own[0]) if not parts else at
            out[row:end] = own - own[0] + at
            parts.append((name, at, float(own[0]) - at))
            at += float(own[-1] - own[0]) + (float(np.median(np.diff(own))) if end - row > 1 else 0.0)
        return out, parts


def plots(
    time: Timeline,
    panels: Sequence[Panel],
    clouds: Sequence[Cloud] = (),
    arm: Posture | None = None,
    label: str = "plots over time",
    note: str = "",
) -> str:
    """The figure's data as HTML, `note` below its clouds; what draws it stands once at the page's end
    (`html.document`)."""
    t, parts = time.joined()
    lines = sum(len(x.lines) for x in panels)
    pick = _Thinned(t, _stretches(t, [row for row, _ in time.names]), MOST_VALUES // max(1, lines + 1))
    some = np.unique(np.linspace(0, len(t) - 1, min(len(t), MOST_POINTS)).astype(int)) if len(t) else np.zeros(0, int)
    start = float(t[0]) if len(t) else 0.0
    said: dict[str, Any] = {
        "label": label,
        "time": time.label,
        "start": start,
        "t": _packed(pick.t - start),
        "every": pick.every,
        "parts": [[name, _number(at - start), _number(more)] for name, at, more in parts],
        "stages": [[name, _number(t[row] - start)] for row, name in time.stages],
        "panels": [_panel(x, pick, t - start) for x in panels],
        "cloud_t": _packed((t - start)[some]),
        "clouds": [_cloud(x, some) for x in clouds],
        "note": note,
    }
    if arm is not None:
        said["arm"] = {
            "t": _packed(arm.t - start),
            "points": _packed(arm.points.reshape(len(arm.points), -1)),
            "parents": list(arm.parents),
            "joints": list(arm.joints),
        }
    text = json.dumps(said, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    return f'<div class="plots" role="group" aria-label="{escape(label, quote=True)}">' + (
        f'<script type="application/json">{text}</script></div>'
    )


class _Thinned:
    """Which values of a line are kept: `most` at most, the same times for all lines."""

    def __init__(self, t: np.ndarray, stretches: Sequence[slice], most: int) -> None:
        self._stretches = stretches
        room = max(200, most - len(stretches))
        self.every = 1 if len(t) <= room else math.ceil(2 * len(t) / room)
        self.t = self._joined([self._times(t[x]) for x in stretches], repeat=True)

    def values(self, y: np.ndarray) -> np.ndarray:
        """Those of a line (T,)."""
        y = np.asarray(y, float)
        return self._joined([self._ends(y[x]) for x in self._stretches])

    def _times(self, t: np.ndarray) -> np.ndarray:
        if self.every == 1:
            return t
        first = np.arange(0, len(t), self.every)
        return np.stack([t[np.minimum(first + k * self.every // 4, len(t) - 1)] for k in (1, 3)], axis=1).ravel()

    def _ends(self, y: np.ndarray) -> np.ndarray:
        if self.every == 1:
            return y
        padded = np.pad(y, (0, -len(y) % self.every), mode="edge").reshape(-1, self.every)
        lost = ~np.isfinite(padded)
        low, high = np.where(lost, np.inf, padded), np.where(lost, -np.inf, padded)
        first = low.argmin(axis=1) <= high.argmax(axis=1)
        ends = low.min(axis=1), high.max(axis=1)
        out = np.stack([np.where(first, *ends), np.where(first, *ends[::-1])], axis=1)
        return np.where(np.isfinite(out), out, np.nan).ravel()

    @staticmethod
    def _joined(parts: Sequence[np.ndarray], repeat: bool = False) -> np.ndarray:
        """One after another, a value without a number between them (of times: the last one again)."""
        out: list[np.ndarray] = []
        for part in parts:
            out += [part, part[-1:] if repeat else np.full(len(part[-1:]), np.nan)]
        return np.concatenate([np.zeros(0), *out[:-1]])


def _stretches(t: np.ndarray, starts: Sequence[int]) -> list[slice]:
    """Rows without interruption."""
    if not len(t):
        return []
    step = np.diff(t)
    usual = float(np.median(step[step > 0])) if (step > 0).any() else 0.0
    gaps = np.flatnonzero(step > GAP * usual) + 1 if usual else np.zeros(0, int)
    cuts = sorted({*starts, *(gaps.tolist() if len(gaps) < 500 else ())} - {0, len(t)})
    return [slice(a, b) for a, b in pairwise((0, *cuts, len(t)))]


def _panel(panel: Panel, pick: _Thinned, t: np.ndarray) -> dict[str, Any]:
    def mark(one: Mark) -> dict[str, Any]:
        rows = np.asarray(one.rows, int)
        if rows.ndim == 2:
            return {"name": one.name, "colour": one.colour, "spans": [[float(t[x]) for x in ends] for ends in rows]}
        y = np.full(len(rows), np.nan) if one.y is None else one.y
        at = [[float(t[row]), _number(float(v))] for row, v in zip(rows, y, strict=True)]
        return {"name": one.name, "colour": one.colour, "at": at}

    return {
        "title": panel.title.replace("N m", "N\u00a0m"),
        "quantity": panel.quantity, "note": panel.note, "joint": panel.joint,
        "height": panel.height, "zero": panel.zero, "marks": [mark(x) for x in panel.marks],
        "lines": [
            {"name": x.name, "colour": x.colour, "width": x.width, "frames": x.frames,
             "y": _packed(pick.values(x.y))}
            for x in panel.lines
        ],
    }  # fmt: skip


def _cloud(cloud: Cloud, some: np.ndarray) -> dict[str, Any]:
    def curve(name: str, x: np.ndarray, y: np.ndarray, colour: str) -> dict[str, Any]:
        return {"name": name, "colour": colour, "x": _packed(x), "y": _packed(y)}

    return {
        "title": cloud.title, "x_label": cloud.x_label, "y_label": cloud.y_label, "joint": cloud.joint,
        "diagonal": cloud.diagonal, "curves": [curve(*x) for x in cloud.curves],
        "points": [curve(name, x[some], y[some], colour) for name, x, y, colour in cloud.points],
    }  # fmt: skip


def _packed(values: np.ndarray) -> dict[str, Any]:
    """In base64, little endian: 65535 steps between the lowest and the highest value, or float32 where so wide a range
    would leave too few of them for most values; what is not a number stays none."""
    values = np.asarray(values, float)
    fine = np.abs(values) < 3e38
    low, high = (float(f(values[fine])) for f in (np.min, np.max)) if fine.any() else (0.0, 0.0)
    usual = float(np.ptp(np.percentile(values[fine], [5, 95]))) if fine.any() else 0.0
    if high - low > WIDE * usual:
        made, step = np.where(fine, values, np.nan).astype("<f4"), 0.0
    else:
        step = (high - low) / 65534 or 1.0
        made = np.where(fine, np.round((np.where(fine, values, low) - low) / step), 65535).astype("<u2")
    return {"b": base64.b64encode(made.tobytes()).decode("ascii"), "low": low, "step": step}


def _number(value: float) -> float | None:
    return float(f"{value:.9g}") if math.isfinite(value) else None
