"""What is noise, and what stands out of it."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.cases import draw_case
from invdyn_cli.diagnosis.case import Case, Options, prepared
from invdyn_cli.diagnosis.columns.candidates import kind_of
from invdyn_cli.diagnosis.search import noise
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.transmission import TorqueRipple
from tests.commands import usually
from tests.diagnosis.analytic import arm, evidence_of, gather, log_of, moved, nothing, on, raw, recording_of

NAMES = [n for n in EFFECTS if n != "torque_ripple"]
SIGMA = 0.1


def measured(term=nothing, torque=SIGMA):
    evidence = evidence_of(log_of(raw(*moved(), term, torque=torque)), NAMES, cutoffs=(10.0,))
    rows = evidence.role == 0
    return evidence, rows, noise.measure(evidence, rows)


@pytest.fixture(scope="module")
def quiet():
    """Noise alone."""
    return measured()


def test_the_deviation_is_that_of_the_noise(quiet):
    """What is measured is what white noise leaves behind the filter, within 10 % (some 300 independent rows)."""
    evidence, rows, found = quiet
    clean = evidence_of(log_of(raw(*moved())), ["viscous_friction"], cutoffs=(10.0,))
    alone = (evidence.tau - clean.tau)[rows]
    np.testing.assert_allclose(found.deviation, alone.std(axis=0), rtol=0.1)


def test_a_weak_joint_is_heard_beside_a_strong_one(quiet):
    """Where the second joint has 100 times its torque, as the shoulder of an industrial arm beside a wrist, the noise
    of the weakest is what it was: a wrist's delay of 29 ms had been hidden by a share of the shoulder's torque."""
    evidence, rows, found = quiet
    strong = replace(evidence, tau=evidence.tau * np.array([1.0, 100.0, 1.0]))
    np.testing.assert_allclose(noise.measure(strong, rows).deviation[0], found.deviation[0], rtol=0.05)


def test_effects_are_no_noise(quiet):
    """Friction, an offset and another load change the measured noise by less than 15 %."""
    term = on(1, lambda t, q, qd, qdd: 2.0 * np.sign(qd) + qd + 0.3 + 0.2 * qdd)
    np.testing.assert_allclose(measured(term)[2].deviation, quiet[2].deviation, rtol=0.15)


def test_a_limit_that_lets_nothing_through_does_not_tell_the_noise():
    """Trials of a limit are drawn from the nominal load too; where that is a thousandth of the logged torque, as on the
    last joint of a real arm, such a trial leaves neither noise nor cause, and the noise is what it is without it."""
    evidence, rows, found = measured(on(1, lambda t, q, qd, qdd: 2.0 * np.sign(qd)))
    saturation = EFFECTS["torque_saturation"]
    lowest = 1e-3 * np.abs(evidence.tau[:, 1]).max()
    evidence.candidates.append(kind_of(saturation).candidate(evidence, saturation, 1, {"limit": lowest}))
    np.testing.assert_allclose(noise.measure(evidence, rows).deviation, found.deviation)


def test_the_noise_is_what_a_right_model_leaves(quiet):
    """A drive that gives less for half of the log is in no plain column, and was noise; of a residual that has white
    noise alone the noise is what was put in, but for 10 %. A joint on which no less is left keeps its noise, and where
    that is all of them nothing is quieter."""
    evidence, rows, found = quiet
    weaker = on(1, lambda t, q, qd, qdd: np.where(t > t.mean(), 3.0 * np.sin(3 * q), 0.0))
    heard = measured(weaker)[2]
    assert heard.deviation[1] > 2 * found.deviation[1]
    quieter = noise.quieter(evidence, found.residual, rows, heard)
    assert quieter is not None and quieter.deviation[0] == heard.deviation[0]
    np.testing.assert_allclose(quieter.deviation[1], np.std(found.residual[rows, 1]), rtol=0.1)
    assert noise.quieter(evidence, found.residual, rows, found) is None


def test_weights_count_correlation(quiet):
    """A row weighs 1 / (variance x autocorrelation time); a joint without torque and motion weighs nothing."""
    found = quiet[2]
    np.testing.assert_allclose(found.weights, 1 / (found.deviation**2 * found.time))
    assert np.all(found.time >= 1)
    silent = noise.Noise(np.array([0.0, 1.0]), np.ones(2), np.zeros((1, 2)))
    assert silent.weights.tolist() == [0.0, 1.0]


@pytest.mark.parametrize("cycles", usually([23.0], [7.0, 23.0]))
def test_a_ripple_is_found_by_its_cycles(cycles):
    """A ripple as large as the noise becomes a candidate, its cycles right to a fifth of what the range can resolve."""
    evidence, rows, found = measured(on(1, lambda t, q, qd, qdd: SIGMA * np.sin(cycles * q + 1.0)))
    lines = noise.ripples(evidence, found, [found.residual], rows, TorqueRipple())
    trials = [c.shape["cycles"] for c in lines if c.joint == 1]
    q = np.concatenate([s[1].q for s in evidence.states])
    assert trials and abs(trials[0] - cycles) < 0.2 * 2 * np.pi / np.ptp(q)


@pytest.mark.benchmark  # a whole log; a ripple by its cycles is above
@pytest.mark.parametrize("seed", [521002, 1, 2])
def test_a_ripple_that_a_model_of_all_columns_takes_up(seed):
    """Of 22 s of pick and place, some turns of the ripple long, columns of other effects take it up; what standard
    terms leave has its line, at its cycles to a fifth of what the range can resolve."""
    case = draw_case(seed, ["torque_ripple"])
    (hidden,) = case.hidden
    prepared_case = prepared(case.log, case.robot, None, None, Options(), EFFECTS)
    assert isinstance(prepared_case, Case)
    evidence = prepared_case.evidence
    rows, joint = evidence.role == 0, case.robot.joints.index(str(hidden.joint))
    found = noise.measure(evidence, rows)
    residuals = [found.residual, noise.left_by_terms(evidence, rows)]
    lines = noise.ripples(evidence, found, residuals, rows, TorqueRipple())
    trials = np.array([c.shape["cycles"] for c in lines if c.joint == joint])
    q = np.concatenate([s[joint].q for s in evidence.states])
    assert np.min(np.abs(trials - hidden.parameters["cycles"])) < 0.2 * 2 * np.pi / np.ptp(q)


def test_noise_has_no_ripples(quiet):
    """In noise alone no line stands out."""
    evidence, rows, found = quiet
    assert noise.ripples(evidence, found, [found.residual], rows, TorqueRipple()) == []


@pytest.mark.parametrize("seed", usually([0], range(3)))
def test_noise_is_none_of_what_many_columns_take_up(seed):
    """25 s behind a low-pass of 2 Hz are some seventy independent samples, though rows are kept for joints of 30 Hz,
    and the columns of all effects are nearly as many: white noise is measured within a factor of 1.6."""

    def made(torque: float):
        recording = recording_of(log_of(raw(*moved(25.0, 250.0, seed), torque=torque, seed=seed)), cutoffs=(30.0,))
        recording = replace(recording, filter=replace(recording.filter, cutoffs=(2.0, 30.0, 30.0)))
        return gather(arm(), recording, [EFFECTS[name] for name in NAMES], "unknown")

    clean, loud = made(0.0), made(0.5)
    truth = np.std(loud.tau - clean.tau, axis=0)
    found = noise.measure(loud, loud.role == 0).deviation
    assert np.all(np.abs(np.log(found / truth)) < np.log(1.6)), found / truth
