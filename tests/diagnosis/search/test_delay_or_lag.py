"""Delay or lag."""

from dataclasses import replace

import numpy as np
import pytest

from invdyn_cli.diagnosis.case import Case, Options, prepared
from invdyn_cli.diagnosis.columns.candidates import trial_at
from invdyn_cli.diagnosis.decide import claim, refusals
from invdyn_cli.diagnosis.search import naming
from invdyn_cli.diagnosis.search.delay_or_lag import distinguish
from invdyn_cli.diagnosis.search.exact import refine
from invdyn_cli.diagnosis.search.inquiry import Question
from invdyn_cli.diagnosis.search.whole import inquire
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.simulation import plant
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.simulation.references import Multisine
from invdyn_cli.simulation.sensors import Noise
from tests.diagnosis.analytic import arm

LATE = {name: EFFECTS[name] for name in ("torque_delay", "actuator_lag")}


def searched(effect, **parameters):
    """What a search for delays and lags finds in the log of an arm with this effect on its second joint."""
    hidden = [Hidden(effect, arm().joints[1], parameters)]
    noise = Noise(position=1e-6, torque=(0.02,) * arm().dofs)
    log = plant.record(arm(), [Multisine()], hidden, duration=30.0, rate=500.0, seed=3, noise=noise)
    case = prepared(log, arm(), None, None, Options(), LATE)
    assert isinstance(case, Case)
    return inquire(case.evidence, Question(LATE, 3))


@pytest.fixture(scope="module")
def lagging():
    """What a search finds in the log of a drive with a lag of 15 ms."""
    return searched("actuator_lag", time_constant=0.015)


def test_a_log_that_is_late_is_a_negative_delay():
    """A torque that was logged 4 to 20 ms late: a delay of that size, within a tenth of it, and no lag in its place."""
    late = float(np.random.default_rng(5).uniform(0.004, 0.02))
    inquiry = searched("torque_delay", delay=-late)
    (found,) = inquiry.whole.acting
    assert found.key == ("torque_delay", 1)
    assert found.parameters["delay"] == pytest.approx(-late, rel=0.1)
    every = np.ones_like(inquiry.judge.rows)
    whole, after = (
        claim.exactly(inquiry, inquiry.hypothesis, inquiry.whole, every),
        claim.left(inquiry, inquiry.hypothesis),
    )
    told = claim.Claim(inquiry, inquiry.hypothesis, 0, whole, inquiry.chosen, after)
    assert 0 < told.delay <= late  # the least that it may be, of either sign
    assert refusals.refusal(told) is None


def test_a_log_that_was_filtered_is_a_negative_lag():
    """A torque behind a first-order filter of 8 to 20 ms before it was logged: a lag of that size, within a tenth of
    it, and no delay in its place."""
    constant = float(np.random.default_rng(6).uniform(0.008, 0.02))
    inquiry = searched("actuator_lag", time_constant=-constant)
    (found,) = inquiry.whole.acting
    assert found.key == ("actuator_lag", 1)
    assert found.parameters["time_constant"] == pytest.approx(-constant, rel=0.1)


@pytest.mark.parametrize(
    ("barred", "found"), [(set(), "actuator_lag"), ({("actuator_lag", 1)}, "torque_delay")], ids=["free", "barred"]
)
def test_what_was_barred_is_not_chosen_again(lagging, barred, found):
    """A lag that was tried as a delay is told as a lag, unless a lag was taken out of the search: the search chose the
    delay again, and was put back to the lag for ever."""
    (lag,) = lagging.whole.acting
    assert lag.key == ("actuator_lag", 1)
    delay = replace(lag, effect=EFFECTS["torque_delay"], parameters={"delay": lag.parameters["time_constant"]})
    rows, weights = lagging.judge.rows, lagging.noise.weights
    chosen = refine(lagging.evidence, lagging.model, [delay], rows, weights, lagging.always)
    hypothesis = (trial_at(lagging.evidence, delay),)
    lagging.judge.refresh()
    told, _, _ = distinguish(lagging.judge, lagging.model, LATE, lagging.always, hypothesis, chosen, barred)
    assert [c.key for c in told] == [(found, 1)]


@pytest.mark.parametrize(("least", "close"), [(0.0, False), (np.inf, True)])
def test_agreement_of_all_blocks_does_not_decide_alone(lagging, monkeypatch, least, close):
    """The lag of 15 ms explains every block of time better than a delay. Where the difference is below the limit, the
    delay is an alternative nevertheless: an error of the model that repeats with the motion would look alike."""
    monkeypatch.setattr(naming, "MIN_CLEAR_DIFFERENCE", least)
    lagging.judge.refresh()
    of_lag = lagging.judge, lagging.model, LATE, lagging.always, lagging.hypothesis, lagging.chosen
    assert distinguish(*of_lag)[2] == {("actuator_lag", 1): close}
