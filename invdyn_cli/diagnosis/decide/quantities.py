"""Parameters of an effect as a finding tells them: values, intervals and units."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from invdyn_cli.effects.composition import EffectInstance
from invdyn_cli.effects.description import driver_name
from invdyn_cli.interfaces import AbstractEffect
from invdyn_cli.types import Quantity, Robot

SLIDING = {
    "N m": "N",
    "N m/rad": "N/m",
    "N m s/rad": "N s/m",
    "N m s²/rad²": "N s²/m²",
    "kg m²": "kg",
    "rad": "m",
    "rad/s": "m/s",
    "1/rev": "rad/m",
}
"""Units at a joint that turns, and at one that slides."""


def quantities(
    robot: Robot, effect: AbstractEffect, joint: int | None, ends: Mapping[str, tuple]
) -> dict[str, Quantity]:
    """Of {parameter: (value, lower, upper)} those that the effect has."""
    slides = not effect.changes_inertials and joint is not None and robot.prismatic[joint]
    return {
        name: Quantity(plain(value), unit_of(effect, name, slides), [plain(low), plain(high)])
        for name, (value, low, high) in ends.items()
        if name in effect.parameters
    }


def tried(robot: Robot, acting: EffectInstance) -> dict[str, Quantity]:
    """What a search chose and nothing refined: parameters that are one of a few values, and the joint that drives the
    gear of a coupled effect, by its name."""
    units = {name: acting.effect.parameters[name].unit for name in acting.effect.chosen if name in acting.parameters}
    chosen = {name: Quantity(plain(acting.parameters[name]), unit) for name, unit in units.items()}
    return chosen | {name: Quantity(joint, "") for name, joint in driver_name(acting, robot).items()}


def unit_of(effect: AbstractEffect, name: str, slides: bool) -> str:
    """The unit of a parameter at a joint that turns, or slides."""
    unit = effect.parameters[name].unit
    return SLIDING.get(unit, unit) if slides and name != "phase" else unit


def plain(value: Any) -> Any:
    """As JSON has it: a number or nested lists."""
    return np.asarray(value, float).tolist()
