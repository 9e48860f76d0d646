"""A load that comes and goes on a MuJoCo arm: found, weighed, predicted with, and nothing else taken for one."""

from dataclasses import replace

import jax
import numpy as np
import pinocchio as pin
import pytest

from invdyn_cli import experiment
from invdyn_cli.adaptation.payload import Payload, columns
from invdyn_cli.data.pick_place import PickPlace
from invdyn_cli.errors import UsageError
from invdyn_cli.interfaces import AbstractModel
from invdyn_cli.models.ffnn import Ffnn
from invdyn_cli.models.pest import Pest
from invdyn_cli.robots import load_urdf, pinocchio_model
from invdyn_cli.simulation.references import Manipulation
from invdyn_cli.testing import check_adapter
from invdyn_cli.types import Dataset, Fit, Motion
from tests.records import make_dataset, make_robot

KEY = jax.random.key(0)
DRAW = np.random.default_rng()
MASS, COM = float(DRAW.uniform(0.4, 1.5)), (*DRAW.uniform(-0.03, 0.03, 2), float(DRAW.uniform(0.05, 0.1)))
"""Of the object, another one each time."""


@pytest.fixture(scope="module")
def arm():
    return load_urdf("apollo_arm", dofs=4)


def source(**options) -> PickPlace:
    plain = {"repetitions": 1, "watched": 1, "elastic": False, "ripple": 0.0, "mass": MASS, "com": COM, "cache": None}
    much = {"friction": 1.0, "torque_noise": 0.01}  # as published for a UR10e, seven times that of the default arm
    return PickPlace(**{**plain, **much, "causal": True, "seed": int(DRAW.integers(1000)), **options})


def followed(arm, source: PickPlace, model: Pest, adapter: Payload):
    """The splits, and traces of the loaded and of one more unloaded repetition, each by name."""
    splits = source.load(arm)
    fit = adapter.fit(model, splits.train, KEY, validation=splits.validation)
    test, watched = splits.tests["test"], splits.validation
    assert watched is not None
    said, trace = experiment.follow(adapter, model, fit, test)
    return splits, said, trace, experiment.follow(adapter, model, fit, watched)[1]


def holds(source: PickPlace, k: int) -> tuple[float, float]:
    """When the object is half in hand, and half out of it, in a loaded repetition [s]."""
    return Manipulation().times(int(np.random.default_rng([source.seed, 1, k]).integers(2**31)))["holds"]


def test_contract():
    """It keeps the contract of an adaptation."""
    data = make_dataset(make_robot(("a", "b")), np.random.default_rng(0), samples=150)
    check_adapter(Payload(), Pest(), data)


def test_columns_are_a_bodys_torques(arm):
    """Y phi is what Pinocchio's inverse dynamics gains by a body on the last link."""
    draw = np.random.default_rng(1)
    body = pin.Inertia(1.3, np.array([0.02, -0.03, 0.1]), np.diag([0.01, 0.02, 0.015]))
    alone, laden = pinocchio_model(arm), pinocchio_model(arm)
    laden.inertias[laden.njoints - 1] += body
    for _ in range(3):
        q, qd, qdd = draw.normal(size=(3, arm.dofs))
        gained = pin.rnea(laden, laden.createData(), q, qd, qdd) - pin.rnea(alone, alone.createData(), q, qd, qdd)
        found = columns(arm, Motion(q, qd, qdd)) @ body.toDynamicParameters()
        np.testing.assert_allclose(found, gained, atol=1e-9)


@pytest.mark.benchmark  # a load is weighed through friction below
def test_a_load_is_weighed_behind_the_gears(arm):
    """Sensors behind friction see a load at rest: it is believed in when a slow grasp ends, and no longer 200 ms after
    a slow release has ended (the filter's 40 ms included), whatever was left of it in between; its mass is right within
    3 %, its centre within a centimetre; a repetition without one shows none."""
    made = source(torque_side="link", ramp=(0.3, 0.3))
    splits, _, trace, watched = followed(arm, made, Pest(threshold=1e-6), Payload())
    start = 0
    for k, x in enumerate(splits.tests["test"].trajectories):
        loaded, mass, com = (trace[name][start : start + len(x.t)] for name in ("loaded", "mass", "com"))
        start += len(x.t)
        grasp, release = holds(made, k)
        assert not loaded[x.t < grasp - 0.15].any() and loaded[(x.t > grasp + 0.15) & (x.t < release - 0.15)].all()
        assert not loaded[x.t > release + 0.15 + 0.2].any()
        last = np.flatnonzero(x.t < release - 0.15)[-1]
        assert mass[last] == pytest.approx(MASS, rel=0.03)
        np.testing.assert_allclose(com[last], COM, atol=0.01)
    assert not watched["loaded"].any()


def test_a_load_is_weighed_through_friction(arm):
    """From the motors' torques, friction and all, it is found once the arm moves on, and weighed within 5 % of a mass
    whose own standard deviation says as much; the torque is predicted several times better than without it."""
    made = source()
    model = Pest(friction="stribeck", weighting="torque_spread", rest_speed=0.003, least_speed=0.05)
    splits, said, trace, watched = followed(arm, made, model, Payload(observer=None))
    x = splits.tests["test"].trajectories[0]
    rows, (_, release) = slice(len(trace["mass"]) - len(x.t), None), holds(made, 0)
    last = np.flatnonzero(x.t < release - 0.05)[-1]
    mass, spread = trace["mass"][rows][last], trace["mass_std"][rows][last]
    assert abs(mass - MASS) < min(0.1, max(0.05 * MASS, 3 * spread))
    assert not watched["loaded"].any()
    place = (x.stage == "place") & (np.abs(x.motion.qd[:, 1]) > 0.1)  # at rest friction holds what it likes
    fit = model.fit(splits.train, KEY)
    unladen, laden = x.tau - model.predict(fit, x.motion), x.tau - said[rows]
    assert np.mean(laden[place, 1] ** 2) < np.mean(unladen[place, 1] ** 2) / 4


def test_what_no_load_does_is_followed():
    """A constant torque, where no load is ever believed in, is known but for 1/e after as many samples as the observer
    takes, and after five times as many but for 1 %."""
    data = make_dataset(make_robot(("a", "b")), np.random.default_rng(0), samples=100)
    adapter, model = Payload(observer=20, surety=1e9), Pest()
    fit = adapter.fit(model, data, KEY)
    fit = replace(fit, details={**fit.details, "load_threshold": np.inf})
    push = np.array([3.0, -2.0])
    pushed = Dataset(
        tuple(replace(x, tau=model.predict(fit, x.motion) + push) for x in data.trajectories), data.joints, data.robot
    )
    said, _ = experiment.follow(adapter, model, fit, pushed)
    missing = (pushed.tau - said) / push
    np.testing.assert_allclose(missing[20], np.exp(-1), atol=0.02)
    assert np.abs(missing[99]).max() < 0.01


class ByHeart(AbstractModel):
    """Knows every recording that it has seen, and says zero of others."""

    def init(self, dataset, key):
        return {}

    def apply(self, params, motion, robot):
        return 0.0 * motion.q

    def fit(self, dataset, key, *, validation=None, progress=None):
        seen = {x.motion.q.tobytes(): x.tau for x in dataset.trajectories}
        return Fit({}, dataset.robot, dataset.joints, 0, details={"seen": seen})

    def predict(self, fit, motion):
        q = np.asarray(motion.q)
        return fit.details["seen"].get(q.tobytes(), 0 * q)


@pytest.mark.parametrize("recordings", [1, 5])
@pytest.mark.parametrize("watched", [None, "a part of what was learned"])
def test_what_was_learned_by_heart_is_no_measure(watched, recordings):
    """A model that knows its recordings by heart is judged by what it says of what it does not know, whether
    there is no validation or one from the same recordings."""
    data = make_dataset(make_robot(("a", "b")), np.random.default_rng(0), samples=400, trajectories=recordings)
    parts = tuple(replace(x, name=f"{x.name}[0:1]") for x in data.trajectories)
    fit = Payload().fit(ByHeart(), data, KEY, validation=watched and replace(data, trajectories=parts))
    assert np.all(fit.details["load_variance"] > 0.1 * data.tau.var(axis=0))


@pytest.mark.parametrize("options", [{"mass": 0}, {"window": 1}, {"margin": 0.5}, {"observer": 0}, {"rate": 0}])
def test_misuse_is_refused(options):
    """Options that make no sense are refused by name."""
    (name,) = options
    with pytest.raises(UsageError, match=f"adaptation.{name}=.*allowed"):
        Payload(**options)


def test_it_needs_a_robot():
    """Without kinematics nobody knows where a load acts: a line that says so."""
    data = make_dataset(make_robot(("a",)), np.random.default_rng(0), samples=50)
    blind = Dataset(data.trajectories, data.joints, None)
    with pytest.raises(UsageError, match="needs the robot's kinematics"):
        Payload().fit(Ffnn(hidden=(4,), epochs=1, joints=()), blind, KEY)
