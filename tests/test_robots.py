"""Robots against Pinocchio's own URDF reader: the whole model there, locked joints at rest, the others at random."""
# pyright: reportAttributeAccessIssue=false

import os
import sys
import types
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate

from invdyn_cli.errors import RobotError
from invdyn_cli.robots import load_urdf, pinocchio_model
from invdyn_cli.urdf import BUILT_IN

ROOT = Path(__file__).resolve().parents[1]
REAL = Path(os.environ.get("INVDYN_REAL_DATA", ROOT.parent / "shared" / "data")) / "urdf"
REAL_NAMES = ("iiwa14", "kuka_lwr4", "panda", "panda_no_hand", "ur10e")


def link(name: str, mass: float = 1.0, com: str = "0.02 -0.03 0.1") -> str:
    """A link with a lopsided inertia in a turned frame."""
    return f"""<link name="{name}"><inertial><mass value="{mass}"/><origin xyz="{com}" rpy="0.3 -0.2 0.1"/>
        <inertia ixx="0.03" ixy="0.002" ixz="-0.001" iyy="0.04" iyz="0.003" izz="0.02"/></inertial>
        <visual><geometry><mesh filename="package://nowhere/{name}.stl"/></geometry></visual></link>"""


def joint(
    name: str, kind: str, parent: str, child: str, axis: str = "0 0 1", more: str = "", range_: str = "-2 2"
) -> str:
    """A joint with an offset and a turn."""
    lower, upper = range_.split()
    return f"""<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
        <origin xyz="0.05 -0.1 0.3" rpy="0.4 -0.5 0.6"/><axis xyz="{axis}"/>
        <limit lower="{lower}" upper="{upper}" effort="50" velocity="3"/>{more}</joint>"""


def urdf(*parts: str) -> str:
    return f'<?xml version="1.0" encoding="utf-8"?>\n<robot name="small">{"".join(parts)}</robot>'


def arm(side: str = "", length: int = 4) -> str:
    """Links and joints j1, j2, … from `base`, of mixed types, with a fixed joint in the middle."""
    kinds = ("revolute", "prismatic", "continuous", "revolute", "continuous")
    axes = ("0 0 1", "0 1 1", "1 -2 0.5", "0 -1 0", "1 0 0")
    parts, parent = [], "base"
    for i in range(length):
        if i == 2:
            parts += [link(f"{side}plate", 0.4), joint(f"{side}bolted", "fixed", parent, f"{side}plate")]
            parent = f"{side}plate"
        child = f"{side}l{i + 1}"
        tags = '<dynamics damping="0.5" friction="0.2"/>'
        parts += [link(child), joint(f"{side}j{i + 1}", kinds[i], parent, child, axes[i], tags)]
        parent = child
    return "".join(parts)


BASE = link("base", 5.0)
ARM = urdf(BASE, arm())
JAWS = (
    link("palm", 0.5)
    + joint("wrist", "fixed", "l4", "palm")
    + link("left", 0.1)
    + joint("left_drive", "prismatic", "palm", "left", range_="0.01 0.05")
    + link("right", 0.1)
    + joint("right_slide", "prismatic", "palm", "right", more='<mimic joint="left_drive"/>')
)
FINGERS = "".join(link(f"f{i}", 0.1) + joint(f"digit{i}", "revolute", "l4", f"f{i}") for i in range(3))
DUAL = urdf(BASE, arm("a_", 3), arm("b_", 3))
HOLLOW = '<link name="l3"/>' + joint("j3", "revolute", "l2", "l3")
MASSLESS = urdf(BASE, arm(length=2), HOLLOW, link("l4"), joint("j4", "revolute", "l3", "l4", "0 1 0"))


@pytest.fixture
def write(tmp_path):
    def to_file(text: str, name: str = "robot.urdf") -> Path:
        file = tmp_path / name
        file.write_text(text, encoding="utf-8")
        return file

    return to_file


def torques(model, names, states, locked=None, gravity=(0.0, 0.0, -9.81)):
    """(T, n) RNEA torques of the joints `names` of any Pinocchio model; the others rest at `locked` or zero."""
    model.gravity.linear = np.array(gravity, float)
    data = model.createData()
    joints = [model.joints[model.getJointId(x)] for x in names]
    out = []
    for q, qd, qdd in zip(*states, strict=True):
        full, v, a = pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
        for name, at in (locked or {}).items():
            full[model.joints[model.getJointId(name)].idx_q] = at
        for column, x in enumerate(joints):
            at = slice(x.idx_q, x.idx_q + x.nq)
            full[at] = (np.cos(q[column]), np.sin(q[column])) if x.nq == 2 else q[column]
            v[x.idx_v], a[x.idx_v] = qd[column], qdd[column]
        tau = pin.rnea(model, data, full, v, a)
        out.append([tau[x.idx_v] for x in joints])
    return np.array(out)


def random_states(n: int, count: int = 20):
    return np.random.default_rng(1).uniform(-2, 2, (3, count, n))


def assert_same(robot, reference, locked=None, gravity=(0.0, 0.0, -9.81), columns=None):
    """The robot's own dynamics are those of a reference model, to rounding."""
    states = random_states(robot.dofs)
    mine = torques(pinocchio_model(robot), robot.joints, states, gravity=robot.gravity)
    theirs = torques(reference, columns or robot.joints, states, locked, gravity)
    assert np.abs(mine - theirs).max() <= 1e-12 * np.abs(theirs).max()


def from_file(file) -> pin.Model:
    return pin.buildModelFromUrdf(str(file))


@pytest.mark.parametrize("text", [ARM, MASSLESS, urdf(BASE, arm(length=5))], ids=["arm", "massless", "five"])
def test_mixed_joints(write, text):
    """Revolute, sliding and endless joints with skew axes, a fixed joint between, give Pinocchio's torques."""
    file = write(text)
    assert_same(load_urdf(file), from_file(file))


@pytest.mark.parametrize("name", REAL_NAMES)
def test_real_robots(name):
    """Published URDFs give the torques that Pinocchio's file reader gives."""
    file = REAL / f"{name}.urdf"
    if not file.exists():
        pytest.skip(f"needs {name}.urdf of the real-robot data (INVDYN_REAL_DATA)")
    robot = load_urdf(file)
    assert robot.dofs == (6 if name == "ur10e" else 7)
    assert_same(robot, from_file(file))


def test_apollo():
    """The built-in arm has seven joints, 14.4 kg that move, and gravity that shows in joint 1."""
    robot = load_urdf("apollo_arm")
    assert robot.joints == tuple(f"arm_joint_{i}" for i in range(1, 8)) and not robot.notes
    assert robot.inertial[:, 0].sum() == pytest.approx(14.4)
    axis = np.asarray(robot.rotation[0]) @ robot.axis[0]
    assert abs(axis @ robot.gravity) < 1e-12
    assert_same(robot, from_file(BUILT_IN["apollo_arm"]))


def test_arrays(write):
    """Axes are unit, types, limits and parents those of the URDF; endless joints have no range."""
    robot = load_urdf(write(ARM))
    assert robot.joints == ("j1", "j2", "j3", "j4") and robot.parents == (-1, 0, 1, 2)
    assert robot.prismatic == (False, True, False, False)
    assert np.allclose(np.linalg.norm(robot.axis, axis=1), 1)
    assert robot.lower.tolist() == [-2, -2, -np.inf, -2] and robot.upper.tolist() == [2, 2, np.inf, 2]
    assert robot.velocity_limit.tolist() == [3] * 4 and robot.effort_limit.tolist() == [50] * 4
    assert robot.inertial.shape == (4, 10) and robot.inertial.dtype == np.float64
    assert robot.inertial[1, 0] == pytest.approx(1.4)  # l2 and the plate
    assert robot.urdf == ARM


@pytest.mark.parametrize("end", [JAWS, FINGERS], ids=["mimic", "branches"])
def test_gripper_is_locked(write, end):
    """A gripper's joints are locked at zero, or at the nearest limit, and named; its mass stays."""
    file = write(urdf(BASE, arm(), end))
    robot = load_urdf(file)
    assert robot.joints == ("j1", "j2", "j3", "j4")
    assert_same(robot, from_file(file), locked={"left_drive": 0.01} if end is JAWS else None)
    (note,) = [x for x in robot.notes if x.startswith("locked")]
    assert "left_drive at 0.01, right_slide at 0" in note if end is JAWS else "digit2 at 0" in note


def test_mimic_in_the_arm(write):
    """A joint that carries the arm moves even if another follows it."""
    rod = link("rod", 0.1) + joint("rod_joint", "revolute", "l1", "rod", more='<mimic joint="j1"/>')
    assert load_urdf(write(urdf(BASE, arm(), rod))).joints == ("j1", "j2", "j3", "j4")


@pytest.mark.parametrize("choice", [{"tip": "b_l3"}, {"tip": "b_j3"}, {"joints": ["b_j1", "b_j2", "b_j3"]}], ids=str)
def test_one_of_two_arms(write, choice):
    """A tip, a link's or joint's name, or a list of joints takes one arm of two, and notes the other."""
    file = write(DUAL)
    robot = load_urdf(file, **choice)
    assert robot.joints == ("b_j1", "b_j2", "b_j3")
    assert all(f"a_j{i}" in robot.notes[0] for i in (1, 2, 3))
    assert_same(robot, from_file(file))


def test_order_of_columns(write):
    """Joints of two arms come in the order that is asked for, each with its parent's column."""
    file = write(DUAL)
    robot = load_urdf(file, joints=["b_j1", "a_j1", "a_j3", "b_j2"])
    assert robot.parents == (-1, -1, 1, 0)
    assert_same(robot, from_file(file))


def test_locked_in_the_middle(write):
    """A joint left out between others is locked at zero."""
    file = write(ARM)
    robot = load_urdf(file, joints=["j1", "j4"])
    assert robot.parents == (-1, 0) and "j2 at 0, j3 at 0" in robot.notes[0]
    assert_same(robot, from_file(file))


def test_locked_floating_base(write):
    """A floating joint may stay locked where it is not asked to move, and is refused where it is."""
    free = '<joint name="free" type="floating"><parent link="world"/><child link="base"/></joint>'
    file = write(urdf('<link name="world"/>', free, BASE, arm()))
    robot = load_urdf(file, joints=["j1", "j2", "j3", "j4"])
    assert_same(robot, from_file(file))
    for tip in (None, "l4"):
        with pytest.raises(RobotError, match=r"free \(floating\).*lock"):
            load_urdf(file, tip=tip)


@pytest.mark.parametrize("k", [1, 4, 6])
def test_dofs_cuts_the_arm(write, k):
    """dofs=k is the URDF cut behind joint k, the mass behind it gone."""
    root = ET.parse(BUILT_IN["apollo_arm"]).getroot()
    for x in [*root.findall("link"), *root.findall("joint")]:
        number = x.attrib["name"].rpartition("_")[2]
        if number.isdigit() and int(number) > k:
            root.remove(x)
    robot = load_urdf("apollo_arm", dofs=k)
    assert robot.dofs == k
    assert_same(robot, from_file(write(ET.tostring(root, encoding="unicode"))))
    assert_same(robot, from_file(write(robot.urdf, "own.urdf")))  # its text is that of the arm that is left


@pytest.mark.parametrize("inertia", [None, [0.02, 0.001, -0.002, 0.03, 0.004, 0.025]], ids=["point", "body"])
def test_payload(write, inertia):
    """A payload is the same as a body bolted to the last link."""
    xx, xy, xz, yy, yz, zz = inertia or [0] * 6
    box = f"""<link name="box"><inertial><mass value="1.5"/><origin xyz="0.1 0.02 -0.05"/>
        <inertia ixx="{xx}" ixy="{xy}" ixz="{xz}" iyy="{yy}" iyz="{yz}" izz="{zz}"/></inertial></link>
        <joint name="grip" type="fixed"><parent link="l4"/><child link="box"/></joint>"""
    payload = {"mass": 1.5, "com": [0.1, 0.02, -0.05], "inertia": inertia}
    assert_same(load_urdf(write(ARM), payload=payload), from_file(write(urdf(BASE, arm(), box), "loaded.urdf")))
    if inertia:
        full = {**payload, "inertia": [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]}
        six, nine = (load_urdf(write(ARM), payload=x).inertial for x in (payload, full))
        assert np.array_equal(six, nine)


def test_tilted_base(write):
    """base_rpy is the same as a tilted mount in the URDF, and as its gravity given by hand."""
    rpy = [0.3, -0.7, 1.1]
    mount = '<link name="world"/><joint name="mount" type="fixed"><parent link="world"/><child link="base"/>'
    tilted = from_file(
        write(urdf(mount, f'<origin rpy="{rpy[0]} {rpy[1]} {rpy[2]}"/></joint>', BASE, arm()), "tilted.urdf")
    )
    file = write(ARM)
    robot = load_urdf(file, base_rpy=rpy)
    assert_same(robot, tilted)
    assert_same(robot, from_file(file), gravity=robot.gravity)
    assert_same(load_urdf(file, gravity=robot.gravity.tolist()), tilted)


def test_base_on_its_side(write):
    """A base rolled by +90 degrees feels gravity along its -y axis."""
    gravity = load_urdf(write(ARM), base_rpy=[np.pi / 2, 0, 0]).gravity
    assert np.allclose(gravity, [0, -9.81, 0])


def test_dynamics_tags(write):
    """<dynamics> counts only when it is asked for, and a note says so."""
    file = write(ARM)
    ignored, used = load_urdf(file), load_urdf(file, dynamics_tags="use")
    assert not ignored.damping.any() and not ignored.friction.any() and "dynamics" in ignored.notes[0]
    assert used.damping.tolist() == [0.5] * 4 and used.friction.tolist() == [0.2] * 4 and not used.notes


def test_reduced_again():
    """The reference model has its frames, so that Pinocchio can reduce it."""
    model = pinocchio_model(load_urdf("apollo_arm"))
    assert pin.buildReducedModel(model, [2], pin.neutral(model)).nq == 6


BALL = '<joint name="hip" type="ball"><parent link="base"/><child link="l1"/></joint>'
REFUSED = {
    "not XML": ("<robot name='x'><link", {}, "is not XML"),
    "other format": ("<mujoco/>", {}, "<mujoco> at its root; allowed: <robot>"),
    "two roots": (urdf(BASE, link("other")), {}, "2 links without a parent joint: base, other"),
    "nothing moves": (urdf(BASE), {}, "no moving joint"),
    "ball": (urdf(BASE, link("l1"), BALL), {}, r"hip \(ball\); allowed: revolute"),
    "planar": (urdf(BASE, link("l1"), joint("deck", "planar", "base", "l1")), {}, r"deck \(planar\)"),
    "no mass": (urdf('<link name="base"/><link name="l1"/>', joint("j1", "revolute", "base", "l1")), {}, "no mass"),
    "negative mass": (
        urdf(BASE, link("l1", -1.0), joint("j1", "revolute", "base", "l1")),
        {},
        "'l1' has a negative mass",
    ),
    "mass not finite": (
        urdf(BASE, link("l1", np.nan), joint("j1", "revolute", "base", "l1")),
        {},
        "mass value> is nan",
    ),
    "com not finite": (
        urdf(BASE, link("l1", com="0 inf 0"), joint("j1", "revolute", "base", "l1")),
        {},
        "origin xyz> is",
    ),
    "no axis": (urdf(BASE, link("l1"), joint("j1", "prismatic", "base", "l1", "0 0 0")), {}, "has the axis"),
    "axis without a length": (
        urdf(BASE, link("l1"), joint("j1", "revolute", "base", "l1", "0 1e-200 0")),
        {},
        "a vector of length 1",
    ),
    "a mass beyond reason": (urdf(BASE, link("l1", 1e300), joint("j1", "revolute", "base", "l1")), {}, "up to 1e.06"),
    "a link twice": (
        urdf(BASE, link("base"), joint("j1", "revolute", "base", "base")),
        {},
        "several links called base",
    ),
    "a joint's name twice": (
        urdf(BASE, link("l1"), link("l2"), joint("j", "revolute", "base", "l1"), joint("j", "revolute", "l1", "l2")),
        {},
        "several joints called j",
    ),
    "a circle": (
        urdf(BASE, link("a"), link("b"), joint("j1", "revolute", "b", "a"), joint("j2", "revolute", "a", "b")),
        {},
        "form a loop: a, b",
    ),
    "two parents": (
        urdf(BASE, link("a"), joint("j1", "revolute", "base", "a"), joint("j2", "revolute", "base", "a")),
        {},
        "has several parent joints",
    ),
    "no such link": (urdf(BASE, joint("j1", "revolute", "base", "a")), {}, "has the child 'a'"),
    "no name": (urdf(BASE, link(""), joint("j1", "revolute", "base", "")), {}, "1 to 200 printable characters"),
    "an escape sequence": (urdf(BASE, link("a\u009b2J"), joint("j1", "revolute", "base", "a")), {}, "printable"),
    "101 joints": (
        urdf(
            BASE,
            *(link(f"l{i}") + joint(f"j{i}", "revolute", f"l{i - 1}" if i else "base", f"l{i}") for i in range(101)),
        ),
        {},
        "101 moving joints; allowed: 100",
    ),
    "an XML bomb": (
        '<!DOCTYPE r [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">]><robot name="&b;"/>',
        {},
        "declares a DOCTYPE",
    ),
    "only a gripper": (urdf(BASE, link("l1"), joint("jaw", "revolute", "base", "l1")), {}, "those of a gripper"),
    "two arms": (DUAL, {}, "2 arms; allowed: one. Try: robot.tip=NAME, one of a_j3, b_j3"),
    "unknown joint": (ARM, {"joints": ["j1", "j22"]}, "'j22', did you mean 'j2'.; allowed: j1, j2, j3, j4"),
    "fixed joint": (ARM, {"joints": ["bolted"]}, "no moving joint 'bolted'"),
    "a joint twice": (ARM, {"joints": ["j1", "j1"]}, "twice"),
    "no joints": (ARM, {"joints": []}, "empty"),
    "unknown tip": (ARM, {"tip": "l44"}, "did you mean 'l4'"),
    "tip at the base": (ARM, {"tip": "base"}, "no moving joint between"),
    "tip and joints": (ARM, {"tip": "l4", "joints": ["j1"]}, "one of them"),
    "dofs": (ARM, {"dofs": 5}, "robot.dofs=5; allowed: 1 to 4"),
    "dofs zero": (ARM, {"dofs": 0}, "robot.dofs=0; allowed: 1 to 4"),
    "gravity": (ARM, {"gravity": [0, 9.81]}, "robot.gravity is .0, 9.81.; allowed: finite numbers"),
    "gravity and tilt": (ARM, {"gravity": [0, 0, 9.81], "base_rpy": [0, 0, 0]}, "one of them"),
    "payload": (ARM, {"payload": {"weight": 1}}, "allowed: mass and com"),
    "payload's mass": (ARM, {"payload": {"mass": -1, "com": [0, 0, 0]}}, "mass and moments of inertia >= 0"),
    "payload's inertia": (ARM, {"payload": {"mass": 1, "com": [0, 0, 0], "inertia": [1, 2]}}, "inertia is"),
    "tags": (ARM, {"dynamics_tags": "yes"}, "allowed: ignore, use"),
}


def test_a_joint_called_like_a_link(write):
    """A joint and the link that it moves may have one name: the robot is the same as with two, tip included."""
    one, other = (
        urdf(
            BASE,
            arm(length=2),
            link(name),
            joint("j3", "revolute", "l2", name),
            link("l4"),
            joint("j4", "revolute", name, "l4"),
        )
        for name in ("j3", "l3")
    )
    robots = [load_urdf(write(text), tip="j3") for text in (one, other)]
    np.testing.assert_array_equal(robots[0].inertial, robots[1].inertial)
    assert robots[0].joints == robots[1].joints == ("j1", "j2", "j3")


def test_what_no_body_has_is_told(write):
    """Inertias that break the laws of bodies are named in the notes, rounded ones and placeholders of zero are not."""
    broken = link("l1").replace('izz="0.02"', 'izz="0.5"')
    rounded = link("l2").replace('izz="0.02"', 'izz="0.0695"')
    text = urdf(BASE, broken, joint("j1", "revolute", "base", "l1"), rounded, joint("j2", "revolute", "l1", "l2"))
    notes = [x for x in load_urdf(write(text)).notes if "not physically consistent" in x]
    assert len(notes) == 1 and "l1" in notes[0] and "l2" not in notes[0]


def test_joints_in_any_order(write):
    """Joints that are named in another order are the same robot, which knows the order that was asked for."""
    file = write(ARM)
    robot = load_urdf(file, joints=["j3", "j1", "j4", "j2"])
    assert robot.joints == ("j1", "j2", "j3", "j4") and robot.parents == (-1, 0, 1, 2)
    assert robot.columns == ("j3", "j1", "j4", "j2")
    assert_same(robot, from_file(file))
    assert load_urdf(file, joints=["j1", "j2"]).columns == ()


def test_joints_that_move_nothing_are_told(write):
    """A last link without inertial loads, and a note says that its joint moves no inertia."""
    text = urdf(BASE, arm(length=2), '<link name="tool"/>', joint("j9", "revolute", "l2", "tool"))
    assert any("j9 moves no inertia" in x for x in load_urdf(write(text)).notes)


def test_files_that_are_no_files(tmp_path):
    """A pipe, a device and a file of 21 MB are refused at once."""
    os.mkfifo(tmp_path / "pipe.urdf")
    (tmp_path / "large.urdf").write_bytes(b" " * 21_000_000)
    for name, words in (("pipe.urdf", "no robot description"), ("large.urdf", "holds 21 MB")):
        with pytest.raises(RobotError, match=words):
            load_urdf(tmp_path / name)


@pytest.mark.parametrize("case", REFUSED)
def test_refused(write, capfd, case):
    """What cannot be the robot that is meant is refused in one line that says why, and nothing else is printed."""
    text, options, words = REFUSED[case]
    with pytest.raises(RobotError, match=words) as error:
        load_urdf(write(text), **options)
    assert "\n" not in str(error.value)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("path", "words"), [("apolo_arm", "did you mean 'apollo_arm'"), (None, "robot.path="), (ROOT, "no robot")]
)
def test_no_such_file(path, words):
    """A path that is no file names the built-in robots."""
    with pytest.raises(RobotError, match=words):
        load_urdf(path)


def test_xacro_missing(write, monkeypatch):
    """Without the package xacro, a xacro file asks for the extra."""
    monkeypatch.setitem(sys.modules, "xacro", None)
    with pytest.raises(RobotError, match=r"invdyn\[xacro\]"):
        load_urdf(write(ARM, "robot.urdf.xacro"))


def test_xacro_fails(write, monkeypatch):
    """What xacro stumbles on is told, with a way around."""
    broken = types.SimpleNamespace(process_file=lambda file: 1 / 0)
    monkeypatch.setitem(sys.modules, "xacro", broken)
    with pytest.raises(RobotError, match=r"expanded by xacro: division.*xacro robot.urdf.xacro > robot.urdf"):
        load_urdf(write(ARM, "robot.urdf.xacro"))


def test_xacro(write):
    """A xacro file is expanded."""
    pytest.importorskip("xacro", reason="needs the extra invdyn[xacro]")
    macro = '<robot name="small" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:property name="unused" value="1"/>'
    text = ARM.replace('<robot name="small">', macro)
    robot = load_urdf(write(text, "robot.urdf.xacro"))
    assert robot.dofs == 4 and "xacro:property" not in robot.urdf


@pytest.mark.parametrize("name", ["apollo_arm", "urdf", "from_log"])
def test_configs(write, name):
    """Every robot config gives a loader, and takes a path and a payload on the command line."""
    path = "apollo_arm" if name == "apollo_arm" else write(ARM)
    with initialize_config_dir(str(ROOT / "conf" / "robot"), version_base=None):
        config = compose(name, [f"path={path}", "payload={mass: 1, com: [0, 0, 0.1]}", "base_rpy=[0.1, 0, 0]"])
    robot = instantiate(config, _convert_="all")()
    assert robot.inertial[-1, 3] - load_urdf(path).inertial[-1, 3] == pytest.approx(0.1)
