"""Names of result folders, outputs/latest, and refused commands, which leave no folder."""

from pathlib import Path

import numpy as np
import pytest

from invdyn_cli.verbs import folders
from tests.commands import TINY

PEST = ("model=pest", *TINY)


def make_csv(path: Path) -> None:
    """A log in another format, without a URDF."""
    t = np.arange(200) / 100
    rows = np.column_stack([t, np.sin(5 * t), np.cos(3 * t), np.cos(5 * t), np.sin(3 * t)])
    np.savetxt(path, rows, delimiter=",", header="t,q1,q2,tau1,tau2", comments="")


def test_a_run_is_called_after_its_job_and_is_the_latest(command):
    """The folder's name has model, data, adaptation and seed; outputs/latest is a relative link to the newest one."""
    for seed in (3, 4):
        said = command("run", *PEST, f"seed={seed}")
        assert said.code == 0, said.err
        assert said.out[-1].endswith(f"-pest-sim_noisy-batch-seed{seed}")
        link = Path("outputs/latest")
        assert link.resolve() == Path(said.out[-1]).resolve() and not link.readlink().is_absolute()
    assert command("run", *PEST, "model.threshold=-1").code == 2
    assert command("run", *PEST, "hydra.run.dir=elsewhere").code == 0
    assert link.resolve() == Path(said.out[-1]).resolve()


def test_where_links_are_not_possible_latest_is_a_text_file(tmp_path, monkeypatch):
    """It holds the path; a folder that somebody made in its place stays."""
    monkeypatch.chdir(tmp_path)

    def refused(*args, **kwargs):
        raise OSError("no links here")

    monkeypatch.setattr(Path, "symlink_to", refused)
    Path("outputs/runs/one").mkdir(parents=True)
    folders.point_to(Path("outputs/runs/one"))
    assert Path("outputs/latest").read_text() == "runs/one\n"
    Path("outputs/latest").unlink()
    Path("outputs/latest").mkdir()
    folders.point_to(Path("outputs/runs/one"))
    assert Path("outputs/latest").is_dir() and sorted(x.name for x in Path("outputs").iterdir()) == ["latest", "runs"]


def test_names_of_sweeps(tmp_path, monkeypatch):
    """Sweeps are called after their jobs, safely and shortly; one whose name is taken by another gets a number, and
    each finds its own folder again."""
    monkeypatch.chdir(tmp_path)
    defaults = {"model": "ffnn", "data": "sim_noisy", "adaptation": "batch"}
    first = folders.sweep_folder(["model=pest,ffnn", "seed=0,1"], defaults)
    assert first == Path("outputs/sweeps/pest+ffnn-sim_noisy-batch-seed0+1")
    odd = folders.sweep_folder([f"data.path=../{'x' * 300}/a b,[c]"], defaults)
    assert odd.parent == Path("outputs/sweeps") and len(odd.name) <= 110 and not set(odd.name) & set("/ [],'")
    for number, overrides in enumerate((["data.a=x y"], ["data.a=x_y"]), 1):
        made = folders.sweep_folder(overrides, defaults)
        assert made.name == "ffnn-sim_noisy-batch-ax_y" + ("-2" if number == 2 else "")
        made.mkdir(parents=True)
        (made / "multirun.yaml").write_text(f"hydra: {{overrides: {{task: {overrides}}}}}")
    assert folders.sweep_folder(["data.a=x_y"], defaults).name.endswith("-2")


@pytest.mark.parametrize(
    "argv",
    [
        ("run", "data=real_log", "data.path=log.csv", "model=pest"),
        ("diagnose", "data.path=log.csv", "robot.path=gone.urdf"),
        ("check", "-m", "data.path=gone.h5,gone2.h5"),
        ("simulate", "data.effects=[{effect: nope}]"),
        ("excite",),
    ],
)
def test_a_refused_command_leaves_no_folder(argv, command, tmp_path):
    """Exit code 2 and nothing new, also where a file of another format was read first, and of a sweep."""
    make_csv(Path("log.csv"))
    assert command(*argv).code == 2
    assert [path.name for path in tmp_path.rglob("*")] == ["log.csv"]


def test_the_column_map_of_a_finished_command_is_kept(command):
    """A check of a file of another format leaves its map beside the results."""
    make_csv(Path("log.csv"))
    said = command("check", "data.path=log.csv")
    assert said.code == 0, said.err
    assert said.out[-1].endswith("-log")
    assert (Path(said.out[-1]) / "log.columns.yaml").is_file() and (Path(said.out[-1]) / "check.json").is_file()


def test_a_job_is_called_after_what_differs():
    """Its number, then choices and values of the keys that are swept; a path by its file, nothing that a file system
    would take amiss, and not more than a hundred characters."""
    argv = ["-m", "model=pest,ffnn", "+data.extra=1", "data=real_log", "data.path=a/x.h5,b/x.h5", "seed=range(3)"]
    [override] = folders.of_jobs(argv)
    assert override == "hydra.job.config.override_dirname.exclude_keys=['data.extra','data']"
    assert folders.of_jobs(argv[1:]) == []
    job = ["model=ffnn", "+data.extra=1", "data=real_log", "data.path=b/x.h5", "seed=2"]
    assert folders.job_folder(5, job, ["data.extra", "data"]) == "5-ffnn-x-seed2"
    assert folders.job_folder(0, ["model.hidden=[10,20]"], []) == "0-hidden10_20"
    odd = folders.job_folder(1, [f"a.b={'/ ' * 300}", f"c={'x' * 300}", f"d={'x' * 300}"], [])
    assert len(odd) <= 100 and not set(odd) & set("/ ")
    assert folders.job_folder(7, [], []) == "7"
