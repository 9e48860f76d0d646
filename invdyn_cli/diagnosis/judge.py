"""The judge: what Gram matrices of the chosen rows, by block, say of any set of causes, in a millisecond."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from invdyn_cli.diagnosis.evidence import DRY, Candidate, Evidence, shared_out
from invdyn_cli.interfaces import (
    AbstractBodyEffect,
    AbstractChannelEffect,
    AbstractForceEffect,
    AbstractGearEffect,
    AbstractTorqueEffect,
)

FOLDS = 8
"""Parts of the blocks that are held out in turn."""

PRICE_OF_EFFECT, PRICE_OF_COEFFICIENT = 12.0, 4.0
"""In units of the noise variance: an effect must gain more. About 2 log(tries) and log(samples), as BIC has it
(Schwarz 1978; Foster and George 1994 for the number of tries)."""

RELEVANT = 0.002
"""Share of a joint's RMS torque that an effect must be worth: an honest log of a right model leaves nearly as much by
clocks, interpolation and filters."""

FARTHEST = 1.5
"""Reaches beyond which a channel's correction of a trial is no longer the straight line that it is taken for."""

CANCELLED = 3.0
"""Times the RMS of what the nominal model leaves on a joint, above which the torque of an effect there can only be what
other effects take back: of two that cancel each other, neither is known."""

SPARE = 128
"""Columns for which there is room before matrices are copied."""

LEAST_PRECISION = 1e-9

Hypothesis = tuple[Candidate, ...]


@dataclass(frozen=True)
class Verdict:
    """How a hypothesis does: its `loss` with prices, the held-out loss of each block (B,), its coefficients."""

    loss: float
    blocks: np.ndarray
    theta: np.ndarray


class Judge:
    """Gram matrices of the chosen rows, by block, and what they say of hypotheses.

    Args:
        rows: (R,) bool, which rows count.
        weights: (n,) 1 / (noise variance x autocorrelation time) of every row of the arm.
        deviation: (n,) standard deviation of the noise [N m; N].
        always: candidates that are part of every hypothesis.
    """

    def __init__(
        self,
        evidence: Evidence,
        rows: np.ndarray,
        weights: np.ndarray,
        deviation: np.ndarray,
        always: Hypothesis = (),
    ) -> None:
        self.evidence, self.rows, self.weights = evidence, rows, weights
        numbers, self.block = np.unique(evidence.block[rows], return_inverse=True)
        self.count = len(numbers)
        self.folds = np.arange(self.count) % min(FOLDS, self.count)
        self.grams: list[np.ndarray] = [np.empty((self.count, 0, 0))] * evidence.dofs
        self.totals: list[np.ndarray] = [np.empty((0, 0))] * evidence.dofs
        used = evidence.valid[rows]
        worth = weights * np.sum((RELEVANT * evidence.tau[rows]) ** 2 * used, axis=0)
        self.least = {j: x for j, x in enumerate(worth)} | {None: float(np.mean(worth))}
        self.rows_worth = weights * used.sum(0)
        self.deviation = deviation
        self.always = always
        self._room: list[np.ndarray] = list(self.grams)
        self._freedom: dict[int, float] = {}
        self._prices: dict[int, tuple[float, Candidate]] = {}
        self.tried = 0

    def refresh(self) -> None:
        """Take in the columns that were added to the evidence since."""
        edges = np.searchsorted(self.block, np.arange(self.count + 1))
        for j, table in enumerate(self.evidence.tables):
            if table.shape[1] != self.grams[j].shape[1]:
                x, known = table[self.rows] * self.evidence.valid[self.rows, j : j + 1], self.grams[j].shape[1]
                room, count = self._room[j], x.shape[1]
                if count > room.shape[1]:
                    room = np.zeros((self.count, count + SPARE, count + SPARE))
                    room[:, :known, :known] = self.grams[j]
                    self._room[j] = room
                for block, (a, b) in enumerate(pairwise(edges)):
                    room[block, :count, known:count] = x[a:b].T @ x[a:b, known:]
                    room[block, known:count, :known] = room[block, :known, known:count].T
                self.grams[j] = room[:, :count, :count]
                total = np.empty((count, count))
                total[:known, :known] = self.totals[j]
                total[:, known:] = self.grams[j][:, :, known:].sum(0)
                total[known:, :known] = total[:known, known:].T
                self.totals[j] = total

    def sums(self, hypothesis: Sequence[Candidate]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Squares s (B,), moments r (B, k) and normal matrices N (B, k, k) of a hypothesis' blocks."""
        return self._assembled(hypothesis, self.grams)

    def _assembled(self, hypothesis: Sequence[Candidate], grams: Sequence[np.ndarray], only: int | None = None):
        """`sums` from Gram matrices (..., columns, columns) of all rows of the arm, or of one."""
        starts = np.cumsum([0, *(len(c.precision) for c in hypothesis)])
        k, shape = int(starts[-1]), grams[0].shape[:-2]
        s, r, normal = np.zeros(shape), np.zeros((*shape, k)), np.zeros((*shape, k, k))
        for j, gram in enumerate(grams):
            w = self.weights[j]
            if not w or only not in (None, j):
                continue
            fixed, free, place = [0], [], []
            for c, start in zip(hypothesis, starts[:-1], strict=True):
                if j in c.columns:
                    fixed += c.columns[j][0]
                    free += c.columns[j][1]
                    place += range(start, start + len(c.precision))
            if len(fixed) == 1 and not free:
                s += w * gram[..., 0, 0]
                continue
            signs = np.array([1.0] + [-1.0] * (len(fixed) - 1))
            columns = np.array([*fixed, *free])
            own = gram[..., columns[:, None], columns]
            m = len(fixed)
            s += w * (own[..., :m, :m] @ signs @ signs)
            if free:
                at = np.array(place)
                r[..., at] += w * (own[..., m:, :m] @ signs)
                normal[..., at[:, None], at] += w * own[..., m:, m:]
        return s, r, normal

    def quick(self, hypothesis: Sequence[Candidate]) -> tuple[float, np.ndarray]:
        """Loss with prices on the data that fits the hypothesis, and its coefficients."""
        s, r, normal = self._assembled(hypothesis, self.totals)
        theta = solved(normal, r, _precision(hypothesis))
        return float(s - theta @ r) + self.price(hypothesis), theta

    def extended(
        self, base: Sequence[Candidate], candidates: Sequence[Candidate]
    ) -> tuple[np.ndarray, list[np.ndarray]]:
        """`quick`'s losses (len(candidates),) of a hypothesis with one of these beside it, all at once; and their own
        coefficients.

        What is in the hypothesis is projected out of every column (Schur's complement of its normal matrix), so that
        each candidate is a small problem of its own.
        """
        s, r, normal = self._assembled(base, self.totals)
        prior = _precision(base)
        inverse = np.linalg.inv(normal + np.diag(prior + LEAST_PRECISION * np.diag(normal) + 1e-300))
        theta = inverse @ r
        crossed, towards = self._crossed(base, theta)
        groups: dict[tuple, list[int]] = {}
        for i, c in enumerate(candidates):
            fixed = len(next(iter(c.columns.values()))[0])
            groups.setdefault((tuple(c.columns), fixed, len(c.precision)), []).append(i)
        losses, own_factors = np.empty(len(candidates)), [np.zeros(0)] * len(candidates)
        before = float(s - theta @ r) + self.price(base)
        for (joints, fixed, free), members in groups.items():
            m = fixed + free
            square, cross, moment = (np.zeros((len(members), *shape)) for shape in ((m, m), (m, len(theta)), (m,)))
            for j in joints:
                if self.weights[j]:
                    at = np.array([[*candidates[i].columns[j][0], *candidates[i].columns[j][1]] for i in members])
                    at = at.reshape(len(members), m)
                    square += self.weights[j] * self.totals[j][at[:, :, None], at[:, None, :]]
                    cross += crossed[j][at]
                    moment += towards[j][at]
            own = np.einsum("caa->ca", square)[:, fixed:]
            square = square - cross @ inverse @ np.swapaxes(cross, 1, 2)
            gain = 2 * moment[:, :fixed].sum(1) - square[:, :fixed, :fixed].sum((1, 2))
            if free:
                known = np.array([candidates[i].precision for i in members]) + LEAST_PRECISION * own + 1e-300
                normals = square[:, fixed:, fixed:] + known[:, :, None] * np.eye(free)
                towards_free = moment[:, fixed:] - square[:, fixed:, :fixed].sum(2)
                factors = np.linalg.solve(normals, towards_free[..., None])[..., 0]
                gain = gain + np.sum(factors * towards_free, axis=1)
                for i, factor in zip(members, factors, strict=True):
                    own_factors[i] = factor
            losses[members] = before - gain + [self.price((candidates[i],)) for i in members]
        return losses, own_factors

    def _crossed(self, base: Sequence[Candidate], theta: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Products of every column of each row with a hypothesis' own (C, k), and with what it leaves (C,)."""
        crossed, towards = [], []
        for j, gram in enumerate(self.totals):
            products, left, start = np.zeros((len(gram), len(theta))), gram[:, 0].copy(), 0
            for c in base:
                if j in c.columns:
                    fixed, free = c.columns[j]
                    left -= gram[:, list(fixed)].sum(1)
                    products[:, start : start + len(free)] = gram[:, list(free)]
                start += len(c.precision)
            crossed.append(self.weights[j] * products)
            towards.append(self.weights[j] * (left - products @ theta))
        return crossed, towards

    def verdict(self, hypothesis: Sequence[Candidate]) -> Verdict:
        """The held-out judgement."""
        s, r, normal = self.sums(hypothesis)
        precision = _precision(hypothesis)
        theta = solved(normal.sum(0), r.sum(0), precision)
        blocks = np.empty(self.count)
        for out, held in self._held_out(r, normal, precision):
            blocks[out] = _squares(s[out], r[out], normal[out], held)
        loss = float(blocks.sum() + np.sum(precision * theta**2)) + self.price(hypothesis)
        return Verdict(loss, blocks, theta)

    def _held_out(
        self, r: np.ndarray, normal: np.ndarray, precision: np.ndarray
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Blocks (B,) bool that are held out in turn, and the coefficients (k,) that the others give."""
        for fold in range(self.folds.max() + 1):
            out = self.folds == fold
            others = ~out if self.folds.max() else out
            yield out, solved(normal[others].sum(0), r[others].sum(0), precision)

    def by_row(self, hypothesis: Sequence[Candidate]) -> np.ndarray:
        """Held-out losses (n, B) of every joint's own rows, without prices."""
        _, r, normal = self.sums(hypothesis)
        rows = [self._assembled(hypothesis, self.grams, j) for j in range(len(self.grams))]
        out = np.zeros((len(self.grams), self.count))
        for at, held in self._held_out(r, normal, _precision(hypothesis)):
            for j, (s, own, squares) in enumerate(rows):
                out[j, at] = _squares(s[at], own[at], squares[at], held)
        return out

    def price(self, hypothesis: Sequence[Candidate]) -> float:
        """What a hypothesis must gain at least."""
        for c in hypothesis:
            if id(c) not in self._prices:
                local = c.joint if c.effect.point in ("torque", "channel", "gear") else None
                quiet = c.quiet * self.rows_worth[c.joint] * self.deviation[c.joint] ** 2 if c.quiet else 0.0
                value = PRICE_OF_EFFECT + PRICE_OF_COEFFICIENT * self.freedom(c) + self.least[local] + float(quiet)
                self._prices[id(c)] = value, c
        return sum(self._prices[id(c)][0] for c in hypothesis)

    def refused(self, hypothesis: Sequence[Candidate], theta: np.ndarray) -> str:
        """Why the coefficients of a hypothesis are no physics, "" if they are; what is always in it may be anything."""
        for candidate, own in shared_out(hypothesis, theta):
            if any(candidate is a for a in self.always):
                continue
            if why := self.impossible(candidate, own):
                return why
            if candidate.effect.point in ("channel", "gear"):
                continue
            if any(self._size(candidate, own, j) > CANCELLED * self._left(j) for j in candidate.columns):
                return f"{candidate.effect.title}: so large that other effects would have to take most of it back"
        return ""

    def impossible(self, candidate: Candidate, own: np.ndarray) -> str:
        """Why a candidate's coefficients are no physics by themselves, "" if they are."""
        parameters = parameters_of(self.evidence, candidate, own)
        why = candidate.effect.refuse(parameters)
        if why:
            return f"{candidate.effect.title}: {why}"
        if candidate.effect.point in ("channel", "gear") and np.any(own**2 * candidate.precision > FARTHEST**2):
            return f"{candidate.effect.title}: {parameters} is far from the trial at {candidate.shape}"
        return ""

    def _size(self, candidate: Candidate, own: np.ndarray, j: int) -> float:
        """Root of the sum of squares of a candidate's torque on a joint."""
        fixed, free = candidate.columns[j]
        columns, factors = [*fixed, *free], np.concatenate([np.ones(len(fixed)), own])
        return float(np.sqrt(max(factors @ self.totals[j][np.ix_(columns, columns)] @ factors, 0.0)))

    def _left(self, j: int) -> float:
        """The same of what the nominal model leaves there, noise and all."""
        return float(np.sqrt(self.totals[j][0, 0]))

    def freedom(self, candidate: Candidate) -> float:
        """How many coefficients of a candidate the data determine at all."""
        if not candidate.precision.any():
            return float(len(candidate.precision))
        if id(candidate) not in self._freedom:
            normal = self.sums((candidate,))[2].sum(0)
            prior = np.diag(candidate.precision)
            self._freedom[id(candidate)] = float(np.trace(np.linalg.lstsq(normal + prior, normal, rcond=None)[0]))
        return self._freedom[id(candidate)]


def read_all(evidence: Evidence, hypothesis: Sequence[Candidate], theta: np.ndarray):
    """Every candidate of a hypothesis with its parameters, from the coefficients (k,)."""
    for c, own in shared_out(hypothesis, theta):
        yield c, parameters_of(evidence, c, own)


def parameters_of(evidence: Evidence, candidate: Candidate, coefficients: np.ndarray) -> dict:
    """Parameters of one candidate from its coefficients."""
    effect, shape = candidate.effect, candidate.shape
    if effect.name in ("torque_gain_error", "torque_gain_change"):
        return {"gain": float(1 / max(1 + coefficients[0], 1e-3))}
    if effect.name == "encoder_offset":
        return {"offset": float(shape.get("offset", 0.0) + coefficients[0])}
    if isinstance(effect, AbstractGearEffect):
        return effect.of_softness(effect.softness(shape) + float(coefficients[0]))
    if isinstance(effect, AbstractForceEffect):
        return effect.read([float(c) for c in coefficients])
    if isinstance(effect, AbstractChannelEffect):
        return {name: float(value + c) for (name, value), c in zip(shape.items(), coefficients, strict=True)}
    if isinstance(effect, AbstractBodyEffect):
        return effect.read([float(c) for c in coefficients], evidence.robot, candidate.joint)
    assert isinstance(effect, AbstractTorqueEffect)
    known = [float(c) for c in coefficients]
    return effect.read(known[:-1] if effect.name in DRY else known, shape)


def _precision(hypothesis: Sequence[Candidate]) -> np.ndarray:
    return np.concatenate([c.precision for c in hypothesis]) if hypothesis else np.zeros(0)


def _squares(s: np.ndarray, r: np.ndarray, normal: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Sums of squares (B,) that coefficients (k,) leave, of blocks' s (B,), r (B, k) and N (B, k, k)."""
    return s - 2 * r @ theta + np.einsum("a,bac,c->b", theta, normal, theta)


def solved(normal: np.ndarray, r: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """Coefficients (k,) of the normal equations with what is known beforehand."""
    if not len(r):
        return r
    diagonal = np.diag(normal)
    scale = np.sqrt(np.maximum(diagonal, 1e-300))
    scaled = normal / np.outer(scale, scale) + np.diag(precision / scale**2 + LEAST_PRECISION)
    return np.linalg.solve(scaled, r / scale) / scale
