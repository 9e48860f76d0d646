"""A learned feedforward in the control loop: it takes work off the feedback, adapting keeps it so, and failures are
told."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from invdyn_cli.adaptation.batch import Batch
from invdyn_cli.control import ADAPTED, ALONE, LEARNED, Learner, Sweep, run
from invdyn_cli.data.pick_place import PickPlace
from invdyn_cli.data.tasks import AbstractTaskSource, Task
from invdyn_cli.errors import UsageError
from invdyn_cli.interfaces import AbstractModel, silent
from invdyn_cli.maths import rigid_body
from invdyn_cli.robots import load_urdf
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.simulation.references import Multisine
from invdyn_cli.simulation.sensors import Noise
from invdyn_cli.types import Dataset, Fit, Motion, Splits, Trajectory

STIFF, SOFT = 50.0, 10.0
RIGID = {"friction": 0.0, "elastic": False, "ripple": 0.0}
"""An arm that is a rigid body and nothing else."""


@pytest.fixture(scope="module")
def arm():
    return load_urdf("apollo_arm", dofs=2)


@pytest.fixture(scope="module")
def source() -> PickPlace:
    return PickPlace(repetitions=1, watched=0, torque_noise=0.002, cache=None, causal=True, **RIGID)


class Exact(AbstractModel):
    """The nominal arm, which is what is simulated where nothing is hidden."""

    def init(self, dataset, key):
        return {}

    def apply(self, params, motion, robot):
        assert robot is not None
        return rigid_body.inverse_dynamics(robot, robot.inertial, motion.q, motion.qd, motion.qdd)

    def fit(self, dataset, key, *, validation=None, progress=None):
        return Fit({}, dataset.robot, dataset.joints, 0)


class Following(Batch):
    """What is left over on average in the last tenth of a second is there in the next."""

    adapts = True

    def init(self, model, fit):
        return super().init(model, fit), jnp.zeros(len(fit.joints))

    def predict(self, model, state, motion):
        fitted, left = state
        return super().predict(model, fitted, motion) + left

    def update(self, model, state, motion, tau):
        fitted, left = state
        return fitted, left + (tau - super().predict(model, fitted, motion) - left) / 100


@pytest.fixture(scope="module")
def record(arm, source):
    """Stiff and soft."""
    return run(source, Exact(), Following(), arm, Sweep(gains=(STIFF, SOFT)))


def test_exact_feedforward_leaves_nothing_to_feedback(record):
    """With the inverse dynamics of a rigid arm it follows thirty times as closely as with feedback alone, and the
    feedback has less than 3 % of the torque."""
    for gain in (STIFF, SOFT):
        assert record.rms(gain, False, LEARNED) < record.rms(gain, False, ALONE) / 30
        assert record.share(gain, False, LEARNED) < 0.03


def test_feedback_alone_errs_as_gains_fall(record):
    """With feedback alone all torque is the feedback's, and the error grows as its gain falls, nearly in proportion."""
    for loaded in (False, True):
        assert record.share(SOFT, loaded, ALONE) == pytest.approx(1.0)
        ratio = record.rms(SOFT, loaded, ALONE) / record.rms(STIFF, loaded, ALONE)
        assert STIFF / SOFT / 2 < ratio < STIFF / SOFT * 2


def test_adapting_carries_the_object(record):
    """With the object the adapted model is at least twice as close as the one that does not adapt, at every gain;
    without it adapting costs nothing."""
    for gain in (STIFF, SOFT):
        assert record.rms(gain, True, ADAPTED) < record.rms(gain, True, LEARNED) / 2
        assert record.rms(gain, False, ADAPTED) < 1.1 * record.rms(gain, False, LEARNED)


def test_the_object_tells_while_it_is_held(record):
    """What is not adapted to errs when the object is carried, and hardly before it is grasped."""
    (one,) = record.runs(SOFT, True, LEARNED)
    approach, place = (np.sqrt(np.mean(one.stages[name] ** 2)) for name in ("approach", "place"))
    assert place > 5 * approach


def test_out_of_control_is_a_result(arm, source):
    """An arm that feedback cannot hold is told in a sentence with joint and time, not an exception. A model that does
    not adapt is not tried as if it did."""
    made = run(source, Exact(), Batch(), arm, Sweep(gains=(1.0,), largest_error=0.2))
    assert made.kinds == (ALONE, LEARNED)
    (soft,) = made.runs(1.0, False, ALONE)
    assert "out of control" in soft.failed and "arm_joint" in soft.failed and np.isnan(soft.rms)


class Diverging(Following):
    """Adds ten times what was wrong, each time."""

    def update(self, model, state, motion, tau):
        fitted, left = state
        return fitted, left * 10 + 1e300 * (tau - tau + 1)


def test_learning_that_diverges_is_a_result(arm, source):
    """A feedforward that is no number any more never reaches the arm: it is told by joint, and the others run."""
    made = run(source, Exact(), Diverging(), arm, Sweep(gains=(STIFF,)))
    assert all("diverged" in x.failed and "arm_joint" in x.failed for x in made.cases if x.kind == ADAPTED)
    assert not any(x.failed or np.isnan(x.rms) for x in made.cases if x.kind != ADAPTED)


class Lifting(AbstractTaskSource):
    """A task of somebody else's at 500 Hz: a swing in which a weight is in hand for the last second of three."""

    rate, torque_side, filter_cutoff, filter_order, causal = 500.0, "command", 10.0, 4, True
    torque_lag, decimate, seed = 0, 1, 0

    def trial(self, robot, number, *, loaded):
        weight = Hidden("payload_change", None, {"mass": 2.0, "com": [0.0, 0.0, 0.1], "window": [2.0, 3.0]})
        return Task("swing", Multisine(ramp=0.5), 3.0, number, (weight,) * loaded, Noise(), {"swing": 0.0, "lift": 2.0})

    def load(self, robot, progress=silent):
        motion = self.trial(robot, 1, loaded=False).motion(robot, self.rate)
        t = np.arange(len(motion.q)) / self.rate
        tau = np.asarray(
            rigid_body.inverse_dynamics(robot, robot.inertial, *(x.T for x in (motion.q, motion.qd, motion.qdd)))
        ).T
        return Splits(Dataset((Trajectory("swing", t, motion, tau),), robot.joints, robot), None, {})


def test_a_task_of_somebody_elses(arm):
    """Any source with a task is controlled at its rate: the exact model follows at least ten times as closely as
    feedback alone, and errs by more than ten times as much once it lifts a weight that it does not know."""
    source = Lifting()
    made = run(source, Exact(), Batch(), arm, Sweep(gains=(STIFF,), settle=0.2))
    assert made.rms(STIFF, False, LEARNED) < made.rms(STIFF, False, ALONE) / 10
    ((one,), (loaded,)) = (made.runs(STIFF, x, LEARNED) for x in (False, True))
    assert set(one.stages) == {"swing", "lift"}
    assert np.linalg.norm(loaded.stages["lift"]) > 10 * np.linalg.norm(one.stages["lift"])
    with pytest.raises(UsageError, match="velocity_cutoff=250; allowed: above 0 and below 250 Hz"):
        run(source, Exact(), Batch(), arm, Sweep(velocity_cutoff=250))


class Noting:
    """Stands for what adapts: keeps the pairs that it is given."""

    def __init__(self) -> None:
        self.pairs: list[tuple[float, float]] = []

    def init(self, q, tau):
        return None

    def step(self, state, q, tau, desired):
        self.pairs.append((float(q[0]), float(tau[0])))
        return state, tau


@pytest.mark.parametrize(("lag", "pairs"), [(0, (2, 2)), (1, (3, 2)), (2, (3, 1))])
def test_torques_lag_as_in_the_log(lag, pairs):
    """Angles are learned with the torque that `data.torque_lag` pairs them with, never with one to come."""
    noting, zero = Noting(), np.zeros((1, 1))
    learner = Learner(noting, Motion(zero, zero, zero), lag)  # type: ignore[arg-type]
    q, tau = (np.arange(5.0)[:, None] for _ in range(2))
    for k in range(1, 4):  # at tick k angles 0 to k are known, and torques 0 to k - 1
        learner.torque(0, q[: k + 1], tau[:k])
    assert noting.pairs[-1] == pairs


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"gains": ()}, "gains=[]"),
        ({"gains": (10.0, -1.0)}, "above 0"),
        ({"gains": (10.0, 10.0)}, "each gain once"),
        ({"damping_time": -0.1}, "damping_time=-0.1"),
        ({"velocity_cutoff": 0.0}, "above 0 Hz"),
        ({"settle": float("nan")}, "settle=nan"),
        ({"largest_error": 0.0}, "largest_error=0.0"),
        ({"repetitions": 0}, "repetitions=0"),
    ],
)
def test_numbers_out_of_range_are_refused(options, word):
    """Each option out of range is named with what is allowed."""
    with pytest.raises(UsageError, match="allowed") as error:
        Sweep(**options)
    assert word in str(error.value)


def test_what_cannot_be_controlled_is_refused(arm, source):
    """Thinned samples and sliding joints are refused before anything is simulated."""
    with pytest.raises(UsageError, match=r"data\.decimate=2"):
        run(replace(source, decimate=2), Exact(), Batch(), arm, Sweep())
    with pytest.raises(UsageError, match="prismatic"):
        run(source, Exact(), Batch(), replace(arm, prismatic=(True, False)), Sweep())
