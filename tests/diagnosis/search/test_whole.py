"""The search as a whole: what it does with trials that cannot be."""

import numpy as np

from invdyn_cli.diagnosis.search.whole import inquire
from invdyn_cli.effects.catalogue import EFFECTS
from tests.diagnosis.analytic import FRICTIONS, evidence_of, log_of, moved, on, raw


def test_another_kind_of_a_drop_may_be_likely():
    """Friction that falls by 13 % of its level as exp(-|qd|/v) looks, as exp(-(qd/v)^2), like one that falls by less
    than a tenth, as no gear's does; it is found as Stribeck friction of the first kind, and not as quadratic."""
    torque = on(1, lambda t, q, qd, qdd: (1 + 0.13 * np.exp(-np.abs(qd) / 0.2)) * np.sign(qd) + 0.3 * qd)
    evidence = evidence_of(log_of(raw(*moved(30.0), torque, torque=0.005, position=1e-6)), FRICTIONS)
    inquiry = inquire(evidence, {name: EFFECTS[name] for name in FRICTIONS}, (), 4, compares=False)
    found = {a.key: a.parameters for a in inquiry.whole.acting}
    assert found[("stribeck_friction", 1)]["exponent"] == 1.0 and ("quadratic_friction", 1) not in found
