"""What each refusal of a claim is worth, and how far its figure is from right and false claims (calibrate.md)."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from experiments import cases, unknown
from experiments.changed import CHANGES, beyond_change
from experiments.confusion import claims, judge, name_of, said_of
from experiments.told import jobs, told
from experiments.worn import SIZES, Worn, beyond_wear, drawn
from invdyn_cli.abstract_experiment import chosen
from invdyn_cli.diagnosis import Options
from invdyn_cli.diagnosis.case import Case, prepared
from invdyn_cli.diagnosis.columns.evidence import Candidate
from invdyn_cli.diagnosis.decide.claim import Claim, exactly, left
from invdyn_cli.diagnosis.decide.refusals import REFUSALS, Refusal, supported
from invdyn_cli.diagnosis.pipeline import decided, searched
from invdyn_cli.diagnosis.search.inquiry import Inquiry
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.log import Log
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.types import Diagnosis, Robot

NO_ROW, ALL_ROWS = "none", "all"
"""What is left out of the whole table, and of one without rows."""

ARMS = ("worn", "changed", "perfect", "outside")
"""Worn arms with one anomaly or none; worn arms beside a reference, with one change or none; perfect arms with one
effect; perfect arms with one that the catalogue lacks."""


@dataclass(frozen=True)
class Worth:
    """One log without some rows of the table: what was said of its anomaly, what else was claimed, and, of one row that
    is left out, the figure of the right candidate that the search found, and of the others. `arm`: one of ARMS."""

    arm: str
    seed: int
    hidden: str
    left_out: str
    result: str
    false: tuple[str, ...]
    right: tuple[float, ...] = ()
    others: tuple[float, ...] = ()


@dataclass(frozen=True)
class Calibrate(Worn):
    """Logs of `Worn`, of `Changed`, of one effect on a perfect arm and of effects outside the catalogue, each searched
    once and decided with each row of the table left out, with none, and with each alone."""

    row: ClassVar[type] = Worth

    logs: int = 12
    clean: int = 6
    changed: int = 8
    perfect: int = 12
    outside: int = 8

    def plan(self, rows: Sequence[Worth]) -> Iterable[tuple]:
        """A job per log: on which arm, its seed and its effect."""
        names = chosen("only", self.only, SIZES)
        return [
            *(("worn", *job) for job in jobs(self.seed, names, self.logs, self.clean)),
            *(("changed", *job) for job in jobs(self.seed, CHANGES, self.changed, self.changed // 3)),
            *(("perfect", *job) for job in jobs(self.seed, names, self.perfect, 0)),
            *(("outside", *job) for job in jobs(self.seed, list(unknown.INVENTIONS), self.outside, 0)),
        ]

    def run(self, folder: Path, arm: str, seed: int, name: str) -> Iterable[Worth]:
        """Draw and search one log, and decide by each table."""
        log, reference, robot, anomaly, false = _log(arm, seed, name)
        case = prepared(log, robot, None, reference, Options(), EFFECTS)
        if not isinstance(case, Case):
            return
        inquiry, columns = searched(case)
        found = _found(inquiry, anomaly)
        spoken: dict[tuple, tuple[str, tuple[str, ...]]] = {}
        for left_out, table in _tables():
            kept = tuple(c.key for c in supported(inquiry, table)[1])
            if kept not in spoken:
                diagnosis = decided(case, inquiry, columns, Options(), refusals=table)
                spoken[kept] = told(anomaly, claims(diagnosis))[0], false(diagnosis)
            one = next((row for row in REFUSALS if row.name == left_out), None)
            figures = [tuple(one.figure(x) for x in some) if one else () for some in found]
            yield Worth(arm, seed, name_of(anomaly), left_out, *spoken[kept], *figures)

    def line(self, row: Worth) -> str:
        """What was said without a row."""
        return f"{row.arm} {row.seed} {row.hidden}, left out: {row.left_out}: {row.result}, false {row.false}"

    def table(self, rows: Sequence[Worth]) -> str:
        """A row for each of the table's, as Markdown."""
        lines = [
            "| left out | worn: right | with a false claim | changed: right | with a false claim | perfect: right "
            "| with a false claim | outside the catalogue: with a claim | least "
            "| figures of right claims: smallest, median | of others: median, largest |",
            "|---|" + "---:|" * 10,
        ]
        least = {x.name: f"{x.least:.3g}" if x.least > 1e-9 else "above 0" for x in REFUSALS}
        for name in dict.fromkeys(x.left_out for x in rows):
            own = [x for x in rows if x.left_out == name]
            counts = [count for arm in ARMS for count in _counts(arm, [x for x in own if x.arm == arm])]
            ends = [
                _ends([v for x in own for v in x.right], (0, 50)),
                _ends([v for x in own for v in x.others], (50, 100)),
            ]
            cells = [name, *counts, least.get(name, ""), *ends]
            lines.append(f"| {' | '.join(cells)} |")
        return "\n".join(lines)


def _log(
    arm: str, seed: int, name: str
) -> tuple[Log, Log | None, Robot, Hidden | None, Callable[[Diagnosis], tuple[str, ...]]]:
    """A log, its reference if it has one, its nominal robot, what is hidden in it that the catalogue has, and what says
    which claims are false."""
    if arm in ("worn", "changed"):
        one = drawn(seed, name)

        def beside(diagnosis: Diagnosis) -> tuple[str, ...]:
            rest = told(one.anomaly, claims(diagnosis))[1]
            return tuple(map(said_of, beyond_wear(rest) if arm == "worn" else beyond_change(one.anomaly, rest)))

        return one.log, one.before() if arm == "changed" else None, one.scene.robot, one.anomaly, beside
    if arm == "perfect":
        case = cases.draw_case(seed, [name])
        return case.log, None, case.robot, case.hidden[0], lambda diagnosis: judge(case, diagnosis, seed, 0.0).extra
    case = unknown.draw(name, seed)[0]
    return case.log, None, case.robot, None, lambda diagnosis: tuple(map(said_of, claims(diagnosis)))


def _counts(arm: str, rows: Sequence[Worth]) -> list[str]:
    """Logs whose effect was named or rightly ambiguous, but of those outside the catalogue, and logs with a false
    claim."""
    hidden = [x for x in rows if x.hidden != NO_ROW]
    right = sum(x.result in ("named", "ambiguous") for x in hidden)
    false = sum(bool(x.false) for x in rows)
    return [*([f"{right} of {len(hidden)}"] if arm != "outside" else []), f"{false} of {len(rows)}"]


def _tables() -> Iterable[tuple[str, tuple[Refusal, ...]]]:
    """The tables by which a log is decided, and what is left out of them: first the whole one, then all without one
    row, one without rows, and all with one row."""
    yield NO_ROW, REFUSALS
    for row in REFUSALS:
        yield row.name, tuple(x for x in REFUSALS if x is not row)
    yield ALL_ROWS, ()
    for row in REFUSALS:
        yield f"{ALL_ROWS} but {row.name}", (row,)


def _found(inquiry: Inquiry, anomaly: Hidden | None) -> tuple[list[Claim], list[Claim]]:
    """The anomalies that the search found, before any is refused: the right one, and the others."""
    hypothesis = inquiry.hypothesis
    every, after = np.ones_like(inquiry.judge.rows), left(inquiry, hypothesis)
    exact = exactly(inquiry, hypothesis, inquiry.whole, every), inquiry.chosen
    right, others = [], []
    for k, c in enumerate(hypothesis):
        if c.effect.group != "standard":
            (right if _is_it(inquiry, c, anomaly) else others).append(Claim(inquiry, hypothesis, k, *exact, after))
    return right, others


def _is_it(inquiry: Inquiry, candidate: Candidate, anomaly: Hidden | None) -> bool:
    joint = None if candidate.joint is None else inquiry.evidence.robot.joints[candidate.joint]
    return anomaly is not None and candidate.effect.name == anomaly.effect and joint in (None, anomaly.joint)


def _ends(values: Sequence[float], at: tuple[float, float]) -> str:
    shown = [x for x in values if np.isfinite(x)]  # of an effect without a delay, its delay has no figure
    return ", ".join(f"{x:.3g}" for x in np.percentile(shown, at)) if shown else "-"
