"""invdyn collect: one table of all runs, as CSV, parquet and on the terminal."""

import csv
import json
import shutil
from pathlib import Path

import pytest

from invdyn_cli.store import METRICS, RUN
from tests.commands import TINY, in_process


def rows_of(path: Path) -> list[dict[str, str]]:
    """The rows of a CSV."""
    return list(csv.DictReader(path.read_text().splitlines()))


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """A folder with two runs of PEST, which differ in an option that one of the commands names."""
    folder = tmp_path_factory.mktemp("made")
    for name, *more in (("a",), ("deep/b", "model.threshold=0.002")):
        done = in_process("run", "model=pest", *TINY, *more, f"hydra.run.dir={name}", cwd=folder)
        assert done == 0
    return folder


@pytest.fixture
def runs(made, command) -> list[dict]:
    """A copy of it: runs/a and runs/deep/b."""
    shutil.copytree(made, "runs")
    return [json.loads(Path(folder, METRICS).read_text()) for folder in ("runs/a", "runs/deep/b")]


def test_one_table_of_all_runs(command, runs):
    """Every run at any depth is a row with what differs, the option's default too, and its scores unrounded; csv and
    parquet hold the same."""
    from pyarrow import parquet

    for name in ("runs.csv", "runs.parquet"):
        said = command("collect", "runs", f"output={name}")
        assert said.code == 0, said.err
        assert said.out[-1] == name
    rows = rows_of(Path("runs.csv"))
    assert [row["run"] for row in rows] == ["runs/a", "runs/deep/b"]
    assert [float(row["model.threshold"]) for row in rows] == [0.001, 0.002]
    assert "data.duration" not in rows[0] and [row["model"] for row in rows] == ["pest", "pest"]
    for row, metrics in zip(rows, runs, strict=True):
        assert float(row["test_nmse"]) == metrics["test"]["nmse"]["mean"]
        assert float(row["fit_seconds"]) == metrics["seconds"]["fit"]
    table = parquet.read_table("runs.parquet").to_pylist()
    assert [row["test_rmse"] for row in table] == [metrics["test"]["rmse"]["mean"] for metrics in runs]
    shown = "\n".join(said.out)
    assert (
        "model.threshold" in shown and "2 runs below runs" in shown and "deep/b" in shown and "sim_noisy" not in shown
    )


def test_a_folder_whose_name_begins_like_an_option(command, runs):
    """It is a folder."""
    Path("runs").rename("hydra_runs")
    assert command("collect", "hydra_runs", "output=runs.csv").code == 0 and len(rows_of(Path("runs.csv"))) == 2


def test_what_is_broken_or_foreign_is_named(command, runs):
    """Half a run, somebody else's metrics.json, a cut run.h5 and a folder that is not there are each told with the
    reason; the good runs are collected."""
    for name in ("half", "foreign", "cut"):
        shutil.copytree("runs/a", f"runs/{name}")
    Path("runs/half", METRICS).unlink()
    Path("runs/foreign", METRICS).write_text('{"accuracy": 1}')
    Path("runs/cut", RUN).write_bytes(Path("runs/a", RUN).read_bytes()[:1000])
    said = command("collect", "runs", "gone", "output=runs.csv")
    assert said.code == 0
    assert len(rows_of(Path("runs.csv"))) == 2
    left = {line.split(": ")[1]: line for line in said.err}
    assert set(left) == {"gone", "runs/cut", "runs/foreign", "runs/half"}
    assert "no such folder" in left["gone"] and "not finished" in left["runs/half"]
    assert "has schema None; allowed: 'invdyn-metrics/1'" in left["runs/foreign"]


@pytest.mark.parametrize("argv", [("nothing",), ("here", "output=runs.xlsx"), ()])
def test_wrong_use(argv, command, tmp_path):
    """No run at all, another format, no folder: exit code 2, and nothing is written."""
    Path("here").mkdir()
    assert command("collect", *argv).code == 2
    assert [path.name for path in tmp_path.rglob("*")] == ["here"]
