"""Time between torque and motion that belongs to no joint is found, and taken out."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.cases import inverse_dynamics
from invdyn_cli.diagnosis.columns import hold
from invdyn_cli.diagnosis.columns.evidence import filtered
from invdyn_cli.effects.rigid import rigid_torque
from invdyn_cli.log import RawTrajectory
from invdyn_cli.types import Motion
from tests.diagnosis.analytic import arm, log_of, moved, recording_of

PERIOD = 0.005


def led(lead, friction: float = 0.0):
    """A log at 200 Hz whose torques are those of `lead` [s] later (for all joints or each), with Coulomb friction."""
    t, m = moved(rate=1 / PERIOD)
    tau = np.empty_like(m.q)
    for j, one in enumerate(np.broadcast_to(lead, arm().dofs)):
        _, ahead = moved(rate=1 / PERIOD, late=one)
        tau[:, j] = inverse_dynamics(arm(), ahead.q, ahead.qd, ahead.qdd)[:, j] + friction * np.sign(ahead.qd[:, j])
    tau = tau + 0.01 * np.random.default_rng(0).normal(size=tau.shape)
    return recording_of(log_of(RawTrajectory("run", t, m.q, tau)), cutoffs=(10.0,))


@pytest.mark.parametrize("lead", [0.0, 0.5, 1.0, -0.7])
@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_a_common_time_is_found_and_taken_out(lead, friction):
    """Half a sample of hold, or up to one of reading in turn, comes out within 3 % of a sample, friction or not, and
    the torques then stand over their motion."""
    recording = led(lead * PERIOD, friction)
    after, common = hold.remove_common_delay(arm(), recording, "command")
    assert common == pytest.approx(lead * PERIOD, abs=0.03 * PERIOD)
    if friction:
        return
    nominal = filtered(after, [rigid_torque(arm(), Motion(p.q, p.qd, p.qdd)) for p in after.pieces])
    left = filtered(after, [p.tau for p in after.pieces]) - nominal
    before = filtered(recording, [p.tau for p in recording.pieces]) - nominal
    noise = 0.01 * np.sqrt(2 * 10 * PERIOD)  # of white noise behind a low-pass at 10 Hz
    assert np.sqrt(np.mean(left**2)) < 1.1 * noise
    assert lead == 0 or np.sqrt(np.mean(before**2)) > 2 * noise


def test_one_joint_s_delay_stays_its_own():
    """A joint that lags 15 ms behind the others does not move the common time by more than 5 % of a sample."""
    _, common = hold.remove_common_delay(arm(), led([0.5 * PERIOD, 0.5 * PERIOD - 0.015, 0.5 * PERIOD]), "command")
    assert common == pytest.approx(0.5 * PERIOD, abs=0.05 * PERIOD)


@pytest.mark.parametrize(("side", "taken"), [("link", 0.0), ("command", 0.5)])
def test_delays_of_all_joints_are_no_hold(side, taken):
    """Where all joints lag by 20 ms, that is not the log's own: half a sample is taken, none behind the gear."""
    _, common = hold.remove_common_delay(arm(), led(-0.02), side)
    assert common == pytest.approx(taken * PERIOD)


@pytest.mark.parametrize("share", [0.2, 0.33, 0.5, 0.7])
def test_a_load_that_comes_is_no_hold(share):
    """A load of 3 kg that comes after this share of the time moves the joints' leads by up to 13 samples: none of them
    is known, and half a sample is taken."""
    heavy = np.array(arm().inertial)
    heavy[-1] += 3.0 * np.array([1, 0.1, 0.1, 0.1, 0.02, 0, 0.02, 0, 0, 0.02])
    t, m = moved(rate=1 / PERIOD)
    tau, laden = (inverse_dynamics(x, m.q, m.qd, m.qdd) for x in (arm(), replace(arm(), inertial=heavy)))
    tau = np.where((t > share * t[-1])[:, None], laden, tau) + 0.01 * np.random.default_rng(0).normal(size=tau.shape)
    recording = recording_of(log_of(RawTrajectory("run", t, m.q, tau)), cutoffs=(10.0,))
    _, common = hold.remove_common_delay(arm(), recording, "command")
    assert common == pytest.approx(0.5 * PERIOD)


def test_leads_come_with_their_errors():
    """Each joint's lead lies within four standard errors of the truth, and those are below a tenth of a sample."""
    lead, error = hold.offsets(arm(), led(0.5 * PERIOD))
    assert np.all(np.abs(lead - 0.5 * PERIOD) < 4 * error + 0.01 * PERIOD)
    assert np.all(error < 0.1 * PERIOD)


@pytest.mark.parametrize(("side", "taken"), [("link", 0.0), ("command", 0.5)])
def test_an_arm_at_rest_tells_no_time(side, taken):
    """Half a sample is taken then, too."""
    t, m = moved(rate=1 / PERIOD)
    recording = recording_of(log_of(RawTrajectory("run", t, np.ones_like(m.q), m.q)), cutoffs=(10.0,))
    _, common = hold.remove_common_delay(arm(), recording, side)
    assert common == pytest.approx(taken * PERIOD)
