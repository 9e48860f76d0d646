"""The figures of one run: torques, errors, loss, residual over velocity, singular values.

Each drawing takes a RunRecord and gives a matplotlib Figure, or None where the record has nothing to show. Only the
object interface of matplotlib is used, so that no state outlives a call.
"""

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from invdyn_cli.maths.metrics import ACCURATE
from invdyn_cli.report.adapted import adaptation
from invdyn_cli.report.canvas import (
    BAND,
    BLACK,
    CLOUD_POINTS,
    DROPPED,
    GREY,
    INK,
    KEPT,
    LINE_POINTS,
    MEASURED,
    OTHER_SETS,
    PREDICTED,
    RESIDUAL,
    SAMPLES,
    SET_COLOURS,
    add_legend,
    binned,
    house_style,
    label_below,
    limit_around,
    limit_bars,
    limit_zero,
    log_axis,
    name_joints,
    panel_grid,
    plain,
    save_all,
    shape_of,
    thinned,
    titled_figure,
)
from invdyn_cli.report.tables import position_unit, scored_sets, significant, units
from invdyn_cli.types import Prediction, RunRecord


def draw_all(record: RunRecord, folder: str | Path, formats: Sequence[str] = ("png",)) -> list[Path]:
    """Draw every figure that the record has data for into `folder`, once per format (png, svg, pdf): their paths."""
    written = []
    with house_style():
        for name, drawing in DRAWINGS.items():
            if (figure := drawing(record)) is not None:
                written += save_all(figure, Path(folder), name, formats)
    return written


def torques(record: RunRecord, *, longest: float = 20.0, most: int = 2) -> Figure | None:
    """Measured and predicted torque of every joint over time, the residual below it.

    What is shown is the beginning of the test set: at most `longest` seconds of at most `most` trajectories.
    """
    shown = _beginning(record.predictions["test"], longest, most) if "test" in record.predictions else []
    if not shown:
        return None
    every = record.predictions["test"].data.trajectories
    title = "test set, " + " and ".join(name for name, *_ in shown)
    title += f" ({len(shown)} of {len(every)} trajectories)" if len(every) > len(shown) else ""
    title += f", first {longest:g} s" if len(shown[0][1]) < len(every[0].t) else ""
    joints = record.fit.joints
    rows, columns = shape_of(len(joints))
    figure = titled_figure(record, title, 2.2 * rows + 0.9)
    figure.set_layout_engine("constrained", h_pad=0.03, hspace=0)
    grid = figure.subplots(2 * rows, columns, squeeze=False, sharex=True, height_ratios=(3, 1) * rows)
    for i, (joint, unit) in enumerate(zip(joints, units(record), strict=True)):
        row, column = divmod(i, columns)
        above, below = grid[2 * row, column], grid[2 * row + 1, column]
        start = 0.0
        for _, t, measured, predicted in shown:
            above.plot(*thinned(start + t, measured[:, i]), color=MEASURED, lw=1.8, label="measured")
            above.plot(*thinned(start + t, predicted[:, i]), color=PREDICTED, lw=0.9, label="predicted")
            residual = measured[:, i] - predicted[:, i]
            below.plot(*thinned(start + t, residual), color=RESIDUAL, lw=0.7, label="residual: measured - predicted")
            for axes in (above, below) if start else ():
                axes.axvline(start, color=GREY, lw=1.0, ls=":")
            start += t[-1]
        measured = np.concatenate([y[:, i] for _, _, y, _ in shown])
        predicted = np.concatenate([y[:, i] for _, _, _, y in shown])
        limit_around(above, measured, predicted)
        limit_zero(below, measured - predicted)
        above.set_title(_joint_title(record, i, joint, unit))
        above.set_ylabel(f"torque [{unit}]")
        below.set_ylabel(f"residual\n[{unit}]")
        above.spines.bottom.set_visible(False)
        above.tick_params(bottom=False)
        above.xaxis.set_in_layout(False)
        below.margins(x=0.01)
        label_below(below, "time [s]", i, len(joints))
    for axes in grid[-2:, (len(joints) - 1) % columns + 1 :].flat:
        axes.remove()
    add_legend(figure, *grid[:2, 0])
    return figure


def errors(record: RunRecord) -> Figure | None:
    """NMSE of every joint as dots on a log axis, RMSE as bars from zero, a colour for each scored set; small dots are
    the members of a fit of several."""
    names = scored_sets(record)
    if not names:
        return None
    joints = record.fit.joints
    figure = titled_figure(record, "errors of every scored set", 5.4)
    upper, lower = figure.subplots(2, 1, sharex=True)
    other = iter(OTHER_SETS * len(names))
    width = 0.8 / len(names)
    for k, name in enumerate(names):
        colour = SET_COLOURS.get(name) or next(other)
        where = np.arange(len(joints)) + (k - (len(names) - 1) / 2) * width
        members = record.member_scores.get(name, ())
        for axes, kind in ((upper, "nmse"), (lower, "rmse")):
            values = np.asarray(getattr(record.scores[name], kind), float)
            still = np.isnan(values) & np.isfinite(record.scores[name].rmse)
            if axes is lower:
                axes.bar(where, np.where(np.isfinite(values), values, 0), 0.92 * width, color=colour, label=plain(name))
            else:
                axes.plot(where, np.where(values > 0, values, np.nan), "o", ms=8, color=colour, label=plain(name))
            for member in members if len(members) > 1 else ():
                axes.plot(where, getattr(member, kind), ".", color=BLACK, ms=3, label="one member")
            for x, value, constant in zip(where, values, still, strict=True):
                if not np.isfinite(value) or value == 0:
                    word = "no variance" if constant else "NaN" if np.isnan(value) else f"{value:g}"
                    at = axes.get_xaxis_transform()
                    axes.text(
                        x, 0.03, word, transform=at, rotation=90, ha="center", va="bottom", fontsize=7, color=colour
                    )
    every = np.concatenate([np.asarray(record.scores[name].nmse, float) for name in names])
    limit_bars(upper, every, ACCURATE)
    upper.axhline(ACCURATE, color=BLACK, lw=1.0, ls="--", label=f"the paper's line, NMSE {ACCURATE}")
    upper.set_ylabel("NMSE")
    lower.set_ylim(bottom=0)
    lower.set_ylabel(f"RMSE [{'; '.join(dict.fromkeys(units(record)))}]")
    name_joints(lower, joints, 130)
    room = max(0.6, 2 - len(joints) / 2)
    lower.set_xlim(-room, len(joints) - 1 + room)
    for axes in (upper, lower):
        axes.grid(False, axis="x")
    figure.align_ylabels()
    add_legend(figure, upper)
    return figure


def loss(record: RunRecord) -> Figure | None:
    """Train and validation loss of every joint over epochs: the members' mean, and a band over all of them."""
    curves = {x: np.asarray(record.fit.history.get(f"{x}_loss", ()), float) for x in ("train", "validation")}
    curves = {name: curve for name, curve in curves.items() if curve.size}
    if not curves:
        return None
    joints = record.fit.joints
    panels = max(curve.shape[2] for curve in curves.values())
    figure = titled_figure(record, "loss while learning", 1.8 * shape_of(panels)[0] + 0.9)
    grid = panel_grid(figure, panels, sharex=True)
    for i, axes in enumerate(grid):
        for name, curve in curves.items():
            step = max(1, len(curve) // LINE_POINTS)
            values = np.ma.masked_invalid(curve[::step, :, i])
            values = np.ma.masked_less_equal(values, 0)
            epochs = 1 + step * np.arange(len(values))
            if curve.shape[1] > 1:
                low, high = (x.filled(np.nan) for x in (values.min(axis=1), values.max(axis=1)))
                axes.fill_between(epochs, low, high, color=SET_COLOURS[name], alpha=BAND, lw=0)
            mark = "." if len(epochs) < 3 else None
            axes.plot(epochs, values.mean(axis=1).filled(np.nan), marker=mark, color=SET_COLOURS[name], label=name)
        axes.set_title(plain(joints[i]) if panels == len(joints) else "")
        axes.set_ylabel("loss")
        log_axis(axes)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        label_below(axes, "epoch", i, panels)
    add_legend(figure, grid[0])
    return figure


def residual_velocity(record: RunRecord) -> Figure | None:
    """Residual of every joint over its own velocity on the test set: where friction shows."""
    if "test" not in record.predictions or not record.predictions["test"].data.samples:
        return None
    judged = record.predictions["test"]
    residual = judged.data.tau - judged.tau
    velocity = np.asarray(judged.data.motion.qd)
    joints = record.fit.joints
    figure = titled_figure(record, "residual over velocity, test set", 2.0 * shape_of(len(joints))[0] + 0.9)
    panels = panel_grid(figure, len(joints))
    for i, (axes, joint, unit) in enumerate(zip(panels, joints, units(record), strict=True)):
        finite = np.isfinite(residual[:, i]) & np.isfinite(velocity[:, i])
        x, y = velocity[finite, i], residual[finite, i]
        some = slice(None, None, max(1, math.ceil(len(x) / CLOUD_POINTS)))
        size = 2 if len(x[some]) > 1500 else 4
        axes.plot(x[some], y[some], ".", color=SAMPLES, ms=size, mew=0, alpha=0.6, rasterized=True, label="samples")
        axes.axhline(0, color=INK, lw=0.8)
        centre, low, middle, high = binned(x, y)
        outline = [withStroke(linewidth=3, foreground="white")]
        for side in (centre < 0, centre > 0):
            axes.fill_between(
                centre[side], low[side], high[side], color=RESIDUAL, alpha=BAND, lw=0, label="10 to 90 % of a bin"
            )
            axes.plot(centre[side], middle[side], color=RESIDUAL, lw=1.7, path_effects=outline, label="median of a bin")
        if len(y):
            limit_zero(axes, np.percentile(y, [0.2, 99.8]))
        axes.set_title(_joint_title(record, i, joint, unit))
        axes.set_ylabel(f"residual [{unit}]")
        label_below(axes, f"velocity [{position_unit(unit)}/s]", i, len(joints), shared=False)
    add_legend(figure, panels[0])
    return figure


def singular_values(record: RunRecord) -> Figure | None:
    """Singular values of the regressor, largest first: which directions of the parameters the data determine."""
    if not {"singular_values", "threshold"} <= set(record.fit.details):
        return None
    values = np.atleast_1d(np.asarray(record.fit.details["singular_values"], float))
    threshold = float(record.fit.details["threshold"])
    order, kept = np.arange(1, len(values) + 1), values > threshold
    visible = values[values > 0]
    floor = 0.3 * min([threshold or math.inf, *visible], default=1.0)
    figure = titled_figure(record, f"singular values of the regressor: {kept.sum()} of {len(values)} kept", 3.4)
    axes = figure.subplots()
    for chosen, colour, mark, label in ((kept, KEPT, "o", "kept"), (~kept, DROPPED, "x", "dropped")):
        if not chosen.any():
            continue
        height = np.maximum(values[chosen], floor)
        axes.vlines(order[chosen], floor, height, color=colour, lw=0.8, alpha=0.6)
        axes.plot(order[chosen], height, mark, color=colour, ms=4, label=label)
    if threshold > 0:
        axes.axhline(threshold, color=BLACK, lw=1.0, ls="--", label=f"threshold {threshold:.3g}")
    log_axis(axes)
    axes.set_ylim(bottom=floor)
    axes.margins(x=0.02)
    axes.set_xlabel("index")
    axes.set_ylabel("singular value")
    add_legend(figure, axes)
    return figure


DRAWINGS: dict[str, Callable[[RunRecord], Figure | None]] = {
    "torques": torques,
    "errors": errors,
    "loss": loss,
    "adaptation": adaptation,
    "residual_velocity": residual_velocity,
    "singular_values": singular_values,
}


def _beginning(judged: Prediction, longest: float, most: int) -> list[tuple[str, np.ndarray, np.ndarray, np.ndarray]]:
    """The first trajectories, up to `longest` seconds in total: name, t (T,) from 0, measured and predicted (T, n)."""
    shown, left, row = [], longest, 0
    for x in judged.data.trajectories[:most]:
        t = np.asarray(x.t) - (x.t[0] if len(x.t) else 0.0)
        if shown and t[-1:].sum() > left:
            break
        keep = int(np.searchsorted(t, left, side="right"))
        if keep:
            shown.append((x.name, t[:keep], np.asarray(x.tau)[:keep], judged.tau[row : row + keep]))
        left, row = left - t[-1:].sum(), row + len(t)
    return shown


def _joint_title(record: RunRecord, i: int, joint: str, unit: str) -> str:
    """The joint's name with its error on the whole test set, in two lines where a panel is too narrow for one."""
    score = record.scores.get("test")
    if score is None:
        return plain(joint)
    error = f"NMSE {significant(score.nmse[i])}, RMSE {significant(score.rmse[i])} {unit}"
    _, columns = shape_of(len(record.fit.joints))
    narrow = max(map(len, record.fit.joints)) + 30 > 150 / columns
    return plain(joint) + ("\n" if narrow else "    ") + error
