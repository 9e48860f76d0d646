"""The band in which each joint is heard."""

import numpy as np
import pytest
import scipy.integrate
import scipy.signal

from invdyn_cli.diagnosis import band
from invdyn_cli.diagnosis.standard_columns import columns_of
from invdyn_cli.recording.pieces import Preparation
from invdyn_cli.types import Motion
from tests.diagnosis.analytic import evidence_of, log_of, moved, on, raw


def heard(*terms, motion=None):
    """The cut-offs before, and those in which a log of 30 s with these terms and white noise is heard."""
    evidence = evidence_of(
        log_of(raw(*(motion or moved(30.0)), *terms, torque=0.02, position=1e-7)), ("coulomb_friction",)
    )
    columns, target = columns_of(evidence, "unknown"), evidence.residual((), np.zeros(0))
    return evidence.recording.filter.cutoffs, band.heard(columns, target, Preparation().cutoffs)


def rumble(low, high, size):
    """Noise of this RMS between two frequencies [Hz], as a term of the first joint."""

    def term(t, q, qd, qdd):
        sections = scipy.signal.butter(4, (low, high), "bandpass", fs=1 / np.median(np.diff(t)), output="sos")
        x = scipy.signal.sosfilt(sections, np.random.default_rng(3).normal(size=len(t)))
        return size * x / np.std(x)

    return on(0, term)


def test_white_noise_leaves_the_band_as_it_is():
    """Of noise that is as dense everywhere nothing is cut off."""
    before, now = heard()
    assert now == before


@pytest.mark.parametrize(("low", "high"), [(9.0, 14.0), (13.0, 20.0)])
def test_what_rumbles_above_the_motion_is_cut_off(low, high):
    """Noise of a resonance, ten times the rest: its joint is heard up to where it begins, the others as before."""
    before, now = heard(rumble(low, high, 0.2))
    assert before[0] > high and 0.4 * low < now[0] <= low
    assert now[1:] == before[1:]


def test_noise_at_the_speed_of_the_motion_cuts_nothing_off():
    """What is missing in the model is slow: a narrower band would hold more of it."""
    before, now = heard(rumble(0.3, 2.0, 0.2))
    assert now == before


@pytest.mark.parametrize("seed", range(3))
def test_a_ripple_above_the_motion_is_heard(seed):
    """A line over the angle of a joint that sweeps at one speed is as dense as a resonance, but predictable: the whole
    band is heard."""
    draw = np.random.default_rng([31, seed])
    size, cycles, speed = draw.uniform(0.2, 0.5), draw.uniform(20.0, 50.0), draw.uniform(0.8, 1.2)
    t, m = moved(30.0)
    qd = m.qd.copy()
    qd[:, 0] = speed * np.tanh(6 * np.sin(2 * np.pi * t / 6))
    sweep = Motion(scipy.integrate.cumulative_simpson(qd, x=t, axis=0, initial=0), qd, np.gradient(qd, t, axis=0))
    before, now = heard(on(0, lambda t, q, qd, qdd: size * np.sin(cycles * q)), motion=(t, sweep))
    assert now == before
