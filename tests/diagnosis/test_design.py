"""Designed trajectories: within the limits, better at telling causes apart than others, honest where none can."""

import numpy as np
import pytest

from invdyn_cli.diagnosis.causes import Cause
from invdyn_cli.diagnosis.contest import pairs_of
from invdyn_cli.diagnosis.design import APART, design
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.errors import UsageError
from invdyn_cli.robots import load_urdf
from invdyn_cli.simulation.references import Multisine


def side(*causes):
    """A set of causes, each (effect, joint) of a typical size."""
    return tuple(Cause(EFFECTS[name], joint) for name, joint in causes)


@pytest.fixture(scope="module")
def arm():
    """The upper two joints of the built-in arm."""
    return load_urdf("apollo_arm", dofs=2)


@pytest.fixture(scope="module")
def stribeck(arm):
    """A design that tells Stribeck from Coulomb friction."""
    rivals = [side(("coulomb_friction", 1)), side(("stribeck_friction", 1))]
    return design(arm, [rivals], duration=12.0, tries=12)


@pytest.fixture(scope="module")
def whole(arm):
    """A design with bodies and the whole arm in it."""
    rivals = [side(("joint_spring", 1)), side(("payload", None)), side(("link_inertia_error", 1))]
    return design(arm, [rivals], duration=12.0, tries=6)


@pytest.mark.parametrize("name", ["stribeck", "whole"])
def test_stays_within_limits(name, request, arm):
    """Positions, velocities and the nominal torque stay within the URDF's limits, from rest to rest, for the duration
    that was asked for (to a sample of every gesture and move)."""
    made = request.getfixturevalue(name)
    q, qd = np.asarray(made.motion.q), np.asarray(made.motion.qd)
    assert np.all(q > arm.lower) and np.all(q < arm.upper)
    assert np.all(np.abs(qd) < arm.velocity_limit)
    assert np.all(np.abs(made.torque) < arm.effort_limit)
    assert np.abs(qd[[0, -1]]).max() < 1e-9
    assert made.t[-1] == pytest.approx(12.0, abs=0.1)


def test_velocities_are_those_of_the_positions(whole):
    """Speeds and accelerations are the derivatives of the positions, to the error of differences at 250 Hz."""
    step = whole.t[1]
    q, qd, qdd = (np.asarray(getattr(whole.motion, x)) for x in ("q", "qd", "qdd"))
    for a, b in ((q, qd), (qd, qdd)):
        assert np.abs(np.gradient(a, step, axis=0)[1:-1] - b[1:-1]).max() < 0.06 * np.abs(b).max()


def angle(motion, joint):
    """Share of a Stribeck friction (a fall of 30 % within 0.028 rad/s) that Coulomb, viscous friction and an offset
    leave, where the joint moves."""
    qd = np.asarray(motion.qd)[:, joint]
    qd = qd[np.abs(qd) > 0.004]
    true = np.sign(qd) * (1 + 0.3 * np.exp(-((qd / 0.028) ** 2)))
    columns = np.column_stack([np.sign(qd), qd, np.ones_like(qd)])
    left = true - columns @ np.linalg.lstsq(columns, true, rcond=None)[0]
    return np.linalg.norm(left) / np.linalg.norm(true)


def test_opens_the_angle_between_rivals(stribeck, arm):
    """What Coulomb, viscous friction and an offset leave of a Stribeck friction is larger than on any of ten ordinary
    multisines, by a fifth at least: an independent least-squares fit says so."""
    ordinary = max(angle(Multisine().motion(arm, 12.0, 250.0, seed=s), 1) for s in range(10))
    assert angle(stribeck.motion, 1) > 1.2 * ordinary


def test_says_where_no_motion_tells(arm, whole):
    """What is the same on every motion is called so: friction that differs by direction and Coulomb friction with an
    offset, a payload and the last link's inertials; a spring is told from either."""
    same = [side(("asymmetric_coulomb_friction", 1)), side(("coulomb_friction", 1), ("torque_offset", 1))]
    made = design(arm, [same], duration=8.0, tries=0)
    assert [p.possible for p in made.pairs] == [False, False]
    for pair in whole.pairs:
        names = {c.effect.name for c in (*pair.true, *pair.rival)}
        assert pair.possible == ("joint_spring" in names)
        assert pair.apart == (pair.possible and pair.distance >= APART)


def test_a_special_case_is_no_rival_of_the_general_one():
    """Coulomb friction taken for Stribeck friction leaves nothing, and is not asked for; the other way is."""
    pairs = pairs_of([[side(("coulomb_friction", 0)), side(("stribeck_friction", 0))]])
    assert [(p.true, p.rival) for p in pairs] == [(1, 0)]


def test_comes_from_its_seed(arm):
    """The same seed gives the same trajectory, another one another."""
    rivals = [side(("viscous_friction", 1)), side(("quadratic_friction", 1))]
    one, same, other = (design(arm, [rivals], duration=8.0, seed=s, tries=6) for s in (1, 1, 2))
    assert np.array_equal(one.motion.q, same.motion.q)
    assert not np.array_equal(one.motion.q[:500], other.motion.q[:500])


def test_misuse(arm):
    """Fewer than two rivals, or hardly any time: a line that says what is allowed."""
    with pytest.raises(UsageError, match="two or more"):
        design(arm, [[side(("viscous_friction", 1))]])
    with pytest.raises(UsageError, match="from 5 s"):
        design(arm, [[side(("viscous_friction", 1)), side(("torque_offset", 1))]], duration=1.0)
