"""Trackers: what each tool has of a finished run, read back by the tool; a missing library; a tracker of one's own."""

import importlib.util
import json
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from invdyn_cli import load_run
from invdyn_cli.tracking import contract
from invdyn_cli.tracking.contract import Tracked
from invdyn_cli.tracking.mlflow import Mlflow
from tests.commands import TINY

RUN = ("run", "model=ffnn", "model.epochs=2", *TINY)


@pytest.fixture
def run(tmp_path) -> Tracked:
    """A run with a picture, a loss of three epochs, a number and a long parameter."""
    from matplotlib.image import imsave

    for name in ("torques.png", "report.html"):
        (tmp_path / name).write_text("<html>")
    imsave(tmp_path / "torques.png", np.linspace(0, 1, 48).reshape(4, 4, 3))
    files = [tmp_path / "torques.png", tmp_path / "report.html"]
    params = {"model.hidden": "[100]", "data.path": "x" * 900}
    return Tracked("one", tmp_path, params, {"test.nmse.mean": 0.25}, {"train_loss": np.array([3.0, 2.0, 1.0])}, files)


def needs(module: str) -> None:
    """Skips where a library is not installed."""
    if importlib.util.find_spec(module) is None:
        pytest.skip(f"{module} is not installed")


def test_mlflow(run, tmp_path, monkeypatch):
    """MLflow's own client reads back parameters, the metric, the loss of every epoch, and both files."""
    needs("mlflow")
    monkeypatch.chdir(tmp_path)
    Mlflow(uri="mlruns", experiment="arm").track(run)
    from mlflow import MlflowClient

    client = MlflowClient(tracking_uri="mlruns")
    experiment = client.get_experiment_by_name("arm")
    assert experiment is not None
    [found] = client.search_runs([experiment.experiment_id])
    assert found.info.status == "FINISHED" and found.info.run_name == "one"
    assert found.data.params["model.hidden"] == "[100]"
    assert found.data.metrics["test.nmse.mean"] == 0.25
    assert [x.value for x in client.get_metric_history(found.info.run_id, "train_loss")] == [3.0, 2.0, 1.0]
    names = [x.path for place in (None, "figures") for x in client.list_artifacts(found.info.run_id, place)]
    assert {"report.html", "figures/torques.png"} <= set(names)


def test_tensorboard(run, tmp_path):
    """TensorBoard's own reader finds the metric, the loss of every epoch and the figure."""
    needs("tensorboardX")
    needs("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    from invdyn_cli.tracking.tensorboard import Tensorboard

    Tensorboard(folder=str(tmp_path / "events")).track(run)
    found = EventAccumulator(str(tmp_path / "events" / "one")).Reload()
    assert [(x.step, x.value) for x in found.Scalars("train_loss")] == [(0, 3.0), (1, 2.0), (2, 1.0)]
    assert found.Scalars("test.nmse.mean")[0].value == 0.25
    assert found.Tags()["images"] == ["torques"]
    assert "params/text_summary" in found.Tags()["tensors"]


def test_wandb_is_offline(run, tmp_path, monkeypatch):
    """Without being asked wandb sends nothing: it leaves an offline run, with the loss and the metric in it."""
    needs("wandb")
    for name in ("WANDB_DIR", "WANDB_CACHE_DIR", "WANDB_CONFIG_DIR", "WANDB_DATA_DIR"):
        monkeypatch.setenv(name, str(tmp_path))
    from invdyn_cli.tracking.wandb import Wandb

    Wandb(folder=str(tmp_path / "wandb")).track(run)
    [log] = (tmp_path / "wandb").rglob("offline-run-*/*.wandb")
    content = log.read_bytes()
    assert all(word in content for word in (b"train_loss", b"test.nmse.mean", b"model.hidden", b"[100]"))


def test_what_a_run_hands_on(command):
    """A tracker of one's own, a file and a YAML, gets the resolved config, the numbers of metrics.json, a loss for
    every epoch, and the files."""
    Path("mine.py").write_text(
        "import json\n"
        "from dataclasses import dataclass\n"
        "from pathlib import Path\n"
        "from invdyn_cli.tracking.contract import AbstractTracker\n"
        "@dataclass(frozen=True)\n"
        "class Mine(AbstractTracker):\n"
        "    target: str = 'tracked.json'\n"
        "    def track(self, run):\n"
        "        losses = {k: list(x) for k, x in run.losses.items()}\n"
        "        kept = [run.name, dict(run.params), dict(run.metrics), losses, [x.name for x in run.files]]\n"
        "        Path(self.target).write_text(json.dumps(kept))\n"
    )
    Path("tracker").mkdir()
    Path("tracker/mine.yaml").write_text("# Mine.\n_target_: mine.Mine\ntarget: kept.json\n")
    said = command(*RUN, "tracker=mine")
    assert (said.code, said.err) == (0, [])
    folder = Path(said.out[-1])
    name, params, metrics, losses, files = json.loads(Path("kept.json").read_text())
    assert name == f"{folder.parent.name}-{folder.name}"
    assert params["model.epochs"] == "2" and params["tracker.target"] == "kept.json"
    left = json.loads((folder / "metrics.json").read_text())
    assert metrics["test.rmse.mean"] == left["test"]["rmse"]["mean"] and metrics["seed"] == 0
    history = load_run(folder / "run.h5").fit.history["train_loss"]
    np.testing.assert_allclose(losses["train_loss"], history.mean(axis=(1, 2)))
    assert {"report.html", "torques.png"} <= set(files)


def test_a_missing_library_is_refused_before_anything_is_learned(command, monkeypatch):
    """One line says what to install; no folder is left."""
    real = importlib.util.find_spec
    monkeypatch.setattr(contract.importlib.util, "find_spec", lambda x, *y: None if x == "mlflow" else real(x, *y))
    said = command(*RUN, "tracker=mlflow")
    assert (said.code, len(said.err)) == (2, 1)
    assert "needs the library mlflow" in said.err[0] and "pip install 'invdyn[mlflow]'" in said.err[0]
    assert not Path("outputs").exists()


def test_a_tracker_that_fails_leaves_the_run_whole(command, monkeypatch):
    """The run is complete, exit code 0, and one line says that it was not tracked."""

    def away(*args):
        raise ConnectionError("no server")

    monkeypatch.setattr(Mlflow, "track", away)
    monkeypatch.setattr(Mlflow, "library", "")
    said = command(*RUN, "tracker=mlflow")
    assert said.code == 0 and (Path(said.out[-1]) / "metrics.json").is_file()
    assert said.err == ["invdyn: the run is complete, but was not tracked: ConnectionError: no server"]


def test_curves_and_numbers():
    """Means over members and joints; curves and numbers that are not finite are left out, and so are words."""
    history = {"train_loss": np.arange(12.0).reshape(3, 2, 2), "validation_loss": np.full((3, 1, 2), np.nan)}
    assert {k: list(x) for k, x in contract.mean_curves(history).items()} == {"train_loss": [1.5, 5.5, 9.5]}
    assert contract.numbers({"a": {"b": 1, "c": None, "d": "x"}, "e": float("nan"), "f": True}) == {"a.b": 1.0}
    assert [one.name for one in fields(Mlflow)] == ["uri", "experiment"]
