"""invdyn excite: from rivals to a csv that invdyn simulate plays."""

import json
from pathlib import Path

import pytest

from invdyn_cli.simulation.played import read_csv

SMALL = ("robot.dofs=2", "duration=8")
ONE = "{effect: viscous_friction, joint: arm_joint_2, damping: 2.0}"
RIVALS = f"effects=[{ONE}, {{effect: quadratic_friction, joint: arm_joint_2}}]"


def test_leaves_a_trajectory_that_is_played(command):
    """The last line is the folder with csv, picture and design.json; the table has both names; the plant plays it."""
    said = command("excite", *SMALL, RIVALS, "hydra.run.dir=out")
    assert (said.code, said.err) == (0, [])
    assert said.out[-1] == "out"
    assert {p.name for p in Path("out").iterdir() if not p.name.startswith(".")} == {
        "trajectory.csv", "trajectory.png", "design.json",
    }  # fmt: skip
    text = "\n".join(said.out)
    assert "Viscous" in text.title() and "Quadratic" in text.title()
    tree = json.loads(Path("out/design.json").read_text())
    assert tree["schema"] == "invdyn-design/1" and len(tree["pairs"]) == 2
    t, q = read_csv("out/trajectory.csv", ("arm_joint_1", "arm_joint_2"))
    assert t[-1] == pytest.approx(8.0, abs=0.1) and q.shape == (len(t), 2)
    way = "data.reference={_target_: invdyn_cli.simulation.played.Played, path: out/trajectory.csv}"
    assert command("simulate", "robot.dofs=2", "data.trajectories=1", way, "hydra.run.dir=log").code == 0


def test_takes_rivals_from_a_diagnosis(command):
    """The ambiguous finding of a diagnosis.json is the question, with its size."""
    one = {
        "effect": "torque_delay", "joint": "arm_joint_2", "status": "ambiguous", "alternatives": [["actuator_lag"]],
        "parameters": {"delay": {"value": 0.012, "unit": "s"}}, "advice": "",
    }  # fmt: skip
    Path("diagnosis.json").write_text(json.dumps({"schema": "invdyn-diagnosis/1", "findings": [one]}))
    said = command("excite", *SMALL, "diagnosis=diagnosis.json", "finding=1", "hydra.run.dir=out")
    assert said.code == 0, said.err
    tree = json.loads(Path("out/design.json").read_text())
    delay, lag = (side[0] for side in tree["questions"][0])
    assert (delay["effect"], delay["parameters"], lag["effect"]) == ("torque_delay", {"delay": 0.012}, "actuator_lag")
    for overrides, word in (
        (("diagnosis=diagnosis.json", "finding=2"), "allowed: 1 to 1"),
        (("diagnosis=diagnosis.json", RIVALS), "one of them"),
        (("diagnosis=none.json",), "none.json"),
        (("diagnosis=out/design.json",), "invdyn-design/1"),
    ):
        said = command("excite", *SMALL, *overrides)
        assert (said.code, len(said.err)) == (2, 1) and word in said.err[0]


@pytest.mark.parametrize(
    ("overrides", "word"),
    [
        ((), "two or more"),
        (("effects=3",), "allowed: a list"),
        (("effects=[{effect: coulomb_friction, joint: arm_joint_2}]",), "two or more"),
        (("effects=[{effect: coulomb_frictoin, joint: arm_joint_2}, {}]",), "did you mean 'coulomb_friction'"),
        (("effects=[{effect: coulomb_friction, joint: elbow}, {}]",), "no joint 'elbow'"),
        (("effects=[{effect: coulomb_friction}, {}]",), "without a joint"),
        (("effects=[{effect: coulomb_friction, joint: arm_joint_2, level: 2}, {}]",), "no 'level'"),
        (("effects=[{effect: coulomb_friction, joint: arm_joint_2, coulomb: -2}, {}]",), "possible: 0"),
        (("effects=[{effect: torque_delay, joint: arm_joint_2, delay: soon}, {}]",), "allowed: numbers"),
        (("effects=[{effect: backlash, joint: arm_joint_2, gap: [1, 2]}, {}]",), "a finite number"),
        (("effects=[{effect: payload, mass: 1, com: 3, inertia: [0, 0, 0, 0, 0, 0]}, {}]",), "3 finite numbers"),
        ((RIVALS, "robot=null"), "allowed: apollo_arm"),
        ((RIVALS, "robot=3"), "allowed: apollo_arm"),
        ((RIVALS, "robot=nobody"), "robot=nobody"),
        ((RIVALS, "robot.path=none.urdf"), "none.urdf"),
        ((RIVALS, "known=[{effect: torque_offset, joint: nowhere}]"), "no joint 'nowhere'"),
        ((RIVALS, "duration=1"), "from 5"),
        ((RIVALS, "duration=1e9"), "to 600"),
        ((RIVALS, "duration=null"), "from 5"),
        ((RIVALS, "duration=long"), "from 5"),
        ((RIVALS, "rate=.nan"), "from 20"),
        ((RIVALS, "noise=loud"), "or null"),
        ((RIVALS, "noise=[1,2,3]"), "a list of 2 such numbers"),
        ((RIVALS, "finding=1"), "without a diagnosis"),
        ((RIVALS, "seed=-1"), "from 0"),
    ],
)
def test_misuse_is_one_line(command, overrides, word):
    """Wrong effects, joints, parameters and numbers: one line that says what is allowed, exit code 2, and no csv."""
    said = command("excite", "robot.dofs=2", *overrides, "hydra.run.dir=out")
    assert (said.code, len(said.err)) == (2, 1)
    assert word in said.err[0]
    assert not Path("out/trajectory.csv").exists()


def test_what_comes_and_goes_is_told_not_refused(command):
    """Effects for which no motion can be designed are left out with what would tell them: beside two others these are
    told apart, alone nothing is designed; neither is misuse."""
    contact = "{effect: external_contact, joint: arm_joint_2}"
    said = command("excite", *SMALL, RIVALS.replace("]", f", {contact}]"), "hydra.run.dir=out")
    assert said.code == 0 and "no motion reproduces it" in " ".join(said.out)
    assert len(json.loads(Path("out/design.json").read_text())["questions"][0]) == 2
    said = command("excite", *SMALL, f"effects=[{contact}, {{effect: payload_change}}]", "hydra.run.dir=none")
    assert (said.code, said.err) == (0, []) and said.out[-1] == "No motion was designed."
    assert not Path("none/trajectory.csv").exists()


BENT = {"effect": "torque_delay", "joint": "arm_joint_2", "status": "ambiguous", "alternatives": [["actuator_lag"]],
        "parameters": {}}  # fmt: skip


@pytest.mark.parametrize(
    ("finding", "word"),
    [
        ({"effect": 3}, "names 3"),
        ({"alternatives": [[{}]]}, "names {}"),
        ({"alternatives": 5}, "not iterable"),
        ({"evidence": 7}, "not iterable"),
        ({"parameters": {"delay": 1}}, "subscriptable"),
        ({"joint": "elbow"}, "'elbow'"),
        ({"alternatives": [["unknown"]]}, "nothing to distinguish"),
    ],
)
def test_a_bent_diagnosis_is_one_line(command, finding, word):
    """A diagnosis.json whose findings are not what diagnose writes: one line, exit code 2."""
    tree = {"schema": "invdyn-diagnosis/1", "findings": [{**BENT, **finding}]}
    Path("bent.json").write_text(json.dumps(tree))
    said = command("excite", *SMALL, "diagnosis=bent.json", "hydra.run.dir=out")
    assert (said.code, len(said.err)) == (2, 1)
    assert word in said.err[0]
