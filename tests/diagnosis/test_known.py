"""What is declared is read, or refused in one line; what is allowed for is part of every hypothesis once."""

import numpy as np
import pytest

from invdyn_cli.diagnosis.known import allowed_for, read
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.errors import UsageError
from tests.diagnosis.analytic import arm, evidence_of, log_of, moved, raw

JOINT = arm().joints[1]


def test_declared_with_a_size_or_allowed_for():
    """A size makes a fact, on its joint; a name alone is allowed for; asymmetric friction is Coulomb and offset."""
    friction = {"effect": "coulomb_friction", "joint": JOINT, "coulomb": 2}
    facts, allowed = read([friction, f"viscous_friction@{JOINT}", "asymmetric_coulomb_friction"], EFFECTS, arm())
    assert [(a.effect.name, a.joint, a.parameters) for a in facts] == [("coulomb_friction", 1, {"coulomb": 2.0})]
    assert allowed == [("viscous_friction", 1), ("coulomb_friction", None), ("torque_offset", None)]


WRONG = {
    "a word for a number": ({"effect": "coulomb_friction", "joint": JOINT, "coulomb": "much"}, "allowed: a number"),
    "two of three numbers": ({"effect": "payload", "mass": 1.0, "com": [0.0, 0.1]}, "allowed: 3 numbers"),
    "an infinite one": ({"effect": "coulomb_friction", "joint": JOINT, "coulomb": np.inf}, "allowed: a number"),
    "a joint of the whole arm": (f"base_tilt@{JOINT}", "acts on the whole arm"),
    "no joint": ({"effect": "coulomb_friction", "coulomb": 1.0}, "needs a joint"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_cannot_be_is_refused(name):
    """One line says what was got and what is allowed."""
    declared, words = WRONG[name]
    with pytest.raises(UsageError, match=words):
        read([declared], EFFECTS, arm())


def test_a_channel_is_allowed_for_once_and_does_nothing_by_itself():
    """Of the many trials of a delay one stays, without its fixed column: a delay of all trials together is none."""
    evidence = evidence_of(log_of(raw(*moved())), ["torque_delay", "viscous_friction"], cutoffs=(10.0,))
    made = allowed_for(evidence.candidates, [("torque_delay", 1), ("viscous_friction", None)])
    assert [c.key for c in made if c.effect.name == "torque_delay"] == [("torque_delay", 1)]
    assert len(made) == 1 + arm().dofs
    assert all(fixed == () for c in made for fixed, _ in c.columns.values())
