"""The figures of a diagnosis: an overview, and one picture for every cause.

Black is the measurement minus the terms of the other effects; vermillion is the fitted term.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Annotation

from invdyn_cli.report import channel_laws, laws
from invdyn_cli.report.canvas import (
    BAND,
    GREY,
    INK,
    MEASURED,
    ORANGE,
    PREDICTED,
    SAMPLES,
    add_legend,
    blank_figure,
    house_style,
    label_below,
    panel_grid,
    plain,
    save_all,
    shape_of,
    thinned,
)
from invdyn_cli.report.exhibits import Exhibit, exhibits, recordings, telling_window, time_label
from invdyn_cli.report.overlay import OPENING, OVERLAY, opening, overlay
from invdyn_cli.report.overview import overview
from invdyn_cli.report.quantities import best_gain
from invdyn_cli.report.replay_figure import REPLAY, replay_figure
from invdyn_cli.report.residual_tests import RESIDUAL_TESTS, failing, tests_figure
from invdyn_cli.report.tables import significant
from invdyn_cli.report.wording import headline_of, picture, place, rivals_of, shortened, text_of, windows
from invdyn_cli.types import Diagnosis

OVERVIEW = "overview"

Panel = Callable[[Axes, Exhibit], None]
PANELS: dict[str, Panel] = {
    "velocity": laws.over_velocity,
    "near_standstill": laws.near_standstill,
    "slope_over_time": laws.slope_over_time,
    "shared_velocity": laws.over_shared_velocity,
    "load": laws.over_load,
    "loops_over_load": laws.loops_over_load,
    "loops_over_position": laws.loops_over_position,
    "position": laws.over_position,
    "angle": laws.over_angle,
    "angle_spectrum": laws.spectrum_over_angle,
    "acceleration": laws.over_acceleration,
    "nominal_torque": channel_laws.over_nominal,
    "torque_rate": channel_laws.over_rate,
    "time_shift": channel_laws.misfit_over_shift,
    "clipping": channel_laws.clipping,
}
"""What the picture of an effect may show (`AbstractEffect.panels`), at most two of them."""

MEDIANS = 150
"""Medians of the residual over a whole record."""

JOINTS = "joints"
"""The panel that shows all joints over time."""


def draw_all(
    diagnosis: Diagnosis, folder: str | Path, formats: Sequence[str] = ("png",), helper: Executor | None = None
) -> list[Path]:
    """Draw the opening, the overview, the torques, the replay, failed residual tests and every cause's picture into
    `folder`, once per format (png, svg, pdf); every other one in the process of `helper`, if there is one.

    The paths come back. Nothing is drawn without signals: a log that is unusable has nothing to show.
    """
    if helper is None:
        return _draw_some(diagnosis, Path(folder), formats)
    other = helper.submit(_draw_some, diagnosis, Path(folder), formats, slice(1, None, 2))
    written = _draw_some(diagnosis, Path(folder), formats, slice(0, None, 2))
    if other.exception() is None:
        return written + other.result()
    return written + _draw_some(diagnosis, Path(folder), formats, slice(1, None, 2))  # what hindered it may not be here


def _draw_some(diagnosis: Diagnosis, folder: Path, formats: Sequence[str], part: slice = slice(None)) -> list[Path]:
    """Draw this part of the figures."""
    written = []
    with house_style():
        for name, made in list(_figures(diagnosis).items())[part]:
            written += save_all(made(), folder, name, formats)
    return written


def _figures(diagnosis: Diagnosis) -> dict[str, Callable[[], Figure]]:
    """What there is to draw: name and figure."""
    made: dict[str, Callable[[], Figure]] = {}
    if diagnosis.signals is not None:
        made |= {OPENING: partial(opening, diagnosis), OVERVIEW: partial(overview, diagnosis)}
        made[OVERLAY] = partial(overlay, diagnosis)
    if diagnosis.replay is not None:
        made[REPLAY] = partial(replay_figure, diagnosis)
    if failing(diagnosis):
        made[RESIDUAL_TESTS] = partial(tests_figure, diagnosis)
    return made | {picture(x.number, x.finding): partial(draw, x) for x in exhibits(diagnosis)}


def draw(exhibit: Exhibit) -> Figure:
    """The picture of the effect; an effect without one is shown over time."""
    names = text_of(exhibit.finding).panels
    if JOINTS in names:
        return all_joints(exhibit)
    panels = [PANELS[name] for name in names if name in PANELS]
    return law_and_time(exhibit, panels[:2]) if panels else level(exhibit)


def law_and_time(exhibit: Exhibit, panels: Sequence[Panel]) -> Figure:
    """The law in one or two panels, and the stretch of time that shows it best: beside one panel, below two."""
    if len(panels) == 1:
        figure = _headed(exhibit, 4.3)
        left, time = figure.subplots(1, 2, width_ratios=(1, 1.35))
        above = [left]
    else:
        figure = _headed(exhibit, 6.4)
        grid = figure.add_gridspec(2, 2, height_ratios=(1.7, 1))
        above = [figure.add_subplot(grid[0, k]) for k in range(2)]
        time = figure.add_subplot(grid[1, :])
    for panel, axes in zip(panels, above, strict=True):
        panel(axes, exhibit)
    _stretch(time, exhibit)
    add_legend(figure, *above, time)
    return figure


def level(exhibit: Exhibit) -> Figure:
    """The whole record over time beside its distribution, and the telling stretch below: offsets, drifts, and what has
    no picture of its own."""
    figure = _headed(exhibit, 6.0)
    grid = figure.add_gridspec(2, 2, width_ratios=(3.2, 1), height_ratios=(1.4, 1))
    whole = figure.add_subplot(grid[0, 0])
    spread = figure.add_subplot(grid[0, 1], sharey=whole)
    y, term = exhibit.own(exhibit.residual), exhibit.own(exhibit.term)
    start = 0.0
    for rows in recordings(exhibit.signals):
        t = exhibit.signals.t[rows] - exhibit.signals.t[rows][0] + start
        some = slice(None, None, max(1, len(y) // 8000))
        whole.plot(t[some], y[rows][some], ".", color=SAMPLES, ms=2, mew=0, alpha=0.5, rasterized=True)
        parts = np.array_split(np.arange(len(t)), max(1, min(len(t), round(MEDIANS * len(t) / len(y)))))
        middle = [float(np.nanmedian(y[rows][x])) if np.isfinite(y[rows][x]).any() else np.nan for x in parts]
        whole.plot([t[x].mean() for x in parts], middle, ".", color=MEASURED, ms=4, label="median over time", zorder=3)
        whole.plot(*thinned(t, term[rows]), color=PREDICTED, lw=1.8, label=laws.TERM, zorder=2)
        if start:
            whole.axvline(start, color=GREY, lw=1, ls=":")
        name = plain(str(exhibit.signals.trajectory[rows.start]))
        whole.annotate(name, (start, 1.0), xycoords=("data", "axes fraction"), fontsize=7, va="bottom", color=INK)
        start = float(t[-1])
    fine = y[np.isfinite(y)]
    if len(fine):
        low, high = np.percentile(np.concatenate([fine, term[np.isfinite(term)]]), [0.2, 99.8])
        margin = 0.1 * (high - low) or 1.0
        whole.set_ylim(min(low, 0) - margin, max(high, 0) + margin)
        spread.hist(fine, bins=60, range=(low - margin, high + margin), orientation="horizontal", color=SAMPLES)
        spread.axhline(float(np.median(np.nan_to_num(term))), color=PREDICTED, lw=1.8)
    for axes in (whole, spread):
        axes.axhline(0, color=INK, lw=0.8)
    spread.tick_params(labelleft=False)
    spread.set_xlabel("samples")
    whole.margins(x=0.01)
    whole.set_xlabel("time, recordings one after another [s]")
    whole.set_ylabel(f"residual [{exhibit.unit}]")
    stretch = figure.add_subplot(grid[1, :])
    _stretch(stretch, exhibit)
    add_legend(figure, whole, stretch)
    return figure


def all_joints(exhibit: Exhibit) -> Figure:
    """Every joint over the stretch of time that shows most: one body must explain all of them."""
    n, signals, finding = len(exhibit.joints), exhibit.signals, exhibit.finding
    rows = telling_window(signals, exhibit.term, range(n), where=finding.trajectory, around=finding.window)
    figure = _headed(exhibit, 1.45 * shape_of(n)[0] + 1.5, "One cause, all joints at once.")
    panels = panel_grid(figure, n, sharex=True)
    t = signals.t[rows]
    widest = np.nanmax(np.ptp(np.nan_to_num(exhibit.term[rows]), axis=0), initial=0.0)
    for i, axes in enumerate(panels):
        _two_curves(axes, t, exhibit.residual[rows, i], exhibit.term[rows, i], widest / 25)
        _shade(axes, exhibit)
        gain = finding.gain.get(exhibit.joints[i])
        title = exhibit.joints[i]
        if gain:
            title += f"    RMSE {significant(gain.rmse_before)} → {significant(gain.rmse_after)} {exhibit.units[i]}"
        axes.set_title(plain(title))
        axes.set_ylabel(f"residual [{exhibit.units[i]}]")
        label_below(axes, time_label(signals, rows), i, n)
    add_legend(figure, panels[0])
    return figure


def _headed(exhibit: Exhibit, height: float, word: str = "") -> Figure:
    """An empty figure under the finding in words, with what it gains and what it means in a second line."""
    finding = exhibit.finding
    figure = blank_figure(height)
    figure.get_layout_engine().set(h_pad=0.06, w_pad=0.06)  # type: ignore[union-attr]
    headline = f"{place(finding)}: {headline_of(finding)}"
    meaning = text_of(finding).meaning
    if finding.status == "ambiguous":
        meaning = f"This log cannot distinguish it from {' or '.join(shortened(rivals_of(finding))) or 'others'}."
    shown = exhibit.joints[exhibit.column]
    gain, joint = "", shown if shown in finding.gain else best_gain(finding.gain)
    if joint is not None:
        one, other = (significant(x) for x in (finding.gain[joint].rmse_before, finding.gain[joint].rmse_after))
        unit = dict(zip(exhibit.joints, exhibit.units, strict=True)).get(joint, "N m")
        gain = f"Held-out RMSE of {joint} in motion: {one} → {other} {unit}."
    said = figure.suptitle(plain(fill(headline, 118)) + "\n ", x=0.01, ha="left", fontsize=11, fontweight="bold")
    under = plain(" ".join(x for x in (meaning, word, gain) if x))
    figure.add_artist(
        Annotation(under, (0, 0), xycoords=said, xytext=(0, 1), textcoords="offset points", fontsize=9, color=INK)
    )
    return figure


def _stretch(axes: Axes, exhibit: Exhibit) -> None:
    """Residual and term of the exhibit's joint in the window that shows most."""
    signals, finding = exhibit.signals, exhibit.finding
    rows = telling_window(signals, exhibit.term, [exhibit.column], where=finding.trajectory, around=finding.window)
    _two_curves(axes, signals.t[rows], exhibit.own(exhibit.residual)[rows], exhibit.own(exhibit.term)[rows])
    _shade(axes, exhibit)
    held = ", held out" if rows.stop > rows.start and signals.held_out[rows].all() else ""
    axes.set_title(f"over time{held}")
    axes.set_xlabel(time_label(signals, rows))
    axes.set_ylabel(f"residual [{exhibit.unit}]")


def _two_curves(axes: Axes, t: np.ndarray, y: np.ndarray, term: np.ndarray, least: float = 0.0) -> None:
    axes.axhline(0, color=INK, lw=0.8)
    axes.plot(*thinned(t, y), color=MEASURED, lw=1.0, label="residual without this effect")
    axes.plot(*thinned(t, term), color=PREDICTED, lw=1.8, alpha=0.9, label=laws.TERM)
    axes.margins(x=0.01)
    seen = np.concatenate([[0.0], y[np.isfinite(y)], term[np.isfinite(term)]])
    low, high = seen.min(), seen.max()
    lacking = max(0.0, least - (high - low)) / 2
    margin = 0.06 * (high - low + 2 * lacking) or 1.0
    axes.set_ylim(low - lacking - margin, high + lacking + margin)


def _shade(axes: Axes, exhibit: Exhibit) -> None:
    shown, label = axes.get_xlim(), "window of the finding"
    for window in windows(exhibit.finding):
        axes.axvspan(*window, color=ORANGE, alpha=BAND, lw=0, label=label, zorder=0)
        label = "_"  # one entry of the legend is enough
    axes.set_xlim(shown)
