"""The page of a checked log: what it says, what is marked where, and that no broken log ends it."""

import re
from dataclasses import replace

import numpy as np
import pytest

from invdyn_cli.diagnosis import doctor
from invdyn_cli.diagnosis.marks import located
from invdyn_cli.log import RawTrajectory
from invdyn_cli.report.check_figures import channel, clock, draw_all, model
from invdyn_cli.report.check_page import page, verdict
from invdyn_cli.report.checked_log import CheckedLog
from invdyn_cli.robots import load_urdf
from invdyn_cli.types import Check, Examination
from tests.commands import usually
from tests.diagnosis.sick import changed, sound
from tests.report.reader import Reader


@pytest.fixture(scope="module")
def arm():
    """Four joints of the built-in arm, the others locked."""
    return load_urdf("apollo_arm", joints=[f"arm_joint_{i}" for i in (1, 2, 3, 4)])


@pytest.fixture(scope="module")
def log(arm):
    return sound(arm, seconds=15, channels=("qd", "q_ref"))


def drawn_of(log, robot):
    corrected, examination, marks = located(log, robot)
    return examination, CheckedLog(log, corrected, marks, robot)


def spoiled(log):
    """A gap, rows of NaN, three outliers, a torque that ends, a torque of the opposite sign."""
    raw = log.trajectories[0]
    tau = raw.tau.copy()
    tau[:, 1] = np.minimum(tau[:, 1], np.quantile(tau[:, 1], 0.9))
    tau[:, 3] *= -1
    tau[[300, 900, 1500], 2] += 10 * np.ptp(tau[:, 2])
    tau[600:620] = np.nan
    keep = np.r_[0:2000, 2100:3000]
    rows = {c: getattr(raw, c)[keep] for c in ("t", "q", "qd", "q_ref")}
    return changed(log, **rows, tau=tau[keep])


@pytest.fixture(scope="module")
def defective(log, arm):
    return drawn_of(spoiled(log), arm)


def marks_of(drawn, check):
    return [x for x in drawn.marks if x.check == check]


def test_marks_stand_where_the_defects_are(defective):
    """The rows of a mark are those of the log as it was recorded, though rows before them were dropped."""
    _, drawn = defective
    outliers = np.sort(np.concatenate([x.rows for x in marks_of(drawn, "outliers")]))
    assert outliers.tolist() == [300, 900, 1500]
    assert {x.joint for x in marks_of(drawn, "outliers")} == {2}
    assert marks_of(drawn, "not_finite")[0].rows.tolist() == list(range(600, 620))
    assert [tuple(x.rows) for x in marks_of(drawn, "gaps")] == [(1999, 2000)]
    (at,) = [x for x in marks_of(drawn, "saturation") if x.joint == 1]
    tau = drawn.log.trajectories[0].tau[at.rows, 1]
    assert len(at.rows) > 100 and np.ptp(tau) < 1e-6
    (sign,) = marks_of(drawn, "sign_error")
    assert (sign.channel, sign.joint, sign.rows) == ("tau", 3, None)


def test_time_follows_the_corrected_clock(log, arm):
    """A clock in ms is drawn in s; several recordings stand one after another, and so does one whose clock restarts."""
    raw = log.trajectories[0]
    assert drawn_of(changed(log, t=1e3 * raw.t), arm)[1].time[[0, -1]] == pytest.approx([0, 14.995])
    restarted = changed(log, t=np.where(raw.t < 7, raw.t, raw.t - 7))
    for one in (restarted, replace(log, trajectories=(raw, replace(raw, name="again")))):
        assert np.all(np.diff(drawn_of(one, arm)[1].time) >= 0)


def test_spikes_survive_thinning(log, arm):
    """Of 100,000 rows one single spike is still drawn, in at most some thousand points."""
    raw = log.trajectories[0]
    t = np.arange(100_000) / 1000
    q = np.stack([np.interp(t % 15, raw.t, x) for x in raw.q.T], axis=1)
    tau = np.tile(raw.tau, (34, 1))[:100_000]
    tau[54_321, 0] = 1e4
    long = replace(log, rate=1000.0, trajectories=(RawTrajectory("run", t, q, tau),))
    figure = channel(CheckedLog(long, long_numbered(long), (), None), "tau")
    (line,) = [x for x in figure.axes[0].lines if x.get_label() == "tau as logged"]
    assert np.nanmax(line.get_ydata()) == 1e4 and len(line.get_ydata()) <= 2100


def long_numbered(log):
    raw = log.trajectories[0]
    return replace(log, trajectories=(replace(raw, rows=np.arange(len(raw.t))),))


def test_every_mark_has_words(defective):
    """Every kind of defect has its label in the panel of its joint, and axes have quantities with units."""
    _, drawn = defective
    figure = channel(drawn, "tau")
    said = {k: " ".join(x.get_text() for x in (*axes.texts, axes.title, axes._right_title)) for k, axes in
            enumerate(figure.axes)}  # fmt: skip
    assert "outliers" in said[2] and "stays at" in said[1] and "opposite sign" in said[3]
    assert all("not finite" in x for x in said.values())
    assert all(re.fullmatch(r"torque \[N m\]", axes.get_ylabel()) for axes in figure.axes)
    assert "gap" in clock(drawn).axes[0]._right_title.get_text()


def test_wrong_units_stand_on_no_axis(log, arm):
    """Degrees are not drawn on an axis in rad."""
    _, drawn = drawn_of(changed(log, q=np.rad2deg(log.trajectories[0].q)), arm)
    figure = channel(drawn, "q")
    assert {axes.get_ylabel() for axes in figure.axes} == {"position q [as logged]"}
    assert "q is in degrees" in figure.axes[0]._right_title.get_text()


def test_torque_beside_the_model(defective):
    """The turned torque runs against the model as logged, and with it as corrected; the error falls."""
    _, drawn = defective
    figure = model(drawn)
    right = figure.axes[7]  # the last row's
    clouds = {x.get_label(): x.get_data() for x in right.lines}
    assert np.corrcoef(*clouds["as logged"])[0, 1] < -0.5 < 0.9 < np.corrcoef(*clouds["as corrected"])[0, 1]
    before, after = map(float, re.findall(r"([\d.]+) as logged → ([\d.]+)", figure.axes[6].get_title())[0])
    assert after < before / 3


def test_page_is_one_file(defective, arm, tmp_path):
    """It parses, refers to nothing outside, opens with the verdict and then with what to do, and folds all checks."""
    examination, drawn = defective
    paths, lacking = draw_all(drawn, tmp_path)
    text = page(examination, drawn.log, arm, paths, ["a note"])
    reader = Reader(text)
    assert not lacking and reader.tags.count("img") == len(paths) == 6
    assert not re.search(r"https?:|//[a-z]|url\(|@import|<script", re.sub(r"base64,[^\"]*", "", text))
    assert text.index("The log is usable after") < text.index("What to do") < text.index("The log over time")
    assert "a note" in reader.text and "outliers (tau of arm_joint_3)" in reader.text
    folded = text.partition("<h2>Every check</h2>")[2]
    assert folded.startswith("<details><summary>") and all(
        x.check.replace("_", " ") in folded for x in examination.checks
    )


def test_verdicts(log, arm, defective):
    """One sentence each: sound, corrected, not usable."""
    assert verdict(doctor.examine(log, arm)) == "The log is usable, no check warns."
    said = verdict(defective[0])
    assert "sign error (tau of arm_joint_4)" in said and "saturation (tau of arm_joint_2)" in said
    assert "not corrected" not in said
    broken = doctor.examine(changed(log, q=np.full_like(log.trajectories[0].q, np.nan)), arm)
    assert verdict(broken).startswith("The log is not usable: not finite (q)") and verdict(broken).count(". ") == 0


def test_doubts_are_not_called_corrected():
    """A torque whose unit is in doubt is listed as not corrected, though the unit of q was corrected."""
    checks = (
        Check("unit_error", "fail", threshold={"channel": "q", "factor": 57.3}, advice="q in rad"),
        Check("unit_error", "warn", threshold={"channel": "tau", "factor": None}, advice="torques in N m"),
    )
    done = ({"check": "unit_error", "done": "q divided by 57.3"},)
    said = verdict(Examination(True, checks, {}, done))
    assert said == "The log is usable after 1 correction: unit error (q); not corrected: unit error (tau)."


def test_what_the_log_can_show(log, arm):
    """Drift needs more time on all joints, and a joint that rests shows no friction."""
    q = log.trajectories[0].q.copy()
    q[:, 1] = 0.2
    one = changed(log, q=q, qd=None, q_ref=None)
    text = page(doctor.examine(one, arm), one, arm, [])
    rows = dict(re.findall(r'<tr><td class="whole">(.*?)</td>(.*?)</tr>', text.partition("can show</h2>")[2]))
    assert ">none</td>" in rows["Thermal friction drift"] and "15 s of motion" in rows["Thermal friction drift"]
    assert "arm_joint_2: it moves by" in rows["Viscous friction"] and "arm_joint_1" in rows["Viscous friction"]


def broken_logs(log):
    raw = log.trajectories[0]
    nothing = replace(raw, t=raw.t[:0], q=raw.q[:0], tau=raw.tau[:0], qd=None, q_ref=None)
    return {
        "only NaN": changed(log, q=np.full_like(raw.q, np.nan)),
        "one row": replace(log, trajectories=(RawTrajectory("one", raw.t[:1], raw.q[:1], raw.tau[:1]),)),
        "no rows": replace(log, trajectories=(nothing,)),
        "no trajectories": replace(log, trajectories=()),
        "other rows": changed(log, qd=raw.qd[:10], q_ref=None),
        "wild stamps": changed(log, t=np.where(np.arange(3000) % 700 == 5, 1e200, raw.t)),
        "wild torques": changed(log, tau=np.where(np.arange(3000)[:, None] % 700 == 5, 1e300, raw.tau)),
        "nothing moves": changed(log, q=0 * raw.q, qd=None, q_ref=None),
        "no torque": changed(log, tau=0 * raw.tau),
        "one clock": changed(log, t=0 * raw.t),
    }


@pytest.mark.parametrize("with_robot", usually([True], [True, False]))
def test_no_log_ends_the_page(with_robot, tmp_path):
    """NaN, no rows, channels of other lengths, clocks that stand: every log has a page. Two joints, as a page has the
    same parts for each."""
    arm = load_urdf("apollo_arm", joints=["arm_joint_1", "arm_joint_2"])
    robot = arm if with_robot else None
    for name, one in broken_logs(sound(arm, seconds=15, channels=("qd", "q_ref"))).items():
        examination, drawn = drawn_of(one, robot)
        paths, _ = draw_all(drawn, tmp_path / name)
        text = page(examination, one, robot, paths)
        assert "The log is " in Reader(text).text, name
