"""What a finding is worth."""

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from invdyn_cli.diagnosis.columns.evidence import held_out
from invdyn_cli.diagnosis.columns.gears import inertia_on
from invdyn_cli.diagnosis.decide.findings import Made, _moves_others_more, _special_cases, joined, perhaps_stribeck
from invdyn_cli.diagnosis.decide.gain import gain_of
from invdyn_cli.diagnosis.search.inquiry import Inquiry
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.composition import EffectInstance
from invdyn_cli.recording.pieces import ROLES
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


def test_anomalies_stand_before_standard_terms():
    """An anomaly that is claimed later stands behind those that are there, and before friction; each keeps what it adds
    to the torque, and what the log cannot show stays last."""
    ripple, friction = Finding("torque_ripple", "a", "named"), Finding("viscous_friction", "a", "named")
    friction, unseen = replace(friction, group="standard"), Finding("payload", None, "not_excited")
    play = Finding("backlash", "b", "ambiguous")
    one, two, three = np.eye(3)
    none = np.zeros(3)
    made = Made((ripple, friction, unseen), (), (), (), (one, two), none, none, none, none, (), ())
    found = joined(made, [play], [three])
    assert found.findings == (ripple, play, friction, unseen)
    np.testing.assert_array_equal(found.terms, (one, three, two))


@pytest.mark.parametrize("joint", range(3))
def test_a_gear_moves_its_own_joint_most(joint):
    """A link that swings against its motor puts on another joint at most the torque that both inertias allow, here 0.3
    of it; what gains these is a gear of that joint alone."""
    evidence = evidence_of(log_of(raw(*moved(20.0), torque=0.02, position=1e-5)), ())
    inertia = [inertia_on(evidence, j) for j in range(3)]
    swing = [np.sqrt(inertia[joint] * inertia[k]) * (1.0 if k == joint else 0.3) for k in range(3)]
    names = evidence.robot.joints
    gains = {
        names[k]: Gain(float(np.hypot(x, 1e-3 * x)), 1e-3 * float(x), 1.0, 0.0, (0, 1)) for k, x in enumerate(swing)
    }
    most = {"rms_of_term_N_m": {names[k]: float(np.sqrt(inertia[joint] * inertia[k])) for k in range(3)}}
    told = [_moves_others_more(evidence, Finding("backlash", x, "named", gain=gains, evidence=most)) for x in names]
    assert told == [k != joint for k in range(3)]


@pytest.mark.parametrize(("own", "told"), [(0.7, False), (0.1, True)])
def test_a_gear_whose_gravity_is_felt_elsewhere(own, told):
    """A gear moves a heavy link slowly, and another joint feels its weight five times as much as its own, over the
    inertias. It is that gear where its own joint saves most of what it does there, and perhaps another effect where it
    saves a tenth."""
    evidence = evidence_of(log_of(raw(*moved(20.0), torque=0.02, position=1e-5)), ())
    names, inertia = evidence.robot.joints, [inertia_on(evidence, j) for j in range(2)]
    torque = {names[0]: float(np.sqrt(inertia[0])), names[1]: float(np.sqrt(5 * inertia[1]))}
    shares = dict(zip(names, (own, 1.0), strict=False))
    gains = {j: Gain(float(np.hypot(1e-3, x * np.sqrt(shares[j]))), 1e-3, 1.0, 0.0, (0, 1)) for j, x in torque.items()}
    gear = Finding("backlash", names[0], "named", gain=gains, evidence={"rms_of_term_N_m": torque})
    assert _moves_others_more(evidence, gear) is told


def test_a_joint_that_rests_in_all_that_is_held_out():
    """Residuals of 2 and 1 N m where a joint moves, all of it training data, and 5 N m at rest: what an effect there is
    worth is that where it moves."""
    evidence = evidence_of(log_of(raw(*moved(20.0), torque=0.02, position=1e-5)), ())
    assert held_out(evidence)
    evidence = replace(evidence, valid=evidence.valid & ~(evidence.role == ROLES.index("test"))[:, None])
    before, after = (np.where(evidence.valid, x, 5.0) for x in (2.0, 1.0))
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
