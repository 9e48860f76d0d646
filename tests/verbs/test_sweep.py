"""Sweeps: a table of all jobs, failures as rows, and going on where a sweep stopped."""

import csv
import importlib.util
import json
import os
import signal
import subprocess
import time
from pathlib import Path

import pytest
import yaml

from invdyn_cli import load_run
from tests.commands import ENVIRONMENT, TINY, invdyn, script, tree
from tests.logs import make_log

JOB = ("model=pest", *TINY)
SPLITS = ("model=pest", "data.split=interpolation,extrapolation", *TINY)


def folder_of(said) -> Path:
    """The sweep's folder, the last line printed."""
    return Path(said.out[-1])


def rows_of(folder: Path) -> list[dict[str, str]]:
    """sweep.csv."""
    with (folder / "sweep.csv").open() as file:
        return list(csv.DictReader(file))


def test_a_failed_job_is_a_row(command):
    """All jobs run, the table and sweep.csv hold each, a failed one with what was wrong; exit code 2.

    Called again, the same command finds the same folder, keeps the complete jobs untouched and tries the others again.
    """
    argv = ("run", "-m", *SPLITS, "model.threshold=0.001,-1")
    said = command(*argv)
    folder = folder_of(said)
    rows = rows_of(folder)
    assert said.code == 2
    assert [row["status"] for row in rows] == ["ran", "failed", "ran", "failed"]
    assert [row["job"] for row in rows] == ["0", "1", "2", "3"]
    assert rows[0]["overrides"].split() == ["model=pest", "data.split=interpolation", *TINY, "model.threshold=0.001"]
    assert rows[1]["message"] == "model.threshold=-1; allowed: a number >= 0"
    for row in (rows[0], rows[2]):
        scores = json.loads((folder / row["folder"] / "metrics.json").read_text())["test"]
        assert float(row["test_nmse"]) == scores["nmse"]["mean"]
        assert float(row["test_rmse"]) == scores["rmse"]["mean"]
    assert rows[0]["test_nmse"] != rows[2]["test_nmse"]
    table = "\n".join(said.out)
    assert table.count("failed") == 2
    assert "allowed: a number >= 0" in table
    assert said.err[2] == "job 1 failed: model.threshold=-1; allowed: a number >= 0"
    assert not [p for p in folder.glob("[13]-*/*") if p.name in ("run.h5", "metrics.json")]

    before = tree(folder)
    again = command(*argv)
    after = tree(folder)
    assert (again.code, folder_of(again)) == (2, folder)
    assert [row["status"] for row in rows_of(folder)] == ["kept", "failed", "kept", "failed"]
    kept = [
        name for name in before if name.startswith(("0-", "2-")) and name.endswith((".h5", ".png", ".html", "cs.json"))
    ]
    assert len(kept) >= 8
    assert all(after[name] == before[name] for name in kept)
    assert all(
        after[name] > before[name] for name in before if name[:2] in ("1-", "3-") and name.endswith("status.json")
    )


def test_what_failed_may_succeed_later(command):
    """A job that failed for want of a log runs when the sweep is called again and the log is there; exit code 0."""
    argv = ("run", "-m", "model=ffnn", "model.epochs=1", "data=real_log", "data.path=a.h5,b.h5")
    make_log(Path("a.h5"), urdf="")
    said = command(*argv)
    assert said.code == 2
    assert [row["status"] for row in rows_of(folder_of(said))] == ["ran", "failed"]
    make_log(Path("b.h5"), urdf="")
    said = command(*argv)
    assert said.code == 0
    assert [row["status"] for row in rows_of(folder_of(said))] == ["kept", "ran"]


def test_another_job_in_the_same_folder_is_not_kept(command):
    """A job is kept for its config, not for its number: with other settings in the same folder it runs."""
    argv = ("run", "-m", *JOB, "hydra.sweep.dir=here")
    for threshold in ("0.001", "0.002"):
        assert command(*argv, f"model.threshold={threshold}").code == 0
        assert [row["status"] for row in rows_of(Path("here"))] == ["ran"]


def test_a_bug_in_one_job_leaves_the_others(command):
    """A model that raises something unforeseen fails alone, and leaves its traceback in its folder."""
    Path("bad.py").write_text(
        "from invdyn_cli.models.pest import Pest\n"
        "class Bad(Pest):\n"
        "    def fit(self, *args, **kwargs):\n"
        "        return 1 / 0\n"
    )
    argv = ("run", "-m", *JOB, "model._target_=bad.Bad,invdyn_cli.models.pest.Pest")
    said = command(*argv)
    folder = folder_of(said)
    assert said.code == 2
    assert [row["message"] for row in rows_of(folder)] == ["ZeroDivisionError: division by zero", ""]
    assert "return 1 / 0" in (folder / rows_of(folder)[0]["folder"] / "traceback.txt").read_text()


def test_a_killed_sweep_goes_on(command, tmp_path):
    """After SIGKILL in the middle, whatever run.h5 there is can be read, and the same command finishes the sweep."""
    argv = ("run", "-m", *JOB, "model.threshold=0.001,0.002,0.003")
    process = subprocess.Popen(
        [script(), *argv],
        cwd=tmp_path,
        env=os.environ | ENVIRONMENT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    deadline = time.monotonic() + 120
    while not list(tmp_path.glob("outputs/sweeps/*/1-*/status.json")):
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    [folder] = tmp_path.glob("outputs/sweeps/*")
    assert not (folder / "sweep.csv").exists()
    for path in folder.glob("*/run.h5"):
        load_run(path)
    [kept] = folder.glob("0-*/run.h5")
    first = kept.stat().st_mtime_ns

    said = command(*argv)
    assert said.code == 0
    statuses = [row["status"] for row in rows_of(folder)]
    assert statuses[0] == "kept"
    assert statuses[-1] == "ran"
    assert set(statuses) == {"kept", "ran"}
    assert kept.stat().st_mtime_ns == first
    assert not list(folder.glob("*/.*.part"))


@pytest.mark.skipif(
    importlib.util.find_spec("hydra_plugins.hydra_joblib_launcher") is None, reason="no hydra-joblib-launcher"
)
def test_side_by_side(command):
    """With hydra/launcher=joblib jobs run in processes of their own, and end in the same table and exit code."""
    said = command("run", "-m", *JOB, "model.threshold=0.001,-1", "hydra/launcher=joblib", "hydra.launcher.n_jobs=2")
    assert said.code == 2
    assert [row["status"] for row in rows_of(folder_of(said))] == ["ran", "failed"]
    assert sorted(line.split(":")[0] for line in said.err) == ["job 0 ran", "job 1 failed"]


@pytest.mark.benchmark  # jobs in processes of their own, and the table that they leave, are those of joblib above
@pytest.mark.skipif(
    importlib.util.find_spec("hydra_plugins.hydra_submitit_launcher") is None, reason="no hydra-submitit-launcher"
)
def test_as_slurm_runs_them(tmp_path):
    """With submitit, here its executor on this machine, jobs run in processes of its own and leave the same."""
    argv = ("run", "-m", *JOB, "model.threshold=0.001,-1", "hydra/launcher=submitit_local", "hydra.sweep.dir=sweep")
    done = invdyn(*argv, cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert [row["status"] for row in rows_of(tmp_path / "sweep")] == ["ran", "failed"]


@pytest.mark.benchmark  # what shares a program, what fails and the table are those of the sweeps above
@pytest.mark.skipif(
    importlib.util.find_spec("hydra_plugins.hydra_optuna_sweeper") is None, reason="no hydra-optuna-sweeper"
)
def test_a_search_by_optuna(tmp_path):
    """Optuna makes the validation error small: its best value is the least mean NMSE of all its jobs, a failed one
    counts as infinitely bad, and jobs that it asks for at once share a program."""
    argv = ("run", "-m", "model=ffnn", "model.epochs=2", *TINY, "model.learning_rate=choice(0.0001,0.01,-1)")
    drawn = ("hydra/sweeper=optuna", "hydra.sweeper.sampler.seed=0", "hydra.sweeper.n_trials=6")
    said = invdyn(
        *argv, *drawn, "hydra.sweeper.n_jobs=3", "hydra.sweep.dir=found", cwd=tmp_path
    )  # a process of its own: optuna warns on import
    folder = tmp_path / "found"
    rows = rows_of(folder)
    assert len(rows) == 6, said.stderr
    scores = [
        json.loads((folder / row["folder"] / "metrics.json").read_text())["validation"]["nmse"]["mean"]
        for row in rows
        if row["status"] != "failed"
    ]
    best = yaml.safe_load((folder / "optimization_results.yaml").read_text())
    assert best["best_value"] == min(scores) < max(scores)
    assert best["best_params"]["model.learning_rate"] == 0.01


def test_only_the_jobs_of_this_sweep_count(command):
    """Rows of an earlier, larger sweep in the same folder are not shown, and its failures do not fail this one."""
    assert command("run", "-m", *JOB, "model.threshold=-1,-2", "hydra.sweep.dir=sweep").code == 2
    said = command("run", "-m", *JOB, "hydra.sweep.dir=sweep")
    assert said.code == 0, said.err
    assert [row["status"] for row in rows_of(Path("sweep"))] == ["ran"]


def test_a_log_written_since_is_read_again(command):
    """A complete job on a log is kept while the log stays as it is, and run again when the log is newer."""
    make_log(Path("log.h5"), urdf="")
    argv = ("run", "-m", "model=ffnn", "model.epochs=1", "data=real_log", "data.path=log.h5", "seed=0")
    statuses = []
    for again in (False, False, True):
        if again:
            make_log(Path("log.h5"), urdf="")
        statuses += [row["status"] for row in rows_of(folder_of(command(*argv)))]
    assert statuses == ["ran", "kept", "ran"]
