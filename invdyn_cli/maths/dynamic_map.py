r"""The Dynamic Bézier Map: tau = H(q) qdd + C(q)(qd, qd) + g(q), every coefficient a tensor of one-joint functions.

The only assumption about the geometry is that joints turn: a coefficient depends on each joint's angle by a
trigonometric polynomial of degree 1 or 2 (`bezier`), so that it is a linear combination of products of one function per
joint. Three forms, from the largest to the smallest:

- naive: every coefficient of every joint's torque is a full tensor, degree 2 in H and C, degree 1 in g.
- structured: only the degrees that a coefficient has. With a <= b the smallest two of its indices, joints up to a are
  absent (the inertia that a joint feels lies outward of it), those up to b have degree 1 (they carry a force inward),
  the others degree 2 (they turn an inertia); g_i = dU / dq_i has degree 1 in all joints, and no constant in q_i.
- shared: one H and one potential U for all joints, the torque by Lagrange's equations; C follows by Christoffel.

Source: derived; Ulbrich et al. (2009, 2012) name the ingredients (tensor products of rational Bézier functions, squared
trigonometric functions, the Lagrangian), and how they counted is not known.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce
from itertools import combinations_with_replacement
from math import prod
from typing import Literal, NamedTuple

import jax.numpy as jnp

from invdyn_cli.maths import bezier
from invdyn_cli.types import Array, Motion

Form = Literal["naive", "structured", "shared"]
FORMS = ("naive", "structured", "shared")

Degrees = tuple[int, ...]
"""Per joint the degree of a coefficient's functions, 0 where the joint is absent."""


Tables = dict[int, tuple[Array, Array]]
"""Per degree the values and slopes (2 degree + 1, n) of all joints' functions."""


class Arc(NamedTuple):
    """Where the angles were, (n,) each [rad]: the middle of every joint's range, and alpha of the Bézier form."""

    middle: Array
    alpha: Array


@dataclass(frozen=True)
class DynamicMap:
    """The columns of a form for n joints."""

    form: Form
    basis: bezier.Basis
    joints: int

    @property
    def sizes(self) -> tuple[int, ...]:
        """Columns of each system of equations: one per joint (structured), or one for all."""
        n = self.joints
        if self.form == "naive":
            return ((n + n * (n + 1) // 2) * 5**n + 3**n,)
        if self.form == "shared":
            return (sum(_size(inertia(n, i, j)) for i, j in pairs(n)) + 3**n - 1,)
        return tuple(
            sum(_size(inertia(n, i, j)) for j in range(n))
            + sum(_size(coriolis(n, i, j, k)) for j, k in velocities(n, i))
            + 2 * 3 ** (n - 1)
            for i in range(n)
        )

    @property
    def targets(self) -> int:
        """Joints whose torques are fitted on the same columns: all, or one at a time."""
        return self.joints if self.form == "naive" else 1

    @property
    def equations(self) -> int:
        """Rows that a sample gives a system: one for each joint where they share coefficients."""
        return self.joints if self.form == "shared" else 1

    @property
    def parameters(self) -> int:
        """How many numbers are learned."""
        return sum(self.sizes) * self.targets

    def columns(self, arc: Arc, motion: Motion) -> tuple[Array, ...]:
        """The columns of ONE sample, a motion of (n,) arrays: naive one array (p,), shared one (n, p), structured one
        (p_i,) for each joint."""
        x = motion.q - arc.middle
        tables = {d: bezier.functions(self.basis, d, x, arc.alpha) for d in (1, 2)}
        if self.form == "naive":
            return (self._naive(tables, motion),)
        if self.form == "shared":
            return (self._shared(tables, motion),)
        return tuple(self._of_joint(i, tables, motion) for i in range(self.joints))

    def _naive(self, tables: Tables, motion: Motion) -> Array:
        n, qd = self.joints, motion.qd
        drives = jnp.array([*motion.qdd, *(qd[j] * qd[k] for j, k in pairs(n))])
        return jnp.concatenate([(drives[:, None] * products(tables, (2,) * n)).ravel(), products(tables, (1,) * n)])

    def _of_joint(self, i: int, tables: Tables, motion: Motion) -> Array:
        n, qd = self.joints, motion.qd
        parts = [motion.qdd[j] * products(tables, inertia(n, i, j)) for j in range(n)]
        parts += [qd[j] * qd[k] * products(tables, coriolis(n, i, j, k)) for j, k in velocities(n, i)]
        return jnp.concatenate([*parts, products(tables, (1,) * n, sloped=i, constant=False)])

    def _shared(self, tables: Tables, motion: Motion) -> Array:
        """Lagrange's equations on each product: tau = d/dt dT/dqd - dT/dq + dU/dq."""
        n, qd, qdd = self.joints, motion.qd, motion.qdd
        parts = []
        for i, j in pairs(n):
            degrees = inertia(n, i, j)
            value = products(tables, degrees)
            slopes = {k: products(tables, degrees, sloped=k) for k in range(n) if degrees[k]}
            change = sum((slopes[k] * qd[k] for k in slopes), jnp.zeros_like(value))
            rows = [jnp.zeros_like(value)] * n
            for own, other in {(i, j), (j, i)}:  # T holds H_ij twice, or half of H_ii
                rows[own] = rows[own] + value * qdd[other] + change * qd[other]
            for k, slope in slopes.items():
                rows[k] = rows[k] - slope * qd[i] * qd[j] * (0.5 if i == j else 1.0)
            parts.append(jnp.stack(rows))
        potential = jnp.stack([products(tables, (1,) * n, sloped=k) for k in range(n)])
        return jnp.concatenate([*parts, potential[:, 1:]], axis=1)  # a constant moves nothing: one product is too many


def pairs(n: int) -> Iterator[tuple[int, int]]:
    """All (i, j) with i <= j."""
    return combinations_with_replacement(range(n), 2)


def inertia(n: int, i: int, j: int) -> Degrees:
    """Degrees of H_ij."""
    a, b = sorted((i, j))
    return (0,) * (a + 1) + (1,) * (b - a) + (2,) * (n - b - 1)


def coriolis(n: int, i: int, j: int, k: int) -> Degrees:
    """Degrees of C_ijk, the coefficient of qd_j qd_k in the torque of joint i."""
    return inertia(n, *sorted((i, j, k))[:2])


def velocities(n: int, i: int) -> Iterator[tuple[int, int]]:
    """All (j, k), j <= k, whose product acts on joint i: C_iji is zero for j <= i, as H_ii knows no q_j."""
    return ((j, k) for j, k in pairs(n) if k != i)


def _size(degrees: Degrees) -> int:
    return prod(2 * d + 1 for d in degrees)


def products(tables: Tables, degrees: Degrees, sloped: int | None = None, constant: bool = True) -> Array:
    """All products (size,) of the joints' functions; of joint `sloped` their slopes, without the first function's
    where not `constant`."""
    factors = []
    for joint, degree in enumerate(degrees):
        if degree:
            values, slopes = tables[degree]
            factors.append((slopes if joint == sloped else values)[:, joint][0 if constant or joint != sloped else 1 :])
    return reduce(lambda a, b: jnp.outer(a, b).ravel(), factors, jnp.ones(1))
