"""The figures of adaptation experiments: what their lines, bands and panels stand for."""

from dataclasses import replace

import numpy as np
import pytest

from invdyn_cli.adaptation.incremental import Incremental
from invdyn_cli.report import curves, repetitions
from invdyn_cli.types import Prediction
from tests.records import make_record

SPEC = {
    "title": "Errors",
    "lines": {
        "frozen": {"each": {"name": "A"}, "set": "test", "colour": "blue", "dashed": True},
        "going on": {"each": {"name": "A"}, "set": "test_adapted", "colour": "blue"},
        "nowhere": {"each": {"name": "B"}, "set": "test", "colour": "green"},
    },
}


def run(wrong):
    """A run of two repetitions and two stages whose adapted predictions are off by `wrong` standard deviations, and
    which believes in a load of 2 kg in the second stage."""
    made = make_record(2)
    data = made.predictions["test"].data
    stage = np.repeat(["still", "moving"], 200)
    data = replace(data, trajectories=tuple(replace(x, stage=stage) for x in data.trajectories))
    off = Prediction(data, data.tau + data.tau.std(axis=0))
    on = Prediction(data, data.tau + wrong * data.tau.std(axis=0))
    mass = np.where(np.tile(stage == "moving", 2), 2.0, np.nan)
    predictions = {"validation": off, "test": off, "test_adapted": on}
    return replace(
        made, adaptation=Incremental(), predictions=predictions, trace={"mass": mass, "mass_std": 0.1 * mass}
    )


def test_a_line_is_the_median_of_repetitions_and_seeds():
    """Every line that has a run is drawn over all stages at the middles of blocks, as high as the seeds' median; one
    that has none is left out."""
    runs = [({"name": "A", "seed": str(k)}, curves.course(run(x))) for k, x in enumerate((0.1, 0.2, 0.9))]
    (axes,) = curves.draw(SPEC, runs).axes
    lines = {str(line.get_label()): line for line in axes.lines}
    np.testing.assert_allclose(lines["going on"].get_xdata(), [50, 150, 250, 350])
    np.testing.assert_allclose(lines["going on"].get_ydata(), 0.04)
    np.testing.assert_allclose(lines["frozen"].get_ydata(), 1.0)
    assert "nowhere" not in lines and {x.get_text() for x in axes.texts} == {"still", "moving"}


@pytest.mark.filterwarnings("error")
def test_a_seed_that_diverged_is_no_gap_in_the_others():
    """One of three runs is no number: the line is that of the runs in the middle, the upper half of the band is not
    drawn, and no warning comes."""
    runs = [({"name": "A", "seed": str(k)}, curves.course(run(x))) for k, x in enumerate((0.1, 0.2, np.nan))]
    figure = curves.draw(SPEC, runs)
    figure.canvas.draw()
    lines = {str(line.get_label()): line for line in figure.axes[0].lines}
    np.testing.assert_allclose(lines["going on"].get_ydata(), 0.04)


def test_the_mass_is_shown_where_one_is_believed_in():
    """The lower panel has the estimated mass in the second stage alone, beside the true one."""
    spec = {**SPEC, "mass": {"each": {"name": "A"}, "kg": 1.9}}
    _, below = curves.draw(spec, [({"name": "A"}, curves.course(run(0.1)))]).axes
    lines = {str(line.get_label()): np.asarray(line.get_ydata()) for line in below.lines}
    np.testing.assert_allclose(lines["load, estimated mass"], [np.nan, np.nan, 2.0, 2.0])
    assert lines["true mass, 1.9 kg"][0] == 1.9


def test_torques_are_those_of_one_repetition_each():
    """Fig. 2 has a panel per joint that is asked for, with the first repetition of either set."""
    record = run(0.1)
    panels = repetitions.draw({"title": "Torques", "joints": [2, 1]}, record).axes
    assert len(panels) == 2
    drawn = {str(line.get_label()): np.asarray(line.get_ydata()) for line in panels[0].lines}
    for label, name in (("without object", "validation"), ("with object", "test")):
        expected = record.predictions[name].data.trajectories[0].tau[:, 1]
        assert drawn[label] == pytest.approx(np.asarray(expected))
