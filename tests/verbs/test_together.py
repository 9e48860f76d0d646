"""Sweeps whose jobs are fitted in one program give what the jobs give alone."""

import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import Mock

import jax
import numpy as np
import pytest

from invdyn_cli import load_run
from invdyn_cli.errors import UsageError
from invdyn_cli.models.ffnn import Ffnn, JointNet
from invdyn_cli.verbs import sweep, together
from tests.commands import TINY, usually
from tests.verbs.test_sweep import folder_of, rows_of

NETS = ("model=ffnn", "model.epochs=3", *TINY, "data.filter=central", "data.jitter=0")


def test_a_job_of_one_program_is_the_run_alone(command):
    """Seeds and learning rates in one sweep: folders named by both, and in each what the single run leaves there, with
    the same weights, losses and torques to float32's rounding over 3 epochs."""
    said = command("run", "-m", *NETS, "seed=0,7", "model.learning_rate=0.001,0.004")
    folder = folder_of(said)
    assert said.code == 0, said.err
    assert said.err[0] == "jobs 0 to 3: fitted in one program (they differ in model.learning_rate, seed)"
    assert [row["folder"] for row in rows_of(folder)] == [
        f"{i}-seed{seed}-learning_rate{rate}"
        for i, (seed, rate) in enumerate((s, r) for s in (0, 7) for r in ("0.001", "0.004"))
    ]
    assert command("run", *NETS, "seed=7", "model.learning_rate=0.004", "hydra.run.dir=alone").code == 0
    inside = folder / "3-seed7-learning_rate0.004"
    assert _names(inside) - {"status.json"} == _names(Path("alone"))
    together, alone = load_run(inside / "run.h5"), load_run("alone/run.h5")
    assert together.config == alone.config and together.digest == alone.digest
    assert together.model == alone.model and together.samples == alone.samples
    for a, b in zip(*(jax.tree.leaves(run.fit.params) for run in (together, alone)), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-4)
    np.testing.assert_allclose(
        together.fit.history["train_loss"], alone.fit.history["train_loss"], rtol=1e-3, atol=1e-5
    )
    spread = alone.predictions["test"].data.tau.std(0)
    np.testing.assert_allclose(
        together.predictions["test"].tau / spread, alone.predictions["test"].tau / spread, atol=1e-3
    )
    other = load_run(folder / "0-seed0-learning_rate0.001" / "run.h5")
    assert abs(other.predictions["test"].tau - alone.predictions["test"].tau).max() > 0.01 * spread.min()


def test_what_does_not_belong_together_says_so(command, monkeypatch):
    """Of six jobs, two pairs share a program each (their widths differ), and PEST runs as before, with the reason."""
    Path("model").mkdir()
    Path("model/quick.yaml").write_text("defaults: [ffnn]\nhidden: [4]\nepochs: 1\n")  # options that PEST refuses
    said = command("run", "-m", "model=quick,pest", "seed=0,1", *TINY)
    assert said.code == 0, said.err
    assert said.err[:2] == [
        "jobs 0 to 1: fitted in one program (they differ in seed)",
        "jobs 2 to 3: fitted one by one, because Pest cannot be fitted with others in one program",
    ]
    monkeypatch.setattr(together.experiment, "run", Mock(side_effect=UsageError("enough")))  # it is said before
    said = command("run", "-m", "model=quick", "model.hidden=[4],[5]", *TINY)
    assert said.err[0] == (
        "jobs 0 to 1: fitted one by one, because jobs are fitted in one program only if nothing but seed and learning "
        "rates differs; these jobs also differ in model.hidden"
    )


def test_a_refused_job_leaves_the_others_together(command):
    """One learning rate that is not allowed fails in its row; the other two still share a program."""
    said = command("run", "-m", *NETS, "model.learning_rate=0.001,-1,0.002")
    assert said.code == 2
    assert said.err[0] == "jobs 0, 2: fitted in one program (they differ in model.learning_rate)"
    assert [row["status"] for row in rows_of(folder_of(said))] == ["ran", "failed", "ran"]


def test_other_processes_write_the_files(command, monkeypatch):
    """From so many jobs on as are worth it: each has run and left all of its files; the same command then finds them
    complete."""
    monkeypatch.setattr(together, "WORTH", 3)
    many = ("run", "-m", "model=ffnn", "model.epochs=1", *TINY, "seed=range(3)")
    said = command(*many)
    folder = folder_of(said)
    assert said.code == 0, said.err
    assert [row["status"] for row in rows_of(folder)] == ["ran"] * 3
    for row in rows_of(folder):
        names = _names(folder / row["folder"])
        assert {"run.h5", "metrics.json", "report.html", "status.json", "figures/torques.png"} <= names
        assert load_run(folder / row["folder"] / "run.h5").overrides[-1] == f"seed={row['job']}"
    assert [row["status"] for row in rows_of(folder_of(command(*many)))] == ["kept"] * 3


def test_a_process_that_cannot_write_leaves_it_to_this_one(command, monkeypatch):
    """What the other process raises does not fail the job: this one writes the files."""

    @contextmanager
    def broken():
        executor = Mock()
        executor.submit.return_value.exception.return_value = OSError("no space left")
        yield executor

    monkeypatch.setattr(together, "WORTH", 2)
    monkeypatch.setattr(sweep, "writers", broken)
    said = command("run", "-m", "model=ffnn", "model.epochs=1", *TINY, "seed=0,1")
    folder = folder_of(said)
    assert [row["status"] for row in rows_of(folder)] == ["ran"] * 2
    assert all("run.h5" in _names(folder / row["folder"]) for row in rows_of(folder))


@pytest.mark.benchmark  # test_stops kills other commands
@pytest.mark.skipif(not Path("/proc").is_dir(), reason="processes are looked up in /proc")
def test_processes_that_write_end_with_the_sweep(tmp_path):
    """Killed in the middle of its writing, a sweep leaves no process behind."""
    code = "from invdyn_cli.cli import entry; entry()"
    argv = ("run", "-m", "model=ffnn", "model.epochs=1", *TINY, "seed=range(16)", f"hydra.sweep.dir={tmp_path / 'out'}")
    process = subprocess.Popen([sys.executable, "-c", code, *argv], cwd=tmp_path, stderr=subprocess.DEVNULL)
    wait(lambda: any(tmp_path.glob("out/*/metrics.json")), 120)
    own = children(process.pid)
    assert len(own) > 1
    process.kill()
    process.wait()
    wait(lambda: not any(Path(f"/proc/{pid}").is_dir() for pid in own), 20)


def wait(until: Callable[[], bool], seconds: float) -> None:
    """Wait until that is so; AssertionError if it takes longer."""
    deadline = time.monotonic() + seconds
    while not until():
        assert time.monotonic() < deadline
        time.sleep(0.1)


def children(pid: int) -> list[int]:
    """The processes that this one has started."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text()
    return [int(child) for child in children.split()]


@pytest.mark.benchmark  # the first test has a shared fit and the run alone; adapting is each job's own
def test_adaptation_starts_from_the_shared_fit(command):
    """Jobs with adaptation=incremental share the program of their pretraining, too, and adapt each by itself."""
    adapted = (*NETS, "adaptation=incremental")
    said = command("run", "-m", *adapted, "seed=0,1")
    assert said.code == 0, said.err
    assert said.err[0].startswith("jobs 0 to 1: fitted in one program")
    assert command("run", *adapted, "seed=1", "hydra.run.dir=alone").code == 0
    together, alone = load_run(folder_of(said) / "1-seed1" / "run.h5"), load_run("alone/run.h5")
    a, b = (run.predictions["test_adapted"].tau for run in (together, alone))
    np.testing.assert_allclose(a / b.std(0), b / b.std(0), atol=1e-2)


@pytest.mark.parametrize("seeds", usually([2], [1, 2]))
def test_members_stay_with_their_model(seeds, tiny_dataset):
    """With several networks per joint, each model gets back its own, in order; one diverges alone."""
    rates = (0.001, 0.01, 1e30)
    models = [
        Ffnn(hidden=(4,), learning_rate=x, joints=((2, JointNet((4, 4), x)),), epochs=2, seeds=seeds) for x in rates
    ]
    keys = [jax.random.key(k) for k in range(3)]
    fits = models[0].fit_together(models, tiny_dataset, keys)
    for model, key, fit in zip(models[:2], keys, fits, strict=False):
        alone = model.fit(tiny_dataset, key)
        for a, b in zip(jax.tree.leaves(fit.params), jax.tree.leaves(alone.params), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-4)
        assert fit.parameters == alone.parameters and not fit.warnings
    assert fits[2].warnings


def _names(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def tiny_dataset():
    """Two joints, sines."""
    from invdyn_cli.types import Dataset, Motion, Trajectory

    t = np.arange(200) / 100
    q = np.stack([np.sin(3 * t), np.cos(2 * t)], axis=1)
    return Dataset((Trajectory("one", t, Motion(q, q + 1, q**2), q**3),), ("a", "b"))
