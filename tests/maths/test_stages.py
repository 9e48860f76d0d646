"""Errors along a repetition: which samples a block has, when a stage counts as recovered."""

from dataclasses import replace

import numpy as np
import pytest

from invdyn_cli.maths import stages
from invdyn_cli.maths.metrics import BLOCK
from invdyn_cli.types import Dataset, Prediction
from tests.records import make_record


def staged(lengths, wrong):
    """Repetitions of two stages ("still", "moving"), `lengths` [samples] of both in each; predictions are wrong by
    `wrong(stage, sample in the stage)` in units of each joint's standard deviation."""
    data = make_record(2, samples=1000).predictions["test"].data
    x, made, left = data.trajectories[0], [], []
    for still, moving in lengths:
        rows, stage = slice(still + moving), np.repeat(["still", "moving"], [still, moving])
        made.append(replace(x, t=x.t[rows], motion=x.motion[rows], tau=x.tau[rows], stage=stage))
        left += [wrong("still", k) for k in range(still)] + [wrong("moving", k) for k in range(moving)]
    whole = Dataset(tuple(made), data.joints, data.robot)
    return Prediction(whole, whole.tau + np.array(left)[:, None] * whole.tau.std(axis=0))


def test_blocks_are_counted_from_each_stage():
    """No block holds samples of two stages, in repetitions of different lengths, and what fills none is left out."""
    found = stages.errors(staged([(150, 450), (290, 310)], lambda stage, k: float(stage == "moving")))
    assert found["still"].shape == (2, 2) and found["moving"].shape == (2, 4)
    np.testing.assert_allclose(found["still"][:, 0], 0)
    np.testing.assert_allclose(found["moving"][:, :3], 1)
    assert np.isnan(found["moving"][1, 3]) and np.isnan(found["still"][0, 1])


def test_stages_begin_where_they_do_in_the_median():
    """The second stage begins at the median of its first samples."""
    assert stages.begins(staged([(100, 300), (200, 300), (240, 300)], lambda *_: 0.0)) == {"still": 0, "moving": 200}


@pytest.mark.parametrize(
    ("curve", "samples"),
    [([0.5, 0.2, 0.05, 0.05], 200), ([0.05, 0.5, 0.05, 0.05], 200), ([0.05, 0.05], 0), ([0.05, 0.2], None)],
)
def test_back_means_back_for_good(curve, samples):
    """Samples count until the last block that is not below the level; never, if that is the stage's last."""
    assert stages.until_below(np.array([curve, curve, [1.0] * len(curve)]), 0.1) == samples


def test_a_curve_goes_as_far_as_half_of_the_repetitions():
    """Where fewer than half of the repetitions still go on, the median ends."""
    errors = np.array([[1.0, 2.0, 9.0], [1.0, 4.0, np.nan], [1.0, np.nan, np.nan]])
    np.testing.assert_allclose(stages.line(errors), [1.0, 3.0])


def test_scores_say_both_peaks():
    """`peak` is the highest block of all repetitions, `line_peak` that of their median."""
    judged = staged([(200, 200)] * 3, lambda stage, k: 0.5)
    said = judged.tau.copy()
    said[: 2 * BLOCK] += 2 * judged.data.tau.std(axis=0)
    found = stages.scores(replace(judged, tau=said))
    assert found["nmse"]["line_peak"] == pytest.approx(0.25) and found["nmse"]["peak"] == pytest.approx(6.25)
    assert found["stages"]["moving"]["samples_below"] == {"0.1": None, "0.01": None}


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_what_is_not_finite_has_no_score(wrong):
    """One sample that is no number, in one of three repetitions: its stage and the whole have an infinite mean and
    peaks and are never below a level; the other stage, and the other joint, keep their scores. A stage that is longer
    in one repetition than in the others is no such thing."""
    judged = staged([(200, 200), (200, 200), (400, 200)], lambda stage, k: 0.2)
    said = judged.tau.copy()
    said[250, 0] = wrong
    found = stages.scores(replace(judged, tau=said))
    never = {"mean": np.inf, "peak": np.inf, "line_peak": np.inf, "samples_below": {"0.1": None, "0.01": None}}
    assert found["stages"]["moving"] == never
    assert [found["nmse"][name] for name in ("mean", "peak", "line_peak")] == [np.inf] * 3
    still = found["stages"]["still"]
    assert [still[name] for name in ("mean", "peak", "line_peak")] == pytest.approx([0.04] * 3)
    assert still["samples_below"] == {"0.1": 0, "0.01": None}
    assert list(found["nmse"]["joint"].values()) == [np.inf, pytest.approx(0.04)]


@pytest.mark.filterwarnings("error")
def test_torques_that_never_change_have_no_score():
    """Neither an error nor a warning: NaN, and never below a level."""
    judged = staged([(200, 200)], lambda stage, k: 0.2)
    (x,) = judged.data.trajectories
    data = Dataset((replace(x, tau=np.ones_like(x.tau)),), judged.data.joints, judged.data.robot)
    found = stages.scores(Prediction(data, judged.tau))
    assert np.isnan([found["nmse"][name] for name in ("mean", "peak", "line_peak")]).all()
    assert found["stages"]["still"]["samples_below"] == {"0.1": None, "0.01": None}
