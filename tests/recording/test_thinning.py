"""A long log is thinned so that every joint still moves."""

from dataclasses import replace

import numpy as np
import pytest

from invdyn_cli.recording.thinning import thinned, windows
from tests.diagnosis.analytic import log_of, moved, raw

LENGTH, JOINTS = 20.0, 3


def turns(seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """t (T,), q (T, n) of 360 s, in which three joints move one after the other for some seconds each, again and
    again."""
    t, motion = moved(seconds=360.0, rate=50.0)
    mine = (t[:, None] // seconds) % JOINTS == np.arange(motion.q.shape[1]) % JOINTS
    return t, np.where(mine, motion.q, 0.0)


def covered(q: np.ndarray, parts: list[np.ndarray]) -> np.ndarray:
    """(n,) share of the distance of every joint in parts of a motion q (T, n)."""
    return sum(np.abs(np.diff(x, axis=0)).sum(axis=0) for x in parts) / np.abs(np.diff(q, axis=0)).sum(axis=0)


def test_stretches_show_joints_that_take_turns():
    """A third of the log in stretches of 20 s would begin every 60 s and show one joint of the three."""
    t, q = turns(20.0)
    length, made = thinned([("run", "train", t, q.T, q.T)], t[-1] / JOINTS, 0.7, LENGTH)
    assert np.all(covered(q, [part.T for _, _, _, part, _ in made]) > 0.4 / JOINTS)
    assert length < LENGTH and sum(np.ptp(part) for _, _, part, *_ in made) == pytest.approx(t[-1] / JOINTS, rel=0.02)


def test_windows_of_the_checks_show_joints_that_take_turns():
    """A third of the log in windows of 20 s, the last at its end, would begin every 68 s, and show one joint."""
    t, q = turns(68 / JOINTS)
    one = replace(raw(*moved(seconds=360.0, rate=50.0)), q=q)
    parts = [rows for _, rows in windows(log_of(one).trajectories, len(t) // JOINTS)]
    assert np.all(covered(q, [q[rows] for rows in parts]) > 0.4 / JOINTS)
    assert len(np.concatenate(parts)) == pytest.approx(len(t) / JOINTS, rel=0.02)
    assert np.all(np.concatenate([np.diff(rows) for rows in parts]) == 1)


def test_a_motion_of_all_joints_is_looked_at_in_long_stretches():
    """Stretches stay as long as asked where all joints move all the time."""
    t, motion = moved(seconds=360.0, rate=50.0)
    length, made = thinned([("run", "train", t, motion.q.T, motion.q.T)], 120.0, 0.7, LENGTH)
    assert length == LENGTH and all(np.ptp(part) == pytest.approx(LENGTH, abs=0.5) for _, _, part, *_ in made)
