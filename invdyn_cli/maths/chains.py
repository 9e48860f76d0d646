r"""A serial chain of unknown geometry: its axes and the inertial parameters of its links, from torques alone.

The coefficient tensors of an arm of n joints have tensor trains of rank 10 at most, whatever n: a composite inertia has
ten numbers, and every joint moves them linearly outward to inward. Here the cores of that train are what they are in
every arm, rigid displacements, one rotation and one shift per joint, learned along with ten inertial parameters per
link: 16 n numbers stand for the 5^n of a dense tensor.

Given the geometry, the torque is linear in all that is left, so that only the geometry is searched (variable
projection, Golub and Pereyra 1973, with Kaufman's slopes) by Levenberg and Marquardt's steps. There are other minima
than the arm, and most have it right in all joints but one or two: a search draws one or two joints anew and descends
again, as long as that helps (iterated local search). When two searches from chains of their own came to the same, it is
the arm.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from invdyn_cli.interfaces import Progress, silent
from invdyn_cli.maths import regression, rigid_body
from invdyn_cli.maths.scaling import spread_rows
from invdyn_cli.types import Array, Motion, Robot

SPAN = 0.2
"""[m] Distance of joints in a start, in each direction."""

STEPS, LONGEST = 80, 1.5
"""Largest number of steps, and longest step in one number [rad; a SPAN]."""

STAGES = (512, 3e-2), (4096, 1e-4), (None, 1e-3)
"""Samples, evenly over all (None: all), and what share of what is left a step must be worth for another to follow: for
every descent, and then twice more for the best of them."""

PATIENCE, BETTER = 24, 0.99
"""Descents in turn that lead nowhere, after which a search ends; the share of what was left below which one leads
somewhere."""

SIDE_BY_SIDE = 2
"""Number of searches at a time, each in a thread."""

ALIKE = 1.02
"""Two searches whose residuals are within this factor found the same chain."""

PRIOR = 1e-10
"""Share of the squares of a column: keeps those numbers small that the data do not determine."""

EXACT = 1e-16
"""Share of the weighted squares that is rounding: nothing else is needed."""

TOLD, NOTHING = 1e-10, 1e-9
"""Share of the largest eigenvalue of all columns at length 1, above which the data determine a direction; and share of
the longest column, below which a column is rounding."""

BLOCK = 128
"""Number of samples that are processed at a time: few enough for the cache, and one shape, so that little is
compiled."""

CANCELLED = 1e-8
"""Share of the squares below which sums over products of columns are too inexact for the residual, which is then summed
itself."""

Block = tuple[Motion, Array, Array]
"""Motion (n, BLOCK), torque alike, and which samples count (BLOCK,)."""


@dataclass(frozen=True)
class Learned:
    """A chain: turns (n, 3) rotation vectors and shifts (n, 3) [m] of every joint's frame in the one before it,
    inertial (n, 10), extras (columns, n); the share of the weighted squares that it leaves; what every
    search left of those it looked at (searches,); and how many directions of all its numbers the data tell."""

    turns: np.ndarray
    shifts: np.ndarray
    inertial: np.ndarray
    extras: np.ndarray
    left: float
    searches: np.ndarray
    rank: int

    @property
    def sure(self) -> bool:
        """Whether the residual is zero, or another search found the same chain."""
        return _settled(self.searches.tolist())


def robot(turns: Array, shifts: Array) -> Robot:
    """The chain's kinematics, gravity along -z of the base; every joint turns about its z axis."""
    n = len(turns)
    unbounded = jnp.full(n, jnp.inf)
    return Robot(
        name="chain",
        joints=tuple(f"joint{i + 1}" for i in range(n)),
        parents=tuple(range(-1, n - 1)),
        prismatic=(False,) * n,
        rotation=jax.vmap(_rotation)(turns),
        translation=jnp.asarray(shifts).at[0].set(0.0),
        axis=jnp.tile(jnp.array([0.0, 0.0, 1.0]), (n, 1)),
        inertial=jnp.zeros((n, 10)),
        gravity=jnp.array([0.0, 0.0, -9.81]),
        lower=-unbounded,
        upper=unbounded,
        velocity_limit=unbounded,
        effort_limit=unbounded,
        damping=jnp.zeros(n),
        friction=jnp.zeros(n),
    )


def learn(
    motion: Motion,
    tau: np.ndarray,
    weights: np.ndarray,
    extras: tuple[str, ...],
    searches: int,
    seed: int,
    progress: Progress = silent,
) -> Learned:
    """The chain that leaves least of W tau, after so many searches at most; two go side by side.

    Args:
        motion: (T, n).
        tau: (T, n) [N m].
        weights: (n,) of every joint's rows.
        extras: columns beside, as `regression.extra_columns` knows them.
    """
    n = tau.shape[1]
    (some, rough), *closer = ((_evenly(motion, tau, samples), least) for samples, least in STAGES)
    draws = np.random.default_rng(seed).spawn(searches)
    reached: list[_State] = []

    def search(k: int) -> _State:
        def tell(left: float) -> None:
            progress(0.6 * len(reached) / searches, f"search {k + 1} of {searches} leaves {left:.2g}")

        first = _State(draws[k].normal(size=(2, n, 3)), some, weights, extras)
        return _searched(first, draws[k], rough, tell)

    with ThreadPoolExecutor(SIDE_BY_SIDE) as pool:
        while len(reached) < searches and not _settled([x.left for x in reached]):
            reached += pool.map(search, range(len(reached), min(searches, len(reached) + SIDE_BY_SIDE)))
    best = min(reached, key=lambda x: x.left)
    for number, (more, least) in enumerate(closer):
        best = _descended(_State(best.geometry, more, weights, extras), least)
        progress(0.8 + 0.2 * number, f"leaves {best.left:.2g}")
    inertial, beside = best.theta[: 10 * n], best.theta[10 * n :]
    return Learned(
        turns=best.geometry[0],
        shifts=SPAN * best.geometry[1],
        inertial=inertial.reshape(n, 10),
        extras=beside.reshape(-1, n),
        left=best.left,
        searches=np.array([x.left for x in reached]),
        rank=best.rank(),
    )


class _State:
    """A geometry (2, n, 3), rotation vectors and shifts in units of SPAN, with the linear parameters that are best
    beside it, from sums over all rows."""

    def __init__(
        self, geometry: np.ndarray, data: Sequence[Block], weights: np.ndarray, extras: tuple[str, ...]
    ) -> None:
        self.geometry, self.data, self.weights, self.extras = geometry, data, weights, extras
        gram = self._summed(_gram, geometry)
        normal, moment, total = gram[:-1, :-1], gram[:-1, -1], gram[-1, -1]
        unit = np.outer(*[_lengths(normal)] * 2)
        self.inverse = np.linalg.inv(normal / unit + PRIOR * np.eye(len(moment))) / unit
        self.theta = self.inverse @ moment
        self.left = float(1 - self.theta @ (2 * moment - normal @ self.theta) / total)
        if self.left < CANCELLED:
            self.theta = self.theta + self.inverse @ self._summed(_left, geometry, self.theta)[:-1]
            self.left = float(self._summed(_left, geometry, self.theta)[-1] / total)

    def slopes(self) -> tuple[np.ndarray, np.ndarray]:
        """Normal matrix (6 n, 6 n) and moment (6 n,) of the geometry, the linear parameters following."""
        gram = self._summed(_gram_with_slopes, self.geometry, self.theta)
        k = len(self.theta)
        across, own, moment = gram[:k, k:-1], gram[k:-1, k:-1], gram[k:-1, -1]
        return own - across.T @ self.inverse @ across, moment - across.T @ (self.inverse @ gram[:k, -1])

    def at(self, geometry: np.ndarray) -> "_State":
        """Another geometry on the same data."""
        return _State(geometry, self.data, self.weights, self.extras)

    def rank(self) -> int:
        """Directions in the space of all numbers that the data determine."""
        gram = self._summed(_gram_with_slopes, self.geometry, self.theta)[:-1, :-1]
        values = np.linalg.eigvalsh(gram / np.outer(*[_lengths(gram)] * 2))
        return int(np.sum(values > TOLD * values[-1]))

    def _summed(self, sums: Callable[..., Array], *where: np.ndarray) -> np.ndarray:
        """Over all blocks."""
        return np.sum([np.asarray(sums(*where, block, self.weights, self.extras)) for block in self.data], axis=0)


def _settled(left: Sequence[float]) -> bool:
    """Whether the residual is zero, or two searches found the same chain."""
    least, *others = sorted(left) or [np.inf]
    return least < EXACT or any(x < ALIKE * least for x in others)


def _searched(first: _State, draw: np.random.Generator, least: float, tell: Callable[[float], None]) -> _State:
    """The result of a search that starts from its own random chain."""
    found, idle = _descended(first, least), 0
    while idle < PATIENCE and found.left > EXACT:
        one = _descended(found.at(_redrawn(found.geometry, draw)), least)
        found, idle = (one, 0) if one.left < BETTER * found.left else (found, idle + 1)
        tell(found.left)
    return found


def _redrawn(geometry: np.ndarray, draw: np.random.Generator) -> np.ndarray:
    """The geometry with one or two joints drawn anew."""
    n = geometry.shape[1]
    chosen = draw.choice(n, min(n, draw.integers(1, 3)), replace=False)
    out = geometry.copy()
    out[:, chosen] = draw.normal(size=(2, len(chosen), 3))
    return out


def _lengths(gram: np.ndarray) -> np.ndarray:
    """Lengths of all columns; infinite if a column is only rounding."""
    length = np.sqrt(np.diag(gram))
    return np.where(length > NOTHING * length.max(), length, np.inf)


def _descended(state: _State, least: float) -> _State:
    """Levenberg-Marquardt steps, until two in a row reduce the residual by less than the share `least`."""
    damping, worth = 0.1, 1.0
    for _ in range(STEPS):
        normal, moment = state.slopes()
        scale = np.diag(normal) + 1e-3 * np.mean(np.diag(normal))
        better = None
        for _ in range(8):
            step = np.linalg.solve(normal + damping * np.diag(scale), moment)
            step *= min(1.0, LONGEST / np.abs(step).max())
            tried = state.at(state.geometry + step.reshape(state.geometry.shape))
            if tried.left < state.left:
                better = tried
                break
            damping *= 4
        if better is None:
            break
        damping = max(damping / 5, 1e-9)
        before, worth = worth, 1 - better.left / state.left
        state = better
        if state.left < EXACT or max(before, worth) < least:
            break
    return state


def _evenly(motion: Motion, tau: np.ndarray, samples: int | None) -> list[Block]:
    """That many samples, evenly spread; all samples if there are fewer."""
    rows = spread_rows(len(tau), samples or len(tau))
    blocks = []
    for start in range(0, len(rows), BLOCK):
        own = rows[start : start + BLOCK]
        filled = np.pad(own, (0, BLOCK - len(own)), mode="edge")
        counts = np.arange(BLOCK) < len(own)
        blocks.append(jax.tree.map(lambda x: jnp.asarray(x.T), (motion[filled], tau[filled], counts)))
    return blocks


def _rows(geometry: Array, motion: Motion, weights: Array, extras: tuple[str, ...], counts: Array) -> Array:
    """Columns (10 n + extras n, n, samples) of all linear parameters; zero for rows that do not count."""
    return regression.design_rows(
        regression.Design(robot(geometry[0], SPAN * geometry[1]), extras, weights), motion, counts
    )


def _products(columns: Array) -> Array:
    flat = columns.reshape(len(columns), -1)
    return flat @ flat.T


@jax.jit(static_argnums=3)
def _gram(geometry: Array, block: Block, weights: Array, extras: tuple[str, ...]) -> Array:
    """Gram matrix of [linear columns | torque]."""
    motion, tau, counts = block
    rows = _rows(geometry, motion, weights, extras, counts)
    return _products(jnp.concatenate([rows, (weights[:, None] * tau * counts)[None]]))


@jax.jit(static_argnums=4)
def _left(geometry: Array, theta: Array, block: Block, weights: Array, extras: tuple[str, ...]) -> Array:
    """Products of the residual torque with every linear column and with itself."""
    motion, tau, counts = block
    rows = _rows(geometry, motion, weights, extras, counts)
    left = (weights[:, None] * tau - jnp.tensordot(theta, rows, 1)) * counts
    return jnp.append(jnp.einsum("pnb,nb->p", rows, left), jnp.sum(left**2))


@jax.jit(static_argnums=4)
def _gram_with_slopes(geometry: Array, theta: Array, block: Block, weights: Array, extras: tuple[str, ...]) -> Array:
    """Gram matrix of [linear columns | derivatives of the torque by the geometry | residual]."""
    motion, tau, counts = block
    n = len(weights)
    inertial = theta[: 10 * n].reshape(n, 10)

    def torque(g):
        arm = robot(g[0], SPAN * g[1])
        return rigid_body.inverse_dynamics(arm, inertial, motion.q, motion.qd, motion.qdd) * weights[:, None]

    rows = _rows(geometry, motion, weights, extras, counts)
    slopes = jnp.moveaxis(jax.jacfwd(torque)(geometry).reshape(n, -1, 6 * n), -1, 0)
    left = weights[:, None] * tau - jnp.tensordot(theta, rows, 1)
    return _products(jnp.concatenate([rows, slopes, left[None]]) * counts)


def _rotation(turn: Array) -> Array:
    """Rotation matrix (3, 3) of a rotation vector (3,): Rodrigues' formula, its series near zero."""
    x, y, z = turn
    square = turn @ turn
    small = square < 1e-8
    angle = jnp.sqrt(jnp.where(small, 1.0, square))
    sine = jnp.where(small, 1 - square / 6, jnp.sin(angle) / angle)
    cosine = jnp.where(small, 0.5 - square / 24, (1 - jnp.cos(angle)) / angle**2)
    cross = jnp.array([[0 * x, -z, y], [z, 0 * x, -x], [-y, x, 0 * x]])
    return jnp.eye(3) + sine * cross + cosine * (cross @ cross)
