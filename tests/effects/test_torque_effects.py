"""Effects on a joint's torque: the linear form that the search uses is the formula that stands in the model."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline

from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.interfaces import AbstractTorqueEffect, JointState
from tests.effects.drawn import joint_state, named, parameters

NAMES = named(AbstractTorqueEffect)


@pytest.mark.parametrize("name", NAMES)
def test_columns_make_the_term(name):
    """The term lies in the span of the columns at its own nonlinear parameters, to rounding, and `read` gives its
    parameters back from the coefficients: both forms are one formula."""
    effect = EFFECTS[name]
    for seed in range(10):
        draw = np.random.default_rng(seed)
        state, given = joint_state(draw), parameters(name, draw)
        shape = effect.shape_of(given)
        columns = np.stack(effect.basis(state, shape))
        coefficients, *_ = np.linalg.lstsq(columns.T, effect.term(given, state))
        np.testing.assert_allclose(columns.T @ coefficients, effect.term(given, state), atol=1e-9)
        told = effect.read([float(x) for x in coefficients], shape)
        assert set(told) == set(effect.parameters)
        np.testing.assert_allclose([told[k] for k in given], list(given.values()), rtol=1e-7)


@pytest.mark.parametrize("name", NAMES)
def test_shapes_are_complete(name):
    """Every trial gives all that is nonlinear a value, parameters made from it are within their bounds, and it is read
    back from them; a ripple's come from a scan."""
    effect = EFFECTS[name]
    draw = np.random.default_rng(0)
    state, wanted = joint_state(draw), set(effect.shape_of(parameters(name, draw)))
    shapes = effect.shapes(state)
    assert len(shapes) > 0 or name == "torque_ripple"
    for shape in shapes:
        assert set(shape) == wanted
        made = effect.read([1.0] * len(effect.basis(state, shape)), shape)
        assert effect.refuse(made) == ""
        assert effect.shape_of(made) == pytest.approx(shape)


@pytest.mark.parametrize("name", [n for n in NAMES if n != "presliding_hysteresis"])
def test_numpy_and_jax_agree(name):
    """Term and columns are the same of either arrays, to rounding, and jax arrays stay jax arrays."""
    effect, draw = EFFECTS[name], np.random.default_rng(0)
    state, given = joint_state(draw), parameters(name, draw)
    there = jax.tree.map(jnp.asarray, state)
    term = effect.term(given, there)
    assert isinstance(effect.term(given, state), np.ndarray) and isinstance(term, jnp.ndarray)
    np.testing.assert_allclose(term, effect.term(given, state), rtol=1e-12)
    shape = effect.shape_of(given)
    for x, y in zip(effect.basis(there, shape), effect.basis(state, shape), strict=True):
        assert isinstance(x, jnp.ndarray)
        np.testing.assert_allclose(x, y, rtol=1e-12, atol=1e-300)


@pytest.mark.parametrize("name", [n for n in NAMES if n.endswith("friction") or n.startswith("thermal")])
def test_friction_takes_power(name):
    """Friction acts against the motion: logged torque times velocity, of both joints of a gear that two share, is never
    negative."""
    effect, draw = EFFECTS[name], np.random.default_rng(1)
    state, given = joint_state(draw), parameters(name, draw)
    state = state._replace(sign=np.sign(state.qd))
    given |= {"armature": 0.0} if effect.coupled else {}
    term = effect.term(given, state)
    assert np.all(term * state.qd + effect.share_on_driver(given) * term * state.driver.qd >= 0)


def test_a_shared_drive_turns_with_both_joints():
    """Written out: coulomb sign(s) + damping s + armature ds/dt of s = qd + ratio qd of the joint before, where s is
    not near zero; the sign has slope 1 / width there, the widths of both speeds added as errors are."""
    state, given = joint_state(np.random.default_rng(0)), {"coulomb": 2.0, "damping": 0.7, "armature": 0.3}
    effect, before = EFFECTS["coupled_friction"], state.driver
    for ratio in (1.0, -1.0, 0.4):
        s, ds = state.qd + ratio * before.qd, state.qdd + ratio * before.qdd
        got = effect.term({**given, "ratio": ratio}, state)
        far = np.abs(s) > 0.01
        np.testing.assert_allclose(got[far], (2.0 * np.sign(s) + 0.7 * s + 0.3 * ds)[far], rtol=1e-12)
        assert effect.share_on_driver({**given, "ratio": ratio}) == ratio
        near = state._replace(qd=1e-4 - ratio * before.qd, qdd=-ratio * before.qdd)
        width = 1e-3 * np.hypot(1, ratio)
        np.testing.assert_allclose(effect.term({**given, "ratio": ratio}, near), 2e-4 / width + 0.7e-4, rtol=1e-9)


def test_a_part_that_is_hardly_negative_is_none():
    """A drive's damping that comes out a little below zero beside its dry friction is read as zero, one far below is
    refused; so is a ratio with which the other joint hardly turns the drive."""
    effect, shape = EFFECTS["coupled_friction"], {"ratio": -1.0}
    assert effect.read([1.0, -0.05, 0.2], shape) == {"coulomb": 1.0, "damping": 0.0, "armature": 0.2, **shape}
    assert "damping" in effect.refuse(effect.read([1.0, -0.5, 0.2], shape))
    assert "hardly turns" in effect.refuse({"coulomb": 1.0, "damping": 0.1, "armature": 0.1, "ratio": 0.05})


def bristled(q: np.ndarray, t: np.ndarray | None = None) -> JointState:
    """A joint that is at q (T,), of which bristles know nothing else."""
    t = np.arange(len(q)) / 500 if t is None else t
    qd = np.gradient(q, t)
    return JointState(t, q, qd, np.gradient(qd, t), np.sign(qd), np.zeros(len(q)))


def swaying(t: np.ndarray, seed: int) -> np.ndarray:
    """A sum of three sines of 0.2 to 2 Hz, some 0.1 rad."""
    draw = np.random.default_rng(seed)
    rate, phase = 2 * np.pi * draw.uniform(0.2, 2, (3, 1)), draw.uniform(0, 2 * np.pi, (3, 1))
    return 0.05 * np.sin(rate * t + phase).sum(axis=0)


@pytest.mark.parametrize("seed", range(2))
def test_bristles_are_dahls(seed):
    """Along a motion, coulomb and stiffness drawn at random, the term is stiffness z of dz/dt = qd - stiffness/coulomb
    |qd| z as SciPy integrates it, to 4 % of the level: a joint has turned after 2 % of the bristles' length, over which
    the term would have fallen by twice that. Bristles of a joint that moves are bent in the beginning."""
    given = parameters("presliding_hysteresis", np.random.default_rng(seed))
    t = np.arange(0, 3, 0.002)
    speed = make_interp_spline(t, swaying(t, seed), k=5).derivative()

    def slope(now, z):
        qd = float(speed(now))
        return qd - given["stiffness"] / given["coulomb"] * abs(qd) * z

    bent = np.sign(speed(0.0)) * given["coulomb"] / given["stiffness"]
    z = solve_ivp(slope, (0, t[-1]), [bent], t_eval=t, rtol=1e-6, atol=1e-7, max_step=0.01).y[0]
    got = EFFECTS["presliding_hysteresis"].term(given, bristled(swaying(t, seed), t))
    np.testing.assert_allclose(got, given["stiffness"] * z, atol=0.04 * given["coulomb"])
    assert got.min() < -0.8 * given["coulomb"] and got.max() > 0.8 * given["coulomb"]


def test_bristles_know_the_way_and_not_the_time():
    """The same way at another, uneven pace makes the same term, to rounding; never more than coulomb."""
    effect, given = EFFECTS["presliding_hysteresis"], {"coulomb": 2.0, "stiffness": 300.0}
    q = swaying(np.arange(0, 5, 0.002), 0)
    even = effect.term(given, bristled(q))
    uneven = effect.term(given, bristled(q, np.cumsum(np.random.default_rng(0).uniform(0.001, 0.1, len(q)))))
    np.testing.assert_allclose(uneven, even, atol=1e-12)
    assert np.abs(even).max() <= 2.0


def test_bristles_of_no_level_make_nothing():
    """A search may come to a level and a stiffness of zero."""
    effect = EFFECTS["presliding_hysteresis"]
    given = effect.read([0.0], {"length": 0.004})
    assert not effect.term(given, bristled(swaying(np.arange(0, 1, 0.002), 0))).any()


def test_bristles_stay_bent_at_rest():
    """A joint that moves, rests for 100 s and goes back: encoder noise of 10 microradians at 500 Hz adds up to 0.4 rad,
    a hundred times the bristles' length; the term stays that of the true motion to 10 % of the level."""
    effect, given = EFFECTS["presliding_hysteresis"], {"coulomb": 2.0, "stiffness": 2.0 / 0.004}
    t = np.arange(0, 104, 0.002)
    q = np.interp(t, [0, 2, 102, 104], [0.0, 0.5, 0.5, 0.0])
    noisy = q + 1e-5 * np.random.default_rng(0).normal(size=len(q))
    got, true = (effect.term(given, bristled(x)._replace(sign=0 * x)) for x in (noisy, q))
    np.testing.assert_allclose(got, true, atol=0.1 * 2.0)
    assert true[len(t) // 2] > 1.9


def test_bristles_remember_what_was_before():
    """A motion that is cut in two: with the way until then the second part's term is that of the whole motion."""
    effect, given = EFFECTS["presliding_hysteresis"], {"coulomb": 2.0, "stiffness": 300.0}
    q = swaying(np.arange(0, 5, 0.002), 1)
    first = int(np.flatnonzero(np.diff(np.sign(np.diff(q))))[0]) + 5  # just after it has turned back
    parts = bristled(q[:first]), bristled(q[first:])._replace(before=q[:first])
    whole = effect.term(given, bristled(q)._replace(sign=0 * q))
    got = [effect.term(given, x._replace(sign=0 * x.q)) for x in parts]
    np.testing.assert_allclose(np.concatenate(got), whole, atol=1e-12)
    assert abs(effect.term(given, bristled(q[first:]))[0] - whole[first]) > 1.0  # and not without


def test_bristles_of_one_sample():
    """One sample has no way behind it: the term is Coulomb's, of jax arrays too."""
    effect, given = EFFECTS["presliding_hysteresis"], {"coulomb": 2.0, "stiffness": 300.0}
    one = JointState(*map(jnp.asarray, (0.0, 0.3, -0.1, 0.0, -1.0, 5.0)))
    assert float(effect.term(given, one)) == -2.0
