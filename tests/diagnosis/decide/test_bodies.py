"""What is said of a body that was found, and what stays open."""

from dataclasses import replace

import numpy as np
import pytest

from invdyn_cli.diagnosis.decide import bodies
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.composition import EffectInstance, TimeWindow
from invdyn_cli.types import Finding, Quantity
from tests.diagnosis.analytic import arm


def found(effect: str, share: float) -> Finding:
    """What is said of a body of this share of the last link's mass."""
    mass = share * float(arm().inertial[-1, 0])
    quantities = {
        "mass": Quantity(mass, "kg", [mass, mass]),
        "com": Quantity([0.0] * 3, "m", None),
        "inertia": Quantity([0.0] * 6, "kg m²", None),
    }
    finding = Finding(effect, None, "named", parameters=quantities)
    return bodies.told(finding, EffectInstance(EFFECTS[effect], None, {}), arm(), {"mass": (mass, mass, mass)})


@pytest.mark.parametrize("effect", ["payload", "payload_change"])
def test_mass_and_centre_are_told(effect):
    """A body is told by its mass and its centre; what it has beyond a point is part of the extended model alone."""
    assert set(found(effect, 2.0).parameters) == {"mass", "com"} and not found(effect, 2.0).alternatives


def test_a_light_payload_may_be_the_link():
    """A lasting body that is light beside the last link may be an error of it; one that comes and goes is none."""
    assert found("payload", 0.1).alternatives == (("link_inertia_error",),)
    assert found("payload_change", 0.1).alternatives == ()


def test_no_body_is_a_wrong_link():
    """A payload of negative mass, or a metre and more away, is the last link's error with the same torque; one that
    comes and goes stays what it is."""
    heavier = {"mass": 1.0, "com": np.array([0.0, 0.0, 0.1]), "inertia": np.zeros(6)}
    body = EffectInstance(EFFECTS["payload"], None, heavier)
    assert bodies.as_link(arm(), body) is body
    for wrong in ({"mass": -1.0}, {"com": np.array([0.0, 0.0, 2.0])}):
        none = replace(body, parameters={**heavier, **wrong})
        link = bodies.as_link(arm(), none)
        assert (link.effect.name, link.joint) == ("link_inertia_error", arm().dofs - 1)
        changed = [a.effect.changed(a.parameters, arm(), a.joint).inertial for a in (none, link)]
        np.testing.assert_allclose(*changed, atol=1e-12)
        passing = replace(none, effect=EFFECTS["payload_change"], when=TimeWindow("run", 1.0, 2.0))
        assert bodies.as_link(arm(), passing) is passing


def test_a_body_may_be_taken_off():
    """Since a reference a payload of negative mass is one that was taken off."""
    taken = EffectInstance(EFFECTS["payload"], None, {"mass": -1.0, "com": np.array([0.0, 0.0, 0.1])})
    assert bodies.as_link(arm(), taken, compares=True) is taken
    assert not found("payload", -2.0).alternatives
    assert found("payload", -0.1).alternatives == (("link_inertia_error",),)
