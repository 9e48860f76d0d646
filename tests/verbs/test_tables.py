"""invdyn tables: experiments become runs, a table and verdicts; readers of README and experiments hear the truth."""

import json
import subprocess
from pathlib import Path

import pytest
import yaml

from invdyn_cli.verbs import published

ROOT = Path(__file__).parents[2]
EXPERIMENTS = sorted(path.stem for path in (ROOT / "experiments").glob("*.yaml"))


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_every_experiment_has_its_page(name):
    """Beside NAME.yaml stands NAME.md with question, command, what is expected and what was found."""
    text = (ROOT / "experiments" / f"{name}.md").read_text()
    assert all(f"**{head}.**" in text for head in ("Question", "Command", "Expected", "Found"))
    assert f"invdyn experiment {name}" in text


def test_a_sweep_is_spelled_out():
    """A job's sweep is a product; a value that `choices` knows stands for several overrides."""
    spec = {
        "common": ["a=1"],
        "choices": {"model": {"good": ["model=pest", "model.offset=true"]}},
        "jobs": [{"name": "X", "overrides": ["b=2"], "sweep": {"model": ["good", "ffnn"], "seed": [0, 1]}}],
    }
    jobs = list(published.expand(spec))
    assert len(jobs) == 4
    assert jobs[0] == (
        {"name": "X", "model": "good", "seed": "0"},
        ["a=1", "b=2", "model=pest", "model.offset=true", "seed=0"],
    )


def test_runs_are_kept_and_the_table_written(tmp_path, command):
    """The table has a row per job with the numbers of its metrics.json; run again, no job runs anew; two processes find
    the same, and say in one line what keeps a job from running."""
    (tmp_path / "experiments").mkdir()
    spec = {
        "title": "Small",
        "source": "a test",
        "columns": "sets",
        "common": ["robot.dofs=2", "data.duration=2", "data=sim_clean"],
        "jobs": [{"name": "PEST", "overrides": ["model=pest"], "sweep": {"data.amplitude": [0.5, 1.0]}}],
        "statements": [{"paper": "exact", "claim": "clean", "each": {"name": "PEST"}, "band": [0, 1e-20]}],
    }
    (tmp_path / "experiments" / "small.yaml").write_text(yaml.safe_dump(spec))
    done = command("tables", "experiment=small")
    assert done.code == 0, done.err
    runs = sorted((tmp_path / "outputs/tables/small").glob("*/metrics.json"))
    text = (tmp_path / "outputs/tables/small.md").read_text()
    found = [json.loads(run.read_text())["test"] for run in runs]
    assert len(runs) == 2 and f"{found[0]['nmse']['mean']:.2e}" in text and "| holds |" in text
    before = [run.stat().st_mtime_ns for run in runs]
    assert command("tables", "experiment=small").code == 0
    assert [run.stat().st_mtime_ns for run in runs] == before
    assert command("tables", "experiment=small", "fresh=true", "workers=2").code == 0
    assert [json.loads(run.read_text())["test"] for run in runs] == found
    assert all(run.stat().st_mtime_ns > old for run, old in zip(runs, before, strict=True))
    spec["jobs"][0]["overrides"] = ["model=pest", "seed=-1"]
    (tmp_path / "experiments" / "small.yaml").write_text(yaml.safe_dump(spec))
    refused = command("tables", "experiment=small", "fresh=true", "workers=2")
    assert refused.code == 2 and "seed=-1; allowed" in refused.err[-1]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["experiment=batch_simulatd"], "did you mean 'batch_simulated'?"),
        (["experiment=real_logs", "real_data=nowhere"], "INVDYN_REAL_DATA"),
        (["workers=0"], "workers=0; allowed: 1 and more"),
    ],
)
def test_wrong_use_is_one_line(command, arguments, said):
    """An unknown experiment and missing logs are told in one line with exit code 2."""
    done = command("tables", *arguments)
    assert done.code == 2 and len(done.err) == 1 and said in done.err[0]


def test_git_ignores_outputs():
    """What the commands write does not end in the repository."""
    if not (ROOT / ".git").exists():
        pytest.skip("not a git checkout")
    assert subprocess.run(["git", "check-ignore", "-q", "outputs/tables/x.md"], cwd=ROOT).returncode == 0
