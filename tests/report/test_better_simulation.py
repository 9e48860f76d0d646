"""The report's section, picture and line on the better simulation."""

import math
from dataclasses import replace

import numpy as np
import pytest

from invdyn_cli.report.better_simulation import MUJOCO, better_simulation, replay_line
from invdyn_cli.report.diagnosis_figures import draw_all
from invdyn_cli.report.diagnosis_page import page
from invdyn_cli.report.replay_figure import replay_figure
from invdyn_cli.simulation.replay import Replay, Traces
from invdyn_cli.types import Diagnosis
from tests.diagnoses import JOINTS, diagnosis_of, make_diagnosis


def replayed(before: float = 0.4, after: float = 0.02) -> Diagnosis:
    """A diagnosis whose arm is off by `before` and `after` [rad] on the mean of its joints."""
    ones, t = np.ones(len(JOINTS)), np.linspace(3.0, 3.2, 51)
    trace = Traces("sweep_1", JOINTS[1], t, np.sin(t), np.sin(t) + 2 * (t - 3) ** 2, np.sin(t) + 1e-3)
    rest = {x: after * ones for x in ("end_before", "end_after", "held_before", "held_after")}
    torque = {"torque_before": 2 * ones, "torque_after": 0.1 * ones}
    made = Replay(
        joints=JOINTS,
        length=0.2,
        windows=40,
        before=before * ones,
        after=after * ones,
        held=12.0,
        **rest,
        **torque,
        traces=(trace, trace),
        not_held=("axis: something is left out",),
    )
    short = diagnosis_of([("coulomb_friction", 1, {})], trajectories=2, seconds=24.0)
    return replace(short, replay=made)


def test_the_line_has_the_numbers():
    """Both errors in rad, and by how much the one is less than the other, or more."""
    assert "deviates by 0.0200 rad, the nominal arm by 0.400 rad: 95 % less" in replay_line(replayed())
    assert "50 % more" in replay_line(replayed(0.4, 0.6))


def test_the_section_tells_what_the_files_lack():
    """Sentences stand under the file they are of, a file that lacks nothing says so, and names are escaped."""
    html = better_simulation(replayed(), None, {"a.urdf": ("<b>: left out",), "a.mjcf.xml": ()})
    assert "<li>&lt;b&gt;: left out</li>" in html and "contains all effects found" in html
    assert html.count("<li>") == 1 and MUJOCO.splitlines()[0] in html
    assert "12 s" in html and "2.00 N m" in html


def test_nothing_to_tell_is_no_section(tmp_path):
    """Without replay and files there is no heading; with a replay there is, and its picture stands in the page."""
    assert "The better simulation" not in page(make_diagnosis(), "lbr", [])
    found = replayed()
    drawn = draw_all(found, tmp_path)
    assert "replay" in {x.stem for x in drawn}
    text = page(found, "lbr", drawn)
    assert "The better simulation" in text and text.count("<img") == len(drawn)


@pytest.mark.parametrize("after", [0.0, 0.02, math.pi])
def test_the_figure_shows_curves_and_bars(after):
    """Measured, before and after in every window, and a bar per joint and model, also for an error of zero."""
    figure = replay_figure(replayed(after=after))
    *windows, bars = figure.axes
    for axes in windows:
        curves = {line.get_label(): np.array(line.get_ydata()) for line in axes.lines}
        assert set(curves) == {"measured", "nominal arm", "extended arm"}
        assert curves["nominal arm"][-1] - curves["measured"][-1] == pytest.approx(2 * 0.2**2)
    heights = [x.get_height() for x in bars.patches]
    assert heights == pytest.approx([0.4] * 7 + [after] * 7)


def test_a_window_at_rest_has_a_scale_for_eyes():
    """A joint that rests within 10 nanoradians is drawn on an axis of a milliradian or more, not on its noise."""
    found = replayed()
    assert found.replay is not None
    trace = found.replay.traces[0]
    resting = replace(trace, measured=-0.9 + 1e-8 * np.sin(50 * trace.t))
    window = replay_figure(replace(found, replay=replace(found.replay, traces=(resting,)))).axes[0]
    low, high = window.get_ylim()
    assert low < -0.9 < high and high - low > 0.001
