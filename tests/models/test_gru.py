"""GRU: the unit's equations in numpy, and that it learns what no function of the present state can say."""

from dataclasses import dataclass, replace

import jax
import numpy as np
import pytest

from invdyn_cli import experiment
from invdyn_cli.adaptation.batch import Batch
from invdyn_cli.adaptation.rls import Rls
from invdyn_cli.errors import UsageError
from invdyn_cli.hybrid import Hybrid
from invdyn_cli.interfaces import AbstractSource, silent
from invdyn_cli.maths.metrics import nmse
from invdyn_cli.maths.scaling import standardised
from invdyn_cli.models.gru import Gru
from invdyn_cli.models.pest import Pest
from invdyn_cli.testing import check_model
from invdyn_cli.types import Dataset, Fit, Splits
from tests.records import make_dataset, make_robot

KEY = jax.random.key(0)
SMALL = Gru(memory=6, hidden=8, window=20, epochs=2, batch_size=4)


@pytest.fixture(scope="module")
def data():
    return make_dataset(make_robot(("a", "b")), np.random.default_rng(0), samples=90)


def test_contract(data):
    """It keeps the contract of a model with a memory."""
    check_model(SMALL, data)


@pytest.mark.benchmark  # the hybrid's contract without a memory is in tests/test_experiment.py
def test_contract_of_a_hybrid(data):
    """So does a hybrid that has one in it."""
    check_model(Hybrid(Pest(friction="coulomb_viscous"), SMALL), data)


def test_equations_are_the_units(data):
    """The torques along a recording are those of the unit's equations (Cho et al. 2014, with the reset gate after the
    recurrent product, as cuDNN and flax have it) in numpy."""
    fit = Fit(SMALL.init(data, KEY), None, data.joints, 0)
    p, motion = fit.params, data.trajectories[0].motion
    x, _ = standardised(p, motion, data.trajectories[0].tau)
    unit, head = (jax.tree.map(np.asarray, p["nets"][name]) for name in ("unit", "head"))

    def sigmoid(x):
        return 1 / (1 + np.exp(-x))

    h, said = np.zeros(6), []
    for row in x:
        r = sigmoid(row @ unit["ir"]["kernel"] + unit["ir"]["bias"] + h @ unit["hr"]["kernel"])
        z = sigmoid(row @ unit["iz"]["kernel"] + unit["iz"]["bias"] + h @ unit["hz"]["kernel"])
        new = r * (h @ unit["hn"]["kernel"] + unit["hn"]["bias"])
        h = (1 - z) * np.tanh(row @ unit["in"]["kernel"] + unit["in"]["bias"] + new) + z * h
        wide = np.maximum(np.concatenate([h, row]) @ head["Dense_0"]["kernel"] + head["Dense_0"]["bias"], 0)
        said.append(wide @ head["Dense_1"]["kernel"] + head["Dense_1"]["bias"])
    expected = p["target_mean"] + p["target_scale"] * np.array(said)
    np.testing.assert_allclose(SMALL.predict(fit, motion), expected, atol=1e-5 * np.abs(expected).max())


def hidden_state(rng: np.random.Generator, data):
    """The same motions with a push of white noise in the place of qdd, and a torque that follows it with a first-order
    lag of 20 samples: what the present state says of it is the last of many terms."""
    made = []
    for one in data.trajectories:
        push = rng.normal(size=(len(one.t), 2))
        tau = np.zeros_like(push)
        for k in range(1, len(push)):
            tau[k] = 0.95 * tau[k - 1] + push[k]
        made.append(replace(one, motion=replace(one.motion, qdd=push), tau=tau))
    return replace(data, trajectories=tuple(made))


def test_learns_what_is_in_the_past(data):
    """Where the torque is a lag of 20 samples behind the input, the present input explains 1 - 0.95² = 10 % of its
    variance, and no memoryless model leaves less than 0.9; the unit leaves less than 0.2 on a recording it has not
    seen."""
    rng = np.random.default_rng(1)
    long = make_dataset(make_robot(("a", "b")), rng, samples=1500, trajectories=2)
    train, test = hidden_state(rng, long), hidden_state(rng, long)
    model = Gru(memory=16, hidden=16, window=60, epochs=60, batch_size=8, learning_rate=0.01)
    fit = model.fit(train, KEY)
    said = experiment.predict(model, fit, test)
    assert (nmse(test.tau, said) < 0.2).all()


def test_a_recording_shorter_than_the_window(data):
    """It trains on stretches as long as the shortest recording; a validation recording that is shorter is left out."""
    short = replace(data, trajectories=(data.trajectories[0], data.trajectories[1][slice(0, 12)]))
    fit = SMALL.fit(short, KEY, validation=replace(data, trajectories=(data.trajectories[1][slice(0, 5)],)))
    assert set(fit.history) == {"train_loss"} and np.isfinite(fit.history["train_loss"]).all()
    assert SMALL.predict(fit, data.motion[slice(0, 0)]).shape == (0, 2)


@dataclass(frozen=True)
class Held(AbstractSource):
    """Data that are there, learned from and judged on."""

    data: Dataset

    def load(self, robot, progress=silent):
        return Splits(self.data, None, {"test": self.data})


def test_is_not_adapted(data):
    """An adaptation takes samples one by one and would lose the memory: said in a line, and batch works."""
    with pytest.raises(UsageError, match="Gru needs the earlier samples of a recording"):
        experiment.run(Held(data), SMALL, Rls(), data.robot)
    record = experiment.run(Held(data), SMALL, Batch(), data.robot)
    said = [SMALL.predict(record.fit, x.motion) for x in data.trajectories]
    np.testing.assert_array_equal(record.predictions["test"].tau, np.concatenate(said))


def test_bad_options():
    """Options outside their ranges are refused by name."""
    for option, value in {"memory": 0, "window": 0, "learning_rate": 0.0}.items():
        with pytest.raises(UsageError, match=f"model.{option}="):
            Gru(**{option: value})
