"""Several causes at once: three on different joints, and two on one joint; F1 of (effect, joint) pairs.

    python experiments/multiple.py [seed=0] [logs=20] [only=three,two] [folder=outputs/multiple]

Logs are drawn as in `cases.py`. A finding counts as right where `confusion.matches` says so: named, or ambiguous within
what theory allows. Three effects are drawn for every log from all that act on a joint; pairs on one joint take turns.
"""

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from experiments.cases import SIZES, WHOLE_ARM, Case, draw_case
from experiments.confusion import claims, judge, matches
from experiments.options import only_of, options_of
from experiments.results import tell
from invdyn_cli.diagnosis import diagnose
from invdyn_cli.types import Diagnosis

PAIRS = (
    ("coulomb_friction", "viscous_friction"),
    ("stribeck_friction", "torque_ripple"),
    ("torque_gain_error", "load_dependent_friction"),
)
TASKS = {"three": "three on different joints", "two": "two on one joint"}


@dataclass(frozen=True)
class Options:
    """What the command line may say."""

    seed: int = 0
    logs: int = 20
    only: Sequence[str] = tuple(TASKS)
    folder: str = "outputs/multiple"


@dataclass(frozen=True)
class Counted:
    """One log: pairs that were hidden, said, found, and claims beside them."""

    task: str
    seed: int
    hidden: tuple[str, ...]
    said: tuple[str, ...]
    missed: tuple[str, ...]
    extra: tuple[str, ...]
    seconds: float


def names_of(task: str, seed: int, k: int) -> tuple[str, ...]:
    """The effects of log k of a task."""
    if task == "two":
        return PAIRS[k % len(PAIRS)]
    of_joint = [name for name in SIZES if name not in WHOLE_ARM]
    draw = np.random.default_rng([seed, k, 3])
    return tuple(str(x) for x in draw.choice(of_joint, 3, replace=False))


def count(task: str, seed: int, case: Case, diagnosis: Diagnosis, seconds: float) -> Counted:
    """What a diagnosis found of what was hidden: each finding stands for one hidden effect at most."""
    left, missed = list(claims(diagnosis)), []
    for hidden in case.hidden:
        how = {match: f for f in reversed(left) if (match := matches(hidden, f))}
        best = how.get("named", how.get("ambiguous"))
        if best is None:
            missed.append(f"{hidden.effect}@{hidden.joint}")
        else:
            left.remove(best)
    outcome = judge(case, diagnosis, seed, seconds)
    return Counted(task, seed, outcome.hidden, outcome.named, tuple(missed), outcome.extra, seconds)


def f1(logs: Sequence[Counted]) -> tuple[float, float, float]:
    """F1, precision and recall of the pairs of all logs together."""
    hidden, missed, extra = (sum(len(getattr(c, name)) for c in logs) for name in ("hidden", "missed", "extra"))
    right = hidden - missed
    return 2 * right / max(2 * right + missed + extra, 1), right / max(right + extra, 1), right / max(hidden, 1)


def table(counted: Sequence[Counted]) -> str:
    """A row per task, and one for each pair on one joint, as Markdown."""
    groups = {title: [c for c in counted if c.task == task] for task, title in TASKS.items()}
    for pair in PAIRS:
        own = [c for c in groups[TASKS["two"]] if c.hidden[0].startswith(pair[0] + "@")]
        groups["of these " + " + ".join(pair)] = own
    lines = ["| hidden | logs | F1 | precision | recall | all right |", "|---|---:|---:|---:|---:|---:|"]
    for title, logs in groups.items():
        if logs:
            numbers = " | ".join(f"{x:.2f}" for x in f1(logs))
            perfect = sum(not c.missed and not c.extra for c in logs)
            lines.append(f"| {title} | {len(logs)} | {numbers} | {perfect} |")
    return "\n".join(lines)


def main(argv: Sequence[str]) -> int:
    """Run as the docstring says."""
    options = options_of(argv, Options(), __doc__)
    tasks, folder, counted = only_of("only", options.only, TASKS), Path(options.folder), []
    folder.mkdir(parents=True, exist_ok=True)
    for task in tasks:
        for k in range(options.logs):
            seed = 1000 * options.seed + k
            case = draw_case(seed, names_of(task, options.seed, k), same_joint=task == "two")
            started = time.perf_counter()
            diagnosis = diagnose(case.log, case.robot)
            one = count(task, seed, case, diagnosis, time.perf_counter() - started)
            counted.append(one)
            print(
                f"{task} {seed} {one.hidden}: missed {one.missed}, beside {one.extra}; {one.seconds:.0f} s", flush=True
            )
    tell(folder, "multiple", f"seed {options.seed}", table(counted), counted)
    return 0


if __name__ == "__main__":
    from invdyn_cli.verbs.screen import use_compilation_cache

    use_compilation_cache()
    sys.exit(main(sys.argv[1:]))
