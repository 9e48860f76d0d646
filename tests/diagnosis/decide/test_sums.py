"""Coulomb friction beside an offset is friction that differs by direction."""

import pytest

from invdyn_cli.diagnosis.decide import sums
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.types import Finding, Quantity


def term(effect: str, name: str, value: float, joint: str = "j1") -> Finding:
    """A standard term of a joint."""
    return Finding(effect, joint, "named", parameters={name: Quantity(value, "N m")}, group="standard")


@pytest.mark.parametrize(("positive", "negative"), [(10.0, 4.0), (4.0, 10.0), (3.0, 1.0)])
def test_levels_that_differ_plainly_are_told(positive, negative):
    """Friction of two levels is the mean level and an offset of half the difference: the offset is not named alone."""
    coulomb = term("coulomb_friction", "coulomb", (positive + negative) / 2)
    offset = term("torque_offset", "offset", (positive - negative) / 2)
    first, second = sums.uneven(EFFECTS, [coulomb, offset])
    assert first == coulomb
    assert second.status == "ambiguous" and second.alternatives == (("asymmetric_coulomb_friction",),)


@pytest.mark.parametrize(
    "terms",
    [
        [term("coulomb_friction", "coulomb", 5.0), term("torque_offset", "offset", 1.0)],  # 6 and 4
        [term("coulomb_friction", "coulomb", 1.0), term("torque_offset", "offset", 5.0)],  # would push in one direction
        [term("torque_offset", "offset", 5.0)],
        [term("coulomb_friction", "coulomb", 5.0, "j2"), term("torque_offset", "offset", 2.5)],
    ],
)
def test_an_ordinary_offset_stays_named(terms):
    """A small one beside friction, one that friction cannot be, and one without friction on its joint."""
    assert sums.uneven(EFFECTS, terms) == terms
