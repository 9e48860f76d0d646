"""Inertias of a robot that were neither measured nor computed: zero, equal on all axes, or equal on several links."""

from collections.abc import Sequence

import numpy as np

from invdyn_cli.types import Robot

ZERO, EQUAL, SAME = "zero", "equal on all axes", "the same as another link's"


def doubtful_inertias(robot: Robot) -> np.ndarray:
    """(n,) bool: bodies whose rotational inertia about the centre of mass is that of no CAD program.

    Fixed links are merged into the body that carries them; if a body contains several placeholders, their sum is
    judged.
    """
    rows = np.asarray(robot.inertial, float)
    return np.array([kind is not None for kind in kinds_of([about_centre(row) for row in rows], rows[:, 0])])


def kinds_of(inertias: Sequence[np.ndarray], masses: Sequence[float] | np.ndarray) -> list[str | None]:
    """For inertias (3, 3) about centres of mass [kg m^2]: ZERO, EQUAL or SAME for a placeholder, None for a possible
    body."""
    moments = [np.linalg.eigvalsh((x + x.T) / 2) for x in inertias]
    return [_kind(k, moments, float(mass)) for k, mass in enumerate(masses)]


def _kind(k: int, moments: Sequence[np.ndarray], mass: float) -> str | None:
    own = moments[k]
    if own.max() < 1e-9 * max(mass, 1e-9):
        return ZERO
    if np.ptp(own) < 1e-3 * own.max():
        return EQUAL
    others = (x for j, x in enumerate(moments) if j != k)
    return SAME if any(np.max(np.abs(own - x)) < 1e-6 * own.max() for x in others) else None


def about_centre(row: np.ndarray) -> np.ndarray:
    """(3, 3) [kg m^2] about the centre of mass, axes of the joint frame, of ten parameters as in `Robot.inertial`."""
    mass, first = float(row[0]), np.asarray(row[1:4], float)
    inertia = np.array([[row[4], row[5], row[7]], [row[5], row[6], row[8]], [row[7], row[8], row[9]]], float)
    centre = first / mass if mass > 0 else np.zeros(3)
    return inertia - mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
