"""Does one designed trajectory settle an ambiguous diagnosis?

    python experiments/excite.py [seed=1000] [cases=10] [only=effect,effect] [duration=30] [folder=outputs/excite]
"""

import dataclasses
import json
import sys
import time
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from experiments.cases import SIZES, Case, draw_effect, draw_scene, inverse_dynamics
from experiments.confusion import claims, judge, matches
from experiments.options import only_of, options_of
from invdyn_cli.diagnosis import diagnose
from invdyn_cli.simulation import plant
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.simulation.references import AbstractReference, Multisine
from invdyn_cli.simulation.sensors import Noise
from invdyn_cli.types import Diagnosis, Finding, Robot


@dataclass(frozen=True)
class Plant:
    """An arm with something hidden in it, its noise, and the poor motion that it is first asked for."""

    robot: Robot
    hidden: tuple[Hidden, ...]
    noise: Noise
    poor: AbstractReference
    duration: float
    seed: int

    def play(self, reference: AbstractReference, duration: float, seed: int) -> Any:
        """The log of a reference."""
        return plant.record(self.robot, [reference], self.hidden, noise=self.noise, duration=duration, seed=seed)


def draw_plant(seed: int, name: str) -> Plant:
    """An effect of the size that an ordinary motion calls for, on an arm that then moves slowly and little."""
    draw = np.random.default_rng([seed, zlib.crc32(name.encode()), 77])
    scene = draw_scene(draw)
    hidden = (draw_effect(draw, scene, name),)
    poor = Multisine(speed=float(draw.uniform(0.05, 0.15)), amplitude=float(draw.uniform(0.1, 0.3)))
    motion = poor.motion(scene.robot, 20.0, 100.0, scene.seed)
    torque = inverse_dynamics(scene.robot, motion.q, motion.qd, motion.qdd)
    rms = np.sqrt(np.mean(torque**2, axis=0))
    level = np.maximum(rms, 0.02 * rms.max()) * np.exp(draw.uniform(np.log(0.002), np.log(0.02)))
    noise = Noise(position=float(np.exp(draw.uniform(np.log(1e-6), np.log(1.5e-5)))), torque=tuple(level))
    return Plant(scene.robot, hidden, noise, poor, 20.0, scene.seed)
