"""The MJCF of a robot with effects: plain MuJoCo loads it, and it is that robot."""

from dataclasses import replace

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from experiments.arms import random_robot
from experiments.truth import mjcf_of
from invdyn_cli.diagnosis.extension import exported
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.composition import EffectInstance
from invdyn_cli.effects.description import ExtendedModel
from invdyn_cli.errors import UsageError
from invdyn_cli.joints import SimulatorTerms
from invdyn_cli.robots import load_urdf
from invdyn_cli.simulation.arm import GEAR
from invdyn_cli.simulation.hidden import Hidden, assemble
from invdyn_cli.simulation.mjcf import Part, written
from invdyn_cli.types import Robot
from tests.simulation.test_arm import difference, tree

ROUNDING = 1e-9
"""Relative to the largest torque: text keeps all digits, MuJoCo finds principal axes by iteration."""

PARAMETERS = {
    "viscous_friction": {"damping": 0.3},
    "coulomb_friction": {"coulomb": 0.4},
    "asymmetric_coulomb_friction": {"positive": 0.5, "negative": 0.2},
    "stribeck_friction": {"coulomb": 0.4, "static": 0.7, "velocity": 0.05},
    "load_dependent_friction": {"mu": 0.1},
    "quadratic_friction": {"drag": 0.2},
    "presliding_hysteresis": {"coulomb": 0.4, "stiffness": 100.0},
    "thermal_friction_drift": {"cold": 0.9, "warm": 0.3, "time_constant": 9.0},
    "coupled_friction": {"coulomb": 0.4, "damping": 0.3, "armature": 0.02, "ratio": -1.0},
    "torque_offset_drift": {"rate": 0.01},
    "backlash": {"gap": 0.01},
    "joint_elasticity": {"stiffness": 4000.0},
    "torque_ripple": {"amplitude": 0.2, "cycles": 12.0, "phase": 0.3},
    "joint_spring": {"stiffness": 2.0, "rest": 0.4},
    "rotor_inertia": {"armature": 0.1},
    "torque_gain_error": {"gain": 0.9},
    "torque_gain_change": {"gain": 0.9},
    "torque_offset": {"offset": 0.3},
    "torque_delay": {"delay": 0.012},
    "actuator_lag": {"time_constant": 0.01},
    "torque_saturation": {"limit": 9.0},
    "payload": {"mass": 0.7, "com": (0.01, 0.02, 0.08)},
    "payload_change": {"mass": 0.7, "com": (0.01, 0.02, 0.08)},
    "external_contact": {"force": (1.0, 2.0, 3.0)},
    "link_inertia_error": {"mass": 0.3, "moment": (0.01, 0.0, 0.02), "inertia": (0.01, 0, 0.01, 0, 0, 0.01)},
    "base_tilt": {"angle": 0.1, "azimuth": 0.7},
    "encoder_offset": {"offset": 0.03},
}
"""Of every effect of the catalogue."""


@pytest.fixture(scope="module")
def arm() -> Robot:
    return random_robot(np.random.default_rng(3), 4)


def mjcf_with(robot: Robot, *effects: tuple[str, str | None, dict]) -> tuple[str, tuple[str, ...]]:
    """The MJCF of a robot with effects of the catalogue, and what it lacks."""
    made = []
    for name, joint, parameters in effects:
        p = {k: np.asarray(v, float) if np.ndim(v) else v for k, v in parameters.items()}
        p |= {"inertia": np.zeros(6)} if name.startswith("payload") and "inertia" not in p else {}
        made.append(EffectInstance(EFFECTS[name], None if joint is None else robot.joints.index(joint), p))
    out = exported(ExtendedModel(robot, tuple(made)))
    return out.mjcf, out.mjcf_lacks


def test_a_robot_alone_is_itself(arm):
    """Mass matrix, bias forces and gravity of drawn, branched and sliding robots are Pinocchio's; nothing is said."""
    branched = np.array(tree().inertial)
    branched[:, [4, 6, 9]] += 8.0  # kg m^2 about all axes alike: with so much, any of them is a real body
    branched = replace(tree(), inertial=branched, damping=np.zeros(6), friction=np.zeros(6))
    for robot in (load_urdf("apollo_arm"), arm, branched):
        text, said = written(robot)
        assert difference(robot, mujoco.MjModel.from_xml_string(text)) < ROUNDING and said == ()


def test_bodies_gravity_and_encoders(arm):
    """Payload, other inertials, tilt and encoder offset make the arm that `hidden` makes of them."""
    effects = [
        Hidden("payload", None, PARAMETERS["payload"]),
        Hidden("link_inertia_error", "axis2", {"mass": 0.2, "com": (0.01, 0.0, -0.02), "inertia": 0.3}),
        Hidden("base_tilt", None, PARAMETERS["base_tilt"]),
    ]
    made = assemble(arm, effects)
    ball = made.carried[0]
    sphere = pin.Inertia(ball.mass, np.array(ball.com), 0.4 * ball.mass * ball.radius**2 * np.eye(3))
    made.inertial[-1] += sphere.toDynamicParameters()
    other = replace(arm, inertial=made.inertial, gravity=made.gravity)
    text, said = mjcf_of(arm, [*effects, Hidden("encoder_offset", "axis2", {"offset": 0.1})])
    assert difference(other, mujoco.MjModel.from_xml_string(text), encoder=0.1) < ROUNDING and said == ()


def test_a_change_of_inertials_is_added(arm):
    """mass, moment and inertia of a link_inertia_error are added to the link's row; a point mass is a part of it."""
    row = np.concatenate([np.atleast_1d(np.asarray(x, float)) for x in PARAMETERS["link_inertia_error"].values()])
    x, y, z = com = np.array([0.01, 0.02, 0.08])
    point = 0.7 * np.array([1, *com, y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y])
    inertial = np.array(arm.inertial)
    inertial[2] += row
    inertial[-1] += point
    text, _ = mjcf_with(
        arm,
        ("link_inertia_error", "axis3", PARAMETERS["link_inertia_error"]),
        ("payload", None, {"mass": 0.7, "com": com, "inertia": np.zeros(6)}),
    )
    assert difference(replace(arm, inertial=inertial), mujoco.MjModel.from_xml_string(text)) < ROUNDING


def test_every_effect_is_held_or_said(arm):
    """No effect of the catalogue is left out without a message."""
    nominal, _ = written(arm)
    for name, effect in EFFECTS.items():
        text, said = mjcf_with(arm, (name, "axis2" if effect.of_joint else None, PARAMETERS[name]))
        mujoco.MjModel.from_xml_string(text)
        assert text != nominal, name
        assert said or "<!--" not in text
        assert all(x in text for x in said)
        if "left out" in " ".join(said):
            assert [x for x in text.splitlines() if "<!--" not in x] == nominal.splitlines()


def test_names_are_those_of_the_urdf(arm):
    """Bodies are called like the URDF's links; motors like the joints, in their order."""
    model = mujoco.MjModel.from_xml_string(written(arm)[0])
    assert [model.body(i + 1).name for i in range(4)] == ["link1", "link2", "link3", "link4"]
    assert [model.actuator(i).name for i in range(model.nu)] == list(arm.joints)
    assert [model.joint(i).name for i in range(model.njnt)] == list(arm.joints)
    assert model.jnt_range == pytest.approx(np.stack([arm.lower, arm.upper], axis=1))


def force(text: str, ctrl, seconds: float) -> np.ndarray:
    """Force of the second motor after each step under ctrl(t)."""
    model = mujoco.MjModel.from_xml_string(text)
    data, out = mujoco.MjData(model), []
    for _ in range(round(seconds / model.opt.timestep)):
        data.ctrl[1] = ctrl(data.time)
        mujoco.mj_step(model, data)
        out.append(data.actuator_force[1])
    return np.array(out)


def test_a_late_motor_is_late(arm):
    """What is commanded arrives after the delay: a ramp is the delay's share lower, to a tenth of a millisecond."""
    text, _ = mjcf_with(arm, ("torque_delay", "axis2", {"delay": 0.0123}))
    t = 5e-4 * np.arange(200)
    got = force(text, lambda now: 10 * now, 0.1)
    assert got[100:] == pytest.approx(10 * (t[100:] - 0.0123), abs=10 * 1e-4)


def test_gain_then_limit_then_offset(arm):
    """A motor gives clip(gain x ctrl, limit) - offset, slowly where it lags."""
    effects = [
        ("torque_gain_error", "axis2", {"gain": 0.8}),
        ("torque_saturation", "axis2", {"limit": 3.0}),
        ("torque_offset", "axis2", {"offset": 0.5}),
    ]
    text, said = mjcf_with(arm, *effects)
    assert said == ()
    for ctrl, wanted in ((1.0, 0.3), (9.0, 2.5), (-9.0, -3.5)):
        assert force(text, lambda now, x=ctrl: x, 0.005)[-1] == pytest.approx(wanted, rel=1e-12)
    slow, _ = mjcf_with(arm, *effects, ("actuator_lag", "axis2", {"time_constant": 0.02}))
    got = force(slow, lambda now: 1.0, 0.02)
    assert got[-1] == pytest.approx(0.8 * (1 - np.exp(-1)) - 0.5, abs=0.8 * 0.025)  # a step is 2.5 % of the constant


def test_a_gear_is_a_second_joint(arm):
    """Play and elasticity are a second joint about the same axis, moved by no motor; the rotor that they need is said
    where it is not known."""
    effects = [("backlash", "axis2", {"gap": 0.02}), ("joint_elasticity", "axis3", {"stiffness": 500.0})]
    text, said = mjcf_with(arm, *effects, ("rotor_inertia", "axis2", {"armature": 0.05}))
    model = mujoco.MjModel.from_xml_string(text)
    assert (model.nu, model.njnt) == (4, 6) and len(said) == 1 and "axis3" in said[0]
    gap, spring = model.joint("axis2" + GEAR), model.joint("axis3" + GEAR)
    assert gap.range == pytest.approx([-0.01, 0.01]) and gap.limited[0] and not gap.stiffness.any()
    assert spring.stiffness[0] == 500.0 and not spring.limited[0]
    assert np.array_equal(spring.axis, model.joint("axis3").axis)


def test_what_no_body_could_be_is_corrected_and_said(arm):
    """A change that leaves a link with a negative mass still loads, with a sentence that names the link."""
    change = {"mass": -1.2 * arm.inertial[2, 0], "moment": np.zeros(3), "inertia": np.zeros(6)}
    text, said = mjcf_with(arm, ("link_inertia_error", "axis3", change))
    model = mujoco.MjModel.from_xml_string(text)
    assert model.body("link3").mass[0] > 0
    assert any(x.startswith("link3: its inertials") for x in said)


def test_wrong_joints_are_refused(arm):
    """An effect on a joint that is not there names those that are."""
    with pytest.raises(UsageError, match="allowed: axis1, axis2, axis3, axis4"):
        written(arm, [Part("elbow", "Coulomb friction", SimulatorTerms({"friction": 1.0}))])
