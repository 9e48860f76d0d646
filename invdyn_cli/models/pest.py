"""model=pest: inertial parameter estimation, tau = K psi by a truncated singular value decomposition (paper, III-A).

K (samples x joints rows, 10 parameters a link) is never held: it is worked off in blocks, so that memory does not grow
with the number of samples. A Gram matrix K'K would square the condition number and blur the small singular values that
decide the rank; here the columns are preconditioned first, K = Z T with T from a sample of the rows, so that Z'Z is
harmless and the singular values of K are those of the small matrix (Z'Z)^(1/2) T (Cholesky QR with a preconditioner;
Fukaya et al. 2020).
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from scipy import linalg

from invdyn_cli.errors import UsageError
from invdyn_cli.interfaces import CHUNK, AbstractModel, Progress, in_chunks, silent
from invdyn_cli.maths import rigid_body, statistics
from invdyn_cli.types import Array, Dataset, Fit, Motion, PyTree, Robot

BLOCK = 256
"""Samples whose regressor exists at a time (1 MB at 7 joints: it stays in cache)."""

RESIDUALS = 1 << 16
"""Samples of a trajectory that its residuals' autocorrelation is taken from: they are held in memory."""

REST_SPEED = 0.02
"""Speed [rad/s; m/s] below which the sign of a measured velocity is noise: sign(qd) is a ramp there, so that samples at
rest do not enter with full friction (on a UR10e log a bare sign made the held-out error four times as large)."""

FEW_BLOCKS = 20
"""Fewer independent stretches leave a standard deviation uncertain by more than a sixth (chi, 1 / sqrt(2 B))."""


@dataclass(frozen=True)
class Pest(AbstractModel):
    """Inertial parameters by least squares, the directions that the data do not excite left out.

    Attributes:
        threshold: singular values of K at or below it are set to zero (paper, III-A: 0.001).
        relative: whether the threshold is a share of the largest singular value. The paper's is absolute; a relative
            one deletes real base parameters when the motion is small.
        weighting: "torque_spread" divides every joint's rows by the standard deviation of its torque, so that the noise
            of a strong joint does not drown a weak one; "none" is the paper's.
        friction: "coulomb_viscous" adds the columns sign(qd) (a ramp within `REST_SPEED`) and qd for every joint;
            "none" is the paper's.
        offset: adds a constant torque per joint (a sensor's or a drive's zero).
        rotor_inertia: adds a column qdd per joint (reflected rotor inertia; only where torque is taken at the motor).
    """

    threshold: float = 1e-3
    relative: bool = False
    weighting: Literal["none", "torque_spread"] = "none"
    friction: Literal["none", "coulomb_viscous"] = "none"
    offset: bool = False
    rotor_inertia: bool = False

    def __post_init__(self) -> None:
        for name, value, allowed in (
            ("weighting", self.weighting, ("none", "torque_spread")),
            ("friction", self.friction, ("none", "coulomb_viscous")),
        ):
            if value not in allowed:
                raise UsageError(f"model.{name}={value!r}; allowed: {', '.join(allowed)}")
        if not self.threshold >= 0:
            raise UsageError(f"model.threshold={self.threshold}; allowed: a number >= 0")

    @property
    def extras(self) -> tuple[str, ...]:
        """Names of the columns that every joint has beside the inertial ones."""
        chosen = {
            "coulomb": self.friction != "none",
            "viscous": self.friction != "none",
            "offset": self.offset,
            "armature": self.rotor_inertia,
        }
        return tuple(name for name, wanted in chosen.items() if wanted)

    def init(self, dataset: Dataset, key: jax.Array) -> PyTree:
        """All parameters zero: {"psi": (n, 10), "extras": (columns, n)}."""
        n = len(dataset.joints)
        return {"psi": jnp.zeros((n, 10)), "extras": jnp.zeros((len(self.extras), n))}

    def apply(self, params: PyTree, motion: Motion, robot: Robot | None) -> Array:
        """Torque (n,) of one sample, equation 5."""
        assert robot is not None
        tau = rigid_body.inverse_dynamics(robot, params["psi"], motion.q, motion.qd, motion.qdd)
        for value, column in zip(params["extras"], _extra_columns(self.extras, motion), strict=True):
            tau = tau + jnp.reshape(value, (-1, *(1,) * (jnp.ndim(motion.q) - 1))) * column
        return tau

    def predict(self, fit: Fit, motion: Motion) -> np.ndarray:
        """Torques (T, n); the rigid body works on whole rows of samples, which is faster than vmap over samples."""
        return in_chunks(lambda part: _apply_rows(self, fit.params, part, fit.robot), motion)

    def fit(
        self, dataset: Dataset, key: jax.Array, *, validation: Dataset | None = None, progress: Progress = silent
    ) -> Fit:
        """Least squares over all rows; standard deviations count the residuals' autocorrelation.

        details: rank, singular_values (descending), threshold (in use), base_parameters {names, expressions, values,
            std},
        effective_samples (n,), blocks.

        Raises:
            UsageError: if the dataset has no robot.
        """
        robot = dataset.robot
        if robot is None:
            raise UsageError(
                "model=pest needs the robot's kinematics, and these data bring no URDF",
                advice="robot=urdf robot.path=arm.urdf, or a model that needs none (model=ffnn)",
            )
        n = robot.dofs
        weights = 1 / _torque_spread(dataset) if self.weighting == "torque_spread" else np.ones(n)
        solution = solve(robot, dataset, self.extras, weights, self.threshold, self.relative, progress)
        progress(0.6, f"rank {solution.rank} of {10 * n + len(self.extras) * n}")
        covariance, details = _uncertainty(robot, self.extras, dataset, weights, solution, progress)
        params = {"psi": solution.psi[: 10 * n].reshape(n, 10), "extras": solution.psi[10 * n :].reshape(-1, n)}
        few = details["blocks"] < FEW_BLOCKS
        return Fit(
            params=params,
            robot=robot,
            joints=dataset.joints,
            parameters=solution.rank,
            details={
                "rank": solution.rank,
                "singular_values": solution.singular_values,
                "threshold": solution.threshold,
                "base_parameters": base_parameters(solution, covariance, _column_names(robot, self.extras)),
                **details,
            },
            warnings=(
                f"The residuals hold only {details['blocks']} independent stretches: standard deviations are rough.",
            )
            * few,
        )


@dataclass(frozen=True)
class Solution:
    """psi (p,) and what led to it: singular values of the (weighted) K, its kept right-singular vectors (p, rank), and
    the map from scores of the preconditioned columns to scores of psi."""

    psi: np.ndarray
    rank: int
    singular_values: np.ndarray
    threshold: float
    kept: np.ndarray
    preconditioner: np.ndarray
    to_scores: np.ndarray


def solve(
    robot: Robot,
    dataset: Dataset,
    extras: tuple[str, ...],
    weights: np.ndarray,
    threshold: float,
    relative: bool,
    progress: Progress = silent,
) -> Solution:
    """The truncated least-squares solution of min |W (K psi - tau)|, K in blocks (paper, equations 7 and 8).

    Args:
        weights: (n,) factor of each joint's rows.
        threshold: singular values at or below it are dropped (times the largest one where `relative`).
    """
    possible = _possible_directions(robot, extras)
    floor = 1e-8
    scale, directions = _svd_of_rows(robot, extras, weights, _subsample(dataset, 1024), possible)
    for _ in range(3):
        scale = np.maximum(scale, floor * max(scale[0], 1e-300))
        preconditioner = possible @ directions / scale
        gram, moment = _accumulate(robot, extras, weights, dataset, preconditioner, progress)
        values, vectors = linalg.eigh(gram)
        real = values > values[-1] * len(values) * np.finfo(float).eps
        root = np.sqrt(np.where(real, values, 0))
        left, singular_values, right = linalg.svd((root[:, None] * vectors.T) @ (scale[:, None] * directions.T))
        if values[-1] < 1e8 * np.median(values[real]):
            break
        scale, directions = singular_values, right.T
    projected = vectors.T @ moment / np.where(real, root, np.inf)
    limit = threshold * (singular_values[0] if relative else 1.0)
    rank = int(np.sum(singular_values > limit))
    kept = possible @ right[:rank].T
    return Solution(
        psi=kept @ ((left.T @ projected)[:rank] / singular_values[:rank]),
        rank=rank,
        singular_values=singular_values,
        threshold=float(limit),
        kept=kept,
        preconditioner=preconditioner,
        to_scores=(right[:rank] @ directions * scale) / singular_values[:rank, None] ** 2,
    )


def base_parameters(solution: Solution, covariance: np.ndarray, columns: list[str]) -> dict[str, Any]:
    """The identifiable combinations: as many as the rank, each one parameter plus multiples of dependent ones.

    Pivoted QR of the kept directions (Gautier 1991). `covariance` (rank, rank) is that of the kept coordinates.
    """
    _, r, order = linalg.qr(solution.kept.T, mode="economic", pivoting=True)  # type: ignore[misc]
    rank = solution.rank
    combine = np.zeros((rank, len(columns)))
    combine[:, order] = linalg.solve_triangular(r[:, :rank], r) if rank else r
    spread = combine @ solution.kept
    return {
        "names": [columns[c] for c in order[:rank]],
        "expressions": [_expression(columns, lead, row) for lead, row in zip(order[:rank], combine, strict=True)],
        "values": combine @ solution.psi,
        "std": np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", spread, covariance, spread), 0)),
    }


def _uncertainty(robot: Robot, extras, dataset: Dataset, weights, solution: Solution, progress: Progress):
    """Covariance (rank, rank) of the kept coordinates, and what it rests on.

    Sandwich estimator with stretches of ten autocorrelation times as independent blocks; where there are fewer than
    FEW_BLOCKS of them, the white-noise formula, each joint's noise variance times its residual's correlation time.
    """
    slow, times = np.ones(robot.dofs), np.ones(robot.dofs)
    squares = np.zeros(robot.dofs)
    scores = []
    for trajectory in dataset.trajectories:
        blocks, residuals = [], []
        for chunk in _chunks(Dataset((trajectory,), dataset.joints)):
            score, residual = _scores(robot, extras, weights, *chunk, solution.preconditioner, solution.psi)
            blocks.append(np.asarray(score))
            squares += np.sum(np.asarray(residual)[chunk[2]] ** 2, axis=0)
            if len(residuals) * CHUNK < RESIDUALS:
                residuals.append(np.asarray(residual))
        residual = np.concatenate(residuals)[: len(trajectory.t)]
        slow = np.maximum(slow, [statistics.autocorrelation_time(r) for r in residual.T])
        times = np.maximum(times, [statistics.resonance_time(r) for r in residual.T])
        scores.append(np.concatenate(blocks)[: -(-len(trajectory.t) // BLOCK)])
        progress(0.6 + 0.4 * len(scores) / len(dataset.trajectories), "standard deviations")
    size = int(np.ceil(10 * slow.max() / BLOCK))
    merged = np.concatenate([statistics.merge_blocks(s, size) for s in scores])
    if len(merged) >= FEW_BLOCKS:
        meat = statistics.score_covariance(merged)
    else:
        noise = squares / dataset.samples * weights**2 * np.maximum(slow, times)
        meat = np.einsum("j,jab->ab", noise, _grams(robot, extras, weights, dataset, solution.preconditioner))
    covariance = solution.to_scores @ meat @ solution.to_scores.T
    return covariance, {"blocks": len(merged), "effective_samples": dataset.samples / slow}


def _grams(robot: Robot, extras, weights, dataset: Dataset, preconditioner) -> np.ndarray:
    """Z_j'Z_j (n, r, r) of every joint's own rows."""
    r = preconditioner.shape[1]
    grams = jnp.zeros((robot.dofs, r, r))
    for motion, _, valid in _chunks(dataset):
        grams = _add_grams(robot, extras, weights, motion, valid, preconditioner, grams)
    return np.asarray(grams)


@jax.jit(static_argnames="extras")
def _add_grams(robot, extras, weights, motion, valid, preconditioner, grams):
    def add(grams, block):
        motion, valid = block
        rows = _weighted_rows(robot, extras, weights[:, None] * valid, motion)
        z = jnp.einsum("pr,pnb->nrb", preconditioner, rows)
        return grams + jnp.einsum("nrb,nsb->nrs", z, z), None

    return jax.lax.scan(add, grams, (jax.tree.map(_blocks, motion), _blocks(valid)))[0]


def _possible_directions(robot: Robot, extras: tuple[str, ...]) -> np.ndarray:
    """Orthonormal directions (p, r) of parameter space that some motion of this robot can show; the rest never does."""
    motion = Motion(*(x.T for x in rigid_body.random_states(robot, 256, seed=0)))
    scale, directions = _svd_of_rows(robot, extras, np.ones(robot.dofs), motion, np.eye(_width(robot, extras)))
    return directions[:, scale > 1e-10 * scale[0]]


def _svd_of_rows(robot, extras, weights, motion: Motion, basis) -> tuple[np.ndarray, np.ndarray]:
    """Singular values (r,) and right-singular vectors (r, r) of the rows K basis of a few samples, by QR."""
    rows = np.asarray(_weighted_rows(robot, extras, jnp.asarray(weights)[:, None], jax.tree.map(jnp.transpose, motion)))
    triangle = linalg.qr(rows.reshape(len(rows), -1).T @ basis, mode="r")[0][: basis.shape[1]]
    _, scale, right = linalg.svd(triangle, full_matrices=True)
    return np.pad(scale, (0, basis.shape[1] - len(scale))), right.T


def _subsample(dataset: Dataset, most: int) -> Motion:
    """So many samples, evenly from all over: one shape (one compilation) for all datasets that have as many."""
    rows = np.linspace(0, dataset.samples - 1, min(most, dataset.samples)).astype(int)
    starts = np.cumsum([0, *(len(x.t) for x in dataset.trajectories)])
    owned = [rows[(rows >= a) & (rows < b)] - a for a, b in itertools.pairwise(starts)]
    parts = [
        jax.tree.map(lambda array, own=own: np.asarray(array)[own], x.motion)
        for x, own in zip(dataset.trajectories, owned, strict=True)
    ]
    return jax.tree.map(lambda *x: np.concatenate(x), *parts)


def _accumulate(robot, extras, weights, dataset: Dataset, preconditioner, progress: Progress):
    """Z'Z (r, r) and Z'tau (r,) over all rows of Z = W K preconditioner."""
    r = preconditioner.shape[1]
    state = jnp.zeros((r, r)), jnp.zeros(r)
    done = 0
    for chunk in _chunks(dataset):
        state = _add_chunk(robot, extras, weights, *chunk, preconditioner, state)
        done += CHUNK
        if done % (64 * CHUNK) == 0:
            jax.block_until_ready(state)
            progress(0.5 * done / dataset.samples, "regressor")
    return np.asarray(state[0]), np.asarray(state[1])


def _chunks(dataset: Dataset) -> Iterator[tuple[Motion, Array, np.ndarray]]:
    """Motion, torque and validity (CHUNK rows each, the last of a trajectory padded with rows that do not count)."""
    for x in dataset.trajectories:
        for start in range(0, len(x.t), CHUNK):
            rows = slice(start, start + CHUNK)
            part, tau = x.motion[rows], x.tau[rows]
            missing = CHUNK - len(part)
            valid = np.arange(CHUNK) < len(part)
            if missing:
                part, tau = jax.tree.map(lambda a, m=missing: np.pad(a, ((0, m), (0, 0))), (part, tau))
            yield part, tau, valid


def _blocks(x: Array) -> Array:
    """(CHUNK, ...) as (CHUNK / BLOCK, ..., BLOCK): what a scan over blocks takes, samples last."""
    return jnp.moveaxis(jnp.reshape(x, (-1, BLOCK, *x.shape[1:])), 1, -1)


@jax.jit(static_argnames="extras")
def _add_chunk(robot, extras, weights, motion, tau, valid, preconditioner, state):
    def add(state, block):
        motion, tau, valid = block
        factor = weights[:, None] * valid
        z = preconditioner.T @ _weighted_rows(robot, extras, factor, motion).reshape(len(preconditioner), -1)
        return (state[0] + z @ z.T, state[1] + z @ (factor * tau).ravel()), None

    return jax.lax.scan(add, state, (jax.tree.map(_blocks, motion), _blocks(tau), _blocks(valid)))[0]


@jax.jit(static_argnames="extras")
def _scores(robot, extras, weights, motion, tau, valid, preconditioner, psi):
    """Score (blocks, r) of every block and residual (CHUNK, n) [N m; N]."""

    def one(block):
        motion, tau, valid = block
        factor = weights[:, None] * valid
        rows = _weighted_rows(robot, extras, factor, motion).reshape(len(psi), -1)
        residual = (factor * tau).ravel() - psi @ rows
        return preconditioner.T @ (rows @ residual), (residual.reshape(tau.shape) / weights[:, None]).T

    scores, residual = jax.lax.map(one, (jax.tree.map(_blocks, motion), _blocks(tau), _blocks(valid)))
    return scores, residual.reshape(-1, residual.shape[-1])


@partial(jax.jit, static_argnames="extras")
def _weighted_rows(robot, extras, factor, motion: Motion) -> Array:
    """W K transposed, (p, n, samples), for a motion (n, samples) and a factor (n, samples or 1)."""
    rows = rigid_body.regressor(robot, motion.q, motion.qd, motion.qdd)
    rows = rows.reshape(-1, *rows.shape[2:])
    diagonal = jnp.eye(robot.dofs)[:, :, None]
    columns = [diagonal * column for column in _extra_columns(extras, motion)]
    return jnp.concatenate([rows, *columns]) * factor if columns else rows * factor


def _extra_columns(extras: tuple[str, ...], motion: Motion) -> list[Array]:
    column = {
        "coulomb": lambda: jnp.clip(motion.qd / REST_SPEED, -1, 1),
        "viscous": lambda: motion.qd,
        "offset": lambda: jnp.ones_like(motion.qd),
        "armature": lambda: motion.qdd,
    }
    return [column[name]() for name in extras]


@jax.jit(static_argnums=0)
def _apply_rows(model: Pest, params: PyTree, motion: Motion, robot: Robot) -> Array:
    return model.apply(params, jax.tree.map(jnp.transpose, motion), robot).T


def _width(robot: Robot, extras: tuple[str, ...]) -> int:
    return robot.dofs * (len(rigid_body.PARAMETERS) + len(extras))


def _column_names(robot: Robot, extras: tuple[str, ...]) -> list[str]:
    inertial = [f"{name}[{joint}]" for joint in robot.joints for name in rigid_body.PARAMETERS]
    return inertial + [f"{name}[{joint}]" for name in extras for joint in robot.joints]


def _expression(columns: list[str], lead: int, factors: np.ndarray) -> str:
    others = [c for c in np.flatnonzero(np.abs(factors) > 1e-6) if c != lead]
    return columns[lead] + "".join(
        f" {'-' if factors[c] < 0 else '+'} {abs(factors[c]):.4g} {columns[c]}" for c in others
    )


def _torque_spread(dataset: Dataset) -> np.ndarray:
    """Standard deviation of every joint's torque (n,) over all trajectories, 1 for a joint without any."""
    count = dataset.samples
    mean = sum(x.tau.sum(0) for x in dataset.trajectories) / count
    parts = (x.tau[start : start + CHUNK] for x in dataset.trajectories for start in range(0, len(x.t), CHUNK))
    spread = np.sqrt(sum(((part - mean) ** 2).sum(0) for part in parts) / count)
    return np.where(spread > 0, spread, 1.0)
