"""The better simulation: two causes hidden in an arm, diagnosed, written as MJCF, and replayed on the log.

    python experiments/replay.py [seed=0] [logs=20] [folder=outputs/replay]

Logs are drawn as in `cases.py`, each with two effects on different joints that an MJCF can hold. The simulated arm is
left free for 0.2 s at a time under the logged torques, on the share of the log that the diagnosis did not learn from;
its error is the RMS over all such windows, mean of the joints. Printed is by how much it falls from the nominal arm to
the extended one, and, as what could be had at best, to the arm with exactly what was hidden.
"""

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from experiments.cases import SIZES, Case, draw_case
from experiments.confusion import WHOLE_ARM, claims
from experiments.options import options_of
from experiments.results import tell
from experiments.truth import mjcf_of
from invdyn_cli.diagnosis import Options as Wanted
from invdyn_cli.diagnosis import diagnose, extension
from invdyn_cli.simulation.replay import replay

ENOUGH = 0.8
"""[-] Share of the error that shall vanish."""

NOT_HELD = (
    *("stribeck_friction", "load_dependent_friction", "thermal_friction_drift", "presliding_hysteresis"),
    *("torque_ripple", "torque_offset_drift", "torque_gain_change", "payload_change", "external_contact"),
)
"""Effects that an MJCF lacks, and those that come and go."""


@dataclass(frozen=True)
class Options:
    """What the command line may say."""

    seed: int = 0
    logs: int = 20
    folder: str = "outputs/replay"


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
        diagnosis = diagnose(case.log, case.robot, options=Wanted(replay=True))
    finally:
        extension.replayed = real
    found = diagnosis.replay
    nominal, truth = (mjcf_of(case.robot, x)[0] for x in ((), case.hidden))
    best = replay(nominal, truth, kept["stretches"], case.robot.joints)
    return Replayed(
        seed=seed,
        hidden=tuple(f"{x.effect}@{x.joint}" for x in case.hidden),
        said=tuple(f"{x.effect}@{x.joint}" for x in claims(diagnosis)),
        before=float(found.before.mean()),
        after=float(found.after.mean()),
        best=float(best.after.mean()),
        held_before=float(found.held_before.mean()),
        held_after=float(found.held_after.mean()),
        seconds=time.perf_counter() - started,
    )


def table(logs: Sequence[Replayed]) -> str:
    """A row per log, as Markdown, and how many gained enough."""
    lines = ["| hidden | nominal [rad] | extended | at best | falls by |", "|---|---:|---:|---:|---:|"]
    for x in logs:
        numbers = " | ".join(f"{v:.2g}" for v in (x.before, x.after, x.best))
        lines.append(f"| {', '.join(x.hidden)} | {numbers} | {100 * x.gain:.0f} % |")
    good = sum(x.gain >= ENOUGH for x in logs)
    lines.append(f"\n{good} of {len(logs)} logs: the error falls by {100 * ENOUGH:.0f} % or more")
    return "\n".join(lines)


def main(argv: Sequence[str]) -> int:
    """Run as the docstring says."""
    options = options_of(argv, Options(), __doc__)
    folder, logs = Path(options.folder), []
    folder.mkdir(parents=True, exist_ok=True)
    for k in range(options.logs):
        seed = 1000 * options.seed + k
        names = names_of(options.seed, k)
        one = played(seed, draw_case(seed, names, same_joint=None if set(names) & set(WHOLE_ARM) else False))
        logs.append(one)
        print(
            f"{seed} {one.hidden} -> {one.said}: {one.before:.3g} rad to {one.after:.3g} ({one.best:.3g} at best), "
            f"{100 * one.gain:.0f} %; held {one.held_before:.3g} to {one.held_after:.3g}; {one.seconds:.0f} s",
            flush=True,
        )
    tell(folder, "replay", f"seed {options.seed}", table(logs), logs)
    return 0


if __name__ == "__main__":
    from invdyn_cli.verbs.screen import use_compilation_cache

    use_compilation_cache()
    sys.exit(main(sys.argv[1:]))
