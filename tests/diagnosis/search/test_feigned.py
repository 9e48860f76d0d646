"""What only the noise of encoders asks for on a worn arm is no part of the search."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from invdyn_cli.diagnosis.columns.evidence import slow_share, slow_squares
from invdyn_cli.diagnosis.search import noise
from invdyn_cli.diagnosis.search.feigned import EVIDENCE, feigned
from invdyn_cli.diagnosis.search.judge import HypothesisScorer
from tests.diagnosis.analytic import evidence_of, log_of, moved, on, raw

NAMES = ("coulomb_friction", "joint_spring", "joint_elasticity")


@pytest.mark.parametrize(("name", "share", "odd"), [("gear", 0.04, False), ("gear", 0.8, True), ("spring", 0.8, False)])
def test_what_is_saved_beyond_the_motion_is_feigned(name, share, odd):
    """The residual has a wave in the place of an elasticity's torque, or of a spring's. As far above the arm's motion
    the elasticity is feigned, though it saves more than is asked of evidence; where the arm moves it is not. A spring
    never is: it needs no acceleration."""
    friction = on(0, lambda t, q, qd, qdd: 2.0 * np.tanh(qd / 0.01) + 20.0 * q)
    log = log_of(raw(*moved(40.0), friction, torque=2.0, position=1e-5))
    evidence = evidence_of(log, NAMES)
    every = np.ones(len(evidence.tau), bool)
    measured = noise.measure(evidence_of(log, NAMES), every)
    spring, gear = (next(c for c in evidence.candidates if c.key == (name, 0)) for name in NAMES[1:])
    coulomb = next(c for c in evidence.candidates if c.key == ("coulomb_friction", 0))
    wave = np.sin(2 * np.pi * share * evidence.recording.filter.cutoffs[0] * evidence.on_rows("t"))
    one, other = (gear, spring) if name == "gear" else (spring, gear)
    for j, (fixed, free) in one.columns.items():
        evidence.tables[j][:, [*fixed, *free]] = 0.0
        if j == 0:
            first = [*fixed, *free][0]
            evidence.tables[j][:, first] = 2 * measured.deviation[0] * wave
            evidence.tables[j][:, 0] += evidence.tables[j][:, first]
    scorer = HypothesisScorer(evidence, every, measured.weights, measured.deviation, (coulomb,), True)
    scorer.refresh()
    assert scorer.loss((coulomb, other)) - scorer.loss((coulomb, other, one)) > EVIDENCE
    assert (one.key in feigned(scorer, (coulomb,), (other, one))) == odd


@pytest.mark.parametrize("shakes", [False, True])
def test_what_is_saved_where_a_resonance_swings_is_not_feigned(shakes):
    """Of a gear, a wave at 10 Hz of a band of 30 counts where the joint itself moves far beyond its encoder's noise up
    to 15 Hz, as a resonance makes it, and not where it does not; of other effects it never does."""
    t, m = moved(40.0)
    sections = butter(8, 15.0, fs=500.0, output="sos")
    swing = sosfiltfilt(sections, np.random.default_rng(1).normal(size=len(t))) * 1e-3 * shakes
    log = log_of(raw(t, replace(m, q=m.q + swing[:, None]), torque=0.02, position=1e-5))
    evidence = evidence_of(log, NAMES, cutoffs=(30.0,))
    wave = np.sin(2 * np.pi * 10.0 * evidence.on_rows("t"))
    gear, other = (slow_share(slow_squares(evidence, wave, 0, x)) for x in (True, False))
    assert other < 0.1 and (gear > 0.9 if shakes else gear < 0.1)


def test_short_pieces_do_not_tell():
    """On pieces that are shorter than the slow filter's memory nothing is known of a share, and all is counted; a piece
    that is long enough tells for all."""
    evidence = evidence_of(log_of(raw(*moved(40.0), torque=0.02, position=1e-5)), NAMES)
    t, cutoff = evidence.on_rows("t"), evidence.recording.filter.cutoffs[0]
    saved = np.sin(2 * np.pi * 0.8 * cutoff * t)
    numbers = np.arange(len(t)) // 4
    half = np.where(t < 20.0, numbers, numbers.max() + 1)
    assert slow_share(slow_squares(replace(evidence, piece=numbers), saved, 0)) == 1.0
    for pieces in (evidence.piece, half):
        assert slow_share(slow_squares(replace(evidence, piece=pieces), saved, 0)) < 0.1
