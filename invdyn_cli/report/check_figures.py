"""The figures of a checked log: its clock, every channel with what is wrong marked where it is, measured over nominal
torque, and what the motion covers."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from invdyn_cli.diagnosis.checks.samples import gather, nominal_torque
from invdyn_cli.recording.stretches import Stretch, stretches
from invdyn_cli.report.canvas import (
    BLACK,
    BLUE,
    CLOUD_POINTS,
    GREY,
    LINE_POINTS,
    ORANGE,
    VERMILLION,
    add_legend,
    blank_figure,
    house_style,
    label_below,
    limit_around,
    log_axis,
    panel_grid,
    plain,
    save,
    shape_of,
    thinned,
)
from invdyn_cli.report.check_marks import draw_marks, draw_recordings
from invdyn_cli.report.checked_log import CheckedLog, joined
from invdyn_cli.report.tables import significant
from invdyn_cli.types import Motion

MANY = 0.02
"""Share of corrected values from which on the corrected curve is drawn; fewer are marked as samples."""

SHOWN = 20.0
"""[s] of measured and nominal torque over time."""

QUANTITIES = {"q": "position q", "qd": "velocity", "qdd": "acceleration", "tau": "torque"}


def draw_all(drawn: CheckedLog, folder: Path) -> tuple[list[Path], list[str]]:
    """Write the figures as png into `folder`: their paths, and a sentence for each that numbers did not allow."""
    drawings: dict[str, Callable[[], Figure | None]] = {"clock": lambda: clock(drawn)}
    drawings |= {name: lambda name=name: channel(drawn, name) for name in QUANTITIES}
    drawings |= {"model": lambda: model(drawn), "excitation": lambda: excitation(drawn)}
    paths, lacking = [], []
    with house_style(), np.errstate(all="ignore"):
        for name, drawing in drawings.items():
            try:
                figure = drawing()
                paths += [save(figure, folder / f"{name}.png")] if figure is not None else []
            except (ArithmeticError, ValueError, IndexError, np.linalg.LinAlgError) as error:
                lacking.append(f"The figure {name} could not be drawn from these numbers: {error}.")
    return paths, lacking


def clock(drawn: CheckedLog) -> Figure | None:
    """The steps of the clock as logged, a log axis where they differ much."""
    figure = blank_figure(2.3)
    axes = figure.subplots()
    every, scale = [], 1e3 if drawn.logged_unit("t", 0) == "s" else 1.0
    for raw, start in zip(drawn.log.trajectories, drawn.starts, strict=False):
        steps = np.diff(raw.t)
        rows = np.flatnonzero(np.isfinite(steps) & (np.abs(steps) < 1e10))
        every.append(steps[rows])
        axes.plot(*thinned(drawn.time[rows + start], scale * steps[rows]), ".-", color=BLACK, ms=2, lw=0.6,
                  label="step as logged")  # fmt: skip
    steps = np.concatenate([np.zeros(0), *every])
    if not len(steps):
        return None
    if steps.min() > 0 and steps.max() > 10 * np.median(steps):
        log_axis(axes)
    else:
        low, high = np.quantile(steps, [0.001, 0.999])
        middle = max(high - low, 0.1 * abs(float(np.median(steps))), 1e-9)
        least, most = max(low - 2 * middle, steps.min() - middle), min(high + 2 * middle, steps.max() + middle)
        axes.set_ylim(scale * least, scale * most)
    draw_marks(drawn, axes, "t", None)
    draw_recordings(drawn, axes, names=True)
    axes.set_ylabel("step of t [ms]" if scale > 1 else "step of t [as logged]")
    axes.set_xlabel(drawn.time_label)
    axes.margins(x=0.01)
    add_legend(figure, axes)
    return figure


def channel(drawn: CheckedLog, name: str) -> Figure | None:
    """A channel of every joint over time as logged, as corrected where that differs, and its marks."""
    joints = drawn.log.joints
    columns = [drawn.column(drawn.log, name, j) for j in range(len(joints))]
    if not any(columns):
        return None
    figure = blank_figure(1.6 * shape_of(len(joints))[0] + 0.8)
    panels = panel_grid(figure, len(joints), sharex=True)
    for j, axes in enumerate(panels):
        logged = columns[j]
        new = drawn.column(drawn.corrected, name, j)
        if name == "q":
            wrong = drawn.logged_unit("q_ref", j) == "as logged" != drawn.logged_unit("q", j)
            which, word = (drawn.corrected, "corrected") if wrong else (drawn.log, "logged")
            _lines(drawn, axes, drawn.column(which, "q_ref", j), ORANGE, f"q_ref as {word}", 1.0, (0, (4, 1.5)))
        _lines(drawn, axes, logged, BLACK, f"{name} as logged")
        share, comparable = drawn.corrected_share(name, j)
        base = new if share and comparable else logged
        if share > MANY and comparable:
            _lines(drawn, axes, new, BLUE, f"{name} as corrected", 0.9)
        limit_around(axes, joined(base)[1], joined(logged)[1], 1e-6)
        axes.set_title(plain(joints[j]))
        axes.set_ylabel(f"{QUANTITIES[name]} [{drawn.logged_unit(name, j)}]")
        axes.margins(x=0.01)
        draw_recordings(drawn, axes)
        draw_marks(drawn, axes, name, j, logged)
        label_below(axes, drawn.time_label, j, len(joints))
    add_legend(figure, *panels)
    return figure


def model(drawn: CheckedLog) -> Figure | None:
    """Measured and nominal torque of every joint: a stretch of the corrected log over time, and measured over nominal
    torque of all rows, as logged and as corrected."""
    robot = drawn.robot
    after = gather(drawn.corrected, robot) if robot is not None and drawn.corrected.trajectories else None
    if robot is None or after is None:
        return None
    changed = any(drawn.corrected_share(c, j)[0] for c in ("q", "tau") for j in range(robot.dofs))
    before = gather(drawn.log, robot) if changed else None
    part, shown = _liveliest(after.stretches)
    nominal, gravity = nominal_torque(robot, Motion(part.q[shown], part.qd[shown], part.qdd[shown]))
    nominal = nominal - gravity if "gravity" in drawn.corrected.compensated else nominal
    t = np.arange(len(nominal)) / part.rate
    figure = blank_figure(1.6 * robot.dofs + 0.8)
    grid = figure.subplots(robot.dofs, 2, squeeze=False, width_ratios=[3, 1])
    every = slice(None, None, max(1, len(after.tau) // (CLOUD_POINTS // 2)))
    for j, (left, right) in enumerate(grid):
        unit = drawn.torque_unit(j)
        label = "measured, as corrected" if changed else "measured"
        left.plot(*thinned(t, part.tau[shown, j]), color=BLACK, lw=1.4, label=label)
        left.plot(*thinned(t, nominal[:, j]), color=VERMILLION, lw=1.2, ls=(0, (4, 1.5)), label="URDF's model")
        errors = [np.sqrt(np.mean((x.tau[:, j] - x.nominal[:, j]) ** 2)) for x in (before, after) if x is not None]
        said = " as logged → ".join(dict.fromkeys(map(significant, errors)))
        said = f"{drawn.log.joints[j]}    RMS difference {said} {unit}" + " as corrected" * ("→" in said)
        left.set_title(plain(said))
        left.set_ylabel(f"torque [{unit}]")
        left.margins(x=0.01)
        if before is not None:
            right.plot(before.nominal[every, j], before.tau[every, j], ".", color=ORANGE, ms=2, label="as logged")
        right.plot(after.nominal[every, j], after.tau[every, j], ".", color=BLUE, ms=2,
                   label="as corrected" if changed else "every row")  # fmt: skip
        low, high = (f(np.concatenate([after.nominal[:, j], after.tau[:, j]])) for f in (np.min, np.max))
        margin = 0.08 * (high - low) or 1.0
        right.plot([low, high], [low, high], color=GREY, lw=1.0, zorder=0, label="measured = model")
        right.set(xlim=(low - margin, high + margin), ylim=(low - margin, high + margin))
        right.set_ylabel(f"measured torque [{unit}]")
        last = j == robot.dofs - 1
        left.set_xlabel(f"time in a stretch of {plain(part.trajectory)} [s]" if last else "")
        right.set_xlabel(f"URDF's model [{unit}]" if last else "")
        left.tick_params(labelbottom=last)
    add_legend(figure, *grid.flat)
    return figure


def excitation(drawn: CheckedLog) -> Figure | None:
    """Velocity over position of every joint, with the robot's limits."""
    parts = stretches(drawn.corrected) if drawn.corrected.trajectories else ()
    if not parts:
        return None
    q, qd = (np.concatenate([getattr(x, c) for x in parts]) for c in ("q", "qd"))
    every = slice(None, None, max(1, len(q) // CLOUD_POINTS))
    joints = drawn.log.joints
    figure = blank_figure(1.6 * shape_of(len(joints))[0] + 0.8)
    panels = panel_grid(figure, len(joints))
    for j, axes in enumerate(panels):
        axes.plot(q[every, j], qd[every, j], ".", color=BLUE, ms=1.5, label="visited")
        robot = drawn.robot
        if robot is not None:
            for limit in (robot.lower[j], robot.upper[j]):
                if np.isfinite(limit):
                    axes.axvline(float(limit), color=VERMILLION, ls="--", lw=1.0, label="limit of the URDF")
        axes.axhline(0.0, color=GREY, lw=0.6)
        axes.set_title(plain(joints[j]))
        axes.set_xlabel(f"position q [{drawn.unit('q', j)}]")
        axes.set_ylabel(f"velocity [{drawn.unit('qd', j)}]")
    add_legend(figure, *panels)
    return figure


def _liveliest(parts: Sequence[Stretch]) -> tuple[Stretch, slice]:
    """The stretch and the SHOWN seconds of it in which the joints move most, each beside its own fastest."""
    fastest = np.maximum(np.max([np.abs(x.qd).max(axis=0) for x in parts], axis=0), 1e-12)
    tried = []
    for k, x in enumerate(parts):
        length = max(1, int(SHOWN * x.rate))
        for start in range(0, max(1, len(x.q) - length // 2), length):
            moves = np.sum(np.abs(x.qd[start : start + length]) / fastest)
            tried.append((moves / x.rate, -k, start, length))
    _, k, start, length = max(tried)
    return parts[-k], slice(start, start + length)


def _lines(
    drawn: CheckedLog, axes: Axes, pieces: Sequence, colour: str, label: str, width: float = 1.0, style=None
) -> None:
    """The stretches of a channel as lines, thinned together, peaks kept."""
    if not pieces:
        return
    most = max(8, LINE_POINTS // len(pieces))
    thin = [thinned(drawn.time[rows], y, most) for rows, y in pieces]
    x, y = (np.concatenate([part for one in thin for part in (one[k], [np.nan])]) for k in (0, 1))
    axes.plot(x, y, color=colour, lw=width, ls=style or "-", label=label)
