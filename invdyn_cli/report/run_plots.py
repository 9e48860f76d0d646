"""The plots of a run that zoom: torque and residual of every joint over the test set, the residual over velocity, and
the arm in its posture."""

from itertools import accumulate

import numpy as np

from invdyn_cli.report.canvas import binned
from invdyn_cli.report.interactive import Cloud, Line, Panel, Timeline, plots
from invdyn_cli.report.posture import posture
from invdyn_cli.report.tables import position_unit, robot_of, significant, units
from invdyn_cli.types import Dataset, RunRecord

SHOWN = ("test", "test_adapted")
"""Predictions of the test set."""


def run_plots(record: RunRecord, note: str = "") -> str:
    """As HTML, `note` below the clouds; "" for a run without a test set."""
    if "test" not in record.predictions or not record.predictions["test"].data.samples:
        return ""
    data = record.predictions["test"].data
    found = {
        name: record.predictions[name].tau
        for name in SHOWN
        if name in record.predictions and record.predictions[name].tau.shape == data.tau.shape
    }
    time, tau, motion = timeline(data), data.tau, data.motion
    q, qd = np.asarray(motion.q), np.asarray(motion.qd)
    last = list(found)[-1]
    words = {name: "adapted" if name != "test" else "predicted" if name == last else "not adapted" for name in found}
    panels, clouds = [], []
    for j, (joint, unit) in enumerate(zip(record.fit.joints, units(record), strict=True)):
        said, left = [Line("measured", tau[:, j], "ink", 3.0)], []
        for name, y in found.items():
            colours = ("vermillion", "blue") if name == last else ("grey", "grey")
            said.append(Line(words[name], y[:, j], colours[0], 1.1, frames=False))
            of = "residual" if len(found) == 1 else f"residual, {words[name]}"
            left.append(Line(of, _residual(tau[:, j], y[:, j]), colours[1], 1.1))
        score = record.scores.get(last)
        title = joint
        if score is not None:
            title += f": NMSE {significant(score.nmse[j])}, RMSE {significant(score.rmse[j])} {unit}"
        panels.append(Panel(title, f"torque [{unit}]", said, joint=j, height=140))
        panels.append(Panel("", f"residual [{unit}]", left, joint=j, height=95, zero=True))
        speed = f"velocity [{position_unit(unit)}/s]"
        rest = _residual(tau[:, j], found[last][:, j])
        fine = np.isfinite(rest) & np.isfinite(qd[:, j])
        centre, _, middle, _ = binned(qd[fine, j], rest[fine])
        sides = ("median of a bin", np.insert(centre, np.searchsorted(centre, 0), np.nan),
                 np.insert(middle, np.searchsorted(centre, 0), np.nan), "vermillion")  # fmt: skip
        clouds.append(
            Cloud(joint, speed, f"residual [{unit}]", [("samples in view", qd[:, j], rest, "sky")], [sides], joint=j)
        )
    return plots(time, panels, clouds, posture(robot_of(record), time, q), "torques of the test set", note)


def _residual(measured: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """Their difference (T,), NaN beyond twice the measured range, where the prediction has left its plot, too."""
    residual = measured - predicted
    reach = 2 * np.ptp(measured)
    return np.where(np.abs(residual) <= reach, residual, np.nan) if reach > 0 else residual


def timeline(data: Dataset) -> Timeline:
    """The time axis of all recordings of a set, with their stages."""
    starts = list(accumulate((len(x.t) for x in data.trajectories), initial=0))
    t = np.concatenate([np.asarray(x.t, float) for x in data.trajectories])
    stages: list[tuple[int, str]] = []
    if data.stage is not None:
        names = np.asarray(data.stage)
        begins = np.union1d(np.flatnonzero(names[1:] != names[:-1]) + 1, starts[:-1]).astype(int)
        stages = [(int(row), str(names[row])) for row in begins if row < len(names)]
    return Timeline(t, list(zip(starts[:-1], (x.name for x in data.trajectories), strict=True)), stages=stages)
