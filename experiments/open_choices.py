"""What the paper does not say of its sine tasks, searched on its interpolation results alone (open_choices.md)."""

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import ClassVar

import jax

from invdyn_cli import experiment
from invdyn_cli.abstract_experiment import WAIT, AbstractExperiment
from invdyn_cli.adaptation.batch import Batch
from invdyn_cli.data.sim import SineTasks
from invdyn_cli.interfaces import AbstractModel
from invdyn_cli.models.dbm import Dbm
from invdyn_cli.models.ffnn import Ffnn
from invdyn_cli.models.pest import Pest
from invdyn_cli.report.tables import significant
from invdyn_cli.robots import load_urdf
from invdyn_cli.types import Robot

MODELS: Mapping[str, AbstractModel] = {"PEST": Pest(), "DBM": Dbm(form="structured", solver="lstsq"), "NN": Ffnn()}

NOISY = 1e-2
"""NMSE that all three models "almost" reach on noisy data in interpolation (paper, V-B.1)."""

CLEAN = {"PEST": 1e-10, "DBM": 1e-10, "NN": 0.1}
"""NMSE that they are below on noise-free data: "very close to zero", read as eight decades below the noisy one, and 0.1
for the nets (paper, V-B.1, Fig. 3a)."""

Choice = tuple[float, str, float]
"""data.amplitude, data.filter, data.jitter."""


@dataclass(frozen=True)
class Tried:
    """One model on the data of one choice, both in interpolation: NMSE without noise and with it."""

    amplitude: float
    filter: str
    jitter: float
    model: str
    clean: float
    noisy: float

    @property
    def choice(self) -> Choice:
        """What was chosen."""
        return self.amplitude, self.filter, self.jitter

    @property
    def distance(self) -> float:
        """Squared decades between these two and the paper's."""
        return math.log10(self.noisy / NOISY) ** 2 + max(0.0, math.log10(self.clean / CLEAN[self.model])) ** 2


@dataclass(frozen=True)
class OpenChoices(AbstractExperiment):
    """A grid: PEST and the DBM on every choice, nets on the best of those; the choice with the smallest sum of squared
    decades is the default of data=sim_clean and sim_noisy. Extrapolation is never computed."""

    row: ClassVar[type] = Tried
    page: ClassVar[str] = "experiments/open_choices.md"

    amplitudes: Sequence[float] = (0.25, 0.35, 0.5, 0.7, 1.0, 1.4)
    filters: Sequence[str] = ("backward", "central")
    jitters: Sequence[float] = (0, 0.003, 0.01, 0.03, 0.1)
    nets: int = 8
    seed: int = 0

    def plan(self, rows: Sequence[Tried]) -> Iterable[tuple]:
        """PEST and the DBM on every choice, then the nets on the best."""
        for choice in itertools.product(self.amplitudes, self.filters, self.jitters):
            for model in ("PEST", "DBM"):
                yield (*choice, model, 0)
        yield WAIT
        for choice in best(rows)[: self.nets]:
            yield (*choice, "NN", self.seed)

    def run(self, folder: Path, amplitude: float, filter: str, jitter: float, model: str, seed: int) -> Iterable[Tried]:
        """One model on one choice."""
        jax.config.update("jax_enable_x64", True)
        found = {
            noisy: experiment.run(
                SineTasks(noisy=noisy, amplitude=amplitude, filter=filter, jitter=jitter),  # pyright: ignore[reportArgumentType]
                MODELS[model],
                Batch(),
                arm(),
                seed=seed,
            ).scores["test"]
            for noisy in (False, True)
        }
        errors = {noisy: float(score.nmse.mean()) for noisy, score in found.items()}
        yield Tried(amplitude, filter, jitter, model, errors[False], errors[True])

    def line(self, row: Tried) -> str:
        """What was chosen, and how far from the paper it is."""
        chosen = f"amplitude {row.amplitude:g}, {row.filter}, jitter {row.jitter:g}"
        return f"{chosen}, {row.model}: clean {row.clean:.2e}, noisy {row.noisy:.2e}, distance {row.distance:.3g}"

    def table(self, rows: Sequence[Tried]) -> str:
        """All choices, those with nets first, each group from the nearest to the farthest."""
        by = {(x.choice, x.model): x for x in rows}
        heads = [f"{model} {kind}" for kind in ("clean", "noisy") for model in MODELS]
        lines = [f"| amplitude | filter | jitter | {' | '.join(heads)} | without NN | distance |"]
        lines.append("|---" * (5 + len(heads)) + "|")
        for choice in ordered(rows):
            found = [by.get((choice, model)) for model in MODELS]
            cells = [significant(x.clean) if x else "" for x in found] + [
                significant(x.noisy) if x else "" for x in found
            ]
            closed = sum(x.distance for x in found if x and x.model != "NN")
            total = f"{sum(x.distance for x in found if x):.3g}" if all(found) else ""
            lines.append(
                f"| {choice[0]:g} | {choice[1]} | {choice[2]:g} | {' | '.join(cells)} | {closed:.3g} | {total} |"
            )
        return "\n".join(lines)


def best(rows: Sequence[Tried]) -> list[Choice]:
    """All choices, by the distance of PEST and the DBM."""
    return sorted(
        {x.choice for x in rows}, key=lambda c: sum(x.distance for x in rows if x.choice == c and x.model != "NN")
    )


def ordered(rows: Sequence[Tried]) -> list[Choice]:
    """Those with nets by the distance of all three, then the others."""
    tried = {x.choice for x in rows if x.model == "NN"}
    nearest = sorted(tried, key=lambda c: sum(x.distance for x in rows if x.choice == c))
    return nearest + [c for c in best(rows) if c not in tried]


@cache
def arm() -> Robot:
    """The paper's four joints."""
    return load_urdf("apollo_arm", dofs=4)
