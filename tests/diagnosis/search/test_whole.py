"""The search as a whole: what it does with trials that cannot be."""

import numpy as np
import pytest

from experiments.cases import inverse_dynamics
from invdyn_cli.diagnosis.search import whole
from invdyn_cli.diagnosis.search.inquiry import Question
from invdyn_cli.diagnosis.search.whole import inquire
from invdyn_cli.effects.catalogue import EFFECTS
from tests.diagnosis.analytic import FRICTIONS, arm, evidence_of, log_of, moved, on, raw


def test_another_kind_of_a_drop_may_be_likely():
    """Friction that falls by 13 % of its level as exp(-|qd|/v) looks, as exp(-(qd/v)^2), like one that falls by less
    than a tenth, as no gear's does; it is found as Stribeck friction of the first kind, and not as quadratic."""
    torque = on(1, lambda t, q, qd, qdd: (1 + 0.13 * np.exp(-np.abs(qd) / 0.2)) * np.sign(qd) + 0.3 * qd)
    evidence = evidence_of(log_of(raw(*moved(30.0), torque, torque=0.005, position=1e-6)), FRICTIONS)
    inquiry = inquire(evidence, Question({name: EFFECTS[name] for name in FRICTIONS}, 4))
    found = {a.key: a.parameters for a in inquiry.whole.acting}
    assert found[("stribeck_friction", 1)]["exponent"] == 1.0 and ("quadratic_friction", 1) not in found


@pytest.mark.parametrize(
    ("start", "end", "rubs"), [(12.3, 21.7, 1.0), (6.1, 30.0, 0.0)], ids=["rubs", "most of the log"]
)
def test_a_weak_drive_gives_less_of_its_friction_too(start, end, rubs):
    """A drive gives 0.8 of what is logged: for a time, where friction is several times what its links ask for; and for
    most of the log, where there is none, and what the drive lacks is not taken for friction."""
    names = ("coulomb_friction", "viscous_friction", "torque_gain_error")
    names += ("torque_gain_change", "payload_change", "external_contact")

    def weak(t, m):
        friction = np.zeros_like(m.q)
        friction[:, 1] = rubs * (60.0 * np.sign(m.qd[:, 1]) + 20.0 * m.qd[:, 1])
        whole = (friction + inverse_dynamics(arm(), m.q, m.qd, m.qdd)) * (np.arange(3) == 1)
        return friction + (1 / 0.8 - 1) * whole * ((t > start) & (t < end))[:, None]

    evidence = evidence_of(log_of(raw(*moved(30.0), weak, torque=0.05, position=1e-6)), names)
    inquiry = inquire(evidence, Question({name: EFFECTS[name] for name in names}, 6))
    (found,) = inquiry.whole.acting if not rubs else [a for a in inquiry.whole.acting if a.when is not None]
    assert (found.effect.name, found.joint) == ("torque_gain_change", 1)
    assert np.allclose([found.when.start, found.when.end], [start, end], atol=0.05)
    assert np.isclose(found.parameters["gain"], 0.8, atol=0.005)


@pytest.mark.parametrize(("most", "windows"), [(3, False), (9, True)], ids=["full", "not full"])
def test_a_full_search_asks_for_no_windows(monkeypatch, most, windows):
    """Friction of three joints, and a drive that is weak for a time. Where friction takes all places, windows are not
    searched again once a search has held none; where there are more places, the weak drive is found."""
    names = ("coulomb_friction", "torque_gain_change")
    offered = []

    def searched(evidence, *args):
        offered.append(any(c.when is not None for c in evidence.candidates))
        return original(evidence, *args)

    def torque(t, m):
        friction = 20.0 * np.sign(m.qd)
        lacks = 0.25 * (np.arange(3) == 1) * ((t > 12.3) & (t < 21.7))[:, None]
        return friction + lacks * (friction + inverse_dynamics(arm(), m.q, m.qd, m.qdd))

    original = whole._searched
    monkeypatch.setattr(whole, "_searched", searched)
    evidence = evidence_of(log_of(raw(*moved(30.0), torque, torque=0.01, position=1e-6)), names)
    inquiry = inquire(evidence, Question({name: EFFECTS[name] for name in names}, most))
    assert any(offered[1:]) == windows
    assert any(a.when is not None for a in inquiry.whole.acting) == windows
