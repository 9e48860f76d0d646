"""One experiment on objects: scores as by hand, a digest that sees every number, refusals; all models' contracts."""

from dataclasses import dataclass, replace

import jax
import numpy as np
import pytest

from invdyn_cli import experiment
from invdyn_cli.adaptation.batch import Batch
from invdyn_cli.chunks import CHUNK, in_chunks
from invdyn_cli.data.sim import SineTasks
from invdyn_cli.errors import UsageError
from invdyn_cli.hybrid import Hybrid
from invdyn_cli.interfaces import AbstractModel, AbstractSource, silent
from invdyn_cli.models.ffnn import Ffnn
from invdyn_cli.models.pest import Pest
from invdyn_cli.testing import check_adapter, check_model
from invdyn_cli.types import Dataset, Fit, Motion, Score, Splits, Trajectory
from tests.commands import usually
from tests.records import make_dataset, make_robot

ROBOT = make_robot(("a", "b"))
NET = Ffnn((8,), joints={2: {"hidden": (6, 6)}}, epochs=2, seeds=2)


@dataclass(frozen=True)
class Data(AbstractSource):
    """Three trajectories to learn from, one to watch, two to test on."""

    needs_robot = False
    seed: int = 0

    def load(self, robot, progress=silent):
        rng = np.random.default_rng(self.seed)
        progress(1.0, "made")
        sizes = {"samples": 50, "trajectories": 3}, {"samples": 40, "trajectories": 1}, {"samples": 30}, {"samples": 5}
        train, validation, test, other = (make_dataset(ROBOT, rng, **size) for size in sizes)
        return Splits(train, validation, {"test": test, "test_other": other}, {"made": "for a test"})


@dataclass(frozen=True)
class Constant(AbstractModel):
    """Says the mean torque that it learned, plus `error`; each of two members says one more or one less."""

    needs_robot = False
    error: float = 0.0

    def init(self, dataset, key):
        return {"mean": np.zeros(len(dataset.joints))}

    def apply(self, params, motion, robot):
        return params["mean"] + self.error + 0.0 * motion.q

    def fit(self, dataset, key, *, validation=None, progress=silent):
        progress(0.5, "half")
        noise = 1e-9 * jax.random.normal(key, (len(dataset.joints),))
        return Fit({"mean": dataset.tau.mean(0) + np.asarray(noise)}, None, dataset.joints, len(dataset.joints))

    def members(self, fit):
        return tuple(replace(fit, params={"mean": fit.params["mean"] + side}) for side in (-1, 1))


def test_scores_are_those_of_a_hand_computation():
    """NMSE and RMSE of every set, over all its trajectories together, against the mean of the learned torques."""
    record = experiment.run(Data(), Constant(0.25), Batch(), None)
    splits = Data().load(None)
    said = np.concatenate([x.tau for x in splits.train.trajectories]).mean(0) + 0.25
    for name, data in {"train": splits.train, "validation": splits.validation, **splits.tests}.items():
        tau = np.concatenate([x.tau for x in data.trajectories])
        mse = ((tau - said) ** 2).mean(0)
        np.testing.assert_allclose(record.scores[name].rmse, np.sqrt(mse), rtol=1e-6)
        np.testing.assert_allclose(record.scores[name].nmse, mse / tau.var(0), rtol=1e-6)
        for side, score in zip((-1, 1), record.member_scores[name], strict=True):
            np.testing.assert_allclose(score.rmse, np.sqrt(((tau - said - side) ** 2).mean(0)), rtol=1e-6)


def test_a_record_knows_what_was_done():
    """Predictions of the judged sets, sample counts, the split's description, the seed, and times that add up."""
    record = experiment.run(Data(), Constant(), Batch(), None, seed=3)
    assert set(record.predictions) == {"validation", "test", "test_other"}
    assert record.samples == {"train": 150, "validation": 40, "test": 60, "test_other": 10}
    assert record.choices["seed"] == 3 and record.split == {"made": "for a test"}
    assert record.predictions["test"].tau.shape == (60, 2)
    assert sum(record.seconds[name] for name in ("data", "fit", "predict")) <= record.seconds["total"]


def test_stages_are_told():
    """The stages data, learn and judge are opened in this order, and each reports what it does."""
    seen = []
    experiment.run(Data(), Constant(), Batch(), None, stage=lambda name: lambda share, note: seen.append((name, share)))
    assert [name for name, _ in seen] == ["data", "learn", *["judge"] * 4]
    assert seen[-1] == ("judge", 1.0)


def test_the_seed_is_the_models_key():
    """Equal seeds give equal fits, other seeds others."""
    means = [experiment.run(Data(), Constant(), Batch(), None, seed=s).fit.params["mean"] for s in (0, 0, 1)]
    np.testing.assert_array_equal(means[0], means[1])
    assert (means[0] != means[2]).all()


def test_each_recording_is_predicted_on_its_own():
    """A model is given one trajectory at a time: what it remembers cannot leak from one recording into the next."""
    lengths = []

    class Listens(Constant):
        def predict(self, fit, motion):
            lengths.append(len(motion))
            return super().predict(fit, motion)

    splits = Data().load(None)
    model = Listens()
    experiment.predict(model, model.fit(splits.train, jax.random.key(0)), splits.tests["test"])
    assert lengths == [30, 30]


def changed(splits: Splits, name: str, channel: str) -> Splits:
    """The splits with the last bit of one number of one channel flipped."""

    def touched(data: Dataset) -> Dataset:
        *rest, last = data.trajectories
        motion = {k: np.array(getattr(last.motion, k)) for k in ("q", "qd", "qdd")}
        arrays = {"t": np.array(last.t), "tau": np.array(last.tau), **motion}
        flat = arrays[channel].reshape(-1)
        flat[-1] = np.nextafter(flat[-1], np.inf)
        last = Trajectory(last.name, arrays["t"], Motion(*(arrays[k] for k in ("q", "qd", "qdd"))), arrays["tau"])
        return replace(data, trajectories=(*rest, last))

    if name in splits.tests:
        return replace(splits, tests={**splits.tests, name: touched(splits.tests[name])})
    return replace(splits, **{name: touched(getattr(splits, name))})


def test_the_digest_changes_with_any_number():
    """The last bit of a number in any channel of any set changes the digest; making the same data again does not."""
    splits = Data().load(None)
    digests = {experiment.digest(splits), experiment.digest(Data().load(None))}
    assert len(digests) == 1 and len(next(iter(digests))) == 16
    for name in ("train", "validation", "test", "test_other"):
        for channel in ("t", "q", "qd", "qdd", "tau"):
            digests.add(experiment.digest(changed(splits, name, channel)))
    assert len(digests) == 1 + 4 * 5


@pytest.mark.parametrize(
    ("source", "model", "words"),
    [(SineTasks(), NET, "this data source needs the robot"), (Data(), Pest(), "the model Pest needs the robot")],
)
def test_no_robot_where_one_is_needed(source, model, words):
    """Data and models that need kinematics are refused before any work, with a way out."""
    with pytest.raises(UsageError, match=rf"{words}.*robot=urdf"):
        experiment.run(source, model, Batch(), None)


def test_nets_need_no_robot():
    """FFNN runs from data to scores without any robot; one seed has no scores of members."""
    record = experiment.run(Data(), Ffnn((4,), joints={}, epochs=1), Batch(), None)
    assert np.isfinite(record.scores["test"].rmse).all() and not record.member_scores


@pytest.mark.parametrize("samples", [0, 1, 3, 100, CHUNK, CHUNK + 1, 2 * CHUNK + 5])
def test_chunks_lose_no_sample(samples):
    """Whatever the length, a function sees every sample once, in order, in few shapes, all powers of four."""
    q = np.arange(2.0 * samples).reshape(samples, 2)
    shapes = []

    def function(part):
        shapes.append(len(part.q))
        return part.q + part.qd + part.qdd

    np.testing.assert_array_equal(in_chunks(function, Motion(q, 2 * q, 3 * q)), 6 * q)
    assert all(n in (1, 4, 16, 64, 256, CHUNK) for n in shapes) and len(set(shapes)) <= 1


MODELS = {
    "pest": Pest(1e-2, False, "torque_spread", "coulomb_viscous", True, True),
    "ffnn": NET,
    "hybrid": Hybrid(Pest(1e-2, False, "torque_spread", "coulomb_viscous", True, True), NET),
}


@pytest.fixture(scope="module")
def few(apollo4):
    """Some hundred clean samples of the paper's arm."""
    return SineTasks(duration=2.0, rate=100.0, trim=10).load(apollo4).train


@pytest.mark.parametrize("name", usually(["pest", "ffnn"], MODELS))
def test_models_keep_their_contract(few, name):
    """`check_model` holds for PEST with all its columns, nets of two shapes, and the hybrid of both."""
    check_model(MODELS[name], few)


@pytest.mark.parametrize("name", usually(["hybrid"], MODELS))
def test_batch_keeps_its_contract(few, name):
    """`check_adapter` holds for batch learning of each."""
    check_adapter(Batch(), MODELS[name], few)


@dataclass(frozen=True)
class Follower(Batch):
    """Adds what the last sample lacked."""

    adapts = True

    def init(self, model, fit):
        return {**super().init(model, fit), "lacked": jax.numpy.zeros(len(fit.joints))}

    def predict(self, model, state, motion):
        return super().predict(model, state, motion) + state["lacked"]

    def update(self, model, state, motion, tau):
        return {**state, "lacked": tau - super().predict(model, state, motion)}


def test_an_adaptation_predicts_before_it_learns():
    """What adapts is also judged on the test set as it is adapted to: here each sample gets the last one's residual,
    the first none; what does not adapt is not judged twice."""
    record = experiment.run(Data(), Constant(), Follower(), None)
    test = record.predictions["test"]
    residual = test.data.tau - test.tau
    expected = test.tau + np.concatenate([np.zeros((1, 2)), residual[:-1]])
    np.testing.assert_allclose(record.predictions["test_adapted"].tau, expected, atol=1e-12)
    assert record.scores["test_adapted"].rmse[0] != record.scores["test"].rmse[0]
    assert "test_adapted" not in experiment.run(Data(), Constant(), Batch(), None).scores


@dataclass(frozen=True)
class Diverging(Follower):
    """Says nonsense of joint a after `after` samples, for `lasting` of them."""

    after: int = 40
    lasting: int = 1000
    nonsense: float = np.nan

    def init(self, model, fit):
        return {**super().init(model, fit), "samples": 0}

    def predict(self, model, state, motion):
        lost = (state["samples"] >= self.after) & (state["samples"] < self.after + self.lasting)
        nonsense = jax.numpy.array([self.nonsense, 0.0])
        return super().predict(model, state, motion) + jax.numpy.where(lost, nonsense, 0.0)

    def update(self, model, state, motion, tau):
        return {**super().update(model, state, motion, tau), "samples": state["samples"] + 1}


@pytest.mark.parametrize("nonsense", [np.nan, np.inf])
def test_what_diverged_is_told_and_has_no_score(nonsense):
    """Torques of joint a that are no numbers from the second trajectory's eleventh sample on: one warning with that
    time and name, no score of that joint, and no mean as if the other joint were all; what was learned is scored."""
    record = experiment.run(Data(), Constant(), Diverging(nonsense=nonsense), None)
    assert record.fit.warnings == (
        "the adaptation diverged at 0.10 s of move_1: its torques are not finite from there on",
    )
    for kind in ("nmse", "rmse"):
        adapted = record.scores["test_adapted"]
        assert np.isnan([adapted.mean(kind), getattr(adapted, kind)[0]]).all()
        assert np.isfinite(getattr(adapted, kind)[1]) and np.isfinite(record.scores["test"].mean(kind))


def test_a_mean_is_over_joints_that_have_variance():
    """A torque that never changes has no NMSE, and the mean is over the others."""
    score = Score(("a", "b"), np.array([np.nan, 0.5]), np.array([1.0, 2.0]))
    assert score.mean("nmse") == 0.5 and score.mean("rmse") == 1.5


@dataclass(frozen=True)
class Curable(Diverging):
    """One that knows what may help."""

    if_diverged = "a lower adaptation.after may help"


def test_only_adapting_is_blamed_for_what_it_did():
    """No word where all is finite or the model was no better as learned; "there" where numbers come back; what may
    help is said where the adaptation knows it."""
    (told,) = experiment.run(Data(), Constant(), Curable(lasting=5), None).fit.warnings
    assert told.endswith("0.10 s of move_1: its torques are not finite there; a lower adaptation.after may help")
    assert not experiment.run(Data(), Constant(), Follower(), None).fit.warnings
    assert not experiment.run(Data(), Constant(np.nan), Diverging(), None).fit.warnings
