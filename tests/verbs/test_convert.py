"""invdyn convert: what it prints and writes; and the same files behind data.path=."""

from pathlib import Path

import numpy as np
import pytest

from invdyn_cli.logfile import read_log
from tests.formats.recordings import bag2, csv, named, recording, write_csv


@pytest.fixture
def run(tmp_path) -> Path:
    """run.csv in the test's folder."""
    return csv(tmp_path, recording())


def test_a_csv(command, run):
    """The mapping is a table that says how each entry is known, the log is written whole, its path comes last."""
    said = command("convert", "run.csv", "log.h5")
    assert said.code == 0, said.err
    text = "\n".join(said.out)
    for line in ("q_shoulder … q_elbow (2)", "guessed from the name; unit guessed from values", "1000 rows, 100 Hz"):
        assert line in text
    assert "torque side is unknown" in text and said.out[-1] == "log.h5"
    log = read_log("log.h5")
    data = recording()
    for channel, expected in data.items():
        np.testing.assert_allclose(getattr(log.trajectories[0], channel), expected, atol=1e-9)
    assert log.history[0] == "converted from run.csv" and log.torque_side == "unknown"
    assert sorted(p.name for p in Path().iterdir()) == ["log.columns.yaml", "log.h5", "run.csv"]


def test_the_map_serves_again(command, run):
    """The map that was written gives the same log, now as given; the command line wins over it."""
    assert command("convert", "run.csv", "log.h5", "torque_side=link", "tau.sign=-1").code == 0
    said = command("convert", "run.csv", "again.h5", "columns=log.columns.yaml", "robot_name=arm")
    assert said.code == 0 and "guessed" not in "\n".join(said.out)
    one, two = read_log("log.h5"), read_log("again.h5")
    np.testing.assert_array_equal(one.trajectories[0].tau, two.trajectories[0].tau)
    np.testing.assert_allclose(two.trajectories[0].tau, -recording()["tau"], atol=1e-9)
    assert (two.torque_side, two.robot) == ("link", "arm")


def test_several_files(command, tmp_path):
    """Files are trajectories of one log, by the stems of their names; names may have spaces and quotes in them."""
    data = recording()
    names = ["run a.csv", "run 'b'.csv"]
    for name in names:
        write_csv(tmp_path / name, named(data, q="q_{}", tau="tau_{}"))
    said = command("convert", *names, "log.h5")
    assert said.code == 0, said.err
    assert {x.name for x in read_log("log.h5").trajectories} == {"run a", "run 'b'"}


def test_it_overwrites_nothing(command, run):
    """A log that is there already stays, unless force=true."""
    Path("log.h5").write_text("mine")
    said = command("convert", "run.csv", "log.h5")
    assert said.code == 2 and "force=true" in said.err[0] and Path("log.h5").read_text() == "mine"
    assert command("convert", "run.csv", "log.h5", "force=true").code == 0
    assert len(read_log("log.h5").trajectories) == 1


@pytest.mark.parametrize(
    ("argv", "line"),
    [
        (["run.csv"], "output is not set"),
        (["nowhere.csv", "log.h5"], "no file nowhere.csv"),
        (["run.csv", "log.txt"], "allowed: the path of a new log, NAME.h5"),
        (["run.csv", "log.h5", "q.unit=parsec"], "convert: q.unit=parsec; allowed: rad, deg"),
        (["run.csv", "log.h5", "q.colums=[a]"], "q.colums"),
        (["run.csv", "log.h5", "q.columns=[a,b]"], "no column 'a'; allowed: t, q_shoulder"),
        (["run.csv", "log.h5", "q.sign=[1,1,1]"], "q.sign has 3 values; allowed: 1, or 2"),
        (["run.csv", "log.h5", "joints=[a,a]"], "allowed: a name for each column, each once"),
        (["run.csv", "log.h5", "drive_gain=[1,2]"], "drive_gain is given, but tau is not a current"),
        (["run.csv", "log.h5", "columns=nowhere.yaml"], "nowhere.yaml does not exist"),
        (["run.csv", "log.h5", "drive_gain=[a]"], "drive_gain=a; allowed: a number"),
        (["run.csv", "log.h5", "max_size=1e-9"], "allowed: 1e-09 GB"),
    ],
)
def test_wrong_use(argv, line, command, run):
    """Wrong use is one line and exit code 2, and nothing is written."""
    said = command("convert", *argv)
    assert said.code == 2 and len(said.err) == 1 and line in said.err[0], said.err
    assert [p.name for p in Path().iterdir()] == ["run.csv"]


def test_what_is_left_open_is_asked(command, tmp_path):
    """A column that may be two things is asked for in one line with the options that answer; the answer is enough."""
    data = recording()
    write_csv(tmp_path / "run.csv", named(data | {"q": 0.1 * data["q"]}, q="q_{}", tau="load_{}"))
    said = command("convert", "run.csv", "log.h5")
    assert said.code == 2 and len(said.err) == 1
    assert "the unit of q" in said.err[0] and "the unit of tau" in said.err[0] and "q.unit=rad|deg" in said.err[0]
    said = command("convert", "run.csv", "log.h5", "q.unit=rad", "tau.unit=percent")
    assert said.code == 0 and "percent of full scale" in "\n".join(said.out)


def test_check_reads_other_formats(command, tmp_path):
    """`invdyn check` takes a csv and a bag as data.path, shows how it reads them, and keeps the map in its folder."""
    data = recording()
    csv(tmp_path, data)
    bag2(tmp_path, data)
    for path, name in (("run.csv", "run"), ("bag", "bag")):
        said = command("check", f"data.path={path}")
        assert said.code == 0, said.err
        assert said.out[0] == f"{path} is read as:" and "The log is usable" in "\n".join(said.out)
        assert Path(said.out[-1], f"{name}.columns.yaml").is_file() and Path(said.out[-1], "check.json").is_file()


def test_run_reads_other_formats(command, run):
    """`invdyn run` learns from a csv, with a map of its own."""
    Path("map.yaml").write_text("tau: {unit: N m, sign: -1}\n")
    options = ("model=ffnn", "model.epochs=1", "model.hidden=[4]", "data.columns=map.yaml")
    said = command("run", "data=real_log", "data.path=run.csv", *options)
    assert said.code == 0, said.err
    assert "run.csv is read as:" in said.out and "-" in next(x for x in said.out if x.startswith(" tau"))


def test_no_torques(command, tmp_path):
    """A log without torques is written and checked; that it has none is said, and `run` refuses it in a line."""
    write_csv(tmp_path / "run.csv", named(recording(), q="present_position_{}"))
    said = command("convert", "run.csv", "log.h5")
    assert said.code == 0 and "no torques or currents" in "\n".join(said.out)
    assert np.isnan(read_log("log.h5", check=False).trajectories[0].tau).all()
    assert command("check", "data.path=log.h5").code == 0
    said = command("run", "data=real_log", "data.path=log.h5", "model=ffnn")
    assert said.code == 2 and "tau" in said.err[0]


def test_real_files(command, real_data):
    """A UR10e's csv without header: clock, positions and velocities are found, the torque is asked for; with the
    answer its currents come out as in the log that was made of it by hand."""
    path = str(real_data("csv/ur-20_02_19_14harm50sec.csv"))
    said = command("convert", path, "log.h5")
    assert said.code == 2 and "tau: c14:c19, c20:c25, c26:c31" in said.err[0]
    said = command("convert", path, "log.h5", "tau.columns=c14:c19", "tau.unit=A")
    assert said.code == 0, said.err
    known = read_log(real_data("ur10e.h5"), ["pair2_unloaded"]).trajectories[0]
    made = read_log("log.h5", check=False).trajectories[0]
    for channel, digits in (("t", 1e-9), ("q", 1e-9), ("qd", 1e-6), ("tau", 1e-5)):
        np.testing.assert_allclose(getattr(made, channel), getattr(known, channel), atol=digits, err_msg=channel)
