"""What a refinement ends at and nobody believes."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from invdyn_cli.diagnosis.search.composed import Model
from invdyn_cli.diagnosis.search.likely import unlikely
from invdyn_cli.diagnosis.search.noise import Noise
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.composition import EffectInstance, TimeWindow
from tests.diagnosis.analytic import evidence_of, log_of, moved, raw


@pytest.mark.parametrize(
    ("name", "parameters", "odd"),
    [
        ("torque_delay", {"delay": 0.05}, True),
        ("torque_delay", {"delay": 0.049}, False),
        ("actuator_lag", {"time_constant": -0.05}, True),
        ("torque_gain_error", {"gain": 0.4}, True),
        ("coulomb_friction", {"coulomb": 0.0}, False),  # it is none, and so small that it costs more than it saves
        ("stribeck_friction", {"coulomb": 1.0, "static": 1.6, "velocity": 0.1, "exponent": 2.0}, False),  # it was tried
    ],
)
def test_what_ends_at_its_bound_is_not_believed(name, parameters, odd):
    """A parameter that a refinement keeps at the end of what is possible would go beyond."""
    evidence = evidence_of(log_of(raw(*moved())), [name])
    refined = SimpleNamespace(acting=[EffectInstance(EFFECTS[name], 1, parameters)], labels=())
    noise = Noise(np.ones(3), np.ones(3), np.zeros((1, 3)))
    found = unlikely(evidence, Model(evidence), noise, cast(Any, refined))
    assert found == ({(name, 1)} if odd else set())


@pytest.mark.parametrize(("mass", "odd"), [(-0.1, True), (0.1, False)])
def test_a_body_that_came_has_a_mass(mass, odd):
    """Its columns may take up a force that it cannot make, with less than no mass on all rows together."""
    evidence = evidence_of(log_of(raw(*moved())), ["payload_change"])
    body = {"mass": mass, "com": np.array([0.0, 0.0, 0.1]), "inertia": np.zeros(6)}
    one = EffectInstance(EFFECTS["payload_change"], None, body, TimeWindow("run", 5.0, 15.0))
    noise = Noise(np.ones(3), np.ones(3), np.zeros((1, 3)))
    labels = [(0, "", k) for k in range(10)]
    theta = np.array(one.effect.coefficients(body, evidence.robot, None))
    refined = SimpleNamespace(acting=[one], labels=labels, theta=theta, unknown=np.eye(10), replicas=[])
    found = unlikely(evidence, Model(evidence), noise, cast(Any, refined))
    assert found == ({one.key} if odd else set())
