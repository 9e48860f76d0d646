"""Signs, units and order of the effects, against an arm that shares no code with them.

Each effect is hidden in a MuJoCo arm without noise; the model with that effect must predict what is logged. Motion
comes from central differences of the logged angles, the torque at t is the mean of what was held before and after; both
pass the same filter. `tests/simulation/test_effects.py` holds the same logs against the formulas written out.
"""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from experiments.cases import SIZES, draw_effect, draw_scene, inverse_dynamics
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.composition import EffectInstance, TimeWindow
from invdyn_cli.effects.description import ExtendedModel
from invdyn_cli.effects.rigid import rigid_torque
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.simulation.plant import simulate
from invdyn_cli.simulation.references import Multisine
from invdyn_cli.types import Motion, Robot
from tests.simulation.recorded import RATE, filtered, middle, rests, rms

SECONDS, JOINT = 7.0, 1
SHARES = {name: 2e-3 for name in SIZES} | {
    "actuator_lag": 5e-3,
    "torque_delay": 5e-3,
    "joint_elasticity": 0.05,
    "backlash": 0.1,
}
"""Of the effect that may be left: the plant's own error (a permille, `docs/plant.md`), twice; lag and delay are a
derivative of the torque, and the held torque's steps are part of them. A spring's damping is 0.3 of critical, in the
plant 0.02: a phase of 2 x 0.28 x frequency / resonance, 0.05 at a tenth of it. The blow at the end of play comes at a
sample, in the plant it takes some milliseconds."""

WINDOW = (2.5, 4.5)
"""[s] of what comes and goes."""


@pytest.fixture(scope="module")
def scene():
    """A three-joint arm on a multisine."""
    drawn = draw_scene(np.random.default_rng(0), 3)
    return replace(drawn, reference=Multisine(), duration=SECONDS)


@pytest.fixture(scope="module")
def clean(scene):
    """It, with nothing hidden."""
    return simulate(scene.robot, scene.reference, duration=SECONDS, seed=3)


def motion_of(q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(T, n) angles -> angles, velocities, accelerations."""
    qdd = np.zeros_like(q)
    qdd[1:-1] = np.diff(q, 2, axis=0) * RATE**2
    return q, np.gradient(q, 1 / RATE, axis=0), qdd


def told(hidden: Hidden, robot: Robot) -> dict:
    """The plant's parameters as the catalogue has them; bodies by Pinocchio's inertias."""
    p = {k: np.asarray(v, float) if np.ndim(v) else float(v) for k, v in hidden.parameters.items()}
    if hidden.effect in ("payload", "payload_change"):
        own = 0.4 * p["mass"] * 0.02**2  # a sphere of 2 cm
        return {"mass": p["mass"], "com": p["com"], "inertia": np.array([own, 0, own, 0, 0, own])}
    if hidden.effect == "link_inertia_error":
        old = pin.Inertia.FromDynamicParameters(robot.inertial[JOINT])
        new = pin.Inertia(old.mass + p["mass"], old.lever + p["com"], (1 + p["inertia"]) * old.inertia)
        change = new.toDynamicParameters() - robot.inertial[JOINT]
        return {"mass": change[0], "moment": change[1:4], "inertia": change[4:]}
    return {k: v for k, v in p.items() if k in EFFECTS[hidden.effect].parameters}


def acting_of(hidden: Hidden, robot: Robot) -> tuple[EffectInstance, ...]:
    """The same effect of the catalogue, and the rotor that the plant puts before a gear that yields."""
    joint = None if hidden.joint is None else robot.joints.index(hidden.joint)
    when = TimeWindow("run", *hidden.parameters["window"]) if "window" in hidden.parameters else None
    one = EffectInstance(EFFECTS[hidden.effect], joint, told(hidden, robot), when)
    if "rotor" not in hidden.parameters:
        return (one,)
    return one, EffectInstance(EFFECTS["rotor_inertia"], joint, {"armature": float(hidden.parameters["rotor"])})


@pytest.mark.parametrize("name", [n for n in SIZES if n != "torque_saturation"])
def test_the_model_predicts_the_hidden_effect(name, scene, clean):
    """With the effect the model leaves no more of the logged torque than a few permille of what the effect makes, on
    all joints together: formula, sign and units are right."""
    hidden = draw_effect(np.random.default_rng(1), scene, name, 2 if name == "external_contact" else JOINT)
    if "window" in hidden.parameters:
        hidden = replace(hidden, parameters={**hidden.parameters, "window": WINDOW})
    log = simulate(scene.robot, scene.reference, [hidden], duration=SECONDS, seed=3, position_side="motor")
    motion, acting = motion_of(log.q), acting_of(hidden, scene.robot)
    with_it, without = (ExtendedModel(scene.robot, a).predict(*motion, log.t, "run") for a in (acting, acting[1:]))
    floor = filtered(middle(clean.tau)) - filtered(ExtendedModel(scene.robot, ()).predict(*motion_of(clean.q), clean.t))
    speed = motion[1][:, JOINT]
    if "ratio" in hidden.parameters:  # of the drive that the joint before turns as well
        speed = speed + hidden.parameters["ratio"] * motion[1][:, JOINT - 1]
    moving = ~rests(speed)
    logged, made = filtered(middle(log.tau)), filtered(with_it) - filtered(without)
    left = rms((logged - filtered(with_it))[moving])
    assert rms(made[moving]) > 20 * rms(floor)
    assert left < SHARES[name] * rms(made[moving]) + rms(floor), left / rms(made[moving])


def test_a_saturation_delivers_what_moves_the_arm(scene, clean):
    """The nominal torque of the motion is the logged one clipped, to a permille of what a limit at the 95 % quantile of
    the torque cuts off, beside the plant's own error (3e-4)."""
    limit = {"limit": float(np.quantile(np.abs(clean.tau[:, JOINT]), 0.95))}
    hidden = Hidden("torque_saturation", scene.robot.joints[JOINT], limit)
    log = simulate(scene.robot, scene.reference, [hidden], duration=SECONDS, seed=3)
    nominal = ExtendedModel(scene.robot, ()).predict(*motion_of(log.q), log.t)[:, JOINT]
    delivered = EFFECTS["torque_saturation"].delivered(limit, log.tau[:, JOINT], RATE)
    cut = filtered(middle(log.tau[:, JOINT]) - middle(delivered))
    assert rms(cut) > 0.01 * rms(nominal)
    assert rms(filtered(middle(delivered) - nominal)) < 1e-3 * rms(cut) + 3e-4 * rms(nominal)


def test_effects_are_composed_in_their_order(scene):
    """A gain scales all that lies behind it, friction of the gear carries the payload: logged = (inverse dynamics of
    the changed arm + terms) / gain, in whatever order the effects are given."""
    robot, draw = scene.robot, np.random.default_rng(0)
    q, qd, qdd = draw.normal(size=(3, 50, 3))
    acting = (
        EffectInstance(EFFECTS["torque_gain_error"], 2, {"gain": 0.8}),
        EffectInstance(EFFECTS["load_dependent_friction"], 2, {"mu": 0.1}),
        EffectInstance(
            EFFECTS["payload"], None, {"mass": 1.0, "com": np.array([0.0, 0.02, 0.1]), "inertia": np.zeros(6)}
        ),
        EffectInstance(EFFECTS["encoder_offset"], 1, {"offset": 0.1}),
    )
    inertial = np.array(robot.inertial)
    inertial[-1] += pin.Inertia(1.0, np.array([0.0, 0.02, 0.1]), np.zeros((3, 3))).toDynamicParameters()
    body = inverse_dynamics(replace(robot, inertial=inertial), q - np.array([0, 0.1, 0]), qd, qdd)
    wanted = body.copy()
    wanted[:, 2] = (body[:, 2] + 0.1 * np.abs(body[:, 2]) * np.sign(qd[:, 2])) / 0.8
    t = np.arange(50) / 100
    for order in (acting, acting[::-1]):
        np.testing.assert_allclose(ExtendedModel(robot, order).predict(q, qd, qdd, t), wanted, atol=1e-9)


def test_long_motions_are_chunked(scene):
    """Torques of more samples than a chunk holds are those of Pinocchio, sample by sample."""
    draw = np.random.default_rng(0)
    q, qd, qdd = draw.normal(size=(3, 3, 5000))
    wanted = inverse_dynamics(scene.robot, q.T, qd.T, qdd.T).T
    np.testing.assert_allclose(rigid_torque(scene.robot, Motion(q, qd, qdd)), wanted, atol=1e-8)
