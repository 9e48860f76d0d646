"""The extended model: pure in jax, the same over a recording, and the same from its JSON."""

import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.arms import random_robot
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.composition import EffectInstance, TimeWindow
from invdyn_cli.effects.description import ExtendedModel, as_dict, from_dict, period_of
from invdyn_cli.errors import UsageError
from invdyn_cli.types import Motion
from tests.effects.drawn import joint_of, parameters

MEMORY = ("torque_delay", "actuator_lag", "backlash", "joint_elasticity")
PASSING = tuple(name for name, effect in EFFECTS.items() if effect.passing)
"""Neither shows in a single sample."""


@pytest.fixture(scope="module")
def robot():
    """An arm of two joints: what compiles fast."""
    return random_robot(np.random.default_rng(3), 2)


@pytest.fixture(scope="module")
def motion():
    """(T, n) at random; no velocity is within the width of sign(qd)."""
    q, qd, qdd = np.random.default_rng(0).normal(size=(3, 30, 2))
    return Motion(q, np.where(np.abs(qd) < 0.01, 0.02, qd), qdd)


T = np.linspace(0, 3, 30)
WINDOWS = (0.5, 1.0), (1.5, 2.5)
"""[s] of two events on one joint."""
WEIGHTS = np.random.default_rng(1).normal(size=(30, 2))


def model_of(name: str, robot, given=None) -> ExtendedModel:
    """The robot with one effect on its second joint."""
    given = parameters(name, np.random.default_rng(5)) if given is None else given
    when = TimeWindow("run", 1.0, 2.0) if EFFECTS[name].passing else None
    return ExtendedModel(robot, (EffectInstance(EFFECTS[name], joint_of(name, 1), given, when),))


SHOWN = [n for n in EFFECTS if n not in (*MEMORY, *PASSING, "presliding_hysteresis")]


@pytest.fixture(scope="module")
def everything(robot):
    """The robot with every effect that a single sample shows; the limit is the first joint's, the rest the second's."""
    where = {"torque_saturation": 0}
    return ExtendedModel(
        robot, tuple(replace(model_of(n, robot).acting[0], joint=where.get(n, joint_of(n, 1))) for n in SHOWN)
    )


@pytest.fixture(scope="module")
def slopes(everything, motion):
    """Torques (T, n) of all samples by `apply`, and the slope of a weighted sum of them in every parameter: one jit."""

    def value(parameters):
        acting = [replace(a, parameters=p) for a, p in zip(everything.acting, parameters, strict=True)]
        model = replace(everything, acting=tuple(acting))
        tau = jax.vmap(lambda m, t: model.apply(m, t))(motion, T)
        return jnp.sum(WEIGHTS * tau), tau

    given = [jax.tree.map(jnp.asarray, dict(a.parameters)) for a in everything.acting]
    (_, tau), slope = jax.jit(jax.value_and_grad(value, has_aux=True))(given)
    return tau, dict(zip(SHOWN, slope, strict=True))


def test_jit_and_vmap_go_through(everything, slopes, motion):
    """`apply` under jit and vmap is what `predict` says of a recording; one sample, not jitted, is a row of it."""
    rows = everything.predict(motion.q, motion.qd, motion.qdd, T)
    np.testing.assert_allclose(slopes[0], rows, atol=1e-9)
    one = Motion(*(jnp.asarray(x[7]) for x in (motion.q, motion.qd, motion.qdd)))
    np.testing.assert_allclose(everything.apply(one, T[7]), rows[7], atol=1e-9)


@pytest.mark.parametrize("name", SHOWN)
def test_grad_goes_through(name, everything, slopes, motion):
    """The gradient in an effect's parameters is the slope of `predict`, to 1e-5."""
    place = SHOWN.index(name)
    given = everything.acting[place].parameters
    for key, at in given.items():
        for i in np.ndindex(np.shape(at)):
            ends = []
            for step in (1e-6, -1e-6):
                moved = np.array(at, float)
                moved[i] += step
                acting = list(everything.acting)
                moved = moved if np.ndim(at) else float(moved)
                acting[place] = replace(acting[place], parameters={**given, key: moved})
                model = replace(everything, acting=tuple(acting))
                ends.append(np.sum(WEIGHTS * model.predict(motion.q, motion.qd, motion.qdd, T)))
            slope = np.asarray(slopes[1][name][key])[i]
            assert slope == pytest.approx((ends[0] - ends[1]) / 2e-6, rel=1e-5, abs=1e-5)
        assert np.any(np.asarray(slopes[1][name][key]))


def test_a_single_sample_has_no_memory(robot, motion):
    """What has a memory, or comes and goes, leaves `apply` as it is."""
    every = ExtendedModel(robot, tuple(model_of(n, robot).acting[0] for n in (*MEMORY, *PASSING)))
    one = Motion(*(jnp.asarray(x[7]) for x in (motion.q, motion.qd, motion.qdd)))
    np.testing.assert_array_equal(every.apply(one, T[7]), ExtendedModel(robot, ()).apply(one, T[7]))


@pytest.mark.parametrize("name", [*MEMORY, *PASSING])
def test_a_recording_has(name, robot, motion):
    """Over a recording they change the torque of their own joint, and of the other as well where they move the link or
    pull on it."""
    change = [
        m.predict(motion.q, motion.qd, motion.qdd, T, "run") for m in (model_of(name, robot), ExtendedModel(robot, ()))
    ]
    assert np.any(np.abs(change[0] - change[1]) > 1e-12, axis=0).tolist() == [EFFECTS[name].point != "channel", True]


def test_a_force_at_a_joint_s_origin_is_not_felt_there(robot, motion):
    """At the second joint's origin, which that joint does not move, only the first feels it."""
    model = model_of("external_contact", robot, {"force": np.array([3.0, -2.0, 5.0])})
    change = [m.predict(motion.q, motion.qd, motion.qdd, T, "run") for m in (model, ExtendedModel(robot, ()))]
    assert np.any(np.abs(change[0] - change[1]) > 1e-12, axis=0).tolist() == [True, False]


@pytest.mark.parametrize("name", PASSING)
def test_what_comes_and_goes(name, robot, motion):
    """In its own trajectory it acts from 1 to 2 s, as the lasting one would, and at no other time; in others never."""
    model, nominal = model_of(name, robot), ExtendedModel(robot, ())
    lasting = replace(model, acting=(replace(model.acting[0], when=None),))
    inside = (T > 1.1) & (T < 1.9)
    outside = (T < 0.9) | (T > 2.1)
    rows, never = (m.predict(motion.q, motion.qd, motion.qdd, T, "run") for m in (model, nominal))
    always = lasting.predict(motion.q, motion.qd, motion.qdd, T, "run")
    np.testing.assert_array_equal(rows[outside], never[outside])
    np.testing.assert_allclose(rows[inside], always[inside], atol=1e-12)
    assert np.abs(always[inside] - never[inside]).max() > 0.01
    for other in (None, "another"):
        np.testing.assert_array_equal(model.predict(motion.q, motion.qd, motion.qdd, T, other), never)


def test_bristles_in_a_sample_are_bent_to_their_end(robot, motion):
    """`apply` has them slide, as Coulomb friction does; `predict` has them bend along the way."""
    bristles = model_of("presliding_hysteresis", robot, {"coulomb": 1.5, "stiffness": 1.0})
    sliding = model_of("coulomb_friction", robot, {"coulomb": 1.5})
    one = Motion(*(jnp.asarray(x[7]) for x in (motion.q, motion.qd, motion.qdd)))
    np.testing.assert_allclose(bristles.apply(one), sliding.apply(one), atol=1e-12)
    rows = [m.predict(motion.q, motion.qd, motion.qdd, T) for m in (bristles, sliding)]
    assert np.abs(rows[0] - rows[1]).max(axis=0)[1] > 0.1


@pytest.mark.parametrize("name", EFFECTS)
def test_json_and_back(name, robot, motion):
    """Through JSON text and back the model predicts the same to the last bit; parameters carry their units."""
    model = replace(model_of(name, robot), filter={"order": 4}, provenance={"log": "a test"})
    stored = json.loads(json.dumps(as_dict(model), allow_nan=False))
    again = from_dict(stored)
    rows = [m.predict(motion.q, motion.qd, motion.qdd, T, "run") for m in (model, again)]
    assert np.array_equal(*rows)
    assert again.acting[0].when == model.acting[0].when
    assert again.acting[0].effect is EFFECTS[name] and again.acting[0].joint == model.acting[0].joint
    assert (again.filter, again.provenance, again.robot.urdf) == (model.filter, model.provenance, robot.urdf)
    row = stored["effects"][0]["parameters"]
    assert {k: v["unit"] for k, v in row.items()} == {k: v.unit for k, v in EFFECTS[name].parameters.items()}


def test_windows_stand_in_the_file(robot):
    """What comes and goes has its trajectory and its window there, what lasts has neither; two on one joint stay two,
    and one without a window is refused in a line."""
    both = tuple(replace(model_of("torque_gain_change", robot).acting[0], when=TimeWindow("run", *w)) for w in WINDOWS)
    model = ExtendedModel(robot, (*both, *model_of("payload", robot).acting))
    stored = json.loads(json.dumps(as_dict(model)))
    assert [x.get("window") for x in stored["effects"]] == [[0.5, 1.0], [1.5, 2.5], None]
    assert [x.get("trajectory") for x in stored["effects"]] == ["run", "run", None]
    assert len({x.key for x in from_dict(stored).acting}) == 3
    del stored["effects"][0]["window"]
    with pytest.raises(UsageError, match="lacks 'window'"):
        from_dict(stored)


def test_intervals_come_back(robot):
    """Interval ends of numbers and vectors survive, and none stays none."""
    com = np.array([0.0, 0.01, 0.1])
    given = {"mass": 1.0, "com": com, "inertia": np.zeros(6)}
    ends = {"mass": (1.0, 0.9, 1.1), "com": (com, com - 0.01, com + 0.01)}
    model = replace(model_of("payload", robot, given), intervals=(ends,))
    (told,) = from_dict(json.loads(json.dumps(as_dict(model)))).intervals
    assert set(told) == {"mass", "com"} and told["mass"] == (1.0, 0.9, 1.1)
    np.testing.assert_array_equal(told["com"], ends["com"])


def test_limits_without_end_survive(robot):
    """A robot without joint limits is one after the file, which is strict JSON."""
    free = replace(robot, lower=np.full(2, -np.inf), upper=np.full(2, np.inf))
    again = from_dict(json.loads(json.dumps(as_dict(ExtendedModel(free, ())), allow_nan=False))).robot
    assert np.array_equal(again.upper, free.upper) and np.array_equal(again.lower, free.lower)


def test_an_unknown_effect_is_told(robot):
    """A file with an effect that this version lacks is refused with the nearest name."""
    stored = as_dict(model_of("payload", robot))
    stored["effects"][0]["effect"] = "payloads"
    with pytest.raises(UsageError, match=r"no effect 'payloads'.*payload"):
        from_dict(stored)


def test_the_clock_is_found_in_the_motion():
    """Without t, the period is that which makes qd the derivative of q, to 1e-3 on a smooth motion."""
    t = np.arange(2000) / 250.0
    q, qd = (np.stack([np.sin(2 * t), np.cos(3 * t)]), np.stack([2 * np.cos(2 * t), -3 * np.sin(3 * t)]))
    assert period_of(q, qd) == pytest.approx(1 / 250, rel=1e-3)
    assert period_of(q, 0 * qd) > 0
