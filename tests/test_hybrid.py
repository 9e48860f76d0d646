"""model=hybrid: a base and a learner for what it leaves over."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from invdyn_cli import experiment
from invdyn_cli.data.sim import SineTasks
from invdyn_cli.hybrid import Hybrid
from invdyn_cli.models.ffnn import Ffnn
from invdyn_cli.models.gru import Gru
from invdyn_cli.models.pest import Pest
from invdyn_cli.models.rff import Rff


@pytest.fixture(scope="module")
def data(apollo4):
    """Short sine tasks whose torque has, beside the rigid body, something that no rigid body explains."""
    splits = SineTasks(duration=2.0).load(apollo4)

    def bent(dataset):
        moved = (replace(x, tau=x.tau + 3 * np.sin(3 * x.motion.q)) for x in dataset.trajectories)
        return replace(dataset, trajectories=tuple(moved))

    return bent(splits.train), bent(splits.tests["test"])


def test_the_learner_explains_what_the_base_cannot(data):
    """With a torque that no rigid body has, the hybrid's held-out error is well below the base's alone."""
    train, test = data
    key = jax.random.key(0)
    base, hybrid = Pest(), Hybrid(Pest(), Ffnn(epochs=15))
    errors = [
        experiment.score(test, experiment.predict(m, m.fit(train, key), test)).mean("rmse") for m in (base, hybrid)
    ]
    assert errors[1] < 0.5 * errors[0]


def test_members_are_those_of_the_learner(data):
    """Each seed of the learner is a member with the same base, and their mean is the hybrid's prediction."""
    train, test = data
    model = Hybrid(Pest(), Ffnn(epochs=1, seeds=3))
    fit = model.fit(train, jax.random.key(0))
    motion = test.trajectories[0].motion
    members = [model.predict(member, motion) for member in model.members(fit)]
    assert len(members) == 3 and not np.allclose(members[0], members[1])
    np.testing.assert_allclose(
        np.mean(members, axis=0), model.predict(fit, motion), rtol=1e-5, atol=1e-5
    )  # float32 nets


def test_it_needs_a_robot_if_a_part_does():
    """Two nets run without a URDF; with PEST inside, the hybrid does not."""
    assert Hybrid(Pest(), Ffnn()).needs_robot and not Hybrid(Ffnn(), Ffnn()).needs_robot


def test_what_it_takes_over_from_its_parts():
    """Its linear parameters are the base's, and a memory in either part is its own."""
    net = Ffnn()
    assert Hybrid(Rff(), net).by_joint and not Hybrid(Pest(), Rff()).by_joint
    assert Hybrid(Pest(), Gru()).has_memory and not Hybrid(Pest(), net).has_memory
