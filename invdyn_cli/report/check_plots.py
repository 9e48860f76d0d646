"""The interactive plots of a checked log: every channel of every joint with its defects, and measured torque beside
that of the URDF's model."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invdyn_cli.diagnosis.checks.samples import gather
from invdyn_cli.report.check_figures import MANY, QUANTITIES
from invdyn_cli.report.check_marks import LOOKS, MOST_MARKS, longest_gaps, spans
from invdyn_cli.report.checked_log import CheckedLog
from invdyn_cli.report.interactive import Cloud, Line, Mark, Panel, Timeline, plots
from invdyn_cli.report.posture import posture
from invdyn_cli.report.tables import significant

COLOURS = {"outliers": "vermillion", "not_finite": "purple", "duplicates": "sky", "at_rest": "green",
           "saturation": "orange"}  # fmt: skip
"""Colours of marks of samples and spans."""

MODEL_NOTE = (
    "Blue: measured torque over that of the URDF's rigid bodies. Points along the grey line agree; "
    "another slope is a unit, a sign or a gain, a cloud without a slope a wrong column; two parallel bands are "
    "friction. Green: velocity over position. This log cannot show what a joint never did."
)


def channel_plots(drawn: CheckedLog) -> str:
    """Every channel over time, as HTML; "" where there is no row to draw."""
    if not drawn.starts[-1]:
        return ""
    log = drawn.log
    names = [(int(row), raw.name) for row, raw in zip(drawn.starts, log.trajectories, strict=False) if len(raw.t)]
    time, panels = Timeline(drawn.time, names), []
    for j, joint in enumerate(log.joints):
        for channel in QUANTITIES:
            logged = drawn.column(log, channel, j)
            if not logged:
                continue
            lines = [Line(f"{channel} as logged", drawn.dense(logged), "ink", 1.3)]
            marks, note = _marks(drawn, channel, j, lines[0].y)
            share, comparable = drawn.corrected_share(channel, j)
            if comparable and (share > MANY or any(x.name == "outliers" for x in marks)):
                new = drawn.dense(drawn.column(drawn.corrected, channel, j))
                lines = [replace(lines[0], width=2.6, frames=False), Line(f"{channel} as corrected", new, "blue", 1.1)]
            if channel == "q" and (asked := drawn.column(log, "q_ref", j)):
                lines.insert(0, Line("q_ref as logged", drawn.dense(asked), "orange", 3.5, frames=False))
            unit = drawn.logged_unit(channel, j)
            known = unit != "as logged"  # else the shorter name: a panel has no room for more
            quantity = f"{QUANTITIES[channel] if known else channel} [{unit}]"
            panels.append(Panel(joint, quantity, lines, marks, note, joint=j, height=105))
    q = np.stack([drawn.dense(drawn.column(drawn.corrected, "q", j)) for j in range(len(log.joints))], axis=1)
    return plots(time, panels, arm=posture(drawn.robot, time, q), label="the log over time")


def model_plots(drawn: CheckedLog) -> str:
    """Measured and nominal torque of the corrected log, filtered, as HTML; "" without a robot or a stretch of it."""
    robot = drawn.robot
    found = gather(drawn.corrected, robot) if robot is not None and drawn.corrected.trajectories else None
    if robot is None or found is None:
        return ""
    rate = np.array([x.rate for x in found.stretches])
    starts = [int(np.searchsorted(found.stretch, k)) for k in range(len(found.stretches))]
    names = [(row, found.stretches[k].trajectory) for k, row in enumerate(starts) if (found.stretch == k).any()]
    time = Timeline(found.row / rate[found.stretch], names, "time in a stretch [s]")
    q, qd = np.asarray(found.motion.q), np.asarray(found.motion.qd)
    panels, over_model, visited = [], [], []
    for j, joint in enumerate(drawn.log.joints):
        unit = drawn.torque_unit(j)
        rest = found.tau[:, j] - found.nominal[:, j]
        title = f"{joint}: RMS difference {significant(float(np.sqrt(np.mean(rest**2))))} {unit}"
        lines = [Line("measured", found.tau[:, j], "ink", 3.0),
                 Line("URDF's model", found.nominal[:, j], "vermillion", 1.1, frames=False)]  # fmt: skip
        panels.append(Panel(title, f"torque [{unit}]", lines, joint=j, height=120))
        points = [("samples in view", found.nominal[:, j], found.tau[:, j], "blue")]
        labels = f"URDF's model [{unit}]", f"measured torque [{unit}]"
        over_model.append(Cloud(joint, *labels, points, diagonal=True, joint=j))
        points = [("samples in view", q[:, j], qd[:, j], "green")]
        labels = f"position [{drawn.unit('q', j)}]", f"velocity [{drawn.unit('qd', j)}]"
        visited.append(Cloud(joint, *labels, points, joint=j))
    return plots(
        time, panels, [*over_model, *visited], posture(robot, time, q), "measured torque and the model's", MODEL_NOTE
    )


def _marks(drawn: CheckedLog, channel: str, joint: int, y: np.ndarray) -> tuple[list[Mark], str]:
    """The marks in a panel, and the defects of its whole channel."""
    marks, whole = [], []
    for one in drawn.marks:
        if one.check == "gaps" and one.rows is not None and len(one.rows):
            marks.append(Mark("gap", "grey", longest_gaps(drawn, one.rows)))
        elif (one.channel == channel or (one.channel == "q_ref" and channel == "q")) and one.joint in (None, joint):
            if one.rows is None or one.check not in COLOURS:
                whole.append(f"q_ref: {one.label}" if one.channel == "q_ref" else one.label)
            elif len(one.rows):
                marks.append(_mark(one.check, one.rows, y))
    return marks, ", ".join(dict.fromkeys(whole))


def _mark(check: str, rows: np.ndarray, y: np.ndarray) -> Mark:
    if check in LOOKS:
        at = rows[:: max(1, len(rows) // MOST_MARKS)]
        return Mark(check.replace("_", " "), COLOURS[check], at, y[at] if check == "outliers" else None)
    return Mark(check.replace("_", " "), COLOURS[check], spans(rows))


def all_plots(drawn: CheckedLog) -> Sequence[str]:
    """Both as HTML; "" for one that these numbers do not allow."""
    made = []
    for draw in (channel_plots, model_plots):
        try:
            with np.errstate(all="ignore"):
                made.append(draw(drawn))
        except (ArithmeticError, ValueError, IndexError, np.linalg.LinAlgError):
            made.append("")
    return made
