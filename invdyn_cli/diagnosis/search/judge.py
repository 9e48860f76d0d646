"""The judge: what Gram matrices of the chosen rows, by block, say of any set of causes, in a millisecond."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Candidate, Evidence, shared_out
from invdyn_cli.diagnosis.search.equations import LEAST_PRECISION, held_out, solved, squares_left, summed
from invdyn_cli.diagnosis.search.grams import Grams
from invdyn_cli.interfaces import (
    AbstractBodyEffect,
    AbstractChannelEffect,
    AbstractForceEffect,
    AbstractGearEffect,
    AbstractMotionEffect,
    AbstractTorqueEffect,
)

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

LOCAL = ("torque", "channel", "gear")
"""Points of effects that are worth what they are to their own joint; others to the whole arm."""

Hypothesis = tuple[Candidate, ...]


@dataclass(frozen=True)
class Verdict:
    """How a hypothesis does: its `loss` with prices, the held-out loss of each block (B,), its coefficients."""

    loss: float
    blocks: np.ndarray
    theta: np.ndarray


@dataclass
class _Alike:
    """Candidates with as many fixed and free columns on as many joints, and what of them no hypothesis changes."""

    joints: list[list[int]] = field(default_factory=list)
    columns: list[list[tuple[int, ...]]] = field(default_factory=list)
    square: list[np.ndarray] = field(default_factory=list)
    precision: list[np.ndarray] = field(default_factory=list)
    price: list[float] = field(default_factory=list)

    @cached_property
    def arrays(self) -> tuple[np.ndarray, ...]:
        """The same as arrays: (N, J), (N, J, m), (N, m, m), (N, free), (N,)."""
        return tuple(np.array(getattr(self, f.name)) for f in fields(self))


class HypothesisScorer:
    """Gram matrices of the chosen rows, and what they say of hypotheses.

    Args:
        rows: (R,) bool, which rows count; a block's are one behind the other.
        weights: (n,) 1 / (noise variance x autocorrelation time) of every row of the arm.
        deviation: (n,) standard deviation of the noise [N m; N].
        always: candidates that are part of every hypothesis.
        worn: whether links that are some percent off are among them. They take over most of what a body does, at a
            price of their own (`strain`); then a body's torque itself must be worth something, not what it adds.

    Attributes:
        grams: of the chosen rows, by fold; blocks are held out in turn by folds.
        count: of blocks.
    """

    def __init__(
        self,
        evidence: Evidence,
        rows: np.ndarray,
        weights: np.ndarray,
        deviation: np.ndarray,
        always: Hypothesis = (),
        worn: bool = False,
    ) -> None:
        self.evidence, self.rows, self.weights = evidence, rows, weights
        self.grams = Grams.of(evidence, rows)
        self.count = len(self.grams.blocks)
        worth = weights * np.sum((RELEVANT * evidence.tau) ** 2 * self.grams.used, axis=0)
        self.least = {j: x for j, x in enumerate(worth)} | {None: float(np.mean(worth))}
        self.rows_worth = weights * self.grams.used.sum(0)
        self.deviation = deviation
        self.always, self.worn = always, worn
        self._freedom: dict[int, float] = {}
        self._prices: dict[int, tuple[float, Candidate]] = {}
        self._alike: dict[tuple[int, int, int], _Alike] = {}
        self._places: dict[int, tuple[tuple[int, int, int], int, Candidate]] = {}
        self.tried = 0

    def refresh(self) -> None:
        """Take in the columns that were added to the evidence since."""
        self.grams.refresh()

    def sums(self, hypothesis: Sequence[Candidate]) -> tuple[np.ndarray, ...]:
        """Squares s (B,), moments r (B, k) and normal matrices N (B, k, k) of a hypothesis' blocks."""
        return summed([self._of_row(hypothesis, j) for j in range(self.evidence.dofs)])

    def _of_row(self, hypothesis: Sequence[Candidate], j: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """`sums` of one row of the arm."""
        fixed, free, place, k = _columns(hypothesis, j)
        table, used = self.evidence.tables[j], self.grams.used[:, j]
        y = np.where(used, table[:, 0] - table[:, fixed].sum(1), 0.0)
        x = np.where(used[:, None], table[:, free], 0.0)
        s, r, normal = np.zeros(self.count), np.zeros((self.count, k)), np.zeros((self.count, k, k))
        for b, rows in enumerate(self.grams.blocks):
            s[b] = y[rows] @ y[rows]
            r[b, place] = y[rows] @ x[rows]
            normal[b, place[:, None], place] = x[rows].T @ x[rows]
        return self.weights[j] * s, self.weights[j] * r, self.weights[j] * normal

    def _assembled(self, hypothesis: Sequence[Candidate], grams: Sequence[np.ndarray]):
        """`sums` from Gram matrices (..., columns, columns)."""
        shape, k = grams[0].shape[:-2], sum(len(c.precision) for c in hypothesis)
        s, r, normal = np.zeros(shape), np.zeros((*shape, k)), np.zeros((*shape, k, k))
        for j, (gram, w) in enumerate(zip(grams, self.weights, strict=True)):
            if not w:
                continue
            fixed, free, at, _ = _columns(hypothesis, j)
            signs = np.array([1.0] + [-1.0] * len(fixed))
            columns, m = np.array([0, *fixed, *free]), len(signs)
            own = gram[..., columns[:, None], columns]
            s += w * (own[..., :m, :m] @ signs @ signs)
            r[..., at] += w * (own[..., m:, :m] @ signs)
            normal[..., at[:, None], at] += w * own[..., m:, m:]
        return s, r, normal

    def quick(self, hypothesis: Sequence[Candidate]) -> tuple[float, np.ndarray]:
        """Loss with prices on the data that fits the hypothesis, and its coefficients."""
        s, r, normal = self._assembled(hypothesis, self.grams.totals)
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
        s, r, normal = self._assembled(base, self.grams.totals)
        prior = _precision(base)
        inverse = np.linalg.inv(normal + np.diag(prior + LEAST_PRECISION * np.diag(normal) + 1e-300))
        theta = inverse @ r
        crossed, towards = self._crossed(base, theta)
        losses, own_factors = np.empty(len(candidates)), [np.zeros(0)] * len(candidates)
        before = float(s - theta @ r) + self.price(base)
        for kind, (members, numbers) in self._grouped(candidates).items():
            joints, columns, square, precision, price = (x[numbers] for x in self._alike[kind].arrays)
            _, fixed, free = kind
            cross, moment = crossed[joints[:, :, None], columns].sum(1), towards[joints[:, :, None], columns].sum(1)
            own = np.einsum("caa->ca", square)[:, fixed:]
            square = square - cross @ inverse @ np.swapaxes(cross, 1, 2)
            gain = 2 * moment[:, :fixed].sum(1) - square[:, :fixed, :fixed].sum((1, 2))
            if free:
                known = precision + LEAST_PRECISION * own + 1e-300
                normals = square[:, fixed:, fixed:] + known[:, :, None] * np.eye(free)
                towards_free = moment[:, fixed:] - square[:, fixed:, :fixed].sum(2)
                factors = np.linalg.solve(normals, towards_free[..., None])[..., 0]
                gain = gain + np.sum(factors * towards_free, axis=1)
                for i, factor in zip(members, factors, strict=True):
                    own_factors[i] = factor
            losses[members] = before - gain + price
        return losses, own_factors

    def _grouped(self, candidates: Sequence[Candidate]) -> dict[tuple, tuple[list[int], list[int]]]:
        """Which of these are alike, and their numbers among all that are."""
        groups: dict[tuple, tuple[list[int], list[int]]] = {}
        for i, c in enumerate(candidates):
            kind, number, _ = self._places.get(id(c)) or self._placed(c)
            members, numbers = groups.setdefault(kind, ([], []))
            members.append(i)
            numbers.append(number)
        return groups

    def _placed(self, c: Candidate) -> tuple[tuple[int, int, int], int, Candidate]:
        """Put a candidate among those alike; its place."""
        columns = [(*fixed, *free) for fixed, free in c.columns.values()]
        kind = len(columns), len(columns[0]) - len(c.precision), len(c.precision)
        alike = self._alike.setdefault(kind, _Alike())
        vars(alike).pop("arrays", None)
        alike.joints.append(list(c.columns))
        alike.columns.append(columns)
        squares = [
            self.weights[j] * self.grams.totals[j][np.ix_(x, x)] for j, x in zip(c.columns, columns, strict=True)
        ]
        alike.square.append(np.sum(squares, axis=0))
        alike.precision.append(c.precision)
        alike.price.append(self.price((c,)))
        self._places[id(c)] = kind, len(alike.price) - 1, c
        return self._places[id(c)]

    def _crossed(self, base: Sequence[Candidate], theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Products of every column of each row with a hypothesis' own (n, C, k), and with what it leaves (n, C)."""
        most = max(len(gram) for gram in self.grams.totals)
        crossed, towards = (
            np.zeros((len(self.grams.totals), most, len(theta))),
            np.zeros((len(self.grams.totals), most)),
        )
        for j, (gram, w) in enumerate(zip(self.grams.totals, self.weights, strict=True)):
            fixed, free, place, _ = _columns(base, j)
            products = w * gram[free]
            crossed[j, : len(gram), place] = products
            towards[j, : len(gram)] = w * (gram[0] - gram[fixed].sum(0)) - theta[place] @ products
        return crossed, towards

    def loss(self, hypothesis: Sequence[Candidate]) -> float:
        """`verdict`'s, from the folds' Gram matrices."""
        return self._judged(hypothesis, self._assembled(hypothesis, self.grams.parts), np.unique(self.grams.folds)).loss

    def verdict(self, hypothesis: Sequence[Candidate]) -> Verdict:
        """The held-out judgement."""
        return self._judged(hypothesis, self.sums(hypothesis), self.grams.folds)

    def _judged(self, hypothesis: Sequence[Candidate], sums: tuple[np.ndarray, ...], folds: np.ndarray) -> Verdict:
        """The held-out judgement by the sums of parts of the rows, which are held out by their `folds`."""
        (s, r, normal), precision = sums, _precision(hypothesis)
        theta = solved(normal.sum(0), r.sum(0), precision)
        parts = np.empty(len(s))
        for out, held in held_out(folds, r, normal, precision):
            parts[out] = squares_left(s[out], r[out], normal[out], held)
        loss = float(parts.sum() + np.sum(precision * theta**2)) + self.price(hypothesis)
        return Verdict(loss, parts, theta)

    def by_row(self, hypothesis: Sequence[Candidate]) -> np.ndarray:
        """Held-out losses (n, B) of every joint's own rows, without prices."""
        rows = [self._of_row(hypothesis, j) for j in range(self.evidence.dofs)]
        _, r, normal = summed(rows)
        out = np.zeros((self.evidence.dofs, self.count))
        for at, held in held_out(self.grams.folds, r, normal, _precision(hypothesis)):
            for j, (s, own, squares) in enumerate(rows):
                out[j, at] = squares_left(s[at], own[at], squares[at], held)
        return out

    def price(self, hypothesis: Sequence[Candidate]) -> float:
        """What a hypothesis must gain at least."""
        for c in hypothesis:
            if id(c) not in self._prices:
                local = c.joint if c.effect.point in LOCAL else None
                least = 0.0 if self.worn and c.effect.point not in LOCAL else self.least[local]
                quiet = (
                    c.noise_reduction * self.rows_worth[c.joint] * self.deviation[c.joint] ** 2
                    if c.noise_reduction
                    else 0.0
                )
                value = PRICE_OF_EFFECT + PRICE_OF_COEFFICIENT * self.freedom(c) + least + float(quiet)
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
            if self.worn and candidate.effect.point not in LOCAL and self._worth(candidate, own) < self.least[None]:
                return f"{candidate.effect.title}: smaller than the errors of clocks and filters"
            if any(self._size(candidate, own, j) > CANCELLED * self._left(j) for j in candidate.columns):
                return f"{candidate.effect.title}: so large that other effects would have to cancel most of it"
        return ""

    def impossible(self, candidate: Candidate, own: np.ndarray) -> str:
        """Why a candidate's coefficients are no physics by themselves, "" if they are."""
        parameters = parameters_of(self.evidence, candidate, own)
        why = candidate.effect.refuse(parameters)
        if why:
            return f"{candidate.effect.title}: {why}"
        if candidate.effect.point in ("channel", "gear") and np.any(own**2 * candidate.precision > FARTHEST**2):
            return f"{candidate.effect.title}: {parameters} is far from the trial value {candidate.shape}"
        return ""

    def _worth(self, candidate: Candidate, own: np.ndarray) -> float:
        """Squares of a candidate's torque on all joints, in noise variances."""
        return sum(float(self.weights[j]) * self._size(candidate, own, j) ** 2 for j in candidate.columns)

    def _size(self, candidate: Candidate, own: np.ndarray, j: int) -> float:
        """Root of the sum of squares of a candidate's torque on a joint."""
        fixed, free = candidate.columns[j]
        columns, factors = [*fixed, *free], np.concatenate([np.ones(len(fixed)), own])
        return float(np.sqrt(max(factors @ self.grams.totals[j][np.ix_(columns, columns)] @ factors, 0.0)))

    def _left(self, j: int) -> float:
        """The same of what the nominal model leaves there, noise and all."""
        return float(np.sqrt(self.grams.totals[j][0, 0]))

    def freedom(self, candidate: Candidate) -> float:
        """How many coefficients of a candidate the data determine at all."""
        if not candidate.precision.any():
            return float(len(candidate.precision))
        if id(candidate) not in self._freedom:
            normal = self._assembled((candidate,), self.grams.totals)[2]
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
    if isinstance(effect, AbstractGearEffect):
        return effect.from_compliance(effect.compliance(shape) + float(coefficients[0]))
    if isinstance(effect, AbstractForceEffect):
        return effect.read([float(c) for c in coefficients])
    if isinstance(effect, AbstractChannelEffect) and effect.factor:  # its column is the model's torque
        return {effect.factor: float(1 / max(1 + coefficients[0], 1e-3))}
    if isinstance(effect, AbstractChannelEffect | AbstractMotionEffect):
        return {name: float(shape.get(name, 0.0) + c) for name, c in zip(effect.parameters, coefficients, strict=True)}
    if isinstance(effect, AbstractBodyEffect):
        return effect.read([float(c) for c in coefficients], evidence.robot, candidate.joint)
    assert isinstance(effect, AbstractTorqueEffect)
    known = [float(c) for c in coefficients]
    return effect.read(known[:-1] if effect.jumps else known, shape)


def strain(always: Hypothesis, theta: np.ndarray) -> float:
    """Squares, in their prior's variances, of the coefficients of what is always there, the first of `theta`: what they
    take over from an effect that is missing they take at this price."""
    return float(sum(c.precision @ own**2 for c, own in shared_out(always, theta)))


def _precision(hypothesis: Sequence[Candidate]) -> np.ndarray:
    return np.concatenate([c.precision for c in hypothesis]) if hypothesis else np.zeros(0)


def _columns(hypothesis: Sequence[Candidate], j: int) -> tuple[list[int], list[int], np.ndarray, int]:
    """A hypothesis' fixed and free columns in a joint's table, the latter's places among the coefficients, and how many
    there are of these."""
    fixed, free, place, start = [], [], [], 0
    for c in hypothesis:
        if j in c.columns:
            fixed += c.columns[j][0]
            free += c.columns[j][1]
            place += range(start, start + len(c.precision))
        start += len(c.precision)
    return fixed, free, np.array(place, int), start
