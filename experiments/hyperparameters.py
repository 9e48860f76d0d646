"""Adapting against forgetting: how often, in what batches, how long and how fast nets learn on (hyperparameters.md)."""

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache, partial
from pathlib import Path
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

from invdyn_cli import experiment
from invdyn_cli.abstract_experiment import AbstractExperiment
from invdyn_cli.adaptation.incremental import Incremental
from invdyn_cli.data.pick_place import PickPlace
from invdyn_cli.maths.metrics import nmse
from invdyn_cli.models.ffnn import Ffnn
from invdyn_cli.report.canvas import BLACK, BLUE, GREEN, ORANGE, VERMILLION, house_style
from invdyn_cli.robots import load_urdf
from invdyn_cli.types import Array, Dataset, Fit, PyTree, Trajectory

RATES, BATCHES, EPOCHS = (10, 100, 1000), (8, 32, 100), (1, 5, 20)
SPEEDS = (0.001, 0.003, 0.01, 0.03)
COLOURS = dict(zip(SPEEDS, (BLUE, GREEN, ORANGE, VERMILLION), strict=True))
PAPER = (100, 32, 5)
"""Adaptation rate, batch size, epochs that the paper found best."""
PROBE = 20
"""Every so many-th sample of the unloaded repetition is asked."""


@dataclass(frozen=True)
class Tried:
    """One way to go on learning, and what it did."""

    rate: int
    batch_size: int
    epochs: int
    learning_rate: float
    adapting: float
    forgetting: float


@dataclass(frozen=True)
class Hyperparameters(AbstractExperiment):
    """The sweep of the paper's section IV-A on data=pick_place."""

    row: ClassVar[type] = Tried

    seed: int = 0
    epochs: int = 40
    repetitions: int = 2

    def plan(self, rows: Sequence[Tried]) -> Iterable[tuple]:
        """A job per shape of a program; learning rates share it."""
        shapes = [x for x in itertools.product(RATES, BATCHES, EPOCHS) if x[1] <= x[0]]
        return [(self.seed, self.epochs, self.repetitions, *shape) for shape in shapes]

    def run(self, folder: Path, seed: int, epochs: int, repetitions: int, *shape: int) -> Iterable[Tried]:
        """The four learning rates of one shape."""
        return sweep(Incremental(*shape), *learned(seed, epochs, repetitions))

    def table(self, rows: Sequence[Tried]) -> str:
        """All ways, as Markdown, and the best."""
        names = [x.name for x in fields(Tried)]
        lines = [f"| {' | '.join(names)} |", "|---:" * len(names) + "|"]
        lines += [f"| {' | '.join(f'{getattr(x, name):.4g}' for name in names)} |" for x in rows]
        for title, key in (("adapting", lambda x: x.adapting), ("both", lambda x: x.adapting * x.forgetting)):
            lines += ["", f"Best {title}: {min((x for x in rows if np.isfinite(key(x))), key=key)}"]
        return "\n".join(lines)

    def figures(self, rows: Sequence[Tried]) -> Mapping[str, Figure]:
        """Forgetting over adapting."""
        return {"hyperparameters": draw(rows, as_learned(*learned(self.seed, self.epochs, self.repetitions)))}


@cache
def learned(seed: int, epochs: int, repetitions: int) -> tuple[Ffnn, Fit, Sequence[Trajectory], Trajectory]:
    """The nets, learned on the unloaded arm; repetitions with the object; one without that nobody learned from."""
    jax.config.update("jax_enable_x64", True)
    splits = PickPlace(causal=True, friction=1.0, torque_noise=0.01).load(load_urdf("apollo_arm"))
    assert splits.validation is not None
    model = Ffnn((100, 100, 10), joints=(), epochs=epochs)
    fit = Incremental().fit(model, splits.train, jax.random.key(seed))
    return model, fit, splits.tests["test"].trajectories[:repetitions], splits.validation.trajectories[0]


def sweep(
    adapter: Incremental, model: Ffnn, fit: Fit, loaded: Sequence[Trajectory], unloaded: Trajectory
) -> list[Tried]:
    """One shape with all learning rates at once, repetition after repetition."""
    state = adapter.init(model, fit)
    many = jax.tree.map(lambda x: jnp.broadcast_to(x, (len(SPEEDS), *jnp.shape(x))), state)
    many["learning_rate"] = jnp.array(SPEEDS, jnp.float32)
    step = jax.jit(jax.vmap(partial(experiment.follow_blocks, adapter, model), (0, None)))
    ask = jax.jit(jax.vmap(partial(torques, adapter, model), (0, None)))
    probe = unloaded.motion[slice(None, None, PROBE)]
    said, held, forgetting = [], [], []
    for x in loaded:
        for part in cut(x, adapter.rate):
            blocks = jax.tree.map(lambda x: x.reshape(-1, adapter.rate, x.shape[-1]), (part.motion, part.tau))
            many, (torque, _) = step(many, blocks)
            said.append(np.asarray(torque).reshape(len(SPEEDS), *part.tau.shape))
            held.append(np.isin(part.stage, ("grasp", "place")))
            if part.stage[-1] == "place":
                forgetting.append([nmse(unloaded.tau[::PROBE], np.asarray(t)).mean() for t in ask(many, probe)])
    kept = np.concatenate(held)
    measured = np.concatenate([part.tau for x in loaded for part in cut(x, adapter.rate)])
    adapting = [
        float(np.mean(np.mean((measured - tau)[kept] ** 2, axis=0) / measured.var(axis=0)))
        for tau in np.concatenate(said, axis=1)
    ]
    return [
        Tried(adapter.rate, adapter.batch_size, adapter.epochs, *numbers)
        for numbers in zip(SPEEDS, adapting, np.mean(forgetting, axis=0).tolist(), strict=True)
    ]


def cut(x: Trajectory, size: int) -> list[Trajectory]:
    """A repetition until the object is put down, and the rest, in whole blocks, at most `size` - 1 samples lost."""
    assert x.stage is not None
    put_down = int(np.flatnonzero(x.stage == "place")[-1]) // size * size
    whole = len(x.t) // size * size
    return [x[:put_down], x[put_down:whole]]


def torques(adapter: Incremental, model: Ffnn, state: PyTree, motion) -> Array:
    """Torques (T, n) of a motion (T, n) with what is known."""
    return jax.vmap(lambda one: adapter.predict(model, state, one))(motion)


def as_learned(model: Ffnn, fit: Fit, loaded: Sequence[Trajectory], unloaded: Trajectory) -> tuple[float, float]:
    """The same two numbers of nets that do not go on."""
    data = Dataset(tuple(loaded), fit.joints)
    rows = np.isin(np.concatenate([x.stage for x in loaded]), ("grasp", "place"))
    missed = data.tau - np.concatenate([model.predict(fit, x.motion) for x in loaded])
    adapting = np.mean(np.mean(missed[rows] ** 2, axis=0) / data.tau.var(axis=0))
    return float(adapting), float(nmse(unloaded.tau, model.predict(fit, unloaded.motion)).mean())


def draw(tried: Sequence[Tried], before: tuple[float, float]) -> Figure:
    """Forgetting over adapting: a panel per adaptation rate, colours for learning rates, shapes for epochs, sizes for
    batches."""
    with house_style():
        figure = Figure(figsize=(11, 4.2), layout="constrained")
        figure.suptitle(
            "Adapting and forgetting: the delta rule while an object is held", x=0.01, ha="left", fontweight="bold"
        )
        panels = figure.subplots(1, len(RATES), sharex=True, sharey=True)
        shapes, sizes = dict(zip(EPOCHS, "osD", strict=True)), dict(zip(BATCHES, (22, 55, 110), strict=True))
        for axes, rate in zip(panels, RATES, strict=True):
            for x in (x for x in tried if x.rate == rate and x.adapting < 2 and x.forgetting < 20):
                look = {"marker": shapes[x.epochs], "s": sizes[x.batch_size], "color": COLOURS[x.learning_rate]}
                axes.scatter(x.adapting, x.forgetting, alpha=0.8, linewidths=0.5, edgecolors="white", **look)
                if (x.rate, x.batch_size, x.epochs) == PAPER:
                    axes.scatter(x.adapting, x.forgetting, s=190, facecolors="none", edgecolors=BLACK, linewidths=1.2)
            axes.scatter(*before, marker="*", s=150, color=BLACK)
            axes.set(
                xscale="log", yscale="log", title=f"adaptation rate {rate}", xlabel="NMSE while the object is held"
            )
        panels[0].set_ylabel("NMSE of the unloaded arm after that")
        keys = [panels[0].scatter([], [], color=c, label=f"learning rate {x:g}") for x, c in COLOURS.items()]
        keys += [panels[0].scatter([], [], color="0.4", marker=m, label=f"{x} epochs") for x, m in shapes.items()]
        keys += [panels[0].scatter([], [], color="0.4", s=s, label=f"batches of {x}") for x, s in sizes.items()]
        ring = {"s": 190, "facecolors": "none", "edgecolors": BLACK}
        keys += [panels[0].scatter([], [], label="the paper's rate, batch, epochs", **ring)]
        keys += [panels[0].scatter([], [], marker="*", s=150, color=BLACK, label="not adapted")]
        figure.legend(handles=keys, loc="outside lower center", ncols=4)
    return figure
