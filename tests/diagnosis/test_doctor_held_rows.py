"""Rows that were stamped when they were written, later than they were sampled, some or many at once."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.interpolate

from invdyn_cli.diagnosis import doctor
from invdyn_cli.diagnosis.checks.held_rows import HeldRows, held
from invdyn_cli.log import RawTrajectory
from invdyn_cli.recording.rows import taken
from tests.diagnosis.sick import alarms, changed, seen, sound

RATE = 250.0


@pytest.fixture(scope="module")
def arm(apollo4):
    return apollo4


@pytest.fixture(scope="module")
def log(arm):
    return sound(arm, 3, rate=RATE)


def blocked(t: np.ndarray, draw: np.random.Generator, least: float, jitter: float) -> np.ndarray:
    """Stamps of samples at t (T,) [s] by a program that stands still some 30 times for 0.04 to 0.14 s, and otherwise
    is late by up to `jitter` [s]; it needs `least` [s] for a row."""
    late = t + draw.uniform(0, jitter, len(t))
    for start in draw.uniform(1.0, t[-1] - 1.0, 30):
        end = start + draw.uniform(0.04, 0.14)
        inside = (late >= start) & (late < end)
        late[inside] = end
    return np.maximum.accumulate(late) + least * np.arange(len(t))


@pytest.mark.parametrize(("least", "jitter", "lost"), [(0.0, 0.0, 0.0), (2e-5, 2e-4, 0.0), (2e-5, 6e-4, 0.01)])
def test_what_was_held_back_has_no_gaps(log, arm, least, jitter, lost):
    """Rows that a blocked program wrote together, some lost: gaps are told as none, and every row's time is right to a
    quarter of a step, up to a common delay: positions tell where among them rows were lost."""
    raw, draw = log.trajectories[0], np.random.default_rng(7)
    keep = draw.random(len(raw.t)) >= lost
    stamps = blocked(raw.t, draw, 0.0, jitter)[keep]
    late = stamps + least * np.arange(len(stamps))
    kept = taken(raw, keep)
    corrected, examination = doctor.correct(replace(log, trajectories=(replace(kept, t=late),)), arm)
    assert set(alarms(examination)) <= {"clock_jitter"} and examination.usable
    assert abs(seen(examination, "clock_jitter")[0].value) < 0.05
    (run,) = corrected.trajectories
    assert len(run.t) == len(kept.t)
    off = (run.t - kept.t - least * np.arange(len(kept.t))) * RATE
    off -= np.median(off)
    assert np.abs(off).max() < 0.25


def test_a_log_that_is_written_in_blocks(log, arm):
    """Ten rows at a time, all with the stamp of the last one."""
    raw = log.trajectories[0]
    t = raw.t[np.minimum(np.arange(len(raw.t)) // 10 * 10 + 9, len(raw.t) - 1)]
    corrected, _ = doctor.correct(changed(log, t=t), arm)
    (run,) = corrected.trajectories
    inside = slice(10, len(raw.t) // 10 * 10)
    np.testing.assert_allclose(np.ptp((run.t - raw.t[-len(run.t) :])[inside]), 0, atol=0.25 / RATE)


def sampled_at(raw: RawTrajectory, t: np.ndarray) -> RawTrajectory:
    """The motion and torque at other times t (T,) [s]."""
    q, tau, qd = (scipy.interpolate.make_interp_spline(raw.t, x)(t) for x in (raw.q, raw.tau, raw.qd))
    return replace(raw, t=t, q=q, tau=tau, qd=qd)


def test_samples_that_were_taken_at_such_times_are_believed(log, arm):
    """A logger that samples faster after each break: positions follow the stamps, which stay."""
    raw = log.trajectories[0]
    t = blocked(raw.t, np.random.default_rng(8), 2e-5, 0.0)
    t = t[t <= raw.t[-1]]
    assert list(held(t))
    corrected, examination = doctor.correct(replace(log, trajectories=(sampled_at(raw, t),)), arm, checks=[HeldRows()])
    np.testing.assert_array_equal(corrected.trajectories[0].t, t)
    assert not seen(examination, "clock_jitter")


def test_a_gap_stays_a_gap(log, arm):
    """Rows that are missing for 0.2 s and do not come later."""
    raw = log.trajectories[0]
    keep = (raw.t < 10.0) | (raw.t > 10.2)
    corrected, examination = doctor.correct(replace(log, trajectories=(taken(raw, keep),)), arm)
    assert len(seen(examination, "gaps")) == 1 and not seen(examination, "clock_jitter")
    np.testing.assert_array_equal(corrected.trajectories[0].t, raw.t[keep])


def test_where_many_rows_were_lost_nobody_looks(log, arm):
    """A program that stands still for 3 s and keeps the last 2.5 s of rows: the lost ones are the first, and the others
    keep their places."""
    raw = log.trajectories[0]
    kept = taken(raw, (raw.t <= 10.0) | (raw.t > 10.5))
    late = np.where((kept.t > 10.0) & (kept.t < 13.0), 13.0, kept.t)
    corrected, _ = doctor.correct(replace(log, trajectories=(replace(kept, t=late),)), arm, checks=[HeldRows()])
    np.testing.assert_allclose(corrected.trajectories[0].t, kept.t, atol=0.5 / RATE)
