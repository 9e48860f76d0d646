"""What an effect explains in any window of time, with all that lasts fitted anew beside it (Schur's complement).

A model that was fitted without an event is a compromise: friction and links take up a part of it, and leave its
opposite at all other times. The best window in such a residual is not that of the event.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Evidence
from invdyn_cli.diagnosis.search.equations import inverse_root
from invdyn_cli.diagnosis.search.shared_part import Hypothesis, columns_of, precision_of

Spans = Sequence[tuple[int, int]]
"""Windows of a trajectory: the first row of each, and the row behind its last."""

FITTED_ANEW = 10
"""Number of times, at most, that factors and windows of what comes and goes several times are found in turn."""


@dataclass(frozen=True)
class Lasting:
    """What lasts, with p coefficients of columns whose weighted squares, with the prior's, are the unit matrix.

    Attributes:
        used: (R, n) weight of every row of every joint.
        columns: of each joint, those of its table (R, m).
        root: of each joint, (m, p) what makes the p columns of them.
    """

    used: np.ndarray
    columns: tuple[np.ndarray, ...]
    root: tuple[np.ndarray, ...]

    @classmethod
    def beside(cls, evidence: Evidence, hypothesis: Hypothesis, used: np.ndarray) -> "Lasting":
        """That of a hypothesis whose columns are fitted on the rows with these weights (R, n)."""
        precision = precision_of(hypothesis)
        normal, own = np.zeros((len(precision),) * 2), [columns_of(hypothesis, j)[1:] for j in range(evidence.dofs)]
        columns = tuple(table[:, free] for table, (free, _) in zip(evidence.tables, own, strict=True))
        for x, (_, place), w in zip(columns, own, used.T, strict=True):
            normal[np.ix_(place, place)] += (w * x.T) @ x
        root = inverse_root(normal, precision)
        return cls(used, columns, tuple(root[place] for _, place in own))

    def explained(self, torque: np.ndarray) -> np.ndarray:
        """(p,) coefficients of what it explains of a torque (R, n)."""
        parts = zip((self.used * torque).T, self.columns, self.root, strict=True)
        return np.sum([y @ x @ root for y, x, root in parts], axis=0)

    def torque(self, theta: np.ndarray) -> np.ndarray:
        """(R, n) of coefficients (p,)."""
        parts = zip(self.columns, self.root, strict=True)
        return np.stack([x @ (root @ theta) for x, root in parts], axis=1)


class Windowed:
    """An effect's columns on the rows of a trajectory, and all sums that any window needs.

    Args:
        columns: (k, n, R) the effect's.
        precision: (k,) the prior of their factors.
        left: (R, n) what the model leaves.
        refit: (p,) what lasts explains of that.
        rows: (r,) the trajectory's.
    """

    def __init__(
        self,
        lasting: Lasting,
        columns: np.ndarray,
        precision: np.ndarray,
        left: np.ndarray,
        refit: np.ndarray,
        rows: np.ndarray,
    ) -> None:
        self.lasting, self.columns, self.left, self.refit, self.rows = lasting, columns, left, refit, rows
        self.felt: list[int] = np.flatnonzero(np.abs(columns).max(axis=(0, 2)) > 0).tolist()
        whole = self.between(0, len(rows))
        self.prior = np.diag(precision) + 1e-9 * np.diag(np.diag(whole[:, : len(columns)]) + 1e-300)

    def between(self, start: int, end: int) -> np.ndarray:
        """(k, k + 1 + p) sums over the rows from `start` to `end`: the weighted columns times themselves, times what is
        left, and times what lasts."""
        return self._summed(lambda x, others: x @ others, start, end)

    def gains(self, grid: np.ndarray, first: np.ndarray, last: np.ndarray) -> np.ndarray:
        """(W,) squares that the effect explains in windows from a row of `grid` (P,) to another; the rows grow, and
        `first` and `last` (W,) say which of them."""
        cells = [self.between(a, b) for a, b in zip([0, *grid[:-1]], grid, strict=True)]
        sums, k = np.cumsum(cells, axis=0), len(self.prior)
        cross = sums[..., k + 1 :].reshape(len(grid) * k, -1)
        gram = (cross @ cross.T).reshape(len(grid), k, len(grid), k).swapaxes(1, 2)
        own = sums[..., :k] - gram[range(len(grid)), range(len(grid))]
        moment = sums[..., k] - (cross @ self.refit).reshape(-1, k)
        both = gram[last, first] + gram[first, last] - 2 * gram[first, first]
        return _explained(own[last] - own[first] + both + self.prior, moment[last] - moment[first])

    def before(self, first: int, last: int) -> np.ndarray:
        """(last - first + 1, k, k + 1 + p) sums over the rows before each from `first` to `last`."""
        start = self.between(0, first)[None]
        each = self._summed(lambda x, others: x.T[:, :, None] * others[:, None], first, last)
        return np.concatenate([start, start + np.cumsum(each, axis=0)])

    def gain(self, sums: np.ndarray) -> np.ndarray:
        """(W,) squares that the effect explains in windows with these sums (W, k, k + 1 + p)."""
        return _explained(*self._equations(sums))

    def gained(self, spans: Spans) -> float:
        """The squares that the effect explains in all these windows together."""
        return float(self.gain(self._within(spans)[None])[0])

    def fitted(self, spans: Spans) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Factors (k,) of the effect's columns in these windows, its torque (R, n), and what the model leaves with it,
        all that lasts being fitted anew."""
        factors, lasting = self._refitted(spans)
        made = np.zeros_like(self.left)
        for a, b in spans:
            there = self.rows[a:b]
            made[there] = np.tensordot(factors, self.columns[:, :, there], 1).T
        return factors, made, self.left - made - self.lasting.torque(lasting)

    def saved(self, spans: Spans) -> np.ndarray:
        """(r,) weighted squares that the effect saves on every row if it is there, as fitted in these windows."""
        factors, lasting = self._refitted(spans)
        without = (self.left - self.lasting.torque(lasting))[self.rows]
        made = np.tensordot(factors, self.columns[:, :, self.rows], 1).T
        return np.sum(self.lasting.used[self.rows] * (without**2 - (without - made) ** 2), axis=1)

    def equations(self, spans: Spans) -> tuple[np.ndarray, np.ndarray]:
        """Normal matrix (k, k) and moments (k,) of the columns in these windows, what lasts being projected out."""
        normal, moment = self._equations(self._within(spans)[None])
        return normal[0], moment[0]

    def _refitted(self, spans: Spans) -> tuple[np.ndarray, np.ndarray]:
        """Factors (k,) of the columns in these windows, and the coefficients (p,) of what lasts beside them."""
        sums = self._within(spans)
        normal, moment = self._equations(sums[None])
        factors = np.linalg.solve(normal[0], moment[0])
        return factors, self.refit - factors @ sums[:, len(factors) + 1 :]

    def _within(self, spans: Spans) -> np.ndarray:
        """`between`'s sums over the rows of all these windows."""
        return np.sum([self.between(a, b) for a, b in spans], axis=0)

    def _equations(self, sums: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Normal matrices (W, k, k) and moments (W, k), what lasts being projected out."""
        k = len(self.prior)
        cross = sums[..., k + 1 :]
        normal = sums[..., :k] - cross @ np.swapaxes(cross, 1, 2) + self.prior
        return normal, sums[..., k] - cross @ self.refit

    def _summed(self, product: Callable[[np.ndarray, np.ndarray], np.ndarray], start: int, end: int) -> np.ndarray:
        """Sum over the joints that feel it of the product of its weighted columns (k, rows) with all others (rows,
        k + 1 + p)."""
        rows, own, out = self.rows[start:end], len(self.columns) + 1, []
        for j in self.felt:
            x = self.columns[:, j, rows]
            others = np.column_stack([x.T, self.left[rows, j], self.lasting.columns[j][rows]])
            made = product(self.lasting.used[rows, j] * x, others)
            out.append(np.concatenate([made[..., :own], made[..., own:] @ self.lasting.root[j]], axis=-1))
        return np.sum(out, axis=0)


def _explained(normal: np.ndarray, moment: np.ndarray) -> np.ndarray:
    """(W,) squares that factors explain, of normal matrices (W, k, k) and moments (W, k)."""
    return np.einsum("wa,wa->w", moment, np.linalg.solve(normal, moment[..., None])[..., 0])


def times_carried(windowed: Windowed, span: tuple[int, int], time: np.ndarray, least: float, shortest: float) -> Spans:
    """All windows in which an effect that was found in one of them acts, however often it comes and goes.

    With its factors, each row says whether it is there. It comes where from then on it saves `least` before it would
    cost as much, and goes where the reverse holds: then no other windows save more, if each must be worth `least`.
    Its factors are fitted anew in these, until they stay the same; none is shorter than `shortest` [s], nor are gaps.
    """
    spans: Spans = [span]
    for _ in range(FITTED_ANEW):
        before, spans = spans, _lasting_long(best_windows(windowed.saved(spans), least), time, shortest)
        if not spans or spans == before:
            break
    return spans or [span]


def best_windows(saved: np.ndarray, least: float) -> list[tuple[int, int]]:
    """The windows in which the sum of `saved` (r,), less `least` for each, is largest."""
    total = np.append(0.0, np.cumsum(saved))
    spans, low, high, there = [], 0, 0, False
    for row, value in enumerate(total.tolist()):
        if there:
            if value > total[high]:
                high = row
            elif value < total[high] - least:
                spans.append((low, high))
                low, there = row, False
        elif value < total[low]:
            low = row
        elif value > total[low] + least:
            high, there = row, True
    return [*spans, (low, high)] if there else spans


def _lasting_long(spans: Spans, time: np.ndarray, shortest: float) -> Spans:
    """These windows without gaps and then without windows that are too short."""
    joined: list[tuple[int, int]] = []
    for a, b in spans:
        if joined and time[a] - time[joined[-1][1] - 1] < shortest:
            joined[-1] = joined[-1][0], b
        else:
            joined.append((a, b))
    return [(a, b) for a, b in joined if time[b - 1] - time[a] >= shortest]
