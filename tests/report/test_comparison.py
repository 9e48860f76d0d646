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


def test_every_seed_counts():
    """Where a fit has several seeds, each one's error is judged, not the error of their mean."""
    assert comparison.values_of(JOBS[1][1], "test") == [0.2, 0.4, 0.9]
    assert comparison.values_of(JOBS[0][1], "test_clean") == []


def test_a_null_in_metrics_is_no_agreement():
    """An error that does not exist (null in metrics.json) never lets a statement hold."""
    grid = comparison.judge([{"paper": "", "claim": "", "each": {"name": "X"}, "band": [0, 1]}], [job("X", None)])
    assert grid.rows[0][4].startswith("differs")
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
