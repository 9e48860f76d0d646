"""What the search found and nobody claims is in the written model if held-out data are predicted better with it."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.arms import random_robot
from invdyn_cli.diagnosis.case import Options, prepared
from invdyn_cli.diagnosis.decide import findings
from invdyn_cli.diagnosis.decide.refusals import REFUSALS, Refusal
from invdyn_cli.diagnosis.decide.unclaimed import together, unclaimed
from invdyn_cli.diagnosis.pipeline import decided, searched
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.simulation.plant import record
from invdyn_cli.simulation.references import Multisine
from invdyn_cli.simulation.sensors import Noise

NOBODY = (Refusal("nothing", lambda _: 0.0, 1.0),)
"""A table that refuses every claim."""


@pytest.fixture(scope="module")
def robot():
    """A three-joint arm."""
    return random_robot(np.random.default_rng(4), 3)


@pytest.fixture(scope="module")
def load():
    """A payload, its mass drawn at random."""
    return Hidden("payload", None, {"mass": float(np.random.default_rng(5).uniform(0.5, 1.0)), "com": [0.02, 0.0, 0.1]})


def recorded(robot, *trajectories):
    """A log with a recording for every list of hidden effects."""
    noise, references = Noise(position=1e-6, torque=0.02), [Multisine(base=0.1), Multisine(base=0.13)]
    logs = [
        record(robot, [references[i]], hidden, noise=noise, duration=14.0, seed=i)
        for i, hidden in enumerate(trajectories)
    ]
    named = [replace(x.trajectories[0], name=f"run_{i}") for i, x in enumerate(logs)]
    return replace(logs[0], trajectories=tuple(named))


def diagnosed(log, robot, tables, windows=None):
    """The diagnoses of a log that is searched once, with each of these tables of refusals."""
    case = prepared(log, robot, windows, None, Options(replay=False), EFFECTS)
    inquiry, columns = searched(case)
    return [decided(case, inquiry, columns, Options(replay=False), refusals=x) for x in tables]


def rmse(diagnosis):
    """(n,) held-out errors of the written model [N m]."""
    return np.array([x["rmse"] for x in diagnosis.extended.values()])


def test_a_refused_spring_stays_in_the_model(robot):
    """Whether it is claimed or refused, the model has the spring, its stiffness within 5 % (the noise is a permille of
    the torque), and predicts as well: no standard term is like it."""
    spring = {"stiffness": float(np.random.default_rng(5).uniform(3.0, 6.0)), "rest": 0.2}
    log = recorded(robot, [Hidden("joint_spring", robot.joints[1], spring)])
    with_name, without = diagnosed(log, robot, [REFUSALS, NOBODY])
    assert "joint_spring" in {f.effect for f in with_name.findings if f.status in ("named", "ambiguous")}
    assert not any(f.status in ("named", "ambiguous") for f in without.findings)
    found = {f.effect: f for f in without.unclaimed}
    assert found["joint_spring"].status == "unclaimed"
    assert found["joint_spring"].parameters["stiffness"].value == pytest.approx(spring["stiffness"], rel=0.05)
    assert "joint_spring" in {one.effect.name for one in without.model.acting}
    np.testing.assert_allclose(rmse(without), rmse(with_name), rtol=0.1)


@pytest.mark.benchmark  # a refused spring stays, too
def test_bristles_of_which_coulomb_friction_is_claimed_stay_in_the_model(robot):
    """Where only the special case may be claimed, the written model may still have the general one, in its place: it
    leaves less than half, and Coulomb friction is not beside it."""
    draw = np.random.default_rng(7)
    level = float(draw.uniform(1.0, 2.0))
    bristles = {"coulomb": level, "stiffness": level / float(draw.uniform(0.02, 0.04))}
    log = recorded(robot, [Hidden("presliding_hysteresis", robot.joints[1], bristles)])
    case = prepared(log, robot, None, None, Options(replay=False), EFFECTS)
    inquiry, _ = searched(case)
    coulomb = next(c for c in inquiry.pool if c.key == ("coulomb_friction", 1))
    made = findings.report(replace(inquiry, hypothesis=(coulomb,)), EFFECTS, case.examination, log.torque_side)
    more = unclaimed(inquiry, made)
    fuller, told = together(inquiry, made, more)
    assert [(f.effect, f.evidence["in_place_of"]) for f in told] == [("presliding_hysteresis", ("coulomb_friction",))]
    assert [one.effect.name for one in fuller.acting] == ["presliding_hysteresis"]
    assert np.std(fuller.residual[:, 1]) < 0.5 * np.std(made.residual[:, 1])


def test_what_misleads_is_left_out(robot, load):
    """A payload of the recording that chooses, which the one that judges lacks, is not in the model."""
    log = recorded(robot, [load], [])
    windows = {"train": [("run_0", 0.0, np.inf)], "test": [("run_1", 0.0, np.inf)]}
    (diagnosis,) = diagnosed(log, robot, [NOBODY], windows)
    assert diagnosis.unclaimed == ()
    assert "payload" not in {one.effect.name for one in diagnosis.model.acting}
    usual = np.array([x["rmse"] for x in diagnosis.baselines["standard"].values()])
    assert np.mean(np.log(rmse(diagnosis))) <= np.mean(np.log(usual)) + 1e-9
