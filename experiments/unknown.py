"""Effects that the catalogue lacks: none may be named, and the verdict should say so (unknown.md)."""

import time
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from experiments.cases import Case, Scene, draw_scene, play
from experiments.confusion import LOUD, claims
from invdyn_cli.abstract_experiment import AbstractExperiment, chosen
from invdyn_cli.diagnosis import diagnose
from invdyn_cli.errors import UsageError
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.types import Diagnosis

TOLD = 0.15
"""Share of what is left on a joint above which `unexplained` says that something is unknown there."""

Force = Callable
"""force(t, q, qd) [N m], of a joint's own angle and velocity, or of all joints' (n,)."""


def bump(draw: np.random.Generator, scene: Scene, j: int, torque: float) -> tuple[Force, bool]:
    """A torque at one posture alone: a worn tooth, a cable that catches."""
    middle = float(np.quantile(scene.q[:, j], draw.uniform(0.25, 0.75)))
    height = torque / max(float(np.sqrt(np.mean(_bell(scene.q[:, j] - middle) ** 2))), 0.1)
    return lambda t, q, qd: height * _bell(q - middle), False


def _bell(x):
    return np.exp(-((x / 0.1) ** 2))


def hum(draw: np.random.Generator, scene: Scene, j: int, torque: float) -> tuple[Force, bool]:
    """A torque that swings in time, whatever the arm does: no model of q, qd and qdd can know it."""
    rate, phase = 2 * np.pi * draw.uniform(2, 3), draw.uniform(-np.pi, np.pi)
    return lambda t, q, qd: 1.4 * torque * np.sin(rate * t + phase), False


def neighbour(draw: np.random.Generator, scene: Scene, j: int, torque: float) -> tuple[Force, bool]:
    """A torque on one joint, of no mean, that another joint's angle makes: a hose across both, a coupled gear."""
    n = scene.robot.dofs
    other = int(draw.choice([k for k in range(n) if k != j]))
    middle, phase = scene.q[:, other].mean(), draw.uniform(-np.pi, np.pi)
    wave = np.sin(2 * (scene.q[:, other] - middle) + phase)
    mean, size, own = wave.mean(), torque / wave.std(), np.eye(n)[j]
    return lambda t, q, qd: own * size * (np.sin(2 * (q[other] - middle) + phase) - mean), True


def cogging(draw: np.random.Generator, scene: Scene, j: int, torque: float) -> tuple[Force, bool]:
    """A ripple whose phase is another one in either direction of motion."""
    cycles, phase, turn = draw.uniform(6, 20), draw.uniform(-np.pi, np.pi), draw.uniform(0.4, 0.8) * np.pi
    return lambda t, q, qd: 1.4 * torque * np.sin(cycles * q + phase + turn * np.tanh(qd / 0.02)), False


INVENTIONS: Mapping[str, Callable[[np.random.Generator, Scene, int, float], tuple[Force, bool]]] = {
    "bump": bump,
    "hum": hum,
    "neighbour": neighbour,
    "cogging": cogging,
}


@dataclass(frozen=True)
class Said:
    """What was said of one log: findings as effect@joint by status, the share that is unexplained on its joint, and
    whether the verdict says that something is unknown there."""

    invention: str
    seed: int
    joint: str
    share: float
    named: tuple[str, ...]
    ambiguous: tuple[str, ...]
    unexplained: float
    told: bool
    seconds: float


def draw(invention: str, seed: int) -> tuple[Case, str]:
    """A log with an invention hidden in it, loud enough to count, and the joint that it acts on."""
    for attempt in range(40):
        dice = np.random.default_rng([seed, attempt, zlib.crc32(invention.encode())])
        scene = draw_scene(dice)
        j = int(dice.choice(np.flatnonzero(scene.torque > 0.02 * scene.torque.max())))
        torque = float(np.exp(dice.uniform(np.log(0.04), np.log(0.25)))) * scene.torque[j]
        force, everywhere = INVENTIONS[invention](dice, scene, j, torque)
        joint = scene.robot.joints[j]
        try:
            case = play(dice, scene, [Hidden("custom", None if everywhere else joint, {"force": force})])
        except UsageError:
            continue
        if case.share >= LOUD:
            return case, joint
    raise RuntimeError(f"no loud log from seed {seed} for {invention}")


def judge(invention: str, seed: int, case: Case, joint: str, diagnosis: Diagnosis, seconds: float) -> Said:
    """What a diagnosis says of it."""
    found = {
        status: tuple(f"{f.effect}@{f.joint}" for f in claims(diagnosis) if f.status == status)
        for status in ("named", "ambiguous")
    }
    left = float(diagnosis.unexplained.get(joint, 0.0))
    told = left > TOLD or joint in diagnosis.details["beyond_noise"]
    return Said(invention, seed, joint, case.share, **found, unexplained=left, told=told, seconds=seconds)


@dataclass(frozen=True)
class Unknown(AbstractExperiment):
    """Every invention on arms of its own, with 4 to 25 % of a joint's torque."""

    row: ClassVar[type] = Said

    seed: int = 0
    logs: int = 10
    only: Sequence[str] = ()

    def plan(self, rows: Sequence[Said]) -> Iterable[tuple]:
        """A job per log: its invention and its seed."""
        names = chosen("only", self.only, INVENTIONS)
        return [(name, 1000 * self.seed + k) for k in range(self.logs) for name in names]

    def run(self, folder: Path, name: str, seed: int) -> Iterable[Said]:
        """Draw, diagnose, judge one log."""
        case, joint = draw(name, seed)
        started = time.perf_counter()
        diagnosis = diagnose(case.log, case.robot)
        yield judge(name, seed, case, joint, diagnosis, time.perf_counter() - started)

    def line(self, row: Said) -> str:
        """What was said of a log."""
        told = f"{row.unexplained:.2f} unexplained, {row.share:.0f} times the noise, {row.seconds:.0f} s"
        return f"{row.invention} {row.seed} on {row.joint}: named {row.named}, ambiguous {row.ambiguous}; {told}"

    def table(self, rows: Sequence[Said]) -> str:
        """A row per invention, as Markdown."""
        lines = [
            "| hidden | logs | something named | only ambiguous | no claim | said to be unexplained | named most |"
        ]
        lines.append("|---|" + "---:|" * 5 + "---|")
        for name in dict.fromkeys(x.invention for x in rows):
            own = [x for x in rows if x.invention == name]
            named = sum(bool(x.named) for x in own)
            unsure = sum(bool(x.ambiguous) and not x.named for x in own)
            told = sum(x.told for x in own)
            often = Counter(effect for x in own for effect in {y.split("@")[0] for y in x.named})
            most = ", ".join(f"{effect} {count}" for effect, count in often.most_common(3)) or "-"
            none = len(own) - named - unsure
            lines.append(f"| {name} | {len(own)} | {named} | {unsure} | {none} | {told} | {most} |")
        named, told = sum(bool(x.named) for x in rows), sum(x.told for x in rows)
        lines += ["", f"- Something named in {named} of {len(rows)} logs; said to be unexplained in {told}."]
        return "\n".join(lines)
