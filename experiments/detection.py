"""The smallest size of an effect that is found in 9 of 10 logs, over torque noise (detection.md)."""

import math
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from matplotlib.figure import Figure

from experiments.cases import Scene, draw_scene, inverse_dynamics
from experiments.confusion import claims, matches
from experiments.detection_page import figure, table
from invdyn_cli.abstract_experiment import AbstractExperiment, chosen
from invdyn_cli.diagnosis import diagnose
from invdyn_cli.errors import UsageError
from invdyn_cli.simulation import plant
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.simulation.references import Multisine
from invdyn_cli.simulation.sensors import Noise

JOINTS, DURATION = 4, 20.0
ENCODER = 3e-6
"""[rad] RMS noise of the measured angles, about that of 20 bits."""
STEP, LOWEST, HIGHEST = 1.6, 1e-4, 0.4
"""Sizes climb by this factor, within this range of shares."""
ENOUGH = 0.9
"""Share of the logs in which a size must be found."""
COM = (0.03, 0.0, 0.08)
"""[m] where the payload sits in the last joint's frame."""


@dataclass(frozen=True)
class Unit:
    """How a share becomes a size.

    Attributes:
        parameter, unit: what is called the size, and its unit.
        one: the size at which the effect's torque is as large as that of a scene's joint.
        first: share from which the climb begins; what is found there already is sought further down.
        from_one: the parameter is one more than the size: a gain.
        beside: other parameters.
    """

    parameter: str
    unit: str
    one: Callable[[Scene, int], float]
    first: float
    from_one: bool = False
    beside: Mapping[str, Any] = field(default_factory=dict)

    def parameters(self, size: float) -> dict[str, Any]:
        """All parameters of an effect of this size."""
        return {self.parameter: size + self.from_one, **self.beside}


def _mass_per_share(scene: Scene, j: int) -> float:
    """[kg] of a payload whose torque is as large as the torque of the joint that feels it most."""
    motion = scene.reference.motion(scene.robot, scene.duration, 100.0, scene.seed)
    x, y, z = COM
    inertial = scene.robot.inertial.copy()
    inertial[-1] += [1, x, y, z, y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y]
    loaded, bare = (
        inverse_dynamics(robot, motion.q, motion.qd, motion.qdd)
        for robot in (replace(scene.robot, inertial=inertial), scene.robot)
    )
    strong = scene.torque > 0.02 * scene.torque.max()
    return 1 / float(np.max((_rms(loaded - bare) / scene.torque)[strong]))


def _delay_per_share(scene: Scene, j: int) -> float:
    """[s] of a delay whose torque would be as large as the joint's own, if torques changed at one rate."""
    return float(scene.torque[j] / _rms(np.diff(scene.tau[:, j]) * 100.0))


def _rms(x: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(x**2, axis=0))


UNITS: Mapping[str, Unit] = {
    "coulomb_friction": Unit("coulomb", "N m", lambda s, j: s.torque[j], 0.002),
    "viscous_friction": Unit("damping", "N m s/rad", lambda s, j: s.torque[j] / s.speed[j], 0.002),
    "payload": Unit("mass", "kg", _mass_per_share, 0.002, beside={"com": list(COM)}),
    "torque_delay": Unit("delay", "s", _delay_per_share, 0.002),
    "torque_gain_error": Unit("gain", "-", lambda s, j: 1.0, 0.002, from_one=True),
    "torque_offset": Unit("offset", "N m", lambda s, j: s.torque[j], 0.002),
}


@dataclass(frozen=True)
class Limit:
    """The smallest size of an effect that is found in `ENOUGH` of the logs at this torque noise.

    Attributes:
        share: of the joint's RMS torque; None where not even the largest is found.
        size: the same as the median over the logs' arms, in `unit`.
        tried: [share, logs that found it, logs that were asked] of every size, in their order.
    """

    effect: str
    noise: float
    share: float | None
    size: float | None
    unit: str
    tried: tuple[tuple[float, int, int], ...]


@cache
def scene_of(seed: int, log: int) -> tuple[Scene, int]:
    """The arm and motion of a log, and the joint that an effect is hidden on."""
    draw = np.random.default_rng([seed, log, zlib.crc32(b"detection")])
    while True:
        scene = draw_scene(draw, JOINTS)
        if isinstance(scene.reference, Multisine):
            strong = np.flatnonzero(scene.torque > 0.02 * scene.torque.max())
            return replace(scene, duration=DURATION), int(draw.choice(strong))


def is_found(effect: str, share: float, noise: float, seed: int, log: int) -> bool:
    """Whether the diagnosis of one log names the effect, or is rightly unsure of it."""
    scene, j = scene_of(seed, log)
    unit = UNITS[effect]
    joint = None if effect == "payload" else scene.robot.joints[j]
    hidden = Hidden(effect, joint, unit.parameters(share * unit.one(scene, j)))
    torque = noise * np.maximum(scene.torque, 0.02 * scene.torque.max())
    sensors = Noise(position=ENCODER, torque=tuple(torque))
    try:
        played = plant.record(
            scene.robot, [scene.reference], [hidden], noise=sensors, duration=DURATION, seed=scene.seed
        )
    except UsageError:  # an arm that loses control is no log
        return False
    return any(matches(hidden, f) for f in claims(diagnose(played, scene.robot)))


def climb(found: Callable[[float, int], bool], first: float, logs: int) -> tuple[float | None, list]:
    """The smallest share that is found in enough logs, and all that were tried; `found` takes a share and a log."""
    needed = math.ceil(ENOUGH * logs - 1e-9)
    order, tried = list(range(logs)), []

    def enough(share: float) -> bool:
        hits, missed = 0, []
        for log in list(order):
            if found(share, log):
                hits += 1
            else:
                missed.append(log)
                order.remove(log)
                order.insert(0, log)
            if hits >= needed or len(missed) > logs - needed:
                break
        tried.append((share, hits, hits + len(missed)))
        return hits >= needed

    share = first
    if enough(share):
        while share / STEP >= LOWEST and enough(share / STEP):
            share /= STEP
        return share, tried
    while share * STEP <= HIGHEST:
        share *= STEP
        if enough(share):
            return share, tried
    return None, tried


def limits(effect: str, noises: Sequence[float], seed: int, logs: int) -> list[Limit]:
    """The limits of one effect, from the lowest noise up: each climb begins where the one before ended."""
    unit, first, out = UNITS[effect], UNITS[effect].first, []
    for noise in sorted(noises):
        share, tried = climb(lambda s, k, n=noise: is_found(effect, s, n, seed, k), first, logs)
        size = None
        if share is not None:
            first = share
            size = share * float(np.median([unit.one(*scene_of(seed, k)) for k in range(logs)]))
        out.append(Limit(effect, noise, share, size, unit.unit, tuple(tried)))
    return out


@dataclass(frozen=True)
class Detection(AbstractExperiment):
    """The limits of each effect, climbed to from below."""

    row: ClassVar[type] = Limit
    page: ClassVar[str] = "docs/diagnosis.md"

    seed: int = 0
    logs: int = 10
    noises: Sequence[float] = (0.003, 0.01, 0.03)
    effects: Sequence[str] = ()

    def plan(self, rows: Sequence[Limit]) -> Iterable[tuple]:
        """A job per effect: each noise begins where the one before ended."""
        return [(name, self.seed, self.logs, *self.noises) for name in chosen("effects", self.effects, UNITS)]

    def run(self, folder: Path, effect: str, seed: int, logs: int, *noises: float) -> Iterable[Limit]:
        """The limits of one effect."""
        return limits(effect, noises, seed, logs)

    def line(self, row: Limit) -> str:
        """The limit at one noise."""
        size = "nothing found" if row.share is None else f"{100 * row.share:.3g} % of the torque"
        return f"{row.effect}, noise {100 * row.noise:g} %: {size} ({sum(n for *_, n in row.tried)} logs)"

    def table(self, rows: Sequence[Limit]) -> str:
        """A row per effect, a column per noise, and the figure."""
        shown = "![The smallest size that is found, over torque noise, for each effect](detection.png)"
        return f"<!-- seed {self.seed}, {self.logs} logs -->\n{table(rows)}\n\n{shown}"

    def figures(self, rows: Sequence[Limit]) -> Mapping[str, Figure]:
        """Smallest size over noise."""
        return {"detection": figure(rows)}
