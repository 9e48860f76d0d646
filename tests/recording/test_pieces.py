"""A log made ready: nothing is invented by a filter, a clock, or the other half of the data."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from invdyn_cli.diagnosis.columns.evidence import filtered
from invdyn_cli.errors import LogError
from invdyn_cli.log import RawTrajectory
from tests.diagnosis.analytic import arm, column, evidence_of, in_turn, log_of, moved, on, raw, recording_of
from tests.diagnosis.sick import motion

FRICTION = on(1, lambda t, q, qd, qdd: 2.0 * np.sign(qd) + 0.5 * qd)


def least_squares(columns: list[np.ndarray], y: np.ndarray) -> np.ndarray:
    return np.linalg.lstsq(np.column_stack(columns), y)[0]


@pytest.mark.parametrize("cutoff", [5.0, 20.0])
def test_torque_and_columns_pass_one_filter(cutoff):
    """Coulomb 2.0 and viscous 0.5 without noise come out within 0.1 %, whatever the cut-off; with
    the sign of the filtered velocity beside the filtered torque the Coulomb friction is off by ten times that."""
    names = ["coulomb_friction", "viscous_friction"]
    evidence = evidence_of(log_of(raw(*moved(rate=1000.0), FRICTION)), names, cutoffs=(cutoff,))
    y = evidence.tables[1][:, 0]
    got = least_squares([column(evidence, x, 1) for x in names], y)
    np.testing.assert_allclose(got, [2.0, 0.5], rtol=1e-3)
    speed = filtered(evidence.recording, [s[1].qd for s in evidence.states], 1)
    wrong = least_squares([np.sign(speed), speed], y)
    assert abs(wrong[0] - 2.0) > 0.02


def test_derivatives_are_those_of_the_motion():
    """Velocities and accelerations of a noise-free log are the analytic ones to 1e-4 inside, from positions alone."""
    t, m = moved(rate=1000.0)
    for piece in recording_of(log_of(raw(t, m))).pieces:
        rows = np.searchsorted(t, piece.t - 1e-6)[100:-100]
        for got, true in ((piece.qd, m.qd), (piece.qdd, m.qdd)):
            assert np.abs(got[:, 100:-100] - true[rows].T).max() < 1e-4 * np.abs(true).max()


def test_no_end_of_a_stretch_has_an_acceleration_of_its_own():
    """Up to its first and last sample, noise of 1e-5 rad or not, a stretch has the motion's accelerations within a
    fifth of the largest: what has a state would start with a blow."""
    t, m = moved(rate=1000.0)
    for noise in (0.0, 1e-5):
        for piece in recording_of(log_of(raw(t, m, position=noise))).pieces:
            rows = np.searchsorted(t, piece.t - 1e-6)
            off = np.abs(piece.qdd - m.qdd[rows].T)
            assert off.max() < 0.2 * np.abs(m.qdd).max()


def test_a_slow_joint_behind_a_coarse_encoder_still_moves():
    """All joints in steps of 14 bits, one at a fiftieth of the others' speed. Its speed is smoothed until four standard
    deviations of the steps' noise are below half of it, and it counts as moving on a fifth of the rows, not on none;
    the others keep their 60 Hz."""
    step = 2 * np.pi / 2**14
    t, m = moved(rate=500.0)
    whole = raw(t, m)
    q = m.q * np.array([1.0, 0.02, 1.0])
    evidence = evidence_of(log_of(replace(whole, q=step * np.round(q / step))), ["viscous_friction"])
    bands = list(evidence.recording.details["motion_cutoff_Hz"].values())
    assert bands[0] == bands[2] == 60.0 and bands[1] < 45.0
    usual = np.quantile(np.abs(np.gradient(q[:, 1], t)), 0.9)
    assert all(4 * piece.motion_noise[1] < usual / 2 for piece in evidence.recording.pieces)
    assert evidence.valid[:, 1].mean() > 0.2


def test_roles_do_not_mix():
    """Whatever stands in the part that judges, every number of the part that chooses is the same, and no time is in
    both."""
    t, m = moved()
    good = raw(t, m, FRICTION)
    bad = replace(good, tau=np.where(t[:, None] < 28.0, good.tau, 100.0), q=np.where(t[:, None] < 28.0, good.q, 0.0))
    windows = {"train": [("run", -np.inf, 28.0)], "test": [("run", 28.0, np.inf)]}
    one, other = (recording_of(log_of(x), windows, cutoffs=(10.0,)).pieces for x in (good, bad))
    assert [p.role for p in one] == ["train", "test"]
    for name in ("t", "q", "qd", "qdd", "tau"):
        assert np.array_equal(getattr(one[0], name), getattr(other[0], name))
    assert one[0].t[-1] < one[1].t[0]


def test_the_first_share_of_every_trajectory_chooses():
    """Without windows the first 70 % of each trajectory's time chooses and the rest judges."""
    twice = log_of(raw(*moved(seconds=20)), replace(raw(*moved(seconds=30)), name="more"))
    pieces = recording_of(twice).pieces
    assert [(p.trajectory, p.role) for p in pieces] == [
        ("run", "train"), ("run", "test"), ("more", "train"), ("more", "test"),
    ]  # fmt: skip
    ends = 2 * (2 + 3)  # ENDS, and a period of the low-pass of 87.5 Hz, at either end
    np.testing.assert_allclose([(len(p.t) + ends) / 250 for p in pieces], [14, 6, 21, 9], atol=0.02)


def test_of_joints_that_move_one_after_the_other_all_are_learned():
    """A third of every joint's way, at least, is in what chooses, and some in what judges; with all joints in motion
    the first share of the whole is."""
    pieces = recording_of(log_of(raw(*in_turn(60.0)))).pieces
    ways = {
        role: np.sum([np.abs(np.diff(p.q)).sum(axis=1) for p in pieces if p.role == role], axis=0)
        for role in ("train", "test")
    }
    share = ways["train"] / (ways["train"] + ways["test"])
    assert np.all(share > 1 / 3) and np.all(share < 0.95)
    assert [p.role for p in recording_of(log_of(raw(*moved(60.0)))).pieces] == ["train", "test"]


def test_of_joints_that_move_one_after_the_other_all_are_judged():
    """The first of the joints has come to rest for good before the last three tenths of the time: at least a twentieth
    of its way, and of every other's, is held out all the same."""
    pieces = recording_of(log_of(raw(*in_turn(30.0)))).pieces
    ways = [np.sum([np.abs(np.diff(p.q)).sum(axis=1) for p in pieces if p.role in roles], axis=0)
            for roles in (("test",), ("train", "test"))]  # fmt: skip
    assert np.all(ways[0] > 0.05 * ways[1])


@pytest.mark.parametrize("seconds", [33.0, 36.0])
def test_parts_of_a_trajectory_are_as_long_as_the_filters_need(seconds):
    """Five parts would hold out 2 s each, and a low-pass of 2.5 Hz needs more: then there are fewer."""
    pieces = recording_of(log_of(raw(*in_turn(seconds))), cutoffs=(2.5,)).pieces
    assert {p.role for p in pieces} == {"train", "test"}


def test_pieces_of_a_trajectory_are_in_the_order_of_time():
    """Also where what judges was chosen before what learns, and where joints move one after the other."""
    windows = {"train": [("run", 12.0, np.inf)], "test": [("run", -np.inf, 12.0)]}
    for recording in (recording_of(log_of(raw(*moved())), windows), recording_of(log_of(raw(*in_turn(60.0))))):
        starts = [p.t[0] for p in recording.pieces]
        assert len(starts) > 1 and starts == sorted(starts)


def test_a_gap_parts_a_trajectory():
    """A step of more than 0.1 s ends a piece: nothing is interpolated over it."""
    one = raw(*moved())
    kept = (one.t < 10.0) | (one.t > 10.3)
    cut = replace(one, t=one.t[kept], q=one.q[kept], tau=one.tau[kept])
    pieces = recording_of(log_of(cut)).pieces
    assert [p.role for p in pieces] == ["train", "train", "test"]
    assert not any(p.t[0] < 10.1 < p.t[-1] for p in pieces)


def test_a_jittered_clock_is_made_even():
    """Samples at uneven times give the same motion on an even clock, to 1e-5 rad, and the torque of even ones to 2 % of
    its peak (between samples it is a straight line)."""
    t, _ = moved()
    draw = np.random.default_rng(0)
    uneven = t + 0.0005 * draw.uniform(-1, 1, len(t))
    pieces = [recording_of(log_of(raw(x, motion(arm(), x, 0))), cutoffs=(10.0,)).pieces[0] for x in (t, uneven)]
    assert np.ptp(np.diff(pieces[1].t)) < 1e-9
    shared = slice(100, min(len(p.t) for p in pieces) - 100)
    even = motion(arm(), uneven[0] + pieces[1].t, 0)
    assert np.abs(pieces[1].q - even.q.T)[:, shared].max() < 1e-5
    assert np.abs(pieces[1].tau[:, shared] - pieces[0].tau[:, shared]).max() < 0.02 * np.abs(pieces[0].tau).max()


@pytest.mark.parametrize("answer", [0.0, 300.0])
def test_noise_is_told_at_the_log_s_own_rate(answer):
    """Both standard deviations come out within 10 %, a feedback of 300 N m/rad on the noise of the positions or not."""
    t, m = moved()
    one = raw(t, m, torque=0.05, position=5e-5)
    log = log_of(replace(one, tau=one.tau - answer * (one.q - m.q)))
    recording = recording_of(log)
    np.testing.assert_allclose(recording.position_noise, 5e-5, rtol=0.1)
    np.testing.assert_allclose(recording.torque_noise, 0.05, rtol=0.1)


def test_an_encoder_s_noise_is_no_less_than_its_step_makes():
    """A joint that rests for two thirds of the time shows no noise meanwhile; rounding to a step makes step / sqrt(12)
    all the same (Widrow 1956)."""
    t, m = moved(20.0, rate=1000.0)
    step = 2 * np.pi / 2**16
    rests = np.arange(len(t)) % 9000 < 6000
    at = np.maximum.accumulate(np.where(rests, 0, np.arange(len(t))))  # holds the last posture before the rest
    one = raw(t, m, torque=0.02)
    recording = recording_of(log_of(replace(one, q=step * np.round(m.q[at] / step))))
    assert np.all(recording.position_noise > 0.99 * step / np.sqrt(12))


def test_the_cut_off_falls_where_stamps_are_off_in_motion():
    """A joint that rests for two thirds of the time has no noise meanwhile; sampled up to 0.5 ms beside its stamps it
    has noise of its speed times that in motion, which white noise of that size on a joint that always moves makes, too:
    the cut-offs are those of one by 1.5 (half to twice the noise, to the power of 2.5)."""
    t, _ = moved(20.0, rate=250.0)
    rests = (t % 9.0) < 6.0
    place = np.maximum.accumulate(np.where(rests, 0.0, np.cumsum(~rests) / 250.0))  # goes on from where it stopped
    draw = np.random.default_rng(0)
    off = draw.uniform(-5e-4, 5e-4, len(t)) * ~rests
    at = motion(arm(), place + off, 0)
    speed = np.sqrt(np.mean(at.qd[~rests] ** 2, axis=0))
    white = motion(arm(), t, 0)
    noisy = white.q + speed * 1e-3 / np.sqrt(12) * draw.normal(size=white.q.shape)
    cutoffs = [
        recording_of(log_of(replace(raw(t, m, torque=0.02), q=q))).filter.cutoffs
        for m, q in ((at, at.q), (white, noisy), (white, white.q))
    ]
    assert max(cutoffs[0]) < min(cutoffs[2]) / 2
    np.testing.assert_allclose(np.log(np.divide(*cutoffs[:2])), 0, atol=np.log(1.5))


def test_the_cut_off_falls_with_the_noise_of_positions():
    """The noisier the encoders, the lower every joint's cut-off; without noise it is the highest of the list."""
    levels = [
        recording_of(log_of(raw(*moved(seconds=20), torque=0.02, position=x))).filter.cutoffs
        for x in (0.0, 1e-6, 1e-5, 1e-4, 1e-3)
    ]
    assert levels[0] == (40.0,) * 3
    assert np.all(np.diff(levels, axis=0) <= 0)
    assert max(levels[-1]) < min(levels[0]) / 4


def test_the_filter_is_the_one_that_it_says():
    """A zero-phase Butterworth of order 4 at the joint's own cut-off: the same as SciPy's on the whole piece."""
    recording = recording_of(log_of(raw(*moved(seconds=20))), cutoffs=(8.0,))
    common, piece = recording.filter, recording.pieces[0]
    wanted = sosfiltfilt(butter(4, 8.0, fs=250.0, output="sos"), piece.tau, axis=1)[:, common.rows(len(piece.t))]
    (filtered_torque,) = common([piece.tau])
    np.testing.assert_allclose(filtered_torque, wanted, atol=0.01 * np.abs(wanted).max())
    inner = slice(20, -20)
    np.testing.assert_allclose(filtered_torque[:, inner], wanted[:, inner], atol=1e-6 * np.abs(wanted).max())


def test_of_a_long_log_stretches_are_looked_at():
    """Of 60 s with at most 20 s looked at, stretches from all over make up about 20 s, and a sentence says so."""
    recording = recording_of(log_of(raw(*moved(seconds=60, rate=250.0))), longest=20.0, stretch=5.0)
    total = sum(p.t[-1] - p.t[0] for p in recording.pieces)
    assert 15 < total <= 20.5
    assert recording.pieces[0].t[0] < 1 and recording.pieces[-1].t[-1] > 45
    assert "60 s long" in recording.notes[0]


@pytest.mark.parametrize("longest", [20.0, 45.0, 54.0, 59.0])
def test_no_sample_of_a_long_log_is_used_twice(longest):
    """However much of a log is used, its stretches do not overlap."""
    recording = recording_of(log_of(raw(*moved(seconds=60, rate=250.0))), longest=longest, stretch=15.0)
    starts, ends = zip(*((p.t[0], p.t[-1]) for p in recording.pieces if p.role == "train"), strict=True)
    assert all(a < b for a, b in zip(ends, starts[1:], strict=False))


@pytest.mark.parametrize(("learns", "expected"), [(20.0, 20.0), (80.0, 42.0)])
def test_what_a_role_has_little_of_is_used_whole(learns, expected):
    """Of a log of 120 s, part of which was chosen to learn from, 60 s are used: that part whole if it is less than 70 %
    of these, else so much of it; the rest judges."""
    windows = {"train": [("run", 0.0, learns)], "test": [("run", learns, 120.0)]}
    log = log_of(raw(*moved(seconds=120, rate=250.0)))
    pieces = recording_of(log, windows, longest=60.0, stretch=5.0).pieces
    used = {role: sum(p.t[-1] - p.t[0] for p in pieces if p.role == role) for role in ("train", "test")}
    assert used["train"] == pytest.approx(expected, abs=1.0) and sum(used.values()) == pytest.approx(60.0, abs=1.5)


def test_too_little_is_refused():
    """A log too short for its own filter is refused with the length that is needed."""
    with pytest.raises(LogError, match="s are needed"):
        recording_of(log_of(raw(*moved(seconds=1.0))), cutoffs=(3.0,))


def test_time_counts_from_the_start_of_a_trajectory():
    """A clock that began in 1970 gives the times of one that began with the log, within a millisecond: its own steps
    are of 0.24 us."""
    one = raw(*moved(seconds=20))
    since, then = (recording_of(log_of(x), cutoffs=(10.0,)).pieces for x in (one, replace(one, t=one.t + 1.7e9)))
    for a, b in zip(since, then, strict=True):
        np.testing.assert_allclose(a.t, b.t, atol=1e-3)


@pytest.fixture(scope="module")
def handful():
    """Forty trajectories of 3 s."""
    t, m = moved(seconds=120)
    parts = [slice(k * 1500, (k + 1) * 1500) for k in range(40)]
    return [RawTrajectory(f"run_{k}", t[p], m.q[p], 0 * m.q[p]) for k, p in enumerate(parts)]


def test_many_short_trajectories_are_thinned_whole(handful):
    """Of more log than is looked at, short trajectories are left out or kept whole, in both roles."""
    pieces = recording_of(log_of(*handful), longest=30.0, cutoffs=(10.0,)).pieces
    length = {role: sum(p.t[-1] - p.t[0] for p in pieces if p.role == role) for role in ("train", "test")}
    assert 15 < length["train"] < 27 and (length["test"] == 0.0 or 5 < length["test"] < 12)
    assert len({p.trajectory for p in pieces}) > 5


def test_trajectories_too_short_to_be_parted_judge_as_wholes(handful):
    """Where no part of a trajectory is long enough to judge, the last trajectories do."""
    pieces = recording_of(log_of(*handful[:10]), cutoffs=(3.0,)).pieces
    assert [p.role for p in pieces] == ["train"] * 7 + ["test"] * 3


@pytest.mark.parametrize("rate", [500.0, 1000.0])
def test_motion_is_real_up_to_where_noise_of_positions_is_as_dense(rate):
    """Beside white noise of 1e-5 rad, motion of a thousand times its density reaches to 12 Hz on the second joint; that
    of the other ones, sums of slow sines, does not. Half an octave is what a low-pass's slope and spectra blur."""
    t, m = moved(60.0, rate)
    noise = 1e-5
    shaken = np.random.default_rng(0).normal(size=len(t)) * noise * np.sqrt(1000)
    swing = sosfiltfilt(butter(8, 12.0, fs=rate, output="sos"), shaken)
    m = replace(m, q=m.q + np.eye(m.q.shape[1])[1] * swing[:, None])
    real = recording_of(log_of(raw(t, m, torque=5.0, position=noise)), cutoffs=(30.0,)).real
    assert 12.0 / 1.2 < real[1] < 12.0 * 1.2
    assert max(real[0], real[2]) < 6.0


def test_noise_that_is_there_in_motion_alone_is_not_real():
    """An encoder has thirty times its noise, 900 times as dense, in the last two thirds of a log."""
    t, m = moved(60.0)
    draw = np.random.default_rng(0)
    noise = np.where(t[:, None] < 20.0, 1e-6, 3e-5) * draw.normal(size=m.q.shape)
    real = recording_of(log_of(raw(t, replace(m, q=m.q + noise), torque=5.0)), cutoffs=(30.0,)).real
    assert real.max() < 6.0


def test_nothing_is_known_to_be_real_of_short_pieces():
    """Half a second holds no spectrum of two seconds: 0, so that nothing is taken for motion that may be noise."""
    windows = {"train": [("run", 0.5 * k, 0.5 * k + 0.45) for k in range(20)]}
    assert not recording_of(log_of(raw(*moved(), position=1e-6)), windows, cutoffs=(30.0,)).real.any()
