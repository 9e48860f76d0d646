r"""Functions of one joint's angle: trigonometric polynomials of degree d, directly or as rational Bézier curves.

A rational Bézier curve of degree 2 d with the parameter tan(x / 2), taken between -alpha and alpha, is a trigonometric
polynomial of degree d: with u = sin((alpha - x) / 2) / sin(alpha) and v = sin((alpha + x) / 2) / sin(alpha),

    B_k(x) = C(2 d, k) u^(2 d - k) v^k,   k = 0 ... 2 d,

which has no singularity, at x = pi neither. On an arc the Bézier form is the better conditioned one, on a full circle
the trigonometric one.
"""

from math import comb
from typing import Literal

import jax.numpy as jnp

from invdyn_cli.types import Array

Basis = Literal["trig", "bezier"]
BASES = ("trig", "bezier")

REACH = 0.65
"""alpha as a share of half the range that an angle goes through, at which the Bézier form is conditioned best."""


def functions(basis: Basis, degree: int, x: Array, alpha: Array | float) -> tuple[Array, Array]:
    """Values and slopes (2 degree + 1, *x.shape) of all functions at x [rad], measured from the middle of the range."""
    if basis == "trig":
        waves = [f(k * x) for k in range(1, degree + 1) for f in (jnp.cos, jnp.sin)]
        slopes = [k * f(k * x) for k in range(1, degree + 1) for f in (lambda y: -jnp.sin(y), jnp.cos)]
        return jnp.stack([jnp.ones_like(x), *waves]), jnp.stack([jnp.zeros_like(x), *slopes])
    size = jnp.sin(alpha)
    u, du = jnp.sin((alpha - x) / 2) / size, -jnp.cos((alpha - x) / 2) / size / 2
    v, dv = jnp.sin((alpha + x) / 2) / size, jnp.cos((alpha + x) / 2) / size / 2
    order = 2 * degree
    values, slopes = [], []
    for k in range(order + 1):
        values.append(comb(order, k) * u ** (order - k) * v**k)
        of_u = (order - k) * u ** max(order - k - 1, 0) * v**k * du
        of_v = k * u ** (order - k) * v ** max(k - 1, 0) * dv
        slopes.append(comb(order, k) * (of_u + of_v))
    return jnp.stack(values), jnp.stack(slopes)
