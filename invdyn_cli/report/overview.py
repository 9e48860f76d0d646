"""The summary figure of a diagnosis: errors before and after, the unexplained share, the worst joint over time."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from invdyn_cli.diagnosis.decide.wording import units_of
from invdyn_cli.report.canvas import (
    BLACK,
    GREY,
    INK,
    ORANGE,
    RESIDUAL,
    add_legend,
    blank_figure,
    name_joints,
    number_bars,
    plain,
    thinned,
)
from invdyn_cli.report.exhibits import telling_window, time_label
from invdyn_cli.report.tables import significant
from invdyn_cli.report.wording import joints_of
from invdyn_cli.types import Diagnosis

BEFORE, AFTER = GREY, RESIDUAL


def overview(diagnosis: Diagnosis) -> Figure:
    """Held-out error per joint before and after, what is still unexplained, and the worst joint's residual in time."""
    assert diagnosis.signals is not None
    joints, signals = joints_of(diagnosis), diagnosis.signals
    figure = blank_figure(6.2, "Improvement by the extended model, on held-out data", 11)
    grid = figure.add_gridspec(2, 2, width_ratios=(2.1, 1), height_ratios=(1.35, 1))
    bars, shares, time = (figure.add_subplot(grid[k]) for k in ((0, 0), (0, 1), (1, slice(None))))
    _error_bars(bars, diagnosis)
    where = np.arange(len(joints))
    share = 100 * np.array([diagnosis.unexplained.get(x, np.nan) for x in joints], float)
    shares.barh(where, np.nan_to_num(share), 0.62, color=ORANGE)
    for x, value in zip(where, share, strict=True):
        rms = diagnosis.extended.get(joints[x], {}).get("rmse", np.nan) * np.sqrt(max(value, 0) / 100)
        said = f"{value:.0f} %" + (f": {significant(rms)} {units_of(diagnosis)[joints[x]]}" if value > 0 else "")
        shares.annotate(
            said if np.isfinite(value) else "not assessed",
            (np.nan_to_num(value), x),
            xytext=(4, 0),
            textcoords="offset points",
            va="center",
        )
    shares.set_yticks(where, map(plain, joints))
    shares.invert_yaxis()
    shares.set_xlim(0, 160)
    shares.set_xticks([0, 25, 50, 75, 100])
    shares.grid(False, axis="y")
    shares.set_xlabel("predictable share of the residual [%], and its RMS")
    shares.set_title("unexplained: what a neural network predicts")
    name_joints(bars, joints, 75)
    worst = int(np.nanargmax(np.nan_to_num([diagnosis.baseline.get(x, {}).get("rmse", 0.0) for x in joints])))
    unit = units_of(diagnosis)[joints[worst]]
    rows = telling_window(signals, signals.tau - signals.nominal, [worst], length=15.0)
    t = signals.t[rows]
    before, after = ((signals.tau - x)[rows, worst] for x in (signals.nominal, signals.extended))
    time.axhline(0, color=INK, lw=0.8)
    time.plot(*thinned(t, before), color=BEFORE, lw=1.6, label="nominal model")
    time.plot(*thinned(t, after), color=AFTER, lw=1.2, label="extended model")
    time.margins(x=0.01)
    time.set_title(f"residual of {plain(joints[worst])}, the joint with the largest error")
    time.set_xlabel(time_label(signals, rows))
    time.set_ylabel(f"residual [{unit}]")
    add_legend(figure, bars)
    return figure


def _error_bars(axes: Axes, diagnosis: Diagnosis) -> None:
    joints, floor = joints_of(diagnosis), diagnosis.noise_floor or {}
    before, after, least = (
        np.array([x.get(j, {}).get("rmse", np.nan) for j in joints], float)
        for x in (diagnosis.baseline, diagnosis.extended, floor)
    )
    paired_bars(axes, (before, after), ("nominal model", "extended model"))
    if np.isfinite(least).any():
        where = np.arange(len(joints))
        axes.hlines(least, where - 0.42, where + 0.42, color=BLACK, lw=1.8, label="noise floor", zorder=3)
    axes.margins(y=0.12)
    axes.set_ylim(bottom=0)
    axes.grid(False, axis="x")
    axes.set_title("error of every joint")
    axes.set_ylabel(f"RMSE [{'; '.join(dict.fromkeys(units_of(diagnosis).values()))}]")


def paired_bars(axes: Axes, errors: tuple[np.ndarray, np.ndarray], labels: tuple[str, str]) -> None:
    """Two bars for every joint, its errors (n,) before and after, with their numbers."""
    for values, label, colour, side in zip(errors, labels, (BEFORE, AFTER), (-0.2, 0.2), strict=True):
        where = np.arange(len(values)) + side
        axes.bar(where, np.nan_to_num(values), 0.37, color=colour, label=label)
        number_bars(axes, where, values)
