"""The arm tick by tick is the arm of `simulate`: same physics, same sensors, whoever closes the loop."""

from dataclasses import replace

import numpy as np
import pytest

from invdyn_cli.data.pick_place import PickPlace
from invdyn_cli.robots import load_urdf
from invdyn_cli.simulation.closed_loop import ClosedLoop
from invdyn_cli.simulation.control import Control
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.simulation.plant import simulate
from invdyn_cli.simulation.references import Multisine
from invdyn_cli.simulation.sensors import Noise

DURATION, SEED, EXACT, COARSE = 1.5, 4, Noise(), Noise(position=1e-4, position_quantum=1e-4)


@pytest.fixture(scope="module")
def arm():
    return load_urdf("apollo_arm", dofs=3)


def carried(arm) -> list[Hidden]:
    """A load that comes within the second, on an arm with friction, springs and ripple."""
    load = {"mass": 0.8, "com": [0.0, 0.0, 0.1], "window": [0.4, 1.1], "ramp": 0.1}
    return [*PickPlace().hidden(arm), Hidden("payload_change", None, load)]


def late(arm) -> list[Hidden]:
    """Torques that come late and small, read at encoders that are off."""
    delay, lag = Hidden("torque_delay", arm.joints[1], {"delay": 0.01}), {"time_constant": 0.02}
    gain, encoder = {"gain": 0.8}, Hidden("encoder_offset", arm.joints[2], {"offset": 0.1})
    every = [Hidden("actuator_lag", arm.joints[0], lag), Hidden("torque_gain_error", arm.joints[2], gain)]
    return [delay, encoder, *every]


@pytest.mark.parametrize("noise", [EXACT, COARSE], ids=["exact", "coarse"])
@pytest.mark.parametrize("effects", [carried, late])
def test_logged_torques_make_the_logged_motion(effects, noise, arm):
    """Under the torques that `simulate` logged, one after the other, the arm reads the very angles of its log."""
    hidden = effects(arm)
    how = {"noise": noise, "seed": SEED}
    log = simulate(arm, Multisine(ramp=0.5), hidden, duration=DURATION, control=Control(settle=0.0), **how)
    loop = ClosedLoop(arm, hidden, samples=len(log.t), **how)
    assert log.q_ref is not None
    loop.start(log.q_ref[0])
    for k, tau in enumerate(log.tau):
        np.testing.assert_allclose(loop.measure(), log.q[k], rtol=0, atol=1e-12)
        loop.apply(tau)


def test_it_is_held_until_the_task_begins(arm):
    """The simulation's controller holds the arm at its first posture, load or not; t is 0 when the ticks before are
    over."""
    wanted = Multisine().motion(arm, DURATION, 1000.0, SEED)
    loop = ClosedLoop(arm, carried(arm), samples=len(wanted), before=300)
    loop.hold(Control(), wanted, 300)
    assert loop.sample == 0
    assert np.abs(loop.measure() - wanted.q[0]).max() < 0.01


def test_who_is_lost_is_named(arm):
    """An arm too far off is told with the joint, the time and what is allowed; a number that is none is too far."""
    loop = ClosedLoop(arm, samples=10)
    assert loop.lost(np.array([0.1, -0.9, 0.0]), 1.0) == ""
    for error in ([0.1, -1.5, 0.0], [0.1, np.nan, 0.0]):
        said = loop.lost(np.array(error), 1.0)
        assert arm.joints[1] in said and "0.00 s" in said and said.endswith("allowed: 1 rad")


@pytest.mark.parametrize(("error", "said"), [(-2.0137, "2.01"), (2.0003, "2.0003"), (31.41, "31.4")])
def test_how_far_is_more_than_is_allowed(arm, error, said):
    """The number that is told has as many digits as it takes to differ from what is allowed, and its unit."""
    told = ClosedLoop(arm, samples=10).lost(np.array([0.0, error, 0.0]), 2.0)
    assert told.endswith(f"is {said} rad from its reference; allowed: 2 rad")
    slides = replace(arm, prismatic=(False, True, False))
    told = ClosedLoop(slides, samples=10).lost(np.array([0.0, error, 0.0]), 2.0)
    assert told.endswith(f"is {said} m from its reference; allowed: 2 m")


def test_a_late_log_is_late_tick_by_tick(arm):
    """A controller of one's own logs tick by tick what a simulation logs at once: of a joint whose log is 3.3 samples
    late, the torques that far before, between samples on a straight line."""
    hidden = [Hidden("torque_delay", arm.joints[1], {"delay": -0.0033})]
    hidden += [Hidden("actuator_lag", arm.joints[2], {"time_constant": -0.004})]
    once, ticks = (ClosedLoop(arm, hidden, samples=200, rate=1000.0) for _ in range(2))
    torques = np.random.default_rng(2).normal(size=(200, arm.dofs))
    logged = once.logged(torques)
    np.testing.assert_array_equal(logged, [ticks.logged(x) for x in torques])
    np.testing.assert_allclose(logged[:, 1], np.interp(np.arange(200) - 3.3, np.arange(200), torques[:, 1]), atol=1e-12)
    np.testing.assert_array_equal(logged[:, 0], torques[:, 0])
