"""How a diagnosis spoke of what was hidden, and the table by kind of logs that were counted."""

from collections.abc import Iterable, Sequence
from typing import Protocol

from experiments.confusion import matches, told_by
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.types import Finding


class Row(Protocol):
    """What a counted log says of itself: effect@joint or "none", how that was spoken of, and what was claimed beside
    it."""

    @property
    def hidden(self) -> str: ...
    @property
    def result(self) -> str: ...
    @property
    def false(self) -> Sequence[str]: ...


def told(hidden: Hidden | None, found: Sequence[Finding]) -> tuple[str, list[Finding]]:
    """How what was hidden, if anything, was spoken of, and the other findings."""
    if hidden is None:
        return "none", list(found)
    best = told_by(hidden, found)
    return "missed" if best is None else matches(hidden, best), [f for f in found if f is not best]


def jobs(seed: int, names: Sequence[str], logs: int, clean: int) -> Iterable[tuple[int, str]]:
    """The seed and the effect of every log: the names take turns, and then come logs without one."""
    plan = [(1000 * seed + k, names[k % len(names)]) for k in range(logs)]
    return plan + [(1000 * seed + 500 + k, "") for k in range(clean)]


def by_kind(rows: Sequence[Row], title: str, loud: Sequence[Row] = (), said: str = "") -> list[str]:
    """A line for each kind of what was hidden, as a Markdown table; at its end, of those that are `loud`, how many were
    named or ambiguous, if a heading is `said`."""
    heads = [title, "logs", "named", "ambiguous", "missed", "false beside it", *([said] if said else [])]
    lines = [f"| {' | '.join(heads)} |", "|---|" + "---:|" * (len(heads) - 1)]
    for name in dict.fromkeys(row.hidden.split("@")[0] for row in rows):
        own = [row for row in rows if row.hidden.split("@")[0] == name]
        cells = [len(own), *(sum(row.result == r for row in own) for r in ("named", "ambiguous", "missed"))]
        cells.append(sum(len(row.false) for row in own))
        of_loud = [row.result != "missed" for row in own if row in loud]
        cells += [f"{sum(of_loud)} of {len(of_loud)}"] if said else []
        lines.append(f"| {name} | {' | '.join(map(str, cells))} |")
    return lines
