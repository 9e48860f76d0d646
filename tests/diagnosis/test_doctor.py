"""The doctor finds every defect that was made, with its size, and takes no sound log or ordinary effect for one."""

from dataclasses import replace

import numpy as np
import pytest

from invdyn_cli.diagnosis import doctor
from invdyn_cli.diagnosis.checks.columns import SignError
from invdyn_cli.diagnosis.checks.description import Description
from invdyn_cli.diagnosis.checks.samples import gather, nominal_torque
from invdyn_cli.errors import RobotError
from invdyn_cli.log import Log, RawTrajectory
from invdyn_cli.logfile import refuse_defects
from invdyn_cli.recording.rows import median_step, taken
from invdyn_cli.robots import load_urdf
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.simulation.plant import record
from invdyn_cli.simulation.references import Multisine
from invdyn_cli.simulation.sensors import Noise
from invdyn_cli.types import Motion
from tests.commands import usually
from tests.diagnosis.sick import alarms, changed, delayed, motion, seen, sound

NAMES = {
    "unit_error", "sign_error", "joint_order", "time_offset", "clock_jitter", "gaps", "duplicates",
    "derivative_consistency", "quantisation", "saturation", "power_off", "outliers", "gravity_removed",
    "command_copies_measurement", "not_moving", "too_short", "not_finite", "wrapped_angle", "model_mismatch", "urdf",
}  # fmt: skip


@pytest.fixture(scope="module")
def arm():
    """The built-in arm, all seven joints."""
    return load_urdf("apollo_arm")


@pytest.fixture(scope="module")
def log(arm):
    """A sound log of it, 30 s at 200 Hz."""
    return sound(arm)


@pytest.fixture(scope="module")
def shorter(apollo4):
    """A sound log of the upper four joints: for what does not depend on how many there are."""
    return sound(apollo4)


def test_a_sound_log_is_sound(log, arm):
    """Nothing to warn of; every name of docs/checks.md is there, so that a reader sees what was looked at."""
    corrected, examination = doctor.correct(log, arm)
    assert examination.usable
    assert alarms(examination) == {}
    assert {c.check for c in examination.checks} == NAMES
    notes = doctor.done(examination)
    assert notes == ()
    assert corrected.trajectories == log.trajectories


def one_delayed(log: Log) -> np.ndarray:
    tau = log.trajectories[0].tau.copy()
    tau[:, 1] = delayed(tau[:, 1], log.trajectories[0].t, 0.008)
    return tau


EFFECTS = {
    "gain": lambda log: log.trajectories[0].tau * np.array([1, 1, 0.8, 1]),
    "offset": lambda log: log.trajectories[0].tau + 0.3 * log.trajectories[0].tau.std(0),
    "delay of one joint": one_delayed,
}


@pytest.mark.parametrize("effect", EFFECTS)
def test_effects_are_no_defects(effect, shorter, apollo4):
    """A gain of 0.8, offsets, 8 ms on one joint: to be found later, not by the doctor."""
    assert alarms(doctor.examine(changed(shorter, tau=EFFECTS[effect](shorter)), apollo4)) == {}


def test_strong_friction_is_no_defect(apollo4):
    """Friction of half the torque's spread, Coulomb and viscous, raises nothing."""
    assert alarms(doctor.examine(sound(apollo4, 3, coulomb=0.5, viscous=0.5), apollo4)) == {}


def test_a_payload_is_no_defect(apollo4):
    """A kilogram, a decimetre off the flange's axis, that the URDF does not know of raises nothing."""
    inertial = np.array(apollo4.inertial)
    inertial[-1] += [1, 0, 0, 0.1, 0.01, 0, 0.01, 0, 0, 0]
    assert alarms(doctor.examine(sound(apollo4, 4, truth=replace(apollo4, inertial=inertial)), apollo4)) == {}


def order(*pairs: tuple[int, int]) -> list[int]:
    columns = list(range(7))
    for a, b in pairs:
        columns[a], columns[b] = columns[b], columns[a]
    return columns


def without_gravity(log: Log, arm) -> np.ndarray:
    raw = log.trajectories[0]
    still = np.zeros_like(raw.q)
    return raw.tau - nominal_torque(arm, Motion(raw.q, still, still))[0]


def spoiled(log: Log, arm, how: str) -> Log:
    raw = log.trajectories[0]
    q, qd, tau, t = raw.q, raw.qd, raw.tau, raw.t
    assert qd is not None
    swapped = order((1, 3))
    return changed(log, **{
        "q in degrees": {"q": np.rad2deg(q)},
        "q converted twice": {"q": np.deg2rad(q)},
        "qd in degrees": {"qd": np.rad2deg(qd)},
        "qd in rpm": {"qd": qd * 30 / np.pi},
        "t in ms": {"t": 1e3 * t},
        "mN m": {"tau": 1e3 * tau},
        "kN m": {"tau": 1e-3 * tau},
        "all signs": {"tau": -tau},
        "one sign": {"tau": tau * np.array([1, -1, 1, 1, 1, 1, 1])},
        "torques swapped": {"tau": tau[:, swapped]},
        "joints swapped": {"tau": tau[:, swapped], "q": q[:, swapped], "qd": qd[:, swapped]},
        "no gravity": {"tau": without_gravity(log, arm)},
    }[how])  # fmt: skip


SPOILED = {
    "q in degrees": ("unit_error", 57.29578),
    "q converted twice": ("unit_error", 0.01745329),
    "qd in degrees": ("unit_error", 57.29578),
    "qd in rpm": ("unit_error", 9.549297),
    "t in ms": ("unit_error", 1000),
    "mN m": ("unit_error", 1000),
    "kN m": ("unit_error", 0.001),
    "all signs": ("sign_error", -1),
    "one sign": ("sign_error", -1),
    "torques swapped": ("joint_order", order((1, 3))),
    "joints swapped": ("joint_order", order((1, 3))),
}


USUAL = ("qd in degrees", "t in ms", "mN m", "one sign", "joints swapped")
"""One of each kind of defect; the others differ from one of these by a factor, a channel or which joints."""


@pytest.mark.parametrize("how", usually(USUAL, SPOILED))
def test_units_signs_and_orders_are_found_and_corrected(how, log, arm):
    """Each is found with its size, nothing else is made of it, and its correction gives the sound log back, with
    one note. A single reversed torque is that joint's, all of them are nobody's."""
    name, value = SPOILED[how]
    bad = spoiled(log, arm, how)
    corrected, examination = doctor.correct(bad, arm)
    assert set(alarms(examination)) == {name}
    (found,) = seen(examination, name)
    assert found.value == pytest.approx(value, rel=0.05)
    assert found.joint == (arm.joints[1] if how == "one sign" else None)
    assert examination.usable
    notes = doctor.done(examination)
    assert len(notes) == 1
    for channel in ("t", "q", "qd", "tau"):
        now, before = getattr(corrected.trajectories[0], channel), getattr(log.trajectories[0], channel)
        np.testing.assert_allclose(now, before, rtol=1e-9, atol=1e-12)


def test_a_torque_of_another_size_is_not_turned(log, arm):
    """A heavy payload may turn the torque of a light joint, and makes it several times as large: no sign is wrong."""
    tau = log.trajectories[0].tau * np.array([1, 1, 1, 1, 1, 1, -4])
    assert seen(doctor.examine(changed(log, tau=tau), arm), "sign_error") == []


FLAT = """<robot name="flat"><link name="base"/>{}</robot>""".format(
    "".join(
        f"""<link name="l{i}"><inertial><origin xyz="0.15 0 0"/><mass value="{2 / i}"/>
        <inertia ixx="0.05" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="j{i}" type="revolute"><parent link="{"base" if i == 1 else "l1"}"/><child link="l{i}"/>
        <origin xyz="{0.3 * (i - 1)} 0 0"/><axis xyz="0 0 1"/>
        <limit lower="-1.5" apollo4="1.5" velocity="2" effort="50"/></joint>"""
        for i in (1, 2)
    )
)
"""Two upright axes, which gravity does not load; every link has the same round inertia, as a placeholder has."""


@pytest.mark.parametrize("seed", usually([0], range(3)))
def test_a_spring_is_no_sign_error(seed, tmp_path):
    """A spring, as a hose is one, that outdoes an inertia ten times too large in the URDF makes a torque that runs
    against the nominal one: it is told, and not turned round; a torque that is turned round still is."""
    draw = np.random.default_rng(seed)
    (tmp_path / "flat.urdf").write_text(FLAT)
    robot = load_urdf(tmp_path / "flat.urdf")
    base = 0.2
    stiffness = float(0.0725 * (2 * np.pi * base) ** 2 * draw.uniform(2.5, 4.0))  # beside the URDF's inertia
    hidden = [
        Hidden("joint_spring", "j2", {"stiffness": stiffness, "rest": 0.0}),
        Hidden("link_inertia_error", "j2", {"mass": -0.9, "inertia": -0.95}),
    ]
    log = record(robot, [Multisine(base=base, harmonics=1)], hidden, noise=Noise(torque=1e-3), duration=25)
    corrected, examination = doctor.correct(log, robot)
    assert [(c.joint, c.severity) for c in seen(examination, "sign_error")] == [("j2", "warn")]
    np.testing.assert_array_equal(corrected.trajectories[0].tau, log.trajectories[0].tau)
    (raw,) = record(robot, [Multisine()], noise=Noise(torque=1e-3), duration=25).trajectories
    turned = replace(log, trajectories=(replace(raw, tau=raw.tau * [1, -1]),))
    assert [(c.joint, c.severity) for c in seen(doctor.examine(turned, robot), "sign_error")] == [("j2", "fail")]


def test_gravity_is_missed_in_exchanged_columns(log, arm):
    """Torques without gravity in the columns of other joints: both are found, gravity when the order is right."""
    swapped = order((1, 3))
    raw = log.trajectories[0]
    bad = changed(log, q=raw.q[:, swapped], qd=raw.qd[:, swapped], tau=without_gravity(log, arm)[:, swapped])
    corrected, examination = doctor.correct(bad, arm)
    assert set(alarms(examination)) == {"gravity_removed", "joint_order"}
    notes = doctor.done(examination)
    assert corrected.compensated == ("gravity",) and len(notes) == 2
    np.testing.assert_array_equal(corrected.trajectories[0].q, raw.q)


def test_gravity_that_is_removed_is_declared(log, arm):
    """Torques without gravity are found; the correction leaves them, and says so in the log's `compensated`."""
    bad = spoiled(log, arm, "no gravity")
    corrected, examination = doctor.correct(bad, arm)
    assert set(alarms(examination)) == {"gravity_removed"}
    assert corrected.compensated == ("gravity",)
    assert alarms(doctor.examine(corrected, arm)) == {}


def test_gravity_that_is_mostly_gone_has_no_direction(log, arm):
    """Of torques with a fifth of their gravity the check of the URDF compares neither base nor tool, and says why."""
    raw = log.trajectories[0]
    weak = changed(log, tau=0.2 * raw.tau + 0.8 * without_gravity(log, arm))
    assert [c for c in Description().examine(weak, arm) if "degrees" in c.seen or "kg" in c.seen] == []
    (found,) = [c for c in Description().examine(weak, arm) if c.severity == "skipped"]
    assert "not compared" in found.seen


@pytest.mark.parametrize("seconds", usually([-0.012], [0.03, -0.012]))
def test_an_offset_of_all_torques_is_found_and_corrected(seconds, shorter, apollo4):
    """30 ms late or 12 ms early: found within 1 ms, gone after the correction."""
    raw = shorter.trajectories[0]
    bad = changed(shorter, tau=delayed(raw.tau, raw.t, seconds))
    corrected, examination = doctor.correct(bad, apollo4)
    (found,) = seen(examination, "time_offset", least="warn")
    assert found.value == pytest.approx(seconds, abs=1e-3)
    assert seen(doctor.examine(corrected, apollo4), "time_offset", least="warn") == []


@pytest.mark.parametrize(("share", "early", "late"), [(0.7, 0.06, 0.03), (0.5, 0.04, -0.012)])
def test_friction_that_turns_early_does_not_time_the_torque(share, early, late, arm):
    """Torques 30 ms late or 12 ms early, and friction of most of their size that turns 40 to 60 ms before its joint:
    the offset is told within 3 ms. On all rows it is 23 to 45 ms too early."""
    smooth = sound(arm, coulomb=0.0)
    (raw,) = smooth.trajectories
    turns = np.tanh(delayed(motion(arm, raw.t, 0).qd, raw.t, -early) / 0.02)
    log = changed(smooth, tau=delayed(raw.tau + share * raw.tau.std(0) * turns, raw.t, late))
    (found,) = seen(doctor.examine(log, arm), "time_offset", least="warn")
    assert found.value == pytest.approx(late, abs=3e-3)


def test_currents_look_like_currents(shorter, apollo4):
    """Torques over a gain of each joint's own are told as such, and left alone."""
    bad = changed(shorter, tau=shorter.trajectories[0].tau / np.linspace(8, 40, 4))
    examination = doctor.examine(bad, apollo4)
    (found,) = seen(examination, "unit_error")
    assert found.severity == "warn" and "currents" in found.meaning
    assert doctor.done(examination) == ()


def test_currents_without_gains_get_some_suggested(shorter, apollo4):
    """torque_unit A without gains is not usable; the gains that the nominal torques suggest are those of the log."""
    bad = replace(changed(shorter, tau=shorter.trajectories[0].tau / 20), torque_unit="A")
    examination = doctor.examine(bad, apollo4)
    assert not examination.usable
    assert f"{apollo4.joints[1]} 20" in seen(examination, "unit_error")[0].seen


def test_currents_tell_nothing_of_tool_and_gravity(shorter, apollo4):
    """Amperes are not compared with the URDF's N m: no tool is missing, and gravity is not said to be subtracted."""
    bad = replace(changed(shorter, tau=shorter.trajectories[0].tau / 20), torque_unit="A")
    assert [x.seen for x in Description().examine(bad, apollo4) if x.severity == "warn"] == []


def test_a_torque_that_is_noise_is_no_torque(shorter, apollo4):
    """Noise of the right size fails as a mismatch: no inertials explain it."""
    tau = np.random.default_rng(0).normal(size=shorter.trajectories[0].tau.shape) * shorter.trajectories[0].tau.std(0)
    examination = doctor.examine(changed(shorter, tau=tau), apollo4)
    assert not examination.usable
    assert set(alarms(examination)) == {"model_mismatch"}


def test_a_computed_torque_is_no_measurement(apollo4):
    """Inverse dynamics logged as torque is recognised; so are positions that are their own command."""
    examination = doctor.examine(sound(apollo4, coulomb=0, viscous=0, noise=0), apollo4)
    assert set(alarms(examination)) == {"command_copies_measurement"}
    log = sound(apollo4)
    copied = changed(log, q_ref=log.trajectories[0].q.copy())
    assert set(alarms(doctor.examine(copied, apollo4))) == {"command_copies_measurement"}


def hopeless(raw: RawTrajectory) -> dict[str, dict]:
    still = np.ones_like(raw.q)
    nan = np.full_like(raw.q, np.nan)
    few = slice(0, 100)
    return {
        "all zero": {"q": 0 * raw.q, "qd": 0 * raw.q, "tau": 0 * raw.q},
        "constant": {"q": 0.3 * still, "qd": 0 * raw.q, "tau": still},
        "torque zero": {"tau": 0 * raw.tau},
        "torque NaN": {"tau": nan},
        "everything NaN": {"t": np.full_like(raw.t, np.nan), "q": nan, "qd": nan, "tau": nan},
        "clock stands": {"t": 0 * raw.t},
        "half a second": {c: getattr(raw, c)[few] for c in ("t", "q", "qd", "tau")},
        "one row": {c: getattr(raw, c)[:1] for c in ("t", "q", "qd", "tau")},
        "rows missing": {"tau": raw.tau[:-1]},
        "columns missing": {"tau": raw.tau[:, :-1]},
        "huge": {"q": 1e300 * raw.q},
    }


@pytest.mark.parametrize("known", [True, False], ids=["robot", "no robot"])
@pytest.mark.parametrize(
    "how", hopeless(RawTrajectory("", np.zeros(2), np.zeros((2, 1)), np.zeros((2, 1)), np.zeros((2, 1))))
)
def test_hopeless_logs_are_described(how, known, shorter, apollo4):
    """No readable log makes the doctor raise or stumble; what cannot be computed with is not usable and says why."""
    bad = changed(shorter, **hopeless(shorter.trajectories[0])[how])
    robot = apollo4 if known else None
    corrected, examination = doctor.correct(bad, robot)
    assert [c for c in examination.checks if c.meaning == doctor.FAULT] == []
    assert any(c.severity == "fail" for c in examination.checks) or how == "huge"
    if how != "huge":
        assert not examination.usable
    if corrected.trajectories:
        refuse_defects(corrected)


def test_a_log_without_trajectories(log, arm):
    """An empty log is described too."""
    assert not doctor.examine(replace(log, trajectories=()), arm).usable


def test_another_number_of_joints_is_refused(log, apollo4):
    """A robot that cannot be the log's is a failure of use, in one line."""
    with pytest.raises(RobotError, match="moves 4 joints, the log has 7"):
        doctor.examine(log, apollo4)


def test_one_joint_moving(log, arm):
    """Joints that stand are noted, each; the log stays usable, and says what it cannot show on them."""
    raw = log.trajectories[0]
    assert raw.qd is not None
    still = np.arange(7) != 1
    q, qd = np.where(still, 0.3, raw.q), np.where(still, 0.0, raw.qd)
    qdd = np.gradient(qd, 1 / log.rate, axis=0)
    tau = nominal_torque(arm, Motion(q, qd, qdd))[0] + 0.01 * np.random.default_rng(0).normal(size=q.shape)
    examination = doctor.examine(changed(log, q=q, qd=qd, tau=tau), arm)
    assert examination.usable
    assert {c.joint for c in seen(examination, "not_moving")} == set(np.array(arm.joints)[still])
    assert "coulomb_friction" in examination.excitation[arm.joints[0]]["cannot_show"]
    assert "coulomb_friction" not in examination.excitation[arm.joints[1]]["cannot_show"]


def test_excitation_tells_what_the_motion_was(log, arm):
    """Ranges and reversals per joint, and the condition of the whole arm's regressor."""
    examination = doctor.examine(log, arm)
    raw = log.trajectories[0]
    assert list(examination.excitation) == list(arm.joints)
    for j, joint in enumerate(arm.joints):
        numbers = examination.excitation[joint]
        np.testing.assert_allclose(numbers["q"], [raw.q[:, j].min(), raw.q[:, j].max()], atol=0.05)
        assert raw.qd is not None
        turns = np.sum(np.diff(np.sign(raw.qd[np.abs(raw.qd[:, j]) > 0.005, j])) != 0)
        assert abs(numbers["reversals"] - turns) <= 2
        assert 1 < numbers["condition"] < 1000


def test_without_reversals_friction_is_an_offset(arm):
    """A joint that only moves forward cannot tell Coulomb friction from an offset, and the excitation says why."""
    base = sound(arm, seconds=20)
    raw = base.trajectories[0]
    q = raw.q.copy()
    q[:, 0] = -1 + 0.1 * raw.t + 0.02 * np.sin(raw.t)
    numbers = doctor.examine(changed(base, q=q, qd=None), None).excitation[arm.joints[0]]
    assert numbers["reversals"] == 0
    assert "offset" in numbers["cannot_show"]["coulomb_friction"]


@pytest.mark.parametrize("seed", usually([0], range(3)))
def test_the_unit_of_one_joint(seed, log, arm):
    """One joint's torque in N mm among N m is that joint's, and is corrected; one joint's position in degrees, too."""
    joint = int(np.random.default_rng(seed).integers(1, 6))
    by = np.where(np.arange(7) == joint, 1e3, 1.0)
    bad = changed(log, tau=log.trajectories[0].tau * by)
    corrected, examination = doctor.correct(bad, arm)
    found = seen(examination, "unit_error", least="warn")
    assert [(c.joint, c.threshold["factor"]) for c in found] == [(arm.joints[joint], 1e3)]
    np.testing.assert_allclose(corrected.trajectories[0].tau, log.trajectories[0].tau)


@pytest.mark.parametrize("unit", usually(["kgf cm", "percent, one limit"], ["kgf cm", "percent", "percent, one limit"]))
def test_other_units_of_torque(unit, log, arm):
    """kgf cm and percent of rated torque, also of one that all joints have, are named, alone or beside what is as
    likely, and left for the user."""
    raw, limits = log.trajectories[0], np.array([200.0, 150, 80, 60, 30, 20, 9])
    limits = np.full(7, 300.0) if "one" in unit else limits
    robot = replace(arm, effort_limit=limits)
    bad = changed(log, tau=raw.tau * (10.1972 if unit == "kgf cm" else 100 / limits))
    examination = doctor.examine(bad, robot)
    (found,) = seen(examination, "unit_error", least="warn")
    assert unit.split(",")[0] in found.meaning
    assert doctor.done(examination) == ()


@pytest.mark.parametrize("seed", usually([0], range(2)))
def test_an_offset_of_a_session_is_one(seed, apollo4):
    """Of two recordings of a file one moves too little to time the torque: the offset of the other is both recordings'.
    Recordings with different offsets keep their own."""
    draw = np.random.default_rng(seed)
    late = float(draw.uniform(0.015, 0.06))
    raws = []
    for name, seconds in (("a", 25.0), ("b", 25.0), ("slow", 25.0)):
        (raw,) = sound(apollo4, int(draw.integers(1000)), seconds=seconds).trajectories
        raws.append(replace(raw, name=name, tau=delayed(raw.tau, raw.t, late)))
    slow = raws[2]
    raws[2] = replace(slow, q=0 * slow.q + slow.q[0] + 1e-5 * draw.normal(size=slow.q.shape), qd=None,
                      tau=0 * slow.tau + slow.tau[0] + 0.01 * draw.normal(size=slow.tau.shape))  # fmt: skip
    log = replace(sound(apollo4), trajectories=tuple(raws))
    (found,) = seen(doctor.examine(log, apollo4), "time_offset", least="warn")
    assert found.trajectory is None and found.value == pytest.approx(late, abs=1e-3)
    assert found.threshold["trajectories"] == ["a", "b", "slow"]
    other = replace(raws[1], tau=delayed(raws[1].tau, raws[1].t, 0.05))
    found = seen(doctor.examine(replace(log, trajectories=(raws[0], other)), apollo4), "time_offset", least="warn")
    assert {c.trajectory: c.value for c in found} == pytest.approx({"a": late, "b": late + 0.05}, abs=2e-3)


def test_windows_whose_rates_differ_by_rounding_are_timed_together(shorter, apollo4):
    """An arm rests, and moves after a gap, its torques 30 ms late: what moves is looked at, though the median step of
    its clock differs in the last digit."""
    raw = shorter.trajectories[0]
    late = replace(raw, tau=delayed(raw.tau, raw.t, 0.03))
    t = np.concatenate([raw.t - raw.t[0], raw.t - raw.t[0] + raw.t[-1] + 1 / 3])
    assert median_step(t[: len(raw.t)]) != median_step(t[len(raw.t) :])
    rows = np.concatenate([np.zeros(len(raw.t), int), np.arange(len(raw.t))])
    both = replace(shorter, trajectories=(replace(taken(late, rows), t=t),))
    (found,) = seen(doctor.examine(both, apollo4), "time_offset", least="warn")
    assert found.value == pytest.approx(0.03, abs=1e-3)


def test_a_recording_that_contradicts_its_session(arm):
    """Two joints alone tell that a third recording is 100 ms late: no offset of the session is stated or corrected."""
    log = sound(arm)
    raws = [replace(sound(arm, k).trajectories[0], name=name) for k, name in enumerate("abc")]
    raws = [replace(x, tau=delayed(x.tau, x.t, late)) for x, late in zip(raws, (0.03, 0.03, 0.1), strict=True)]
    noisy = raws[2].tau.std(0) * np.where(np.arange(7) < 4, 0.0, 3.0)
    raws[2] = replace(raws[2], tau=raws[2].tau + noisy * np.random.default_rng(0).normal(size=raws[2].tau.shape))
    found = seen(doctor.examine(replace(log, trajectories=tuple(raws)), arm), "time_offset")
    assert [c.trajectory for c in found if c.severity == "warn"] and all(c.trajectory for c in found)


def test_friction_tells_a_sign(log, arm):
    """Friction brakes every joint of a sound log, and would drive a joint whose torque has the opposite sign."""
    sound_work, turned_work = (
        SignError()._work(gather(changed(log, tau=sign * log.trajectories[0].tau), arm)) for sign in (1, -1)
    )
    assert sound_work.min() > -0.05 and sound_work.max() > 0.1
    np.testing.assert_allclose(turned_work, -sound_work, atol=1e-6)


def test_what_was_not_looked_at_is_skipped(log):
    """Without a robot, and without a q_ref, what needs them says so; it does not say ok."""
    examination = doctor.examine(log, None)
    skipped = {(c.check, c.seen) for c in examination.checks if c.severity == "skipped"}
    for name in ("gravity_removed", "joint_order", "sign_error", "unit_error", "time_offset"):
        assert (name, "no robot") in skipped
    assert ("time_offset", "q_ref is not logged") in skipped
    fine = {c.check for c in examination.checks if c.severity == "ok"}
    assert not {"gravity_removed", "joint_order", "sign_error", "time_offset", "model_mismatch"} & fine
