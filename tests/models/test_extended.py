"""model=extended: what a diagnosis found, among the other models."""

import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from invdyn_cli import experiment, load_model, store
from invdyn_cli.adaptation.batch import Batch
from invdyn_cli.data.sim import SineTasks
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.composition import EffectInstance
from invdyn_cli.effects.description import ExtendedModel
from invdyn_cli.errors import UsageError
from invdyn_cli.models.extended import read
from invdyn_cli.robots import load_urdf
from invdyn_cli.testing import check_model
from invdyn_cli.types import Motion

FOUND = (
    ("viscous_friction", 0, {"damping": 0.7}),
    ("coulomb_friction", 1, {"coulomb": 2.0}),
    ("stribeck_friction", 0, {"coulomb": 1.0, "static": 1.5, "velocity": 0.1, "exponent": 1.0}),
    ("load_dependent_friction", 1, {"mu": 0.05}),
    ("torque_ripple", 1, {"amplitude": 0.3, "cycles": 8.0, "phase": 0.4}),
    ("torque_gain_error", 0, {"gain": 0.9}),
    ("payload", None, {"mass": 1.2, "com": np.array([0.01, 0.0, 0.08]), "inertia": np.zeros(6)}),
    ("base_tilt", None, {"angle": 0.05, "azimuth": 1.0}),
    ("encoder_offset", 1, {"offset": 0.02}),
)


@pytest.fixture(scope="module")
def robot():
    """The upper two joints of the built-in arm."""
    return load_urdf("apollo_arm", dofs=2)


@pytest.fixture(scope="module")
def data(robot):
    """Short sine tasks."""
    return SineTasks(duration=2.0).load(robot).train


@pytest.fixture(scope="module")
def extended(robot):
    """The robot with an effect of every kind."""
    return ExtendedModel(robot, tuple(EffectInstance(EFFECTS[name], joint, p) for name, joint, p in FOUND))


@pytest.fixture(scope="module")
def path(extended, tmp_path_factory):
    """Its extended_model.json."""
    path = tmp_path_factory.mktemp("model") / "extended_model.json"
    store.write_model(extended, path)
    return path


def test_keeps_the_contract_of_a_model(path, data):
    """It passes the conformance checker: pure, differentiable, the same under jit and vmap, back from run.h5."""
    check_model(read(str(path)), replace(data, trajectories=data.trajectories[:1]))


def test_the_file_gives_the_model_back(path, extended, data):
    """load_model on the file predicts what the diagnosed model predicts, to the last bit."""
    motion = data.trajectories[0].motion
    loaded = load_model(path)
    said = loaded.predict(motion.q, motion.qd, motion.qdd)
    assert np.array_equal(said, extended.predict(motion.q, motion.qd, motion.qdd))
    assert said.shape == motion.q.shape and loaded.robot.joints == extended.robot.joints


def test_a_run_needs_no_file_afterwards(path, data, tmp_path):
    """run.h5 holds every number: with the JSON gone, the reloaded run predicts the same."""
    gone = tmp_path / "extended_model.json"
    gone.write_text(path.read_text())
    model = read(str(gone))
    fit = Batch().fit(model, data, jax.random.key(0))
    record = experiment.RunRecord({"seed": 0}, model, Batch(), fit, {}, {}, {}, {}, {}, {}, "")
    store.write_run(record, tmp_path / "run.h5")
    gone.unlink()
    motion = data.trajectories[0].motion
    told = load_model(tmp_path / "run.h5").predict(motion.q, motion.qd, motion.qdd)
    assert np.array_equal(told, model.predict(fit, motion))


def test_learns_nothing_but_its_parameters_can_be_changed(path, data):
    """fit gives the file's parameters and counts them; another Coulomb friction gives another torque on its joint."""
    model = read(str(path))
    fit = model.fit(data, jax.random.key(0))
    assert fit.parameters == sum(np.size(v) for _, _, p in FOUND for v in p.values())
    assert float(fit.params["1_coulomb_friction"]["coulomb"]) == 2.0
    more = {**fit.params, "1_coulomb_friction": {"coulomb": jnp.asarray(3.0)}}
    one = Motion(*(jnp.full(2, x) for x in (0.3, 0.5, 0.1)))
    change = model.apply(more, one, None) - model.apply(fit.params, one, None)
    np.testing.assert_allclose(change, [0, 1], atol=1e-9)


def test_needs_no_robot(path, data):
    """It brings its own robot: a log without a URDF will do, and another nominal robot changes nothing."""
    model = read(str(path))
    assert not model.needs_robot
    fit = model.fit(replace(data, robot=None), jax.random.key(0))
    assert fit.robot.joints == data.joints


def test_a_delay_is_told_over_a_recording(robot, data, tmp_path):
    """predict finds the clock in q and qd: a delay of 20 ms shifts the torque by so much; a single sample has none."""
    delayed = ExtendedModel(robot, (EffectInstance(EFFECTS["torque_delay"], 1, {"delay": 0.02}),))
    store.write_model(delayed, tmp_path / "m.json")
    model = read(str(tmp_path / "m.json"))
    fit = model.fit(data, jax.random.key(0))
    trajectory = data.trajectories[-1]
    rate = 1 / np.median(np.diff(trajectory.t))
    said = model.predict(fit, trajectory.motion)
    plain = np.asarray(jax.vmap(lambda m: model.apply(fit.params, m, None))(trajectory.motion))
    ahead = round(0.02 * rate)
    size = np.abs(plain).max(0)
    assert np.abs(said[:-ahead] - plain[ahead:])[5:-5, 1].max() < 1e-3 * size[1]
    assert np.abs(said - plain)[:, 1].max() > 0.05 * size[1]
    assert np.abs(said - plain)[:, 0].max() < 1e-9 * size[0]


def test_other_joints_are_refused(path, data):
    """Data of other joints, or of the same in another order, are refused in one sentence with both lists."""
    with pytest.raises(UsageError, match=r"has joints .*, the data have elbow"):
        read(str(path)).fit(replace(data, joints=("elbow",), robot=None), jax.random.key(0))


BROKEN = {
    "no file": (None, "does not exist"),
    "no JSON": ("{", "is not JSON"),
    "a list": ("[]", "schema is 'list'"),
    "another file": (json.dumps({"schema": "invdyn-metrics/1"}), "allowed: invdyn-model/1"),
    "half a model": (json.dumps({"schema": "invdyn-model/1"}), "lacks"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_file_is_told_in_one_line(name, tmp_path):
    """Whatever the file is, the error says what was got and what to try."""
    text, words = BROKEN[name]
    if text is not None:
        (tmp_path / "m.json").write_text(text)
    with pytest.raises(UsageError, match=words) as error:
        read(str(tmp_path / "m.json"))
    assert "Try: " in str(error.value) and "\n" not in str(error.value)
