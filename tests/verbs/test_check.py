"""invdyn check: what it prints and writes, and its exit codes."""

import io
import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from rich.console import Console

from invdyn_cli.diagnosis import doctor
from invdyn_cli.logfile import read_log, write_log
from invdyn_cli.report import check_terminal
from invdyn_cli.report.tables import significant
from invdyn_cli.robots import load_urdf
from tests.diagnosis.sick import changed, sound
from tests.logs import make_log, motion

KEYS = {
    "check", "severity", "trajectory", "joint", "value", "threshold", "seen", "meaning", "advice", "source",
}  # fmt: skip
LOG = ("data=real_log", "data.path=log.h5")


def report(said) -> dict:
    """check.json in the folder that was printed last; refuses NaN, which is no JSON."""

    def refuse(name: str):
        raise ValueError(name)

    return json.loads(Path(said.out[-1], "check.json").read_text(), parse_constant=refuse)


@pytest.fixture
def arm():
    """Two joints of the built-in arm, the others locked: what is printed and written is of the same kind for each."""
    return load_urdf("apollo_arm", joints=["arm_joint_1", "arm_joint_2"])


ARM = ("robot=apollo_arm",)


def test_a_sound_log(command, arm):
    """Exit 0, the fixed schema, every name, a table of what is excited; the folder comes last."""
    write_log(sound(arm, seconds=10), Path("log.h5"))
    said = command("check", *LOG, *ARM)
    assert said.code == 0, said.err
    found = report(said)
    assert found["schema"] == "invdyn-check/1"
    assert set(found) == {"schema", "usable", "as_recorded", "checks", "corrections", "excitation"}
    assert found["usable"] is True and found["as_recorded"] is False
    assert all(set(one) == KEYS for one in found["checks"])
    assert len({one["check"] for one in found["checks"]}) == 20
    assert list(found["excitation"]) == list(arm.joints)
    assert Path(said.out[-1]).parts[:2] == ("outputs", "checks")
    text = "\n".join(said.out)
    assert "The log is usable" in text and "cannot show" in text and "ok (" in text and "skipped" in text


def test_the_page(command, arm):
    """report.html stands in the folder beside its figures, holds them, and the output names it."""
    write_log(sound(arm, seconds=10), Path("log.h5"))
    said = command("check", *LOG, *ARM)
    folder = Path(said.out[-1])
    assert said.out[-2] == f"page: {folder / 'report.html'}"
    text = (folder / "report.html").read_text("utf-8")
    assert text.count("data:image/png;base64,") == len(list((folder / "figures").glob("*.png"))) == 6
    assert "The log is usable" in text


def test_nothing_is_corrected_on_request(command, arm):
    """correct=false: a clock in ms stays a failure and makes the log not usable, nothing is listed as corrected, broken
    logs are described, and write= is refused."""
    log = sound(arm, seconds=10)
    raw = log.trajectories[0]
    write_log(changed(log, t=1e3 * raw.t), Path("log.h5"))
    said = command("check", *LOG, *ARM, "correct=false")
    assert said.code == 0, said.err
    found = report(said)
    assert (found["usable"], found["corrections"]) == (False, [])
    assert [x["value"] for x in found["checks"] if x["check"] == "unit_error" and x["severity"] == "fail"]
    assert report(command("check", *LOG, *ARM))["usable"] is True
    make_log(
        Path("nan.h5"), {"run": {c: x if c == "t" else np.full_like(x, np.nan) for c, x in motion().items()}}, urdf=""
    )
    said = command("check", "data.path=nan.h5", "correct=false")
    assert said.code == 0 and not report(said)["usable"], said.err
    said = command("check", *LOG, *ARM, "correct=false", "write=fixed.h5")
    assert said.code == 2 and "needs correct=true" in "".join(said.err) and not Path("fixed.h5").exists()


def test_broken_logs_have_a_page(command):
    """NaN everywhere, one row, and no robot: exit 0 and a page that says that the log is not usable."""
    every = motion()
    for name, channels in {
        "nan": {c: x if c == "t" else np.full_like(x, np.nan) for c, x in every.items()},
        "row": {c: x[:1] for c, x in every.items()},
    }.items():
        make_log(Path(f"{name}.h5"), {"run": channels}, urdf="")
        said = command("check", "data=real_log", f"data.path={name}.h5")
        assert said.code == 0, said.err
        assert "The log is not usable" in Path(said.out[-1], "report.html").read_text("utf-8")


@pytest.mark.parametrize("width", [60, 80, 200])
def test_tables_fold(width, apollo4):
    """At any width every column's head and every number stands in full, and no line is wider."""
    names = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint")
    examination = doctor.examine(replace(sound(apollo4, seconds=8), joints=names), None)
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(check_terminal.shown(examination))
    text = console.export_text()
    assert max(map(len, text.splitlines())) <= width
    for head in ("reversals", "rest %", "slow %", "max |qdd|", "cannot"):
        assert head in text
    assert "q in rad or m, tau in N m or N" in " ".join(text.split()) and "None" not in text
    for x in examination.excitation.values():
        assert f"{significant(x['q'][0])} … {significant(x['q'][1])}" in text
        assert f" {significant(max(map(abs, x['qdd'])))}" in text


def test_strict_fails_where_a_check_fails(command, arm):
    """Degrees can be corrected: exit 0; with strict=true exit 1. The words are on the screen either way."""
    log = sound(arm, seconds=10)
    write_log(changed(log, q=np.rad2deg(log.trajectories[0].q)), Path("log.h5"))
    for strict, code in (("strict=false", 0), ("strict=true", 1)):
        said = command("check", *LOG, *ARM, strict)
        assert said.code == code
        text = "\n".join(said.out)
        assert "fail" in text and "unit_error" in text and "correctable" in text
        assert report(said)["usable"] is True
    write_log(log, Path("log.h5"))
    assert command("check", *LOG, *ARM, "strict=true").code == 0


def test_the_corrected_log_is_written(command, arm):
    """write=fixed.h5: degrees and a turned torque are gone there, its history and check.json say so, the log itself is
    as it was; checked again, nothing is corrected."""
    log = sound(arm, seconds=10)
    raw = log.trajectories[0]
    write_log(changed(log, q=np.rad2deg(raw.q), tau=-raw.tau), Path("log.h5"))
    before = Path("log.h5").read_bytes()
    said = command("check", *LOG, *ARM, "write=fixed.h5")
    assert said.code == 0, said.err
    assert Path("log.h5").read_bytes() == before
    fixed = read_log("fixed.h5")
    np.testing.assert_allclose(fixed.trajectories[0].q, raw.q)
    np.testing.assert_allclose(fixed.trajectories[0].tau, raw.tau)
    done = report(said)["corrections"]
    assert [one["check"] for one in done] == ["unit_error", "sign_error"]
    assert fixed.history == tuple(f"invdyn check: {one['done']}" for one in done)
    again = command("check", "data=real_log", "data.path=fixed.h5", *ARM)
    assert report(again)["corrections"] == []


def test_a_broken_log_is_described(command):
    """What stops `run` with exit 2 is described here: NaN, a clock that repeats, currents without gains."""
    channels = motion()
    channels["tau"][7] = np.nan
    channels["t"][50] = channels["t"][49]
    make_log(Path("log.h5"), {"run": channels}, urdf="", torque_unit="A")
    said = command("check", *LOG)
    assert said.code == 0, said.err
    told = [one for one in report(said)["checks"] if one["severity"] not in ("ok", "skipped")]
    found = {one["check"]: one["severity"] for one in told}
    assert found["not_finite"] == found["duplicates"] == found["unit_error"] == "fail"
    assert report(said)["usable"] is False


def test_drive_gains_and_selections(command):
    """data.drive_gain makes torques of currents; selections say which trajectories are looked at."""
    make_log(Path("log.h5"), {"a": motion(), "b": motion(seconds=0.2)}, urdf="", torque_unit="A")
    said = command("check", *LOG, "data.drive_gain=[2,3]", 'data.train=["a[:7]"]', 'data.test=["a[7:]"]')
    found = report(said)
    assert said.code == 0 and found["usable"] is True
    assert [one for one in found["checks"] if one["trajectory"] == "b"] == []
    np.testing.assert_allclose(found["excitation"]["elbow"]["torque"], [-9, 9], rtol=0.02)


def test_several_logs(command):
    """Trajectories of several logs are called LOG/NAME."""
    for name in ("one", "two"):
        make_log(Path(f"{name}.h5"), {"run": motion(seconds=0.2 if name == "two" else 10)}, urdf="")
    said = command("check", "data=real_log", "data.path=[one.h5,two.h5]")
    assert said.code == 0, said.err
    short = [one["trajectory"] for one in report(said)["checks"] if one["check"] == "too_short"]
    assert short == ["two/run"]


def cut_off():
    make_log(Path("log.h5"))
    Path("log.h5").write_bytes(Path("log.h5").read_bytes()[:3000])


def without_urdf():
    make_log(Path("log.h5"), urdf="")


def other_gains():
    make_log(Path("log.h5"), urdf="", torque_unit="A")
    with h5py.File("log.h5", "a") as file:
        file.attrs["drive_gain_N_m_per_A"] = [1.0, 2.0, 3.0]


def make_sound():
    make_log(Path("log.h5"), {"run": motion(seconds=10)}, urdf="")


MISUSE = {
    "no log": (lambda: None, LOG, "no log log.h5"),
    "cut off": (cut_off, LOG, "cut off or corrupt"),
    "no measured log": (lambda: None, ("data=sim_clean",), "allowed: a measured log"),
    "another robot": (without_urdf, (*LOG, "robot=apollo_arm"), "no moving joint 'shoulder'"),
    "no trajectory": (without_urdf, (*LOG, "data.train=[walk]"), "no trajectory 'walk'"),
    "gains": (other_gains, LOG, "allowed: 2 numbers"),
    "write over itself": (without_urdf, (*LOG, "write=./log.h5"), "is the log itself"),
    "write what": (without_urdf, (*LOG, "write=7"), "write=7; allowed: the path of a new log"),
    "write where": (make_sound, (*LOG, "write=log.h5/x.h5"), "cannot write log.h5/x.h5"),
    "strict": (lambda: None, (*LOG, "strict=maybe"), "strict=maybe; allowed: true or false"),
}  # fmt: skip


@pytest.mark.parametrize("case", MISUSE)
def test_misuse_is_one_line(case, command, tmp_path):
    """Wrong use: exit code 2, one line on stderr, no check.json."""
    prepare, argv, word = MISUSE[case]
    prepare()
    said = command("check", *argv)
    assert said.code == 2
    assert len(said.err) == 1 and word in said.err[0], said.err
    assert list(tmp_path.rglob("check.json")) == []
