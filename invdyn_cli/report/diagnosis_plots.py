"""The plots of a diagnosis that zoom: torques and residuals of every joint over the log, the residual over velocity."""

import numpy as np

from invdyn_cli.diagnosis.decide.wording import units_of
from invdyn_cli.recording.rows import runs
from invdyn_cli.report.exhibits import in_window
from invdyn_cli.report.interactive import Cloud, Line, Mark, Panel, Timeline, plots
from invdyn_cli.report.posture import posture
from invdyn_cli.report.tables import position_unit, significant
from invdyn_cli.report.wording import claims, joints_of, words
from invdyn_cli.types import Diagnosis, Signals

MOST_TURNS = 20
"""Changes between training and held-out data up to which they are marked."""

NOTE = (
    "Residual over the joint's own velocity, of the stretch of time in view; other samples are pale. What the extended "
    "model has explained is gone from its residual."
)


def diagnosis_plots(diagnosis: Diagnosis) -> str:
    """As HTML; "" without signals."""
    if diagnosis.signals is None or not len(diagnosis.signals.t):
        return ""
    signals, units = diagnosis.signals, units_of(diagnosis)
    starts = [0, *(np.flatnonzero(signals.trajectory[1:] != signals.trajectory[:-1]) + 1).tolist()]
    turns = np.flatnonzero(signals.held_out[1:] != signals.held_out[:-1]) + 1
    stages = [(int(row), "held-out data" if signals.held_out[row] else "training data") for row in turns]
    time = Timeline(
        signals.t,
        [(row, str(signals.trajectory[row])) for row in starts],
        stages=stages if len(stages) <= MOST_TURNS else (),
    )
    panels, clouds = [], []
    for j, joint in enumerate(joints_of(diagnosis)):
        unit = units[joint]
        measured, nominal, extended = (x[:, j] for x in (signals.tau, signals.nominal, signals.extended))
        before, after = (significant(x.get(joint, {}).get("rmse")) for x in (diagnosis.baseline, diagnosis.extended))
        lines = [
            Line("nominal model", nominal, "grey", 1.2, frames=False),
            Line("extended model", extended, "blue", 3.4, frames=False),
            Line("measured", measured, "ink", 1.0),
        ]
        left = [Line("residual, nominal", measured - nominal, "grey"),
                Line("residual, extended", measured - extended, "blue", 1.1)]  # fmt: skip
        title = f"{joint}: held-out RMSE {before} → {after} {unit}"
        panels.append(Panel(title, f"torque [{unit}]", lines, joint=j, height=130))
        marks = _windows(diagnosis, signals, joint)
        panels.append(Panel("", f"residual [{unit}]", left, marks, joint=j, height=95, zero=True))
        speed = f"velocity [{position_unit(unit)}/s]"
        points = [(f"residual, {name}", signals.qd[:, j], measured - x, colour)
                  for name, x, colour in (("nominal", nominal, "grey"), ("extended", extended, "blue"))]  # fmt: skip
        clouds.append(Cloud(joint, speed, f"residual [{unit}]", points, joint=j))
    robot = None if diagnosis.model is None else diagnosis.model.robot
    return plots(time, panels, clouds, posture(robot, time, signals.q), "torques of the log", NOTE)


def _windows(diagnosis: Diagnosis, signals: Signals, joint: str) -> list[Mark]:
    """The times in which causes with a window act, for this joint or the whole arm."""
    marks = []
    for x in claims(diagnosis):
        if x.joint in (None, joint) and (inside := in_window(x, signals)).any():
            marks.append(Mark(words(x.effect), "orange", runs(inside) - [0, 1]))
    return marks
