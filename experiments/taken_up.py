"""A load that is picked up and released in a pick-and-place log, with friction in every joint (taken_up.md)."""

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from experiments.confusion import claims
from invdyn_cli.abstract_experiment import AbstractExperiment
from invdyn_cli.diagnosis import diagnose
from invdyn_cli.log import Log
from invdyn_cli.robots import load_urdf
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.simulation.plant import record
from invdyn_cli.simulation.references import PickPlace
from invdyn_cli.simulation.sensors import Noise
from invdyn_cli.types import Diagnosis, Robot

MASS = 0.851
SECONDS = 40.0
COULOMB = np.array([3.0, 3.0, 1.5, 1.5, 0.5, 0.4, 0.2])
VISCOUS = np.array([3.0, 3.0, 1.5, 1.5, 0.4, 0.3, 0.15])
ROTORS = {4: 0.08, 5: 0.08, 6: 0.04}
"""[N m], [N m s/rad], [kg m^2]: friction of an arm of this class; a wrist as light as its links is no real one."""

TORQUE_NOISE = np.array([0.1, 0.1, 0.05, 0.05, 0.02, 0.02, 0.01])
POSITION_NOISE = 5e-6


@dataclass(frozen=True)
class Found:
    """One log: relative error of the mass, errors of the window's edges [s], frictions named of all, claims that are
    neither, and how long it took [s]; no load found: None."""

    seed: int
    status: str | None
    mass_error: float | None
    edge_errors: tuple[float, ...]
    frictions: str
    beside: tuple[str, ...]
    seconds: float


def drawn(seed: int) -> tuple[Robot, Log, tuple[Hidden, ...]]:
    """The arm, its log, and what is hidden in it."""
    draw, robot = np.random.default_rng([17, seed]), load_urdf("apollo_arm")
    start = float(draw.uniform(4, 20))
    window = [start, float(start + draw.uniform(6, 14))]
    com = [float(x) for x in draw.uniform([-0.03, -0.03, 0.05], [0.03, 0.03, 0.12])]
    size = draw.uniform(0.7, 1.3, (2, robot.dofs))
    hidden = (
        Hidden("payload_change", None, {"mass": MASS, "com": com, "window": window}),
        *_everywhere(robot, "coulomb_friction", "coulomb", COULOMB * size[0]),
        *_everywhere(robot, "viscous_friction", "damping", VISCOUS * size[1]),
        *(Hidden("rotor_inertia", robot.joints[j], {"armature": x}) for j, x in ROTORS.items()),
    )
    noise = Noise(position=POSITION_NOISE, torque=tuple(TORQUE_NOISE))
    log = record(robot, [PickPlace()], hidden, noise=noise, duration=SECONDS, seed=seed, position_side="motor")
    return robot, log, hidden


def _everywhere(robot: Robot, effect: str, parameter: str, sizes: np.ndarray) -> list[Hidden]:
    return [Hidden(effect, j, {parameter: float(x)}) for j, x in zip(robot.joints, sizes, strict=True)]


def judged(seed: int, hidden: Sequence[Hidden], diagnosis: Diagnosis, seconds: float) -> Found:
    """What a diagnosis found of it."""
    found = claims(diagnosis)
    load = next((f for f in found if f.effect == "payload_change"), None)
    true = hidden[0].parameters
    frictions = {(h.effect, h.joint) for h in hidden[1:]}
    right = {(f.effect, f.joint) for f in found if f.status == "named"} & frictions
    names = [(f.effect, f.joint) for f in found if f is not load]
    errors = () if load is None or load.window is None else np.subtract(load.window, true["window"])
    mass = None if load is None else float(load.parameters["mass"].value / true["mass"] - 1)
    return Found(
        seed=seed,
        status=None if load is None else load.status,
        mass_error=mass,
        edge_errors=tuple(float(x) for x in errors),
        frictions=f"{sum('friction' in e for e, _ in right)} of {sum('friction' in e for e, _ in frictions)}",
        beside=tuple(f"{effect}@{joint}" for effect, joint in names if (effect, joint) not in frictions),
        seconds=seconds,
    )


@dataclass(frozen=True)
class TakenUp(AbstractExperiment):
    """Errors of the load's mass and time, and how many of the frictions are named."""

    row: ClassVar[type] = Found

    seed: int = 0
    logs: int = 5

    def plan(self, rows: Sequence[Found]) -> Iterable[tuple]:
        """A job per log: its seed."""
        return [(1000 * self.seed + k,) for k in range(self.logs)]

    def run(self, folder: Path, seed: int) -> Iterable[Found]:
        """Draw, diagnose, judge one log."""
        robot, log, hidden = drawn(seed)
        started = time.perf_counter()
        yield judged(seed, hidden, diagnose(log, robot), time.perf_counter() - started)

    def table(self, rows: Sequence[Found]) -> str:
        """A row per log, as Markdown."""
        lines = [
            "| log | load | mass off by | window off by [ms] | frictions named | beside | s |",
            "|---|---|---:|---:|---|---|---:|",
        ]
        for f in rows:
            mass = "-" if f.mass_error is None else f"{100 * f.mass_error:+.2f} %"
            edges = ", ".join(f"{1e3 * x:+.0f}" for x in f.edge_errors)
            row = [
                str(f.seed),
                f.status or "not found",
                mass,
                edges,
                f.frictions,
                ", ".join(f.beside) or "-",
                f"{f.seconds:.0f}",
            ]
            lines.append(f"| {' | '.join(row)} |")
        return "\n".join(lines)
