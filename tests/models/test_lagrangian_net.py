"""Lagrangian net: what holds whatever it learned (energy, mass matrix), and what it learns."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from invdyn_cli.errors import UsageError
from invdyn_cli.maths.metrics import nmse
from invdyn_cli.models.ffnn import Ffnn
from invdyn_cli.models.lagrangian_net import LagrangianNet
from invdyn_cli.robots import load_urdf, pinocchio_model
from invdyn_cli.testing import check_model
from invdyn_cli.types import Fit, Motion
from tests.records import make_dataset, make_robot
from tests.sine_arm import error, sine_tasks

KEY = jax.random.key(0)
SMALL = LagrangianNet(hidden=(8,), epochs=2, batch_size=32)


@pytest.fixture(scope="module")
def data():
    return make_dataset(make_robot(("a", "b", "c")), np.random.default_rng(0), samples=80)


def test_contract():
    """It keeps the contract of a model, of an arm with a joint that slides too."""
    robot = make_robot(("a", "b"), (False, True))
    check_model(SMALL, make_dataset(robot, np.random.default_rng(0), samples=60))


def fresh(model: LagrangianNet, data) -> Fit:
    return Fit(model.init(data, KEY), data.robot, data.joints, 0)


def test_energy_is_conserved_without_friction(data):
    """Along any motion the work of the torques is the change of kinetic and potential energy, to float32 and the step
    of the integral, with random weights: nothing of it was learned. The work is fifty times what it may be off."""
    model = replace(SMALL, friction=False)
    fit = fresh(model, data)
    t = np.linspace(0, 1, 4001)[:, None]
    rate, phase = np.array([2.0, 3.0, 2.5]), np.array([0.0, 1.0, 2.0])
    motion = Motion(np.sin(rate * t + phase), rate * np.cos(rate * t + phase), -(rate**2) * np.sin(rate * t + phase))
    power = (model.predict(fit, motion) * motion.qd).sum(1)
    work = np.trapezoid(power, t[:, 0])

    def energy(row: int) -> float:
        q = np.asarray(motion.q[row], np.float32)
        slides = np.zeros(3, bool)
        mass, potential = model._energy(fit.params["nets"], fit.params, slides, q)
        return float(0.5 * motion.qd[row] @ np.asarray(mass, float) @ motion.qd[row] + potential)

    assert work == pytest.approx(energy(-1) - energy(0), abs=1e-4 * np.abs(power).max())
    assert abs(work) > 5e-3 * np.abs(power).max()


def mass_matrix(model: LagrangianNet, fit: Fit, q: np.ndarray) -> np.ndarray:
    """Its columns are the torques of unit accelerations at rest, less those of none."""
    n = len(q)
    accelerations = np.concatenate([np.zeros((1, n)), np.eye(n)])
    tau = model.predict(fit, Motion(np.tile(q, (n + 1, 1)), np.zeros((n + 1, n)), accelerations))
    return (tau[1:] - tau[0]).T


def test_mass_matrix_is_positive_definite(data):
    """The mass matrix is symmetric and positive definite, with random weights, too: nothing of it was learned."""
    columns = mass_matrix(SMALL, fresh(SMALL, data), np.array([0.3, -1.0, 2.0]))
    np.testing.assert_allclose(columns, columns.T, atol=1e-5 * np.abs(columns).max())
    assert np.linalg.eigvalsh(columns).min() > 0


def test_learns_an_arm_and_its_mass_matrix():
    """On the paper's interpolation split it leaves less than 1 % of the variance and, trained on as many epochs, less
    than half of what a net without structure leaves; its mass matrix, of which no data told, is the arm's to 10 %."""
    train, test = sine_tasks()
    model = LagrangianNet(hidden=(32, 32), friction=False, epochs=200, batch_size=32)
    fit = model.fit(train, KEY)
    assert (error(model, fit, test) < 0.01).all()
    net = Ffnn(epochs=200)
    assert error(model, fit, test).mean() < 0.5 * error(net, net.fit(train, KEY), test).mean()
    robot = load_urdf("apollo_arm", dofs=2)
    q = np.asarray(test.motion.q[100])
    true = true_mass_matrix(robot, q)
    assert np.abs(mass_matrix(model, fit, q) - true).max() < 0.1 * true.max()


def true_mass_matrix(robot, q: np.ndarray) -> np.ndarray:
    """By Pinocchio's composite rigid bodies."""
    import pinocchio as pin

    model = pinocchio_model(robot)
    mass = pin.crba(model, model.createData(), q)
    return np.triu(mass) + np.triu(mass, 1).T


def test_friction_is_found():
    """With Coulomb friction of 1.5 N m and viscous friction of 0.5 N m s/rad in the torques, it finds both to 10 %."""
    train, test = sine_tasks()

    def rubbed(data):
        def more(x):
            return replace(x, tau=x.tau + 1.5 * np.clip(x.motion.qd / 0.02, -1, 1) + 0.5 * x.motion.qd)

        return replace(data, trajectories=tuple(more(x) for x in data.trajectories))

    model = LagrangianNet(hidden=(32, 32), epochs=200, batch_size=32)
    fit = model.fit(rubbed(train), KEY)
    np.testing.assert_allclose(fit.details["coulomb"], 1.5, rtol=0.1)
    np.testing.assert_allclose(fit.details["viscous"], 0.5, rtol=0.1)
    assert (nmse(rubbed(test).tau, model.predict(fit, test.motion)) < 0.01).all()


def test_bad_options():
    """Options outside their ranges are refused by name."""
    for option, value in {"hidden": [0], "epochs": 0, "learning_rate": 0.0}.items():
        with pytest.raises(UsageError, match=f"model.{option}="):
            LagrangianNet(**{option: value})
