"""References go from rest to rest within the joints' limits, and their derivatives are those of their positions."""

from dataclasses import replace

import numpy as np
import pytest

from invdyn_cli.errors import UsageError
from invdyn_cli.robots import load_urdf
from invdyn_cli.simulation.references import ConstantSpeed, Multisine, PickPlace

WAYS = (Multisine(), Multisine(amplitude=1.0, speed=1.0, base=0.3), PickPlace(), PickPlace(amplitude=1.0, speed=1.0),
        ConstantSpeed(), ConstantSpeed(together=True, amplitude=1.0, speed=1.0))  # fmt: skip
NAMES = [f"{type(way).__name__}-{i}" for i, way in enumerate(WAYS)]


@pytest.fixture(scope="module")
def arms():
    """The built-in arm, and one of it without limits whose last joint slides."""
    apollo = load_urdf("apollo_arm")
    free = {"lower": np.full(7, -np.inf), "upper": np.full(7, np.inf), "velocity_limit": np.full(7, np.inf)}
    return apollo, replace(apollo, **free, prismatic=(False,) * 6 + (True,))


@pytest.mark.parametrize("way", WAYS, ids=NAMES)
def test_stays_within_limits(way, arms):
    """Positions and velocities stay within the joint's limits; without limits within 2 rad (0.5 m) about zero."""
    for robot in arms:
        x = way.motion(robot, 20.0, 200.0, seed=4)
        assert x.q.shape == x.qd.shape == x.qdd.shape == (4000, 7)
        free = np.where(robot.prismatic, 0.5, 2.0)
        low = np.where(np.isfinite(robot.lower), robot.lower, -free)
        high = np.where(np.isfinite(robot.upper), robot.upper, free)
        assert np.all(x.q >= low - 1e-6) and np.all(x.q <= high + 1e-6)
        assert np.all(np.abs(x.qd) <= robot.velocity_limit + 1e-9)
        assert np.all(np.ptp(x.q, axis=0) > 0.05)


@pytest.mark.parametrize("way", WAYS, ids=NAMES)
def test_is_a_motion_from_rest_to_rest(way, arms):
    """It begins and ends at rest; velocities and accelerations are the derivatives, to the error of differences."""
    x = way.motion(arms[0], 20.0, 1000.0, seed=1)
    assert np.abs(x.qd[[0, -1]]).max() < 1e-3 and np.abs(x.qdd[0]).max() < 1e-9
    for a, b in ((x.q, x.qd), (x.qd, x.qdd)):
        assert np.abs(np.gradient(a, 1e-3, axis=0)[1:-1] - b[1:-1]).max() < 0.01 * np.abs(b).max()


@pytest.mark.parametrize("way", WAYS, ids=NAMES)
def test_comes_from_its_seed(way, arms):
    """The same seed gives the same motion, another one another."""
    one, same, other = (way.motion(arms[0], 10.0, 100.0, seed=seed).q for seed in (1, 1, 2))
    assert np.array_equal(one, same)
    assert not np.allclose(one, other)


def test_constant_speeds_are_constant(arms):
    """Most of the time that a joint moves it moves at one of the speeds, and one joint at a time."""
    x = ConstantSpeed(speeds=(0.2, 1.0)).motion(arms[0], 60.0, 200.0, seed=0)
    moving = np.abs(x.qd) > 1e-6
    assert moving.sum(1).max() == 1
    assert np.all((np.abs(x.qdd) < 1e-9)[moving].mean() > 0.5)
    steady = np.abs(x.qd[:, 1])[moving[:, 1] & (np.abs(x.qdd[:, 1]) < 1e-9)]
    speeds = 0.5 * arms[0].velocity_limit[1] * np.array([0.2, 1.0])
    assert np.abs(steady[:, None] - speeds).min(1).max() < 1e-9


def test_joints_sweep_in_turn_or_joint_by_joint(arms):
    """Speed after speed every joint comes as often as there are speeds, joint by joint once; the way is the same."""
    turns = {}
    for by_joint in (False, True):
        x = ConstantSpeed(speeds=(0.2, 0.5, 1.0), by_joint=by_joint).motion(arms[0], 60.0, 200.0, seed=0)
        moves = np.abs(x.qd) > 1e-6
        at = np.argmax(moves[moves.any(axis=1)], axis=1)
        turns[by_joint] = at[np.r_[True, np.diff(at) != 0]]
    n = arms[0].dofs
    assert turns[False].tolist() == 3 * list(range(n)) and turns[True].tolist() == list(range(n))


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Multisine(amplitude=1.5), "amplitude=1.5; allowed: above 0 up to 1"),
        (lambda: Multisine(base=0), "base=0"),
        (lambda: PickPlace(dwell=-1), "dwell=-1"),
        (lambda: ConstantSpeed(speeds=()), "speeds="),
    ],
    ids=["amplitude", "base", "dwell", "speeds"],
)
def test_refuses(make, said):
    """Numbers out of range are refused in one line."""
    with pytest.raises(UsageError, match=said):
        make()


def test_no_time_for_a_move(arms):
    """A recording too short for a single move is refused rather than recorded at rest."""
    with pytest.raises(UsageError, match="a longer duration"):
        PickPlace(dwell=3.0).motion(arms[0], 3.1, 100.0, seed=0)
