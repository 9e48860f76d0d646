"""A run that adapted: its scores by stage, its figure, and both from run.h5."""

import json
from dataclasses import replace

import numpy as np
import pytest

from invdyn_cli import store
from invdyn_cli.adaptation.incremental import Incremental
from invdyn_cli.maths.metrics import BLOCK, nmse_in_blocks
from invdyn_cli.report import page, tables
from invdyn_cli.report.adapted import adaptation
from invdyn_cli.types import Prediction
from tests.records import make_record


@pytest.fixture
def record():
    """A test set of two trajectories, 400 samples each, that was followed exactly but in its second stage."""
    made = make_record(2)
    stage = np.repeat(["still", "moving"], 200)
    data = made.predictions["test"].data
    data = replace(data, trajectories=tuple(replace(x, stage=stage) for x in data.trajectories))
    followed = data.tau + np.tile(stage == "moving", 2)[:, None]
    predictions = {**made.predictions, "test": Prediction(data, made.predictions["test"].tau)}
    return replace(
        made, adaptation=Incremental(), predictions={**predictions, "test_adapted": Prediction(data, followed)},
        seconds={**made.seconds, "update_p50": 0.001, "update_p99": 0.002},
    )  # fmt: skip


def test_scores_by_stage(record):
    """Errors of every hundred samples over the variance of all, their mean and peak by stage, and the updates."""
    found = store.metrics(record)["adaptation_scores"]
    variance = record.predictions["test"].data.tau.var(0)
    still = {"mean": 0.0, "peak": 0.0, "line_peak": 0.0, "samples_below": {"0.1": 0, "0.01": 0}}
    assert found["stages"]["still"] == still
    assert found["as_learned"]["stages"]["still"]["mean"] > 0
    assert found["stages"]["moving"]["mean"] == pytest.approx(np.mean(1 / variance))
    assert found["nmse"]["mean"] == pytest.approx(np.mean(1 / variance) / 2)
    assert list(found["nmse"]["joint"].values()) == pytest.approx(list(0.5 / variance))
    assert found["updates"] == 8 and found["seconds_per_update"] == {"p50": 0.001, "p99": 0.002}


def test_loads_are_told(record):
    """A load of 2 kg in the second recording's second stage stands in metrics.json, in the terminal's table and on the
    page with its times and standard errors, and an adaptation that weighs nothing tells of none."""
    loaded = np.arange(800) >= 600
    mass = np.where(loaded, 2.0, np.nan)
    com = np.repeat([[0.0, 0.01, 0.08]], 800, axis=0)
    trace = {"loaded": 1.0 * loaded, "evidence": 0.0 * mass, "mass": mass, "mass_std": 0.1 * mass, "com": com}
    trace["since"] = np.arange(800.0)
    weighed = replace(record, trace={**trace, "com_std": 0 * com + 0.001})
    (found,) = store.metrics(weighed)["adaptation_scores"]["loads"]
    second = record.predictions["test"].data.trajectories[1]
    assert (found["trajectory"], found["came_in"], found["went"]) == (second.name, "moving", None)
    assert (found["came"], found["came_after"], found["mass"]) == pytest.approx((second.t[200], 0, 2))
    row = (second.name, f"{second.t[200]:.2f}", "-", "2.00 ± 0.20", "0.0000 ± 0.0010, 0.0100 ± 0.0010, 0.0800 ± 0.0010")
    assert tables.load_rows(weighed) == [row]
    assert all(cell in page.page(weighed, []) for cell in row)
    assert tables.load_table(record) is None and "Loads" not in page.page(record, [])
    assert "loads" not in store.metrics(record)["adaptation_scores"]


def test_what_fills_no_block_is_left_out():
    """Of 25 samples in blocks of ten, two blocks count, each over the variance of all 25."""
    tau = np.arange(25.0)[:, None]
    found = nmse_in_blocks(tau, tau + np.repeat([1.0, 2.0, 9.0], [10, 10, 5])[:, None], 10, np.var(tau, axis=0))
    np.testing.assert_allclose(found[:, 0], np.array([1.0, 4.0]) / tau.var())
    assert np.isnan(nmse_in_blocks(np.ones((20, 1)), np.zeros((20, 1)), 10, np.zeros(1))).all()


def test_stages_are_stored(record, tmp_path):
    """run.h5 gives the stages back, and with them the same scores."""
    store.write_run(record, tmp_path / "run.h5")
    again = store.load_run(tmp_path / "run.h5")
    assert store.metrics(again)["adaptation_scores"] == store.metrics(record)["adaptation_scores"]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("rows", [slice(500, None), slice(None)], ids=["from 500 on", "all"])
def test_what_diverged_is_drawn_as_far_as_it_goes(record, rows, tmp_path):
    """Predictions that are no numbers: null in metrics.json, and a figure without them, and no warning."""
    followed = record.predictions["test_adapted"]
    said = followed.tau.copy()
    said[rows] = np.nan
    made = replace(record, predictions={**record.predictions, "test_adapted": replace(followed, tau=said)})
    store.write_metrics(made, tmp_path / "metrics.json")
    found = json.loads((tmp_path / "metrics.json").read_text())["adaptation_scores"]
    assert [found["nmse"][name] for name in ("mean", "peak", "line_peak")] == [None] * 3
    assert set(found["nmse"]["joint"].values()) == {None}
    never = {"mean": None, "peak": None, "line_peak": None, "samples_below": {"0.1": None, "0.01": None}}
    assert found["stages"] == {"still": never, "moving": never}
    assert found["as_learned"]["nmse"]["mean"] > 0
    figure = adaptation(made)
    figure.savefig(tmp_path / "adaptation.png")
    lines = {str(line.get_label()): np.asarray(line.get_ydata()) for line in figure.axes[0].lines}
    assert np.isfinite(lines["not adapted"]).all() and not np.isfinite(lines["adapted"]).all()


def test_the_figure_shows_both_and_the_stages(record):
    """A line with and one without adapting, as long as the trajectories, and a mark at every stage's beginning; no
    figure for a run that does not adapt."""
    figure = adaptation(record)
    assert figure is not None
    (axes,) = figure.axes
    lines = {str(line.get_label()): line for line in axes.lines}
    assert len(lines["adapted"].get_xdata()) == len(lines["not adapted"].get_xdata()) == 400 // BLOCK
    assert {text.get_text() for text in axes.texts} == {"still", "moving"}
    assert adaptation(make_record(2)) is None
