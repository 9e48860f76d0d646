"""What comes and goes: contacts, loads and weak drives are what Pinocchio says, and in their window what would last."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from experiments.arms import random_robot
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.composition import EffectInstance, Span, TimeWindow, channel, link_torque, weight
from invdyn_cli.effects.rigid import rigid_torque
from invdyn_cli.robots import pinocchio_model
from invdyn_cli.types import Motion
from tests.effects.drawn import parameters

RATE = 100.0
T = np.arange(300) / RATE
WINDOW = TimeWindow("run", 0.5, 1.5)
HERE = Span("run", T, RATE)


@pytest.fixture(scope="module")
def robot():
    """An arm of four joints."""
    return random_robot(np.random.default_rng(5), 4)


@pytest.fixture(scope="module")
def motion(robot):
    """(n, T) at random."""
    return Motion(*np.random.default_rng(0).normal(size=(3, robot.dofs, len(T))))


@pytest.mark.parametrize("placed", [False, True])
@pytest.mark.parametrize("joint", range(4))
def test_a_contact_is_the_jacobians(joint, placed, robot, motion):
    """The term of a force in the base frame at a point of a link, or at a joint's origin, is minus the transposed
    Jacobian of that point times it, by Pinocchio, to rounding; what the arm's own masses need is left as it is."""
    effect, model = EFFECTS["external_contact"], pinocchio_model(robot)
    given, data = parameters("external_contact", np.random.default_rng(joint)), model.createData()
    point = given["point"] if placed else np.zeros(3)
    given = given if placed else {"force": given["force"]}
    wanted = np.empty_like(motion.q)
    for k, q in enumerate(motion.q.T):
        pin.computeJointJacobians(model, data, q)
        frame = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        own = model.getJointId(robot.joints[joint])
        jacobian, arm = pin.getJointJacobian(model, data, own, frame), data.oMi[own].rotation @ point
        wanted[:, k] = -jacobian[:3].T @ given["force"] - jacobian[3:].T @ np.cross(arm, given["force"])
    columns = effect.placed(given, robot, joint, motion) if placed else effect.basis(robot, joint, motion)
    np.testing.assert_allclose(np.tensordot(effect.coefficients(given), columns, 1), wanted, atol=1e-9)
    there = effect.found(effect.coefficients(given), given, robot, joint)
    assert there.keys() == given.keys() and all(np.array_equal(there[name], given[name]) for name in given)
    always = link_torque(robot, [EffectInstance(effect, joint, given)], motion, HERE)
    np.testing.assert_allclose(always - rigid_torque(robot, motion), wanted, atol=1e-9)


def test_a_window_has_its_weight():
    """1 inside, 0 outside and in other trajectories, 1 without a window; its sum times the period is its length, and
    grows as the edge moves between two samples, so that the edge can be found finer than a sample."""
    share = weight(WINDOW, HERE)
    assert np.all(share[(T > 0.51) & (T < 1.49)] == 1) and not np.any(share[(T < 0.49) | (T > 1.51)])
    assert weight(None, HERE) == 1 and weight(WINDOW, Span("other", T, RATE)) == 0
    assert weight(WINDOW, Span(None, T, RATE)) == 0
    for end in np.linspace(1.5, 1.52, 9):
        assert np.sum(weight(WINDOW._replace(end=end), HERE)) / RATE == pytest.approx(end - 0.5, abs=1e-12)


@pytest.mark.parametrize("seed", range(2))
def test_a_load_taken_up_is_a_payload(seed, robot, motion):
    """Inside the window the torque is that of the arm with the payload, outside that of the bare arm."""
    given = parameters("payload", np.random.default_rng(seed))
    laden = rigid_torque(EFFECTS["payload"].changed(given, robot, None), motion)
    got = link_torque(robot, [EffectInstance(EFFECTS["payload_change"], None, given, WINDOW)], motion, HERE)
    share = np.asarray(weight(WINDOW, HERE))
    np.testing.assert_allclose(got[:, share == 1], laden[:, share == 1], atol=1e-9)
    np.testing.assert_array_equal(got[:, share == 0], rigid_torque(robot, motion)[:, share == 0])


def test_a_load_is_taken_up_by_the_arm_as_it_is(robot, motion):
    """What is taken up adds to what lasts: with a wrong link beside it, the step in torque is the payload's alone."""
    error = EffectInstance(EFFECTS["link_inertia_error"], 1, parameters("link_inertia_error", np.random.default_rng(0)))
    load = EffectInstance(EFFECTS["payload_change"], None, parameters("payload", np.random.default_rng(1)), WINDOW)
    steps = [link_torque(robot, (*x, load), motion, HERE) - link_torque(robot, x, motion, HERE) for x in ((), (error,))]
    np.testing.assert_allclose(*steps, atol=1e-9)


def test_a_drive_weakens_for_a_time():
    """Logged torque is what reaches the joint divided by the gain inside the window, what reaches it outside."""
    tau = np.random.default_rng(0).normal(size=len(T))
    one = EffectInstance(EFFECTS["torque_gain_change"], 2, {"gain": 0.8}, WINDOW)
    share = np.asarray(weight(WINDOW, HERE))
    np.testing.assert_allclose(channel([one], 2, tau, HERE), tau + share * (tau / 0.8 - tau), atol=1e-12)
    np.testing.assert_array_equal(channel([one], 1, tau, HERE), tau)
    lasting = channel([replace(one, when=None)], 2, tau, HERE)
    np.testing.assert_allclose(lasting, tau / 0.8, atol=1e-12)
