"""One link of a worn arm whose mass is off by half is told; where all links are some percent off, none is."""

import numpy as np
import pytest

from experiments.arms import random_robot
from experiments.cases import scene_of
from experiments.worn import wear
from invdyn_cli.diagnosis import Options, diagnose
from invdyn_cli.maths import standard
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.simulation.plant import record
from invdyn_cli.simulation.references import Multisine
from invdyn_cli.simulation.sensors import Noise


@pytest.mark.parametrize("seed", [4, *(pytest.param(x, marks=pytest.mark.benchmark) for x in (2, 5))])
def test_a_link_that_is_off_by_half_is_named(seed):
    """Friction on all joints and links up to 8 % off; one link has 40 to 60 % more or less mass: it is named, its mass
    lies in the interval, and of the same arm without it no link is told."""
    draw = np.random.default_rng([seed, 62])
    joints = int(draw.integers(3, 6))
    robot = random_robot(draw, joints)
    scene = scene_of(robot, Multisine(), 25.0, seed)
    worn = wear(draw, scene)
    link, off = int(draw.integers(1, joints - 1)), float(draw.choice([-1, 1]) * draw.uniform(0.4, 0.6))
    name, mass = robot.joints[link], float(robot.inertial[link, 0])
    hidden = Hidden("link_inertia_error", name, {"mass": off * mass, "inertia": off})
    (worn_by,) = (x.parameters["mass"] for x in worn if (x.effect, x.joint) == ("link_inertia_error", name))
    options = {"duration": 25.0, "rate": 250.0, "seed": seed, "position_side": "motor"}
    options["noise"] = Noise(position=1e-6, torque=tuple(0.01 * scene.torque))
    told = []
    for effects in (worn, [*worn, hidden]):
        found = diagnose(record(robot, [scene.reference], effects, **options), robot, options=Options(replay=False))
        told.append([f for f in found.findings if f.effect == "link_inertia_error" and f.status == "named"])
    assert not told[0]
    (one,) = told[1]
    low, high = one.parameters["mass"].interval95
    assert one.joint == name and low <= off * mass + worn_by <= high


def test_one_coefficient_more_moves_the_others():
    """Its Gram matrices are those of the table with the combined column, and its prior is as given."""
    draw = np.random.default_rng(0)
    table, together = draw.normal(size=(50, 5)), draw.normal(size=4)
    prior = standard.Prior(np.ones(4), np.array([True, True, False, False]), np.zeros(4, bool), np.zeros(4))
    (more,), wider = standard.with_one_more(
        [standard.Sums((table.T @ table)[None], np.array([50.0]))], prior, together, 0.5
    )
    whole = np.column_stack([table[:, :4], table[:, :4] @ together, table[:, 4]])
    np.testing.assert_allclose(more.grams[0], whole.T @ whole, rtol=1e-12, atol=1e-12)
    assert wider.scale[-1] == 0.5 and not wider.inertial[-1] and len(wider.least) == 5
