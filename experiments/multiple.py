"""Several effects at once, on different joints and on one joint: F1 of (effect, joint) pairs (multiple.md)."""

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from experiments.cases import SIZES, WHOLE_ARM, Case, draw_case
from experiments.confusion import claims, judge, name_of, said_of, told_by
from experiments.worn import ANOMALIES, LOUD, beyond_wear, several
from invdyn_cli.abstract_experiment import AbstractExperiment, chosen
from invdyn_cli.diagnosis import diagnose
from invdyn_cli.types import Diagnosis

PAIRS = (
    ("coulomb_friction", "viscous_friction"),
    ("stribeck_friction", "torque_ripple"),
    ("torque_gain_error", "load_dependent_friction"),
)
TASKS = {"three": "three on different joints", "two": "two on one joint", "worn": "three on a worn arm"}


@dataclass(frozen=True)
class Counted:
    """One log: pairs that were hidden, said, missed, claims beside them, and pairs of which little is left beyond what
    a worn arm has."""

    task: str
    seed: int
    hidden: tuple[str, ...]
    said: tuple[str, ...]
    missed: tuple[str, ...]
    extra: tuple[str, ...]
    seconds: float
    faint: tuple[str, ...] = ()


def names_of(task: str, seed: int, k: int) -> tuple[str, ...]:
    """The effects of log k of a task."""
    if task == "two":
        return PAIRS[k % len(PAIRS)]
    of_joint = ANOMALIES if task == "worn" else [name for name in SIZES if name not in WHOLE_ARM]
    draw = np.random.default_rng([seed, k, 3])
    return tuple(str(x) for x in draw.choice(of_joint, 3, replace=False))


def count(task: str, seed: int, case: Case, diagnosis: Diagnosis, seconds: float) -> Counted:
    """What a diagnosis found of what was hidden: each finding stands for one hidden effect at most."""
    left, missed = list(claims(diagnosis)), []
    for hidden in case.hidden:
        best = told_by(hidden, left)
        if best is None:
            missed.append(name_of(hidden))
        else:
            left.remove(best)
    outcome = judge(case, diagnosis, seed, seconds)
    extra = tuple(map(said_of, beyond_wear(left))) if task == "worn" else outcome.extra
    faint = tuple(map(name_of, case.faint))
    return Counted(task, seed, outcome.hidden, outcome.named, tuple(missed), extra, seconds, faint)


def loud(one: Counted) -> Counted:
    """A log as if what is faint had not been hidden; a claim that names it is not counted, either."""
    hidden, missed = (tuple(x for x in names if x not in one.faint) for names in (one.hidden, one.missed))
    return replace(one, hidden=hidden, missed=missed)


def f1(logs: Sequence[Counted]) -> tuple[float, float, float]:
    """F1, precision and recall of the pairs of all logs together."""
    hidden, missed, extra = (sum(len(getattr(c, name)) for c in logs) for name in ("hidden", "missed", "extra"))
    right = hidden - missed
    return 2 * right / max(2 * right + missed + extra, 1), right / max(right + extra, 1), right / max(hidden, 1)


@dataclass(frozen=True)
class Multiple(AbstractExperiment):
    """Three effects on different joints, two on one joint, and three on a worn arm."""

    row: ClassVar[type] = Counted

    seed: int = 0
    logs: int = 20
    only: Sequence[str] = ()

    def plan(self, rows: Sequence[Counted]) -> Iterable[tuple]:
        """A job per log: its task, its seed, its effects."""
        for task in chosen("only", self.only, TASKS):
            for k in range(self.logs):
                yield task, 1000 * self.seed + k, *names_of(task, self.seed, k)

    def run(self, folder: Path, task: str, seed: int, *names: str) -> Iterable[Counted]:
        """Draw, diagnose, judge one log."""
        case = several(seed, names) if task == "worn" else draw_case(seed, names, same_joint=task == "two")
        started = time.perf_counter()
        diagnosis = diagnose(case.log, case.robot)
        yield count(task, seed, case, diagnosis, time.perf_counter() - started)

    def line(self, row: Counted) -> str:
        """What was missed and what was claimed beside it."""
        faint = f" (faint {row.faint})" if row.faint else ""
        return (
            f"{row.task} {row.seed} {row.hidden}{faint}: missed {row.missed}, beside {row.extra}; {row.seconds:.0f} s"
        )

    def table(self, rows: Sequence[Counted]) -> str:
        """A row per task, and one for each pair on one joint, as Markdown."""
        groups = {title: [c for c in rows if c.task == task] for task, title in TASKS.items()}
        for pair in PAIRS:
            own = [c for c in groups[TASKS["two"]] if c.hidden[0].startswith(pair[0] + "@")]
            groups["of these " + " + ".join(pair)] = own
        groups[f"those of a worn arm over {LOUD:g} times the noise beyond its terms"] = list(
            map(loud, groups[TASKS["worn"]])
        )
        lines = ["| hidden | logs | F1 | precision | recall | all right |", "|---|---:|---:|---:|---:|---:|"]
        for title, logs in groups.items():
            if logs:
                numbers = " | ".join(f"{x:.2f}" for x in f1(logs))
                perfect = sum(not c.missed and not c.extra for c in logs)
                lines.append(f"| {title} | {len(logs)} | {numbers} | {perfect} |")
        return "\n".join(lines)
