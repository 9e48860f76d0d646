"""model=dbm: the Dynamic Bézier Map, a model of the torque that assumes nothing about the arm except that its joints
turn."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np

from invdyn_cli.chunks import CHUNK, padded
from invdyn_cli.errors import UsageError
from invdyn_cli.fields import counts
from invdyn_cli.interfaces import AbstractModel, Progress, silent
from invdyn_cli.maths import chains, least_squares, regression
from invdyn_cli.maths.bezier import BASES, REACH, Basis
from invdyn_cli.maths.dynamic_map import FORMS, Arc, DynamicMap
from invdyn_cli.maths.least_squares import SOLVERS, Solver
from invdyn_cli.models import rigid_model
from invdyn_cli.types import Array, Dataset, Fit, Motion, PyTree, Robot

COPIES = 4
"""Triangles of all columns that exist at a time: what was there, what is added, and LAPACK's working copy of both."""

ROWS = 256, 2048
"""Number of rows that are computed at a time: about as many as there are columns, within these limits."""

FOLDS = 5
"""Number of stretches into which a single trajectory is divided, to leave each out in turn."""


@dataclass(frozen=True)
class Dbm(AbstractModel):
    """Products of one-joint functions, by linear least squares (`maths.dynamic_map`), or with the tensors as trains
    whose cores are the displacements of an unknown chain (`maths.chains`).

    Attributes:
        form: naive, structured or shared (dense tensors of 5^n numbers, from the largest to the smallest), chain (a
            tensor train of 16 n numbers), or auto: shared up to five joints, chain beyond.
        basis: basis functions of dense tensors: trig, or bezier, centred on the training angles (better conditioned,
            extrapolates less).
        solver: least squares of dense tensors: ridge, tsvd (truncated), or lstsq (plain, diverges where the data
            contain no information).
        strength: [-] regularisation, relative to the largest singular value (tsvd) or to its square (ridge); None:
            chosen by leaving out in turn each trajectory, or each fifth of a single one.
        weighting: torque_spread divides the rows of each joint by the standard deviation of its torque if joints share
            coefficients; none does not.
        friction: coulomb_viscous adds the columns sign(qd), a ramp within `regression.REST_SPEED`, and qd for each
            joint; or none.
        offset: whether a constant torque per joint is fitted.
        rotor_inertia: whether a term in qdd per joint is fitted, for form=chain; the dense forms contain it.
        searches: largest number of searches for a chain; they end when two agree.
        memory: [GB] memory that the solution of dense tensors may take.
    """

    needs_robot = False

    form: Literal["auto", "naive", "structured", "shared", "chain"] = "auto"
    basis: Basis = "trig"
    solver: Solver = "ridge"
    strength: float | None = None
    weighting: Literal["none", "torque_spread"] = "torque_spread"
    friction: Literal["none", "coulomb_viscous"] = "none"
    offset: bool = False
    rotor_inertia: bool = False
    searches: int = 4
    memory: float = 8.0

    def __post_init__(self) -> None:
        for name, allowed in (
            ("form", ("auto", *FORMS, "chain")),
            ("basis", BASES),
            ("solver", SOLVERS),
            ("weighting", ("none", "torque_spread")),
            ("friction", ("none", "coulomb_viscous")),
        ):
            if getattr(self, name) not in allowed:
                raise UsageError(f"model.{name}={getattr(self, name)!r}; allowed: {', '.join(allowed)}")
        if self.strength is not None and not 0 < self.strength < 1:
            raise UsageError(f"model.strength={self.strength}; allowed: null, or a number between 0 and 1")
        counts(self, "model", "searches")
        if not self.memory > 0:
            raise UsageError(f"model.memory={self.memory}; allowed: a number > 0 [GB]")

    def form_of(self, n: int) -> str:
        """The form for n joints."""
        return ("shared" if n <= 5 else "chain") if self.form == "auto" else self.form

    @property
    def extras(self) -> tuple[str, ...]:
        """Names of the further columns of every joint."""
        return ("coulomb", "viscous") * (self.friction != "none") + ("offset",) * self.offset

    def columns(self, n: int) -> tuple[int, ...]:
        """Columns of a dense form's systems of equations, one per joint (structured) or one for all, extras and all."""
        own = len(self.extras) * (1 if self.form_of(n) == "structured" else n)
        return tuple(size + own for size in self._map(n).sizes)

    def init(self, dataset: Dataset, key: jax.Array) -> PyTree:
        """All coefficients zero, on the arc that the dataset goes through; of a chain, links without mass."""
        n = len(dataset.joints)
        if self.form_of(n) == "chain":
            turns, shifts, beside = jnp.zeros((n, 3)), jnp.zeros((n, 3)), jnp.zeros((len(self._beside_chain), n))
            return {"turns": turns, "shifts": shifts, "inertial": jnp.zeros((n, 10)), "extras": beside}
        theta = {f"system{i}": jnp.zeros((p, self._map(n).targets)) for i, p in enumerate(self.columns(n))}
        return {"arc": _arc(dataset)._asdict(), "theta": theta}

    def apply(self, params: PyTree, motion: Motion, robot: Robot | None) -> Array:
        """Torque (n,) of one sample."""
        if "turns" in params:
            arm = chains.robot(params["turns"], params["shifts"])
            columns = regression.extra_columns(self._beside_chain, motion)
            return rigid_model.torque(arm, params["inertial"], motion, params["extras"], columns)
        systems = self._columns(Arc(**params["arc"]), motion)
        return jnp.concatenate([jnp.ravel(x @ params["theta"][f"system{i}"]) for i, x in enumerate(systems)])

    def chunk(self, motion: Motion) -> int:
        """Number of samples at a time: their columns take at most some 300 MB."""
        n = motion.q.shape[1]
        if self.form_of(n) == "chain":
            return CHUNK
        numbers = sum(self.columns(n)) * self._map(n).equations
        return int(np.clip(2 ** int(np.log2(4e7 / numbers)), 1, CHUNK))

    def fit(
        self, dataset: Dataset, key: jax.Array, *, validation: Dataset | None = None, progress: Progress = silent
    ) -> Fit:
        """Least squares on all rows.

        details of dense forms: columns (systems,), rank (systems,), strength (targets,) in use, strengths and left_out
        (strengths, targets), the mean square of the (weighted) torque on trajectories that were left out. Of a chain:
        searches (searches,), the share of the weighted squares that each left; rank, directions that the data tell.

        Raises:
            UsageError: if a joint slides, or the columns do not fit into `memory`.
        """
        n = len(dataset.joints)
        _refuse_sliding(dataset)
        if self.form_of(n) == "chain":
            return self._fit_chain(dataset, key, progress)
        self._refuse_size(n)
        progress(0.0, f"{sum(self.columns(n)):,} columns, {_gigabytes(self.columns(n)):.2g} GB")
        arc, weights, parts, targets = _arc(dataset), self._weights(dataset), _groups(dataset), self._map(n).targets
        systems: list[list[tuple[np.ndarray, int]]] = [[] for _ in self.columns(n)]
        for number, part in enumerate(parts):
            for i, system in enumerate(systems):
                rows = part.samples * self._map(n).equations
                system.append((least_squares.triangle(self._rows(i, part, arc, weights)), rows))
                done = (number + (i + 1) / len(systems)) / len(parts)
                progress(0.7 * done, f"{self.columns(n)[i]:,} columns")
        solutions = []
        for i, system in enumerate(systems):
            solutions.append(least_squares.solve(system, targets, self.solver, self.strength))
            progress(0.7 + 0.3 * (i + 1) / len(systems), f"rank {solutions[-1].rank:,}")
        return Fit(
            params={"arc": arc._asdict(), "theta": {f"system{i}": s.theta for i, s in enumerate(solutions)}},
            robot=dataset.robot,
            joints=dataset.joints,
            parameters=sum(self.columns(n)) * targets,
            details={
                "columns": np.array(self.columns(n)),
                "rank": np.array([s.rank for s in solutions]),
                "strength": np.concatenate([s.strength for s in solutions]),
                "strengths": solutions[0].tried,
                "left_out": np.concatenate([s.left_out for s in solutions], axis=1),
            },
        )

    def _fit_chain(self, dataset: Dataset, key: jax.Array, progress: Progress) -> Fit:
        seed = int(jax.random.randint(key, (), 0, 2**31 - 1))
        motion, tau, weights = dataset.motion, dataset.tau, self._weights(dataset)
        found = chains.learn(motion, tau, weights, self._beside_chain, self.searches, seed, progress)
        params = {"turns": found.turns, "shifts": found.shifts, "inertial": found.inertial, "extras": found.extras}
        return Fit(
            params=params,
            robot=dataset.robot,
            joints=dataset.joints,
            parameters=found.rank,
            details={"searches": found.searches, "rank": found.rank},
            warnings=()
            if found.sure
            else ("No two searches found the same chain: more searches may find a better one (model.searches).",),
        )

    @property
    def _beside_chain(self) -> tuple[str, ...]:
        return self.extras + ("armature",) * self.rotor_inertia

    def _map(self, n: int) -> DynamicMap:
        return DynamicMap(self.form_of(n), self.basis, n)  # type: ignore[arg-type]

    def _columns(self, arc: Arc, motion: Motion) -> tuple[Array, ...]:
        """Columns of one sample, system by system (rows, p): the map's, then the extras."""
        n = motion.q.shape[-1]
        systems = self._map(n).columns(arc, motion)
        beside = jnp.array(regression.extra_columns(self.extras, motion)).reshape(-1, n)
        if self.form_of(n) == "shared":
            return (jnp.concatenate([systems[0], *map(jnp.diag, beside)], axis=1),)
        if self.form_of(n) == "naive":
            return (jnp.append(systems[0], beside)[None],)
        return tuple(jnp.append(x, beside[:, i])[None] for i, x in enumerate(systems))

    def _rows(self, system: int, part: Dataset, arc: Arc, weights: np.ndarray) -> Iterator[np.ndarray]:
        """Rows [X | Y] of one system, some at a time."""
        n = len(part.joints)
        shared = self.form_of(n) == "shared"
        size = int(np.clip(self.columns(n)[system] // self._map(n).equations, *ROWS))
        for x in part.trajectories:
            for start in range(0, len(x.t), size):
                motion, tau = x.motion[slice(start, start + size)], x.tau[start : start + size]
                columns = np.asarray(_columns_of(self, system, arc, padded(motion, size)))[: len(motion)]
                if shared:
                    columns, y = columns * weights[:, None], (tau * weights).reshape(-1, 1)
                else:
                    y = tau if self.form_of(n) == "naive" else tau[:, [system]]
                yield np.concatenate([columns.reshape(-1, columns.shape[-1]), y], axis=1)

    def _weights(self, dataset: Dataset) -> np.ndarray:
        """Weights (n,) of every joint's rows."""
        alike = self.weighting == "none"
        return np.ones(len(dataset.joints)) if alike else 1 / regression.torque_spread(dataset)

    def _refuse_size(self, n: int) -> None:
        needed = {form: _gigabytes(replace(self, form=form).columns(n)) for form in FORMS}
        form = self.form_of(n)
        if needed[form] > self.memory:
            fitting = [f for f in FORMS if needed[f] <= self.memory]
            raise UsageError(
                f"model.form={form} has {max(self.columns(n)):,} columns for {n} joints, and solving for them "
                f"takes about {needed[form]:,.1f} GB; allowed: {self.memory:g} GB (model.memory)",
                advice=f"model.form={fitting[-1] if fitting else 'chain'}",
            )


@jax.jit(static_argnums=(0, 1))
def _columns_of(model: Dbm, system: int, arc: Arc, motion: Motion) -> Array:
    """Columns (samples, rows, p) of one system."""
    return jax.vmap(lambda one: model._columns(arc, one)[system])(motion)


def _gigabytes(columns: tuple[int, ...]) -> float:
    """Memory [GB] to solve the largest system."""
    return COPIES * 8 * max(columns) ** 2 / 1e9


def _arc(dataset: Dataset) -> Arc:
    q = dataset.motion.q
    low, high = q.min(0), q.max(0)
    return Arc((low + high) / 2, np.clip(REACH * (high - low) / 2, 0.02, np.pi / 2))


def _groups(dataset: Dataset) -> list[Dataset]:
    """The parts that are left out in turn: whole trajectories, or stretches of the only one."""
    names = list(dict.fromkeys(x.name for x in dataset.trajectories))
    if len(names) > 1:
        own = [tuple(x for x in dataset.trajectories if x.name == name) for name in names]
    else:
        own = [_stretch(dataset, k) for k in range(FOLDS)]
    return [replace(dataset, trajectories=one) for one in own if sum(len(x.t) for x in one)]


def _stretch(dataset: Dataset, k: int) -> tuple:
    """The k-th of FOLDS stretches of every trajectory."""
    return tuple(x[len(x.t) * k // FOLDS : len(x.t) * (k + 1) // FOLDS] for x in dataset.trajectories)


def _refuse_sliding(dataset: Dataset) -> None:
    slides = dataset.robot.prismatic if dataset.robot is not None else ()
    named = [joint for joint, slide in zip(dataset.joints, slides, strict=False) if slide]
    if named:
        raise UsageError(
            f"model=dbm supports only revolute joints; prismatic: {', '.join(named)}",
            advice="model=pest or model=ffnn",
        )
