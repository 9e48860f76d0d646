"""What each refusal of a claim is worth, and how far its figure is from right and false claims (calibrate.md)."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from experiments.confusion import claims
from experiments.told import said_of
from experiments.worn import Worn, drawn, spoken
from invdyn_cli.diagnosis import Options
from invdyn_cli.diagnosis.case import Case, prepared
from invdyn_cli.diagnosis.columns.evidence import Candidate
from invdyn_cli.diagnosis.decide.claim import Claim, exactly, left
from invdyn_cli.diagnosis.decide.support import REFUSALS, supported
from invdyn_cli.diagnosis.pipeline import decided, searched
from invdyn_cli.diagnosis.search.inquiry import Inquiry
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.simulation.hidden import Hidden

WHOLE = "none"
"""The name of the row that is left out when none is."""


@dataclass(frozen=True)
class Worth:
    """One log without one row of the table: what was said of its anomaly, what else was claimed, and the row's figure
    of the right candidate that the search found, and of the others."""

    seed: int
    hidden: str
    left_out: str
    result: str
    false: tuple[str, ...]
    right: tuple[float, ...] = ()
    others: tuple[float, ...] = ()


@dataclass(frozen=True)
class Calibrate(Worn):
    """The logs of `Worn`, each searched once and decided with each row of the table left out."""

    row: ClassVar[type] = Worth

    logs: int = 12
    clean: int = 6

    def run(self, folder: Path, seed: int, name: str) -> Iterable[Worth]:
        """Draw and search one log, and decide without each row."""
        one = drawn(seed, name)
        anomaly = one.anomaly
        case = prepared(one.log, one.scene.robot, None, None, Options(), EFFECTS)
        if not isinstance(case, Case):
            return
        inquiry, columns = searched(case)
        hidden = f"{anomaly.effect}@{anomaly.joint}" if anomaly else WHOLE
        found = _found(inquiry, anomaly)
        told: dict[tuple, tuple[str, tuple[str, ...]]] = {}
        for number, table in enumerate([REFUSALS, *(_without(k) for k in range(len(REFUSALS)))]):
            kept = tuple(c.key for c in supported(inquiry, table)[0])
            if kept not in told:
                diagnosis = decided(case, inquiry, columns, Options(), refusals=table)
                result, false = spoken(anomaly, claims(diagnosis))
                told[kept] = result, tuple(map(said_of, false))
            name = WHOLE if number == 0 else REFUSALS[number - 1].name
            figures = [tuple(REFUSALS[number - 1].figure(x) for x in some) if number else () for some in found]
            yield Worth(seed, hidden, name, *told[kept], *figures)

    def line(self, row: Worth) -> str:
        """What was said without a row."""
        return f"{row.seed} {row.hidden}, left out: {row.left_out}: {row.result}, false {row.false}"

    def table(self, rows: Sequence[Worth]) -> str:
        """A row for each of the table's, as Markdown."""
        lines = [
            "| left out | right | logs with a false claim | least | figures of right claims: smallest, median "
            "| of others: median, largest |",
            "|---|---:|---:|---:|---:|---:|",
        ]
        least = {WHOLE: ""} | {x.name: f"{x.least:.3g}" if x.least > 1e-9 else "above 0" for x in REFUSALS}
        for name in dict.fromkeys(x.left_out for x in rows):
            own = [x for x in rows if x.left_out == name]
            worn = [x for x in own if x.hidden != WHOLE]
            right = sum(x.result in ("named", "ambiguous") for x in worn)
            false = sum(bool(x.false) for x in own)
            ends = [
                _ends([v for x in own for v in x.right], (0, 50)),
                _ends([v for x in own for v in x.others], (50, 100)),
            ]
            cells = [name, f"{right} of {len(worn)}", f"{false} of {len(own)}", least[name], *ends]
            lines.append(f"| {' | '.join(cells)} |")
        return "\n".join(lines)


def _without(place: int) -> tuple:
    return REFUSALS[:place] + REFUSALS[place + 1 :]


def _found(inquiry: Inquiry, anomaly: Hidden | None) -> tuple[list[Claim], list[Claim]]:
    """The anomalies that the search found, before any is refused: the right one, and the others."""
    hypothesis = inquiry.hypothesis
    every, after = np.ones_like(inquiry.judge.rows), left(inquiry, hypothesis)
    exact = exactly(inquiry, hypothesis, inquiry.whole, every)
    right, others = [], []
    for k, c in enumerate(hypothesis):
        if c.effect.group != "standard":
            (right if _is_it(inquiry, c, anomaly) else others).append(Claim(inquiry, hypothesis, k, exact, after))
    return right, others


def _is_it(inquiry: Inquiry, candidate: Candidate, anomaly: Hidden | None) -> bool:
    joint = None if candidate.joint is None else inquiry.evidence.robot.joints[candidate.joint]
    return anomaly is not None and candidate.effect.name == anomaly.effect and joint in (None, anomaly.joint)


def _ends(values: Sequence[float], at: tuple[float, float]) -> str:
    shown = [x for x in values if np.isfinite(x)]  # of an effect without a delay, its delay has no figure
    return ", ".join(f"{x:.3g}" for x in np.percentile(shown, at)) if shown else "-"
