"""Diagnosis and check from Python give what the command line gives, and write nothing unless asked."""

import json
from pathlib import Path

import numpy as np
import pytest

import invdyn_cli as invdyn
from invdyn_cli.errors import InvdynError, RobotError, UsageError

OPTIONS = invdyn.Options(replay=False)


@pytest.fixture(scope="module")
def result(case):
    """The diagnosis of the arrays."""
    known = {"joints": case.log.joints, "torque_side": case.log.torque_side, "robot_name": case.log.robot}
    return invdyn.diagnose(**case.arrays, **known, urdf=case.folder / "arm.urdf", options=OPTIONS, design=False)


def tree(path: Path) -> dict:
    return json.loads(path.read_text())


def test_arrays_give_the_diagnosis_of_the_file(case, result, command):
    """diagnosis.json of the arrays is that of the file through the command line: every finding, number and note."""
    options = ("diagnosis.replay=false", "diagnosis.design=false", "hydra.run.dir=by_verb")
    said = command("diagnose", f"data.path={case.folder / 'log.h5'}", *options)
    assert said.code == 0, said.err
    result.save("by_function")
    assert tree(Path("by_function/diagnosis.json")) == tree(Path("by_verb/diagnosis.json"))
    files = [sorted(p.name for p in Path(x).rglob("*") if ".hydra" not in p.parts) for x in ("by_function", "by_verb")]
    assert files[0] == files[1]
    assert str(result).split() == " ".join(said.out[:-2]).split()  # but for the paths of page and folder


def test_the_hidden_effect_is_named(case, result):
    """What was hidden is named, with its joint and size, and the written model predicts better than the URDF."""
    claims = [(x.effect, x.joint) for x in result.findings if x.status == "named"]
    assert claims == [("coulomb_friction", case.joint)] and result.verdict == "explained"
    size = result.findings[0].parameters["coulomb"]
    assert size.value == pytest.approx(case.coulomb, rel=0.02)
    assert result.diagnosis.extended[case.joint]["rmse"] < 0.2 * result.diagnosis.baseline[case.joint]["rmse"]


def test_shows_itself(case, result):
    """The HTML holds the verdict and the cause in tables, needs nothing else, and styles nothing outside of itself."""
    html = result._repr_html_()
    assert all(word in html for word in ("Explained", "Coulomb friction", case.joint, "<table"))
    assert "src=" not in html and "<script" not in html and len(html) < 8000
    style = html.partition("<style>")[2].partition("</style>")[0]
    assert all(
        one.strip().startswith(".invdyn ") for rule in style.split("}")[:-1] for one in rule.split("{")[0].split(",")
    )


@pytest.fixture(scope="module")
def checked(case):
    """The check of the log object."""
    return invdyn.check(case.log, case.robot)


def test_check_gives_what_the_verb_gives(case, checked, command):
    """check.json of the object is that of the file, and the words are the same but for the page and the folder."""
    said = command("check", f"data.path={case.folder / 'log.h5'}", "hydra.run.dir=by_verb")
    assert said.code == 0, said.err
    checked.save("by_function")
    assert tree(Path("by_function/check.json")) == tree(Path("by_verb/check.json"))
    assert str(checked).splitlines()[-1] == said.out[-3] == "The log is usable."
    html = checked._repr_html_()
    assert "cannot show" in html and "axis1" in html and "The log is" in html


def test_nothing_is_written(case, tmp_path, monkeypatch):
    """Checks and failures leave no file in the working directory."""
    monkeypatch.chdir(tmp_path)
    assert invdyn.check(**case.arrays, urdf=str(case.folder / "arm.urdf")).usable
    with pytest.raises(UsageError):
        invdyn.check()
    assert list(tmp_path.iterdir()) == []


def test_columns_without_names_follow_the_urdf(case):
    """Without `joints`, the columns are the URDF's joints, and a note says so."""
    result = invdyn.check(**case.arrays, urdf=case.folder / "arm.urdf")
    assert result.log.joints == case.robot.joints and any("are read as" in x for x in result.notes)


def test_names_that_are_none_of_the_urdf_follow_it_in_order(case):
    """As many of them as the URDF has joints are read in its order, with a note; of a robot that is given by its joints
    others are refused."""
    result = invdyn.check(**case.arrays, joints=["lower", "upper"], urdf=case.folder / "arm.urdf")
    assert result.log.joints == case.robot.joints
    (told,) = [x for x in result.notes if "are read as" in x]
    assert "lower, upper" in told and "in this order" in told


def test_defects_are_described(case):
    """NaN in the arrays is no exception but a finding of the check, which leaves such rows out unless told not to."""
    q = case.arrays["q"].copy()
    q[100:110, 0] = np.nan
    result = invdyn.check(**{**case.arrays, "q": q}, urdf=case.folder / "arm.urdf")
    assert {x.severity for x in result.checks if x.check == "not_finite"} & {"warn", "fail"}
    assert np.isfinite(result.corrected.trajectories[0].q).all() and result.corrections
    raw = invdyn.check(**{**case.arrays, "q": q}, urdf=case.folder / "arm.urdf", correct=False)
    assert np.isnan(raw.corrected.trajectories[0].q).any() and not raw.usable


def test_refuses_what_does_not_belong_together(case):
    """Joints that the URDF lacks, too few joints, both a log and arrays, neither, no robot: a sentence each."""
    urdf = case.folder / "arm.urdf"
    for error, word, call in (
        (RobotError, "elbow", lambda: invdyn.check(**case.arrays, joints=["axis1", "elbow"], urdf=urdf)),
        (RobotError, "no moving joint 'axis1'; allowed: arm_joint_1", lambda: invdyn.check(case.log, "apollo_arm")),
        (RobotError, "moves 7 joints.*the log has 2", lambda: invdyn.check(**case.arrays, urdf="apollo_arm")),
        (UsageError, "a log and q, tau are given", lambda: invdyn.check(case.log, q=1, tau=2)),
        (UsageError, "q is missing", lambda: invdyn.diagnose()),
        (UsageError, "names no URDF", lambda: invdyn.diagnose(case.log)),
        (UsageError, "the log is a dict", lambda: invdyn.diagnose({"q": 1}, case.robot)),  # pyright: ignore
        (UsageError, "the robot is a int", lambda: invdyn.diagnose(case.log, 7)),  # pyright: ignore
        (InvdynError, "no log|no file", lambda: invdyn.read("nothing.h5")),
    ):
        with pytest.raises(error, match=word) as caught:
            call()
        assert "\n" not in str(caught.value)
