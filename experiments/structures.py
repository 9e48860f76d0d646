"""Which nets a search finds, feed-forward and recurrent ones, and what they gain over Table I (structures.md)."""

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import jax
import numpy as np

from experiments.open_choices import arm
from invdyn_cli import experiment
from invdyn_cli.abstract_experiment import WAIT, AbstractExperiment
from invdyn_cli.data.sim import SineTasks
from invdyn_cli.interfaces import AbstractModel
from invdyn_cli.models.ffnn import Ffnn, JointNet
from invdyn_cli.models.gru import Gru
from invdyn_cli.report.tables import significant
from invdyn_cli.types import Dataset, Splits

HIDDEN = ((50,), (100,), (200,), (50, 50), (100, 100), (50, 50, 50))
RATES = (0.0003, 0.001, 0.003, 0.01)
BATCHES, EPOCHS = (32, 128), (30, 100)
MEMORIES = (16, 32, 64)
LEFT_OUT = "sine_0.4_Hz"
"""The training task that judges in the search: between others, as the test tasks of interpolation are."""
EVERY = 5
"""Every so many-th sample is learned from in the search: neighbours at 500 Hz are nearly alike."""
TABLE_ONE, FOUND = "Table I", "found"
SPLITS = ("interpolation", "extrapolation")


@dataclass(frozen=True)
class Tried:
    """Nets that were learned.

    Attributes:
        where: "search", or the split whose test tasks judge.
        who: of a split, Table I or what was found.
        hidden, rate: of feed-forward nets, widths and learning rate; those of a split have their own per joint.
        memory: of a recurrent one; 0 of the others.
        batch, epochs: of all joints.
        nmse: (n,) of each joint.
    """

    where: str
    who: str
    hidden: tuple[int, ...]
    rate: float
    memory: int
    batch: int
    epochs: int
    seed: int
    nmse: tuple[float, ...]

    @property
    def mean(self) -> float:
        """Mean over joints."""
        return float(np.mean(self.nmse))


@dataclass(frozen=True)
class Structures(AbstractExperiment):
    """The search, one program for all learning rates of a structure; then what it found beside Table I."""

    row: ClassVar[type] = Tried
    page: ClassVar[str] = "experiments/structures.md"

    seeds: int = 3

    def plan(self, rows: Sequence[Tried]) -> Iterable[tuple]:
        """A job for each program of the search; when all are there, one for each split and net."""
        for hidden, batch, epochs in itertools.product(HIDDEN, BATCHES, EPOCHS):
            yield ("search", "", hidden, batch, epochs, (), 0)
        for memory in MEMORIES:
            yield ("search", "", (), 0, 0, (), memory)
        yield WAIT
        batch, epochs, nets = best(rows)
        for split, seed in itertools.product(SPLITS, range(self.seeds)):
            yield (split, TABLE_ONE, (), 32, 100, (), seed)
            yield (split, FOUND, (), batch, epochs, nets, seed)

    def run(
        self, folder: Path, where: str, who: str, hidden: tuple, batch: int, epochs: int, nets: tuple, number: int
    ) -> Iterable[Tried]:
        """Every learning rate of a structure, or one net beside the paper's."""
        jax.config.update("jax_enable_x64", True)
        if where == "search":
            return list(_searched(hidden, batch, epochs) if hidden else _recurrent(number))
        model = Ffnn()
        if who == FOUND:
            joints = tuple((j + 1, JointNet(tuple(own), rate)) for j, (own, rate) in enumerate(nets))
            model = replace(model, joints=joints, batch_size=batch, epochs=epochs)
        splits = _data(where)
        fit = model.fit(splits.train, jax.random.key(number))
        return [Tried(where, who, (), 0.0, 0, batch, epochs, number, _nmse(model, fit, splits.tests["test"]))]

    def line(self, row: Tried) -> str:
        """The nets, and their error."""
        what = row.who or (f"GRU {row.memory}" if row.memory else f"{list(row.hidden)} batch {row.batch}")
        return f"{row.where}, {what}, rate {row.rate:g}, {row.epochs} epochs: NMSE {row.mean:.3g}"

    def table(self, rows: Sequence[Tried]) -> str:
        """What was found per joint, the gain over Table I, and the search."""
        batch, epochs, nets = best(rows)
        lines = [
            f"Found, batches of {batch}, {epochs} epochs:",
            "",
            "| joint | hidden | learning rate |",
            "|---:|---|---:|",
        ]
        lines += [f"| {j + 1} | {', '.join(map(str, own))} | {rate:g} |" for j, (own, rate) in enumerate(nets)]
        lines += ["", "| test tasks | Table I | found | ratio |", "|---|---:|---:|---:|"]
        for split in SPLITS:
            one, other = ([x.mean for x in rows if (x.where, x.who) == (split, who)] for who in (TABLE_ONE, FOUND))
            if one and other:
                lines.append(f"| {split} | {_spread(one)} | {_spread(other)} | {np.mean(other) / np.mean(one):.2f} |")
        lines += ["", "| search | batch | epochs | " + " | ".join(f"rate {x:g}" for x in RATES) + " |"]
        lines.append("|---|---:|---:|" + "---:|" * len(RATES))
        groups: dict[tuple, dict[float, float]] = {}
        for x in (x for x in rows if x.where == "search"):
            name = f"GRU {x.memory}" if x.memory else ", ".join(map(str, x.hidden))
            groups.setdefault((name, x.batch, x.epochs), {})[x.rate] = x.mean
        for (name, size, passes), own in groups.items():
            cells = " | ".join(significant(own[x]) if x in own else "" for x in RATES)
            lines.append(f"| {name} | {size} | {passes} | {cells} |")
        return "\n".join(lines)


def best(rows: Sequence[Tried]) -> tuple[int, int, tuple]:
    """Batch size and epochs whose best nets, joint by joint, have the smallest mean error in the search; and those,
    (hidden, rate) per joint. Table I's where nothing was tried yet."""
    tried: Mapping[tuple[int, int], list[Tried]] = {}
    for x in rows:
        if x.where == "search" and not x.memory:
            tried.setdefault((x.batch, x.epochs), []).append(x)
    if not tried:
        return 32, 100, ()

    def errors(own: Sequence[Tried]) -> np.ndarray:
        return np.array([x.nmse for x in own])

    batch, epochs = min(tried, key=lambda key: errors(tried[key]).min(0).mean())
    own = tried[batch, epochs]
    return batch, epochs, tuple((own[i].hidden, own[i].rate) for i in errors(own).argmin(0))


def _searched(hidden: tuple, batch: int, epochs: int) -> Iterable[Tried]:
    """One structure with every learning rate, in one program."""
    learn, judge = _parted(_data("interpolation").train)
    models = [Ffnn(tuple(hidden), rate, (), epochs, batch) for rate in RATES]
    fits = models[0].fit_together(models, learn, [jax.random.key(0)] * len(models))
    for model, fit, rate in zip(models, fits, RATES, strict=True):
        yield Tried("search", "", tuple(hidden), rate, 0, batch, epochs, 0, _nmse(model, fit, judge))


def _recurrent(memory: int) -> Iterable[Tried]:
    """A recurrent net with every learning rate: it remembers samples, and learns from all of them."""
    learn, judge = _parted(_data("interpolation").train, 1)
    for rate in RATES:
        model = Gru(memory=memory, learning_rate=rate)
        fit = model.fit(learn, jax.random.key(0))
        yield Tried("search", "", (), rate, memory, model.batch_size, model.epochs, 0, _nmse(model, fit, judge))


def _data(split: str) -> Splits:
    return SineTasks(noisy=True, split=split, validation_share=0.0).load(arm())  # type: ignore[arg-type]


def _parted(train: Dataset, every: int = EVERY) -> tuple[Dataset, Dataset]:
    """Every so many-th sample of the training tasks but one, and that one."""
    learn = tuple(x[np.arange(0, len(x.t), every)] for x in train.trajectories if x.name != LEFT_OUT)
    return replace(train, trajectories=learn), replace(
        train, trajectories=tuple(x for x in train.trajectories if x.name == LEFT_OUT)
    )


def _nmse(model: AbstractModel, fit, data: Dataset) -> tuple[float, ...]:
    return tuple(float(x) for x in experiment.score(data, experiment.predict(model, fit, data)).nmse)


def _spread(values: Sequence[float]) -> str:
    """The mean, and the smallest and the largest."""
    return f"{significant(float(np.mean(values)))} ({significant(min(values))} to {significant(max(values))})"
