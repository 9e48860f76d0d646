"""Where the joints of an arm are over time, for the stick figure beside a page's plots."""

import jax
import numpy as np

from invdyn_cli.maths.rigid_body import link_motions
from invdyn_cli.report.interactive import Posture, Timeline
from invdyn_cli.types import Robot

FRAMES = 1000
"""Postures of a figure; the page draws straight lines between them."""


def posture(robot: Robot | None, time: Timeline, q: np.ndarray) -> Posture | None:
    """The base's origin, every joint's, and the last link's centre of mass at FRAMES of the rows q (T, n) [rad; m].

    None without a robot, or where no position is finite.
    """
    if robot is None or q.ndim != 2 or q.shape[1] != robot.dofs:
        return None
    good = np.flatnonzero(np.isfinite(q).all(axis=1))
    if not len(good):
        return None
    rows = good[np.linspace(0, len(good) - 1, FRAMES).astype(int)]
    still = np.zeros((robot.dofs, FRAMES))
    links = _link_motions(robot, q[rows].T, still, still)
    origins = np.stack([np.asarray(x) for x in links.origin], axis=-1)
    inertial = np.asarray(robot.inertial, float)
    ends = [j for j in range(robot.dofs) if j not in robot.parents]
    tips = []
    for j in ends:
        com = inertial[j, 1:4] / inertial[j, 0] if inertial[j, 0] > 0 else np.zeros(3)
        turned = np.stack([sum(np.asarray(links.rotation[r][c][j]) * com[c] for c in range(3)) for r in range(3)], -1)
        tips.append(origins[j] + turned)
    points = np.stack([np.zeros_like(origins[0]), *origins, *tips], axis=1) @ _upright(np.asarray(robot.gravity)).T
    parents = [-1, *(p + 1 for p in robot.parents), *(j + 1 for j in ends)]
    return Posture(time.joined()[0][rows], points, parents, robot.joints)


_link_motions = jax.jit(link_motions)


def _upright(gravity: np.ndarray) -> np.ndarray:
    """(3, 3) the turn from the base's frame to one whose z points against gravity; none without gravity."""
    size = float(np.linalg.norm(gravity))
    up = -gravity / size if size > 0 else np.array([0.0, 0.0, 1.0])
    if up[2] > 1 - 1e-9:
        return np.eye(3)
    if up[2] < 1e-9 - 1:
        return np.diag([1.0, -1.0, -1.0])
    axis = np.cross(up, [0.0, 0.0, 1.0])
    skew = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + skew + skew @ skew / (1 + up[2])
