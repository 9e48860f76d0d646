"""What a finding is worth."""

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from invdyn_cli.diagnosis.decide.findings import _special_cases, overlapping, perhaps_stribeck
from invdyn_cli.diagnosis.decide.gain import gain_of
from invdyn_cli.diagnosis.search.inquiry import Inquiry
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.composition import EffectInstance
from invdyn_cli.types import Finding, Gain
from tests.diagnosis.analytic import candidate, evidence_of, judged, log_of, moved, raw


def test_rest_is_no_gain_and_no_loss():
    """Residuals of 2 and 1 N m while a joint moves: its gain is that, whatever they are while it rests."""
    evidence = evidence_of(log_of(raw(*moved(20.0), torque=0.02, position=1e-5)), ())
    resting = np.arange(len(evidence.role)) % 3 == 0
    evidence = replace(evidence, valid=evidence.valid & ~resting[:, None])
    before, after = (np.where(evidence.valid, x, y) for x, y in ((2.0, 5.0), (1.0, 50.0)))
    gain = gain_of(evidence, 0, before, after)
    assert gain is not None and (gain.rmse_before, gain.rmse_after) == pytest.approx((2.0, 1.0))


@pytest.mark.parametrize(("lowest", "others"), [(0.03, []), (0.001, ["coulomb_friction"])])
def test_stribeck_friction_that_may_be_coulombs(lowest, others):
    """A Stribeck velocity whose interval reaches speeds at which the joint sticks (5 ms of its acceleration, here about
    5 mm/s) does not exclude Coulomb friction."""
    evidence = evidence_of(log_of(raw(*moved(20.0), torque=0.02, position=1e-5)), ())
    one = EffectInstance(EFFECTS["stribeck_friction"], 0, {"coulomb": 1.0, "static": 1.5, "velocity": 0.05})
    ends = {"coulomb": (1.0, 0.9, 1.1), "static": (1.5, 1.4, 1.6), "velocity": (0.05, lowest, 0.1)}
    assert _special_cases(evidence, EFFECTS, one, ends) == others


@pytest.mark.parametrize(
    ("speed", "found", "status"),
    [(1.0, (), "named"), (6.0, (), "ambiguous"), (1.0, ("stribeck_friction",), "ambiguous")],
)
def test_a_standard_term_that_may_be_stribecks(speed, found, status):
    """The Coulomb friction of a worn arm is told with Stribeck friction where the motion crosses low speeds in no time,
    or where that was found and is not claimed; its viscous friction is named."""
    evidence, judge = judged(lambda t, q, qd, qdd: np.sign(qd) + qd, speed=speed, torque=0.3)
    usual = tuple(candidate(evidence, name, 1) for name in ("coulomb_friction", "viscous_friction"))
    hypothesis = tuple(candidate(evidence, name, 1) for name in found)
    kept = {"wear": usual, "always": usual, "pool": evidence.candidates, "hypothesis": hypothesis}
    inquiry = SimpleNamespace(evidence=evidence, judge=judge, **kept)
    joint = evidence.robot.joints[1]
    told = [perhaps_stribeck(cast(Inquiry, inquiry), (), Finding(c.effect.name, joint, "named")) for c in usual]
    assert [f.status for f in told] == [status, "named"]
    assert told[0].alternatives == ((("stribeck_friction",),) if status == "ambiguous" else ())


@pytest.mark.parametrize(
    ("other", "open_ones"),
    [
        ({"window": (5.0, 8.0)}, True),
        ({"window": (9.5, 12.0)}, False),
        ({"window": (5.0, 8.0), "joint": "b"}, False),
        ({"window": (5.0, 8.0), "effect": "external_contact"}, False),
        ({"window": (5.0, 8.0), "trajectory": "two"}, False),
        ({"window": None}, False),
    ],
)
def test_two_of_one_kind_at_once_may_be_unknown(other, open_ones):
    """A gain that changes while it is changed already, on the same joint, is the shape of something else; one after the
    other, elsewhere, or of different kinds they may both be true."""
    one = Finding("torque_gain_change", "a", "named", window=(4.0, 9.0), trajectory="one")
    found = overlapping([one, replace(one, **other)])
    assert [f.status for f in found] == ["ambiguous" if open_ones else "named"] * 2
    assert all((("unknown",) in f.alternatives) == open_ones for f in found)


def test_what_comes_and_goes_beside_two_at_once_is_in_doubt():
    """Two contacts at once that one joint feels are the shape of something else, as of a torque at one posture; a gain
    of that joint that changes later may be the same. What another joint feels, or what lasts, may not."""
    felt = Gain(1.0, 0.5, 0.1, 0.03, (0.4, 0.6))
    pushed = Finding("external_contact", "b", "named", window=(4.0, 9.0), trajectory="one", gain={"a": felt})
    weaker = replace(pushed, effect="torque_gain_change", joint="a", window=(12.0, 13.0))
    others = [replace(weaker, joint="b", gain={"a": felt, "b": felt}), replace(weaker, window=None, trajectory=None)]
    found = overlapping([pushed, replace(pushed, window=(5.0, 8.0)), weaker, *others])
    assert [f.status for f in found] == ["ambiguous"] * 3 + ["named"] * 2
    assert [f.status for f in overlapping([pushed, weaker, *others])] == ["named"] * 4
