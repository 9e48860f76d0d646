"""From ambiguous findings to what is recorded next, and what the user is told of it."""

from dataclasses import replace

import numpy as np
import pytest

from invdyn_cli.design import next_motion
from invdyn_cli.design.next_motion import FILE, after, all_open
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.robots import load_urdf
from invdyn_cli.types import Diagnosis, Examination, Finding, Quantity

LATE = Finding(
    "torque_delay",
    "arm_joint_2",
    "ambiguous",
    (("actuator_lag",),),
    {"delay": Quantity(0.012, "s", [0.011, 0.013])},
    evidence={"rivals": [{"effect": "actuator_lag", "joint": "arm_joint_2", "parameters": {"time_constant": 0.013}}]},
    advice="fast motion",
)
SAME = Finding(
    "asymmetric_coulomb_friction",
    "arm_joint_1",
    "ambiguous",
    (("coulomb_friction", "torque_offset"),),
    {"positive": Quantity(1.0, "N m"), "negative": Quantity(0.5, "N m")},
    advice="a posture without torque",
)
SURE = Finding("viscous_friction", "arm_joint_1", "named", parameters={"damping": Quantity(1.0, "N m s/rad")})
UNKNOWN = Finding("torque_offset", "arm_joint_1", "ambiguous", (("unknown",),), {"offset": Quantity(1.0, "N m")})
PASSING = Finding(
    "payload_change",
    None,
    "ambiguous",
    (("external_contact",),),
    {"mass": Quantity(1.0, "kg")},
    trajectory="a",
    window=(1.0, 2.0),
    advice=EFFECTS["payload_change"].advice,
)


@pytest.fixture(scope="module")
def arm():
    """The upper two joints of the built-in arm."""
    return load_urdf("apollo_arm", dofs=2)


def diagnosis(arm, *findings):
    """A diagnosis with these findings, of a log with a little noise."""
    details = {
        "noise_N_m": dict.fromkeys(arm.joints, 0.05),
        "filter_cutoff_Hz": dict.fromkeys(arm.joints, 20.0),
    }
    return Diagnosis("explained", Examination(True, (), {}), findings, {}, {}, None, {}, details=details)


def test_questions_are_the_open_ones(arm):
    """Ambiguous findings alone are questions, with the sizes that the log gave both names; "unknown" is no rival."""
    asked = [x for x in all_open([SURE, LATE, UNKNOWN, SAME], arm) if x.playable]
    assert [x.finding for x in asked] == [1, 3]
    names = [[[(c.effect.name, c.joint) for c in side] for side in x.sides] for x in asked]
    assert names[0] == [[("torque_delay", 1)], [("actuator_lag", 1)]]
    assert names[1] == [[("asymmetric_coulomb_friction", 0)], [("coulomb_friction", 0), ("torque_offset", 0)]]
    assert asked[0].sides[0][0].parameters == {"delay": 0.012}
    assert asked[0].sides[1][0].parameters == {"time_constant": 0.013}


def test_a_finding_that_a_motion_settles_says_so(arm, monkeypatch):
    """Its advice names the file and the distance, its evidence has the distances; the others stay as they were."""
    monkeypatch.setattr(next_motion, "TRIES", 6)
    before = diagnosis(arm, SURE, LATE)
    advised, made = after(before, arm, duration=8.0)
    assert made is not None and made.t[-1] == pytest.approx(8.0, abs=0.1)
    finding = advised.findings[1]
    assert FILE in finding.advice and "standard errors" in finding.advice
    assert {x["true"] for x in finding.evidence["distances"]} == {"torque_delay", "actuator_lag"}
    assert advised.findings[0] == SURE
    assert np.isfinite([x["standard_errors"] for x in finding.evidence["distances"]]).all()


@pytest.mark.parametrize(
    ("distance", "said"),
    [(0.09, "no motion of 8 s separates"), (4.0, "it probably separates"), (40.0, "it separates")],
)
def test_what_a_motion_settles_hardly_is_not_promised(arm, monkeypatch, distance, said):
    """Ten standard errors are certain, and below two there is nothing to record."""
    monkeypatch.setattr(next_motion, "TRIES", 6)
    real = next_motion.design

    def designed(*args, **options):
        made = real(*args, **options)
        return replace(made, pairs=tuple(replace(p, distance=distance) for p in made.pairs))

    monkeypatch.setattr(next_motion, "design", designed)
    advised, made = after(diagnosis(arm, LATE), arm, duration=8.0)
    assert said in advised.findings[0].advice
    assert (made is None) == (distance < 2)


def test_a_finding_that_no_motion_settles_says_so(arm):
    """There is nothing to record, and the advice is what else would tell."""
    advised, made = after(diagnosis(arm, SAME), arm, duration=8.0)
    assert made is None
    assert (
        "no motion separates" in advised.findings[0].advice and "a posture without torque" in advised.findings[0].advice
    )


def test_nothing_open_nothing_done(arm):
    """A diagnosis without open findings stays as it is, one of an unusable log too."""
    for one in (diagnosis(arm, SURE, UNKNOWN), replace(diagnosis(arm), details={}, verdict="log_unusable")):
        assert after(one, arm) == (one, None)


def test_what_comes_and_goes_is_left_to_its_advice(arm):
    """No motion makes it come again: its finding says so, with what would tell, once; nothing is designed, and nothing
    fails."""
    advised, made = after(diagnosis(arm, PASSING), arm, duration=8.0)
    assert made is None
    said = advised.findings[0].advice
    assert "no motion reproduces it" in said and said.count(EFFECTS["payload_change"].advice) == 1


@pytest.mark.parametrize("name", ["made_up", "external_contact"])
def test_a_rival_that_cannot_be_played_stops_nothing(arm, monkeypatch, name):
    """Beside a rival that is not in the catalogue, or comes and goes, the others of the same finding and the other
    findings are told apart as ever; the one is a note, the other a line of the advice."""
    monkeypatch.setattr(next_motion, "TRIES", 0)
    odd = {"effect": name, "joint": "no_joint", "parameters": {}}
    late = replace(
        LATE,
        alternatives=(*LATE.alternatives, (name,), ("coulomb_friction", "unknown")),
        evidence={"rivals": [*LATE.evidence["rivals"], odd]},
    )
    stranger = replace(SAME, effect="made_up", alternatives=(("viscous_friction",),))
    advised, made = after(diagnosis(arm, stranger, PASSING, late), arm, duration=8.0)
    assert made is not None and {p.question for p in made.pairs} == {0}
    assert FILE in advised.findings[2].advice
    assert any("made_up is not in the catalogue" in x for x in advised.notes)
    assert (EFFECTS[name].title in advised.findings[2].advice) if name in EFFECTS else True


def test_sizes_that_make_no_sense_are_typical_ones(arm):
    """Parameters that lack one, are no number or no physics are as if there were none."""
    for bad in (
        {},
        {"delay": Quantity(float("nan"), "s")},
        {"delay": Quantity(-1.0, "s")},
        {"delay": Quantity("x", "s")},
    ):
        (asked,) = all_open([replace(LATE, parameters=bad)], arm)
        assert asked.sides[0][0].parameters is None


def test_a_diagnosis_without_noise_or_filter_gets_a_motion(arm, monkeypatch):
    """A joint whose noise or filter the diagnosis could not tell has usual ones."""
    monkeypatch.setattr(next_motion, "TRIES", 0)
    bare = replace(diagnosis(arm, LATE), details={"noise_N_m": {"arm_joint_1": float("nan")}})
    assert after(bare, arm, duration=8.0)[1] is not None


@pytest.mark.parametrize("lacks", ["gravity", "mass"])
def test_a_bare_arm_gets_a_motion(arm, monkeypatch, lacks):
    """Where nothing pulls at the arm, or its last link has no mass, what can be told apart is, without a warning; a
    tilt that nothing shows is left out."""
    monkeypatch.setattr(next_motion, "TRIES", 0)
    bare = {"gravity": np.zeros(3)} if lacks == "gravity" else {"inertial": np.asarray(arm.inertial) * [[1], [0]]}
    names = ("backlash", "joint_elasticity", "torque_saturation", "presliding_hysteresis", "base_tilt")
    one = replace(LATE, alternatives=(*LATE.alternatives, *((x,) for x in names)))
    with np.errstate(all="raise", under="ignore"):
        advised, made = after(diagnosis(arm, one), replace(arm, **bare), duration=8.0)
    assert made is not None and np.isfinite([p.distance for p in made.pairs]).all()
    assert ("no gravity acts on" in advised.findings[0].advice) == (lacks == "gravity")
