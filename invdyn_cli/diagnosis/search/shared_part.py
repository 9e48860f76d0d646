"""The equations of hypotheses with a common part: that part is solved once (Schur's complement), so that a hypothesis
costs only its own columns."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Candidate
from invdyn_cli.diagnosis.search.equations import inverted, solved
from invdyn_cli.diagnosis.search.grams import Grams

Hypothesis = tuple[Candidate, ...]

HELD = 0.01
"""What a row counts in the fit that is judged by it, beside one for the others: what these do not tell at all, as the
offset of a joint that moves one way in them, is no fault of a hypothesis; of what they tell, it changes a percent."""


@dataclass(frozen=True)
class Equations:
    """Of F parts of the rows, of what is always there (k coefficients) and of a hypothesis' own columns (m): `squares`
    (F,), moments `shared` (F, k) and `own` (F, m), normal matrices `cross` (F, k, m) and `normal` (F, m, m)."""

    squares: np.ndarray
    shared: np.ndarray
    own: np.ndarray
    cross: np.ndarray
    normal: np.ndarray

    def total(self) -> "Equations":
        """Those of all parts as one."""
        return Equations(*(x.sum(0, keepdims=True) for x in vars(self).values()))

    def others(self) -> "Equations":
        """Of every part, those of all the others, and its own by HELD; of a single part its own."""
        return self if len(self.squares) == 1 else Equations(*(_others(x) for x in vars(self).values()))


class Shared:
    """What is always there, `always`, and its own part of all equations.

    Args:
        grams: of the chosen rows.
        weights: (n,) 1 / (noise variance x autocorrelation time) of every row of the arm.
    """

    def __init__(self, always: Hypothesis, grams: Grams, weights: np.ndarray) -> None:
        self.always, self.grams, self.weights = always, grams, weights
        self.precision = precision_of(always)
        self.at = [columns_of(always, j) for j in range(len(weights))]
        folds, k = len(grams.parts[0]), len(self.precision)
        squares, moments = np.zeros((len(weights), folds)), np.zeros((folds, k))
        self.normal = np.zeros((folds, k, k))
        for j, (fixed, free, place) in enumerate(self.at):
            gram, w, signs = grams.parts[j], weights[j], _signs(fixed)
            target = np.array([0, *fixed])
            squares[j] = w * (gram[:, target[:, None], target] @ signs @ signs)
            moments[:, place] += w * (gram[:, free[:, None], target] @ signs)
            self.normal[:, place[:, None], place] += w * gram[:, free[:, None], free]
        total = self.normal.sum(0)
        self.inverse = inverted(total, self.precision)[None]
        self._given = {False: (squares, moments), True: (squares.sum(1, keepdims=True), moments.sum(0, keepdims=True))}
        self._projected: dict[tuple, tuple[int, np.ndarray]] = {}
        self._crossed = np.zeros((0, 0, 0))
        self._known: dict[tuple[Candidate, bool], tuple[np.ndarray, np.ndarray]] = {}

    @cached_property
    def inverses(self) -> np.ndarray:
        """Of every part, the inverse (F, k, k) of the normal matrix of `Equations.others`."""
        if len(self.normal) == 1:
            return self.inverse
        return np.stack([inverted(one, self.precision) for one in _others(self.normal)])

    def equations(self, own: Hypothesis, whole: bool = False) -> Equations:
        """Those of a hypothesis' own columns, of each fold; of all rows as one if `whole`."""
        grams = [gram[None] for gram in self.grams.totals] if whole else self.grams.parts
        of_joints, shared = self._given[whole]
        m = sum(len(c.precision) for c in own)
        beside = [self._beside(c, whole) for c in own]
        shared = shared - sum(x for x, _ in beside)
        cross = np.concatenate([np.zeros((*shared.shape, 0)), *(x for _, x in beside)], axis=2)
        squares = of_joints.sum(0)
        moments, normal = np.zeros((len(squares), m)), np.zeros((len(squares), m, m))
        for j in {j for c in own for j in c.columns}:
            gram, w, given = grams[j], self.weights[j], self.at[j][0]
            fixed, free, place = columns_of(own, j)
            target, signs = np.array([0, *given, *fixed]), _signs((*given, *fixed))
            if len(fixed):
                squares = squares + w * (gram[:, target[:, None], target] @ signs @ signs) - of_joints[j]
            moments[:, place] += w * (gram[:, free[:, None], target] @ signs)
            normal[:, place[:, None], place] += w * gram[:, free[:, None], free]
        return Equations(squares, shared, moments, cross, normal)

    def _beside(self, c: Candidate, whole: bool) -> tuple[np.ndarray, np.ndarray]:
        """Of each fold, or of all rows as one, the products of what is always there with a candidate's fixed columns
        (F, k) and with its free ones (F, k, m)."""
        if (c, whole) not in self._known and whole:
            fixed, cross = self._beside(c, False)
            self._known[c, whole] = fixed.sum(0, keepdims=True), cross.sum(0, keepdims=True)
        if (c, whole) not in self._known:
            folds, k = self._given[False][1].shape
            fixed, cross = np.zeros((folds, k)), np.zeros((folds, k, len(c.precision)))
            for j, (tried, free) in c.columns.items():
                gram, w, (_, mine, at) = self.grams.parts[j], self.weights[j], self.at[j]
                fixed[:, at] += w * gram[:, np.array(tried, int)[:, None], mine].sum(1)
                cross[:, at] += w * np.swapaxes(gram[:, np.array(free, int)[:, None], mine], 1, 2)
            self._known[c, whole] = fixed, cross
        return self._known[c, whole]

    def solve(self, equations: Equations, own: Hypothesis, inverse: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients (F, k) of what is always there and (F, m) of the rest; `inverse` (F, k, k) belongs to the same
        rows."""
        first = (inverse @ equations.shared[:, :, None])[:, :, 0]
        if not own:
            return first, np.zeros((len(first), 0))
        through = inverse @ equations.cross
        turned = np.swapaxes(equations.cross, 1, 2)
        normal = equations.normal - turned @ through
        moment = equations.own - (turned @ first[:, :, None])[:, :, 0]
        theta = np.stack([solved(n, r, precision_of(own)) for n, r in zip(normal, moment, strict=True)])
        return first - (through @ theta[:, :, None])[:, :, 0], theta

    def held_out(self, own: Hypothesis) -> tuple[Equations, np.ndarray, np.ndarray]:
        """The equations of each fold, and the coefficients (F, k) and (F, m) that the other folds give."""
        equations = self.equations(own)
        return equations, *self.solve(equations.others(), own, self.inverses)

    def crossed(self) -> np.ndarray:
        """Products (n, k, C) of what is always there with every column of each row."""
        most = max(len(gram) for gram in self.grams.totals)
        if self._crossed.shape[::2] != (len(self.weights), most):
            self._crossed = np.zeros((len(self.weights), len(self.precision), most))
            for j, (gram, w) in enumerate(zip(self.grams.totals, self.weights, strict=True)):
                _, free, place = self.at[j]
                self._crossed[j, place, : len(gram)] = w * gram[free]
        return self._crossed

    def projected(self, kind: tuple, joints: np.ndarray, columns: np.ndarray, square: np.ndarray) -> np.ndarray:
        """Squares (N, m, m) of candidates that are alike, less what is always there explains of them."""
        count, known = self._projected.get(kind, (0, square[:0]))
        if count < len(square):
            new = slice(count, None)
            cross = self.crossed()[joints[new][:, :, None], :, columns[new]].sum(1)
            less = square[new] - cross @ self.inverse[0] @ np.swapaxes(cross, 1, 2)
            self._projected[kind] = len(square), np.concatenate([known, less])
        return self._projected[kind][1]

    @cached_property
    def rows(self) -> "Rows":
        """What is always there, row by row."""
        return Rows(self)


class Rows:
    """The used rows of every joint, fold after fold, with the columns of what is always there."""

    def __init__(self, shared: Shared) -> None:
        self.shared, grams = shared, shared.grams
        block = np.full(len(grams.used), -1)
        for b, rows in enumerate(grams.blocks):
            block[rows] = b
        fold = np.where(block >= 0, grams.folds[block], -1)
        self.order, self.ends, self.block, self.free, self.target = [], [], [], [], []
        for j, (fixed, free, _) in enumerate(shared.at):
            used = np.flatnonzero(grams.used[:, j])
            order = used[np.argsort(fold[used], kind="stable")]
            table = grams.table(j)
            self.order.append(order)
            self.ends.append(np.searchsorted(fold[order], np.arange(grams.folds.max() + 2)))
            self.block.append(block[order])
            self.free.append(np.ascontiguousarray(table[order[:, None], free]))
            self.target.append(table[order, 0] - table[order[:, None], fixed].sum(1))

    def squares(self, own: Hypothesis, first: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Weighted squares (n, B) of every joint's rows in every block that the coefficients (F, k) and (F, m) of its
        fold leave."""
        shared, grams = self.shared, self.shared.grams
        out = np.zeros((len(shared.weights), len(grams.blocks)))
        for j, (order, ends) in enumerate(zip(self.order, self.ends, strict=True)):
            place = shared.at[j][2]
            fixed, free, mine = columns_of(own, j)
            left = self.target[j]
            if len(fixed) or len(free):
                table = grams.table(j)
                left = left - table[order[:, None], fixed].sum(1)
                added = table[order[:, None], free]
            else:
                left, added = left.copy(), np.zeros((len(order), 0))
            for f in range(len(first)):
                part = slice(ends[f], ends[f + 1])
                left[part] -= self.free[j][part] @ first[f, place] + added[part] @ theta[f, mine]
            out[j] = shared.weights[j] * np.bincount(self.block[j], left**2, minlength=len(grams.blocks))
        return out


def precision_of(hypothesis: Sequence[Candidate]) -> np.ndarray:
    """The prior of the coefficients (k,) of a hypothesis."""
    return np.concatenate([c.precision for c in hypothesis]) if hypothesis else np.zeros(0)


def columns_of(hypothesis: Sequence[Candidate], j: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A hypothesis' fixed and free columns in a joint's table, and the latter's places among the coefficients."""
    fixed: list[int] = []
    free: list[int] = []
    place: list[int] = []
    start = 0
    for c in hypothesis:
        if j in c.columns:
            fixed += c.columns[j][0]
            free += c.columns[j][1]
            place += range(start, start + len(c.precision))
        start += len(c.precision)
    return np.array(fixed, int), np.array(free, int), np.array(place, int)


def _others(parts: np.ndarray) -> np.ndarray:
    """Of sums (F, …) over the rows of each part, those over the rows of the others, and its own by HELD."""
    return parts.sum(0) - (1 - HELD) * parts


def _signs(fixed: Sequence[int] | np.ndarray) -> np.ndarray:
    return np.array([1.0] + [-1.0] * len(fixed))
