"""Defects of rows and clocks: found, counted, corrected; each was put into a sound log by the test."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.interpolate

from invdyn_cli.diagnosis import doctor
from invdyn_cli.diagnosis.checks import offset
from invdyn_cli.diagnosis.checks.offset import TimeOffset
from invdyn_cli.diagnosis.checks.samples import nominal_torque
from invdyn_cli.diagnosis.checks.saturation import Saturation
from invdyn_cli.diagnosis.checks.stamps import IrregularStamps, followed
from invdyn_cli.diagnosis.checks.values import Outliers
from invdyn_cli.log import Log, RawTrajectory
from invdyn_cli.logfile import refuse_defects
from invdyn_cli.recording.rows import clock_pieces, taken
from invdyn_cli.robots import load_urdf
from invdyn_cli.types import Motion
from tests.diagnosis.sick import alarms, changed, delayed, motion, seen, sound


@pytest.fixture(scope="module")
def arm(apollo4):
    """What is wrong with rows and clocks is the same for any number of joints."""
    return apollo4


@pytest.fixture(scope="module")
def log(arm):
    """A sound log of it, 30 s at 200 Hz."""
    return sound(arm)


@pytest.fixture(scope="module")
def seven():
    """The same of all seven joints, and the arm."""
    arm = load_urdf("apollo_arm")
    return sound(arm), arm


def test_missing_values(log, arm):
    """Rows with NaN are counted per channel; short holes are dropped, long ones part the trajectory."""
    raw = log.trajectories[0]
    tau = raw.tau.copy()
    tau[100, 2] = np.nan
    tau[3000:3400] = np.inf
    bad = changed(log, tau=tau)
    corrected, examination = doctor.correct(bad, arm)
    assert [c.value for c in seen(examination, "not_finite")] == [401]
    assert examination.usable
    refuse_defects(corrected)
    assert [(x.name, len(x.t)) for x in corrected.trajectories] == [("run.1", 2999), ("run.2", 2600)]


def test_an_empty_channel_is_left_out(log, arm):
    """Velocities that are all NaN cost the channel, not the rows."""
    bad = changed(log, qd=np.full_like(log.trajectories[0].q, np.nan))
    corrected, examination = doctor.correct(bad, arm)
    notes = doctor.done(examination)
    assert corrected.trajectories[0].qd is None
    assert len(corrected.trajectories[0].t) == len(log.trajectories[0].t)
    assert "without the channel qd" in notes[0]


def test_repeated_rows(log, arm):
    """Samples that were held while the arm moved are counted and dropped."""
    raw = log.trajectories[0]
    rows = np.arange(len(raw.t))
    held = np.sort(np.random.default_rng(1).choice(rows[100:-100:3], 200, replace=False))
    rows[held] = held - 1
    bad = changed(log, q=raw.q[rows], qd=raw.qd[rows], tau=raw.tau[rows])
    corrected, examination = doctor.correct(bad, arm)
    (found,) = seen(examination, "duplicates", least="warn")
    assert 150 <= found.value <= 200
    assert len(corrected.trajectories[0].t) == len(raw.t) - found.value


def test_a_clock_that_stands_and_runs_backwards(log, arm):
    """Such rows are dropped, and nothing else."""
    t = log.trajectories[0].t.copy()
    t[1000:1003] = t[999]
    t[2000] -= 0.02
    bad = changed(log, t=t)
    corrected, examination = doctor.correct(bad, arm)
    (found,) = seen(examination, "duplicates")
    assert (found.severity, found.value) == ("fail", 4)
    assert examination.usable
    refuse_defects(corrected)
    assert len(corrected.trajectories[0].t) == len(t) - 4


@pytest.mark.parametrize("bad", [[(3, 2.7e154)], [(0, 1e9)], [(700, 1e9), (2500, -1e9), (2501, 5.0), (4000, 1e300)]])
def test_single_stamps_that_are_wrong(bad, log, arm):
    """A stamp that is wrong by any amount costs its own row and no other."""
    t = log.trajectories[0].t.copy()
    for row, stamp in bad:
        t[row] = stamp
    wrong = changed(log, t=t)
    corrected, examination = doctor.correct(wrong, arm)
    (found,) = seen(examination, "duplicates")
    assert found.value == len(bad) and examination.usable
    notes = doctor.done(examination)
    refuse_defects(corrected)
    assert [len(x.t) for x in corrected.trajectories] == [len(t) - len(bad)], notes


def test_the_longest_sequence_is_the_longest():
    """On short random clocks, no increasing sequence of rows is longer than the one that is kept (all were tried)."""
    rng = np.random.default_rng(5)
    for _ in range(50):
        t = rng.integers(0, 8, 9).astype(float)
        (rows,) = clock_pieces(t)
        assert np.all(np.diff(t[rows]) > 0)
        subsets = (np.flatnonzero([k >> i & 1 for i in range(9)]) for k in range(1, 2**9))
        assert len(rows) == max(len(x) for x in subsets if np.all(np.diff(t[x]) > 0))


def test_a_clock_that_starts_anew(log, arm):
    """Two recordings in one become two trajectories, whole."""
    t = log.trajectories[0].t.copy()
    t[3000:] -= t[3000]
    bad = changed(log, t=t)
    corrected, _ = doctor.correct(bad, arm)
    refuse_defects(corrected)
    assert [len(x.t) for x in corrected.trajectories] == [3000, 3000]


def test_gaps(log, arm):
    """The longest gap's length is given; gaps alone are a note."""
    raw = log.trajectories[0]
    keep = np.ones(len(raw.t), bool)
    keep[2000:2100] = keep[4000:4050] = False
    (found,) = seen(doctor.examine(replace(log, trajectories=(taken(raw, keep),)), arm), "gaps")
    assert found.value == pytest.approx(0.505, abs=1e-6)
    assert found.severity == "note"


def test_jitter_and_the_nominal_rate(log, arm):
    """Samples that were taken a fifth of a step off are noted with that number; a wrong nominal rate is warned of."""
    raw = log.trajectories[0]
    t = raw.t + 0.001 * np.random.default_rng(2).uniform(-1, 1, len(raw.t))
    q, tau = (scipy.interpolate.make_interp_spline(raw.t, x)(t) for x in (raw.q, raw.tau))
    (found,) = seen(doctor.examine(changed(log, t=t, q=q, tau=tau), arm), "clock_jitter")
    assert (found.severity, found.value) == ("note", pytest.approx(0.2 * np.sqrt(2 / 3), rel=0.1))
    (found,) = seen(doctor.examine(replace(log, rate=125.0), arm), "clock_jitter")
    assert (found.severity, found.value) == ("warn", pytest.approx(200, rel=1e-3))


def test_stamps_that_vary_about_regular_samples(log, arm):
    """Stamps written up to a fifth of a step late, some rows missing: told by the positions, which follow none of it,
    and put on the regular clock, up to the mean delay, to a hundredth of a step."""
    raw, draw = log.trajectories[0], np.random.default_rng(4)
    keep = np.ones(len(raw.t), bool)
    keep[draw.choice(np.arange(100, len(keep) - 100, 50), 5, replace=False)] = False
    step = raw.t[1] - raw.t[0]
    kept = taken(raw, keep)
    late = draw.uniform(0, 0.2 * step, len(kept.t))
    corrected, examination = doctor.correct(
        replace(log, trajectories=(replace(kept, t=kept.t + late),)), arm, checks=[IrregularStamps()]
    )
    (found,) = seen(examination, "clock_jitter")
    assert found.severity == "note" and abs(found.value) < 0.01
    off = corrected.trajectories[0].t - kept.t
    assert np.ptp(off) < 0.01 * step and abs(off.mean() - 0.1 * step) < 0.01 * step


@pytest.mark.parametrize("size", [0.02, 0.2])
def test_stamps_that_samples_follow_are_believed(log, arm, size):
    """A clock that varies, with its samples, by 2 % or a fifth of a step."""
    raw = log.trajectories[0]
    step = raw.t[1] - raw.t[0]
    t = raw.t + size * step * np.random.default_rng(6).uniform(-1, 1, len(raw.t))
    q = scipy.interpolate.make_interp_spline(raw.t, raw.q)(t)
    told = followed(replace(raw, t=t, q=q), [np.arange(len(t))])
    assert told is not None and told.share == pytest.approx(1.0, abs=max(4 * told.error, 0.02))
    corrected, _ = doctor.correct(changed(log, t=t, q=q), arm, checks=[IrregularStamps()])
    np.testing.assert_array_equal(corrected.trajectories[0].t, t)


def test_outliers(log, arm):
    """Single wild samples of q and tau are counted where they are, and replaced to within the noise's reach."""
    raw = log.trajectories[0]
    rng = np.random.default_rng(3)
    rows = np.sort(rng.choice(np.arange(50, 5900, 40), 12, replace=False))
    tau, q = raw.tau.copy(), raw.q.copy()
    tau[rows, 1] += rng.choice([-1, 1], 12) * 5 * np.ptp(raw.tau[:, 1])
    q[rows[:4] + 9, 3] += 0.2
    bad = changed(log, q=q, tau=tau)
    corrected, examination = doctor.correct(bad, arm)
    assert set(alarms(examination)) == {"outliers"}
    assert {(c.threshold["channel"], c.joint, c.value) for c in seen(examination, "outliers")} == {
        ("tau", arm.joints[1], 12),
        ("q", arm.joints[3], 4),
    }
    np.testing.assert_allclose(corrected.trajectories[0].q, raw.q, atol=1e-3)
    np.testing.assert_allclose(corrected.trajectories[0].tau[:, 1], raw.tau[:, 1], atol=0.1 * raw.tau[:, 1].std())


def test_the_jerk_of_a_stop_is_no_outlier(log):
    """An arm that is stopped within 40 ms jerks for one sample, and a filter's answer to a step has a peak of several:
    neither is a transmission error; the same sample in the middle of a motion is one."""
    raw = log.trajectories[0]
    stop = 3000
    t = np.minimum(raw.t, raw.t[stop])  # of the motion: it stands still from there
    q = np.stack([np.interp(t, raw.t, x) for x in raw.q.T], axis=1)
    tau = raw.tau.copy()
    tau[stop + 1, 1] += 5 * np.ptp(raw.tau[:, 1])
    qdd = np.stack([np.gradient(np.gradient(x, raw.t), raw.t) for x in raw.q.T], axis=1)
    qdd = np.stack([np.convolve(x, np.ones(20) / 20, "same") for x in qdd.T], axis=1)
    peak = 20 * np.ptp(qdd[100:-100, 2]) * np.exp(-0.5 * (np.arange(-10, 11) / 2.5) ** 2)
    qdd[1500 - 10 : 1500 + 11, 2] += peak
    found = Outliers().examine(changed(log, q=q, qd=None, qdd=qdd, tau=tau), None)
    assert [c for c in found if c.threshold["channel"] == "tau" or c.joint == log.joints[2]] == []
    (found,) = Outliers().examine(changed(log, qd=None, tau=tau), None)
    assert (found.joint, found.value, found.threshold["channel"]) == (log.joints[1], 1, "tau")


def test_noise_and_friction_have_no_outliers(arm):
    """Heavy-tailed noise and Coulomb steps are no outliers."""
    log = sound(arm, 5, coulomb=0.6, noise=0.02)
    tau = log.trajectories[0].tau
    heavy = tau + 0.005 * tau.std(0) * np.random.default_rng(4).standard_t(4, tau.shape)
    assert seen(doctor.examine(changed(log, tau=heavy), arm), "outliers", least="warn") == []


def test_quantisation(log, arm):
    """An encoder of 12 bit on a turn: its step is measured, and found coarse for accelerations."""
    step = 2 * np.pi / 4096
    q = np.round(log.trajectories[0].q / step) * step
    found = seen(doctor.examine(changed(log, q=q), arm), "quantisation")
    assert {c.joint for c in found} == set(arm.joints)
    assert [c.value for c in found] == pytest.approx([step] * 4, rel=1e-6)


def test_a_rest_after_a_gap_does_not_coarsen_an_encoder(log, arm):
    """A motion, a second without rows, and a slow end: an encoder of 12 bit is as fine as without
    them."""
    raw, step = log.trajectories[0], 2 * np.pi / 4096
    t = np.where(np.arange(len(raw.t)) < 0.8 * len(raw.t), raw.t, raw.t + 1.0)
    still = raw.q[int(0.8 * len(raw.t))]
    q = np.where((raw.t < t)[:, None], still + 0.02 * (raw.q - still), raw.q)
    for when, angles in ((raw.t, raw.q), (t, q)):
        log = changed(log, t=when, q=np.round(angles / step) * step, qd=None)
        found = seen(doctor.examine(log, arm), "quantisation")
        assert {c.joint: c.severity for c in found} == dict.fromkeys(arm.joints, "note")


def test_coarse_torques(log, arm):
    """A torque with twenty levels over its range is warned of."""
    tau = log.trajectories[0].tau.copy()
    step = np.ptp(tau[:, 1]) / 20
    tau[:, 1] = np.round(tau[:, 1] / step) * step
    (found,) = seen(doctor.examine(changed(log, tau=tau), arm), "quantisation", least="warn")
    assert (found.joint, found.value) == (arm.joints[1], pytest.approx(step))


def test_saturation(log, arm):
    """Torques cut at a level are warned of with the level, on that joint alone."""
    tau = log.trajectories[0].tau.copy()
    level = float(np.quantile(tau[:, 3], 0.9))
    tau[:, 3] = np.minimum(tau[:, 3], level)
    found = seen(doctor.examine(changed(log, tau=tau), arm), "saturation")
    assert [(c.joint, c.value) for c in found] == [(arm.joints[3], pytest.approx(level))]


@pytest.mark.parametrize(("seed", "noise"), [(1, 0.01), (2, 0.0), (3, 0.02), (4, 0.003)])
def test_rows_at_a_limit_are_left_out(seed, noise, arm):
    """A sensor that ends at a limit on both sides, with noise behind it of a share of the torque's deviation or none:
    rows at the limit are left out, and not one of ten others."""
    draw = np.random.default_rng([seed, 71])
    log = sound(arm, seed, seconds=40.0, rate=500.0, noise=1e-4)
    (raw,) = log.trajectories
    level = float(np.quantile(np.abs(raw.tau[:, 3]), draw.uniform(0.75, 0.9)))
    tau = raw.tau + noise * raw.tau.std(0) * draw.normal(size=raw.tau.shape)
    tau[:, 3] += np.clip(raw.tau[:, 3], -level, level) - raw.tau[:, 3]
    corrected, examination = doctor.correct(changed(log, tau=tau), arm)
    found = seen(examination, "saturation")
    assert {c.joint for c in found} == {arm.joints[3]}
    assert [abs(c.value) for c in found] == pytest.approx(len(found) * [level], rel=0.01)
    kept = np.isin(raw.t, np.concatenate([x.t for x in corrected.trajectories]))
    beyond = np.abs(raw.tau[:, 3]) > level
    assert np.mean(kept[beyond]) < 0.1 and np.mean(kept[~beyond]) > 0.9


def test_where_a_torque_jitters_about_a_limit_nothing_is_interpolated(arm):
    """In the first half of a log, noise is added to the torque, and a sensor's limit cuts it. The readings between the
    cut ones are too low, and are left out as well; of the second half, more than nine of ten rows stay."""
    log = sound(arm, 5, seconds=40.0, rate=500.0, noise=1e-4)
    (raw,) = log.trajectories
    tau, early = raw.tau.copy(), raw.t < 20.0
    jitter = 0.3 * raw.tau[:, 3].std() * np.random.default_rng(72).normal(size=len(raw.t))
    level = float(np.quantile(raw.tau[early, 3], 0.01))  # nearly all motion is above it
    tau[:, 3] += np.where(early, jitter, 0.0)
    tau[early, 3] = np.minimum(tau[early, 3], level)
    tau[~early, 3] = np.minimum(tau[~early, 3] - tau[~early, 3].max() + level - 1.0, level)
    corrected, _ = doctor.correct(changed(log, tau=tau), arm)
    kept = np.isin(raw.t, np.concatenate([x.t for x in corrected.trajectories]))
    assert not kept[early & (raw.t > 0.1) & (raw.t < 19.9)].any() and kept[~early].mean() > 0.9


def test_what_stays_at_one_torque_for_a_reason(arm):
    """An arm that returns to a posture and rests there, and a slow joint without gravity, whose friction is all its
    torque, are at no limit, though their torque returns to its extreme and scatters there no more than noise does."""
    t = np.arange(6000) / 200.0
    turn = np.clip(4.0 * np.sin(2 * np.pi * t / 10.0), -1.0, 1.0)[:, None]
    q = 0.3 + 0.5 * turn * np.ones(len(arm.joints))
    qd = np.gradient(q, t, axis=0)
    held, _ = nominal_torque(arm, Motion(q, qd, np.gradient(qd, t, axis=0)))
    noise = np.random.default_rng(3).normal(size=q.shape)
    rests = RawTrajectory("run", t, q, held + 0.01 * held.std(0) * noise)
    moved = motion(arm, t, 0)
    slides = RawTrajectory("run", t, moved.q, np.sign(moved.qd) + 0.01 * noise)
    one = Log(arm.name, arm.joints, "link", "N m", 200.0, (rests,))
    assert Saturation().examine(one, arm) == []
    other = replace(one, trajectories=(slides,), compensated=("gravity",))
    assert Saturation().examine(other, arm) == []


def test_saturation_of_what_is_mostly_noise(log, arm):
    """Noise that is cut at a level returns to it again and again, never for long: warned of. Rounded noise is not."""
    tau = log.trajectories[0].tau.copy()
    tau[:, 3] = np.random.default_rng(2).normal(size=len(tau))
    coarse = changed(log, tau=np.where(np.arange(len(arm.joints)) == 3, tau.round(1), tau))
    tau[:, 3] = np.minimum(tau[:, 3], 1.3)
    found = Saturation().examine(changed(log, tau=tau), arm)
    assert [(c.joint, c.value) for c in found] == [(arm.joints[3], pytest.approx(1.3))]
    assert Saturation().examine(coarse, arm) == []


def test_the_effort_limit(log, arm):
    """Torques that reach the URDF's effort limit, and stay, are warned of even with noise on top."""
    tau = log.trajectories[0].tau
    bound = float(np.quantile(np.abs(tau[:, 3]), 0.9))
    cut = tau.copy()
    noise = np.random.default_rng(5).normal(size=len(tau))
    cut[:, 3] = np.clip(tau[:, 3], -bound, bound) * (1 - 0.001 * np.abs(noise))
    limits = np.array(arm.effort_limit)
    limits[3] = bound
    found = seen(doctor.examine(changed(log, tau=cut), replace(arm, effort_limit=limits)), "saturation")
    assert [c.joint for c in found] == [arm.joints[3]]


def test_derivatives_that_are_none(log, arm):
    """Velocities of another joint are no derivative: they fail and are left out; slow filters are a warning."""
    raw = log.trajectories[0]
    bad = changed(log, qd=raw.qd[:, ::-1].copy())
    corrected, examination = doctor.correct(bad, arm)
    assert set(alarms(examination)) == {"derivative_consistency"}
    assert examination.usable
    assert corrected.trajectories[0].qd is None
    (found,) = seen(doctor.examine(changed(log, qd=1.2 * raw.qd), arm), "derivative_consistency")
    assert (found.severity, found.value) == ("warn", pytest.approx(1.2, rel=0.02))


def test_a_lag_of_velocities(log, arm):
    """Velocities that come 20 ms late are noted, with four samples."""
    raw = log.trajectories[0]
    (found,) = seen(doctor.examine(changed(log, qd=delayed(raw.qd, raw.t, 0.02)), arm), "derivative_consistency")
    assert found.severity == "note" and "with a lag of 4 samples" in found.seen


def test_poses_are_no_motion(arm):
    """Rows in no order are told so and left out."""
    log = sound(arm)
    rows = np.random.default_rng(6).permutation(len(log.trajectories[0].t))
    raw = replace(taken(log.trajectories[0], rows), t=log.trajectories[0].t, name="poses")
    both = replace(log, trajectories=(*log.trajectories, raw))
    corrected, examination = doctor.correct(both, arm)
    assert examination.usable
    assert [c.trajectory for c in seen(examination, "derivative_consistency", least="warn")] == ["poses"]
    assert [x.name for x in corrected.trajectories] == ["run"]


def test_short_trajectories_are_left_out(log, arm):
    """0.3 s beside 30 s: left out with a word; alone: not usable."""
    short = replace(taken(log.trajectories[0], slice(0, 60)), name="short")
    both = replace(log, trajectories=(*log.trajectories, short))
    corrected, examination = doctor.correct(both, arm)
    assert examination.usable
    notes = doctor.done(examination)
    assert [x.name for x in corrected.trajectories] == ["run"]
    assert notes == ("short: left out, 0.295 s without a break",)
    assert not doctor.examine(replace(log, trajectories=(short,)), arm).usable


def test_tracking_lag_is_noted(arm):
    """Positions that follow their command 20 ms late are a note with that number."""
    log = sound(arm, channels=("q_ref",))
    (found,) = seen(doctor.examine(log, arm), "time_offset")
    assert (found.severity, found.value) == ("note", pytest.approx(0.02, abs=2e-3))


def test_an_offset_is_that_of_the_joints_that_tell_it(seven):
    """Torques 30 ms late, two joints of seven 50 and 60 ms later still: found within 3 ms. Where every joint has a lag
    of its own, none is corrected, and their range is said."""
    log, arm = seven
    raw = log.trajectories[0]
    for own, right in (([0, 0, 0, 0, 0.05, 0.06, 0], True), (np.linspace(-0.12, 0.12, 7), False)):
        tau = [delayed(x, raw.t, 0.03 + late) for x, late in zip(raw.tau.T, own, strict=True)]
        examination = doctor.correct(changed(log, tau=np.stack(tau, axis=1)), arm, (TimeOffset(),))[1]
        shared = [c for c in examination.checks if c.joint is None]
        assert [c.severity == "warn" for c in shared] == [right]
        if right:
            assert shared[0].value == pytest.approx(0.03, abs=3e-3)
        else:
            assert "standard error" in shared[0].seen and doctor.done(examination) == ()


def test_an_offset_that_the_others_contradict_is_none(seven):
    """Four of seven joints come 11 ms late, and three tell as clearly of less, as where friction sets in late at
    reversals: nothing is corrected."""
    log, arm = seven
    raw = log.trajectories[0]
    early = [0.011, 0.011, 0, 0.011, 0.011, 0.007, 0.004]
    tau = [delayed(x, raw.t, late) for x, late in zip(raw.tau.T, early, strict=True)]
    examination = doctor.correct(changed(log, tau=np.stack(tau, axis=1)), arm, (TimeOffset(),))[1]
    assert doctor.done(examination) == ()


@pytest.mark.parametrize(("gain", "shared"), [(1.05, False), (1.2, True)])
def test_an_offset_that_one_joint_tells_is_a_late_drive(gain, shared, log):
    """A joint that tells more than all others together comes 9 ms late. The others lean to its side, as friction has
    them; unless one of them says so clearly, too, it is the joint's own delay."""
    offsets = {0: 0.009, 1: 0.004, 2: 0.009, 3: 0.003, 4: 0.004, 5: 0.006}
    gains = {0: 10.0, 1: 1.05, 2: gain, 3: 1.0, 4: 1.01, 5: 1.03}
    weights = {0: 3.8, 1: 0.7, 2: 0.1, 3: 0.1, 4: 0.1, 5: 0.3}
    shifts = offset._Shifts("one", offsets, gains, weights, 0.0083, 0.0012, 1000.0)
    assert TimeOffset()._shared(shifts, log) == shared


def test_the_log_is_corrected_on_the_way(log, arm):
    """Every check sees the log as those before it corrected it; rows keep their stages and where they stood."""
    raw = log.trajectories[0]
    t = raw.t.copy()
    t[[1000, 2000]] += 1e3
    rows = np.arange(len(t))
    bad = changed(log, t=t, stage=rows // 100, rows=rows)
    told = []
    corrected, examination = doctor.correct(
        bad, arm, follow=lambda log, found: told.append((log, [c.check for c in found]))
    )
    assert len(told) == len(doctor.CHECKS) and told[0][0] is bad
    assert [found for _, found in told if "duplicates" in found] == [["duplicates"]]
    assert len(doctor.done(examination)) == 1
    kept = np.delete(rows, [1000, 2000])
    np.testing.assert_array_equal(corrected.trajectories[0].rows, kept)
    np.testing.assert_array_equal(corrected.trajectories[0].stage, kept // 100)
