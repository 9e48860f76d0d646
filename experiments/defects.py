"""What invdyn check finds of defects that were put into sound logs of simulated and of real arms (defects.md)."""

import itertools
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from experiments.cases import draw_scene, scene_of
from experiments.spoiled import DEFECTS, arranged
from experiments.worn import wear
from invdyn_cli.abstract_experiment import AbstractExperiment, chosen
from invdyn_cli.diagnosis import doctor
from invdyn_cli.errors import UsageError
from invdyn_cli.log import Log
from invdyn_cli.logfile import read_log
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
SIX = "six joints"
"""Where a log is from that has six joints, so that they can be exchanged."""
Base = tuple[str, Log, Robot]
"""Name, log and robot of what defects are put into."""

OF_TORQUE = (
    "units_torque", "unit_of_one_torque", "sign_all", "sign_torque", "sign_position", "sign_axis", "order_torque",
    "order_all", "order_reversed", "time_offset", "gravity_removed", "saturation", "power_off",
)  # fmt: skip
"""Defects that a log shows by the torque of its drives."""

HIDES = {"model_mismatch": OF_TORQUE, "derivative": ("units_qd",)}
"""What cannot be found beside a defect: in white noise in place of the torque nothing, nor does noise stay at a limit;
of velocities that belong to other joints not their unit."""

SEQUENCE = ("power_off", "gravity_removed", "model_mismatch", "time_offset", "saturation", "units_torque",
            "unit_of_one_torque", "sign_all", "sign_torque", "sign_position", "sign_axis", "order_torque", "order_all",
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


@cache
def base_of(source: str, item: int | str) -> Base:
    """What defects are put into: an "arm" or one of "six joints" by its seed, or a recording of the log at a path."""
    if isinstance(item, int):
        log, robot = simulated(item, 6 if source == SIX else None)
        if source == SIX:
            log, robot = renamed(log, robot, np.random.default_rng([item, 8]))
        return f"arm {item}", log, robot
    log = read_log(Path(source), [item])
    return f"{Path(source).name} {item}", log, load_urdf(log.urdf, joints=list(log.joints))


@cache
def before(source: str, item: int | str) -> set:
    """The alarms of a log without a defect."""
    _, log, robot = base_of(source, item)
    return alarms(doctor.examine(log, robot))


def pair_of(seed: int, k: int, names: Sequence[str], bases: Sequence[tuple]) -> tuple[str, ...]:
    """The k-th pair of defects that a seed draws for these logs."""
    draw = np.random.default_rng([seed, 9])
    return [draw_pair(draw, names, base_of(*bases[j % len(bases)])[1]) for j in range(k + 1)][-1]


@dataclass(frozen=True)
class Defects(AbstractExperiment):
    """Single defects in every log; pairs or exchanges of joints in their place."""

    row: ClassVar[type] = Counted

    seed: int = 0
    logs: int = 6
    clean: int = 20
    pairs: int = 0
    permutations: bool = False
    only: Sequence[str] = ()
    data: str = "../shared/data"

    def plan(self, rows: Sequence[Counted]) -> Iterable[tuple]:
        """Every log as it is, then what is put in: kind, seed, what, log."""
        names, first = chosen("only", self.only, DEFECTS), 1000 * self.seed
        bases = [(SIX if self.permutations else "arm", first + k) for k in range(self.logs)]
        if not self.permutations:
            paths = ((Path(self.data) / file, recordings) for file, recordings in REAL.items())
            bases += [(str(path), one) for path, recordings in paths if path.is_file() for one in recordings]
        yield from (("nothing", 0, "", *base) for base in bases)
        if self.permutations:
            yield from (("permutations", first + k, "", *base) for k, base in enumerate(bases))
        for k in range(self.pairs if bases else 0):
            yield "pair", first + k, (self.seed, k, names, bases), *bases[k % len(bases)]
        if not self.permutations and not self.pairs:
            yield from (("one", first + k, name, *base) for k, base in enumerate(bases) for name in names)
        yield from (("nothing", 0, "", "arm", first + 500 + k) for k in range(self.clean))

    def run(self, folder: Path, kind: str, seed: int, what: Any, *base: Any) -> Iterable[Counted]:
        """What the doctor says of one log with this in it; nothing where the log cannot have it."""
        if kind == "nothing":
            false = tuple(sorted(" ".join(map(str, x)) for x in before(*base)))
            yield Counted(seed, base_of(*base)[0], "", False, False, false, (), 0.0)
        elif kind == "permutations":
            yield from permuted(seed, *base_of(*base))
        else:
            one = count(seed, *base_of(*base), before(*base), pair_of(*what) if kind == "pair" else [what])
            yield from [one] if one else []

    def line(self, row: Counted) -> str:
        """How a defect was found, and false alarms."""
        if not row.defect:
            return f"{row.log}, nothing put in: {', '.join(row.false) or 'no alarm'}"
        how = "right" if row.right else "found" if row.found else "MISSED"
        false = f"; false: {', '.join(row.false)}" if row.false else ""
        return f"{how}: {row.defect} in {row.log} ({row.seconds:.1f} s){false}"

    def table(self, rows: Sequence[Counted]) -> str:
        """A row per defect, as Markdown, and what clean logs raised."""
        counted = [c for c in rows if c.defect]
        clean = [c for c in rows if not c.defect and c.log.startswith("arm")]
        lines = ["| defect | logs | found | right | with a false alarm |", "|---|" + "---:|" * 4]
        for name in dict.fromkeys(c.defect for c in counted):
            own = [c for c in counted if c.defect == name]
            numbers = (len(own), sum(c.found for c in own), sum(c.right for c in own), sum(bool(c.false) for c in own))
            lines.append(f"| {name} | {' | '.join(map(str, numbers))} |")
        total, right = len(counted), sum(c.right for c in counted)
        share = 100 * right / max(total, 1)
        lines += ["", f"Right: {right} of {total} ({share:.0f} %)."]
        lines.append(f"Clean logs with an alarm: {sum(bool(c.false) for c in clean)} of {len(clean)}.")
        return "\n".join(lines)
