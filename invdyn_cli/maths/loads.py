"""The loads that an adaptation reported along recordings, read from its trace."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from invdyn_cli.maths import stages
from invdyn_cli.types import Dataset, Trajectory


@dataclass(frozen=True)
class Load:
    """A stretch of one recording in which a load was reported.

    Attributes:
        trajectory: of that name.
        came, went: [s] of its clock; went: None where it was believed in until the end.
        came_in, went_in: the stages of that, "" without stages.
        came_after, went_after: [s] since these began.
        mass, mass_std: [kg]; com, com_std: (3,) [m] in the last joint's frame; at the recording's end where it is still
            there, else when nothing spoke against it for the last time (of the one believed in longest: on its way out
            what is left of a load is taken for another one).
    """

    trajectory: str
    came: float
    went: float | None
    came_in: str
    went_in: str
    came_after: float
    went_after: float | None
    mass: float
    mass_std: float
    com: tuple[float, ...]
    com_std: tuple[float, ...]


def believed(data: Dataset, trace: Mapping[str, np.ndarray]) -> list[Load]:
    """All loads in time; none for the trace of another adaptation. `trace` is (samples, …) over all of the data."""
    found, row = [], 0
    for x in data.trajectories if "loaded" in trace else ():
        own = {name: values[row : row + len(x.t)] for name, values in trace.items()}
        row += len(x.t)
        edges = np.flatnonzero(np.diff(own["loaded"] > 0.5, prepend=False, append=False))
        found += [_load(x, own, int(a), int(b)) for a, b in edges.reshape(-1, 2)]
    return found


def _load(x: Trajectory, trace: Mapping[str, np.ndarray], first: int, end: int) -> Load:
    """The load of rows `first` to `end`."""
    last, gone = end - 1, end < len(x.t)
    if gone:
        edges = [first, *(first + 1 + np.flatnonzero(np.diff(trace["since"][first:end]) < 0)), end]
        begin, over = max(pairwise(edges), key=lambda rows: rows[1] - rows[0])
        stands = np.flatnonzero(trace["evidence"][begin:over] <= 0)
        last = begin + stands[-1] if len(stands) else over - 1
    came_in, came_after = _stage(x, first)
    went_in, went_after = _stage(x, end) if gone else ("", None)
    return Load(
        trajectory=x.name,
        came=float(x.t[first]),
        went=float(x.t[end]) if gone else None,
        came_in=came_in,
        went_in=went_in,
        came_after=came_after,
        went_after=went_after,
        mass=float(trace["mass"][last]),
        mass_std=float(trace["mass_std"][last]),
        com=tuple(trace["com"][last].tolist()),
        com_std=tuple(trace["com_std"][last].tolist()),
    )


def _stage(x: Trajectory, row: int) -> tuple[str, float]:
    """Name of a row's stage, and time [s] since it began."""
    name, rows = next((name, rows) for name, rows in stages.parts(x) if rows.stop > row)
    return "" if x.stage is None else name, float(x.t[row] - x.t[rows.start])
