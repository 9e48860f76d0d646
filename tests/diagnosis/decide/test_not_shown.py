"""What a log cannot show: by the sides on which it was taken, or by its motion."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.cases import inverse_dynamics
from invdyn_cli.diagnosis import wear
from invdyn_cli.diagnosis.checks.excitation import Excitation
from invdyn_cli.diagnosis.decide.not_shown import like_links, unseen
from invdyn_cli.diagnosis.search import noise
from invdyn_cli.diagnosis.search.inquiry import Question
from invdyn_cli.diagnosis.search.whole import inquire
from invdyn_cli.diagnosis.standard_columns import columns_of
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.types import Examination, Finding, Motion
from tests.diagnosis.analytic import arm, beyond, gather, log_of, moved, raw, recording_of

GEARS = {"backlash", "joint_elasticity"}


def said(side: str, position_side: str, lacks=(), claims=()) -> list[Finding]:
    """What is said of a log of these sides, its first joint's motion unable to show some effects."""
    examination = Examination(True, (), {"axis1": {"lacks": dict(lacks)}})
    return unseen(EFFECTS, claims, examination, side, position_side)


def test_a_link_encoder_does_not_see_the_gear():
    """Angles of the links do not contain what happens before them: gears are not observable, of the whole arm, with the
    reason and what to log instead; angles of the motors do."""
    found = said("unknown", "link")
    assert {f.effect for f in found} == GEARS
    for f in found:
        assert (f.status, f.joint) == ("not_observable", None)
        assert "link" in f.evidence["why"] and "motor" in f.advice
    assert said("unknown", "motor") == said("unknown", "unknown") == []


def test_each_reason_is_said_once():
    """What no such torque contains is said of the torque; of an effect that is hidden for the whole arm, or claimed, no
    joint's motion is blamed."""
    both = said("link", "link")
    assert len({f.effect for f in both}) == len(both)
    assert {f.effect for f in both if "torque" in f.evidence["why"]} == {
        n for n, e in EFFECTS.items() if "link" not in e.sides
    }
    lacks = {"load_zeros": "one flank", "reversals": "no reversal"}
    blamed = [f for f in said("unknown", "link", lacks, [Finding("torque_offset", "axis1", "named")])]
    blamed = {(f.effect, f.joint, f.evidence["why"]) for f in blamed if f.status == "not_excited"}
    directed = {n for n, e in EFFECTS.items() if "reversals" in e.needs} - {"torque_offset"}
    assert "coulomb_friction" in directed and blamed == {(n, "axis1", "no reversal") for n in directed}


@pytest.mark.parametrize(("position_side", "seen"), [("link", set()), ("motor", GEARS), ("unknown", GEARS)])
def test_nor_is_it_looked_for_there(position_side, seen):
    """Candidates of gears are there if the angles may be the motors', of every joint; nothing that comes and goes is
    among those that last."""
    recording = recording_of(log_of(raw(*moved(6.0, 100.0))))
    effects = [EFFECTS[n] for n in (*GEARS, "viscous_friction", "base_tilt", "payload_change", "external_contact")]
    keys = {c.key for c in gather(arm(), recording, effects, "unknown", position_side).candidates}
    assert {name for name, _ in keys} == {"viscous_friction", "base_tilt", *seen}
    assert all((name, joint) in keys for name in seen for joint in range(3))


def slowed(m: Motion, reach: float, slowness: float) -> Motion:
    """A motion about its first posture, that reaches a share as far, and is so much slower."""
    start = m.q[:1]
    return Motion(start + reach * (m.q - start), reach * m.qd / slowness, reach * m.qdd / slowness**2)


def cannot_show(t, m) -> list[dict]:
    """Of each joint the effects that it cannot show, and why."""
    numbers = Excitation().measure(log_of(raw(t, m)), arm())
    return [numbers[joint]["cannot_show"] for joint in arm().joints]


def test_play_needs_a_load_that_changes_its_side():
    """Backlash cannot be shown by a joint on which the torque, by Pinocchio, pulls to one side alone, and can by one on
    which it pulls to both: the words say which torques there were."""
    sides = set()
    for seed in range(3):
        t, m = moved(20.0, 100.0, seed)
        for reach in (1.0, 0.15):
            near = slowed(m, reach, 1.0)
            low, high = np.quantile(inverse_dynamics(arm(), near.q, near.qd, near.qdd), [0.02, 0.98], axis=0)
            for joint, why in enumerate(cannot_show(t, near)):
                one_sided = bool(low[joint] * high[joint] > 0)
                assert ("backlash" in why) == one_sided
                assert not one_sided or "sign" in why["backlash"]
                sides.add(one_sided)
    assert sides == {True, False}


def test_a_gears_spring_needs_speed():
    """A motion at half a hertz bends a gear, and the same motion, ten times slower, does not."""
    assert not any("joint_elasticity" in why for why in cannot_show(*moved(20.0, 100.0)))
    t, quick = moved(20.0, 1000.0)
    assert all("Hz" in why["joint_elasticity"] for why in cannot_show(10 * t, slowed(quick, 1.0, 10.0)))


def test_a_drift_needs_time_and_bristles_creep():
    """A zero's drift does not show within a minute; bristles not where a joint goes on at one speed."""
    t, m = moved(20.0, 100.0)
    assert all("20 s" in why["torque_offset_drift"] for why in cannot_show(t, m))
    assert not any("torque_offset_drift" in why for why in cannot_show(*moved(70.0, 100.0)))
    never = replace(m, q=0.3 * t[:, None] + 0 * m.q, qd=0.3 + 0 * m.q, qdd=0 * m.q)
    assert all("presliding_hysteresis" in why for why in cannot_show(t, never))


@pytest.mark.parametrize(("lighter", "hidden"), [(0.05, False), (1.0, True)])
def test_a_payload_is_not_shown_where_links_are_as_wrong(lighter, hidden):
    """A payload of a twentieth of an arm's mass is a fifth of its last link's, and links are wrong by a tenth or two;
    beside a last link that is twenty times lighter it is no usual error."""
    inertial = np.array(arm().inertial)
    inertial[-1] *= lighter
    robot, (t, m) = replace(arm(), inertial=inertial), moved(40.0)

    def term(t, m):
        return beyond(arm(), robot, m)

    names = ("payload", "coulomb_friction", "viscous_friction", "torque_offset", "rotor_inertia", "link_inertia_error")
    recording = recording_of(log_of(raw(t, m, term, torque=0.005, position=1e-6)))
    evidence = gather(robot, recording, [EFFECTS[name] for name in names], "unknown")
    least = noise.measure(evidence, np.ones(len(evidence.tau), bool))
    links = wear.worn_links(columns_of(evidence, "unknown"), least.weights, 0.1)
    inquiry = inquire(evidence, Question({x: EFFECTS[x] for x in names}, 3, wear=links))
    assert not inquiry.hypothesis
    assert (("payload", None) in {(f.effect, f.joint) for f in like_links(inquiry, ())}) is hidden
