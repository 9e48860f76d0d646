"""Two effects, diagnosed, written as MJCF, and replayed on the log (replay.md)."""

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from experiments.cases import SIZES, Case, draw_case
from experiments.confusion import WHOLE_ARM, claims, name_of
from experiments.truth import mjcf_of
from invdyn_cli.abstract_experiment import AbstractExperiment
from invdyn_cli.diagnosis import Options, diagnose, extension
from invdyn_cli.simulation.replay import replay

ENOUGH = 0.8
"""[-] Share of the error that shall vanish."""

NOT_HELD = (
    *("stribeck_friction", "load_dependent_friction", "thermal_friction_drift", "presliding_hysteresis"),
    *("torque_ripple", "torque_offset_drift", "torque_gain_change", "payload_change", "external_contact"),
)
"""Effects that an MJCF lacks, and those that come and go."""


@dataclass(frozen=True)
class Replayed:
    """One log: what was hidden and said; errors [rad], mean of the joints: of the nominal arm, of the extended one, of
    the one with what was hidden; and while the arms were held, nominal and extended."""

    seed: int
    hidden: tuple[str, ...]
    said: tuple[str, ...]
    before: float
    after: float
    best: float
    held_before: float
    held_after: float
    seconds: float

    @property
    def gain(self) -> float:
        """Share of the error that vanished."""
        return 1 - self.after / self.before


def names_of(seed: int, k: int) -> tuple[str, ...]:
    """The two effects of log k."""
    held = [name for name in SIZES if name not in NOT_HELD]
    draw = np.random.default_rng([seed, k, 5])
    return tuple(str(x) for x in draw.choice(held, 2, replace=False))


def played(seed: int, case: Case) -> Replayed:
    """One log, diagnosed and replayed."""
    started = time.perf_counter()
    kept = {}

    def keep(model, stretches, progress=None):
        kept["stretches"] = stretches
        return real(model, stretches)

    real, extension.replayed = extension.replayed, keep
    try:
        diagnosis = diagnose(case.log, case.robot, options=Options(replay=True))
    finally:
        extension.replayed = real
    found = diagnosis.replay
    nominal, truth = (mjcf_of(case.robot, x)[0] for x in ((), case.hidden))
    best = replay(nominal, truth, kept["stretches"], case.robot.joints)
    return Replayed(
        seed=seed,
        hidden=tuple(map(name_of, case.hidden)),
        said=tuple(f"{x.effect}@{x.joint}" for x in claims(diagnosis)),
        before=float(found.before.mean()),
        after=float(found.after.mean()),
        best=float(best.after.mean()),
        held_before=float(found.held_before.mean()),
        held_after=float(found.held_after.mean()),
        seconds=time.perf_counter() - started,
    )


@dataclass(frozen=True)
class Replay(AbstractExperiment):
    """By how much the error of a replay falls, with the diagnosis' model and with the true one."""

    row: ClassVar[type] = Replayed

    seed: int = 0
    logs: int = 20

    def plan(self, rows: Sequence[Replayed]) -> Iterable[tuple]:
        """A job per log: its seed and its two effects."""
        return [(1000 * self.seed + k, *names_of(self.seed, k)) for k in range(self.logs)]

    def run(self, folder: Path, seed: int, *names: str) -> Iterable[Replayed]:
        """Draw, diagnose, replay one log."""
        yield played(seed, draw_case(seed, names, same_joint=None if set(names) & set(WHOLE_ARM) else False))

    def line(self, row: Replayed) -> str:
        """The errors of one log."""
        return (
            f"{row.seed} {row.hidden} -> {row.said}: {row.before:.3g} rad to {row.after:.3g} ({row.best:.3g} at best), "
            f"{100 * row.gain:.0f} %; held {row.held_before:.3g} to {row.held_after:.3g}; {row.seconds:.0f} s"
        )

    def table(self, rows: Sequence[Replayed]) -> str:
        """A row per log, as Markdown, and how many gained enough."""
        lines = ["| hidden | nominal [rad] | extended | at best | falls by |", "|---|---:|---:|---:|---:|"]
        for x in rows:
            numbers = " | ".join(f"{v:.2g}" for v in (x.before, x.after, x.best))
            lines.append(f"| {', '.join(x.hidden)} | {numbers} | {100 * x.gain:.0f} % |")
        good = sum(x.gain >= ENOUGH for x in rows)
        lines.append(f"\n{good} of {len(rows)} logs: the error falls by {100 * ENOUGH:.0f} % or more")
        return "\n".join(lines)
