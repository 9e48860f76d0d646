"""What a tick costs: filter, predict, learn and feedforward of one sample, called from Python as a 1 kHz loop would.

    python experiments/latency.py [seconds=20] [docs=false] [folder=outputs/latency]

Plays a loaded repetition of data=pick_place, over and over, into `invdyn_cli.online`, tick after tick as fast as it
goes, and takes the time of each. Draws latency.png into the folder, or into docs/ with docs=true, and prints the
percentiles. Nets learn for one epoch before: what a tick costs does not depend on how good they are.
"""

import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import numpy as np
from matplotlib.figure import Figure

from experiments.options import options_of
from invdyn_cli.adaptation.error_model import ErrorModel
from invdyn_cli.adaptation.incremental import Incremental
from invdyn_cli.adaptation.payload import Payload
from invdyn_cli.data.pick_place import PickPlace
from invdyn_cli.interfaces import AbstractAdapter, AbstractModel
from invdyn_cli.logfile import RawTrajectory
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
class Options:
    """What the command line may say."""

    seconds: float = 20.0
    docs: bool = False
    folder: str = "outputs/latency"


def main(argv: Sequence[str]) -> None:
    """Time, print, draw."""
    options = options_of(argv, Options(), __doc__)
    jax.config.update("jax_enable_x64", True)
    robot, source = load_urdf("apollo_arm"), PickPlace(causal=True)
    train = source.load(robot).train
    learned = replace(train, trajectories=train.trajectories[:2])
    raw = next(x for x in source.log(robot).trajectories if x.name == "loaded_1")
    took = {}
    print(f"{'[ms]':44}{'median':>8}{'99 %':>8}{'99.9 %':>8}{'worst':>8}")
    for name, (adapter, model, _) in CASES.items():
        took[name] = 1e3 * ticks(adapter, adapter.extended(model), learned, raw, round(1000 * options.seconds))
        numbers = np.percentile(took[name], [50, 99, 99.9, 100])
        print(f"{name:44}" + "".join(f"{x:8.3f}" for x in numbers), flush=True)
    path = Path("docs" if options.docs else options.folder) / "latency.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    draw(took).savefig(path, dpi=110)
    print(path)


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


if __name__ == "__main__":
    main(sys.argv[1:])
