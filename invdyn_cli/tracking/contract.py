"""The contract of a tracker: it gives a finished run to a tool that stores experiments."""

import abc
import importlib.util
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from invdyn_cli.errors import UsageError


@dataclass(frozen=True)
class Tracked:
    """A finished run as plain values.

    Attributes:
        name: of the run: date, time and job.
        folder: in which its files are.
        params: the resolved config, dotted option -> value.
        metrics: the numbers of metrics.json, dotted name -> value; numbers that are not finite are left out.
        losses: curves over the epochs of training, (epochs,) each, by name; {} for a model without epochs.
        files: figures and report.
    """

    name: str
    folder: Path
    params: Mapping[str, str]
    metrics: Mapping[str, float]
    losses: Mapping[str, np.ndarray]
    files: Sequence[Path]


class AbstractTracker(abc.ABC):
    """Stores finished runs in a tool; a frozen dataclass whose fields are the options of its YAML."""

    library: ClassVar[str] = ""
    """The module that it needs; "" for none."""
    extra: ClassVar[str] = ""
    """The extra of invdyn that installs it."""

    def refuse_missing(self) -> None:
        """Raise a UsageError if its library is not installed, before anything is learned."""
        if self.library and importlib.util.find_spec(self.library) is None:
            got = f"tracker={self.extra} needs the library {self.library}, which is not installed"
            raise UsageError(got, advice=f"pip install 'invdyn[{self.extra}]', or tracker=none")

    @abc.abstractmethod
    def track(self, run: Tracked) -> None:
        """Give the run to the tool. The run is already complete: an exception here becomes a warning."""


def flat(tree: Any, place: str = "") -> Iterator[tuple[str, Any]]:
    """(dotted name, value) of every leaf of a tree of mappings; a list is a leaf."""
    if isinstance(tree, Mapping) and tree:
        for key, value in tree.items():
            yield from flat(value, f"{place}.{key}" if place else str(key))
    else:
        yield place, tree


def numbers(tree: Any) -> dict[str, float]:
    """The finite numbers among the leaves of a tree."""
    leaves = {name: x for name, x in flat(tree) if isinstance(x, int | float) and not isinstance(x, bool)}
    return {name: float(x) for name, x in leaves.items() if math.isfinite(x)}


def mean_curves(history: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Curves (epochs,) of a fit's history (epochs, members, n): the mean over members and joints, finite ones."""
    means = {name: np.asarray(x, float).reshape(len(x), -1).mean(axis=1) for name, x in history.items() if len(x)}
    return {name: x for name, x in means.items() if np.isfinite(x).all()}
