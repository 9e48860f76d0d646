"""What a diagnosis found, as files for simulators and beside the log."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from experiments.arms import random_arm
from invdyn_cli.diagnosis.extension import beside_dynamics, exported, urdf_of, why_not
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.composition import EffectInstance
from invdyn_cli.effects.description import ExtendedModel
from invdyn_cli.log import Log
from invdyn_cli.robots import load_urdf
from invdyn_cli.types import Robot
from tests.simulation.test_mjcf import PARAMETERS

BODY = {"mass": 0.3, "moment": np.array([0.01, 0.0, 0.02]), "inertia": np.array([0.01, 0, 0.01, 0, 0, 0.01])}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arm")
    (folder / "arm.urdf").write_text(random_arm(np.random.default_rng(0), 3))
    return folder


@pytest.fixture(scope="module")
def arm(folder) -> Robot:
    return load_urdf(folder / "arm.urdf")


def model(robot: Robot, *effects: tuple[str, int | None, dict]) -> ExtendedModel:
    return ExtendedModel(robot, tuple(EffectInstance(EFFECTS[name], joint, p) for name, joint, p in effects))


def test_the_urdf_holds_what_it_can(arm, tmp_path):
    """Inertials, damping and friction come back from the file; the rest is said, and gravity as an option to load."""
    payload = {"mass": 1.0, "com": np.array([0.0, 0.02, 0.1]), "inertia": np.full(6, 1e-3) * [1, 0, 1, 0, 0, 1]}
    found = model(
        arm,
        ("viscous_friction", 0, {"damping": 0.7}),
        ("asymmetric_coulomb_friction", 1, {"positive": 2.0, "negative": 1.0}),
        ("link_inertia_error", 1, BODY),
        ("payload", None, payload),
        ("base_tilt", None, {"angle": 0.1, "azimuth": 0.0}),
    )
    text, said = urdf_of(found)
    (tmp_path / "new.urdf").write_text(text)
    new = load_urdf(tmp_path / "new.urdf", dynamics_tags="use")
    assert new.damping == pytest.approx([0.7, 0, 0]) and new.friction == pytest.approx([0, 1.5, 0])
    added = np.asarray(new.inertial) - arm.inertial
    assert added[1] == pytest.approx(np.concatenate([[0.3], BODY["moment"], BODY["inertia"]]), abs=1e-12)
    assert added[2, :4] == pytest.approx([1.0, 0.0, 0.02, 0.1], abs=1e-12)
    assert len(said) == 2 and "axis2: asymmetric Coulomb friction is written without its offset" in said[0]
    assert "robot.gravity=[0.97" in said[1]


def test_friction_that_the_urdf_states_is_told_beside_what_was_found(arm, tmp_path):
    """Of two joints whose <dynamics> were written with these numbers one has the friction that is found, within a
    tenth, and one another damping; a URDF without such numbers is not spoken of."""
    text, _ = urdf_of(model(arm, ("viscous_friction", 0, {"damping": 0.7}), ("coulomb_friction", 2, {"coulomb": 2.0})))
    (tmp_path / "states.urdf").write_text(text)
    found = (("viscous_friction", 0, {"damping": 0.5}), ("coulomb_friction", 2, {"coulomb": 1.9}))
    (said,) = beside_dynamics(model(load_urdf(tmp_path / "states.urdf"), *found))
    assert "1 of 2 values are within 10 %" in said and said.endswith("; axis1 damping 0.7, estimated 0.5.")
    assert beside_dynamics(model(arm, *found)) == ()


def test_no_effect_vanishes_from_the_urdf(arm):
    """Every effect of the catalogue changes the text or is said."""
    for name in EFFECTS:
        p = {k: np.asarray(v, float) if np.ndim(v) else v for k, v in PARAMETERS[name].items()}
        p |= {"inertia": np.zeros(6)} if name.startswith("payload") else {}
        joint = None if name in ("payload", "payload_change", "base_tilt") else 1
        text, said = urdf_of(model(arm, (name, joint, p)))
        assert said or text != arm.urdf, name


def test_a_robot_without_urdf_has_none(arm):
    """A robot from elsewhere gets an MJCF and no URDF."""
    out = exported(model(replace(arm, urdf="")))
    assert (out.urdf, out.urdf_lacks, out.mjcf_lacks) == ("", (), ())
    assert mujoco.MjModel.from_xml_string(out.mjcf).nu == 3


def test_why_a_log_is_not_replayed(arm):
    """Torques behind the gear, and currents without gains, are no motors' torques; the note says which."""
    log = Log("arm", arm.joints, "command", "N m", 1000.0, ())
    assert why_not(log) == "" and why_not(replace(log, torque_side="unknown")) == ""
    assert "link side of the gears" in why_not(replace(log, torque_side="link"))
    assert "drive gains" in why_not(replace(log, torque_unit="A"))
