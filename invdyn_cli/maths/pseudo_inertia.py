"""Which inertial parameters a body can have: those whose 4 x 4 pseudo inertia is positive definite; and the nearest
consistent parameters to inconsistent ones.

With S = trace(I) / 2 - I, the second moments of the mass about the frame's origin,

    P = [[S, m c], [m c', m]] = integral of (x, y, z, 1)(x, y, z, 1)' dm

is positive definite if and only if some distribution of positive mass has these parameters: the mass is positive, and
the inertia about its centre is positive with the triangle inequality (Wensing, Kim and Slotine, RA-L 2018, eq. 8).
P is linear in the ten parameters, so the realisable ones are a convex cone.
"""

from typing import NamedTuple

import numpy as np
import scipy

from invdyn_cli.types import Array

FLOOR = 1e-6
"""Least eigenvalue of a pseudo inertia in units of the body's mass and size: a body that is thinner than a thousandth
of its size counts as impossible."""

ROUND = 1e-3
"""The same for a reference body: a point mass in a URDF is a placeholder."""

FARTHEST = 1.0
"""[m] Largest distance of a link's centre of mass from its frame, and largest radius of gyration."""

LEAST_MASS = 1e-6
"""[kg] Unit of mass of a row without a mass."""

PULL = 1e-3
"""Weight of the pull to the reference, in noise variances: small beside one, the least that data can show. Four times
that, for every body, is also about all that it costs."""

EXACT = 1e-6
"""Relative accuracy of the cost, if that is more than the pull costs."""

ROUNDING = 1e-13
"""Share of the largest information, in units of the reference, below which information is rounding error."""

STEPS, SHRINK, CLOSE, DAMPED = 50, 0.1, 1e-9, 0.25
"""Largest number of Newton steps for each weight of the pull, factor from one weight to the next, squared decrement at
which they stop, and decrement above which steps are damped."""


WATER = 1000.0
"""[kg/m^3] Density of the ball that a body is taken for where nothing is known of its inertia."""


class Consistent(NamedTuple):
    """Realisable rows (n, 10), and by how much they fit worse than the wanted ones (n, 10), in noise variances."""

    rows: np.ndarray
    cost: float


def pseudo_inertia(row: Array) -> np.ndarray:
    """P (4, 4) [kg m^2, kg m; kg] of a row (10,) in the order of `Robot.inertial`."""
    m, x, y, z, xx, xy, yy, xz, yz, zz = np.asarray(row, float)
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    second = np.trace(inertia) / 2 * np.eye(3) - inertia
    return np.block([[second, np.array([[x], [y], [z]])], [np.array([[x, y, z, m]])]])


def row_of(pseudo: Array) -> np.ndarray:
    """The row (10,) of a pseudo inertia (4, 4): `pseudo_inertia` back."""
    p = np.asarray(pseudo, float)
    return np.array([p[3, 3], *p[:3, 3], *_inertia(p)])


_BASIS = np.array([pseudo_inertia(unit) for unit in np.eye(10)])
"""(10, 4, 4) pseudo inertia of each parameter alone."""


def ball(mass: float, centre: Array) -> np.ndarray:
    """The row (10,) of a ball of water of this mass [kg] about a centre (3,) [m]."""
    place = np.array([*np.asarray(centre, float), 1.0])
    radius = (3 * mass / (4 * np.pi * WATER)) ** (1 / 3)
    return row_of(mass * (np.outer(place, place) + np.diag([radius**2 / 5] * 3 + [0.0])))


def is_realisable(row: Array) -> bool:
    """Whether a body can have this row (10,): no eigenvalue of its pseudo inertia, in units of the body's mass and
    size, is below zero except for rounding. Points, rods and plates are bodies."""
    return bool(np.linalg.eigvalsh(_scaled(row)[0])[0] >= -1e-12)


def realisable(row: Array, floor: float = FLOOR) -> np.ndarray:
    """The nearest row (10,) that a body can have; a row that has no eigenvalue below `floor` comes back as it is.

    Nearest in the Frobenius norm of the pseudo inertia in units of the row's own mass and size (eigenvalues below the
    floor are raised to it; Higham 1988): neither the unit of mass nor the frame's axes choose the body. A mass that
    would put its centre or its radius of gyration beyond `FARTHEST` is no measure, and one that would not is taken.
    """
    scaled, unit = _scaled(row)
    values, vectors = np.linalg.eigh(scaled)
    if values[0] >= floor:
        return np.array(row, float)
    nearest = (vectors * np.maximum(values, floor)) @ vectors.T
    return row_of(nearest * np.outer(unit, unit))


def consistent(reference: Array, wanted: Array, information: Array, pull: float = PULL) -> Consistent:
    """The realisable rows of n bodies that fit the data best; what the data do not show is as near to the reference as
    they let it.

    Minimises (phi - wanted)' N (phi - wanted) / 2 + pull * sum of trace(P R^-1) - log det(P R^-1), R being the
    reference's pseudo inertia: twice the relative entropy of mass distributions, which no unit and no frame changes
    (Lee, Wensing and Park, IEEE T-RO 2020, eq. 21). That is convex in phi itself, and the cone's own barrier: Newton's
    method on ten numbers a body finds the one minimum, from the reference with a strong pull that becomes weak. A
    Euclidean pull would need scales of masses and inertias, and would not keep what comes out strictly inside the cone.

    Args:
        reference: (n, 10) rows that are realisable (as `realisable(row, ROUND)` gives).
        wanted: (n, 10) rows of the best fit, whether or not a body can have them.
        information: (10 n, 10 n) N, the inverse covariance of the best fit; zero where the data show nothing.
    """
    reference, wanted = np.asarray(reference, float), np.asarray(wanted, float)
    units = np.array([_row_unit(row) for row in reference])
    unit = units.ravel()
    values, vectors = np.linalg.eigh(np.asarray(information, float) * np.outer(unit, unit))
    seen = values > ROUNDING * values[-1]
    factor = np.sqrt(values[seen])[:, None] * vectors[:, seen].T
    goal = factor @ (wanted / units).ravel()
    x = (reference / units).ravel()
    centre = np.linalg.inv(_pseudo(x))
    weight = cost = max(1.0, float(np.sum((factor @ x - goal) ** 2)))
    while weight > max(pull, EXACT * cost):
        weight = max(weight * SHRINK, pull)
        x = _centred(x, factor / np.sqrt(weight), goal / np.sqrt(weight), centre)
        cost = float(np.sum((factor @ x - goal) ** 2))
    return Consistent((x * unit).reshape(-1, 10), cost)


def _centred(x: np.ndarray, factor: np.ndarray, goal: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Minimum (10 n,) of |factor x - goal|^2 / 2 + trace(centre P(x)) - log det P(x), by damped Newton steps: it is
    self-concordant, so that steps of 1 / (1 + decrement) never leave the cone (Nesterov and Nemirovskii 1994).

    With P = L L' a step is the least-squares solution of factor dx = goal - factor x beside
    L^-1 P(dx) L^-T = 1 - L' centre L; normal equations would square what the data see of one direction and not of
    another, and how near the cone's edge is.
    """
    count = len(centre)
    for _ in range(STEPS):
        root = np.linalg.cholesky(_pseudo(x))
        inverse = np.linalg.inv(root)
        moves = np.einsum("nab,kbc,ndc->nadk", inverse, _BASIS, inverse).reshape(count, 16, 10)
        toward = np.eye(4) - np.einsum("nba,nbc,ncd->nad", root, centre, root)
        rows = np.concatenate([factor, np.asarray(scipy.linalg.block_diag(*moves))])
        step = np.linalg.lstsq(rows, np.concatenate([goal - factor @ x, toward.ravel()]), rcond=None)[0]
        decrement = float(np.linalg.norm(rows @ step))
        x = x + step / (1 + decrement if decrement > DAMPED else 1.0)
        if decrement**2 < CLOSE:
            break
    return x


def _pseudo(x: np.ndarray) -> np.ndarray:
    """Pseudo inertias (n, 4, 4) of n rows, one behind the other (10 n,)."""
    return np.tensordot(x.reshape(-1, 10), _BASIS, 1)


def _inertia(p):
    """[I_xx, I_xy, I_yy, I_xz, I_yz, I_zz] of a pseudo inertia."""
    return p[1, 1] + p[2, 2], -p[0, 1], p[0, 0] + p[2, 2], -p[0, 2], -p[1, 2], p[0, 0] + p[1, 1]


def _scaled(row: Array) -> tuple[np.ndarray, np.ndarray]:
    """A row's pseudo inertia (4, 4) in units of its own mass and size, and the unit (4,) of either side."""
    mass, size = _mass_and_size(row)
    unit = np.sqrt(mass) * np.array([size, size, size, 1.0])
    return pseudo_inertia(row) / np.outer(unit, unit), unit


def _row_unit(row: Array) -> np.ndarray:
    """(10,) units of the parameters, from a row's own mass and size."""
    mass, size = _mass_and_size(row)
    return mass * np.array([1.0] + [size] * 3 + [size**2] * 6)


def _mass_and_size(row: Array) -> tuple[float, float]:
    """The units of mass [kg] and length [m] for a row (10,), for any values."""
    row = np.asarray(row, float)
    first, second = float(np.linalg.norm(row[1:4])), float(np.linalg.norm(pseudo_inertia(row)[:3, :3]))
    mass = max(abs(float(row[0])), first / FARTHEST, second / FARTHEST**2, LEAST_MASS)
    return mass, max(first / mass, float(np.sqrt(second / mass)), 1e-3 * FARTHEST)
