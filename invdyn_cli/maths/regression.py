"""Least squares on the rows of the joint-torque regressor K, which is never held: min |W (K psi - tau)| in blocks.

Memory does not grow with the number of samples. A Gram matrix K'K would square the condition number and blur the small
singular values that decide the rank; here the columns are preconditioned first, K = Z T with T from a sample of the
rows, so that Z'Z is well conditioned and the singular values of K are those of the small matrix (Z'Z)^(1/2) T (Cholesky
QR with a preconditioner; Fukaya et al. 2020).
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy

from invdyn_cli.chunks import CHUNK, padded
from invdyn_cli.interfaces import Progress, silent
from invdyn_cli.maths import rigid_body, statistics
from invdyn_cli.maths.scaling import spread_rows
from invdyn_cli.types import Array, Dataset, Motion, Robot

BLOCK = 256
"""Number of samples whose regressor is held at a time (1 MB at 7 joints: it stays in cache)."""

RESIDUALS = 1 << 16
"""Number of samples of a trajectory from which the autocorrelation of its residuals is computed: they are held in
memory."""

REST_SPEED = 0.02
"""Speed [rad/s; m/s] below which the sign of a measured velocity is noise: sign(qd) is a ramp there, so that samples at
rest do not enter with full friction (on a UR10e log a bare sign made the held-out error four times as large)."""

STRIBECK = (0.06, 0.2)
"""Speeds [rad/s; m/s] of friction that fades with speed: published Stribeck speeds of geared joints lie between."""

FEW_BLOCKS = 20
"""With fewer independent stretches a standard deviation is uncertain by more than a sixth (chi, 1 / sqrt(2 B))."""


@dataclass(frozen=True)
class Design:
    """Which rows and columns there are: the robot's ten parameters a link, then `extras` for every joint, as
    `extra_columns` has them with `rest_speed` and `cycles`; `weights` (n,) multiplies the rows of each joint, and rows
    of a joint slower than `least_speed` do not count."""

    robot: Robot
    extras: tuple[str, ...]
    weights: Array
    rest_speed: float = REST_SPEED
    least_speed: float = 0.0
    cycles: Array | tuple = ()

    @property
    def columns(self) -> list[str]:
        """Names of the p columns: parameter[joint]."""
        inertial = [f"{name}[{joint}]" for joint in self.robot.joints for name in rigid_body.PARAMETERS]
        return inertial + [f"{name}[{joint}]" for name in self.extras for joint in self.robot.joints]


jax.tree_util.register_dataclass(
    Design, data_fields=["robot", "weights", "cycles"], meta_fields=["extras", "rest_speed", "least_speed"]
)


@dataclass(frozen=True)
class Solution:
    """psi (p,) and what led to it: singular values of the (weighted) K, its kept right-singular vectors (p, rank), the
    map from scores of the preconditioned columns to scores of psi, and the columns' squares (n, r, r) by joint."""

    psi: np.ndarray
    rank: int
    singular_values: np.ndarray
    threshold: float
    kept: np.ndarray
    preconditioner: np.ndarray
    to_scores: np.ndarray
    grams: np.ndarray


def solve(
    design: Design, dataset: Dataset, threshold: float, relative: bool = False, progress: Progress = silent
) -> Solution:
    """The truncated least-squares solution of min |W (K psi - tau)|, K in blocks (paper, equations 7 and 8).

    Args:
        threshold: singular values at or below it are dropped (times the largest one where `relative`).
    """
    possible = _possible_directions(design)
    floor = 1e-8
    scale, directions = _svd_of_rows(design, _subsample(dataset, 1024), possible)
    for _ in range(3):
        scale = np.maximum(scale, floor * max(scale[0], 1e-300))
        preconditioner = possible @ directions / scale
        grams, moment = _accumulate(design, dataset, preconditioner, progress)
        values, vectors = np.linalg.eigh(grams.sum(0))
        real = values > values[-1] * len(values) * np.finfo(float).eps
        root = np.sqrt(np.where(real, values, 0))
        left, singular_values, right = scipy.linalg.svd((root[:, None] * vectors.T) @ (scale[:, None] * directions.T))
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
        grams=grams,
    )


def base_parameters(design: Design, solution: Solution, covariance: np.ndarray) -> dict[str, Any]:
    """The identifiable combinations: as many as the rank, each one parameter plus multiples of dependent ones.

    Pivoted QR of the kept directions (Gautier 1991). `covariance` (rank, rank) is that of the kept coordinates.
    """
    columns = design.columns
    _, r, order = scipy.linalg.qr(solution.kept.T, mode="economic", pivoting=True)  # type: ignore[misc]
    rank = solution.rank
    combine = np.zeros((rank, len(columns)))
    combine[:, order] = scipy.linalg.solve_triangular(r[:, :rank], r) if rank else r
    spread = combine @ solution.kept
    return {
        "names": [columns[c] for c in order[:rank]],
        "expressions": [
            _expression(columns, lead, row) for lead, row in zip(order[:rank].tolist(), combine, strict=True)
        ],
        "values": combine @ solution.psi,
        "std": np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", spread, covariance, spread), 0)),
    }


def uncertainty(
    design: Design, dataset: Dataset, solution: Solution, progress: Progress = silent
) -> tuple[np.ndarray, dict[str, Any]]:
    """Covariance (rank, rank) of the kept coordinates, and what it rests on: {blocks, effective_samples (n,)}.

    Sandwich estimator with stretches of ten autocorrelation times as independent blocks; where there are fewer than
    FEW_BLOCKS of them, the white-noise formula, each joint's noise variance times its residual's correlation time.
    """
    n = design.robot.dofs
    slow, resonant, squares = np.ones(n), np.ones(n), np.zeros(n)
    scores = []
    for trajectory in dataset.trajectories:
        blocks, residuals = [], []
        for chunk in _chunks(Dataset((trajectory,), dataset.joints)):
            score, residual = _scores(design, *chunk, solution.preconditioner, solution.psi)
            blocks.append(np.asarray(score))
            squares += np.sum(np.asarray(residual)[chunk[2]] ** 2, axis=0)
            if len(residuals) * CHUNK < RESIDUALS:
                residuals.append(np.asarray(residual))
        residual = np.concatenate(residuals)[: len(trajectory.t)]
        slow = np.maximum(slow, [statistics.autocorrelation_time(r) for r in residual.T])
        resonant = np.maximum(resonant, [statistics.resonance_time(r) for r in residual.T])
        scores.append(np.concatenate(blocks)[: -(-len(trajectory.t) // BLOCK)])
        progress(len(scores) / len(dataset.trajectories), "standard deviations")
    size = int(np.ceil(10 * slow.max() / BLOCK))
    merged = np.concatenate([statistics.merge_blocks(s, size) for s in scores])
    if len(merged) >= FEW_BLOCKS:
        meat = statistics.score_covariance(merged)
    else:
        noise = squares / dataset.samples * design.weights**2 * np.maximum(slow, resonant)
        meat = np.einsum("j,jab->ab", noise, solution.grams)
    covariance = solution.to_scores @ meat @ solution.to_scores.T
    return covariance, {"blocks": len(merged), "effective_samples": dataset.samples / slow}


def torque_spread(dataset: Dataset) -> np.ndarray:
    """Standard deviation of every joint's torque (n,) over all trajectories, 1 for a joint without any."""
    count = dataset.samples
    mean = sum(x.tau.sum(0) for x in dataset.trajectories) / count
    parts = (x.tau[start : start + CHUNK] for x in dataset.trajectories for start in range(0, len(x.t), CHUNK))
    spread = np.sqrt(sum(((part - mean) ** 2).sum(0) for part in parts) / count)
    return np.where(spread > 0, spread, 1.0)


def extra_columns(
    extras: tuple[str, ...], motion: Motion, rest_speed: float = REST_SPEED, cycles: Array | tuple = ()
) -> list[Array]:
    """The columns beside the inertial ones, like `motion.qd` each: coulomb, viscous, offset, armature; stribeck_0 and
    so on, friction that fades with the speeds STRIBECK; ripple_0_sin, ripple_0_cos and so on, of `cycles` (lines, n) in
    2 pi of each joint's angle (0: no line), joints being the first axis of a motion."""
    direction = jnp.clip(motion.qd / rest_speed, -1, 1)
    lines = [jnp.reshape(c, (-1, *(1,) * (jnp.ndim(motion.q) - 1))) for c in cycles]
    column = {
        "coulomb": direction,
        "viscous": motion.qd,
        "offset": jnp.ones_like(motion.qd),
        "armature": motion.qdd,
        **{f"stribeck_{i}": direction * jnp.exp(-((motion.qd / v) ** 2)) for i, v in enumerate(STRIBECK)},
        **{f"ripple_{i}_sin": jnp.sin(c * motion.q) for i, c in enumerate(lines)},
        **{f"ripple_{i}_cos": jnp.where(c > 0, jnp.cos(c * motion.q), 0.0) for i, c in enumerate(lines)},
    }
    return [column[name] for name in extras]


@jax.jit
def design_rows(design: Design, motion: Motion, valid: Array) -> Array:
    """W K transposed, (p, n, samples), for a motion (n, samples); those that do not count (`valid`) are zero."""
    inertial = rigid_body.regressor(design.robot, motion.q, motion.qd, motion.qdd)
    inertial = inertial.reshape(-1, *inertial.shape[2:])
    diagonal = jnp.eye(design.robot.dofs)[:, :, None]
    beside = extra_columns(design.extras, motion, design.rest_speed, design.cycles)
    columns = [diagonal * column for column in beside]
    return (jnp.concatenate([inertial, *columns]) if columns else inertial) * _row_weights(design, motion, valid)


def _row_weights(design: Design, motion: Motion, valid: Array) -> Array:
    """(n, samples)."""
    return design.weights[:, None] * (valid & (jnp.abs(motion.qd) >= design.least_speed))


def _possible_directions(design: Design) -> np.ndarray:
    """Orthonormal directions (p, r) of parameter space that some motion of this robot can show; no motion shows the
    others."""
    motion = Motion(*(x.T for x in rigid_body.random_states(design.robot, 256, seed=0)))
    unweighted = Design(design.robot, design.extras, np.ones(design.robot.dofs), cycles=design.cycles)
    scale, directions = _svd_of_rows(unweighted, motion, np.eye(len(design.columns)))
    return directions[:, scale > 1e-10 * scale[0]]


def _svd_of_rows(design: Design, motion: Motion, basis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Singular values (r,) and right-singular vectors (r, r) of the rows K basis of a few samples, by QR."""
    parts = [motion[slice(start, start + BLOCK)] for start in range(0, len(motion), BLOCK)]
    valid = [np.arange(BLOCK) < len(part) for part in parts]
    blocks = [jax.tree.map(jnp.transpose, padded(part, BLOCK)) for part in parts]  # one shape, one compilation
    rows = np.concatenate([design_rows(design, *x) for x in zip(blocks, valid, strict=True)], axis=-1)
    triangle = scipy.linalg.qr(rows.reshape(len(rows), -1).T @ basis, mode="r")[0][: basis.shape[1]]
    _, scale, right = scipy.linalg.svd(triangle, full_matrices=True)
    return np.pad(scale, (0, basis.shape[1] - len(scale))), right.T


def _subsample(dataset: Dataset, most: int) -> Motion:
    """That many samples, evenly spread: one shape (one compilation) for all datasets that have as many."""
    rows = spread_rows(dataset.samples, most)
    starts = np.cumsum([0, *(len(x.t) for x in dataset.trajectories)])
    owned = [rows[(rows >= a) & (rows < b)] - a for a, b in itertools.pairwise(starts)]
    parts = [x.motion[own] for x, own in zip(dataset.trajectories, owned, strict=True)]
    return jax.tree.map(lambda *x: np.concatenate(x), *parts)


def _accumulate(design: Design, dataset: Dataset, preconditioner: np.ndarray, progress: Progress):
    """Z_j'Z_j (n, r, r) of every joint's rows of Z = W K preconditioner, and Z'tau (r,) over all of them."""
    r = preconditioner.shape[1]
    state = jnp.zeros((design.robot.dofs, r, r)), jnp.zeros(r)
    for number, chunk in enumerate(_chunks(dataset)):
        state = _add_chunk(design, *chunk, preconditioner, state)
        if number % 64 == 63:
            jax.block_until_ready(state)
            progress(min(1.0, number * CHUNK / dataset.samples), "regressor")
    return np.asarray(state[0]), np.asarray(state[1])


def _chunks(dataset: Dataset) -> Iterator[tuple[Motion, Array, np.ndarray]]:
    """`chunks` of all trajectories."""
    for x in dataset.trajectories:
        yield from chunks(x.motion, x.tau)


def chunks(motion: Motion, tau: Array) -> Iterator[tuple[Motion, Array, np.ndarray]]:
    """Motion, torque and validity (CHUNK rows each, the last padded with rows that do not count)."""
    for start in range(0, len(tau), CHUNK):
        rows = slice(start, start + CHUNK)
        part, torque = motion[rows], tau[rows]
        torque = np.pad(torque, ((0, CHUNK - len(part)), (0, 0)))
        yield padded(part, CHUNK), torque, np.arange(CHUNK) < len(part)


def blocks(motion: Motion, tau: Array, valid: Array) -> tuple[Motion, Array, Array]:
    """A chunk (CHUNK, ...) as what a scan over blocks takes: (CHUNK / BLOCK, ..., BLOCK), samples last."""
    return jax.tree.map(lambda x: jnp.moveaxis(x.reshape(-1, BLOCK, *x.shape[1:]), 1, -1), (motion, tau, valid))


@jax.jit
def _add_chunk(design, motion, tau, valid, preconditioner, state):
    def add(state, block):
        motion, tau, valid = block
        rows = jnp.moveaxis(design_rows(design, motion, valid), 0, 1)
        z = preconditioner.T @ rows
        moment = jnp.einsum("nrb,nb->r", z, design.weights[:, None] * tau)
        return (state[0] + z @ jnp.moveaxis(z, 1, 2), state[1] + moment), None

    return jax.lax.scan(add, state, blocks(motion, tau, valid))[0]


@jax.jit
def _scores(design, motion, tau, valid, preconditioner, psi):
    """Score (blocks, r) of every block and residual (CHUNK, n) [N m; N]; what is not valid has none."""

    def one(block):
        motion, tau, valid = block
        rows = design_rows(design, motion, valid).reshape(len(psi), -1)
        residual = (_row_weights(design, motion, valid) * tau).ravel() - psi @ rows
        return preconditioner.T @ (rows @ residual), (residual.reshape(tau.shape) / design.weights[:, None]).T

    scores, residual = jax.lax.map(one, blocks(motion, tau, valid))
    return scores, residual.reshape(-1, residual.shape[-1])


def _expression(columns: list[str], lead: int, factors: np.ndarray) -> str:
    others = [c for c in np.flatnonzero(np.abs(factors) > 1e-6) if c != lead]
    return columns[lead] + "".join(
        f" {'-' if factors[c] < 0 else '+'} {abs(factors[c]):.4g} {columns[c]}" for c in others
    )
