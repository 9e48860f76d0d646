"""An invdyn log is read as it was written, and every broken one is refused in one line that names the culprit."""

import dataclasses
import re

import h5py
import numpy as np
import pytest

from invdyn_cli.errors import LogError
from invdyn_cli.log import Log, RawTrajectory
from invdyn_cli.logfile import read_log, refuse_defects, trajectory_names, write_log
from tests.logs import make_log, motion


def changed(**changes):
    """A sound trajectory with some channels replaced, or left out (None)."""
    return {name: x for name, x in (motion() | changes).items() if x is not None}


def with_value(channel, row, value):
    """A sound trajectory with one value of a channel (of the second joint) replaced."""
    values = motion()[channel].copy()
    values[(row, 1) if values.ndim == 2 else row] = value
    return changed(**{channel: values})


def refused(call, *words):
    """The call raises a LogError of one line, in which all words occur."""
    with pytest.raises(LogError) as caught:
        call()
    line = str(caught.value)
    assert "\n" not in line
    for word in words:
        assert re.search(word, line), f"{word!r} is not in: {line}"


def test_reads_what_the_format_says(tmp_path):
    """Header, arrays in float64, payload and notes arrive as written, and the URDF's path can be opened from here."""
    run = changed(q_ref=motion()["q"].astype("float32"), payload_mass=1.5, notes="as found")
    log = read_log(make_log(tmp_path / "a.h5", {"run": run}, position_side="motor", compensated=["gravity"]))
    assert (log.robot, log.joints, log.torque_side, log.torque_unit) == (
        "two_link",
        ("shoulder", "elbow"),
        "link",
        "N m",
    )
    assert (log.rate, log.source, log.licence, log.urdf) == (100.0, "a test", "MIT", str(tmp_path / "arm.urdf"))
    assert (log.position_side, log.compensated, log.drive_gain) == ("motor", ("gravity",), None)
    [raw] = log.trajectories
    np.testing.assert_array_equal(raw.tau, run["tau"])
    assert raw.q_ref is not None and raw.q_ref.dtype == np.float64
    assert (raw.name, raw.payload_mass, raw.notes, raw.q_link, raw.stage) == ("run", 1.5, "as found", None, None)


def test_optional_words_may_be_missing(tmp_path):
    """Without urdf, source, licence, notes and payload a log is still a log; what is not known says so."""
    log = read_log(make_log(tmp_path / "a.h5", urdf=None, source=None, licence=None))
    assert (log.urdf, log.source, log.licence, log.position_side) == ("", "", "", "unknown")
    assert np.isnan(log.trajectories[0].payload_mass)


def test_other_writers_habits_are_understood(tmp_path):
    """Text as bytes and the version as a float, as MATLAB and old h5py write them, are read the same."""
    names = np.array([b"shoulder", b"elbow"])
    log = read_log(make_log(tmp_path / "a.h5", format=np.bytes_("invdyn-log"), version=1.0, joint_names=names))
    assert log.joints == ("shoulder", "elbow")


def test_reads_only_what_is_asked_for(tmp_path):
    """A broken trajectory does not matter to who reads another one, or the header alone; order is as asked."""
    broken = with_value("q", 5, np.nan)
    path = make_log(tmp_path / "a.h5", {"b": motion(), "a": motion(), "broken": broken})
    assert [raw.name for raw in read_log(path, ["b", "a"]).trajectories] == ["b", "a"]
    assert read_log(path, ()).trajectories == ()
    assert trajectory_names(path) == ("a", "b", "broken")
    refused(lambda: read_log(path), "broken")


def test_written_and_read_again_is_the_same(tmp_path):
    """write_log then read_log gives back every field bit for bit, stages and gains included, and leaves no debris."""
    channels = motion() | {"q_ref": motion()["q"] + 0.1, "q_link": motion()["q"] - 0.1}
    stage = np.where(channels["t"] < 5, "before", "after")
    log = Log(
        robot="arm", joints=("shoulder", "elbow"), torque_side="motor", torque_unit="A", rate=100.0, source="s",
        licence="l", urdf=str(tmp_path / "robots" / "arm.urdf"), drive_gain=np.array([2.0, 3.0]),
        position_side="link", compensated=("gravity", "friction"),
        trajectories=(RawTrajectory("one", stage=stage, payload_mass=0.5, notes="n", **channels),),
    )  # fmt: skip
    write_log(log, tmp_path / "a.h5")
    again = read_log(tmp_path / "a.h5")
    for field in dataclasses.fields(Log):
        if field.name != "trajectories":
            np.testing.assert_array_equal(getattr(again, field.name), getattr(log, field.name), err_msg=field.name)
    for field in dataclasses.fields(RawTrajectory):
        one, other = getattr(again.trajectories[0], field.name), getattr(log.trajectories[0], field.name)
        np.testing.assert_array_equal(one, other, err_msg=field.name)
    assert [p.name for p in tmp_path.iterdir()] == ["a.h5"]


def test_defects_are_kept_on_writing_and_readable_without_check(tmp_path):
    """A log with NaN and repeated times can be written and read with check=False, for who wants to describe it."""
    raw = RawTrajectory("run", np.array([0.0, 0.0, 0.1]), np.full((3, 1), np.nan), np.zeros((3, 1)))
    write_log(Log("arm", ("j",), "link", "N m", 100.0, (raw,)), tmp_path / "a.h5")
    assert np.isnan(read_log(tmp_path / "a.h5", check=False).trajectories[0].q).all()
    refused(lambda: read_log(tmp_path / "a.h5"), "'run'", "q of joint j is nan in row 0, 3 such")


def test_a_log_that_cannot_be_written_leaves_the_old_one(tmp_path):
    """Where writing fails there is one line of error, no half file, and the previous log is untouched."""
    log = read_log(make_log(tmp_path / "a.h5"))
    before = (tmp_path / "a.h5").read_bytes()
    broken = dataclasses.replace(log, trajectories=(*log.trajectories, *log.trajectories))
    words = "a trajectory is named 'run'; allowed: unique names"
    refused(lambda: write_log(broken, tmp_path / "a.h5"), "cannot write .*a.h5", words)
    assert (tmp_path / "a.h5").read_bytes() == before and len(list(tmp_path.iterdir())) == 1
    refused(lambda: write_log(log, tmp_path / "a.h5" / "b.h5"), "cannot write", "b.h5: ")


def test_no_such_file_and_folders(tmp_path):
    """A missing file names its nearest neighbour, a folder names the logs in it."""
    make_log(tmp_path / "arm.h5")
    refused(lambda: read_log(tmp_path / "amr.h5"), "no log", "did you mean 'arm.h5'")
    refused(lambda: read_log(tmp_path / "nowhere" / "a.h5"), "no log .*nowhere")
    refused(lambda: read_log(tmp_path), "is a folder", "arm.h5")


def test_files_that_are_no_log(tmp_path):
    """Text, an empty file and somebody else's HDF5 are refused for what they are."""
    (tmp_path / "text.h5").write_text("t,q,tau\n0,1,2\n" * 100)
    (tmp_path / "empty.h5").touch()
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["x"] = np.zeros(3)
    refused(lambda: read_log(tmp_path / "text.h5"), "text.h5 is not an HDF5 file")
    refused(lambda: read_log(tmp_path / "empty.h5"), "empty.h5 is not an HDF5 file")
    refused(lambda: read_log(tmp_path / "other.h5"), r"format is \(none\); allowed: invdyn-log")


@pytest.mark.parametrize("share", [0.02, 0.3, 0.9, 0.999])
def test_a_file_cut_off_anywhere_is_refused(tmp_path, share):
    """However much of the end is missing, the answer is one line that names the file."""
    whole = make_log(tmp_path / "whole.h5").read_bytes()
    (tmp_path / "cut.h5").write_bytes(whole[: int(share * len(whole))])
    refused(lambda: read_log(tmp_path / "cut.h5"), "cut.h5 is cut off or corrupt")


def test_damage_that_shows_only_on_reading_a_dataset(tmp_path):
    """A file that opens, but whose compressed data were overwritten, is refused as corrupt too."""
    write_log(read_log(make_log(tmp_path / "a.h5")), tmp_path / "b.h5")
    with h5py.File(tmp_path / "b.h5") as file:
        start = file["trajectories/run/q"].id.get_chunk_info(0).byte_offset
    damaged = bytearray((tmp_path / "b.h5").read_bytes())
    damaged[start : start + 200] = b"\xff" * 200
    (tmp_path / "b.h5").write_bytes(damaged)
    assert trajectory_names(tmp_path / "b.h5") == ("run",)
    refused(lambda: read_log(tmp_path / "b.h5"), "b.h5 is cut off or corrupt")


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ({"format": "rosbag"}, ["format is rosbag", "invdyn-log"]),
        ({"version": 2}, ["version is 2; allowed: 1"]),
        ({"version": None}, [r"version is \(none\)"]),
        ({"robot": None}, ["lacks the attribute robot"]),
        ({"joint_names": None}, ["lacks the attribute joint_names"]),
        ({"torque_side": None}, ["lacks the attribute torque_side"]),
        ({"torque_unit": None}, ["lacks the attribute torque_unit"]),
        ({"rate": None}, ["lacks the attribute rate"]),
        ({"rate": "fast"}, ["rate", "allowed: numbers"]),
        ({"rate": -1.0}, ["rate is -1.0 Hz", "above 0"]),
        ({"torque_unit": "Nm"}, ["torque_unit is 'Nm'", "N m, A"]),
        ({"torque_side": "gear"}, ["torque_side is 'gear'", "link, motor, command, unknown"]),
        ({"position_side": "both"}, ["position_side is 'both'", "motor, link, unknown"]),
        ({"torque_unit": "A"}, ["no drive_gain_N_m_per_A", r"data.drive_gain=\[…\], 2 numbers in N m per A"]),
        ({"torque_unit": "A", "drive_gain_N_m_per_A": [1.0]}, [r"drive gains \[1.0\]", "2 numbers"]),
        ({"torque_unit": "A", "drive_gain_N_m_per_A": [1.0, np.nan]}, ["drive gains", "nan"]),
        ({"joint_names": ["elbow", "elbow"]}, ["joint_names has 'elbow' twice"]),
        ({"joint_names": []}, ["joint_names has no names"]),
        ({"joint_names": ["a", "b", "c"]}, ["q has shape", r"\(1000, 3\)", "joint_names has 3"]),
    ],
)  # fmt: skip
def test_headers_that_are_refused(tmp_path, header, words):
    """A header that lacks a word, or says what is not allowed, is refused with what is allowed."""
    path = make_log(tmp_path / "a.h5", **header)
    refused(lambda: read_log(path), "a.h5", *words)


@pytest.mark.parametrize(
    ("trajectory", "words"),
    [
        (changed(t=None), ["lacks the dataset t"]),
        (changed(q=None), ["lacks the dataset q"]),
        (changed(tau=None), ["lacks the dataset tau"]),
        (changed(q=np.full((1000, 2), b"n/a")), ["q holds", "allowed: numbers"]),
        (changed(t=motion()["t"][:, None]), [r"t has shape \(1000, 1\)"]),
        (changed(t=np.zeros(0)), [r"t has shape \(0,\)", "at least one sample"]),
        (changed(t=np.array(1.0)), [r"t has shape \(\)"]),
        (changed(q=motion()["q"][:-1]), [r"q has shape \(999, 2\); allowed: 1000 rows, one for each sample of t"]),
        (changed(tau=motion()["tau"][:-7]), [r"tau has shape \(993, 2\)"]),
        (changed(qd=motion()["qd"][:10]), [r"qd has shape \(10, 2\)"]),
        (changed(stage=np.zeros(3)), [r"stage has shape \(3,\)"]),
        (changed(tau=motion()["tau"][:, :1]), [r"tau has shape \(1000, 1\)", r"\(1000, 2\)"]),
        (changed(q=motion()["q"][:, 0]), [r"q has shape \(1000,\)"]),
        (with_value("q", 17, np.nan), ["q of joint elbow is nan in row 17, 1 such"]),
        (with_value("tau", slice(40, 44), np.inf), ["tau of joint elbow is inf in row 40, 4 such"]),
        (with_value("qdd", 3, -np.inf), ["qdd of joint elbow is -inf in row 3"]),
        (with_value("t", 8, np.nan), ["t is nan in row 8"]),
        (with_value("t", 500, 4.0), ["time runs backwards in row 500, from 4.99 s to 4 s", "1 such"]),
        (with_value("t", 500, 4.99), ["time repeats in row 500"]),
    ],
)  # fmt: skip
def test_trajectories_that_are_refused(tmp_path, trajectory, words):
    """A trajectory that cannot be computed with is refused by name, with channel, joint, row and count."""
    path = make_log(tmp_path / "a.h5", {"good": motion(), "bad": trajectory})
    refused(lambda: read_log(path), "trajectory 'bad'", *words)


def test_no_trajectories_and_unknown_ones(tmp_path):
    """An empty log is refused; an unknown name is answered with the closest one and all that exist."""
    refused(lambda: read_log(make_log(tmp_path / "none.h5", {})), "none.h5 has no trajectories")
    path = make_log(tmp_path / "a.h5", {"run_1": motion(), "load": motion()})
    refused(lambda: read_log(path, ["run1"]), "no trajectory 'run1', did you mean 'run_1'", "load, run_1")


def test_refusals_name_the_log_they_are_told(tmp_path):
    """refuse_defects alone passes a sound log in memory, and puts the given name in front of what it refuses."""
    log = read_log(make_log(tmp_path / "a.h5"))
    refuse_defects(log)
    refused(lambda: refuse_defects(dataclasses.replace(log, rate=0.0), "this one"), "^this one: rate")
