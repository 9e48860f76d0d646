"""What each coefficient of a fit changes, joint by joint: most touch one joint, and an array of all coefficients on all
joints would be zeros for the most part."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Candidate, Evidence
from invdyn_cli.diagnosis.search.equations import solved
from invdyn_cli.effects.composition import EffectInstance


@dataclass(frozen=True)
class Slopes:
    """Of each joint the numbers (m,) of the coefficients that change its torque, of `count` (k) in all, and the torque
    (m, R) of one unit of each."""

    count: int
    numbers: tuple[np.ndarray, ...]
    columns: tuple[np.ndarray, ...]

    @classmethod
    def of(cls, evidence: Evidence, count: int, made: Iterable[tuple[int, int, np.ndarray]]) -> "Slopes":
        """From the number, the joint, and the torque (R,) of each."""
        numbers: list[list[int]] = [[] for _ in evidence.tables]
        columns: list[list[np.ndarray]] = [[] for _ in evidence.tables]
        for number, j, column in made:
            numbers[j].append(number)
            columns[j].append(column)
        rows = len(evidence.tau)
        arrays = (np.reshape(x, (len(x), rows)) for x in columns)
        return cls(count, tuple(np.array(x, int) for x in numbers), tuple(arrays))

    @classmethod
    def free(cls, evidence: Evidence, hypothesis: Sequence[Candidate]) -> "Slopes":
        """Of the coefficients of candidates."""
        made, start = [], 0
        for c in hypothesis:
            for j, (_, free) in c.columns.items():
                made += [(start + i, j, evidence.tables[j][:, column]) for i, column in enumerate(free)]
            start += len(c.precision)
        return cls.of(evidence, start, made)

    def with_more(self, other: "Slopes") -> "Slopes":
        """These, and behind them the coefficients of another."""
        late = tuple(self.count + x for x in other.numbers)
        return replace(self, count=self.count + other.count).and_of(replace(other, numbers=late))

    def and_of(self, other: "Slopes") -> "Slopes":
        """These, and what another knows of the same coefficients."""
        numbers, columns = (
            tuple(np.concatenate(x) for x in zip(*pair, strict=True))
            for pair in ((self.numbers, other.numbers), (self.columns, other.columns))
        )
        return replace(self, numbers=numbers, columns=columns)

    def logged(self, evidence: Evidence, acting: Sequence[EffectInstance]) -> "Slopes":
        """The same behind the channels among `acting`."""
        behind = (evidence.logged_on(j, acting, x) for j, x in enumerate(self.columns))
        return Slopes(self.count, self.numbers, tuple(behind))

    def torque(self, theta: np.ndarray) -> np.ndarray:
        """Torque (R, n) of coefficients (k,)."""
        parts = zip(self.numbers, self.columns, strict=True)
        return np.column_stack([theta[own] @ x for own, x in parts])

    def weighed(self, scale: np.ndarray, rows: np.ndarray | slice = slice(None)) -> "Slopes":
        """Some rows, each joint's multiplied by `scale` (R, n)."""
        return replace(self, columns=tuple(x[:, rows] * scale[rows, j] for j, x in enumerate(self.columns)))

    def fitted(self, y: np.ndarray, scale: np.ndarray, precision: np.ndarray) -> np.ndarray:
        """Coefficients (k,) that explain most of a torque (R, n), each row weighed by scale^2, with the prior."""
        own = self.weighed(scale)
        return solved(own.normal(), own.moment(y * scale), precision)

    def normal(self) -> np.ndarray:
        """Normal matrix (k, k)."""
        out = np.zeros((self.count, self.count))
        for own, x in zip(self.numbers, self.columns, strict=True):
            out[np.ix_(own, own)] += x @ x.T
        return out

    def moment(self, y: np.ndarray) -> np.ndarray:
        """Moments (k,) with a target (R, n)."""
        out = np.zeros(self.count)
        for j, (own, x) in enumerate(zip(self.numbers, self.columns, strict=True)):
            out[own] += x @ y[:, j]
        return out
