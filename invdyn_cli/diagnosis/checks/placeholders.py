"""Which inertias of a robot were neither measured nor computed: zero, equal on all axes, the same on several links."""

import numpy as np

from invdyn_cli.types import Robot


def doubtful_inertias(robot: Robot) -> np.ndarray:
    """(n,) bool: bodies whose rotational inertia about the centre of mass is that of no CAD program.

    Fixed links are merged into the body that carries them, so of several placeholders in one body the sum is judged.
    """
    found = np.zeros(robot.dofs, bool)
    about = [about_centre(row) for row in np.asarray(robot.inertial, float)]
    for j, inertia in enumerate(about):
        found[j] = kind_of(inertia, float(robot.inertial[j][0])) is not None
    for j in range(len(about)):
        found[j] |= any(k != j and _alike(about[j], about[k]) for k in range(len(about)))
    return found


def about_centre(row: np.ndarray) -> np.ndarray:
    """(3, 3) [kg m^2] about the centre of mass, axes of the joint frame, of ten parameters as in `Robot.inertial`."""
    mass, first = float(row[0]), np.asarray(row[1:4], float)
    inertia = np.array([[row[4], row[5], row[7]], [row[5], row[6], row[8]], [row[7], row[8], row[9]]], float)
    centre = first / mass if mass > 0 else np.zeros(3)
    return inertia - mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))


def kind_of(inertia: np.ndarray, mass: float) -> str | None:
    """ "zero" or "equal on all axes", or None for an inertia (3, 3) that a body may have."""
    values = np.linalg.eigvalsh((inertia + inertia.T) / 2)
    if values.max() < 1e-9 * max(mass, 1e-9):
        return "zero"
    if np.ptp(values) < 1e-3 * values.max():
        return "equal on all axes"
    return None


def _alike(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two inertias have the very same principal moments."""
    a, b = (np.linalg.eigvalsh((x + x.T) / 2) for x in (one, other))
    return bool(a.max() > 0 and np.max(np.abs(a - b)) < 1e-6 * a.max())
