"""model=lip: one Gaussian process for all joints, whose prior stands on the arm's energies (Lagrangian inspired
polynomial kernel).

Giacomuzzo, Carli, Romeres and Dalla Libera 2023, "A black-box physics-informed estimator based on Gaussian process
regression for robot inverse dynamics identification" (arXiv:2310.06585). The energies of a chain of rigid links are
polynomials in cosine and sine of the angles: link i's kinetic energy of degree two in each of its joints 1 to i and a
square in their velocities, its potential energy of degree one. A kernel spans exactly these; the Euler-Lagrange
operator is linear, so that applying it to both arguments gives the covariance of all torques.

The derivatives are written out (`torque_covariance`): differentiating the energies' kernel for every pair of samples
and joints took about ten times as long. All links share the coefficients of cosines and sines; in the paper each link
has its own.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import cho_solve, solve_triangular

from invdyn_cli.fields import counts
from invdyn_cli.interfaces import AbstractModel, Progress, silent
from invdyn_cli.maths import gaussian_process as gp
from invdyn_cli.maths.regression import REST_SPEED
from invdyn_cli.maths.scaling import spread_rows
from invdyn_cli.types import Array, Dataset, Fit, Motion, PyTree, Robot

CHUNK = 128
"""Samples whose covariances with the support are computed at once: each takes 8 n² bytes per sample of the support."""


class Place(NamedTuple):
    """A joint's part of the energies: cosine and sine of its angle, or its position and zero where it slides, and
    their derivatives."""

    cosine: jax.Array
    sine: jax.Array
    cosine_slope: jax.Array
    sine_slope: jax.Array


class State(NamedTuple):
    """Samples in the model's units, joints first: places, velocities, accelerations, signs of velocities (n, N)."""

    place: Place
    qd: Array
    qdd: Array
    sign: Array


class Product(NamedTuple):
    """A product of the joints' polynomials for pairs of samples (N, M), with its derivatives by the joints of the
    first sample (n, N, M), of the second one, and of both (n, n, N, M)."""

    value: jax.Array
    left: jax.Array
    right: jax.Array
    both: jax.Array

    def times(self, joint: jax.Array, factor: tuple[jax.Array, jax.Array, jax.Array, jax.Array]) -> "Product":
        """With the factor of one more joint, given with its derivatives: by the first, the second, and both."""
        p, a, b, ab = factor
        both = p * self.both
        both = both.at[joint].add(a * self.right).at[:, joint].add(b * self.left).at[joint, joint].add(ab * self.value)
        left, right = p * self.left, p * self.right
        left, right = left.at[joint].add(a * self.value), right.at[joint].add(b * self.value)
        return Product(p * self.value, left, right, both)


@dataclass(frozen=True)
class Lip(AbstractModel):
    """One process for the torques of all joints; needs no URDF, but takes from one which joints slide.

    Covariance of the Lagrangian: sum_i [(sum_(b<=i) s_ib qd_b qd_b')² prod_(b<=i) p2_b + e_i prod_(b<=i) p1_b] with
    p_b = 1 + g_b cos q_b cos q_b' + h_b sin q_b sin q_b', p2 the product of two such factors; all coefficients are
    learned by the evidence of the torques.

    Attributes:
        friction: whether a constant and terms linear in every joint's velocity and its sign are added.
        exact: [samples] largest number for exact inference; its cost grows with the third power of samples x joints.
        inducing: number of samples whose torques carry the posterior beyond, evenly from the training samples.
        hyperparameter_samples: [samples] number of training samples from which hyperparameters are estimated.
        steps: iterations of L-BFGS on the evidence.
    """

    needs_robot = False

    friction: bool = True
    exact: int = 250
    inducing: int = 200
    hyperparameter_samples: int = 60
    steps: int = 60

    def __post_init__(self) -> None:
        counts(self, "model", "exact", "inducing", "hyperparameter_samples", "steps")

    def init(self, dataset: Dataset, key: jax.Array) -> PyTree:
        """The prior: mean zero."""
        n, support = len(dataset.joints), self._support(dataset.samples)
        blank = {"support": np.zeros((support, 3 * n)), "coefficients": np.zeros(support * n)}
        return {**_scales(dataset), "hyper": self.start(n), **blank}

    def apply(self, params: PyTree, motion: Motion, robot: Robot | None) -> Array:
        """Torque (n,) of one sample: the posterior mean."""
        n = motion.q.shape[-1]
        row = jnp.concatenate([motion.q, motion.qd, motion.qdd])[None]
        one, support = (_state(params, x, robot) for x in (row, params["support"]))
        k = _gram(params["hyper"], one, support, params["scale"])
        return params["scale"] * (k.reshape(n, -1) @ params["coefficients"])

    def fit(
        self, dataset: Dataset, key: jax.Array, *, validation: Dataset | None = None, progress: Progress = silent
    ) -> Fit:
        """Hyperparameters of largest evidence on some of the samples, then the posterior; details: noise (n,)
        [N m; N]."""
        scales, n = _scales(dataset), len(dataset.joints)
        motion = dataset.motion
        x, y = np.concatenate([motion.q, motion.qd, motion.qdd], axis=1), dataset.tau / scales["scale"]
        rows = spread_rows(len(x), self.hyperparameter_samples)
        start, robot = self.start(n), dataset.robot
        floor: dict = jax.tree.map(lambda leaf: np.full_like(leaf, -np.inf), start)
        floor["noise"] = np.full(n, np.log(gp.LEAST_NOISE))
        samples = jax.tree.map(jnp.asarray, (_state(scales, x[rows], robot), y[rows], scales["scale"]))
        hyper = gp.minimise(_loss, start, *samples, steps=self.steps, progress=progress, floor=floor)
        if len(x) <= self.exact:
            support, coefficients = x, _exact(hyper, _state(scales, x, robot), y, scales["scale"])
        else:
            support = x[spread_rows(len(x), self.inducing)]
            coefficients = _projected(hyper, _state(scales, support, robot), _state(scales, x, robot), y, scales)
        coefficients = np.asarray(coefficients)
        finite = bool(np.isfinite(coefficients).all())
        return Fit(
            params={**scales, "hyper": hyper, "support": support, "coefficients": coefficients},
            robot=robot,
            joints=dataset.joints,
            parameters=coefficients.size + sum(leaf.size for leaf in jax.tree.leaves(hyper)),
            details={"noise": np.exp(hyper["noise"]) * scales["scale"]},
            warnings=() if finite else ("The kernel matrix is singular: fewer or less similar samples help.",),
        )

    def chunk(self, motion: Motion) -> int:
        """Fewer samples at a time: each one needs a covariance with every torque of the support."""
        return CHUNK

    def start(self, n: int) -> dict[str, np.ndarray]:
        """Logarithms of the coefficients of an arm with n joints, all alike; without friction its terms are absent."""
        zero = np.zeros(n)
        friction = {"offset": zero - 4.0, "viscous": zero - 4.0, "coulomb": zero - 4.0} if self.friction else {}
        return {
            "speed": np.full((n, n), -2.0),
            "potential": zero,
            "kinetic_cosine": np.full((2, n), -1.0),
            "kinetic_sine": np.full((2, n), -1.0),
            "potential_cosine": zero,
            "potential_sine": zero,
            "noise": zero + np.log(0.1),
            **friction,
        }

    def _support(self, samples: int) -> int:
        return samples if samples <= self.exact else min(self.inducing, samples)


def _scales(dataset: Dataset) -> dict[str, np.ndarray]:
    """Spread of every torque [N m; N], and one unit of time [s] for all joints, in which velocities are near one: other
    units of single joints would break the Euler-Lagrange equation. `length`: a sliding joint's unit [m]."""
    motion, tau = dataset.motion, dataset.tau
    spread = tau.std(0)
    speed = float(np.sqrt(np.mean(motion.qd**2)))
    reach = motion.q.std(0)
    return {
        "scale": np.where(spread > 1e-12 * (1 + np.abs(tau.mean(0))), spread, 1.0),
        "time": np.array(1.0 / speed if speed > 1e-9 else 1.0),
        "length": np.where(reach > 1e-9, reach, 1.0),
    }


def _state(scales: PyTree, rows: Array, robot: Robot | None) -> State:
    """Samples (N, 3 n) of q, qd, qdd in the model's units."""
    q, qd, qdd = jnp.split(jnp.asarray(rows).T, 3)
    slides = jnp.array(robot.prismatic if robot is not None else (False,) * len(q))[:, None]
    length = jnp.asarray(scales["length"])[:, None]
    place = Place(
        jnp.where(slides, q / length, jnp.cos(q)),
        jnp.where(slides, 0.0, jnp.sin(q)),
        jnp.where(slides, 1 / length, -jnp.sin(q)),
        jnp.where(slides, 0.0, jnp.cos(q)),
    )
    return State(place, qd * scales["time"], qdd * scales["time"] ** 2, jnp.clip(qd / REST_SPEED, -1, 1))


@jax.jit
def torque_covariance(hyper: Mapping[str, Array], a: State, b: State) -> Array:
    """Covariance (n, n, N, M) of the torques of samples a with those of samples b, in the model's units.

    With L the Lagrangian's kernel and D the derivative along the motion, each is (D d/dqd_i - d/dq_i) of L in the first
    sample and the same for j in the second one.
    """
    n, pairs = len(a.qd), (a.qd.shape[1], b.qd.shape[1])
    weight = {name: jnp.exp(value) for name, value in hyper.items()}
    left, right = (_expanded(x, axis) for x, axis in ((a, 2), (b, 1)))
    one = Product(jnp.ones(pairs), jnp.zeros((n, *pairs)), jnp.zeros((n, *pairs)), jnp.zeros((n, n, *pairs)))

    def link(done: tuple, number: Array) -> tuple[tuple, None]:
        total, kinetic, potential = done
        at = {name: leaf[..., number] for name, leaf in weight.items() if name.endswith("sine")}
        places = [Place(*(leaf[number] for leaf in x.place)) for x in (left, right)]
        for s in range(2):
            factor = _factor(at["kinetic_cosine"][s], at["kinetic_sine"][s], *places)
            kinetic = kinetic.times(number, factor)
        potential = potential.times(number, _factor(at["potential_cosine"], at["potential_sine"], *places))
        speed = jnp.where(jnp.arange(n) <= number, weight["speed"][number], 0.0)[:, None, None]
        total = total + weight["potential"][number] * potential.both + _kinetic(speed, kinetic, left, right)
        return (total, kinetic, potential), None

    total: jax.Array = jax.lax.scan(link, (one.both, one, one), jnp.arange(n))[0][0]
    if "viscous" in weight:
        own = lambda name, x, y: weight[name][:, None, None] * x * y  # noqa: E731
        rubbed = own("viscous", left.qd, right.qd) + own("coulomb", left.sign, right.sign) + own("offset", 1.0, 1.0)
        total = total.at[jnp.arange(n), jnp.arange(n)].add(rubbed)
    return total


def _expanded(state: State, axis: int) -> State:
    return jax.tree.map(lambda x: jnp.expand_dims(x, axis), state)


def _factor(g: jax.Array, h: jax.Array, a: Place, b: Place) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """1 + g cos cos' + h sin sin' of one joint, and its derivatives by the first angle, the second, and both."""
    g_slope, h_slope = g * a.cosine_slope, h * a.sine_slope
    return (
        1 + g * a.cosine * b.cosine + h * a.sine * b.sine,
        g_slope * b.cosine + h_slope * b.sine,
        g * a.cosine * b.cosine_slope + h * a.sine * b.sine_slope,
        g_slope * b.cosine_slope + h_slope * b.sine_slope,
    )


def _kinetic(speed: jax.Array, p: Product, a: State, b: State) -> jax.Array:
    """The Euler-Lagrange operator in both samples of (sum_i speed_i qd_i qd_i')² p, (n, n, N, M)."""
    v, w = a.qd, b.qd
    left_v, left_a, right_w, right_b = (speed * x for x in (v, a.qdd, w, b.qdd))
    vw, aw, ab, vb = ((x * y).sum(0) for x, y in ((v, right_w), (a.qdd, right_w), (a.qdd, right_b), (v, right_b)))
    along_a, along_b = (v * p.left).sum(0), (w * p.right).sum(0)
    right_along_a, left_along_b = (v[:, None] * p.both).sum(0), (w * p.both).sum(1)
    along_both = (v * left_along_b).sum(0)
    change_a = left_a * along_b + left_v * along_both - aw * p.right - vw * right_along_a
    rate_a = left_a * p.value + left_v * along_a
    rate_b = vb * p.left + vw * left_along_b
    own = 2 * speed * (ab * p.value + aw * along_b + vb * along_a + vw * along_both)
    total = 2 * (right_w[:, None] * change_a + right_b[:, None] * rate_a - left_v * rate_b[:, None]) + vw**2 * p.both
    n = len(v)
    return total.at[jnp.arange(n), jnp.arange(n)].add(own)


def _gram(hyper: PyTree, a: State, b: State, scale: Array) -> Array:
    """Covariance (N n, M n) of the torques in units of `scale`, joints fastest."""
    n, rows = len(a.qd), (a.qd.shape[1], b.qd.shape[1])
    k = torque_covariance(hyper, a, b) / _relative(scale)[:, None, None, None] / _relative(scale)[None, :, None, None]
    return k.transpose(2, 0, 3, 1).reshape(rows[0] * n, rows[1] * n)


def _relative(scale: Array) -> Array:
    """The joints' spreads in units of their root mean square: energies are shared, so that units must not differ."""
    return scale / jnp.sqrt(jnp.mean(scale**2))


def _noise(hyper: PyTree, samples: int) -> Array:
    return jnp.tile(jnp.exp(2 * hyper["noise"]), samples)


def _lower(k: Array, more: Array | float = 0.0) -> Array:
    """Lower Cholesky factor, with more on the diagonal."""
    return jnp.linalg.cholesky(k + jnp.diag(gp.JITTER * jnp.mean(jnp.diag(k)) + more * jnp.ones(len(k))))


def _loss(hyper: PyTree, x: State, y: Array, scale: Array) -> Array:
    """Minus the log evidence of the torques y (N, n), but for a constant."""
    lower = _lower(_gram(hyper, x, x, scale), _noise(hyper, len(y)))
    white = solve_triangular(lower, y.ravel(), lower=True)
    return 0.5 * white @ white + jnp.sum(jnp.log(jnp.diag(lower)))


@jax.jit
def _exact(hyper: PyTree, x: State, y: Array, scale: Array) -> Array:
    """Coefficients (N n,) of the posterior mean."""
    return cho_solve((_lower(_gram(hyper, x, x, scale), _noise(hyper, len(y))), True), y.ravel())


def _projected(hyper: PyTree, support: State, x: State, y: Array, scales: PyTree) -> Array:
    """Coefficients (m n,) of the process of all samples, projected on the torques of m (as `gp.projected`: what these
    cannot represent of a torque is its noise)."""
    size = support.qd.size
    lower = _inducing_factor(hyper, support, scales["scale"])
    square, product = jnp.zeros((size, size)), jnp.zeros(size)
    for start in range(0, len(y), CHUNK):
        part = jax.tree.map(lambda leaf, at=start: leaf[:, at : at + CHUNK], x)
        square, product = _add(hyper, lower, support, part, y[start : start + CHUNK], scales["scale"], square, product)
    return _solved(lower, square, product)


@jax.jit
def _inducing_factor(hyper: PyTree, support: State, scale: Array) -> Array:
    return _lower(_gram(hyper, support, support, scale))


@jax.jit
def _add(
    hyper: PyTree, lower: Array, support: State, x: State, y: Array, scale: Array, square: Array, product: Array
) -> tuple[Array, Array]:
    white = solve_triangular(lower, _gram(hyper, support, x, scale), lower=True)
    unseen = jnp.maximum(_prior_variance(hyper, x, scale) - jnp.sum(white**2, 0), 0.0)
    weighted = white / (_noise(hyper, len(y)) + unseen)
    return square + weighted @ white.T, product + weighted @ y.ravel()


def _prior_variance(hyper: PyTree, x: State, scale: Array) -> Array:
    """Variance (N n,) of every torque before data, joints fastest."""

    def one(sample: State) -> Array:
        alone = jax.tree.map(lambda leaf: leaf[:, None], sample)
        return jnp.diag(_gram(hyper, alone, alone, scale))

    return jax.vmap(one, in_axes=1)(x).ravel()


@jax.jit
def _solved(lower: Array, square: Array, product: Array) -> Array:
    middle = jnp.linalg.cholesky(jnp.eye(len(square)) + square)
    return partial(solve_triangular, lower, lower=True, trans=1)(cho_solve((middle, True), product))
