"""Every effect that can be hidden shows in the log as DESIGN, section 6, says: logged = nominal + term.

The nominal torque is Pinocchio's, of the true motion (noise-free positions, differentiated); the terms are written out
here anew. Both are filtered alike; the torque is the mean of what was held before and after t.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
import pytest
from scipy.signal import butter, sosfiltfilt

from invdyn_cli.robots import load_urdf, pinocchio_model
from invdyn_cli.simulation.hidden import KINDS, Hidden
from invdyn_cli.simulation.plant import simulate
from invdyn_cli.simulation.references import Multisine

RATE, SECONDS = 1000.0, 12.0


@dataclass(frozen=True)
class Truth:
    """What the term of an effect on joint column i may depend on; arrays (T, n)."""

    t: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    nominal: np.ndarray
    logged: np.ndarray


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
        "asymmetric_coulomb_friction",
        "arm_joint_3",
        {"positive": 2.0, "negative": 1.0},
        lambda x, i: np.where(x.qd[:, i] > 0, 2.0, -1.0),
    ),
    Case("stribeck_friction", "arm_joint_4", {"coulomb": 1.0, "static": 1.5, "velocity": 0.1}, stribeck),
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
    Case("torque_offset", "arm_joint_5", {"offset": 0.8}, lambda x, i: np.full(len(x.t), 0.8)),
    Case("torque_gain_error", "arm_joint_2", {"gain": 0.8}, lambda x, i: 0.2 * x.logged[:, i]),
)


def filtered(x: np.ndarray) -> np.ndarray:
    """(T, n) through a zero-phase low-pass at 20 Hz, a second off either end."""
    return sosfiltfilt(butter(4, 20.0, fs=RATE, output="sos"), x, axis=0)[1000:-1000]


def rms(x: np.ndarray, axis=None):
    """Root of the mean square."""
    return np.sqrt((x**2).mean(axis))


def rests(qd: np.ndarray) -> np.ndarray:
    """(T - 2000,) whether a joint rests within 0.1 s, where sign(qd) is not defined and the filter carries it."""
    slow = (np.abs(qd) < 0.01).astype(float)
    return np.convolve(slow, np.ones(201), "same")[1000:-1000] > 0.5


def truth(robot, trajectory, offset=0.0) -> Truth:
    """The true motion by central differences, Pinocchio's torque of it, and the logged one at its middle."""
    q = trajectory.q - offset
    qd, qdd = np.gradient(q, 1 / RATE, axis=0), np.zeros_like(q)
    qdd[1:-1] = np.diff(q, 2, axis=0) * RATE**2
    model = pinocchio_model(robot)
    data = model.createData()
    nominal = np.array([pin.rnea(model, data, *rows) for rows in zip(q, qd, qdd, strict=True)])
    logged = np.concatenate([trajectory.tau[:1], (trajectory.tau[1:] + trajectory.tau[:-1]) / 2])
    return Truth(trajectory.t, q, qd, qdd, nominal, logged)


@pytest.fixture(scope="module")
def apollo():
    """All seven joints."""
    return load_urdf("apollo_arm")


def recorded(robot, *hidden: Hidden, **options):
    """Twelve seconds of a multisine."""
    return simulate(robot, Multisine(), hidden, duration=SECONDS, rate=RATE, seed=2, **options)


@pytest.mark.parametrize("case", CASES, ids=lambda c: f"{c.effect}-{c.joint}")
def test_term(case, apollo):
    """The logged torque of a hidden effect is the nominal one plus its term, to 0.5 % of the term, and no other
    joint shows anything."""
    x = truth(apollo, recorded(apollo, Hidden(case.effect, case.joint, case.parameters)))
    i = apollo.joints.index(case.joint)
    term = np.zeros_like(x.q)
    term[:, i] = case.term(x, i)
    left = filtered(x.logged) - filtered(x.nominal + term)
    moving = ~rests(x.qd[:, i])
    size = rms(filtered(term)[moving, i])
    share = rms(left[moving], 0) / rms(filtered(x.nominal + term)[moving], 0)
    print(case.effect, case.joint, rms(left[moving, i]) / size, share.max(), moving.mean())
    assert rms(left[moving, i]) < 0.005 * size
