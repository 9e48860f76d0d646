"""Bodies, mounting and encoders: the changed robot is Pinocchio's, and its torque is linear in the coefficients."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from experiments.arms import random_robot
from experiments.cases import inverse_dynamics
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.rigid import rigid_torque
from invdyn_cli.interfaces import AbstractBodyEffect
from invdyn_cli.robots import load_urdf
from invdyn_cli.types import Motion
from tests.effects.drawn import joint_of, named, parameters

BODIES = named(AbstractBodyEffect)


@pytest.fixture(scope="module", params=["upright", "tilted"])
def robot(request):
    """An arm of three joints, its base upright, or nearly on its side."""
    return random_robot(np.random.default_rng(3), 3, None if request.param == "upright" else [1.3, -0.4, 0.0])


@pytest.fixture(scope="module")
def motion(robot):
    """(n, T) at random."""
    return Motion(*np.random.default_rng(0).normal(size=(3, robot.dofs, 40)))


def pinocchio(robot, motion: Motion) -> np.ndarray:
    """Torques (n, T) by Pinocchio."""
    return inverse_dynamics(robot, motion.q.T, motion.qd.T, motion.qdd.T).T


@pytest.mark.parametrize("name", BODIES)
@pytest.mark.parametrize("seed", range(3))
def test_the_changed_robot(name, seed, robot, motion):
    """Its torque is what Pinocchio says of it, to rounding, and differs from the nominal one."""
    effect, draw = EFFECTS[name], np.random.default_rng(seed)
    changed = effect.changed(parameters(name, draw), robot, joint_of(name, seed))
    torque = pinocchio(changed, motion)
    np.testing.assert_allclose(rigid_torque(changed, motion), torque, atol=1e-9)
    assert np.abs(torque - pinocchio(robot, motion)).max() > 0.01


@pytest.mark.parametrize("name", ["payload", "link_inertia_error"])
@pytest.mark.parametrize("seed", range(3))
def test_directions_and_coefficients_make_the_torque(name, seed, robot, motion):
    """Nominal torque plus directions times coefficients is the changed robot's, all by Pinocchio, to rounding."""
    effect, joint = EFFECTS[name], joint_of(name, seed)
    given = parameters(name, np.random.default_rng(seed))
    nominal = pinocchio(robot, motion)
    columns = [
        pinocchio(replace(robot, inertial=robot.inertial + inertial), motion) - nominal
        for inertial, _, _ in effect.directions(robot, joint)
    ]
    coefficients = effect.coefficients(given, robot, joint)
    sum_of = nominal + np.tensordot(coefficients, columns, 1)
    np.testing.assert_allclose(sum_of, pinocchio(effect.changed(given, robot, joint), motion), atol=1e-9)


def test_directions_of_gravity(robot, motion):
    """Likewise for a tilt, up to gravity's length: what is beyond the nominal fall grows with the tangent."""
    effect = EFFECTS["base_tilt"]
    nominal = np.asarray(robot.gravity)
    down = nominal / np.linalg.norm(nominal) + 0.1 * np.array([0.3, -0.5, 0.2])
    down /= np.linalg.norm(down)
    given = {"angle": float(np.arccos(-down[2])), "azimuth": float(np.arctan2(down[1], down[0]))}
    coefficients = effect.coefficients(given, robot, None)
    fall = nominal + sum(c * g for c, (_, g, _) in zip(coefficients, effect.directions(robot, None), strict=True))
    np.testing.assert_allclose(fall / np.linalg.norm(fall), down, atol=1e-9)
    changed = np.asarray(effect.changed(given, robot, None).gravity)
    np.testing.assert_allclose(changed, np.linalg.norm(nominal) * down, atol=1e-9)


def test_a_tilt_is_that_of_the_design():
    """gravity = 9.81 (sin angle cos azimuth, sin angle sin azimuth, -cos angle) in the base frame."""
    robot = load_urdf("apollo_arm", dofs=2)
    got = EFFECTS["base_tilt"].changed({"angle": 0.2, "azimuth": 0.7}, robot, None).gravity
    wanted = [np.sin(0.2) * np.cos(0.7), np.sin(0.2) * np.sin(0.7), -np.cos(0.2)]
    np.testing.assert_allclose(got, np.linalg.norm(robot.gravity) * np.array(wanted), atol=1e-12)
    assert np.linalg.norm(got) == pytest.approx(9.81, rel=1e-3)


@pytest.mark.parametrize("name", BODIES)
def test_coefficients_and_parameters_are_inverses(name, robot):
    """`read` of `coefficients` gives the parameters back, one coefficient for every direction."""
    effect = EFFECTS[name]
    for seed in range(5):
        given = parameters(name, np.random.default_rng(seed))
        coefficients = effect.coefficients(given, robot, joint_of(name, 1))
        assert len(coefficients) == len(effect.directions(robot, joint_of(name, 1)))
        told = effect.read(coefficients, robot, joint_of(name, 1))
        assert set(told) == set(effect.parameters)
        for key, value in given.items():
            np.testing.assert_allclose(told[key], value, atol=1e-9)


@pytest.mark.parametrize("name", BODIES)
def test_no_coefficients_change_nothing(name, robot, motion):
    """Coefficients of zero are the nominal robot (a payload of no mass has no centre either)."""
    effect = EFFECTS[name]
    none = effect.read([0.0] * len(effect.directions(robot, joint_of(name, 1))), robot, joint_of(name, 1))
    changed = effect.changed(none, robot, joint_of(name, 1))
    np.testing.assert_allclose(rigid_torque(changed, motion), rigid_torque(robot, motion), atol=1e-9)


def test_a_payload_is_a_body_on_the_last_link(robot):
    """Mass, centre and inertia about it add to the last link alone, as Pinocchio adds two bodies."""
    own = np.array([0.01, 0.001, 0.02, 0, 0.002, 0.015])
    given = {"mass": 1.5, "com": np.array([0.02, -0.03, 0.1]), "inertia": own}
    xx, xy, yy, xz, yz, zz = own
    body = pin.Inertia(1.5, given["com"], np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    changed = EFFECTS["payload"].changed(given, robot, None).inertial - robot.inertial
    np.testing.assert_allclose(changed[:-1], 0)
    np.testing.assert_allclose(changed[-1], body.toDynamicParameters(), atol=1e-12)


@pytest.mark.parametrize("joint", range(3))
def test_an_encoder_offset(joint, robot, motion):
    """logged q = true q + offset, on its joint alone, for one sample as for many; speeds are as logged."""
    effect = EFFECTS["encoder_offset"]
    shift = np.zeros((3, 1))
    shift[joint] = 0.1
    true = effect.true({"offset": 0.1}, motion, joint)
    np.testing.assert_allclose(true.q, motion.q - shift, atol=1e-15)
    assert true.qd is motion.qd and true.qdd is motion.qdd
    one = effect.true({"offset": 0.1}, Motion(motion.q[:, 0], motion.qd[:, 0], motion.qdd[:, 0]), joint)
    np.testing.assert_allclose(one.q, true.q[:, 0])


@pytest.mark.parametrize(("mounting", "said"), [([0, 0, 0], ""), ([np.pi, 0, 0], "3.44 degrees")])
def test_a_tilt_is_told_from_the_mounting(mounting, said):
    """The angle of a tilt is from upright; of a base that hangs the distance from hanging is told, too."""
    robot = load_urdf("apollo_arm", base_rpy=mounting)
    turned = {"angle": abs(mounting[0] - 0.06), "azimuth": 0.3}
    remark = EFFECTS["base_tilt"].remark(turned, robot)
    assert said in remark and bool(remark) == bool(said)
