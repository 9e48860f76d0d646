"""Does one designed trajectory resolve an ambiguous diagnosis? (excite.md)"""

import time
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from experiments.cases import SIZES, Case, draw_effect, draw_scene, inverse_dynamics
from experiments.confusion import claims, judge, matches, name_of
from invdyn_cli.abstract_experiment import AbstractExperiment, chosen
from invdyn_cli.design.next_motion import FILE, after
from invdyn_cli.design.trajectory import Design
from invdyn_cli.diagnosis import diagnose
from invdyn_cli.errors import UsageError
from invdyn_cli.log import Log
from invdyn_cli.simulation import plant
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.simulation.played import Played, write_csv
from invdyn_cli.simulation.references import AbstractReference, Multisine
from invdyn_cli.simulation.sensors import Noise
from invdyn_cli.types import Diagnosis, Finding, Robot

SECONDS = 15.0
"""[s] of the poor log."""

OFTEN = (
    "actuator_lag",
    "viscous_friction",
    "link_inertia_error",
    "torque_delay",
    "quadratic_friction",
    "presliding_hysteresis",
    "backlash",
    "joint_elasticity",
    "stribeck_friction",
    "rotor_inertia",
)
"""Effects that a poor motion leaves open now and then, or that look much alike where a joint hardly moves."""

MOST_DRAWS = 60
"""Logs that are drawn for every case that is asked for, before the experiment gives up."""


@dataclass(frozen=True)
class Plant:
    """An arm with something hidden in it, its noise, and the poor motion that it is first asked for."""

    robot: Robot
    hidden: tuple[Hidden, ...]
    noise: Noise
    poor: AbstractReference
    seed: int

    def play(self, reference: AbstractReference, duration: float, seed: int) -> Log:
        """The log of a reference."""
        how = {"noise": self.noise, "duration": duration, "seed": seed, "position_side": "motor"}
        return plant.record(self.robot, [reference], self.hidden, **how)


def draw_plant(seed: int, name: str) -> Plant:
    """An effect of the size that an ordinary motion calls for, on an arm that then moves slowly and little."""
    draw = np.random.default_rng([seed, zlib.crc32(name.encode()), 77])
    scene = draw_scene(draw)
    hidden = (draw_effect(draw, scene, name),)
    poor = Multisine(speed=float(draw.uniform(0.03, 0.12)), amplitude=float(draw.uniform(0.05, 0.25)))
    motion = poor.motion(scene.robot, SECONDS, 100.0, scene.seed)
    torque = inverse_dynamics(scene.robot, *(np.asarray(x) for x in (motion.q, motion.qd, motion.qdd)))
    rms = np.sqrt(np.mean(torque**2, axis=0))
    level = np.maximum(rms, 0.02 * rms.max()) * np.exp(draw.uniform(np.log(0.003), np.log(0.03)))
    noise = Noise(position=float(np.exp(draw.uniform(np.log(1e-6), np.log(1.5e-5)))), torque=tuple(level))
    return Plant(scene.robot, hidden, noise, poor, scene.seed)


@dataclass(frozen=True)
class Settled:
    """One log: what was hidden, said of the poor log, predicted, said of the designed one; a `result` of "named" is
    right, "no motion" is an ambiguous log that no motion resolves, "" is a log that is no case."""

    seed: int
    hidden: str
    poor: tuple[str, ...] = ()
    distance: float = 0.0
    designed: tuple[str, ...] = ()
    result: str = ""
    seconds: float = 0.0

    @property
    def is_case(self) -> bool:
        """Whether a trajectory was designed for it."""
        return self.result not in ("", "no motion")


def open_finding(hidden: Hidden, diagnosis: Diagnosis) -> int | None:
    """Number of the ambiguous finding that has the hidden effect among its names."""
    for number, finding in enumerate(diagnosis.findings):
        if finding.status == "ambiguous" and matches(hidden, finding) == "ambiguous":
            return number
    return None


def least_distance(hidden: Hidden, finding: Finding) -> float | None:
    """The smallest predicted distance, in standard errors, of the hidden effect from a rival; None where no motion
    tells it from one of them, or no rival is in the catalogue."""
    own = [x for x in finding.evidence.get("distances", ()) if hidden.effect in x["true"].split(" + ")]
    own += [
        x
        for x in finding.evidence.get("distances", ())
        if hidden.effect in x["rival"].split(" + ") and not own  # a special case of its rivals
    ]
    if not own or not all(x["possible"] for x in own):
        return None
    return min(x["standard_errors"] for x in own)


def said(diagnosis: Diagnosis) -> tuple[str, ...]:
    """The claims of a diagnosis in short."""
    return tuple(
        f.effect + "".join("|" + "+".join(a) for a in f.alternatives) + f"@{f.joint}" for f in claims(diagnosis)
    )


def play_designed(arm: Plant, design: Design, folder: Path, seed: int) -> Log:
    """The log of a design, by way of its file."""
    path = folder / f"{seed}_{arm.hidden[0].effect}_{FILE}"
    write_csv(path, design.t, np.asarray(design.motion.q), arm.robot.joints)
    return arm.play(Played(str(path)), float(design.t[-1]), arm.seed + 1)


def settle(seed: int, name: str, duration: float, folder: Path) -> Settled:
    """One drawn log: how it ends."""
    arm = draw_plant(seed, name)
    hidden = name_of(arm.hidden[0])
    started = time.perf_counter()
    try:
        poor = diagnose(arm.play(arm.poor, SECONDS, arm.seed), arm.robot)
    except UsageError:  # out of control
        return Settled(seed, hidden)
    place = open_finding(arm.hidden[0], poor)
    if place is None:
        return Settled(seed, hidden, said(poor))
    advised, design = after(poor, arm.robot, duration=duration)
    distance = least_distance(arm.hidden[0], advised.findings[place])
    if design is None or distance is None:
        return Settled(seed, hidden, said(poor), result="no motion")
    try:
        log = play_designed(arm, design, folder, seed)
    except UsageError as error:
        return Settled(seed, hidden, said(poor), distance, (str(error),), "out of control")
    fresh = diagnose(log, arm.robot)
    outcome = judge(Case(arm.robot, log, arm.hidden, 0.0, ""), fresh, seed, 0.0)
    seconds = time.perf_counter() - started
    return Settled(seed, hidden, said(poor), distance, said(fresh), outcome.result, seconds)


def _escaped(text: str) -> str:
    return text.replace("|", " or ")


@dataclass(frozen=True)
class Excite(AbstractExperiment):
    """Ambiguous logs of slow motions, the trajectory that is designed for each, and what its log says."""

    row: ClassVar[type] = Settled

    seed: int = 1000
    cases: int = 10
    duration: float = 30.0
    most: int = 2
    only: Sequence[str] = OFTEN

    def plan(self, rows: Sequence[Settled]) -> Iterable[tuple]:
        """A job per log: seed, effect, duration; effects in turn, until there are enough cases."""
        only = chosen("only", self.only, SIZES)
        for k in range(MOST_DRAWS * self.cases):
            if sum(x.is_case for x in rows) >= self.cases:
                return
            name = only[k % len(only)]
            if sum(x.is_case and x.hidden.startswith(name + "@") for x in rows) < self.most:
                yield self.seed + k // len(only), name, self.duration

    def run(self, folder: Path, seed: int, name: str, duration: float) -> Iterable[Settled]:
        """Draw one log and, if it is a case, design, play, diagnose."""
        yield settle(seed, name, duration, folder)

    def line(self, row: Settled) -> str:
        """How a log ended."""
        return f"{row.result or 'no case'}: {row.seed} {row.hidden} {row.poor} -> {row.designed}"

    def table(self, rows: Sequence[Settled]) -> str:
        """A row for every case, and the count, as Markdown."""
        lines = ["| hidden | seed | poor log | predicted distance | designed log | |", "|---|---:|---|---:|---|---|"]
        settled = [x for x in rows if x.is_case]
        for x in settled:
            what = " · ".join(x.poor), " · ".join(x.designed) or "nothing"
            cells = (_escaped(what[0]), f"{x.distance:.0f}", _escaped(what[1]), x.result)
            lines.append(f"| {x.hidden} | {x.seed} | " + " | ".join(cells) + " |")
        right = sum(x.result == "named" for x in settled)
        lines += [
            "",
            f"- {right} of {len(settled)} ambiguous cases are named rightly from one designed recording alone.",
        ]
        left_out = sum(x.result == "no motion" for x in rows)
        lines.append(
            f"- {len(rows)} logs were drawn for them; {left_out} more were ambiguous between names that no motion "
            "tells apart."
        )
        return "\n".join(lines)
