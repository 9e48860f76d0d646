"""Trials: a candidate at parameters that were found is those parameters and a correction."""

import numpy as np
import pytest

from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.interfaces import AbstractBodyEffect
from invdyn_cli.robots import load_urdf

BODIES = [name for name, effect in EFFECTS.items() if isinstance(effect, AbstractBodyEffect)]


@pytest.mark.parametrize("name", BODIES)
def test_a_body_that_was_tried_is_there_beside_its_correction(name):
    """Without a correction a trial's parameters are those that were tried; with one, those of both columns together."""
    robot, effect = load_urdf("apollo_arm"), EFFECTS[name]
    joint = 3 if effect.of_joint else None
    count = len(effect.directions(robot, joint))
    scale = np.array([move[-1] for move in effect.directions(robot, joint)])
    draw = np.random.default_rng(0)
    first, more = 0.05 * scale * draw.normal(size=(2, count))
    tried = effect.read(first, robot, joint)
    for correction, whole in ((0 * more, first), (more, first + more)):
        found, expected = effect.found(correction, tried, robot, joint), effect.read(whole, robot, joint)
        assert all(np.allclose(found[key], expected[key], rtol=1e-9, atol=1e-12) for key in expected)
