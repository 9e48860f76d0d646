r"""Rigid-body dynamics in JAX: inverse dynamics and the joint-torque regressor, in the base frame.

Arrays put joints first and samples last, q (n, *batch), and a 3-vector is a tuple of three such rows: XLA then sees
nothing but elementwise work on long rows, which it fuses and vectorises. The same code serves one sample (n,), a
trajectory (n, T), and `jax.vmap`.

One outward recursion (`lax.scan` over joints) says how every link moves in the base frame: Newton and Euler's forward
pass (Luh, Walker and Paul 1980), gravity as an acceleration of the base. After it there is no recursion left: with all
wrenches about the base's origin, joint i feels the sum over the links that it carries, and its torque is their power
along its twist.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from invdyn_cli.types import Array, Robot

PARAMETERS = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
"""Parameters of a link in the order of `Robot.inertial`: mass, first moments, inertia about the frame's origin."""

Row = Array
Vector = tuple[Row, ...]  # x, y, z
Rotation = tuple[Vector, ...]  # three rows


class LinkMotion(NamedTuple):
    """How all links move, in the base frame, rows (n, *batch): pose (rows of the rotation link -> base, origin),
    angular velocity and acceleration, acceleration of the origin less gravity, and the joint's own twist (angular,
    linear at the base's origin) for unit joint speed."""

    rotation: Rotation
    origin: Vector
    omega: Vector
    alpha: Vector
    a: Vector
    twist: tuple[Vector, Vector]


@jax.jit
def inverse_dynamics(robot: Robot, inertial: Array, q: Array, qd: Array, qdd: Array) -> Array:
    """Torques tau (n, *batch) [N m; N] of the motion q, qd, qdd (n, *batch) with the inertials (n, 10).

    `robot` gives kinematics and gravity; the inertials are a separate argument because they are learned.
    """
    links = link_motions(robot, q, qd, qdd)
    omega, alpha, a = _in_link_frames(links)
    phi = _over(jnp.asarray(inertial).T, jnp.ndim(q))
    mass, first = phi[0], (phi[1], phi[2], phi[3])
    inertia = (phi[4], phi[5], phi[7]), (phi[5], phi[6], phi[8]), (phi[7], phi[8], phi[9])
    force = _add(_scale(mass, a), _add(_cross(alpha, first), _cross(omega, _cross(omega, first))))
    moment = _add(_rotate(inertia, alpha), _cross(omega, _rotate(inertia, omega)))
    moment = _add(moment, _cross(first, a))
    force = _rotate(links.rotation, force)
    moment = _add(_rotate(links.rotation, moment), _cross(links.origin, force))
    carried = jnp.asarray(carries(robot), float)
    force, moment = (tuple(jnp.tensordot(carried, x, 1) for x in v) for v in (force, moment))
    w, u = links.twist
    return _dot(w, moment) + _dot(u, force)


@jax.jit
def regressor(robot: Robot, q: Array, qd: Array, qdd: Array) -> Array:
    """The joint-torque regressor transposed, (n links, 10 parameters, n joints, *batch) for a motion (n, *batch).

    tau_i = sum_jc regressor[j, c, i] psi[j, c] (paper, equation 5: tau = K psi): the twist of joint i is carried to
    link j, and multiplied with the link's own 6 x 10 regressor. Zero where joint i does not carry link j.
    """
    links = link_motions(robot, q, qd, qdd)
    omega, alpha, a = _in_link_frames(links)
    w, u = links.twist

    carried = jnp.asarray(carries(robot).T, float)

    def at_link(j):
        rotation, origin, carried = j
        carried = _over(carried, jnp.ndim(q))
        u_j = _add(u, _cross(w, origin))
        return _rotate_back(rotation, _scale(carried, w)), _rotate_back(rotation, _scale(carried, u_j))

    twists = jax.lax.map(at_link, (links.rotation, links.origin, carried))
    rows = jax.lax.map(lambda j: _power(*j[0], *j[1]), (twists, (omega, alpha, a)))
    return jnp.stack(rows, axis=1)


@jax.jit
def force_columns(robot: Robot, link: Array | int, point: Array, q: Array) -> Array:
    """Torques (3, n, *batch) that hold unit forces along the base's axes at a point (3,) [m] of a link's frame, in
    postures q (n, *batch): -J' of that point (its velocity is w x point + u for each joint's twist)."""
    still = jnp.zeros_like(q)
    links = link_motions(robot, q, still, still)
    w, u = links.twist
    rotation, origin = jax.tree.map(lambda x: x[link], (links.rotation, links.origin))
    moved = _add(u, _cross(w, _add(origin, _rotate(rotation, tuple(jnp.asarray(point))))))
    carried = _over(jnp.asarray(carries(robot), float)[:, link], jnp.ndim(q))
    return -jnp.stack(_scale(carried, moved))


def link_motions(robot: Robot, q: Array, qd: Array, qdd: Array) -> LinkMotion:
    """Outward recursion: the motion of every link for joint motions q, qd, qdd (n, *batch)."""
    q, qd, qdd = (jnp.asarray(x) for x in (q, qd, qdd))
    slides = np.array(robot.prismatic)
    turns = jnp.where(_over(slides, q.ndim), 0.0, 1.0)
    joints = {
        "index": jnp.arange(robot.dofs),
        "parent": jnp.asarray(robot.parents) + 1,
        "slides": jnp.asarray(slides, float),
        "axis": jnp.asarray(robot.axis),
        "offset": tuple(jnp.asarray(robot.translation).T),
        "along": tuple(jnp.einsum("nij,nj->in", robot.rotation, robot.axis)),
        "turn": jax.vmap(_turn_coefficients)(jnp.asarray(robot.rotation), jnp.asarray(robot.axis)),
        "sin": turns * jnp.sin(q),
        "vers": turns * (1 - jnp.cos(q)),
        "q": q,
        "qd": qd,
        "qdd": qdd,
    }
    buffer = jnp.zeros((robot.dofs + 1, *q.shape[1:]))
    base = tuple(tuple(buffer.at[0].set(float(r == c)) for c in range(3)) for r in range(3))
    still = (buffer, buffer, buffer)
    falling = tuple(buffer.at[0].set(-g) for g in jnp.asarray(robot.gravity))

    def outward(state, joint):
        rotation, origin, omega, alpha, a = jax.tree.map(lambda x: x[joint["parent"]], state)
        constant, sine, vers = joint["turn"]
        turn = tuple(
            tuple(constant[r, c] + sine[r, c] * joint["sin"] + vers[r, c] * joint["vers"] for c in range(3))
            for r in range(3)
        )
        slide = joint["slides"]
        offset = _rotate(rotation, _add(joint["offset"], _scale(slide * joint["q"], joint["along"])))
        columns = tuple(_rotate(rotation, tuple(turn[r][c] for r in range(3))) for c in range(3))
        rotation_i = tuple(tuple(columns[c][r] for c in range(3)) for r in range(3))
        axis = _rotate(rotation, joint["along"])
        swept = _cross(omega, _scale(joint["qd"], axis))
        a = _add(a, _add(_cross(alpha, offset), _cross(omega, _cross(omega, offset))))
        a = _add(a, _scale(slide, _add(_scale(joint["qdd"], axis), _scale(2.0, swept))))
        alpha = _add(alpha, _scale(1 - slide, _add(_scale(joint["qdd"], axis), swept)))
        omega = _add(omega, _scale((1 - slide) * joint["qd"], axis))
        here = rotation_i, _add(origin, offset), omega, alpha, a
        return jax.tree.map(lambda x, new: x.at[joint["index"] + 1].set(new), state, here), None

    state, _ = jax.lax.scan(outward, (base, still, still, still, falling), joints)
    rotation, origin, omega, alpha, a = jax.tree.map(lambda x: x[1:], state)
    axis = _rotate(rotation, tuple(_over(x, q.ndim) for x in jnp.asarray(robot.axis).T))
    twist = _scale(turns, axis), _add(_scale(turns, _cross(origin, axis)), _scale(1 - turns, axis))
    return LinkMotion(rotation, origin, omega, alpha, a, twist)


def carries(robot: Robot) -> np.ndarray:
    """(n, n) bool: whether joint i (row) carries link j (column)."""
    matrix = np.eye(robot.dofs, dtype=bool)
    for j, parent in enumerate(robot.parents):
        if parent >= 0:
            matrix[:, j] |= matrix[:, parent]
    return matrix


def random_states(robot: Robot, samples: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random states q, qd, qdd (n, samples) over the joints' whole ranges, to determine the structural rank."""
    rng = np.random.default_rng(seed)
    low = np.where(np.isfinite(robot.lower), robot.lower, -np.pi)[:, None]
    high = np.where(np.isfinite(robot.upper), robot.upper, np.pi)[:, None]
    shape = (robot.dofs, samples)
    return rng.uniform(low, high, shape), rng.normal(size=shape), rng.normal(size=shape)


def _power(w: Vector, u: Vector, omega: Vector, alpha: Vector, a: Vector) -> tuple[Row, ...]:
    """The 10 rows: power of a link's wrench along the twist (w, u), all in the link's frame, per inertial parameter."""
    first = _add(_add(_cross(u, alpha), _cross(_cross(u, omega), omega)), _cross(a, w))
    y = _cross(w, omega)

    def second(r: int, s: int) -> Row:
        if r == s:
            return w[r] * alpha[r] + y[r] * omega[r]
        return w[r] * alpha[s] + w[s] * alpha[r] + y[r] * omega[s] + y[s] * omega[r]

    return _dot(u, a), *first, second(0, 0), second(0, 1), second(1, 1), second(0, 2), second(1, 2), second(2, 2)


def _turn_coefficients(at_zero: Array, axis: Array) -> tuple[Array, Array, Array]:
    """(3, 3) each: `at_zero` times a turn about `axis` is first + second sin + third (1 - cos) (Rodrigues)."""
    x, y, z = axis
    skew = jnp.array([[0 * x, -z, y], [z, 0 * x, -x], [-y, x, 0 * x]])
    return at_zero, at_zero @ skew, at_zero @ skew @ skew


def _in_link_frames(links: LinkMotion) -> tuple[Vector, ...]:
    return tuple(_rotate_back(links.rotation, x) for x in (links.omega, links.alpha, links.a))


def _over(x: Array, ndim: int) -> Array:
    """x (..., n) as (..., n, 1, ...): one value per joint, the same for all samples of an array with `ndim` axes."""
    return jnp.reshape(x, (*jnp.shape(x), *(1,) * (ndim - 1)))


def _rotate(rotation: Rotation, v: Vector) -> Vector:
    return _dot(rotation[0], v), _dot(rotation[1], v), _dot(rotation[2], v)


def _rotate_back(rotation: Rotation, v: Vector) -> Vector:
    first, second, third = (_scale(v[r], rotation[r]) for r in range(3))
    return _add(_add(first, second), third)


def _cross(x: Vector, y: Vector) -> Vector:
    return x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]


def _add(x: Vector, y: Vector) -> Vector:
    return x[0] + y[0], x[1] + y[1], x[2] + y[2]


def _scale(factor: Row | float, v: Vector) -> Vector:
    return factor * v[0], factor * v[1], factor * v[2]


def _dot(x: Vector, y: Vector) -> Row:
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]
