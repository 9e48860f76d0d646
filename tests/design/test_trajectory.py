"""Designed trajectories: within the limits, better at telling causes apart than others, honest where none can."""

from dataclasses import replace

import numpy as np
import pytest

from invdyn_cli.design.causes import Cause, columns, scenes_of, term
from invdyn_cli.design.contest import pairs_of
from invdyn_cli.design.gestures import drawn, motion_of
from invdyn_cli.design.sizes import refused, typical, unplayable
from invdyn_cli.design.trajectory import APART, _room_and_usual, design
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.composition import EffectInstance, Span, link_torque
from invdyn_cli.effects.rigid import rigid_torque
from invdyn_cli.errors import UsageError
from invdyn_cli.robots import load_urdf
from invdyn_cli.simulation.references import Multisine
from invdyn_cli.types import Motion


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


def test_every_lasting_effect_has_a_typical_size(arm):
    """A cause of every effect of the catalogue that lasts can be designed for, without parameters: it changes some
    torque, by finite numbers, and physics allows it."""
    draw = np.random.default_rng(0)
    allowed, usual, postures = _room_and_usual(arm, draw)
    gestures = [drawn(draw, allowed, [1], 2.0, postures) for _ in range(12)]
    scenes = scenes_of(arm, [motion_of(g, allowed, 100.0) for g in gestures], np.arange(12.0), 100.0)
    for effect in EFFECTS.values():
        assert bool(unplayable(effect, arm)) == effect.passing
        if effect.passing:
            continue
        joint = None if effect.name in ("payload", "base_tilt") else 1
        parameters = typical(effect, joint, arm, usual, 30.0)
        assert refused(effect, parameters) == ""
        made = Cause(effect, joint, parameters)
        own = term(arm, made, scenes)
        for column in (own, *columns(arm, made, scenes, usual.torque)[-1][0]):
            assert np.isfinite(np.stack(list(column.values()))).all()
        assert effect.name == "torque_saturation" or np.abs(np.stack(list(own.values()))).max() > 0


@pytest.mark.parametrize("name", ["backlash", "joint_elasticity"])
def test_a_gear_is_what_its_formula_says(arm, name):
    """What a design takes a gear's yielding for is what inverse dynamics of the link's motion behind it says, but for
    what goes with the square of the deflection (milliradians: a few percent) and with its speed, and scene by scene."""
    motion = Multisine().motion(arm, 4.0, 100.0, seed=0)
    motion = Motion(*(np.asarray(x).T for x in (motion.q, motion.qd, motion.qdd)))
    parameters = {"backlash": {"gap": 0.002}, "joint_elasticity": {"stiffness": 4000.0}}[name]
    scenes = scenes_of(arm, [motion, motion], [0.0, 5.0], 100.0)
    found = term(arm, Cause(EFFECTS[name], 1, parameters), scenes)
    stretch = Span(None, np.arange(motion.q.shape[1]) / 100.0, 100.0)
    whole = link_torque(arm, [EffectInstance(EFFECTS[name], 1, parameters)], motion, stretch) - rigid_torque(
        arm, motion
    )
    for scene in range(2):
        for joint in range(2):
            assert np.abs(found[joint][scene] - whole[joint]).max() < 0.05 * np.abs(whole).max()


def test_library_reverses_over_milliradians_with_and_without_load(arm):
    """Among gestures at random there are reversals of 1 to 30 mrad, slow (below 0.03 rad/s) and fast (above 0.1 rad/s),
    where the joint bears a tenth of its largest load at most, and where it bears half of it or more."""
    draw = np.random.default_rng(1)
    allowed, _, postures = _room_and_usual(arm, draw)
    small = [g for g in (drawn(draw, allowed, [1], 2.0, postures) for _ in range(240)) if g.kind == "reversal"]
    most, seen = np.abs(postures.load[1]).max(), set()
    for g in small:
        motion = motion_of(g, allowed, 100.0)
        if not np.any(motion.qd[1]):
            continue
        assert np.ptp(motion.q[1]) < 0.0301
        still = Motion(g.centre[:, None], *(np.zeros((2, 1)) for _ in range(2)))
        load, speed = abs(rigid_torque(arm, still)[1, 0]) / most, np.abs(motion.qd[1]).max()
        seen |= {(a, b) for a, ok in (("slow", speed < 0.03), ("fast", speed > 0.1)) if ok
                 for b, there in (("free", load < 0.1), ("loaded", load > 0.5)) if there}  # fmt: skip
    assert seen == {("slow", "free"), ("slow", "loaded"), ("fast", "free"), ("fast", "loaded")}


def test_chirps_use_what_the_limits_allow(arm):
    """A chirp over the widest range of frequencies comes near its limit of speed or acceleration in its first and in
    its last third alike: it is not made small as a whole by its fastest part."""
    draw = np.random.default_rng(2)
    allowed, _, postures = _room_and_usual(arm, draw)
    made = next(g for g in (drawn(draw, allowed, [1], 2.0, postures) for _ in range(99)) if g.kind == "chirp")
    numbers = np.tile([0.5, 1.0, *[0.0] * 10], (2, 1))
    motion = motion_of(replace(made, size=np.array([0.0, 0.3]), numbers=numbers), allowed, 100.0)
    use = np.maximum(np.abs(motion.qd[1]) / allowed.speed[1], np.abs(motion.qdd[1]) / allowed.acceleration[1])
    third = len(use) // 3
    assert use[:third].max() > 0.4 and use[-third:].max() > 0.4 and use.max() <= 1 + 1e-9


def test_bristles_and_play_are_told_from_friction(arm):
    """Gear play, bristles, Stribeck and Coulomb friction of typical sizes are told apart, each from each that is no
    special case of it."""
    rivals = ("backlash", "presliding_hysteresis", "stribeck_friction", "coulomb_friction")
    made = design(arm, [[side((x, 1)) for x in rivals]], duration=24.0, tries=0)
    assert len(made.pairs) == 10 and all(p.apart for p in made.pairs)


def test_misuse(arm):
    """Fewer than two rivals, or hardly any time: a line that says what is allowed."""
    with pytest.raises(UsageError, match="two or more"):
        design(arm, [[side(("viscous_friction", 1))]])
    with pytest.raises(UsageError, match="5 s or more"):
        design(arm, [[side(("viscous_friction", 1)), side(("torque_offset", 1))]], duration=1.0)
