"""What is wrong with a log as a whole: several recordings in one, channels that are empty."""

import numpy as np

from invdyn_cli.diagnosis import doctor
from tests.diagnosis.sick import changed, seen, sound


def test_a_clock_that_restarts(apollo4):
    """Three recordings in one are read apart, and every row of them is kept; no row is told as defective."""
    log = sound(apollo4)
    t = log.trajectories[0].t
    bad = changed(log, t=np.where(t < 9, t, np.where(t < 20, t - 9, t - 20)))
    corrected, examination = doctor.correct(bad, apollo4)
    (found,) = seen(examination, "duplicates")
    assert (found.severity, found.value) == ("fail", 2) and "restarts 2 times, first in row 1800" in found.seen
    assert doctor.done(examination)[0] == "run: read as 3 recordings, parted where the clock restarts"
    assert [len(x.t) for x in corrected.trajectories] == [1800, 2200, 2000] and examination.usable


def test_no_torques(apollo4):
    """A log without any torque is told so, not to leave rows out."""
    log = sound(apollo4)
    none = changed(log, tau=np.full_like(log.trajectories[0].tau, np.nan))
    (found,) = seen(doctor.examine(none, apollo4), "not_finite")
    assert found.seen == "there are no torques" and "data.columns" in found.advice
