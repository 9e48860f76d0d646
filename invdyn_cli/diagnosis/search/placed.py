"""On which link a force acts, and at which point of it, where a log says so.

The torque of a force f at a point p of a link is linear in f and in the products of f and p: twelve columns, in which
all that lasts is projected out once for each link. Force and point then follow from a small least-squares problem.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from invdyn_cli.diagnosis.columns.candidates import by_place, passing, passing_candidate
from invdyn_cli.diagnosis.columns.evidence import Candidate, Evidence, filtered
from invdyn_cli.diagnosis.search.coordinates import REACH
from invdyn_cli.diagnosis.search.judge import (
    PRICE_OF_COEFFICIENT,
    PRICE_OF_EFFECT,
    Hypothesis,
    HypothesisScorer,
)
from invdyn_cli.diagnosis.search.windowed import Lasting, Windowed
from invdyn_cli.effects.composition import TimeWindow

SETTLED = 2.0
"""Periods of a low-pass filter's cut-off within which its answer to a step has settled."""

ASKED = PRICE_OF_EFFECT + 3 * PRICE_OF_COEFFICIENT
"""Noise variances by which a link with a point must do better than what was tried."""


def placed(judge: HypothesisScorer, always: Hypothesis, hypothesis: Hypothesis) -> Hypothesis:
    """The hypothesis with its forces on the links, and at the points, that the data clearly ask for."""
    for c in hypothesis:
        if not c.effect.placed_by or c.when is None or c.joint is None:
            continue
        others = (*always, *(e for e in hypothesis if e is not c))
        left = judge.evidence.residual(others, judge.quick(others)[1])
        found = at_best_point(judge.evidence, c, c.when, others, judge.weights * judge.grams.used, left)
        judge.refresh()
        if found and judge.quick((*others, found))[0] < judge.quick((*others, c))[0] - ASKED:
            hypothesis = tuple(found if e is c else e for e in hypothesis)
    return hypothesis


def at_best_point(
    evidence: Evidence, c: Candidate, when: TimeWindow, lasting: Hypothesis, used: np.ndarray, left: np.ndarray
) -> Candidate | None:
    """A force on the link, and at the point, that explain most in a window; None if it does as well where it was tried,
    or at the origin of a frame.

    Args:
        lasting: what is fitted anew beside it.
        used: (R, n) weights of the rows.
        left: (R, n) what remains without the force.
    """
    name, (inside, near) = c.effect.placed_by, _inside(evidence, when)
    used = np.where(near[:, None], 0.0, used)
    beside = Lasting.beside(evidence, lasting, used)
    refit = beside.explained(left)
    assert c.joint is not None
    links = []
    for joint in range(evidence.dofs):
        columns = _columns(evidence, c, joint)
        windowed = Windowed(beside, columns, np.zeros(len(columns)), left, refit, np.flatnonzero(inside))
        links.append(Link.of(*windowed.equations([(0, int(inside.sum()))]), float(1 / np.sqrt(c.precision[0]))))
    tried = [links[c.joint].least_at(np.asarray(c.effect.whole(c.shape)[name], float))]
    least = min(tried + [link.least_at(np.zeros(3)) for link in links]) - ASKED
    best: tuple[int, np.ndarray] | None = None
    for joint in reversed(range(evidence.dofs)):  # a force on a joint's axis is the same on both links: the outer one
        if links[joint].least > least:
            continue
        loss, point = links[joint].best()
        made = c.effect.found([0.0] * len(c.precision), {name: point}, evidence.robot, joint)
        if loss < least and not c.effect.refuse(made):
            least, best = loss - PRICE_OF_EFFECT, (joint, point)
    return None if best is None else passing_candidate(evidence, c.effect, best[0], when, {name: best[1]})


def _inside(evidence: Evidence, when: TimeWindow) -> tuple[np.ndarray, np.ndarray]:
    """(R,) each: rows inside the windows; and rows near an edge, where the filter mixes what is inside with what is not
    and the columns below are not exact."""
    t, own = evidence.on_rows("t"), evidence.trajectory == when.trajectory
    inside, near = np.zeros((2, len(t)), bool)
    for one in when.each:
        reach = min(SETTLED / min(evidence.recording.filter.cutoffs), (one.end - one.start) / 4)
        inside |= own & (t >= one.start) & (t < one.end)
        near |= own & ((np.abs(t - one.start) < reach) | (np.abs(t - one.end) < reach))
    return inside, near


@dataclass(frozen=True)
class Link:
    """What a force on one link explains: `root` (m, 12) and `target` (m,), so that the loss of coefficients x (12,) is
    |root x - target|^2 - |target|^2; `scale` [N] of the force's prior."""

    root: np.ndarray
    target: np.ndarray
    scale: float

    @classmethod
    def of(cls, normal: np.ndarray, moment: np.ndarray, scale: float) -> "Link":
        """From the normal equations (12, 12) and (12,) of its columns."""
        values, vectors = np.linalg.eigh(normal)
        kept = values > 1e-9 * max(values[-1], 1e-300)
        root = np.sqrt(values[kept])
        return cls(root[:, None] * vectors[:, kept].T, vectors[:, kept].T @ moment / root, scale)

    @property
    def least(self) -> float:
        """A loss that no force and point come below: that of any twelve coefficients."""
        return -float(self.target @ self.target)

    def least_at(self, point: np.ndarray) -> float:
        """The loss with the best force at this point."""
        return self._loss(np.append(self._force(point), point))

    def best(self) -> tuple[float, np.ndarray]:
        """The least loss, and the point (3,) [m] that has it: sought from the origin, and from the force and point
        whose products are nearest to the coefficients that explain most."""
        rows = np.vstack([self.root, np.diag(np.append(np.full(3, 1.0), np.full(9, 1 / REACH)) / self.scale)])
        products = np.linalg.lstsq(rows, np.append(self.target, np.zeros(12)))[0].reshape(4, 3)
        left, *_ = np.linalg.svd(products)
        nearest = np.clip(left[1:, 0] / left[0, 0], -1.0, 1.0) if left[0, 0] else np.zeros(3)
        starts = [np.append(self._force(point), point) for point in (np.zeros(3), nearest)]
        jacobian: Any = self._slopes
        best = min(
            (scipy.optimize.least_squares(self._residual, x, jacobian, x_scale=_scale(x)).x for x in starts),
            key=self._loss,
        )
        return self._loss(best), best[3:]

    def _force(self, point: np.ndarray) -> np.ndarray:
        slopes = self._slopes(np.append(np.zeros(3), point))[:-3, :3]
        return np.linalg.lstsq(slopes, np.append(self.target, np.zeros(3)))[0]

    def _residual(self, x: np.ndarray) -> np.ndarray:
        force, point = x[:3], x[3:]
        made = np.append(force, np.outer(point, force))
        return np.concatenate([self.root @ made - self.target, force / self.scale, point / REACH])

    def _slopes(self, x: np.ndarray) -> np.ndarray:
        force, point = x[:3], x[3:]
        by_force = np.vstack([np.eye(3), np.kron(point[:, None], np.eye(3))])
        by_point = np.vstack([np.zeros((3, 3)), np.kron(np.eye(3), force[:, None])])
        own = np.diag(np.append(np.full(3, 1 / self.scale), np.full(3, 1 / REACH)))
        return np.vstack([self.root @ np.hstack([by_force, by_point]), own])

    def _loss(self, x: np.ndarray) -> float:
        return float(np.sum(self._residual(x) ** 2)) + self.least


def _columns(evidence: Evidence, c: Candidate, joint: int) -> np.ndarray:
    """(12, n, R) torques of unit forces at the origin of a joint's frame, and what they change by a metre along each of
    its axes; cached."""
    key = ("by point", c.effect.name, joint)
    if key not in evidence.kept:
        origin = passing(evidence, c.effect, joint)
        parts = [origin, *by_place(evidence, c.effect, joint, origin)]
        evidence.kept[key] = [np.concatenate([filtered(evidence.recording, x) for x in parts])]
    return evidence.kept[key][0]


def _scale(x: np.ndarray) -> np.ndarray:
    """(6,) typical steps of a force and its point."""
    return np.append(np.full(3, max(np.linalg.norm(x[:3]), 1e-3)), np.full(3, REACH))
