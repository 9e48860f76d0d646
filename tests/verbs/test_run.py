"""invdyn run: what a run leaves, that it can be used and repeated, and that every misuse is one line."""

import json
import os
from pathlib import Path

import h5py
import numpy as np
import pytest
import yaml

from invdyn_cli import load_model, load_run
from invdyn_cli.report import figures
from invdyn_cli.verbs import run as verb
from tests.commands import ROOT, TINY, invdyn, usually
from tests.logs import make_log, motion

NETS = ("model=ffnn", "model.epochs=1")


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """One tiny run by the installed command: its process, and its folder."""
    cwd = tmp_path_factory.mktemp("run")
    done = invdyn("run", *NETS, *TINY, "seed=3", cwd=cwd)
    assert done.returncode == 0, done.stderr
    return done, cwd / done.stdout.splitlines()[-1]


def test_leaves_its_files(finished):
    """The last line that a run prints is its folder, which holds run.h5, metrics.json, figures and the page."""
    _, folder = finished
    assert folder.relative_to(folder.parents[3]).parts[:2] == ("outputs", "runs")
    names = {p.name for p in folder.iterdir() if not p.name.startswith(".")}
    assert names == {"run.h5", "metrics.json", "figures", "report.html"}
    assert {p.suffix for p in (folder / "figures").iterdir()} == {".png"}
    assert len(list((folder / "figures").iterdir())) >= 4
    assert "<html" in (folder / "report.html").read_text()


def test_says_nothing_on_stderr(finished):
    """Where progress is turned off, a run leaves no trace on stderr: logs of other programs stay readable."""
    assert finished[0].stderr == ""


def test_metrics_have_the_fixed_schema(finished):
    """metrics.json has the keys of its schema, a number per joint, and the command's choices."""
    metrics = json.loads((finished[1] / "metrics.json").read_text())
    assert metrics["schema"] == "invdyn-metrics/1"
    assert [metrics[k] for k in ("model", "data", "adaptation", "seed")] == ["ffnn", "sim_noisy", "batch", 3]
    joints = metrics["joints"]
    assert len(joints) == 2
    for name in ("train", "validation", "test"):
        for kind in ("nmse", "rmse"):
            assert list(metrics[name][kind]["joint"]) == joints
            assert metrics[name][kind]["mean"] == pytest.approx(np.mean(list(metrics[name][kind]["joint"].values())))
    assert {"fit", "predict", "total"} <= set(metrics["seconds"])
    assert metrics["samples"]["train"] > metrics["samples"]["test"] > 0
    assert isinstance(metrics["parameters"], int)


def test_three_lines_of_python(finished):
    """The model loaded from run.h5 predicts what the run stored."""
    path = finished[1] / "run.h5"
    model = load_model(path)
    stored = load_run(path).predictions["test"]
    motion = stored.data.motion
    tau = model.predict(motion.q, motion.qd, motion.qdd)
    assert tau.shape == motion.q.shape
    np.testing.assert_allclose(tau, stored.tau, rtol=1e-5, atol=1e-6)


def test_records_where_it_came_from(finished):
    """run.h5 holds the resolved config, the overrides, versions, device, the data's hash and the split."""
    record = load_run(finished[1] / "run.h5")
    assert yaml.safe_load(record.config)["model"]["epochs"] == 1
    assert record.overrides == (*NETS, *TINY, "seed=3")
    assert {"python", "jax", "numpy", "pin"} <= set(record.provenance["versions"])
    assert record.provenance["device"]
    assert len(record.digest) == 16
    assert record.split["test_Hz"] == [0.5, 0.6]


ADAPTS = ("data=pick_place", "data.repetitions=1", "data.watched=0", "data.decimate=10", "robot.dofs=2", *NETS)


LEARNS = [("incremental", "adaptation.learning_rate"), ("error_model", "adaptation.incremental.learning_rate")]


@pytest.mark.parametrize(("adaptation", "option"), usually(LEARNS[:1], LEARNS))
def test_learning_that_diverges_ends_well(adaptation, option, command):
    """Steps far too large: exit code 0, all files, one warning with the option that this adaptation has, on the
    terminal and the page; the adapted scores are null and as learned they are not."""
    said = command("run", *ADAPTS, f"adaptation={adaptation}", f"{option}=1000")
    assert (said.code, said.err) == (0, [])
    text = " ".join(said.out)
    assert text.count("diverged") == 1 and "s of loaded_1: its torques are not finite from there on" in text
    assert f"; a lower {option} may help" in text
    folder = Path(said.out[-1])
    assert (folder / "figures" / "adaptation.png").is_file()
    assert f"a lower {option} may help" in (folder / "report.html").read_text()
    metrics = json.loads((folder / "metrics.json").read_text())
    assert metrics["test_adapted"]["nmse"]["mean"] is None and metrics["test"]["nmse"]["mean"] > 0
    assert metrics["adaptation_scores"]["nmse"]["mean"] is None


@pytest.mark.parametrize("adaptation", usually(["incremental"], ["incremental", "payload"]))
def test_a_rate_beyond_the_test_set(adaptation, command):
    """No whole block: nothing is learned in one, no update is timed, and the run is whole."""
    said = command("run", *ADAPTS, f"adaptation={adaptation}", "adaptation.rate=100000")
    assert (said.code, said.err) == (0, [])
    metrics = json.loads(Path(said.out[-1], "metrics.json").read_text())
    assert metrics["test_adapted"]["nmse"]["mean"] > 0
    assert metrics["adaptation_scores"]["updates"] == 0
    assert metrics["adaptation_scores"]["seconds_per_update"] == {"p50": None, "p99": None}


def test_can_be_repeated(finished, command):
    """The same command gives the same scores in another process; another seed gives others."""
    scores = {}
    for seed in (3, 4):
        said = command("run", *NETS, *TINY, f"seed={seed}", f"hydra.run.dir=seed_{seed}", "figures.formats=[svg]")
        assert said.code == 0
        assert said.out[-1] == f"seed_{seed}"
        scores[seed] = json.loads(Path(said.out[-1], "metrics.json").read_text())["test"]["nmse"]["mean"]
    before = json.loads((finished[1] / "metrics.json").read_text())["test"]["nmse"]["mean"]
    assert scores[3] == pytest.approx(before, rel=1e-6)
    assert scores[4] != pytest.approx(before, rel=1e-3)
    assert {p.suffix for p in Path("seed_3/figures").iterdir()} == {".png", ".svg"}


def test_a_log_without_urdf(command):
    """Nets learn from a log that brings no URDF; its joints are the log's."""
    make_log(Path("log.h5"), urdf="")
    said = command("run", *NETS, "data=real_log", "data.path=log.h5")
    assert said.code == 0, said.err
    assert json.loads(Path(said.out[-1], "metrics.json").read_text())["joints"] == ["shoulder", "elbow"]


def test_a_log_whose_urdf_is_not_there_still_serves_a_net(command):
    """A model that needs no kinematics runs on a log that names a missing URDF, with a word; PEST is refused."""
    make_log(Path("log.h5"), urdf="gone.urdf")
    said = command("run", *NETS, "data=real_log", "data.path=log.h5")
    assert said.code == 0, said.err
    assert "gone.urdf" in "".join(said.out)
    assert command("run", "model=pest", "data=real_log", "data.path=log.h5").code == 2


def test_a_model_that_cannot_be_stored_is_refused_before_it_learns(command):
    """A class that is no dataclass is refused in one line, and nothing is written."""
    Path("odd.py").write_text(
        "from invdyn_cli.interfaces import AbstractModel\n"
        "class Odd(AbstractModel):\n"
        "    init = apply = fit = lambda *a, **k: None\n"
    )
    Path("model").mkdir()
    Path("model/odd.yaml").write_text("_target_: odd.Odd\n")
    said = command("run", "model=odd", "hydra.run.dir=out")
    assert said.code == 2 and len(said.err) == 1 and "frozen dataclass" in said.err[0]
    assert not list(Path().glob("out/*.h5"))


def broken_log(**header):
    """Makes log.h5 without a URDF; trajectories=… in place of a sound one."""
    trajectories = header.pop("trajectories", None)
    return lambda: make_log(Path("log.h5"), trajectories, **{"urdf": "", **header})


def cut_off():
    """A log that lost its second half."""
    path = make_log(Path("log.h5"), urdf="")
    os.truncate(path, path.stat().st_size // 2)


def changed(channel, row, value):
    """A log of one trajectory in which one row of a channel has another value."""
    channels = motion()
    channels[channel][row] = value
    return broken_log(trajectories={"run": channels})


def with_other_urdf():
    """A sound log, and a file that ends inside its first tag."""
    make_log(Path("log.h5"), urdf="")
    Path("arm.urdf").write_text('<robot name="arm"><link')


LOG = ("data=real_log", "data.path=log.h5", *NETS)
NO_FILES = tuple
MISUSE = {
    "misspelt option": (NO_FILES, (*NETS, "model.epoch=1"), "model.epoch; allowed: ", "did you mean 'model.epochs'?"),
    "misspelt group": (NO_FILES, ("modle=ffnn",), "modle", "did you mean 'model'?"),
    "misspelt choice": (NO_FILES, ("model=fnn",), "model=fnn; allowed: ", "did you mean 'ffnn'?"),
    "no override": (NO_FILES, ("model",), "'model'", "group=choice, option=value"),
    "wrong type": (NO_FILES, ("model=ffnn", "model.epochs=many"), "model.epochs=many; allowed: a whole number"),
    "wrong word": (NO_FILES, ("data.split=both",), "data.split=both; allowed: interpolation, extrapolation"),
    "wrong type in list": (NO_FILES, ("model=ffnn", "model.hidden=[a]"), "model.hidden", "a list, each a whole number"),
    "wrong number": (NO_FILES, ("model=ffnn", "model.epochs=0"), "model.epochs=0; allowed: a whole number >= 1"),
    "wrong seed": (NO_FILES, ("seed=-1",), "seed=-1; allowed: a whole number from 0 to"),
    "wrong format": (NO_FILES, ("figures.formats=[bmp]",), "figures.formats", "png, svg, pdf"),
    "too much": (NO_FILES, ("data.duration=1e10",), "data.duration", "allowed"),
    "too many joints": (NO_FILES, ("robot.dofs=9",), "robot.dofs=9; allowed: 1 to 7"),
    "no class": (NO_FILES, ("model._target_=nowhere.Model",), "No module named 'nowhere'"),
    "no path": (NO_FILES, ("data=real_log",), "data.path is not set. Try: data.path="),
    "no log": (broken_log(), ("data=real_log", "data.path=lag.h5"), "no log lag.h5, did you mean 'log.h5'?"),
    "not HDF5": (lambda: Path("log.h5").write_text("t,q,tau\n"), LOG, "not an HDF5 file", "docs/logs.md"),
    "cut off": (cut_off, LOG, "log.h5 is cut off or corrupt"),
    "no log format": (broken_log(format="other"), LOG, "attribute format is other; allowed: invdyn-log"),
    "wrong version": (broken_log(version=2), LOG, "version is 2; allowed: 1"),
    "NaN": (changed("tau", 7, np.nan), LOG, "tau of joint shoulder is nan in row 7"),
    "infinite": (changed("q", 8, np.inf), LOG, "q of joint shoulder is inf in row 8"),
    "time backwards": (changed("t", 50, 0.1), LOG, "time runs backwards in row 50"),
    "time repeats": (changed("t", 50, 0.49), LOG, "time repeats in row 50"),
    "lengths differ": (
        broken_log(trajectories={"run": {**motion(), "tau": np.zeros((999, 2))}}),
        LOG,
        "tau has shape (999, 2); allowed: 1000 rows, one for each sample of t",
    ),
    "no gains": (broken_log(torque_unit="A"), LOG, "torque_unit is 'A'", "data.drive_gain=[…], 2 numbers"),
    "too short": (broken_log(trajectories={"run": motion(seconds=0.3)}), LOG, "samples at 100 Hz are needed for"),
    "no trajectory": (broken_log(), (*LOG, "data.train=[walk]"), "walk", "run"),
    "no URDF": (
        broken_log(),
        ("data=real_log", "data.path=log.h5", "model=pest"),
        "Pest needs the robot's kinematics",
        "model=ffnn",
    ),
    "URDF missing": (broken_log(), (*LOG, "robot=urdf", "robot.path=arm.urdf"), "no robot description at 'arm.urdf'"),
    "URDF broken": (with_other_urdf, (*LOG, "robot=urdf", "robot.path=arm.urdf"), "arm.urdf is not XML"),
    "URDF of another": (broken_log(), (*LOG, "robot=apollo_arm"), "no moving joint 'shoulder'; allowed: arm_joint_1"),
    "file in the way": (lambda: Path("taken").touch(), ("hydra.run.dir=taken/run",), "taken", "hydra.run.dir"),
}  # fmt: skip


@pytest.mark.parametrize("case", MISUSE)
def test_misuse_is_one_line(case, command, tmp_path):
    """Wrong use: exit code 2, one line on stderr that says what was got and what is allowed or to try, no run left."""
    prepare, argv, *words = MISUSE[case]
    prepare()
    said = command("run", *argv)
    assert said.code == 2
    assert len(said.err) == 1, said.err
    assert said.err[0].startswith("invdyn: ")
    assert [word for word in words if word not in said.err[0]] == []
    assert not [p for p in tmp_path.rglob("*") if p.name in ("run.h5", "metrics.json", "report.html", "figures")]


def test_misuse_of_the_installed_command(tmp_path):
    """The installed command too gives exit code 2 and one line, no traceback."""
    said = invdyn("run", "modle=ffnn", cwd=tmp_path)
    assert (said.returncode, said.stdout) == (2, "")
    assert len(said.stderr.splitlines()) == 1


def test_stopped(command, monkeypatch):
    """Ctrl-C goes through a run to whoever called it, and the folder that it began is gone."""

    def interrupted(*args, **kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr(verb.experiment, "run", interrupted)
    with pytest.raises(KeyboardInterrupt):
        command("run", *NETS, *TINY)
    assert not Path("outputs").exists()


def test_a_bug_keeps_its_traceback(command, monkeypatch):
    """An error of ours is one line with exit code 3, which names the file that holds its traceback."""
    monkeypatch.setattr(verb.experiment, "run", lambda *args, **kwargs: 1 / 0)
    said = command("run", *NETS, *TINY)
    assert (said.code, len(said.err)) == (3, 1)
    assert "ZeroDivisionError: division by zero" in said.err[0] and "report it" in said.err[0]
    assert "1 / 0" in Path(said.err[0].rsplit(" ", 1)[1]).read_text()


def test_a_refused_command_leaves_no_folder(command, tmp_path):
    """What is refused after Hydra made its folder leaves none; folders that were there before stay."""
    assert command("run", "model=pest", "model.threshold=-1").code == 2
    assert not list(tmp_path.iterdir())
    (tmp_path / "mine").mkdir()
    assert command("run", "model=pest", "model.threshold=-1", "hydra.run.dir=mine").code == 2
    assert [p.name for p in tmp_path.rglob("*")] == ["mine"]
    assert command("tables", "experiment=nope").code == 2
    assert command("report", "nowhere").code == 2
    assert [p.name for p in tmp_path.rglob("*")] == ["mine"]


def test_a_new_run_in_an_old_folder_starts_incomplete(command, monkeypatch):
    """Where a run is written over another one and dies while drawing, no metrics.json claims that it is complete."""
    argv = ("run", *NETS, *TINY, "hydra.run.dir=here")
    assert command(*argv).code == 0

    def dies(*args, **kwargs):
        raise OSError(28, "No space left on device", "here/figures")

    monkeypatch.setattr(figures, "draw_all", dies)
    said = command(*argv)
    assert said.code == 2
    assert "No space left on device" in said.err[0]
    assert not Path("here/metrics.json").exists()
    with h5py.File("here/run.h5") as file:
        assert file.attrs["schema"] == "invdyn-run/1"


def test_help_holds_no_path_of_this_machine(command, tmp_path):
    """`invdyn run --help` reads the same on every machine; what it says is tested in test_options.py."""
    text = "\n".join(command("run", "--help").out)
    assert "model.epochs=100" in text
    assert str(ROOT) not in text
    assert str(tmp_path) not in text


def test_shows_its_config(command):
    """`--cfg job` prints the config that would run, as YAML, and runs nothing."""
    said = command("run", "model=pest", "seed=7", "--cfg", "job")
    config = yaml.safe_load("\n".join(said.out))
    assert said.code == 0
    assert config["seed"] == 7
    assert config["model"]["_target_"] == "invdyn_cli.models.pest.Pest"
    assert not Path("outputs").exists()
