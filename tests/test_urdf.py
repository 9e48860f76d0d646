"""A URDF with other numbers: what is asked for changes, and not a byte else."""

import numpy as np
import pinocchio as pin
import pytest

from invdyn_cli.robots import load_urdf
from invdyn_cli.urdf import moving_links, with_changes

TEXT = """<?xml version="1.0"?>
<!-- an arm whose names are odd: <link name="upper"/> -->
<robot name="odd">
  <link name="base"/>
  <link name="upper" ><!-- lighter than it looks -->
    <inertial>
      <origin xyz="0.1 0.02 -0.03" rpy="0.3 -0.2 0.9"/>
      <mass value="2.5"/>
      <inertia ixx="0.03" ixy="0.002" ixz="0" iyy="0.04" iyz="-0.001" izz="0.05"/>
    </inertial>
    <visual><geometry><box size="1 1 1"/></geometry></visual>
  </link>
  <link name="lower"/>
  <link name="tool &gt; é"><inertial><mass value="0.4"/>
    <inertia ixx="1e-3" ixy="0" ixz="0" iyy="1e-3" iyz="0" izz="1e-3"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" velocity="2" effort="9"/><dynamics damping="0.5" friction="0.1"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0 0 0.3"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="2" effort="9"/></joint>
  <joint name="flange" type="fixed"><parent link="lower"/><child link="tool &gt; é"/><origin xyz="0 0 0.2"/></joint>
  <transmission name="t"><joint name="elbow"><dynamics damping="7"/></joint></transmission>
</robot>
"""


@pytest.fixture
def load(tmp_path):
    def loaded(text: str):
        path = tmp_path / "arm.urdf"
        path.write_text(text, encoding="utf-8")
        return load_urdf(path, dynamics_tags="use")

    return loaded


def test_nothing_asked_nothing_changed():
    """Without changes, or with the numbers that stand there already, the text is the same."""
    assert with_changes(TEXT, {}, {}) == (TEXT, ())
    assert with_changes(TEXT, {}, {"shoulder": (0.5, 0.1), "elbow": (0.0, 0.0)}) == (TEXT, ())


def test_what_is_written_is_read_back(load):
    """Changed inertials (turned, missing, of fixed links) and dynamics come back from the loader as they were asked."""
    body = pin.Inertia(0.7, np.array([0.02, -0.01, 0.1]), np.diag([0.003, 0.004, 0.005]))
    change = body.toDynamicParameters()
    text, said = with_changes(
        TEXT, {"upper": change, "lower": 2 * change}, {"shoulder": (1.5, 0.0), "elbow": (0.25, 3)}
    )
    before, after = load(TEXT), load(text)
    assert said == ()
    assert after.inertial - before.inertial == pytest.approx(np.array([change, 2 * change]), abs=1e-12)
    assert after.damping == pytest.approx([1.5, 0.25]) and after.friction == pytest.approx([0.0, 3.0])


def test_all_else_stays_byte_for_byte():
    """Comments, spaces, odd names, shapes and a transmission's joint of the same name are untouched."""
    text, _ = with_changes(TEXT, {"lower": np.array([1.0, 0, 0, 0.1, 1, 0, 1, 0, 0, 1])}, {"elbow": (0.25, 0.5)})
    old, new = TEXT.splitlines(), text.splitlines()
    changed = [i for i, (a, b) in enumerate(zip(old, new, strict=True)) if a != b]
    assert [old[i].split()[:2] for i in changed] == [["<link", 'name="lower"/>'], ["<joint", 'name="elbow"']]
    assert new[changed[0]].startswith('  <link name="lower"><inertial>') and new[changed[0]].endswith("</link>")


def test_a_link_cannot_weigh_less_than_nothing():
    """A change that leaves a link's own mass below zero is left out, with a sentence that names the link."""
    text, said = with_changes(TEXT, {"upper": np.array([-3.0, *np.zeros(9)])}, {})
    assert text == TEXT and len(said) == 1 and "upper" in said[0] and "-0.5 kg" in said[0]


def test_links_of_joints():
    """The link that a joint moves, by its name in the file."""
    assert moving_links(TEXT, ["elbow", "shoulder", "flange"]) == ["lower", "upper", "tool > é"]
