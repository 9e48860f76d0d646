"""Panels that show the law of an effect: the residual without it, over the quantity that drives it.

In all of them the points are samples (sky blue), their medians in bins (black) and the fitted term (vermillion), which
went through the same filter. A panel takes its axes and an exhibit.
"""

import math

import numpy as np
import scipy
from matplotlib.axes import Axes

from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.interfaces import AbstractTorqueEffect, JointState
from invdyn_cli.report.canvas import (
    BAND,
    CLOUD_POINTS,
    GREY,
    INK,
    MEASURED,
    PREDICTED,
    SAMPLES,
    binned,
    plain,
)
from invdyn_cli.report.exhibits import Exhibit, recordings, telling_window
from invdyn_cli.report.tables import position_unit
from invdyn_cli.types import Finding

CLOUD, MEDIAN, TERM = "samples", "median of a bin, bar from 10 to 90 %", "fitted term"
PERIODS = 6
"""Number of periods of a ripple that are shown."""
SLOPES = 15
"""Windows of time in which a recording's drag is measured."""
SPECTRUM_ROWS, SPECTRUM_LINES = 6000, 700
"""Rows from which a spectrum over the angle is computed, and its lines."""


def over_velocity(axes: Axes, exhibit: Exhibit) -> None:
    """Over the joint's own velocity, where it moves: a step is Coulomb friction, a slope viscous friction."""
    y, term = exhibit.own(exhibit.residual, moving=True), exhibit.own(exhibit.term)
    law(axes, exhibit.own(exhibit.signals.qd), y, term, split=True)
    axes.set_title("over velocity")
    name_axes(axes, exhibit, f"velocity of {joint_name(exhibit)} [{rate_unit(exhibit)}]")


def near_standstill(axes: Axes, exhibit: Exhibit) -> None:
    """The same, zoomed to slow motion; dashed is the law of Stribeck friction itself, before the filter rounds it
    off."""
    qd, y = exhibit.own(exhibit.signals.qd), exhibit.own(exhibit.residual, moving=True)
    reach = 6 * abs(scalar(exhibit.finding, "velocity", 0.05))
    near = np.abs(qd) < reach
    law(axes, qd[near], y[near], exhibit.own(exhibit.term)[near], split=True, fewest=5)
    v = np.linspace(1e-4 * reach, reach, 200)
    if (height := by_its_law(exhibit.finding, 0 * v, v)) is not None:
        for sign in (-1, 1):
            axes.plot(sign * v, sign * height, color=PREDICTED, lw=1.1, ls="--", label="the law, unfiltered")
    axes.set_xlim(-reach, reach)
    axes.set_title("near standstill")
    name_axes(axes, exhibit, f"velocity of {joint_name(exhibit)} [{rate_unit(exhibit)}]")


def over_shared_velocity(axes: Axes, exhibit: Exhibit) -> None:
    """Over the velocity of a drive that the joint before also turns: there the scatter over the joint's own velocity
    becomes a line."""
    driver, ratio = exhibit.finding.parameters.get("driver"), scalar(exhibit.finding, "ratio", 0.0)
    name = str(driver.value) if driver is not None and driver.value in exhibit.joints else ""
    other = exhibit.signals.qd[:, exhibit.joints.index(name)] if name else 0.0
    y, term = exhibit.own(exhibit.residual, moving=True), exhibit.own(exhibit.term)
    law(axes, exhibit.own(exhibit.signals.qd) + ratio * other, y, term, split=True)
    axes.set_title("over the drive's velocity")
    shown = f"{ratio:+.3g} × that of {plain(name)}".replace("+", "+ ").replace("-", "− ")
    name_axes(axes, exhibit, f"velocity of {joint_name(exhibit)} {shown} [{rate_unit(exhibit)}]")


def over_load(axes: Axes, exhibit: Exhibit) -> None:
    """The part against the motion, over the size of the torque that the gear carries."""
    sign = np.sign(exhibit.own(exhibit.signals.qd))
    load = np.abs(exhibit.own(exhibit.signals.nominal))
    y = sign * exhibit.own(exhibit.residual, moving=True)
    law(axes, load, y, sign * exhibit.own(exhibit.term, moving=True))
    axes.set_title("against the motion, over the load")
    name_axes(axes, exhibit, f"|nominal torque| [{exhibit.unit}]", y="residual · sign(velocity)")


def slope_over_time(axes: Axes, exhibit: Exhibit) -> None:
    """Slope of residual over velocity in SLOPES windows of time: a viscous friction as it warms up."""
    t = exhibit.signals.t
    qd, y, term = exhibit.own(exhibit.signals.qd, moving=True), exhibit.own(exhibit.residual), exhibit.own(exhibit.term)
    points = []
    for rows in recordings(exhibit.signals):
        for part in np.array_split(np.arange(rows.start, rows.stop), SLOPES):
            use = part[np.isfinite(qd[part] + y[part] + term[part])]
            if len(use) > 10:
                power = np.sum(qd[use] ** 2)
                points.append([t[use].mean(), np.sum(y[use] * qd[use]) / power, np.sum(term[use] * qd[use]) / power])
    when, measured, fitted = np.array(sorted(points)).reshape(-1, 3).T
    axes.plot(when, measured, "o", color=MEASURED, ms=3.5, mew=0, label="slope in a window of time")
    first, last = (when[0], when[-1]) if len(when) else (0.0, 0.0)
    evenly = np.linspace(first, last, 200)
    if len(when) and (law := by_its_law(exhibit.finding, evenly, np.ones(200))) is not None:
        when, fitted = evenly, law
        axes.axhline(scalar(exhibit.finding, "warm"), color=GREY, lw=1, ls=":", label="warm")
    axes.plot(when, fitted, color=PREDICTED, lw=2.2, zorder=1.5, label=TERM)
    axes.set_ylim(min(0, *axes.get_ylim()))
    axes.set_title("drag over time")
    axes.set_xlabel("time [s]")
    axes.set_ylabel(f"residual / velocity [{exhibit.unit} / ({rate_unit(exhibit)})]")


def over_position(axes: Axes, exhibit: Exhibit) -> None:
    """Over the joint's own position: a spring is a line, an encoder offset a part of the gravity curve."""
    law(axes, exhibit.own(exhibit.signals.q), exhibit.own(exhibit.residual), exhibit.own(exhibit.term))
    axes.set_title("over position")
    name_axes(axes, exhibit, f"position of {joint_name(exhibit)} [{angle_unit(exhibit)}]")


def loops_over_position(axes: Axes, exhibit: Exhibit) -> None:
    """Over the joint's own position, as time goes on: effects with a memory form loops."""
    _loops(axes, exhibit, exhibit.own(exhibit.signals.q))
    axes.set_title("over position, as time goes on")
    name_axes(axes, exhibit, f"position of {joint_name(exhibit)} [{angle_unit(exhibit)}]")


def loops_over_load(axes: Axes, exhibit: Exhibit) -> None:
    """Over the torque that the gear carries, as time goes on: play shows where the load changes sign."""
    _loops(axes, exhibit, exhibit.own(exhibit.signals.nominal))
    axes.set_title("over the load, as time goes on")
    axes.axvline(0, color=INK, lw=0.8)
    name_axes(axes, exhibit, f"nominal torque of {joint_name(exhibit)} [{exhibit.unit}]")


def _loops(axes: Axes, exhibit: Exhibit, x: np.ndarray) -> None:
    """Residual and term over x (R,), in the stretch of time that tells most."""
    rows = telling_window(exhibit.signals, exhibit.term, [exhibit.column])
    y, term = exhibit.own(exhibit.residual)[rows], exhibit.own(exhibit.term)[rows]
    cloud(axes, x[rows], y, SAMPLES, CLOUD)
    axes.axhline(0, color=INK, lw=0.8)
    axes.plot(x[rows], term, color=PREDICTED, lw=1.2, label=TERM)
    axes.margins(x=0.02)


def over_acceleration(axes: Axes, exhibit: Exhibit) -> None:
    """Over the joint's own acceleration: a rotor's inertia is a line."""
    law(axes, exhibit.own(exhibit.signals.qdd), exhibit.own(exhibit.residual), exhibit.own(exhibit.term))
    axes.set_title("over acceleration")
    name_axes(axes, exhibit, f"acceleration of {joint_name(exhibit)} [{angle_unit(exhibit)}/s²]")


def over_angle(axes: Axes, exhibit: Exhibit) -> None:
    """Over the joint's angle, a few periods where most samples are."""
    q, y, term = exhibit.own(exhibit.signals.q), exhibit.own(exhibit.residual), exhibit.own(exhibit.term)
    cycles = scalar(exhibit.finding, "cycles", 1.0)
    reach = PERIODS / 2 * 2 * np.pi / abs(cycles)
    near = np.abs(q - np.nanmedian(q)) < reach
    law(axes, q[near], y[near], term[near], bins=12 * PERIODS)
    shown = f"{PERIODS} of its periods" if (~near).any() else "all of it"
    axes.set_title(f"over the angle, {shown}")
    name_axes(axes, exhibit, f"angle of {joint_name(exhibit)} [{angle_unit(exhibit)}]")


def spectrum_over_angle(axes: Axes, exhibit: Exhibit) -> None:
    """Amplitude over cycles per revolution (Lomb-Scargle, for angles that are not evenly spaced), the line marked."""
    q, y = exhibit.own(exhibit.signals.q), exhibit.own(exhibit.residual)
    use = np.flatnonzero(np.isfinite(q + y))
    use = use[:: max(1, len(use) // SPECTRUM_ROWS)]
    span = np.ptp(q[use]) / (2 * np.pi) if len(use) else 0.0
    cycles = scalar(exhibit.finding, "cycles", 1.0)
    if span > 0:
        highest = max(2.2 * abs(cycles), 10.0)
        found = np.linspace(min(0.5 / span, 0.5 * highest), highest, SPECTRUM_LINES)
        power = scipy.signal.lombscargle(q[use], y[use] - y[use].mean(), found)
        axes.plot(found, 2 * np.sqrt(np.maximum(power, 0) / len(use)), color=MEASURED, lw=1.2)
        axes.set_xlim(0, highest)
    axes.axvline(cycles, color=PREDICTED, lw=2.2, alpha=0.35, zorder=0)
    axes.set_ylim(bottom=0)
    mark(axes, cycles, f"{cycles:.4g} / rev")
    axes.set_title("spectrum over the angle")
    name_axes(axes, exhibit, "cycles per revolution [1/rev]", y="amplitude")


def law(
    axes: Axes, x: np.ndarray, y: np.ndarray, term: np.ndarray, *, split=False, bins: int = 40, fewest: int = 10
) -> None:
    """Samples (x, y), medians of y in bins of x, and of the term, in finer ones where x alone decides it; `split`: in
    two parts about zero."""
    fine = np.isfinite(x + y + term)
    x, y, term = x[fine], y[fine], term[fine]
    cloud(axes, x, y, SAMPLES, CLOUD)
    axes.axhline(0, color=INK, lw=0.8)
    centre, low, middle, high = binned(x, y, bins, fewest)
    full = np.isfinite(middle)
    where, lowest, fitted, highest = binned(x, term, 4 * bins, max(3, fewest // 3))
    if not np.isfinite(fitted).any() or np.nanmedian(highest - lowest) > 0.02 * np.ptp(term):
        where, _, fitted, _ = binned(x, term, bins, fewest)
    for part in (where < 0, where > 0) if split else (np.ones(len(where), bool),):
        part = part & np.isfinite(fitted)
        axes.plot(where[part], fitted[part], color="white", lw=4.2, alpha=0.9)
        axes.plot(where[part], fitted[part], color=PREDICTED, lw=2.4, label=TERM)
    axes.vlines(centre[full], low[full], high[full], color=MEASURED, lw=0.8, alpha=2 * BAND, zorder=3)
    axes.plot(centre[full], middle[full], "o", color=MEASURED, ms=3.6, mec="white", mew=0.5, label=MEDIAN, zorder=4)
    if len(y):
        seen = np.concatenate([np.percentile(y, [0.3, 99.7]), term, [0.0]])
        margin = 0.08 * np.ptp(seen) or 1.0
        axes.set_ylim(seen.min() - margin, seen.max() + margin)
        axes.margins(x=0.02)


def scalar(finding: Finding, name: str, missing: float = math.nan) -> float:
    """A parameter that is a single finite number; `missing` where there is none."""
    value = finding.parameters[name].value if name in finding.parameters else None
    if not isinstance(value, int | float | np.number) or not np.isfinite(value):
        return missing
    return float(value)


def cloud(axes: Axes, x: np.ndarray, y: np.ndarray, colour: str, label: str) -> None:
    some = slice(None, None, max(1, -(-len(x) // CLOUD_POINTS)))
    axes.plot(x[some], y[some], ".", color=colour, ms=2.6, mew=0, alpha=0.55, rasterized=True, label=label)


def mark(axes: Axes, x: float, text: str) -> None:
    """A word beside a vertical line, at the top of the panel."""
    axes.annotate(
        text,
        (x, 0.97),
        xycoords=("data", "axes fraction"),
        xytext=(5, 0),
        textcoords="offset points",
        va="top",
        color=PREDICTED,
        fontweight="bold",
    )


def by_its_law(finding: Finding, t: np.ndarray, qd: np.ndarray) -> np.ndarray | None:
    """Torque (T,) [N m; N] of a finding's effect at times and positive velocities (T,), by its own law; None where that
    or a parameter is not known."""
    effect = EFFECTS.get(finding.effect)
    if not isinstance(effect, AbstractTorqueEffect):
        return None
    sizes = {name: scalar(finding, name, effect.defaults.get(name, np.nan)) for name in effect.parameters}
    state = JointState(t, 0 * t, qd, 0 * t, np.ones_like(qd), 0 * t)
    return np.asarray(effect.term(sizes, state)) if np.all(np.isfinite(list(sizes.values()))) else None


def name_axes(axes: Axes, exhibit: Exhibit, x: str, y: str = "residual") -> None:
    axes.set_xlabel(x)
    axes.set_ylabel(f"{y} [{exhibit.unit}]")


def joint_name(exhibit: Exhibit) -> str:
    return plain(exhibit.joints[exhibit.column])


def angle_unit(exhibit: Exhibit) -> str:
    return position_unit(exhibit.unit)


def rate_unit(exhibit: Exhibit) -> str:
    return f"{angle_unit(exhibit)}/s"
