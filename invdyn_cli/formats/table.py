"""The result of every reader: named columns of one recording, and what the format itself defines about them."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from invdyn_cli.errors import LogError

ASK = "?"
"""A unit that follows neither from the file nor from its values: the user is asked for it."""


@dataclass(frozen=True)
class Told:
    """What a format defines of a column: its channel ("t", "q", "tau", …), its joint ("" where it names none), its
    unit ("": not defined; ASK: it must be asked for)."""

    channel: str
    joint: str = ""
    unit: str = ""


@dataclass(frozen=True)
class Table:
    """One recording.

    Attributes:
        name: what its trajectory is called.
        columns: (T,) int64 or float64 each, in the order of the file.
        told: what the format defines, by column.
        notes: what the user should know, e.g. rows that were left out.
        by: what `told` rests on, as the user is told, e.g. "the message's definition".
    """

    name: str
    columns: Mapping[str, np.ndarray]
    told: Mapping[str, Told] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    by: str = ""


def from_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> Table:
    """A table from arrays (T,), (T, n) or (n, T); column k of an array x is called x/k. Other shapes are left out.

    Raises:
        LogError: if no array holds a series of numbers.
    """
    series = {name: np.squeeze(x) for name, x in arrays.items() if x.dtype.kind in "iuf" and x.size > 1}
    lengths = Counter(length for x in series.values() if x.ndim <= 2 for length in set(x.shape))
    if not lengths:
        got = f"{path} holds no series of numbers; it has {_shapes(arrays)}"
        raise LogError(f"{got}; allowed: arrays (T,) and (T, n)")
    rows = max(lengths, key=lambda length: (lengths[length], length))
    columns: dict[str, np.ndarray] = {}
    for name, x in series.items():
        if x.ndim == 1 and len(x) == rows:
            columns[name] = as_column(x)
        elif x.ndim == 2 and rows in x.shape:
            columns |= {f"{name}/{k}": as_column(c) for k, c in enumerate(x.T if len(x) == rows else x)}
    return Table(path.stem, columns)


def as_column(values: np.ndarray) -> np.ndarray:
    """Whole numbers as int64 (nanoseconds since 1970 do not fit into a float), others as float64."""
    return values.astype(np.int64) if values.dtype.kind in "iu" else np.asarray(values, float)


def refuse_size(path: Path, size: float, limit: float) -> None:
    """Raise a LogError for more than `limit` [bytes]."""
    if size > limit:
        got = f"{path} holds {size / 1e9:.3g} GB; allowed: {limit / 1e9:.3g} GB"
        raise LogError(got, advice="a larger max_size [GB], or a part of the file")


def missing(path: Path, library: str) -> LogError:
    """The failure where the library for a format is not installed."""
    return LogError(
        f"{path} needs the library {library}, which is not installed", advice='pip install "invdyn[formats]"'
    )


def _shapes(arrays: Mapping[str, np.ndarray]) -> str:
    found: Iterable[str] = (f"{name} {x.dtype} {x.shape}" for name, x in arrays.items())
    return ", ".join(found) or "nothing that can be read"
