"""How long a diagnosis takes, and how much memory, beside a line of least squares (diagnosis_time.md)."""

import json
import os
import statistics
import subprocess
import sys
import sysconfig
import tempfile
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np

from experiments.cases import scene_of
from experiments.worn import STANDARD, sized, substeps_for, wear
from invdyn_cli.abstract_experiment import AbstractExperiment, chosen
from invdyn_cli.errors import UsageError, shortened
from invdyn_cli.fields import counts
from invdyn_cli.files import write_file
from invdyn_cli.log import Log
from invdyn_cli.logfile import write_log
from invdyn_cli.report.wording import CLAIMS
from invdyn_cli.robots import load_urdf
from invdyn_cli.simulation import plant
from invdyn_cli.simulation.control import Control
from invdyn_cli.simulation.references import AbstractReference, ConstantSpeed, Multisine, PickPlace
from invdyn_cli.simulation.sensors import Noise

ROOT = Path(__file__).parent.parent
INVDYN = str(Path(sysconfig.get_path("scripts")) / "invdyn")

RATE = 1000.0
"""[Hz] of every log."""

HISS, BITS = 0.005, 18
"""Noise of a torque sensor as a share of its joint's torque, and what the encoders resolve."""


class Case(NamedTuple):
    """A log to be timed: its motion, its length [s], and what is hidden beside wear, or nothing."""

    reference: AbstractReference
    duration: float
    anomaly: str = ""


CASES: Mapping[str, Case] = {
    "worn": Case(Multisine(speed=0.45, amplitude=0.65), 60.0),
    "play": Case(Multisine(speed=0.45, amplitude=0.65), 60.0, "backlash"),
    "sweeps": Case(ConstantSpeed(speed=0.45), 440.0, "joint_spring"),
    "hour": Case(PickPlace(speed=0.45, amplitude=0.65), 3600.0, "payload"),
}


@dataclass(frozen=True)
class Timed:
    """A log with the seconds and the largest memory [GiB] of both commands in each repetition."""

    case: str
    duration: float
    named: tuple[str, ...]
    seconds: tuple[float, ...]
    memory: tuple[float, ...]
    by_hand: tuple[float, ...]


@dataclass(frozen=True)
class DiagnosisTime(AbstractExperiment):
    """`invdyn diagnose` as a process of its own on logs of the built-in arm, worn, with and without an anomaly."""

    row: ClassVar[type] = Timed
    page: ClassVar[str] = "experiments/diagnosis_time.md"

    only: Sequence[str] = ()
    seed: int = 0
    repetitions: int = 3

    def plan(self, rows: Sequence[Timed]) -> Iterable[tuple]:
        """A job per log; long logs are timed once."""
        counts(self, "", "repetitions")
        for name in chosen("only", self.only, CASES):
            yield name, self.seed, self.repetitions if CASES[name].duration < 100 else 1

    def run(self, folder: Path, name: str, seed: int, repetitions: int) -> Iterable[Timed]:
        """Record the log, then time both commands in turns; a first time, which compiles, is not counted."""
        place = folder.resolve() / "logs" / name
        urdf, log, into = place / "robot.urdf", place / "log.h5", place / "diagnosis"
        write_file(urdf, load_urdf("apollo_arm").urdf)
        write_log(recorded(CASES[name], seed, str(urdf)), log)
        ours = [INVDYN, "diagnose", "robot=from_log", f"data.path={log}", f"hydra.run.dir={into}"]
        by_hand = [sys.executable, "-m", "experiments.causes_tools", "least_squares"]
        by_hand += [str(x) for x in (log, urdf, place / "answer.json")]
        timed(ours)
        both = [(timed(ours), timed(by_hand)) for _ in range(repetitions)]
        found = json.loads((into / "diagnosis.json").read_text())["findings"]
        named = tuple(
            f"{x['effect']}@{x['joint']}" for x in found if x["status"] in CLAIMS and x["effect"] not in STANDARD
        )
        (seconds, memory), (by_hand_seconds, _) = (tuple(zip(*x, strict=True)) for x in zip(*both, strict=True))
        yield Timed(name, CASES[name].duration, named, seconds, memory, by_hand_seconds)

    def line(self, row: Timed) -> str:
        """The medians, and what was named."""
        took, line = statistics.median(row.seconds), statistics.median(row.by_hand)
        return f"{row.case}: {took:.1f} s, {max(row.memory):.1f} GiB; least squares {line:.1f} s; named: {row.named}"

    def table(self, rows: Sequence[Timed]) -> str:
        """A log each row, as Markdown."""
        lines = ["| log | diagnosis [s] | memory [GiB] | least squares [s] | ratio |", "|---|" + "---:|" * 4]
        for row in rows:
            took, line = statistics.median(row.seconds), statistics.median(row.by_hand)
            cells = f"{took:.1f}", f"{max(row.memory):.1f}", f"{line:.1f}", f"{took / line:.1f}"
            lines.append(f"| {row.case}, {row.duration:.0f} s | {' | '.join(cells)} |")
        return "\n".join(lines)


def recorded(case: Case, seed: int, urdf: str) -> Log:
    """What a simulated worn arm records."""
    draw, robot = np.random.default_rng([seed, 12]), load_urdf("apollo_arm")
    scene = scene_of(robot, case.reference, case.duration, seed)
    anomalies = [sized(draw, scene, case.anomaly)] if case.anomaly else []
    noise = Noise(position=1e-6, position_quantum=2 * np.pi / 2**BITS, torque=tuple(HISS * scene.torque))
    return plant.record(
        robot,
        [scene.reference],
        [*wear(draw, scene), *anomalies],
        duration=case.duration,
        rate=RATE,
        substeps=max([substeps_for(x, RATE) for x in anomalies], default=4),
        noise=noise,
        control=Control(frequency=2.5, damping_ratio=0.9, velocity_cutoff=30.0, knows="arm"),
        position_side="motor",
        urdf=urdf,
        seed=seed,
    )


def timed(command: Sequence[str]) -> tuple[float, float]:
    """Seconds and largest memory [GiB] of a command.

    Raises:
        UsageError: with its last line, if it fails.
    """
    with tempfile.TemporaryFile() as said:
        started = time.perf_counter()
        process = subprocess.Popen(command, cwd=ROOT, stdout=said, stderr=subprocess.STDOUT)
        _, status, used = os.wait4(process.pid, 0)
        seconds = time.perf_counter() - started
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            said.seek(0)
            last = said.read().decode(errors="replace").strip().splitlines()[-1:]
            raise UsageError(f"{shortened(' '.join(command), 200)} failed: {shortened(''.join(last), 200)}")
    return seconds, used.ru_maxrss / 2**20
