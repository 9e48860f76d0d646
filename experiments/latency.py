"""The time of a tick: filter, predict, learn and feedforward, called from Python at 1 kHz (latency.md)."""

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import jax
import numpy as np
from matplotlib.figure import Figure

from invdyn_cli.abstract_experiment import AbstractExperiment
from invdyn_cli.adaptation.error_model import ErrorModel
from invdyn_cli.adaptation.incremental import Incremental
from invdyn_cli.adaptation.payload import Payload
from invdyn_cli.data.pick_place import PickPlace
from invdyn_cli.interfaces import AbstractAdapter, AbstractModel
from invdyn_cli.log import RawTrajectory
from invdyn_cli.models.ffnn import Ffnn
from invdyn_cli.models.pest import Pest
from invdyn_cli.online import online
from invdyn_cli.report.canvas import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, house_style
from invdyn_cli.robots import load_urdf
from invdyn_cli.types import Dataset, Motion

WARM = 200
"""Ticks before the first that counts."""

EVERY = Incremental(rate=1, batch_size=1, epochs=1)
DEEP, SHALLOW = Ffnn((100, 100, 10), joints=(), epochs=1), Ffnn(epochs=1)
CASES: Mapping[str, tuple[AbstractAdapter, AbstractModel, str]] = {
    "nets of Table I, every sample learned": (EVERY, SHALLOW, BLUE),
    "nets of V-C, every sample learned": (EVERY, DEEP, GREEN),
    "nets of V-C, 100 samples every 100": (Incremental(), DEEP, GREY),
    "PEST and error model, every sample learned": (ErrorModel(SHALLOW, incremental=EVERY), Pest(), PURPLE),
    "payload": (Payload(), Pest(friction="stribeck", rest_speed=0.003, least_speed=0.05), ORANGE),
}


@dataclass(frozen=True)
class Timed:
    """A way to adapt, and the time of each tick [ms]."""

    name: str
    ticks: tuple[float, ...]


@dataclass(frozen=True)
class Latency(AbstractExperiment):
    """Times of the ticks of a loaded repetition of data=pick_place."""

    row: ClassVar[type] = Timed

    seconds: float = 20.0

    def plan(self, rows: Sequence[Timed]) -> Iterable[tuple]:
        """A job per way to adapt."""
        return [(name, self.seconds) for name in CASES]

    def run(self, folder: Path, name: str, seconds: float) -> Iterable[Timed]:
        """Fit the model, and play the repetition as fast as it goes."""
        jax.config.update("jax_enable_x64", True)
        robot, source = load_urdf("apollo_arm"), PickPlace(causal=True)
        train = source.load(robot).train
        learned = replace(train, trajectories=train.trajectories[:2])
        raw = next(x for x in source.log(robot).trajectories if x.name == "loaded_1")
        adapter, model, _ = CASES[name]
        times = ticks(adapter, adapter.extended(model), learned, raw, round(1000 * seconds))
        yield Timed(name, tuple((1e3 * times).tolist()))

    def line(self, row: Timed) -> str:
        """The median."""
        return f"{row.name}: median {np.median(row.ticks):.3f} ms"

    def table(self, rows: Sequence[Timed]) -> str:
        """Percentiles of each way, as Markdown."""
        lines = ["| [ms] | median | 99 % | 99.9 % | worst |", "|---|" + "---:|" * 4]
        for row in rows:
            numbers = np.percentile(row.ticks, [50, 99, 99.9, 100])
            lines.append(f"| {row.name} | {' | '.join(f'{x:.3f}' for x in numbers)} |")
        return "\n".join(lines)

    def figures(self, rows: Sequence[Timed]) -> Mapping[str, Figure]:
        """Histograms of the times."""
        return {"latency": draw({row.name: np.array(row.ticks) for row in rows})}


def ticks(
    adapter: AbstractAdapter, model: AbstractModel, learned: Dataset, raw: RawTrajectory, count: int
) -> np.ndarray:
    """Seconds (count,) of each tick."""
    loop = online(adapter, model, adapter.fit(model, learned, jax.random.key(0)))
    state, times = loop.init(raw.q[0], raw.tau[0]), np.empty(count)
    still = np.zeros(raw.q.shape[1])
    for k in range(-WARM, count):
        row = 1 + (k + WARM) % (len(raw.t) - 1)
        started = time.perf_counter()
        state, torque = loop.step(state, raw.q[row], raw.tau[row - 1], Motion(raw.q[row], still, still))
        np.asarray(torque)
        if k >= 0:
            times[k] = time.perf_counter() - started
    return times


def draw(took: Mapping[str, np.ndarray]) -> Figure:
    """Shares of ticks that take longer than a time: tails are what a loop stumbles over."""
    with house_style():
        figure = Figure(figsize=(8, 4.2), layout="constrained")
        axes = figure.add_subplot()
        axes.set_title("A tick: filter, predict, learn, feedforward of seven joints", loc="left", fontweight="bold")
        edges = np.geomspace(0.08, 12, 90)
        for name, times in took.items():
            axes.hist(times, edges, histtype="step", color=CASES[name][2], lw=1.6, label=name)
        axes.axvline(1.0, color=BLACK, lw=1.0, ls="--")
        axes.annotate("1 ms", (1.0, 1), xycoords=("data", "axes fraction"), xytext=(4, -11), textcoords="offset points")
        axes.set(xscale="log", yscale="log", xlabel="time of a tick [ms]", ylabel="ticks")
        axes.set_xticks([0.1, 0.2, 0.5, 1, 2, 5, 10], ["0.1", "0.2", "0.5", "1", "2", "5", "10"])
        figure.legend(loc="outside lower center", ncols=2)
    return figure
