"""What has changed on a worn arm since an earlier log: one effect, or nothing (changed.md)."""

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from experiments.cases import SIZES
from experiments.confusion import claims, name_of, said_of
from experiments.told import by_kind, jobs, told
from experiments.worn import ANOMALIES, LOUD, drawn
from invdyn_cli.abstract_experiment import AbstractExperiment, chosen
from invdyn_cli.diagnosis import diagnose
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.types import Finding

CHANGES = (*ANOMALIES, "coulomb_friction", "viscous_friction", "torque_offset", "base_tilt")
"""Anomalies, and what wear itself may become."""

LESSENED = ("coulomb_friction", "viscous_friction", "torque_offset", "payload")
"""Of these, what goes away as often as it comes: friction of a warm gear, a tool that is taken off."""


@dataclass(frozen=True)
class Counted:
    """Two logs: what has changed between them ("less" before what has gone away), how many times the noise it makes on
    the joint that feels it most, how it was spoken of, and what was claimed beside it."""

    seed: int
    said: str
    hidden: str
    times: float
    result: str
    named: tuple[str, ...]
    false: tuple[str, ...]
    verdict: str
    seconds: float


def beyond_change(change: Hidden | None, rest: Sequence[Finding]) -> list[Finding]:
    """The findings beside the one of a change that are no rotor that a gear with play or a spring brings with it."""
    brought = ("rotor_inertia", change.joint) if change is not None and "rotor" in change.parameters else None
    return [f for f in rest if (f.effect, f.joint) != brought]


def count(seed: int, name: str) -> Counted:
    """What a diagnosis says of a log beside its reference."""
    one = drawn(seed, name)
    goes = name in LESSENED and bool(np.random.default_rng([seed, 10]).integers(2))
    now, before = (one.before(), one.log) if goes else (one.log, one.before())
    started = time.perf_counter()
    diagnosis = diagnose(now, one.scene.robot, reference=before)
    seconds = time.perf_counter() - started
    change, found = one.anomaly, claims(diagnosis)
    result, rest = told(change, found)
    named, beside = (tuple(map(said_of, x)) for x in (found, beyond_change(change, rest)))
    hidden = f"less {name_of(change)}" if goes else name_of(change)
    return Counted(seed, one.said, hidden, one.times, result, named, beside, diagnosis.verdict, seconds)


@dataclass(frozen=True)
class Changed(AbstractExperiment):
    """Changes of worn arms, in turn, and worn arms on which nothing has changed."""

    row: ClassVar[type] = Counted

    seed: int = 0
    logs: int = 32
    clean: int = 10
    only: Sequence[str] = CHANGES

    def plan(self, rows: Sequence[Counted]) -> Iterable[tuple]:
        """A job per log: its seed and its change."""
        return jobs(self.seed, chosen("only", self.only, SIZES), self.logs, self.clean)

    def run(self, folder: Path, seed: int, name: str) -> Iterable[Counted]:
        """Draw, diagnose, judge one log."""
        yield count(seed, name)

    def line(self, row: Counted) -> str:
        """What has changed and what was named."""
        return (
            f"{row.result}: {row.seed} {row.hidden} ({row.times:.1f} times the noise) -> {row.named} "
            f"({row.said}; {row.seconds:.0f} s, {row.verdict})"
        )

    def table(self, rows: Sequence[Counted]) -> str:
        """A row per change, as Markdown, and what holds for all logs."""
        loud = [c for c in rows if c.times > LOUD]
        right = sum(c.result in ("named", "ambiguous") for c in loud)
        return "\n".join(
            [
                *by_kind(rows, "changed"),
                "",
                f"Changes that make over {LOUD:g} times the noise: {right} of {len(loud)} right or rightly ambiguous; "
                f"{sum(bool(c.false) for c in rows)} of {len(rows)} logs with a false one beside it.",
                f"Seconds a log: median {np.median([c.seconds for c in rows]):.0f}, "
                f"longest {max(c.seconds for c in rows):.0f}.",
            ]
        )
