"""invdyn compare: tables and page of several runs, and what it refuses."""

from dataclasses import replace
from pathlib import Path

import pytest

from invdyn_cli import store
from tests.commands import TINY
from tests.records import make_record


@pytest.fixture
def runs(tmp_path) -> list[str]:
    """Two runs on the same test data, the second with twice the error, and one with another name of the robot."""
    first = make_record(3)
    second = replace(make_record(3, error=2.0), predictions={"test": make_record(3, error=2.0).predictions["test"]})
    assert first.fit.robot is not None
    other = replace(first, fit=replace(first.fit, robot=replace(first.fit.robot, name="crane")))
    fewer = make_record(2)
    for name, record in (("good", first), ("bad", second), ("crane", other), ("fewer", fewer)):
        (tmp_path / name).mkdir()
        store.write_run(record, tmp_path / name / "run.h5")
        store.write_metrics(record, tmp_path / name / "metrics.json")
    return [str(tmp_path / name) for name in ("good", "bad", "crane", "fewer")]


def test_two_runs_beside_each_other(runs, command):
    """The table has each run's errors, and a column for each in that of the joints; the page has the same, the curves
    of both on one time axis, and the last line leads to it."""
    good, bad, *_ = runs
    said = command("compare", good, bad, "hydra.run.dir=out")
    assert said.code == 0, said.err
    text = "\n".join(said.out)
    assert said.out[-1] == "out/report.html" and "good has the lowest mean RMSE" in " ".join(said.out)
    assert all(joint in text for joint in ("joint1", "joint2", "joint3"))
    page = Path("out/report.html").read_text("utf-8")
    assert page.count('<div class="plots"') == 1
    assert all(page.count(f'"name":"{name}"') == 6 for name in ("good", "bad"))  # torque and residual of three joints
    assert Path("out/figures/compared.png").is_file()


@pytest.mark.parametrize(
    ("picked", "words"),
    [
        ((0, 3), "has the joints joint1, joint2, joint3"),
        ((0, 2), "allowed: runs of one robot"),
        ((0, 0), "is named twice"),
        ((0,), "compare got 1 runs"),
    ],
)
def test_what_does_not_belong_together_is_refused(runs, command, picked, words):
    """Other joints, another robot, the same run twice, and a single run: one line, and no folder."""
    said = command("compare", *(runs[i] for i in picked), "hydra.run.dir=out")
    assert said.code == 2 and len(said.err) == 1 and words in said.err[0]
    assert not Path("out").exists()


def test_a_sweep_has_a_page(command):
    """The page of a sweep sets its jobs beside each other, links to their pages, and tells which failed; `compare`
    takes the sweep's folder for its jobs."""
    said = command("run", "-m", "model=pest", *TINY, "seed=0,1", "model.threshold=0.001,-1", "hydra.sweep.dir=swept")
    assert said.code == 2
    page = Path("swept/report.html").read_text("utf-8")
    assert "A sweep of 4 jobs" in page and page.count("failed") == 2
    done = sorted(x.parent.name for x in Path("swept").glob("*/metrics.json"))
    assert [name.split("-")[0] for name in done] == ["0", "2"]
    assert all(f'href="{name}/report.html"' in page for name in done)
    said = command("compare", "swept", "hydra.run.dir=out")
    assert said.code == 0 and done[1] in "\n".join(said.out)
