"""From the base parameters of a regression to physically consistent links: inertials (n, 10) that predict the same.

A log determines a few combinations of the inertials; the others are free, and are chosen so that bodies are
consistent.
"""

import numpy as np
import scipy

from invdyn_cli.joints import units
from invdyn_cli.maths import pseudo_inertia
from invdyn_cli.maths.regression import Solution
from invdyn_cli.types import Array, Robot

CHANCE = 1e-3
"""How often true links cost more than what counts as chance."""

LIGHT = 1e-3
"""Share of the arm's mass, or mass [kg], below which a link of the URDF says nothing of the real one: a kilogramme of
water about its frame stands for it."""

EXACT = 1e-6
"""Share of the torque below which noise is not counted: what is seen beside nothing but rounding would be so sharp that
what is not seen drowns in its rounding errors."""


def consistent(robot: Robot, solution: Solution, covariance: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Parameters (p,) whose links can be bodies and that raise the squares least, those of the nominal links where the
    data show nothing; what they cost in noise variances; and what true ones cost at most but for a share CHANCE.

    Columns behind the inertial ones go along. The noise variance is what makes the mean cost of a true solution its
    rank; its quantile is that of a sum of squares with the `covariance` (rank, rank) of the kept coordinates
    (Satterthwaite 1946), which may differ between joints.
    """
    n = robot.dofs
    squares = solution.singular_values[: solution.rank] ** 2
    kept = solution.kept.T @ solution.psi
    share = squares[:, None] * covariance
    noise = max(float(np.trace(share)) / max(solution.rank, 1), EXACT**2 * float(squares @ kept**2), 1e-300)
    information = (solution.kept * (squares / noise)) @ solution.kept.T
    own, extra = np.arange(10 * n), np.arange(10 * n, len(solution.psi))
    tied = np.linalg.pinv(information[np.ix_(extra, extra)], hermitian=True) @ information[np.ix_(extra, own)]
    alone = information[np.ix_(own, own)] - information[np.ix_(own, extra)] @ tied
    wanted = solution.psi[own].reshape(n, 10)
    found = pseudo_inertia.consistent(_reference(robot), wanted, (alone + alone.T) / 2)
    change = (found.rows - wanted).ravel()
    psi = solution.psi + np.concatenate([change, -tied @ change])
    mean, spread = float(np.trace(share)) / noise, float(np.trace(share @ share)) / noise**2
    chance = spread / mean * float(scipy.stats.chi2.ppf(1 - CHANCE, mean**2 / spread)) if spread > 0 else 0.0
    return psi, found.cost, max(chance, 1.0)


def bodies(robot: Robot, theta: Array, covariance: Array) -> np.ndarray:
    """Coefficients (p,) of the standard model, the first 10 n of which change the links' parameters, as likely as they
    can be with links that are bodies; those that are bodies come back as they are.

    Args:
        covariance: (p, p) of the posterior, what was believed of the links included.
    """
    theta, own = np.asarray(theta, float), slice(10 * robot.dofs)
    wanted = np.asarray(robot.inertial, float) + theta[own].reshape(-1, 10)
    if all(pseudo_inertia.is_realisable(row) for row in wanted):
        return theta
    unit = np.sqrt(np.maximum(np.diag(covariance)[own], 1e-300))
    information = np.linalg.inv(covariance[own, own] / np.outer(unit, unit)) / np.outer(unit, unit)
    found = pseudo_inertia.consistent(_reference(robot), wanted, (information + information.T) / 2)
    return theta + covariance[:, own] @ information @ (found.rows - wanted).ravel()


def sentence(cost: float, chance: float, change: np.ndarray, robot: Robot) -> str:
    """A sentence: the best-fit links are not physically consistent, with the RMS torque (n,) by which the nearest
    consistent ones differ."""
    worst = int(np.argmax(change))
    torque = f"{change[worst]:.2g} {units(robot.prismatic[worst]).torque}"
    return (
        f"The best-fit links are not physically consistent. With the nearest consistent ones, squared errors grow by "
        f"{cost:.3g} noise variances (by chance {chance:.3g} at most), and the torque of {robot.joints[worst]} changes "
        f"by {torque} RMS. The model may lack friction, rotor inertia or an offset."
    )


def _reference(robot: Robot) -> Array:
    """(n, 10) the nominal links, or the nearest physically consistent ones."""
    rows = np.asarray(robot.inertial)
    least = LIGHT * max(1.0, float(rows[:, 0].sum()))
    water = pseudo_inertia.ball(1.0, np.zeros(3))
    return np.array([pseudo_inertia.realisable(r, pseudo_inertia.ROUND) if r[0] > least else water for r in rows])
