"""What the doctor finds of defects that were put into sound logs: of simulated arms, and of real ones.

    python experiments/defects.py [seed=0] [logs=6] [clean=20] [only=units_q,sign_torque] [data=../shared/data]
                                  [pairs=0] [permutations=false] [folder=outputs/defects]

Every defect of `spoiled.DEFECTS` is put, with a size at random, into `logs` simulated arms that are worn (friction
everywhere, links some percent off), and into recordings of real robots where `data` has them. A defect is *found* when
its check says note or more of it, *right* when channel, joint and size are right too, or when the truth is among what
is called ambiguous or skipped by name; *false* is any other warning or failure that the log did not have before.
`clean` further logs have no defect. In place of single defects:

`pairs=N`: two different defects in one log, N times; right when both are, but for what the other one hides (`HIDES`).
`permutations=true`: on `logs` arms of six joints every exchange of two of them, and alphabetical order, of the torque
columns and of all columns.
"""

import itertools
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from experiments.cases import draw_scene, scene_of
from experiments.options import only_of, options_of
from experiments.results import tell
from experiments.spoiled import DEFECTS, arranged
from experiments.worn import wear
from invdyn_cli.diagnosis import doctor
from invdyn_cli.errors import UsageError
from invdyn_cli.logfile import Log, read_log
from invdyn_cli.robots import load_urdf
from invdyn_cli.simulation import plant
from invdyn_cli.simulation.references import Multisine
from invdyn_cli.simulation.sensors import Noise
from invdyn_cli.types import Check, Examination, Robot

REAL = {
    "panda.h5": ("exciting_trajectory_1",),
    "ur10e.h5": ("train_20_02_05_20sec_8harm", "train_20_02_12_40sec_12harm"),
    "iiwa14.h5": ("joint_2_to_7_dynamic_motion",),
    "kuka_lwr4.h5": ("run_1", "run_2"),
}
"""Logs and recordings, six in all."""

ALARMS = ("warn", "fail")
Base = tuple[str, Log, Robot]
"""Name, log and robot of what defects are put into."""

OF_TORQUE = (
    "units_torque", "unit_of_one_torque", "sign_all", "sign_torque", "sign_position", "sign_axis", "order_torque",
    "order_all", "order_reversed", "time_offset", "gravity_removed", "saturation",
)  # fmt: skip
"""Defects that a log shows by the torque of its drives."""

HIDES = {"model_mismatch": OF_TORQUE, "derivative": ("units_qd",)}
"""What cannot be found beside a defect: in white noise in place of the torque nothing, nor does noise stay at a limit;
of velocities that belong to other joints not their unit."""

SEQUENCE = ("gravity_removed", "model_mismatch", "time_offset", "saturation", "units_torque", "unit_of_one_torque",
            "sign_all", "sign_torque", "sign_position", "sign_axis", "order_torque", "order_all",
            "order_reversed", "q_ref", "derivative", "outliers", "units_qd", "units_q", "units_of_one_q", "units_t",
            "stamps", "not_finite")  # fmt: skip
"""In which two defects are put in: first what the drive does, then what a logger does; the doctor undoes the last
first."""

EXCLUSIVE = (("units_torque", "unit_of_one_torque"), ("units_q", "units_of_one_q"))
"""Further pairs of one kind; others have the same check."""


@dataclass(frozen=True)
class Counted:
    """One log: what was put into it, whether that was found and right, other alarms, what was said, seconds."""

    seed: int
    log: str
    defect: str
    found: bool
    right: bool
    false: tuple[str, ...]
    said: tuple[str, ...]
    seconds: float


@dataclass(frozen=True)
class Options:
    """What the command line may say."""

    seed: int = 0
    logs: int = 6
    clean: int = 20
    pairs: int = 0
    permutations: bool = False
    only: Sequence[str] = tuple(DEFECTS)
    data: str = os.environ.get("INVDYN_REAL_DATA", "../shared/data")
    folder: str = "outputs/defects"


def simulated(seed: int, joints: int | None = None) -> tuple[Log, Robot]:
    """A worn arm's log, 200 Hz, that a controller survived; of so many joints, or of any number."""
    for attempt in range(20):
        draw = np.random.default_rng([seed, attempt, 11])
        scene = draw_scene(draw, joints)
        scene = scene_of(scene.robot, Multisine(speed=0.5, amplitude=draw.uniform(0.5, 0.8)), 25.0, scene.seed)
        hiss = np.maximum(scene.torque, 0.02 * scene.torque.max()) * np.exp(draw.uniform(np.log(0.002), np.log(0.02)))
        errors = Noise(position=1e-5, position_quantum=2 * np.pi / 2**18, torque=tuple(hiss), velocity=1e-3)
        how: dict[str, Any] = {"duration": 25.0, "rate": 200.0, "seed": scene.seed, "noise": errors}
        try:
            return plant.record(scene.robot, [scene.reference], wear(draw, scene), **how), scene.robot
        except UsageError:
            continue
    raise RuntimeError(f"no stable arm from seed {seed}")


def alarms(examination: Examination) -> set[tuple]:
    """Warnings and failures: check, joint, channel."""
    about = (x.threshold if isinstance(x.threshold, dict) else {} for x in examination.checks)
    return {
        (x.check, x.joint, known.get("channel"))
        for x, known in zip(examination.checks, about, strict=True)
        if x.severity in ALARMS
    }


def count(seed: int, name: str, log: Log, robot: Robot, before: set, defects: Sequence[str]) -> Counted | None:
    """Defects in one log; None where the log has not what one of them needs. What others hide does not count."""
    if {"units_qd", "derivative"} & set(defects) and any(raw.qd is None for raw in log.trajectories):
        return None
    hidden = {x for defect in defects for x in HIDES.get(defect, ())}
    bad, tests = log, []
    for k, defect in enumerate(sorted(defects, key=SEQUENCE.index)):
        check, change = DEFECTS[defect]
        bad, right = change(np.random.default_rng([seed, 7 + k]), bad, robot)
        if defect not in hidden:
            tests.append((check, right))
    started = time.perf_counter()
    examination = doctor.examine(bad, robot)
    found = [any(x.severity not in ("ok", "skipped") for x in _of(check, examination)) for check, _ in tests]
    good = [any(x.severity != "ok" and _safely(right, x) for x in _of(check, examination)) for check, right in tests]
    names = {DEFECTS[defect][0] for defect in defects}
    known = {x[0] for x in before}  # what the log had before may stand in another column now
    others = {x for x in alarms(examination) if x[0] not in names | known}
    said = tuple(
        f"{x.severity} {x.check} {x.joint or ''}: {x.seen}" for x in examination.checks if x.severity in ALARMS
    )
    false = tuple(sorted(" ".join(map(str, x)) for x in others))
    seconds = time.perf_counter() - started
    return Counted(seed, name, " + ".join(defects), all(found), all(good), false, said, seconds)


def _of(check: str, examination: Examination) -> list[Check]:
    return [x for x in examination.checks if x.check == check]


def _safely(right: Callable[[Check], bool], check: Check) -> bool:
    try:
        return bool(right(check))
    except (TypeError, KeyError):
        return False


def draw_pair(draw: np.random.Generator, names: Sequence[str], log: Log) -> tuple[str, ...]:
    """Two defects that this log can have, found by different checks or in different channels."""
    able = [x for x in names if x not in ("units_qd", "derivative") or all(r.qd is not None for r in log.trajectories)]
    while True:
        pair = tuple(sorted(map(str, draw.choice(able, 2, replace=False)), key=SEQUENCE.index))
        alike = DEFECTS[pair[0]][0] == DEFECTS[pair[1]][0]
        if pair not in EXCLUSIVE and not (alike and DEFECTS[pair[0]][0] != "unit_error"):
            return pair


def renamed(log: Log, robot: Robot, draw: np.random.Generator) -> tuple[Log, Robot]:
    """The same with names whose alphabetical order is another one than the chain's."""
    names = robot.joints
    while names == tuple(sorted(names)):
        names = tuple(f"{x}_joint" for x in draw.permutation(list("abcdefgh"))[: robot.dofs])
    urdf = robot.urdf
    for old, new in zip(robot.joints, names, strict=True):
        urdf = urdf.replace(f'"{old}"', f'"{new}"')
    return replace(log, joints=names), replace(robot, joints=names, urdf=urdf)


def permuted(seed: int, name: str, log: Log, robot: Robot) -> Iterator[Counted]:
    """Every exchange of two joints and alphabetical order, of the torques and of all columns: right, or ambiguous."""
    n = robot.dofs
    alphabet = np.argsort(log.joints)
    exchanges = [np.array([{a: b, b: a}.get(j, j) for j in range(n)]) for a, b in itertools.combinations(range(n), 2)]
    for whole in (False, True):
        for columns in (*exchanges, alphabet):
            bad, truth = arranged(log, columns, whole)
            started = time.perf_counter()
            examination = doctor.examine(bad, robot)
            told = [x for x in _of("joint_order", examination) if x.severity not in ("ok", "skipped")]
            known = [x.threshold for x in told]
            stated = any({k: x.get(k) for k in truth} == truth for x in known)
            among = any(truth in x.get("alike", ()) for x in known)
            kind = "alphabetical" if columns is alphabet else "pair"
            defect = f"{kind}, {'all columns' if whole else 'torque'}"
            said = (f"{columns.tolist()}: {'right' if stated else 'ambiguous with it' if among else 'not right'}",)
            said += tuple(x.seen for x in _of("joint_order", examination))
            false = tuple(sorted(" ".join(map(str, x)) for x in alarms(examination) if x[0] != "joint_order"))
            yield Counted(seed, name, defect, bool(told), stated or among, false, said, time.perf_counter() - started)


def table(counted: Sequence[Counted], clean: Sequence[tuple[str, set]]) -> str:
    """A row per defect, as Markdown, and what clean logs raised."""
    lines = ["| defect | logs | found | right | with a false alarm |", "|---|" + "---:|" * 4]
    for name in dict.fromkeys(c.defect for c in counted):
        own = [c for c in counted if c.defect == name]
        numbers = (len(own), sum(c.found for c in own), sum(c.right for c in own), sum(bool(c.false) for c in own))
        lines.append(f"| {name} | {' | '.join(map(str, numbers))} |")
    total, right = len(counted), sum(c.right for c in counted)
    share = 100 * right / max(total, 1)
    lines += ["", f"Right: {right} of {total} ({share:.0f} %)."]
    lines.append(f"Clean logs with an alarm: {sum(bool(x) for _, x in clean)} of {len(clean)}.")
    return "\n".join(lines)


def bases_of(options: Options) -> Iterator[Base]:
    """Simulated arms, and recordings of real ones."""
    joints = 6 if options.permutations else None
    for seed in range(1000 * options.seed, 1000 * options.seed + options.logs):
        log, robot = simulated(seed, joints)
        if options.permutations:
            log, robot = renamed(log, robot, np.random.default_rng([seed, 8]))
        yield f"arm {seed}", log, robot
    for file, recordings in {} if options.permutations else REAL.items():
        path = Path(options.data) / file
        for recording in recordings if path.is_file() else ():
            log = read_log(path, [recording])
            yield f"{file} {recording}", log, load_urdf(log.urdf, joints=list(log.joints))


def put_in(options: Options, names: Sequence[str], bases: Sequence[Base], before: Sequence[set]) -> Iterator[Counted]:
    """What the options ask to put into the bases."""
    if options.permutations:
        for k, base in enumerate(bases):
            yield from permuted(1000 * options.seed + k, *base)
    draw = np.random.default_rng([options.seed, 9])
    for k in range(options.pairs):
        base = bases[k % len(bases)]
        pair = draw_pair(draw, names, base[1])
        one = count(1000 * options.seed + k, *base, before[k % len(bases)], pair)
        yield from [one] if one else []
    if options.permutations or options.pairs:
        return
    for k, base in enumerate(bases):
        for defect in names:
            one = count(1000 * options.seed + k, *base, before[k], [defect])
            yield from [one] if one else []


def main(argv: Sequence[str]) -> int:
    """Run as the docstring says."""
    options = options_of(argv, Options(), __doc__)
    names = only_of("only", options.only, DEFECTS)
    folder, counted = Path(options.folder), []
    folder.mkdir(parents=True, exist_ok=True)
    bases = list(bases_of(options))
    before = [alarms(doctor.examine(log, robot)) for _, log, robot in bases]
    clean = [(name, seen) for (name, *_), seen in zip(bases, before, strict=True) if name.startswith("arm")]
    for (name, *_), seen in zip(bases, before, strict=True):
        print(f"{name}, nothing put in: {sorted(map(str, seen)) or 'no alarm'}", flush=True)
    for one in put_in(options, names, bases, before):
        counted.append(one)
        how = "right" if one.right else "found" if one.found else "MISSED"
        false = f"; false: {', '.join(one.false)}" if one.false else ""
        print(f"{how}: {one.defect} in {one.log} ({one.seconds:.1f} s){false}", flush=True)
    for k in range(options.clean):
        log, robot = simulated(1000 * options.seed + 500 + k)
        clean.append((f"clean {k}", alarms(doctor.examine(log, robot))))
        if clean[-1][1]:
            print(f"clean {k}: {sorted(map(str, clean[-1][1]))}", flush=True)
    tell(folder, "defects", f"seed {options.seed}", table(counted, clean), counted)
    return 0


if __name__ == "__main__":
    from invdyn_cli.verbs.screen import use_compilation_cache

    use_compilation_cache()
    sys.exit(main(sys.argv[1:]))
