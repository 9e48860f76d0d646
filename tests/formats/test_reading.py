"""Logs of every format: the same recording gives the same log, files that are none give one line."""

import numpy as np
import pytest

from invdyn_cli.data.recorded import RealLog
from invdyn_cli.errors import LogError, UsageError
from invdyn_cli.formats import reading
from invdyn_cli.formats.columns import ColumnMap
from invdyn_cli.formats.reading import import_one, imported, is_foreign, read_log, trajectory_names
from tests.formats.recordings import JOINTS, WRITERS, csv, named, recording, write_csv
from tests.logs import make_log

UNITS = {"lerobot": {"q": {"unit": "rad"}, "tau": {"unit": "N m"}}}
"""What a format cannot tell."""


@pytest.mark.parametrize("kind", WRITERS)
def test_every_format_gives_the_same_log(kind, tmp_path):
    """One recording in any format is read into t, q, qd and tau that agree to 1e-9, in the order of the joints."""
    data = recording()
    path = WRITERS[kind](tmp_path, data)
    assert is_foreign(path)
    log = read_log(path, columns=UNITS.get(kind))
    (one,) = log.trajectories
    for channel, expected in data.items():
        np.testing.assert_allclose(getattr(one, channel), expected, rtol=0, atol=1e-9, err_msg=channel)
    assert (log.torque_unit, log.rate) == ("N m", 100.0)
    assert log.joints == (JOINTS if kind not in ("npz", "mat", "mat73") else ("joint_1", "joint_2"))


def test_an_invdyn_log_is_read_as_it_is(tmp_path):
    """A file that is a log already is not guessed at."""
    path = make_log(tmp_path / "log.h5")
    assert not is_foreign(path) and read_log(path).robot == "two_link" and trajectory_names(path) == ("run",)


def test_selected_trajectories(tmp_path):
    """A trajectory is read by its name, the stem of its file; another name is refused with those that there are."""
    path = csv(tmp_path, recording())
    assert [x.name for x in read_log(path, ["run"]).trajectories] == ["run"]
    with pytest.raises(LogError, match=r"'walk'.*it has run"):
        read_log(path, ["walk"])


def test_files_are_trajectories(tmp_path):
    """Files with the same columns are a trajectory each; one that lacks a column is named."""
    data = recording()
    one = write_csv(tmp_path / "a.csv", named(data, q="q_{}", tau="tau_{}"))
    two = write_csv(tmp_path / "b.csv", named(data, tau="tau_{}", q="q_{}"))  # another order of columns
    log = imported([one, two], ColumnMap()).log
    assert [x.name for x in log.trajectories] == ["a", "b"]
    np.testing.assert_array_equal(log.trajectories[0].q, log.trajectories[1].q)
    three = write_csv(tmp_path / "c.csv", named(data, q="q_{}"))
    with pytest.raises(LogError, match=r"c: no column 'tau_shoulder'"):
        imported([one, three], ColumnMap())
    with pytest.raises(LogError, match="called a"):
        imported([one, one], ColumnMap())


def test_a_changed_file_is_read_again(tmp_path):
    """What is kept of a file is forgotten when the file changes."""
    data = recording()
    path = csv(tmp_path, data)
    before = import_one(path).log.trajectories[0].t
    assert import_one(path).log.trajectories[0].t is before
    csv(tmp_path, {name: x[:500] for name, x in data.items()})
    assert len(import_one(path).log.trajectories[0].t) == 500


def test_other_files(tmp_path):
    """No file, an unknown ending and an empty folder are told in a line with what is allowed."""
    with pytest.raises(LogError, match="no file"):
        reading.read_tables(tmp_path / "log.csv", 1e9)
    (tmp_path / "log.xyz").write_text("1")
    with pytest.raises(LogError, match="allowed: csv"):
        reading.read_tables(tmp_path / "log.xyz", 1e9)
    with pytest.raises(LogError, match="allowed: csv"):
        reading.read_tables(tmp_path, 1e9)


def test_maps_of_a_source(tmp_path):
    """A map may be a file or its entries, and is checked."""
    path = csv(tmp_path, recording())
    (tmp_path / "map.yaml").write_text("robot_name: mine\n")
    assert read_log(path, columns=tmp_path / "map.yaml").robot == "mine"
    assert read_log(path, columns={"torque_side": "link"}).torque_side == "link"
    with pytest.raises(UsageError, match="no entry 'torqueside', did you mean 'torque_side'"):
        read_log(path, columns={"torqueside": "link"})


@pytest.mark.parametrize("kind", [x for x in WRITERS if x != "lerobot"])
def test_too_large(kind, tmp_path):
    """More than the limit is refused in every format, before it is read."""
    path = WRITERS[kind](tmp_path, recording())
    with pytest.raises(LogError, match=r"GB; allowed: .*max_size"):
        read_log(path, limit=1000.0)


def test_a_folder_of_files(tmp_path):
    """A folder of tables is a log of all of them, notes in text beside them or not; of several kinds it is refused."""
    data = recording()
    for name in ("b", "a"):
        write_csv(tmp_path / f"{name}.csv", named(data, q="q_{}", tau="tau_{}"))
    (tmp_path / "notes.txt").write_text("a run on Monday")
    assert [x.name for x in imported([tmp_path], ColumnMap()).log.trajectories] == ["a", "b"]
    assert [x.name for x in RealLog(str(tmp_path)).recorded(None).log.trajectories] == ["a/a", "b/b"]
    np.savez(tmp_path / "c.npz", **data)
    with pytest.raises(LogError, match=r"several kinds: a.csv, b.csv, c.npz; allowed: one kind. Try: data.path=\["):
        RealLog(str(tmp_path))
