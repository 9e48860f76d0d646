"""The time of a tick at 1 kHz (filter, predict, learn, feedforward) against what the learning is worth (latency.md)."""

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import jax
import numpy as np
import scipy
from matplotlib.figure import Figure

from invdyn_cli.abstract_experiment import AbstractExperiment
from invdyn_cli.adaptation.batch import Batch
from invdyn_cli.adaptation.error_model import ErrorModel
from invdyn_cli.adaptation.incremental import Incremental
from invdyn_cli.adaptation.local_error_model import LocalErrorModel
from invdyn_cli.adaptation.memory_learning_rate import MemoryLearningRate
from invdyn_cli.adaptation.online import OnlineUpdate
from invdyn_cli.adaptation.payload import Payload
from invdyn_cli.adaptation.rls import Rls
from invdyn_cli.data.pick_place import PickPlace
from invdyn_cli.interfaces import AbstractAdapter, AbstractModel
from invdyn_cli.log import RawTrajectory
from invdyn_cli.maths.metrics import nmse
from invdyn_cli.maths.signals import at_rest, butterworth
from invdyn_cli.models.ffnn import Ffnn
from invdyn_cli.models.local_gp import LocalGp
from invdyn_cli.models.lwpr import Lwpr
from invdyn_cli.models.pest import Pest
from invdyn_cli.models.rff import Rff
from invdyn_cli.models.standard import Standard
from invdyn_cli.online import online
from invdyn_cli.report.canvas import BLACK, BLUE, GREEN, GREY, ORANGE, VERMILLION, house_style
from invdyn_cli.report.tables import significant
from invdyn_cli.robots import load_urdf
from invdyn_cli.types import Dataset, Motion

WARM = 200
"""Ticks before the first that counts."""

RATE, CUTOFF = 1000.0, 10.0
"""[Hz] Of the loop, and of its low-pass."""

THINNED = 5
"""Every so many-th sample is learned from before the loop: neighbours behind that low-pass are nearly alike."""

EVERY = {"rate": 1, "batch_size": 1, "epochs": 1}
DEEP, SHALLOW = Ffnn((100, 100, 10), joints=(), epochs=40), Ffnn(epochs=20)
RUBBING = Pest(friction="stribeck", rest_speed=0.003, least_speed=0.05)
CASES: Mapping[str, tuple[AbstractAdapter, AbstractModel, str]] = {
    "nets of V-C, not adapted": (Batch(), DEEP, GREY),
    "PEST with friction, not adapted": (Batch(), RUBBING, GREY),
    "nets of Table I": (Incremental(**EVERY), SHALLOW, BLUE),
    "nets of V-C": (Incremental(**EVERY), DEEP, BLUE),
    "nets of V-C, 100 samples every 100": (Incremental(), DEEP, BLUE),
    "nets of V-C, learned learning rates": (MemoryLearningRate(**EVERY), DEEP, BLUE),
    "error model on PEST": (ErrorModel(SHALLOW, incremental=Incremental(**EVERY, learning_rate=0.003)), Pest(), BLUE),
    "local error model on PEST with friction": (LocalErrorModel(), RUBBING, GREEN),
    "LWPR": (OnlineUpdate(), Lwpr(), GREEN),
    "local GPs": (OnlineUpdate(), LocalGp(), GREEN),
    "RLS on PEST with friction": (Rls(), RUBBING, ORANGE),
    "RLS on the standard model": (Rls(), Standard(), ORANGE),
    "RLS on random features": (Rls(), Rff(), ORANGE),
    "payload on PEST with friction": (Payload(), RUBBING, VERMILLION),
}
"""Ways to adapt; each learns from every sample where its name says nothing else."""


@dataclass(frozen=True)
class Timed:
    """A way to adapt, the time of each tick [ms], and the NMSE (mean over joints) of what was predicted for each
    sample before learning from it."""

    name: str
    ticks: tuple[float, ...]
    nmse: float


@dataclass(frozen=True)
class Latency(AbstractExperiment):
    """Ticks of a loaded repetition of data=pick_place."""

    row: ClassVar[type] = Timed
    page: ClassVar[str] = "experiments/latency.md"

    seconds: float = 20.0

    def plan(self, rows: Sequence[Timed]) -> Iterable[tuple]:
        """A job per way to adapt."""
        return [(name, self.seconds) for name in CASES]

    def run(self, folder: Path, name: str, seconds: float) -> Iterable[Timed]:
        """Fit the model, and play the repetition as fast as it goes."""
        jax.config.update("jax_enable_x64", True)
        robot, source = load_urdf("apollo_arm"), PickPlace(causal=True)
        train = source.load(robot).train
        learned = replace(train, trajectories=tuple(x[np.arange(0, len(x.t), THINNED)] for x in train.trajectories[:2]))
        raw = next(x for x in source.log(robot).trajectories if x.name == "loaded_1")
        adapter, model, _ = CASES[name]
        times, error = played(adapter, adapter.extended(model), learned, raw, round(RATE * seconds))
        yield Timed(name, tuple((1e3 * times).tolist()), error)

    def line(self, row: Timed) -> str:
        """Median and error."""
        return f"{row.name}: median {np.median(row.ticks):.3f} ms, NMSE {row.nmse:.3g}"

    def table(self, rows: Sequence[Timed]) -> str:
        """Percentiles and error of each way, as Markdown."""
        lines = ["| [ms] | median | 99 % | 99.9 % | worst | NMSE |", "|---|" + "---:|" * 5]
        for row in rows:
            numbers = np.percentile(row.ticks, [50, 99, 99.9, 100])
            lines.append(f"| {row.name} | {' | '.join(f'{x:.3f}' for x in numbers)} | {significant(row.nmse)} |")
        return "\n".join(lines)

    def figures(self, rows: Sequence[Timed]) -> Mapping[str, Figure]:
        """Error against the time that 99 % of the ticks stay below."""
        return {"latency": draw(rows)}


def played(
    adapter: AbstractAdapter, model: AbstractModel, learned: Dataset, raw: RawTrajectory, count: int
) -> tuple[np.ndarray, float]:
    """Seconds (count,) of each tick, and the NMSE of what was predicted for them; the repetition starts anew where it
    ends."""
    loop = online(adapter, model, adapter.fit(model, learned, jax.random.key(0)), rate=RATE, cutoff=CUTOFF)
    state, times = loop.init(raw.q[0], raw.tau[0]), np.empty(count)
    still, said = np.zeros(raw.q.shape[1]), np.empty((count, raw.q.shape[1]))
    rows = 1 + np.arange(WARM + count) % (len(raw.t) - 1)
    for k, row in enumerate(rows):
        started = time.perf_counter()
        state, torque = loop.step(state, raw.q[row], raw.tau[row - 1], Motion(raw.q[row], still, still))
        np.asarray(torque)
        if k >= WARM:
            times[k - WARM] = time.perf_counter() - started
            said[k - WARM] = state["said"]
    low = butterworth(RATE, CUTOFF)
    rest = at_rest(RATE, CUTOFF)[:, :, None] * raw.tau[0]
    tau = scipy.signal.sosfilt(low, raw.tau[rows - 1], axis=0, zi=rest)[0][WARM:]
    return times, float(np.mean(nmse(tau, said)))


def draw(rows: Sequence[Timed]) -> Figure:
    """A point for each way, with a number that the legend explains; a line goes back to the median tick."""
    with house_style():
        figure = Figure(figsize=(8, 5.4), layout="constrained")
        axes = figure.add_subplot()
        title = "What a tick of 1 ms buys: error against the time that 99 % of the ticks stay below"
        axes.set_title(title, loc="left", fontweight="bold")
        for number, row in enumerate(rows, start=1):
            median, most = np.percentile(row.ticks, [50, 99])
            colour = CASES[row.name][2]
            axes.plot([median, most], [row.nmse] * 2, color=colour, lw=0.9)
            axes.scatter([most], [row.nmse], color=colour, s=30, zorder=3, label=f"{number}  {row.name}")
            axes.annotate(str(number), (most, row.nmse), xytext=(5, 3), textcoords="offset points")
        axes.axvline(1.0, color=BLACK, lw=1.0, ls="--")
        axes.annotate("1 ms", (1.0, 1), xycoords=("data", "axes fraction"), xytext=(4, -11), textcoords="offset points")
        axes.set(xscale="log", yscale="log", xlabel="time of a tick [ms]: line from the median to the 99 % (point)")
        axes.set_ylabel("NMSE before learning, mean of the joints")
        axes.set_xticks([0.1, 0.2, 0.5, 1, 2, 5], ["0.1", "0.2", "0.5", "1", "2", "5"])
        figure.legend(loc="outside lower center", ncols=2)
    return figure
