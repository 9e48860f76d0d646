"""The library of causes says all that a search, a report and a reader need."""

import re

import numpy as np
import pytest

from invdyn_cli.effects.catalogue import EFFECTS, may_be_ambiguous
from invdyn_cli.interfaces import (
    AbstractBodyEffect,
    AbstractChannelEffect,
    AbstractForceEffect,
    AbstractGearEffect,
    AbstractMotionEffect,
    AbstractTorqueEffect,
)
from tests.commands import ROOT
from tests.effects.drawn import parameters

UNITS = re.compile(r"-|(?:1/rev|N|N m|N m/s|rad|kg|m|s|kg m²?|N m/rad|N m s/rad|N m s²/rad²|rad/s)")
"""Every effect of the catalogue (docs/effects.md)."""

NAMES = {
    "viscous_friction": {"damping"},
    "coulomb_friction": {"coulomb"},
    "asymmetric_coulomb_friction": {"positive", "negative"},
    "stribeck_friction": {"coulomb", "static", "velocity", "exponent"},
    "load_dependent_friction": {"mu"},
    "quadratic_friction": {"drag"},
    "presliding_hysteresis": {"coulomb", "stiffness"},
    "coupled_friction": {"coulomb", "damping", "armature", "ratio"},
    "torque_offset_drift": {"rate"},
    "backlash": {"gap", "link_coulomb", "link_damping"},
    "joint_elasticity": {"stiffness", "damping_ratio", "link_coulomb", "link_damping"},
    "thermal_friction_drift": {"cold", "warm", "time_constant"},
    "torque_ripple": {"amplitude", "cycles", "phase"},
    "joint_spring": {"stiffness", "rest"},
    "rotor_inertia": {"armature"},
    "torque_gain_error": {"gain"},
    "torque_gain_change": {"gain"},
    "torque_offset": {"offset"},
    "torque_delay": {"delay"},
    "actuator_lag": {"time_constant"},
    "torque_saturation": {"limit"},
    "payload": {"mass", "com"},
    "payload_change": {"mass", "com"},
    "external_contact": {"force", "point"},
    "base_tilt": {"angle", "azimuth"},
    "encoder_offset": {"offset"},
    "link_inertia_error": {"mass"},
}
"""Parameters that every effect has; bodies have more, for what else of them shows."""


def test_names_are_those_of_the_design():
    """Every effect has its fixed name and its parameters' fixed names; a body may add its inertia."""
    assert set(EFFECTS) == set(NAMES)
    for name, effect in EFFECTS.items():
        assert effect.name == name
        assert NAMES[name] <= set(effect.parameters)
        assert NAMES[name] == set(effect.parameters) or effect.point == "body"


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_says_what_it_is(name):
    """A title, an equation that holds its parameters, a reference with a year, where it acts, where it shows, how it is
    drawn, whether it passes, advice, and units with bounds that leave room."""
    effect = EFFECTS[name]
    assert effect.title and effect.equation and effect.advice and effect.meaning.endswith(".")
    assert re.search(r"(19|20)\d\d", effect.reference) or "first" in effect.reference or "sheets" in effect.reference
    kinds = {
        "torque": AbstractTorqueEffect,
        "channel": AbstractChannelEffect,
        "body": AbstractBodyEffect,
        "motion": AbstractMotionEffect,
        "gear": AbstractGearEffect,
        "force": AbstractForceEffect,
    }
    assert [point for point, kind in kinds.items() if isinstance(effect, kind)] == [effect.point]
    assert set(effect.sides) <= {"link", "motor", "command", "unknown"} and "unknown" in effect.sides
    assert set(effect.position_sides) <= {"link", "motor", "unknown"} and "unknown" in effect.position_sides
    assert effect.passing == ("for a time" in effect.equation)
    for parameter, bound in effect.parameters.items():
        assert UNITS.fullmatch(bound.unit), bound.unit
        assert bound.lower < bound.upper
        if effect.point != "body":
            assert parameter in effect.equation


@pytest.mark.parametrize("name", EFFECTS)
def test_bounds_refuse_what_is_no_physics(name):
    """Ordinary values pass; a value a step outside of a bound is refused with a word that names it."""
    effect = EFFECTS[name]
    usual = parameters(name, np.random.default_rng(0))
    assert effect.refuse(usual) == ""
    for parameter, bound in effect.parameters.items():
        for end, step in ((bound.lower, -0.01), (bound.upper, 0.01)):
            if np.isfinite(end):
                why = effect.refuse({**usual, parameter: end + step})
                assert parameter in why or "friction would rise" in why


def test_what_rises_is_refused():
    """A static level below Coulomb's, and friction that grows as the gear warms up, are told as such."""
    assert "rise" in EFFECTS["stribeck_friction"].refuse({"coulomb": 2.0, "static": 1.0, "velocity": 0.1})
    assert "rise" in EFFECTS["thermal_friction_drift"].refuse({"cold": 1.0, "warm": 2.0, "time_constant": 9.0})


def test_a_static_level_far_above_coulombs_is_refused():
    """Gears stick at 1.1 to 1.6 times their Coulomb friction (Armstrong et al. 1994); five times is none, and a level
    that a slow log leaves open is no reason."""
    effect, fall = EFFECTS["stribeck_friction"], {"velocity": 0.02, "exponent": 2.0}
    assert "5 times Coulomb's" in effect.refuse({"coulomb": 2.0, "static": 10.0, **fall})
    assert effect.refuse({"coulomb": 2.0, "static": 5.0, **fall}) == ""
    assert effect.refuse({"coulomb": 0.0, "static": 5.0, **fall}) == ""


@pytest.mark.parametrize("name", EFFECTS)
def test_confounders_exist(name):
    """What may stand for an effect, and what it contains, is in the catalogue, is not the effect itself, is said once,
    and shows on a side on which the effect shows."""
    effect = EFFECTS[name]
    assert len(set(effect.confounders)) == len(effect.confounders)
    for one in effect.confounders:
        assert one and set(one) <= set(EFFECTS)
        assert one != (name,) or name in ("link_inertia_error", "external_contact")  # of another link
        assert all(set(EFFECTS[other].sides) & set(effect.sides) for other in one)
    assert set(effect.contains) <= set(EFFECTS) - {name}


def test_special_cases_are_confounders():
    """A general case and its special case may always stand for each other, and only one contains the other."""
    for name, effect in EFFECTS.items():
        for special in effect.contains:
            assert may_be_ambiguous(name, (special,)) and may_be_ambiguous(special, (name,))
            assert name not in EFFECTS[special].contains


def test_ambiguity_holds_both_ways():
    """If theory lets one effect stand for another, it lets the other stand for the one; what it does not list, not."""
    for name in EFFECTS:
        for other in EFFECTS:
            assert may_be_ambiguous(name, (other,)) == may_be_ambiguous(other, (name,))
    assert may_be_ambiguous("asymmetric_coulomb_friction", ("coulomb_friction", "torque_offset"))
    assert not may_be_ambiguous("coulomb_friction", ("payload",))
    assert not may_be_ambiguous("torque_ripple", ("viscous_friction",))


def test_the_docs_list_every_effect():
    """docs/effects.md names every effect, and how many there are; `invdyn effects NAME` tells the rest."""
    page = (ROOT / "docs" / "effects.md").read_text()
    assert f"for {len(EFFECTS)} physical effects" in page
    assert [name for name in EFFECTS if f"`{name}`" not in page] == []
