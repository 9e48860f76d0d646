"""The gear beside which the standard model is fitted at first, on a simulated arm that shares no code with it."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from experiments.arms import random_robot
from experiments.cases import scene_of
from experiments.worn import sized, substeps_for
from experiments.worn import wear as drawn_wear
from invdyn_cli.diagnosis.case import Case, Options, prepared
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.simulation.plant import record
from invdyn_cli.simulation.references import Multisine
from invdyn_cli.simulation.sensors import Noise

TEETH = 2e4
"""[N m/rad] that few steps of the physics resolve."""


def worn(seed: int, bits: int, gap: float = 0.0, share: float = 0.0, spring: bool = False) -> tuple[Case, Hidden]:
    """The case of a worn arm of three joints, and what was hidden last: this play in one of them, if it is above zero,
    or a `spring`, with a `share` of the joint's friction on the link."""
    draw = np.random.default_rng(seed)
    robot = random_robot(draw, 3)
    scene = scene_of(robot, Multisine(), 25.0, seed)
    hidden = drawn_wear(draw, scene)
    if gap or spring:
        one = sized(draw, scene, "joint_elasticity" if spring else "backlash")
        soft = {} if spring else {"gap": gap, "stiffness": TEETH, "damping_ratio": 0.3}
        rubs = {x.effect: x for x in hidden if x.joint == one.joint}
        for effect, size in (("coulomb_friction", "coulomb"), ("viscous_friction", "damping")):
            whole = rubs[effect].parameters[size]
            hidden[hidden.index(rubs[effect])] = replace(rubs[effect], parameters={size: (1 - share) * whole})
            soft[f"link_{size}"] = share * whole
        hidden.append(replace(one, parameters={**one.parameters, **soft}))
    noise = Noise(position=1e-6, position_quantum=2 * np.pi / 2**bits, torque=tuple(0.005 * scene.torque))
    steps = max([4, *(substeps_for(x, 500.0) for x in hidden)])
    how: dict[str, Any] = {"duration": 25.0, "rate": 500.0, "seed": seed, "position_side": "motor", "substeps": steps}
    case = prepared(record(robot, [scene.reference], hidden, noise=noise, **how), robot, None, None, Options(), EFFECTS)
    assert isinstance(case, Case)
    return case, hidden[-1]


def is_sized(case: Case, gap: float) -> bool:
    """Whether play is found within 30 % of what it is, or of that and what the teeth yield at the largest load."""
    assert case.gear is not None
    most = gap + 2 * np.abs(case.evidence.tau[:, case.gear.joint]).max() / TEETH
    return bool(0.7 * gap < case.gear.parameters["gap"] < 1.3 * most)


@pytest.mark.benchmark  # play behind which the link rubs, below, is harder to see
def test_play_is_seen_before_links_make_up_for_it():
    """Play of 3 to 22 mrad beside link errors of up to 8 %, on three arms: at least two (a load that hardly changes its
    sign shows none) with its joint and its size; no other gear."""
    seen = 0
    for seed in range(3):
        gap = float(np.exp(np.random.default_rng([seed, 1]).uniform(*np.log((0.003, 0.022)))))
        case, play = worn(seed, 18, gap)
        if case.gear is not None:
            number = case.robot.joints.index(str(play.joint))
            assert case.gear.key == ("backlash", number)
            assert is_sized(case, gap)
            seen += 1
    assert seen >= 2


def test_play_is_seen_behind_which_the_link_rubs():
    """A share of the friction of 15 to 70 %, drawn at random, acts on the link, and shifts the moments at which play is
    crossed. Of 4 to 15 mrad on three arms all are found on their joint, with friction of the link within a factor of
    2.5 (shares are tried a factor of three apart), and at least two with their size."""
    sized = 0
    for seed in range(3):
        draw = np.random.default_rng([seed, 8])
        gap, share = float(np.exp(draw.uniform(*np.log((0.004, 0.015))))), float(draw.uniform(0.15, 0.7))
        case, play = worn(seed, 18, gap, share)
        assert case.gear is not None and case.gear.key == ("backlash", case.robot.joints.index(str(play.joint)))
        for name in ("link_coulomb", "link_damping"):
            assert play.parameters[name] / 2.5 < case.gear.parameters[name] < 2.5 * play.parameters[name]
        sized += is_sized(case, gap)
    assert sized >= 2


@pytest.mark.benchmark  # play behind which the link rubs, above, is harder to see
def test_a_spring_is_seen_behind_which_the_link_rubs():
    """So is a spring, with half to all of the friction on the link: on three arms, with its joint and, on at least two,
    its stiffness within 15 %."""
    sized = 0
    for seed in range(3):
        share = float(np.random.default_rng([seed, 9]).uniform(0.5, 1.0))
        case, spring = worn(seed, 18, share=share, spring=True)
        assert case.gear is not None
        assert case.gear.key == ("joint_elasticity", case.robot.joints.index(str(spring.joint)))
        sized += abs(case.gear.parameters["stiffness"] / spring.parameters["stiffness"] - 1) < 0.15
    assert sized >= 2


@pytest.mark.parametrize(("bits", "seed"), [(13, 0), pytest.param(16, 1, marks=pytest.mark.benchmark)])
def test_none_where_no_gear_yields(bits, seed):
    """Coarse encoders make torque that goes with the acceleration, as a soft gear does."""
    assert worn(seed, bits)[0].gear is None
