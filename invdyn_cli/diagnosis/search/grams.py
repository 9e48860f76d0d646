"""Gram matrices of the evidence's tables, from which everything in a search is computed."""

from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Candidate, Evidence

FOLDS = 8
"""Number of parts of the blocks, each of which is held out in turn."""

SPARE = 128
"""Number of columns for which there is space before matrices are copied."""

FEW = 0.7
"""Share of the columns that must be known for the others to be few."""

Kind = tuple[int, int, int]
"""How many joints candidates act on, and how many fixed and free columns they have on each."""


@dataclass
class Alike:
    """Candidates of one kind, and what of them neither a hypothesis nor a noise changes."""

    members: list[Candidate] = field(default_factory=list)
    joints: list[list[int]] = field(default_factory=list)
    columns: list[list[tuple[int, ...]]] = field(default_factory=list)
    squares: list[list[np.ndarray]] = field(default_factory=list)
    precision: list[np.ndarray] = field(default_factory=list)

    @cached_property
    def arrays(self) -> tuple[np.ndarray, ...]:
        """Joints (N, J), columns (N, J, m), squares (N, J, m, m) and precision (N, free)."""
        return tuple(np.array(x) for x in (self.joints, self.columns, self.squares, self.precision))


class Grams:
    """Gram matrices of the chosen rows (R,) bool, by fold; `refresh` takes in what was added to the tables.

    Attributes:
        blocks: slices of rows that follow each other.
        used: (R, n) which rows of a joint count.
        folds: (B,) the fold of each block.
        parts: of every joint (F, C, C), by fold.
        totals: the same of all folds (C, C).
        alike: the candidates that were placed, by kind.
    """

    def __init__(self, evidence: Evidence, rows: np.ndarray) -> None:
        at = np.flatnonzero(rows)
        first = np.unique(evidence.block[rows], return_index=True)[1]
        self.blocks = [slice(at[a], at[b - 1] + 1) for a, b in pairwise([*first, len(at)])]
        self.used = rows[:, None] & evidence.valid
        self.folds = np.arange(len(self.blocks)) % min(FOLDS, len(self.blocks))
        self.parts: list[np.ndarray] = [np.empty((self.folds.max() + 1, 0, 0))] * evidence.dofs
        self.totals: list[np.ndarray] = [np.empty((0, 0))] * evidence.dofs
        self.alike: dict[Kind, Alike] = {}
        self._places: dict[Candidate, tuple[Kind, int]] = {}
        self._evidence, self._room, self._sums = evidence, list(self.parts), list(self.totals)

    @classmethod
    def of(cls, evidence: Evidence, rows: np.ndarray) -> "Grams":
        """The Gram matrices of the same rows in the same blocks, if they were requested last."""
        key = "grams", rows.tobytes(), evidence.block.tobytes()
        if key not in evidence.kept:
            for old in [k for k in evidence.kept if k[0] == "grams"]:
                del evidence.kept[old]
            evidence.kept[key] = [cls(evidence, rows)]
        return evidence.kept[key][0]

    def table(self, j: int) -> np.ndarray:
        """The evidence's table (R, C) of a joint."""
        return self._evidence.tables[j]

    def refresh(self) -> None:
        """Include the columns that were added to the evidence since."""
        for j, table in enumerate(self._evidence.tables):
            known, count = self.parts[j].shape[1], table.shape[1]
            if count == known:
                continue
            room, sums = self._room[j], self._sums[j]
            if count > room.shape[1]:
                room = np.moveaxis(np.zeros((count + SPARE, count + SPARE, len(room))), 2, 0)  # the folds of a pair of
                # columns are neighbours in memory: few columns are taken from many
                room[:, :known, :known], sums = self.parts[j], np.zeros(room.shape[1:])
                sums[:known, :known] = self.totals[j]
                self._room[j], self._sums[j] = room, sums
            for fold, gram in enumerate(room):
                gram[:count, known:count] = self._products(j, fold, table, known)
            room[:, known:count, :known] = np.swapaxes(room[:, :known, known:count], 1, 2)
            sums[:count, known:count] = room[:, :count, known:count].sum(0)
            sums[known:count, :known] = sums[:known, known:count].T
            self.parts[j], self.totals[j] = room[:, :count, :count], sums[:count, :count]

    def _products(self, j: int, fold: int, table: np.ndarray, known: int) -> np.ndarray:
        """(C, C - known) products of all columns of a joint's table (R, C) with those that are new, in a fold. Few are
        multiplied block by block: to take the rows of a large table costs more than the products."""
        blocks = [block for own, block in zip(self.folds, self.blocks, strict=True) if own == fold]
        if known < FEW * table.shape[1]:
            rows = np.concatenate([table[block][self.used[block, j]] for block in blocks])
            return rows.T @ rows[:, known:]
        new = [self.used[block, j, None] * table[block, known:] for block in blocks]
        return np.sum([table[block].T @ x for block, x in zip(blocks, new, strict=True)], axis=0)

    def place(self, c: Candidate) -> tuple[Kind, int]:
        """A candidate's kind and its number there."""
        if c not in self._places:
            columns = [(*fixed, *free) for fixed, free in c.columns.values()]
            kind = len(columns), len(columns[0]) - len(c.precision), len(c.precision)
            alike = self.alike.setdefault(kind, Alike())
            vars(alike).pop("arrays", None)
            alike.joints.append(list(c.columns))
            alike.columns.append(columns)
            alike.squares.append([self.totals[j][np.ix_(x, x)] for j, x in zip(c.columns, columns, strict=True)])
            alike.precision.append(c.precision)
            alike.members.append(c)
            self._places[c] = kind, len(alike.members) - 1
        return self._places[c]

    def square(self, c: Candidate, j: int) -> np.ndarray:
        """Products (m, m) of a candidate's columns on a joint."""
        kind, number = self.place(c)
        alike = self.alike[kind]
        return alike.squares[number][alike.joints[number].index(j)]
