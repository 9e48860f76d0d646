"""What the doctor finds of defects that were put into sound logs: of simulated arms, and of real ones.

    python experiments/defects.py [seed=0] [logs=6] [clean=20] [only=units_q,sign_torque] [data=../shared/data]
                                  [folder=outputs/defects]

Every defect of DEFECTS is put, with a size at random, into `logs` simulated arms that are worn (friction everywhere,
links some percent off), and into recordings of real robots where `data` has them. A defect is *found* when its check
says note or more of it, *right* when channel, joint and size are right too, or when the truth is among what is called
ambiguous or skipped by name; *false* is any other warning or failure that the log did not have before. `clean` further
logs have no defect.
"""

import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from experiments.cases import draw_scene, scene_of
from experiments.options import only_of, options_of
from experiments.results import tell
from experiments.worn import wear
from invdyn_cli.diagnosis import doctor
from invdyn_cli.diagnosis.checks.evidence import nominal_torque
from invdyn_cli.errors import UsageError
from invdyn_cli.logfile import Log, RawTrajectory, read_log
from invdyn_cli.robots import load_urdf
from invdyn_cli.simulation import plant
from invdyn_cli.simulation.references import Multisine
from invdyn_cli.simulation.sensors import Noise
from invdyn_cli.types import Check, Examination, Motion, Robot

REAL = {
    "panda.h5": ("exciting_trajectory_1",),
    "ur10e.h5": ("train_20_02_05_20sec_8harm", "train_20_02_12_40sec_12harm"),
    "iiwa14.h5": ("joint_2_to_7_dynamic_motion",),
    "kuka_lwr4.h5": ("run_1", "run_2"),
}
"""Logs and recordings, six in all."""

ALARMS = ("warn", "fail")
Change = Callable[[np.random.Generator, Log, Robot], tuple[Log, Callable[[Check], bool]]]


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


def put(log: Log, change: Callable[[RawTrajectory], dict[str, Any]]) -> Log:
    """The log with channels of every recording changed."""
    return replace(log, trajectories=tuple(replace(raw, **change(raw)) for raw in log.trajectories))


def _scaled(channel: str, factor: float, joint: int | None = None, n: int = 0) -> Callable[[RawTrajectory], dict]:
    by = np.where(np.arange(n) == joint, factor, 1.0) if joint is not None else factor
    return lambda raw: {channel: getattr(raw, channel) * by}


def _about(check: Check, channel: str) -> bool:
    return isinstance(check.threshold, dict) and channel == check.threshold.get("channel")


def unit(channel: str, factors: Sequence[float]) -> Change:
    """A channel of all joints in another unit."""

    def change(draw, log, robot):
        factor = float(draw.choice(factors))
        bad = put(log, lambda raw: {} if getattr(raw, channel) is None else _scaled(channel, factor)(raw))

        def right(check: Check) -> bool:
            return _about(check, channel) and abs((check.threshold["factor"] or 0) / factor - 1) < 1e-3

        return bad, right

    return change


def unit_of_one(draw, log, robot):
    """The torque of one joint in N mm."""
    j = int(draw.integers(robot.dofs))
    bad = put(log, _scaled("tau", 1e3, j, robot.dofs))
    return bad, lambda c: c.joint == log.joints[j] and _about(c, "tau")


def sign(channel: str, every: bool = False) -> Change:
    """The torque, q with qd, or both of one joint turned round; or all torques."""

    def change(draw, log, robot):
        j = int(draw.integers(robot.dofs))
        s = -np.ones(robot.dofs) if every else np.where(np.arange(robot.dofs) == j, -1.0, 1.0)

        def turned(raw: RawTrajectory) -> dict[str, Any]:
            names = [c for c in ("q", "qd", "qdd", "q_ref") if getattr(raw, c) is not None] if "q" in channel else []
            return {c: getattr(raw, c) * s for c in (*names, *(["tau"] if "tau" in channel else []))}

        def right(check: Check) -> bool:
            mine = every or check.joint == log.joints[j]
            unsure = check.severity == "skipped" and log.joints[j] in check.seen
            return unsure or (mine and (_about(check, channel) or check.severity == "warn"))

        return put(log, turned), right

    return change


def order(whole: bool, reverse: bool = False) -> Change:
    """Two joints exchanged, or all columns from the tip to the base."""

    def change(draw, log, robot):
        n = robot.dofs
        columns = np.arange(n)
        a, b = draw.choice(n, 2, replace=False)
        columns[[a, b]] = columns[[b, a]]
        columns = np.arange(n)[::-1] if reverse else columns

        def moved(raw: RawTrajectory) -> dict[str, Any]:
            names = ("q", "qd", "qdd", "q_ref", "tau") if whole else ("tau",)
            return {c: getattr(raw, c)[:, columns] for c in names if getattr(raw, c) is not None}

        truth = {"order": (columns if whole else np.arange(n)).tolist(), "columns": columns.tolist()}

        def right(check: Check) -> bool:
            known = check.threshold or {}
            unjudged = set(check.seen.split(": ")[-1].split(", ")) if check.severity == "skipped" else set()
            unsure = {log.joints[a], log.joints[b]} <= unjudged
            stated = {k: known.get(k) for k in truth} == truth
            return bool(stated or truth in known.get("alike", ()) or (unsure and not reverse))

        return put(log, moved), right

    return change


def time_offset(draw, log, robot):
    """All torques late or early by 15 to 100 ms."""
    late = float(draw.choice([-1, 1]) * draw.uniform(0.015, 0.1))

    def moved(raw: RawTrajectory) -> dict[str, Any]:
        return {"tau": np.stack([np.interp(raw.t - late, raw.t, x) for x in raw.tau.T], axis=1)}

    before = {c.value for c in doctor.examine(log, robot).checks if c.check == "time_offset" and c.severity == "warn"}
    known = next((x for x in before if isinstance(x, float)), 0.0)
    return put(log, moved), lambda c: _about(c, "tau") and abs((c.value or 0) - late - known) < 0.004


def lag_of_command(draw, log, robot):
    """q_ref in radians converted once too often, and some tens of milliseconds to two seconds early."""
    late = float(draw.uniform(0.05, 2.0))

    def moved(raw: RawTrajectory) -> dict[str, Any]:
        return {"q_ref": np.stack([np.interp(raw.t + late, raw.t, x) for x in raw.q.T], axis=1) * np.pi / 180}

    return put(log, moved), lambda c: _about(c, "q_ref") and abs(c.value - np.pi / 180) < 1e-3


def stamps(draw, log, robot):
    """One to four stamps that are anything."""
    rows = draw.choice(len(log.trajectories[0].t), int(draw.integers(1, 5)), replace=False)

    def moved(raw: RawTrajectory) -> dict[str, Any]:
        t = raw.t.copy()
        t[rows] = draw.choice([-1, 1], len(rows)) * 10 ** draw.uniform(2, 200, len(rows))
        return {"t": t}

    one = replace(log, trajectories=log.trajectories[:1])
    return put(one, moved), lambda c: isinstance(c.value, int) and abs(c.value - len(rows)) <= 1


def missing(draw, log, robot):
    """Rows of NaN."""
    share = draw.uniform(0.001, 0.02)

    def moved(raw: RawTrajectory) -> dict[str, Any]:
        tau = raw.tau.copy()
        tau[draw.random(len(tau)) < share] = np.nan
        return {"tau": tau}

    return put(log, moved), lambda c: _about(c, "tau")


def outliers(draw, log, robot):
    """Ten wild samples of one joint's torque."""
    j = int(draw.integers(robot.dofs))

    def moved(raw: RawTrajectory) -> dict[str, Any]:
        tau = raw.tau.copy()
        rows = draw.choice(np.arange(60, len(tau) - 60), 10, replace=False)
        tau[rows, j] += draw.choice([-1, 1], 10) * draw.uniform(2, 6) * np.ptp(tau[:, j])
        return {"tau": tau}

    return put(log, moved), lambda c: c.joint == log.joints[j] and _about(c, "tau")


def saturation(draw, log, robot):
    """One joint's torque ends at a quantile."""
    j, at = int(draw.integers(robot.dofs)), draw.uniform(0.85, 0.97)
    return put(log, lambda raw: {
        "tau": np.where(np.arange(robot.dofs) == j, np.minimum(raw.tau, np.quantile(raw.tau[:, j], at)), raw.tau)
    }), lambda c: c.joint == log.joints[j]  # fmt: skip


def other_velocities(draw, log, robot):
    """Velocities in the order of other joints."""
    return put(log, lambda raw: {} if raw.qd is None else {"qd": raw.qd[:, ::-1].copy()}), lambda c: _about(c, "qd")


def no_gravity(draw, log, robot):
    """Gravity taken out of the torque."""

    def moved(raw: RawTrajectory) -> dict[str, Any]:
        still = np.zeros_like(raw.q, float)
        return {"tau": raw.tau - nominal_torque(robot, Motion(raw.q, still, still))[0] / _gain(log)}

    return put(log, moved), lambda c: True


def noise(draw, log, robot):
    """Noise in place of the torque."""
    bad = put(log, lambda raw: {"tau": draw.normal(size=raw.tau.shape) * raw.tau.std(0)})
    return bad, lambda c: c.severity == "fail"


def _gain(log: Log):
    return 1.0 if log.drive_gain is None else log.drive_gain


DEFECTS: dict[str, tuple[str, Change]] = {
    "units_q": ("unit_error", unit("q", [180 / np.pi])),
    "units_qd": ("unit_error", unit("qd", [180 / np.pi, 30 / np.pi])),
    "units_t": ("unit_error", unit("t", [1e3, 1e6])),
    "units_torque": ("unit_error", unit("tau", [1e3, 1e-3])),
    "unit_of_one_torque": ("unit_error", unit_of_one),
    "q_ref": ("unit_error", lag_of_command),
    "sign_all": ("sign_error", sign("tau", every=True)),
    "sign_torque": ("sign_error", sign("tau")),
    "sign_position": ("sign_error", sign("q")),
    "sign_axis": ("sign_error", sign("q, tau")),
    "order_torque": ("joint_order", order(False)),
    "order_all": ("joint_order", order(True)),
    "order_reversed": ("joint_order", order(True, reverse=True)),
    "time_offset": ("time_offset", time_offset),
    "stamps": ("duplicates", stamps),
    "not_finite": ("not_finite", missing),
    "outliers": ("outliers", outliers),
    "saturation": ("saturation", saturation),
    "derivative": ("derivative_consistency", other_velocities),
    "gravity_removed": ("gravity_removed", no_gravity),
    "model_mismatch": ("model_mismatch", noise),
}


@dataclass(frozen=True)
class Options:
    """What the command line may say."""

    seed: int = 0
    logs: int = 6
    clean: int = 20
    only: Sequence[str] = tuple(DEFECTS)
    data: str = os.environ.get("INVDYN_REAL_DATA", "../shared/data")
    folder: str = "outputs/defects"


def simulated(seed: int) -> tuple[Log, Robot]:
    """A worn arm's log, 200 Hz, that a controller survived."""
    for attempt in range(20):
        draw = np.random.default_rng([seed, attempt, 11])
        scene = draw_scene(draw)
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


def count(seed: int, name: str, log: Log, robot: Robot, before: set, defect: str) -> Counted | None:
    """One defect in one log; None where the log has not what it needs."""
    check, change = DEFECTS[defect]
    if defect in ("units_qd", "derivative") and any(raw.qd is None for raw in log.trajectories):
        return None
    bad, right = change(np.random.default_rng([seed, 7]), log, robot)
    started = time.perf_counter()
    examination = doctor.examine(bad, robot)
    mine = [x for x in examination.checks if x.check == check]
    told = [x for x in mine if x.severity not in ("ok", "skipped")]
    good = [x for x in mine if x.severity != "ok" and _safely(right, x)]
    known = {x[0] for x in before}  # what the log had before may stand in another column now
    others = {x for x in alarms(examination) if x[0] != check and x[0] not in known}
    said = tuple(
        f"{x.severity} {x.check} {x.joint or ''}: {x.seen}" for x in examination.checks if x.severity in ALARMS
    )
    false = tuple(sorted(" ".join(map(str, x)) for x in others))
    return Counted(seed, name, defect, bool(told), bool(good), false, said, time.perf_counter() - started)


def _safely(right: Callable[[Check], bool], check: Check) -> bool:
    try:
        return bool(right(check))
    except (TypeError, KeyError):
        return False


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


def main(argv: Sequence[str]) -> int:
    """Run as the docstring says."""
    options = options_of(argv, Options(), __doc__)
    names = only_of("only", options.only, DEFECTS)
    folder, counted = Path(options.folder), []
    folder.mkdir(parents=True, exist_ok=True)
    bases = [(f"arm {1000 * options.seed + k}", *simulated(1000 * options.seed + k)) for k in range(options.logs)]
    for file, recordings in REAL.items():
        path = Path(options.data) / file
        for recording in recordings if path.is_file() else ():
            log = read_log(path, [recording])
            bases.append((f"{file} {recording}", log, load_urdf(log.urdf, joints=list(log.joints))))
    clean = []
    for k, (name, log, robot) in enumerate(bases):
        before = alarms(doctor.examine(log, robot))
        if name.startswith("arm"):
            clean.append((name, before))
        print(f"{name}, nothing put in: {sorted(map(str, before)) or 'no alarm'}", flush=True)
        for defect in names:
            one = count(1000 * options.seed + k, name, log, robot, before, defect)
            if one is None:
                continue
            counted.append(one)
            how = "right" if one.right else "found" if one.found else "MISSED"
            false = f"; false: {', '.join(one.false)}" if one.false else ""
            print(f"{how}: {defect} in {name} ({one.seconds:.1f} s){false}", flush=True)
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
