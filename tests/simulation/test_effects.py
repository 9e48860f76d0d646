"""Every effect that can be hidden shows in the log with its sign: logged = nominal + term.

The terms are written out here anew. What has memory is in test_memory.py, what comes and goes in test_events.py.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
import pytest

from invdyn_cli.errors import UsageError
from invdyn_cli.simulation.control import Control
from invdyn_cli.simulation.hidden import KINDS, Hidden, assemble
from invdyn_cli.simulation.plant import simulate
from invdyn_cli.simulation.references import Multisine
from tests.simulation.recorded import RATE, Truth, filtered, middle, recorded, rests, rms, truth


@dataclass(frozen=True)
class Case:
    """An effect, its joint, its parameters, and its term: Truth, column -> (T,) for a joint."""

    effect: str
    joint: str | None
    parameters: dict
    term: Callable | None = None


def stribeck(x: Truth, i: int) -> np.ndarray:
    """(coulomb + (static - coulomb) exp(-(qd / velocity)^2)) sign(qd)"""
    return (1.0 + 0.5 * np.exp(-((x.qd[:, i] / 0.1) ** 2))) * np.sign(x.qd[:, i])


CASES = (
    Case("viscous_friction", "arm_joint_2", {"damping": 3.0}, lambda x, i: 3.0 * x.qd[:, i]),
    Case("viscous_friction", "arm_joint_7", {"damping": 0.5}, lambda x, i: 0.5 * x.qd[:, i]),
    Case("coulomb_friction", "arm_joint_2", {"coulomb": 2.0}, lambda x, i: 2.0 * np.sign(x.qd[:, i])),
    Case("coulomb_friction", "arm_joint_6", {"coulomb": 0.5}, lambda x, i: 0.5 * np.sign(x.qd[:, i])),
    Case(
        "coulomb_friction",
        "arm_joint_5",
        {"coulomb": 0.5, "transition": 0.01},
        lambda x, i: 0.5 * np.tanh(x.qd[:, i] / 0.01),
    ),
    Case(
        "asymmetric_coulomb_friction",
        "arm_joint_3",
        {"positive": 2.0, "negative": 1.0},
        lambda x, i: np.where(x.qd[:, i] > 0, 2.0, -1.0),
    ),
    Case("stribeck_friction", "arm_joint_4", {"coulomb": 1.0, "static": 1.5, "velocity": 0.1}, stribeck),
    Case(
        "stribeck_friction",
        "arm_joint_2",
        {"coulomb": 1.0, "static": 1.5, "velocity": 0.1, "exponent": 1.0},
        lambda x, i: (1.0 + 0.5 * np.exp(-np.abs(x.qd[:, i]) / 0.1)) * np.sign(x.qd[:, i]),
    ),
    Case(
        "load_dependent_friction",
        "arm_joint_2",
        {"mu": 0.1},
        lambda x, i: 0.1 * np.abs(x.nominal[:, i]) * np.sign(x.qd[:, i]),
    ),
    Case("quadratic_friction", "arm_joint_1", {"drag": 2.0}, lambda x, i: 2.0 * x.qd[:, i] * np.abs(x.qd[:, i])),
    Case(
        "thermal_friction_drift",
        "arm_joint_1",
        {"cold": 5.0, "warm": 2.0, "time_constant": 4.0},
        lambda x, i: (2.0 + 3.0 * np.exp(-x.t / 4.0)) * x.qd[:, i],
    ),
    Case(
        "torque_ripple",
        "arm_joint_1",
        {"amplitude": 0.7, "cycles": 6.0, "phase": 0.4},
        lambda x, i: 0.7 * np.sin(6.0 * x.q[:, i] + 0.4),
    ),
    Case("joint_spring", "arm_joint_3", {"stiffness": 4.0, "rest": 0.3}, lambda x, i: 4.0 * (x.q[:, i] - 0.3)),
    Case("rotor_inertia", "arm_joint_7", {"armature": 0.2}, lambda x, i: 0.2 * x.qdd[:, i]),
    Case("torque_offset_drift", "arm_joint_5", {"rate": 0.3}, lambda x, i: 0.3 * x.t),
    Case("torque_offset", "arm_joint_5", {"offset": 0.8}, lambda x, i: np.full(len(x.t), 0.8)),
    Case("torque_gain_error", "arm_joint_2", {"gain": 0.8}, lambda x, i: 0.2 * x.logged[:, i]),
)


@pytest.mark.parametrize("case", CASES, ids=lambda c: f"{c.effect}-{c.joint}")
def test_term(case, apollo):
    """The logged torque is the nominal one plus the term, to 0.1 % of the term or of the torque, on its joint and all
    others: the steps are of second order but for damping, which is half a step (0.125 ms) early."""
    x = truth(apollo, recorded(apollo, Hidden(case.effect, case.joint, case.parameters)))
    i = apollo.joints.index(case.joint)
    term = np.zeros_like(x.q)
    term[:, i] = case.term(x, i)
    left = filtered(x.logged) - filtered(x.nominal + term)
    moving = ~rests(x.qd[:, i])
    assert rms(left[moving, i]) < 1e-3 * rms(filtered(term)[moving, i])
    assert np.all(rms(left[moving], 0) < 1e-3 * rms(filtered(x.nominal + term)[moving], 0))


@pytest.mark.parametrize("ratio", [1.0, -0.6])
def test_a_shared_drive(ratio, apollo):
    """A drive that turns with joint 6 and `ratio` times joint 5: with s its speed, 0.4 sign(s) + 0.3 s + 0.02 ds/dt on
    joint 6, `ratio` times as much on joint 5, nothing on others, to 0.3 % of it."""
    given = {"coulomb": 0.4, "damping": 0.3, "armature": 0.02, "ratio": ratio}
    x = truth(apollo, recorded(apollo, Hidden("coupled_friction", "arm_joint_6", given)))
    s, ds = (v[:, 5] + ratio * v[:, 4] for v in (x.qd, x.qdd))
    drive = 0.4 * np.sign(s) + 0.3 * s + 0.02 * ds
    term = np.zeros_like(x.q)
    term[:, 5], term[:, 4] = drive, ratio * drive
    left = filtered(x.logged) - filtered(x.nominal + term)
    moving = ~rests(s)
    assert np.all(rms(left[moving][:, 4:6], 0) < 3e-3 * rms(filtered(term)[moving][:, 4:6], 0))
    assert np.all(rms(left[moving], 0) < 2e-3 * rms(filtered(x.nominal + term)[moving], 0))


def test_a_shared_drive_behind_a_sensor(apollo):
    """A torque that is taken behind the gear, at the link, has nothing of it."""
    given = {"coulomb": 0.4, "damping": 0.3, "armature": 0.02, "ratio": 1.0}
    hidden = [Hidden("coupled_friction", "arm_joint_6", given)]
    tr = simulate(apollo, Multisine(), hidden, duration=3.0, rate=RATE, torque_side="link", seed=1)
    clean = simulate(apollo, Multisine(), duration=3.0, rate=RATE, torque_side="link", seed=1)
    difference = filtered(tr.tau - clean.tau)
    assert np.all(rms(difference, 0) < 0.01)


def test_clean(apollo):
    """Without effects the logged torque is the nominal one, to 2e-4 of it on every joint."""
    x = truth(apollo, recorded(apollo))
    assert np.all(rms(filtered(x.logged) - filtered(x.nominal), 0) < 2e-4 * rms(filtered(x.nominal), 0))


def test_sticks_at_rest(apollo):
    """Dry friction holds a joint: while it rests, the torque may be anything below it, and the joint creeps
    by less than 2e-5 rad/s."""
    tr = simulate(
        apollo, Multisine(), [Hidden("coulomb_friction", "arm_joint_4", {"coulomb": 200.0})],
        duration=2.0, control=Control(knows="nominal"),
    )  # fmt: skip
    assert np.ptp(tr.q[:, 3]) < 4e-5
    assert np.abs(tr.tau[:, 3]).max() < 200.0


def about(inertial: np.ndarray, *bodies: pin.Inertia) -> np.ndarray:
    """Ten parameters with other bodies added."""
    return inertial + sum(body.toDynamicParameters() for body in bodies)


def heavier(inertial: np.ndarray) -> np.ndarray:
    """Link 3 with 0.5 kg more, its centre of mass 1, -2, 3 cm on, and 20 % more inertia about it."""
    body = pin.Inertia.FromDynamicParameters(inertial)
    com = body.lever + np.array([0.01, -0.02, 0.03])
    return pin.Inertia(body.mass + 0.5, com, 1.2 * body.inertia).toDynamicParameters()


BODIES = {
    "payload": (
        Hidden("payload", None, {"mass": 2.0, "com": [0.03, -0.02, 0.1], "radius": 0.04}),
        lambda r: replace(
            r,
            inertial=np.vstack(
                [r.inertial[:-1], about(r.inertial[-1], pin.Inertia.FromSphere(2.0, 0.04).se3Action(
                    pin.SE3(np.eye(3), np.array([0.03, -0.02, 0.1])))),
                ]
            ),
        ),
    ),
    "link_inertia_error": (
        Hidden("link_inertia_error", "arm_joint_3", {"mass": 0.5, "com": [0.01, -0.02, 0.03], "inertia": 0.2}),
        lambda r: replace(r, inertial=np.vstack([r.inertial[:2], heavier(r.inertial[2]), r.inertial[3:]])),
    ),
    "base_tilt": (
        Hidden("base_tilt", None, {"angle": 0.2, "azimuth": 0.7}),
        lambda r: replace(
            r, gravity=9.81 * np.array([np.sin(0.2) * np.cos(0.7), np.sin(0.2) * np.sin(0.7), -np.cos(0.2)])
        ),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BODIES)
def test_other_bodies(name, apollo):
    """A payload, another link and a tilted base are what Pinocchio makes of the robot so changed, to 2e-4."""
    hidden, changed = BODIES[name]
    tr = recorded(apollo, hidden)
    x, plain = truth(changed(apollo), tr), truth(apollo, tr)
    assert np.all(rms(filtered(x.logged) - filtered(x.nominal), 0) < 2e-4 * rms(filtered(x.nominal), 0))
    assert rms(filtered(plain.logged) - filtered(plain.nominal)) > 0.01 * rms(filtered(x.nominal))


def test_encoder_offset(apollo):
    """What is logged is the true angle plus the offset; the torques are those of the true angle."""
    tr = recorded(apollo, Hidden("encoder_offset", "arm_joint_2", {"offset": 0.05}))
    x = truth(apollo, tr, offset=np.eye(7)[1] * 0.05)
    assert np.all(rms(filtered(x.logged) - filtered(x.nominal), 0) < 2e-4 * rms(filtered(x.nominal), 0))
    assert np.abs(tr.q - tr.q_ref).max() < 0.01


@pytest.mark.parametrize("delay", [0.004, 0.0125])
def test_delay(delay, apollo):
    """What a joint gets is what was logged so much before, also for delays that are no whole samples."""
    tr = recorded(apollo, Hidden("torque_delay", "arm_joint_2", {"delay": delay}))
    x, late = truth(apollo, tr), round(delay * RATE * 4)
    fine = np.repeat(tr.tau[:, 1], 4)
    got = np.concatenate([np.full(late, fine[0]), fine])[: len(fine)].reshape(-1, 4).mean(1)
    assert rms(filtered(middle(got[:, None]))[:, 0] - filtered(x.nominal)[:, 1]) < 2e-4 * rms(x.nominal[:, 1])


def test_a_late_log(apollo):
    """Of a negative delay the log has the torque that much late; the arm moves as without it."""
    plain, late = (recorded(apollo, Hidden("torque_delay", "arm_joint_2", {"delay": x})) for x in (0.0, -0.006))
    np.testing.assert_array_equal(late.q, plain.q)
    behind = round(0.006 * RATE)
    np.testing.assert_allclose(late.tau[behind:, 1], plain.tau[:-behind, 1], atol=1e-9)
    others = np.arange(7) != 1
    np.testing.assert_array_equal(late.tau[:, others], plain.tau[:, others])


def test_a_filtered_log(apollo):
    """Of a negative lag the log has the torque, which is held for each sample, behind a first-order filter; the arm
    moves as without it."""
    plain = recorded(apollo)
    late = recorded(apollo, Hidden("actuator_lag", "arm_joint_2", {"time_constant": -0.01}))
    np.testing.assert_array_equal(late.q, plain.q)
    wanted = [plain.tau[0, 1]]
    for held in plain.tau[:-1, 1]:
        wanted.append(held + (wanted[-1] - held) * np.exp(-1 / (RATE * 0.01)))
    np.testing.assert_allclose(late.tau[:, 1], wanted, atol=1e-9)
    others = np.arange(7) != 1
    np.testing.assert_array_equal(late.tau[:, others], plain.tau[:, others])


def test_lag(apollo):
    """What a joint gets is what was logged behind a first order lag, exactly, for a torque that is held."""
    tr = recorded(apollo, Hidden("actuator_lag", "arm_joint_2", {"time_constant": 0.01}))
    x, forget = truth(apollo, tr), np.exp(-1 / (RATE * 0.01))
    got, y = np.empty(len(tr.tau)), tr.tau[0, 1]
    for k, u in enumerate(tr.tau[:, 1]):  # the mean over each sample, and the state at its end
        got[k] = u + (y - u) * (1 - forget) * RATE * 0.01
        y = u + (y - u) * forget
    assert rms(filtered(middle(got[:, None]))[:, 0] - filtered(x.nominal)[:, 1]) < 2e-4 * rms(x.nominal[:, 1])


def test_saturation(apollo):
    """What a joint gets is what was logged, within the limits, and they are met."""
    limit = 0.9 * np.abs(recorded(apollo).tau[:, 1]).max()
    tr = recorded(apollo, Hidden("torque_saturation", "arm_joint_2", {"limit": limit}))
    got = np.clip(tr.tau, *np.outer([-1, 1], np.where(np.arange(7) == 1, limit, np.inf)))
    assert np.abs(tr.tau[:, 1]).max() > 1.01 * limit
    x = truth(apollo, tr)
    assert np.all(rms(filtered(middle(got)) - filtered(x.nominal), 0) < 5e-4 * rms(filtered(x.nominal), 0))


def test_custom(apollo):
    """A force that no catalogue knows is a term like the others: of one joint, or of all at once."""
    one = Hidden("custom", "arm_joint_1", {"force": lambda t, q, qd: 0.5 * np.sin(3 * t) * q})
    all_ = Hidden("custom", None, {"force": lambda t, q, qd: np.eye(7)[1] * 0.3 * q[0]})
    x = truth(apollo, recorded(apollo, one, all_))
    term = np.zeros_like(x.q)
    term[:, 0], term[:, 1] = 0.5 * np.sin(3 * x.t) * x.q[:, 0], 0.3 * x.q[:, 0]
    left = rms(filtered(x.logged) - filtered(x.nominal + term), 0)
    assert np.all(left < 2e-4 * rms(filtered(x.logged), 0))
    assert np.all(left[:2] < 5e-3 * rms(filtered(term), 0)[:2])


def test_behind_the_gear(apollo):
    """A torque taken at the link is the nominal one: friction, rotor, gain and offset do not show in it."""
    hidden = [
        Hidden("coulomb_friction", "arm_joint_2", {"coulomb": 3.0}),
        Hidden("rotor_inertia", "arm_joint_2", {"armature": 1.0}),
        Hidden("torque_gain_error", "arm_joint_2", {"gain": 0.7}),
        Hidden("torque_offset", "arm_joint_2", {"offset": 1.0}),
    ]
    tr = recorded(apollo, *hidden, torque_side="link")
    x = truth(apollo, tr)
    moving = ~rests(x.qd[:, 1])
    left = filtered(tr.tau) - filtered(x.nominal)
    assert np.all(rms(left[moving], 0) < 1e-3 * rms(filtered(x.nominal), 0))


def test_effects_add_up(apollo):
    """Two effects on one joint, and two of one kind, act together."""
    hidden = [
        Hidden("viscous_friction", "arm_joint_1", {"damping": 1.0}),
        Hidden("quadratic_friction", "arm_joint_1", {"drag": 2.0}),
        Hidden("thermal_friction_drift", "arm_joint_1", {"cold": 3.0, "warm": 3.0, "time_constant": 1.0}),
        Hidden("joint_spring", "arm_joint_1", {"stiffness": 2.0, "rest": 0.5}),
        Hidden("joint_spring", "arm_joint_1", {"stiffness": 1.0, "rest": -0.5}),
    ]
    x = truth(apollo, recorded(apollo, *hidden))
    q, qd = x.q[:, 0], x.qd[:, 0]
    term = 4.0 * qd + 2.0 * qd * np.abs(qd) + 2.0 * (q - 0.5) + (q + 0.5)
    left = filtered(x.logged - x.nominal)[:, 0] - filtered(term[:, None])[:, 0]
    assert rms(left) < 1e-3 * rms(term)


WRONG = (
    (Hidden("coulomb", "arm_joint_1", {}), "no effect 'coulomb'.*allowed: viscous_friction"),
    (Hidden("coulomb_friction", "arm_joint_9", {"coulomb": 1.0}), "no joint 'arm_joint_9', did you mean"),
    (Hidden("coulomb_friction", None, {"coulomb": 1.0}), "names no joint"),
    (Hidden("payload", "arm_joint_1", {"mass": 1.0, "com": [0, 0, 0]}), "whole arm"),
    (Hidden("coulomb_friction", "arm_joint_1", {}), "lacks coulomb"),
    (Hidden("coulomb_friction", "arm_joint_1", {"coulomb": 1.0, "viscous": 1.0}), "no parameter 'viscous'"),
    (Hidden("coulomb_friction", "arm_joint_1", {"coulomb": -1.0}), "coulomb=-1.0; allowed: a number from 0"),
    (Hidden("payload", None, {"mass": 1.0, "com": [0, 0]}), "allowed: three numbers"),
    (Hidden("link_inertia_error", "arm_joint_1", {"mass": -9.0}), "allowed: above -2.7"),
    (Hidden("custom", "arm_joint_1", {"force": 3.0}), "allowed: a function"),
    (
        Hidden("coupled_friction", "arm_joint_1", {"coulomb": 1.0, "damping": 0.1, "ratio": 1.0}),
        "arm_joint_1: it is the first joint",
    ),
)


@pytest.mark.parametrize(("hidden", "said"), WRONG, ids=[said for _, said in WRONG])
def test_refuses(hidden, said, apollo):
    """An effect, joint or parameter that cannot be is refused in one line that says what is allowed."""
    with pytest.raises(UsageError, match=said):
        assemble(apollo, [hidden])


def test_every_effect_is_tested():
    """No effect can be hidden that is not recovered here, or in the tests of memory and events."""
    other = {"torque_delay", "actuator_lag", "torque_saturation", "encoder_offset", "coupled_friction", "custom"}
    memory = {"presliding_hysteresis", "backlash", "joint_elasticity"}
    events = {"torque_gain_change", "payload_change", "external_contact"}
    assert {case.effect for case in CASES} | set(BODIES) | other | memory | events == set(KINDS)
