"""Rigid-body dynamics against Pinocchio: torques, their derivatives and the regressor, on chains and trees."""
# pyright: reportAttributeAccessIssue=false

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pinocchio as pin
import pytest

from invdyn_cli.maths import rigid_body
from invdyn_cli.robots import load_urdf, pinocchio_model
from invdyn_cli.urdf import BUILT_IN

LINK = """<link name="{name}"><inertial><mass value="{mass}"/><origin xyz="{com}" rpy="0.3 -0.2 0.1"/>
    <inertia ixx="0.03" ixy="0.002" ixz="-0.001" iyy="0.04" iyz="0.003" izz="0.02"/></inertial></link>"""
JOINT = """<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
    <origin xyz="0.05 -0.1 0.3" rpy="0.4 -0.5 0.6"/><axis xyz="{axis}"/>
    <limit lower="-2" upper="2" effort="50" velocity="3"/></joint>"""
AXES = ("0 0 1", "0 1 1", "1 -2 0.5", "0 -1 0", "1 0 0")
FILES = ("kuka_lwr4", "iiwa14", "ur10e", "panda_no_hand", "panda")
EXACT = 1e-9
"""Relative to a joint's largest torque; the issue asks for it, float64 has six decades more."""


def branch(side: str, kinds: tuple[str, ...]) -> str:
    """A chain of lopsided links on the base, joints <side>1, <side>2, … of these types about skew axes."""
    parts, parent = [], "base"
    for i, kind in enumerate(kinds):
        child = f"{side}link{i + 1}"
        parts.append(LINK.format(name=child, mass=0.5 + i, com=f"0.0{i} -0.03 0.1"))
        parts.append(JOINT.format(name=f"{side}{i + 1}", kind=kind, parent=parent, child=child, axis=AXES[i % 5]))
        parent = child
    return "".join(parts)


def urdf(*branches: str) -> str:
    base = LINK.format(name="base", mass=5, com="0 0 0")
    return f'<?xml version="1.0"?><robot name="made">{base}{"".join(branches)}</robot>'


MADE = {
    "slides and turns": (urdf(branch("j", ("prismatic", "continuous", "prismatic", "revolute"))), None),
    "two arms": (
        urdf(branch("a", ("revolute", "continuous", "revolute")), branch("b", ("revolute", "prismatic"))),
        ["b1", "a1", "a2", "b2", "a3"],
    ),
}


@pytest.fixture(scope="module")
def make(tmp_path_factory, real_data):
    """A robot by its name here, and the URDF file that it was read from."""

    def robot(name):
        joints = None
        if name in FILES:
            file = real_data(f"urdf/{name}.urdf")
        elif name in MADE:
            text, joints = MADE[name]
            file = tmp_path_factory.mktemp("urdf") / "made.urdf"
            file.write_text(text)
        else:
            file = BUILT_IN[name]
        read = load_urdf(file, joints=joints)
        return replace(read, name="", joints=tuple(f"j{i}" for i in range(read.dofs)), urdf="", notes=()), read, file

    return robot  # names and text are cleared, so that arms of one build are compiled once


def states(n: int, samples: int = 200) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """q, qd, qdd (n, samples), fast and all around."""
    rng = np.random.default_rng(n)
    return rng.uniform(-np.pi, np.pi, (n, samples)), rng.normal(0, 2, (n, samples)), rng.normal(0, 5, (n, samples))


class Oracle:
    """Pinocchio on one of its models: torques (n, samples) and regressors (10 n, n, samples) of named joints."""

    def __init__(self, model: pin.Model, names, gravity) -> None:
        model.gravity.linear = np.asarray(gravity)
        self.model, self.data = model, model.createData()
        self.joints = [model.joints[model.getJointId(name)] for name in names]
        self.columns = [10 * (model.getJointId(name) - 1) + k for name in names for k in range(10)]

    def _each(self, function, motion) -> np.ndarray:
        rows = [joint.idx_v for joint in self.joints]
        out = []
        for q, qd, qdd in zip(*(x.T for x in motion), strict=True):
            full, v, a = pin.neutral(self.model), np.zeros(self.model.nv), np.zeros(self.model.nv)
            for joint, value in zip(self.joints, q, strict=True):
                at = slice(joint.idx_q, joint.idx_q + joint.nq)
                full[at] = (np.cos(value), np.sin(value)) if joint.nq == 2 else value
            v[rows], a[rows] = qd, qdd
            out.append(np.array(function(self.model, self.data, full, v, a))[rows])
        return np.moveaxis(np.array(out), 0, -1)

    def torques(self, motion) -> np.ndarray:
        return self._each(pin.rnea, motion)

    def regressor(self, motion) -> np.ndarray:
        return self._each(pin.computeJointTorqueRegressor, motion)[:, self.columns].swapaxes(0, 1)


def assert_close(mine, theirs, relative=EXACT):
    """Equal to a share of each joint's largest value (joints first); one that feels nothing counts by the others."""
    mine, theirs = np.asarray(mine), np.asarray(theirs)
    size = np.abs(theirs).reshape(len(theirs), -1).max(axis=1)
    size = np.maximum(size, 1e-6 * size.max())
    worst = np.abs(mine - theirs).reshape(len(theirs), -1).max(axis=1) / size
    assert (worst <= relative).all(), worst


inverse_dynamics = jax.jit(rigid_body.inverse_dynamics)
regressor = jax.jit(rigid_body.regressor)


@pytest.mark.parametrize("name", ["apollo_arm", *MADE, *FILES])
def test_torques_are_pinocchios(make, name):
    """Torques of chains, trees, sliding and endless joints are Pinocchio's, from our arrays and from the URDF."""
    robot, read, file = make(name)
    motion = states(robot.dofs)
    mine = inverse_dynamics(robot, robot.inertial, *motion)
    assert_close(mine, Oracle(pinocchio_model(read), read.joints, read.gravity).torques(motion))
    if not any("locked" in note for note in read.notes):
        assert_close(mine, Oracle(pin.buildModelFromUrdf(str(file)), read.joints, read.gravity).torques(motion))


@pytest.mark.parametrize("name", ["apollo_arm", *MADE, *FILES])
def test_regressor_is_pinocchios(make, name):
    """The regressor is Pinocchio's, entry by entry, and times the inertial parameters it gives the torque."""
    robot, read, _ = make(name)
    motion = states(robot.dofs, 100)
    mine = np.asarray(regressor(robot, *motion))
    theirs = Oracle(pinocchio_model(read), read.joints, read.gravity).regressor(motion)
    assert_close(mine.reshape(theirs.shape).swapaxes(0, 1), theirs.swapaxes(0, 1))
    torque = np.einsum("jcis,jc->is", mine, robot.inertial)
    assert_close(inverse_dynamics(robot, robot.inertial, *motion), torque)


def test_any_parameters_will_do(make):
    """Torque is linear in parameters that no body has: negative masses, zero, inertias without a mass."""
    robot, *_ = make("two arms")
    motion = states(robot.dofs, 200)
    parameters = np.random.default_rng(0).normal(size=(robot.dofs, 10))
    parameters[0, 0] = 0.0
    torque = np.einsum("jcis,jc->is", regressor(robot, *states(robot.dofs, 200)), parameters)
    assert_close(inverse_dynamics(robot, parameters, *motion), torque)


def test_derivatives_are_pinocchios(make):
    """Automatic derivatives by q, qd and qdd are Pinocchio's analytic ones; the last is the mass matrix."""
    robot, read, _ = make("apollo_arm")
    model = pinocchio_model(read)
    data = model.createData()
    motion = states(robot.dofs, 20)
    torque = jax.jit(jax.vmap(jax.jacfwd(rigid_body.inverse_dynamics, argnums=(2, 3, 4)), (None, None, 1, 1, 1)))
    mine = torque(robot, robot.inertial, *motion)
    samples = zip(*(x.T for x in motion), strict=True)
    theirs = [[np.array(x) for x in pin.computeRNEADerivatives(model, data, *sample)] for sample in samples]
    for one, other in zip(mine, zip(*theirs, strict=True), strict=True):
        assert_close(np.moveaxis(one, 1, 0), np.moveaxis(np.array(other), 1, 0))


def test_gradient_at_rest_is_finite(make):
    """Reverse-mode gradients by motion and parameters are finite at q = qd = qdd = 0 too."""
    robot, *_ = make("slides and turns")
    zero = jnp.zeros(robot.dofs)
    power = jax.jit(jax.grad(lambda *x: rigid_body.inverse_dynamics(robot, *x).sum(), argnums=(0, 1, 2, 3)))
    assert all(np.isfinite(x).all() for x in power(jnp.asarray(robot.inertial), zero, zero, zero))


def test_batches_are_samples_one_by_one(make):
    """One sample (n,), several batch axes (n, 2, 3) and vmap over samples are the rows of one call, to rounding."""
    robot, *_ = make("slides and turns")
    motion = states(robot.dofs, 6)
    torque, rows = inverse_dynamics(robot, robot.inertial, *motion), regressor(robot, *motion)
    boxed = [x.reshape(-1, 2, 3) for x in motion]
    assert_close(inverse_dynamics(robot, robot.inertial, *boxed).reshape(torque.shape), torque, 1e-12)
    assert_close(regressor(robot, *boxed).reshape(rows.shape), rows, 1e-12)
    for sample in (0, 5):
        one = [x[:, sample] for x in motion]
        assert_close(inverse_dynamics(robot, robot.inertial, *one), torque[:, sample], 1e-12)
    mapped = jax.jit(jax.vmap(rigid_body.inverse_dynamics, (None, None, 1, 1, 1), 1))
    assert_close(mapped(robot, robot.inertial, *motion), torque, 1e-12)


def test_a_free_motion_keeps_its_energy(make):
    """Along any motion the joints' power is the rate of kinetic and potential energy, taken from the mass matrix."""
    robot, read, _ = make("slides and turns")
    model = pinocchio_model(read)
    data = model.createData()
    t = np.linspace(-1e-3, 1e-3, 5)
    speed, phase = np.array([1.0, 2.0, 3.0, 0.7]), np.arange(4.0)
    angle = speed * t[:, None] + phase
    q, qd, qdd = np.sin(angle), speed * np.cos(angle), -(speed**2) * np.sin(angle)
    energy = [
        pin.computeKineticEnergy(model, data, *x) + pin.computePotentialEnergy(model, data, x[0])
        for x in zip(q, qd, strict=True)
    ]
    rate = np.polyfit(t, energy, 4)[3]  # the slope at t = 0 of the polynomial through five points
    power = qd[2] @ np.asarray(inverse_dynamics(robot, robot.inertial, q[2], qd[2], qdd[2]))
    assert power == pytest.approx(rate, rel=1e-7)  # the sixth derivative times (1 ms)^4 and 1e-16 / 1 ms are below


def test_carries_knows_the_tree(make):
    """A joint carries its own link and those behind it, and no link of the other arm."""
    robot, read, _ = make("two arms")
    rows = zip(read.joints, rigid_body.carries(robot), strict=True)
    carried = {name: {read.joints[j] for j in np.flatnonzero(row)} for name, row in rows}
    assert carried == {"a1": {"a1", "a2", "a3"}, "a2": {"a2", "a3"}, "a3": {"a3"}, "b1": {"b1", "b2"}, "b2": {"b2"}}


def test_random_states_fill_the_ranges(make):
    """Random states stay within the joints' limits, reach 95 % of them, and turn endless joints all around."""
    robot, *_ = make("slides and turns")
    q, qd, qdd = rigid_body.random_states(robot, 1000, seed=0)
    low, high = np.array([-2, -np.pi, -2, -2]), np.array([2, np.pi, 2, 2])
    assert (q >= low[:, None]).all() and (q <= high[:, None]).all() and (np.ptp(q, axis=1) > 0.95 * (high - low)).all()
    assert q.shape == qd.shape == qdd.shape == (4, 1000)
