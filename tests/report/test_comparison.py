"""The paper's statements beside what was found: grids and verdicts."""

import math

import pytest

from invdyn_cli.report import comparison


def job(name, test, *, seeds=None, **labels):
    """A job whose test set has this mean NMSE, or these of several seeds."""

    def scored(x):
        return {"nmse": {"mean": x, "joint": {"a": x}}, "rmse": {"mean": 1.0, "joint": {"a": 1.0}}}

    metrics = {"joints": ["a"], "test": scored(test), "train": scored(test), "seconds": {"fit": 1.0}}
    if seeds:
        metrics["members"] = {"test": [scored(x) for x in seeds]}
    return {"name": name, **labels}, metrics


JOBS = [
    job("PEST", 0.01, data="clean"),
    job("NN", 0.5, data="clean", seeds=[0.2, 0.4, 0.9]),
    job("NN", 5.0, data="noisy"),
]


@pytest.mark.parametrize(
    ("statement", "found", "verdict"),
    [
        ({"each": {"name": "PEST"}, "band": [0, 0.1]}, "0.0100", "holds"),
        ({"each": {"name": "NN", "data": "clean"}, "band": [0, 1]}, "0.200 to 0.900", "holds"),
        (
            {"each": {"name": "NN", "data": "clean"}, "band": [0, 0.5]},
            "0.200 to 0.900",
            "holds for 2 of 3: above by up to 1.8 x",
        ),
        ({"each": {"name": "PEST"}, "band": [0.02, 1]}, "0.0100", "differs: below by up to 2 x"),
        ({"each": {"name": "NN", "data": "clean"}, "over": {"name": "PEST"}, "band": [30, 50]}, "40.0", "holds"),
        ({"each": {"name": "DBM"}, "band": [0, 1]}, "", "not run"),
        (
            {"each": {"name": "NN", "data": "noisy"}, "band": [0, 1], "why": "too far"},
            "5.00",
            "differs: above by up to 5 x; too far",
        ),
    ],
)
def test_verdicts(statement, found, verdict):
    """A statement holds where every value is in its band; else the verdict says how many do, the factor, and why."""
    grid = comparison.judge([{"paper": "p", "claim": "c", **statement}], JOBS)
    assert grid.rows[0][3:] == (found, verdict)


@pytest.mark.parametrize(
    ("band", "said"), [([0, 0.1], "below 0.100"), ([0.1, math.inf], "above 0.100"), ([0.1, 1], "0.100 to 1.00")]
)
def test_expected_is_said_in_words(band, said):
    """A bound that is none is not told as a number."""
    grid = comparison.judge([{"paper": "", "claim": "", "each": {"name": "PEST"}, "band": band}], JOBS)
    assert grid.rows[0][2] == said


def test_every_seed_counts():
    """Where a fit has several seeds, each one's error is judged, not the error of their mean."""
    assert comparison.values_of(JOBS[1][1], "test") == [0.2, 0.4, 0.9]
    assert comparison.values_of(JOBS[0][1], "test_clean") == []


def test_a_null_in_metrics_is_no_agreement():
    """An error that does not exist (null in metrics.json) never lets a statement hold."""
    grid = comparison.judge([{"paper": "", "claim": "", "each": {"name": "X"}, "band": [0, 1]}], [job("X", None)])
    assert grid.rows[0][4] == "differs: no number"
    assert math.isnan(comparison.values_of(job("X", None)[1], "test")[0])


def test_markdown_survives_pipes():
    """A cell with a pipe stays one cell."""
    text = comparison.markdown(comparison.Grid(("a", "b"), (("x|y", "z"),)))
    assert text.splitlines()[2] == r"| x\|y | z |"


def test_floors_follow_their_robot():
    """The noise floor stands after the last job of its robot, and joints that a robot does not have stay empty."""
    two = {"nmse": {"mean": 1.0, "joint": {"a": 1.0, "b": 1.0}}, "rmse": {"mean": 1.0, "joint": {"a": 1.0, "b": 1.0}}}
    jobs = [job("one", 1.0, model="m"), ({"name": "two", "model": "m"}, {"joints": ["a", "b"], "test": two})]
    rows = comparison.by_joints(jobs, {"one": [0.25]}).rows
    assert rows[2] == ("one", "noise floor", "RMSE", "0.250", "", "0.250")
    assert len(rows) == 5


def followed(name, mean, *, seed=None, until=None, learned=1.0):
    """A job that adapted: the mean error of its only stage, samples until below 0.1, its error as learned."""

    def errors(x, samples):
        stage = {"mean": x, "peak": 3 * x, "line_peak": 2 * x, "samples_below": {"0.1": samples, "0.01": None}}
        return {"nmse": {"mean": x, "peak": 3 * x, "line_peak": 2 * x}, "stages": {"grasp": stage}}

    labels, metrics = job(name, mean, **({} if seed is None else {"seed": seed}))
    scores = {**errors(mean, until), "as_learned": errors(learned, None), "seconds_per_update": {"p50": 0.002}}
    return labels, {**metrics, "adaptation_scores": scores}


FOLLOWED = [*(followed("NN", x, seed=str(k), until=700) for k, x in enumerate((0.1, 0.2, 0.6))), followed("PEST", 0.05)]


@pytest.mark.parametrize(
    ("statement", "found"),
    [
        ({"value": "adapted.grasp.mean", "each": {"name": "NN"}}, "0.100 to 0.600"),
        ({"value": "adapted.grasp.samples_below 0.1", "each": {"name": "NN"}}, "700"),
        ({"value": "adapted.grasp.samples_below 0.1", "each": {"name": "PEST"}}, "inf"),
        ({"value": "learned.line_peak", "each": {"name": "PEST"}}, "2.00"),
        ({"value": "adapted.mean", "each": {"name": "NN"}, "over": {"name": "PEST"}}, "4.00"),
        ({"value": "adapted.mean", "each": {"name": "PEST"}, "over": {"name": ["NN", "PEST"]}}, "0.250 to 1.00"),
        (
            {"value": "adapted.peak", "over_value": "learned.peak", "each": {"name": "NN"}, "over": {"name": "NN"}},
            "0.200",
        ),
        ({"value": "adapted.lift.mean", "each": {"name": "NN"}}, ""),
    ],
)
def test_statements_on_stages(statement, found):
    """A statement picks a stage's error, as learned or adapted; seeds are judged one by one, and a ratio is that of
    their medians, one method against each of several."""
    grid = comparison.judge([{"paper": "", "claim": "", "band": [0, 10], **statement}], FOLLOWED)
    assert grid.rows[0][3] == found


def test_what_never_comes_never_holds():
    """Samples that never suffice are no large number: the verdict says never."""
    never = {"paper": "", "claim": "", "value": "adapted.grasp.samples_below 0.1", "band": [0, 1e6]}
    assert comparison.judge([{**never, "each": {"name": "PEST"}}], FOLLOWED).rows[0][4] == "differs: never"


def test_a_row_per_method_and_stage():
    """Seeds share a row, with their median and range; not adapted and adapted stand below each other."""
    grid = comparison.by_stages(FOLLOWED)
    rows = {row[:3]: row[3:] for row in grid.rows}
    assert list(rows) == [
        (name, kind, stage)
        for name in ("NN", "PEST")
        for kind in ("not adapted", "adapted")
        for stage in ("grasp", "whole")
    ]
    assert rows["NN", "adapted", "grasp"][:2] == ("0.200 (0.100 to 0.600)", "0.400 (0.200 to 1.20)")
    assert rows["NN", "adapted", "grasp"][3:] == ("700", "never", "2.00")
