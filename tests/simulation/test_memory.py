"""Effects with memory: bristles that bend before they slide, gears with play, gears that are springs.

Sizes are drawn at random, for the joints of the built-in arm, whose inertias span four orders of magnitude. Terms are
written out here anew, along the logged motion of motor and link.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from scipy.interpolate import make_interp_spline

from invdyn_cli.errors import UsageError
from invdyn_cli.robots import load_urdf, pinocchio_model
from invdyn_cli.simulation import gear
from invdyn_cli.simulation.control import Control
from invdyn_cli.simulation.hidden import Hidden, assemble
from invdyn_cli.simulation.plant import simulate
from invdyn_cli.simulation.references import AbstractReference, Multisine, PickPlace
from invdyn_cli.types import Motion, Robot
from tests.simulation.recorded import RATE, SECONDS, filtered, recorded, rms, truth

FINE = 20
"""Steps of the independent integration within a sample."""


def carried(robot) -> np.ndarray:
    """(n,) [kg m^2] that each joint carries in the middle of its range, by Pinocchio."""
    model = pinocchio_model(robot)
    middle = (np.asarray(robot.lower) + np.asarray(robot.upper)) / 2
    return np.diagonal(pin.crba(model, model.createData(), middle)).copy()


def dahl(t, q, coulomb: float, bend: float) -> np.ndarray:
    """(T,) force of bristles that slide when bent by `bend`, along a motion q (T,), straight at first: small Euler
    steps of dF/dq = coulomb / bend (1 - F sign(qd) / coulomb)."""
    fine = make_interp_spline(t, q, k=3)(np.arange((len(t) - 1) * FINE + 1) / (RATE * FINE))
    force = np.zeros(len(fine))
    for k, way in enumerate(np.diff(fine)):
        force[k + 1] = force[k] + coulomb / bend * way * (1 - force[k] * np.sign(way) / coulomb)
    return force[::FINE]


def drawn_bristle(seed: int) -> tuple[int, float, float]:
    """Joint, coulomb and bend: friction that the joint's inertia would feel as 5 to 50 rad/s^2, sliding after 0.3 to
    10 mrad."""
    draw = np.random.default_rng([1, seed])
    joint = int(draw.integers(7))
    coulomb = carried(load_urdf("apollo_arm"))[joint] * np.exp(draw.uniform(np.log(5), np.log(50)))
    return joint, float(coulomb), float(np.exp(draw.uniform(np.log(3e-4), np.log(1e-2))))


@pytest.mark.parametrize(
    "size", [*map(drawn_bristle, range(2)), (6, 0.5, 3e-4)], ids=lambda x: f"joint{x[0]}-{x[1]:.2g}"
)
def test_bristles(size, apollo):
    """What bristles add to the torque is Dahl's equation along the logged motion, to 1 % (a wrist of 2.4e-4 kg m^2 on
    0.5 N m that slides after 0.3 mrad among them), and is not Coulomb's; other joints feel nothing of it."""
    i, coulomb, bend = size
    hidden = Hidden("presliding_hysteresis", apollo.joints[i], {"coulomb": coulomb, "stiffness": coulomb / bend})
    x = truth(apollo, recorded(apollo, hidden))
    term, sliding = np.zeros_like(x.q), np.zeros_like(x.q)
    term[:, i], sliding[:, i] = dahl(x.t, x.q[:, i], coulomb, bend), coulomb * np.sign(x.qd[:, i])
    left = rms(filtered(x.logged) - filtered(x.nominal + term), 0)
    assert left[i] < 0.01 * rms(filtered(term)[:, i])
    assert rms(filtered(x.logged) - filtered(x.nominal + sliding), 0)[i] > 5 * left[i]
    others = np.arange(7) != i
    assert np.all(left[others] < 1e-3 * rms(filtered(x.nominal), 0)[others])


@dataclass(frozen=True)
class Geared:
    """A joint of the built-in arm whose gear yields, its rotor [kg m^2], and play [rad], or stiffness and damping."""

    effect: str
    joint: int
    rotor: float
    gap: float = 0.0
    stiffness: float = 0.0
    damping: float = 0.0

    def hidden(self, robot) -> Hidden:
        """The effect with all parameters that are not zero."""
        names = ("rotor", "gap", "stiffness", "damping")
        return Hidden(self.effect, robot.joints[self.joint], {n: getattr(self, n) for n in names if getattr(self, n)})


@cache
def alternating() -> list[int]:
    """Joints whose load changes its side in `recorded`'s motion: others lie on one side of their play."""
    robot = load_urdf("apollo_arm")
    model, motion = pinocchio_model(robot), Multisine().motion(robot, SECONDS, 100.0, 2)
    rows = zip(motion.q, motion.qd, motion.qdd, strict=True)
    tau = np.array([pin.rnea(model, model.createData(), *row) for row in rows])
    low, high = np.quantile(tau, [0.1, 0.9], axis=0)
    return [int(i) for i in np.flatnonzero((low < 0) & (high > 0))]


def drawn_gear(effect: str, seed: int) -> Geared:
    """Rotors of 2 to 10 % of what the joint carries; play of 0.3 to 10 mrad; 5 to 40 Hz of the link on its spring."""
    draw = np.random.default_rng([2, seed])
    joint = int(draw.choice(alternating()) if effect == "backlash" else draw.integers(7))
    inertia = float(carried(load_urdf("apollo_arm"))[joint])
    rotor = inertia * float(draw.uniform(0.02, 0.1))
    if effect == "backlash":
        return Geared(effect, joint, rotor, gap=float(np.exp(draw.uniform(np.log(3e-4), np.log(1e-2)))))
    stiffness = float((2 * np.pi * np.exp(draw.uniform(np.log(5), np.log(40)))) ** 2 * inertia)
    return Geared(effect, joint, rotor, stiffness=stiffness, damping=0.04 * float(np.sqrt(stiffness * inertia)))


PLAYS = [drawn_gear("backlash", seed) for seed in range(2)]
SPRINGS = [drawn_gear("joint_elasticity", seed) for seed in range(2)]
BOTH_SIDES = {"position_side": "motor", "link_encoder": True}


@cache
def behind_the_gear(case: Geared):
    """A recording of what the link receives, and of the angles on both sides."""
    robot = load_urdf("apollo_arm")
    return recorded(robot, case.hidden(robot), torque_side="link", **BOTH_SIDES)


def link_of(tr) -> np.ndarray:
    """(T, n) the links' angles of such a recording."""
    assert tr.q_link is not None
    return tr.q_link


def name_of(x: Geared) -> str:
    """For the test's name."""
    return f"{x.effect}-joint{x.joint}-{x.gap or x.stiffness:.2g}"


@pytest.mark.parametrize("case", PLAYS, ids=name_of)
def test_play(case):
    """The link stays within half the gap of the motor to 2 % of it, and touches both sides; other joints are stiff."""
    tr = behind_the_gear(case)
    off = link_of(tr) - tr.q
    half = case.gap / 2
    assert np.abs(off[:, case.joint]).max() < 1.02 * half
    assert off[:, case.joint].max() > 0.98 * half and off[:, case.joint].min() < -0.98 * half
    assert not np.delete(off, case.joint, axis=1).any()


@pytest.mark.parametrize("case", PLAYS, ids=name_of)
def test_nothing_passes_through_play(case, apollo):
    """While the link is free of the motor it receives no torque at all; on the teeth it receives what it needs."""
    tr = behind_the_gear(case)
    i = case.joint
    free = np.abs(link_of(tr) - tr.q)[:, i] < 0.95 * case.gap / 2
    inside = free[:-2] & free[1:-1] & free[2:]
    assert inside.sum() > 5
    assert not tr.tau[1:-1, i][inside].any()
    x = truth(apollo, replace(tr, q=link_of(tr)))
    left = filtered(tr.tau) - filtered(x.nominal)
    assert rms(left[:, i]) < 0.01 * rms(filtered(x.nominal)[:, i])


@pytest.mark.parametrize("case", [*PLAYS, *SPRINGS], ids=name_of)
def test_motor_and_link(case, apollo):
    """Logged torque = rigid torque of the LINK's motion + rotor inertia times the MOTOR's acceleration + friction of
    the motor's speed, on every joint."""
    i, damping = case.joint, 3 * carried(apollo)[case.joint]
    friction = Hidden("viscous_friction", apollo.joints[i], {"damping": damping})
    tr = recorded(apollo, case.hidden(apollo), friction, **BOTH_SIDES)
    motor, link = truth(apollo, tr), truth(apollo, replace(tr, q=link_of(tr)))
    term = np.zeros_like(motor.q)
    term[:, i] = case.rotor * motor.qdd[:, i] + damping * motor.qd[:, i]
    left = filtered(link.logged) - filtered(link.nominal + term)
    assert np.all(rms(left, 0) < 2e-3 * rms(filtered(link.nominal + term), 0))
    assert rms(left[:, i]) < 0.02 * rms(filtered(term)[:, i])


@pytest.mark.parametrize("case", SPRINGS, ids=name_of)
def test_spring(case, apollo):
    """What the link receives is stiffness times deflection and damping times its rate, to 1e-3 of it, and what the
    link's motion needs; other joints are stiff."""
    tr = behind_the_gear(case)
    off = tr.q - link_of(tr)
    rate = np.gradient(off, 1 / RATE, axis=0)
    passed = filtered(case.stiffness * off + case.damping * rate)[:, case.joint]
    x = truth(apollo, replace(tr, q=link_of(tr)))
    assert rms(filtered(tr.tau)[:, case.joint] - passed) < 1e-3 * rms(passed)
    assert np.all(rms(filtered(tr.tau) - filtered(x.nominal), 0) < 1e-3 * rms(filtered(x.nominal), 0))
    assert not np.delete(off, case.joint, axis=1).any()


@dataclass(frozen=True)
class Still(AbstractReference):
    """Rest at zero."""

    def motion(self, robot: Robot, duration: float, rate: float, seed: int) -> Motion:
        """Zeros."""
        return Motion(*np.zeros((3, round(duration * rate), robot.dofs)))


def flywheel(inertia: float) -> Robot:
    """One joint about a vertical axis."""
    body = pin.Inertia(1.0, np.zeros(3), np.diag([inertia] * 3))
    return Robot(
        name="flywheel", joints=("axis",), parents=(-1,), prismatic=(False,), rotation=np.eye(3)[None],
        translation=np.zeros((1, 3)), axis=np.array([[0.0, 0.0, 1.0]]), inertial=body.toDynamicParameters()[None],
        gravity=np.array([0.0, 0.0, -9.81]), lower=np.array([-2.0]), upper=np.array([2.0]),
        velocity_limit=np.full(1, np.inf), effort_limit=np.full(1, np.inf), damping=np.zeros(1), friction=np.zeros(1),
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(3))
def test_resonance(seed):
    """A link M on a spring K that nobody holds swings against its rotor J at sqrt(K / M (1 + M / J)), to 3 %."""
    draw = np.random.default_rng([3, seed])
    m, hz = np.exp(draw.uniform(np.log(1e-3), np.log(3.0))), draw.uniform(5.0, 15.0)
    j, k = m * draw.uniform(0.1, 0.5), (2 * np.pi * hz) ** 2 * m
    spring = Hidden("joint_elasticity", "axis", {"stiffness": k, "rotor": j, "damping": 0.0})
    knock = Hidden("custom", "axis", {"force": lambda t, q, qd: 0.01 * k * (0 < t < 0.005)})
    tr = simulate(flywheel(m), Still(), [spring, knock], duration=2.0, control=Control(frequency=1e-3), **BOTH_SIDES)
    off = (link_of(tr) - tr.q)[20:, 0]
    spectrum = np.abs(np.fft.rfft(off * np.hanning(len(off)), 1 << 16))
    heard = np.argmax(spectrum) * RATE / (1 << 16)
    np.testing.assert_allclose(heard, hz * np.sqrt(1 + m / j), rtol=0.03)


def test_what_is_not_said(apollo):
    """Without a rotor, the motor's is 3 % of what the joint carries in the middle of its range; without a damping, the
    spring's is 2 % of critical for the link on it."""
    for i, inertia in enumerate(carried(apollo)):
        stiff = assemble(apollo, [Hidden("joint_elasticity", apollo.joints[i], {"stiffness": 100.0})])
        (spring,) = stiff.gears
        np.testing.assert_allclose(spring.rotor, 0.03 * inertia)
        np.testing.assert_allclose(spring.damping, 0.02 * 2 * np.sqrt(100.0 * inertia))
    np.testing.assert_allclose(gear.carried(apollo), carried(apollo))


@pytest.mark.parametrize("effect", ["backlash", "joint_elasticity"])
def test_which_side_is_logged(effect, apollo):
    """position_side=link logs the link's angles, motor and unknown the motor's; the controller sees the motor's."""
    hidden = drawn_gear(effect, 4).hidden(apollo)
    both, link, unknown = (
        recorded(apollo, hidden, duration=1.0, **side) for side in (BOTH_SIDES, {"position_side": "link"}, {})
    )
    assert np.array_equal(link.q, link_of(both)) and np.array_equal(unknown.q, both.q)
    assert np.array_equal(link.tau, both.tau) and np.array_equal(unknown.tau, both.tau)
    assert not np.array_equal(both.q, link_of(both))
    assert link.q_link is None and unknown.q_link is None


def test_all_at_once(apollo):
    """An arm with play in two joints, springs in two, bristles in front of either kind and a late torque follows its
    reference to 0.1 rad, whichever way it moves."""
    inertia = carried(apollo)
    names = apollo.joints
    hidden = [
        Hidden("backlash", names[1], {"gap": 5e-3}),
        Hidden("backlash", names[6], {"gap": 1e-2}),
        Hidden("joint_elasticity", names[3], {"stiffness": (2 * np.pi * 10) ** 2 * inertia[3]}),
        Hidden("joint_elasticity", names[5], {"stiffness": (2 * np.pi * 40) ** 2 * inertia[5]}),
        Hidden("presliding_hysteresis", names[1], {"coulomb": 3.0, "stiffness": 3e3}),
        Hidden("presliding_hysteresis", names[5], {"coulomb": 0.1, "stiffness": 3e2}),
        Hidden("torque_delay", names[3], {"delay": 0.005}),
    ]
    for way in (None, PickPlace()):
        tr = recorded(apollo, *hidden, duration=3.0) if way is None else simulate(apollo, way, hidden, duration=6.0)
        assert tr.q_ref is not None and np.abs(tr.q - tr.q_ref).max() < 0.1


def test_refuses(apollo):
    """Two gears in one joint, play without width, and a second encoder beside angles of no known side are refused."""
    name = apollo.joints[0]
    play, spring = Hidden("backlash", name, {"gap": 1e-3}), Hidden("joint_elasticity", name, {"stiffness": 1e3})
    with pytest.raises(UsageError, match=r"on arm_joint_1, which has backlash or joint_elasticity already; allowed"):
        assemble(apollo, [play, spring])
    with pytest.raises(UsageError, match=r"gap=0.0; allowed: a number above 0"):
        assemble(apollo, [Hidden("backlash", name, {"gap": 0.0})])
    with pytest.raises(UsageError, match=r"link_encoder=True with position_side=unknown; allowed: position_side=motor"):
        recorded(apollo, link_encoder=True)
