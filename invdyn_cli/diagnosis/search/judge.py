"""The scorer of hypotheses: losses of any set of causes from Gram matrices of the chosen rows, in a millisecond."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Candidate, Evidence, shared_out
from invdyn_cli.diagnosis.search.equations import LEAST_PRECISION, inverted
from invdyn_cli.diagnosis.search.grams import Grams, Kind
from invdyn_cli.diagnosis.search.shared_part import Equations, Hypothesis, Shared, columns_of, precision_of
from invdyn_cli.effects.friction import REVERSAL_COLUMNS

PRICE_OF_EFFECT, PRICE_OF_COEFFICIENT = 12.0, 4.0
"""In units of the noise variance: an effect must gain more. About 2 log(tries) and log(samples), as BIC has it
(Schwarz 1978; Foster and George 1994 for the number of tries)."""

RELEVANT = 0.002
"""Least torque of an effect as a share of the joint's RMS torque: errors of clocks, interpolation and filters leave
nearly as much on an accurate log of a correct model."""

FARTHEST = 1.5
"""Largest change of a channel's parameter, in prior standard deviations, up to which its torque is linear enough."""

CANCELLED = 3.0
"""Largest torque of an effect on a joint, as a multiple of the RMS of the nominal model's residual there (beside a
reference: of what its model leaves): a larger one can only be cancelled by other effects, and then neither is known."""

EPSILON = float(np.finfo(float).eps)


@dataclass(frozen=True)
class Verdict:
    """The score of a hypothesis: its `loss` with prices, the held-out loss (n, B) of every joint in each block, its
    coefficients."""

    loss: float
    rows: np.ndarray
    theta: np.ndarray

    @cached_property
    def blocks(self) -> np.ndarray:
        """Held-out loss (B,) of each block."""
        return self.rows.sum(0)


class HypothesisScorer:
    """Gram matrices of the chosen rows, and what they say of hypotheses.

    Args:
        rows: (R,) bool, which rows count; a block's are one behind the other.
        weights: (n,) 1 / (noise variance x autocorrelation time) of every row of the arm.
        deviation: (n,) standard deviation of the noise [N m; N].
        always: candidates that are part of every hypothesis.
        worn: whether links that are some percent off are among them, and friction. Links take over most of what a body
            does, at a price of their own (`strain`), and Coulomb friction most of what a friction does that falls from
            it, which adds little beyond slow motion; then the torque of such an effect itself must be worth something,
            not what it adds.

    Attributes:
        grams: of the chosen rows, by fold; blocks are held out in turn by folds.
        count: of blocks.
        floor: the loss that noise alone would leave.
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
        self.refresh()
        self.count = len(self.grams.blocks)
        worth = weights * np.sum((RELEVANT * evidence.tau) ** 2 * self.grams.used, axis=0)
        self.least = {j: x for j, x in enumerate(worth)} | {None: float(np.mean(worth))}
        self.rows_worth = weights * self.grams.used.sum(0)
        self.floor = float(self.rows_worth @ deviation**2)
        self.deviation = deviation
        self.always, self.worn = always, worn
        self._always = frozenset(always)
        self._there = {(c.joint, c.effect.name) for c in always}
        self._shared: dict[Hypothesis, Shared] = {}
        self._freedom: dict[Candidate, float] = {}
        self._prices: dict[Candidate, float] = {}
        self._weighed: dict[Kind, tuple[np.ndarray, np.ndarray]] = {}
        self.tried = 0

    def refresh(self) -> None:
        """Include the columns that were added to the evidence since."""
        self.grams.refresh()

    def equations(self, hypothesis: Sequence[Candidate]) -> tuple[np.ndarray, np.ndarray]:
        """Moments (k,) and normal matrix (k, k) of a hypothesis on all rows."""
        made = Shared((), self.grams, self.weights).equations(tuple(hypothesis), whole=True)
        return made.own[0], made.normal[0]

    def _parted(self, hypothesis: Sequence[Candidate]) -> tuple[Shared, Hypothesis, np.ndarray]:
        """The part of a hypothesis that is always present; the rest; and the positions of the coefficients of both
        among those of the hypothesis."""
        always = tuple(c for c in hypothesis if c in self._always)
        own = tuple(c for c in hypothesis if c not in self._always)
        if always not in self._shared:
            self._shared[always] = Shared(always, self.grams, self.weights)
        ends = np.cumsum([0, *(len(c.precision) for c in hypothesis)])
        at = {c: np.arange(a, b) for c, a, b in zip(hypothesis, ends[:-1], ends[1:], strict=True)}
        return self._shared[always], own, np.concatenate([np.zeros(0, int), *(at[c] for c in (*always, *own))])

    def quick(self, hypothesis: Sequence[Candidate]) -> tuple[float, np.ndarray]:
        """Loss with prices on the data that fits the hypothesis, and its coefficients."""
        shared, own, at = self._parted(hypothesis)
        found = shared.equations(own, whole=True)
        first, rest = shared.solve(found, own, shared.inverse)
        theta = np.empty(len(at))
        theta[at] = np.concatenate([first[0], rest[0]])
        loss = float(found.squares[0] - first[0] @ found.shared[0] - rest[0] @ found.own[0])
        return loss + self.price(hypothesis), theta

    def extended(
        self, base: Sequence[Candidate], candidates: Sequence[Candidate]
    ) -> tuple[np.ndarray, list[np.ndarray]]:
        """`quick`'s losses (len(candidates),) of a hypothesis with one of these beside it, all at once; and their own
        coefficients.

        What is in the hypothesis is projected out of every column (Schur's complement of its normal matrix), so that
        each candidate is a small problem of its own.
        """
        shared, rest, _ = self._parted(base)
        found = shared.equations(rest, whole=True)
        first, theta = (x[0] for x in shared.solve(found, rest, shared.inverse))
        through = shared.inverse[0] @ found.cross[0]
        inverse = inverted(found.normal[0] - found.cross[0].T @ through, precision_of(rest))
        crossed, towards = self._crossed(shared, rest, through, first, theta)
        losses, own_factors = np.empty(len(candidates)), [np.zeros(0)] * len(candidates)
        before = float(found.squares[0] - first @ found.shared[0] - theta @ found.own[0]) + self.price(base)
        for kind, (members, numbers) in self._grouped(candidates).items():
            (joints, columns, _, precision), (own, price) = self.grams.alike[kind].arrays, self._priced(kind)
            square = shared.projected(kind, joints, columns, own)[numbers]
            joints, columns, own, precision, price = (x[numbers] for x in (joints, columns, own, precision, price))
            _, fixed, free = kind
            at = joints[:, :, None]
            cross, moment = crossed[at, :, columns].sum(1), towards[at, columns].sum(1)
            own = np.einsum("caa->ca", own)[:, fixed:]
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

    def _grouped(self, candidates: Sequence[Candidate]) -> dict[Kind, tuple[list[int], list[int]]]:
        """Groups of similar candidates, and their numbers in each group."""
        groups: dict[Kind, tuple[list[int], list[int]]] = {}
        for i, c in enumerate(candidates):
            kind, number = self.grams.place(c)
            members, numbers = groups.setdefault(kind, ([], []))
            members.append(i)
            numbers.append(number)
        return groups

    def _priced(self, kind: Kind) -> tuple[np.ndarray, np.ndarray]:
        """Of candidates that are alike, their weighted squares (N, m, m) and prices (N,)."""
        alike = self.grams.alike[kind]
        if kind not in self._weighed or len(self._weighed[kind][1]) < len(alike.members):
            joints, _, squares, precision = alike.arrays
            square = np.einsum("nj,njab->nab", self.weights[joints], squares)
            own, size = square[:, kind[1] :, kind[1] :], kind[2]
            prior = precision[:, :, None] * np.eye(size)
            known = np.trace(np.linalg.pinv(own + prior, rcond=size * EPSILON) @ own, axis1=1, axis2=2)
            freedom = np.where(precision.any(1), known, size).tolist()
            self._freedom |= dict(zip(alike.members, freedom, strict=True))
            self._weighed[kind] = square, np.array([self.price((c,)) for c in alike.members])
        return self._weighed[kind]

    def _crossed(
        self, shared: Shared, own: Hypothesis, through: np.ndarray, first: np.ndarray, theta: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Products of a hypothesis' own columns with every column of each row (n, m, C), less what is always there
        explains of these, and of what the hypothesis leaves (n, C)."""
        always = shared.crossed()
        crossed, towards = -through.T @ always, -first @ always
        for j, (gram, w) in enumerate(zip(self.grams.totals, self.weights, strict=True)):
            fixed, free, place = columns_of(own, j)
            products = w * gram[free]
            crossed[j, place, : len(gram)] += products
            target = gram[0] - gram[shared.at[j][0]].sum(0) - gram[fixed].sum(0)
            towards[j, : len(gram)] += w * target - theta[place] @ products
        return crossed, towards

    def loss(self, hypothesis: Sequence[Candidate]) -> float:
        """`verdict`'s, from the folds' Gram matrices."""
        shared, own, at = self._parted(hypothesis)
        found, first, theta = shared.held_out(own)
        left = found.squares - 2 * (np.sum(found.shared * first, 1) + np.sum(found.own * theta, 1))
        for a, matrix, b in (
            (first, shared.normal, first),
            (2 * first, found.cross, theta),
            (theta, found.normal, theta),
        ):
            left += (a[:, None, :] @ matrix @ b[:, :, None])[:, 0, 0]
        whole = self._whole(shared, own, found, at)
        return float(left.sum() + np.sum(precision_of(hypothesis) * whole**2)) + self.price(hypothesis)

    def verdict(self, hypothesis: Sequence[Candidate]) -> Verdict:
        """The held-out judgement, block by block."""
        shared, own, at = self._parted(hypothesis)
        found, first, theta = shared.held_out(own)
        rows = shared.rows.squares(own, first, theta)
        whole = self._whole(shared, own, found, at)
        loss = float(rows.sum() + np.sum(precision_of(hypothesis) * whole**2)) + self.price(hypothesis)
        return Verdict(loss, rows, whole)

    def _whole(self, shared: Shared, own: Hypothesis, parts: Equations, at: np.ndarray) -> np.ndarray:
        """Coefficients (k,) on all rows, in the hypothesis' order."""
        theta = np.empty(len(at))
        theta[at] = np.concatenate(shared.solve(parts.total(), own, shared.inverse), axis=1)[0]
        return theta

    def price(self, hypothesis: Sequence[Candidate]) -> float:
        """The least gain of a hypothesis that counts: the prices of its effects."""
        for c in hypothesis:
            if c not in self._prices:
                least = 0.0 if self._mostly_there(c) else self._least(c)
                if c.noise_reduction:
                    least += float(c.noise_reduction * self.rows_worth[c.joint] * self.deviation[c.joint] ** 2)
                self._prices[c] = PRICE_OF_EFFECT + PRICE_OF_COEFFICIENT * self.freedom(c) + least
        return sum(self._prices[c] for c in hypothesis)

    def refused(self, hypothesis: Sequence[Candidate], theta: np.ndarray) -> str:
        """Why the coefficients of a hypothesis are physically impossible, "" if they are possible; effects that are
        always in it may have any values."""
        others = [c for c in hypothesis if c not in self._always]
        for candidate, own in shared_out(hypothesis, theta):
            if candidate in self._always:
                continue
            if why := self.impossible(candidate, own) or falls_beside_its_like(candidate, own, others):
                return why
            if candidate.effect.stays_near:
                continue
            if self._mostly_there(candidate) and self._worth(candidate, own) < self._least(candidate):
                return f"{candidate.effect.title}: smaller than the errors of clocks and filters"
            if self._is_cancelled(candidate, own, hypothesis, theta):
                return f"{candidate.effect.title}: so large that other effects would have to cancel most of it"
        return ""

    def _mostly_there(self, candidate: Candidate) -> bool:
        """Whether most of its torque is that of what is always there."""
        effect = candidate.effect
        parts = {(candidate.joint, name) for name in effect.contains}
        at_reversals = effect.jumps and not effect.contains_as_limit and not parts.isdisjoint(self._there)
        return self.worn and (not effect.is_local or at_reversals)

    def _least(self, candidate: Candidate) -> float:
        """What its torque must be worth, in noise variances."""
        return self.least[candidate.joint if candidate.effect.is_local else None]

    def impossible(self, candidate: Candidate, own: np.ndarray) -> str:
        """Why a candidate's coefficients alone are physically impossible, "" if they are possible."""
        parameters = parameters_of(self.evidence, candidate, own)
        why = candidate.effect.refuse(parameters)
        if why:
            return f"{candidate.effect.title}: {why}"
        if candidate.effect.stays_near and np.any(own**2 * candidate.precision > FARTHEST**2):
            return f"{candidate.effect.title}: it fits only with parameters far from all values that were tried"
        return ""

    def _worth(self, candidate: Candidate, own: np.ndarray) -> float:
        """Squares of a candidate's torque on all joints, in noise variances."""
        return sum(float(self.weights[j]) * self._size(candidate, own, j) ** 2 for j in candidate.columns)

    def _size(self, candidate: Candidate, own: np.ndarray, j: int) -> float:
        """Root of the sum of squares of a candidate's torque on a joint."""
        factors = np.concatenate([np.ones(len(candidate.columns[j][0])), own])
        return float(np.sqrt(max(factors @ self.grams.square(candidate, j) @ factors, 0.0)))

    def _is_cancelled(
        self, candidate: Candidate, own: np.ndarray, hypothesis: Sequence[Candidate], theta: np.ndarray
    ) -> bool:
        """Whether its torque on a joint is so large that other effects cancel most of it. What is always there may do
        so beside a reference, which determines it: what has gone since is in both."""
        large = [j for j in candidate.columns if self._size(candidate, own, j) > CANCELLED * self._left(j, (), theta)]
        if large and self.evidence.reference_rows is not None:
            shares = [(c, x) for c, x in shared_out(hypothesis, theta) if c in self._always]
            there, known = [c for c, _ in shares], np.concatenate([np.zeros(0), *(x for _, x in shares)])
            large = [j for j in large if self._size(candidate, own, j) > CANCELLED * self._left(j, there, known)]
        return bool(large)

    def _left(self, j: int, there: Sequence[Candidate], theta: np.ndarray) -> float:
        """The same for what these candidates leave of the nominal model's residual on that joint, noise included."""
        fixed, free, place = columns_of(there, j)
        factors = np.concatenate([[1.0], -np.ones(len(fixed)), -theta[place]])
        at = [0, *fixed, *free]
        return float(np.sqrt(max(factors @ self.grams.totals[j][np.ix_(at, at)] @ factors, 0.0)))

    def freedom(self, candidate: Candidate) -> float:
        """Effective number of coefficients of a candidate, as far as the data determine them."""
        if not candidate.precision.any():
            return float(len(candidate.precision))
        if candidate not in self._freedom:
            normal = np.sum(
                [self.weights[j] * self.grams.totals[j][np.ix_(x, x)] for j, (_, x) in candidate.columns.items()],
                axis=0,
            )
            prior = np.diag(candidate.precision)
            self._freedom[candidate] = float(np.trace(np.linalg.lstsq(normal + prior, normal, rcond=None)[0]))
        return self._freedom[candidate]


def falls_beside_its_like(candidate: Candidate, own: np.ndarray, others: Sequence[Candidate]) -> str:
    """Why it cannot be that a joint has less of an effect than in a reference, and what looks like the effect beside
    it: the one then corrects the formula of the other."""
    if not candidate.effect.lessens or own[0] >= 0:
        return ""
    alike = {name for names in candidate.effect.confounders for name in names}
    other = next((c for c in others if c.joint == candidate.joint and c.effect.name in alike), None)
    fell = f"{candidate.effect.title} would have decreased since the reference"
    return "" if other is None else f"{fell}, while the similar {other.effect.title} would have appeared"


def read_all(evidence: Evidence, hypothesis: Sequence[Candidate], theta: np.ndarray):
    """Every candidate of a hypothesis with its parameters, from the coefficients (k,)."""
    for c, own in shared_out(hypothesis, theta):
        yield c, parameters_of(evidence, c, own)


def parameters_of(evidence: Evidence, candidate: Candidate, coefficients: np.ndarray) -> dict:
    """Parameters of one candidate from its coefficients, which are corrections where a body was tried at a size."""
    effect, robot, joint = candidate.effect, evidence.robot, candidate.joint
    own = [float(x) for x in coefficients]
    own = own[:-REVERSAL_COLUMNS] if effect.jumps else own
    tried = effect.coordinates(candidate.shape, robot, joint) if candidate.shape else None
    return effect.found(own if tried is None else np.add(own, tried).tolist(), candidate.shape, robot, joint)


def strain(always: Hypothesis, theta: np.ndarray) -> float:
    """Squares, in their prior's variances, of the coefficients of what is always there, the first of `theta`: what they
    take over from an effect that is missing they take at this price."""
    return float(sum(c.precision @ own**2 for c, own in shared_out(always, theta)))
