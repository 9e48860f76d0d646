"""The noise floor of motions that were driven twice."""

from dataclasses import replace

import numpy as np
import pytest

from invdyn_cli.diagnosis.repeats import floor_of_repeats, note_of, seen_before
from invdyn_cli.types import Motion
from tests.diagnosis.analytic import arm, log_of, moved, on, raw, recording_of
from tests.diagnosis.sick import motion

SIGMA = 0.2
WHOLE = {"train": [(name, -np.inf, np.inf) for name in ("run", "again", "other")]}


def named(name, *args, **options):
    return replace(raw(*args, **options), name=name)


@pytest.mark.parametrize("late", [0.0, 0.12])
def test_it_is_the_noise_whatever_the_model_lacks(late):
    """Two recordings, one started later: RMS of half the difference is the filtered noise over the root of two, within
    10 % (about 1,000 independent rows), and unknown torques that both have do not count."""
    term = on(1, lambda t, q, qd, qdd: 5 * np.sin(7 * q))
    t, m = moved()
    log = log_of(
        named("run", t, m, term, torque=SIGMA, seed=1),
        named("again", *moved(late=late), term, torque=SIGMA, seed=2),
    )
    recording = recording_of(log, WHOLE, cutoffs=(10.0,))
    white = SIGMA * np.sqrt(2 * 10.0 / 500.0) * 0.96  # the noise bandwidth of the low-pass, forth and back: 0.96^2
    np.testing.assert_allclose(floor_of_repeats(recording), white / np.sqrt(2), rtol=0.1)


def test_other_motions_are_no_repeats():
    """Without two recordings of one motion there is no floor; halves of one recording are none either."""
    both = log_of(named("run", *moved(), torque=SIGMA), named("other", *moved(seed=5), torque=SIGMA))
    assert floor_of_repeats(recording_of(both, WHOLE)) is None
    assert floor_of_repeats(recording_of(log_of(raw(*moved(), torque=SIGMA)))) is None


def test_what_has_changed_since_a_reference_is_no_noise():
    """The same motion before and after a friction came: no floor is taken from their difference."""
    now = named("run", *moved(), on(1, lambda t, q, qd, qdd: 2 * np.sign(qd)), torque=SIGMA)
    before = named("again", *moved(), torque=SIGMA, seed=2)
    windows = {"train": [("run", -np.inf, np.inf)], "reference": [("again", -np.inf, np.inf)]}
    assert floor_of_repeats(recording_of(log_of(now, before), windows, cutoffs=(10.0,))) is None


def test_a_held_out_motion_that_repeats_the_training_motion_is_told():
    """40 s, the last 12 held out. Driven to and fro every 8 s, all held-out states are known from the training (95 % or
    more: the filters' ends differ); of sines without a common period 5 % or less are, and nothing is said."""
    t, other = moved()
    phase = 4 * (1 - np.cos(2 * np.pi * t / 8))
    q = motion(arm(), phase, 0).q
    again = Motion(q, np.gradient(q, t, axis=0), np.gradient(np.gradient(q, t, axis=0), t, axis=0))
    same, apart = (recording_of(log_of(raw(t, m, torque=SIGMA, position=1e-5))) for m in (again, other))
    assert seen_before(same) >= 0.95
    assert "repeats the training motion" in note_of(same)[0]
    assert seen_before(apart) <= 0.05
    assert note_of(apart) == ()
