"""Inertial parameters that a real body could have: those whose pseudo-inertia matrix is positive semidefinite.

P = [[S, h], [h', m]],   S = tr(I)/2 1 - I                                  (Wensing, Kim and Slotine, RA-L 2018)
"""

import numpy as np

LEAST = 1e-7
"""[kg m^2; kg] Smallest eigenvalue of a pseudo-inertia that was mended: a gram at a centimetre from its centre."""


def realisable(row: np.ndarray) -> np.ndarray:
    """The nearest (10,) parameters of a real body, as `types.Robot.inertial` has them; the row itself where it is one.

    Eigenvalues of the pseudo-inertia below zero are put to LEAST.
    """
    row = np.asarray(row, float)
    mass, first, (xx, xy, yy, xz, yz, zz) = row[0], row[1:4], row[4:]
    about = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    pseudo = np.empty((4, 4))
    pseudo[:3, :3] = np.trace(about) / 2 * np.eye(3) - about
    pseudo[:3, 3] = pseudo[3, :3] = first
    pseudo[3, 3] = mass
    values, vectors = np.linalg.eigh(pseudo)
    if values[0] > 0:
        return row
    pseudo = (vectors * np.maximum(values, LEAST)) @ vectors.T
    second = pseudo[:3, :3]
    about = np.trace(second) * np.eye(3) - second
    return np.array([pseudo[3, 3], *pseudo[:3, 3], *about[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]])
