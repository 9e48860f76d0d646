"""Learned on one recording of a real robot, judged on another, beside simpler models (transfer.md)."""

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from hydra import compose, initialize_config_dir
from omegaconf import open_dict

from experiments.real_diagnosis import present
from invdyn_cli.abstract_experiment import AbstractExperiment, chosen
from invdyn_cli.report.tables import significant
from invdyn_cli.types import Diagnosis
from invdyn_cli.verbs import diagnose, run
from invdyn_cli.verbs.launch import config_folder
from invdyn_cli.verbs.screen import Screen

UR10E = [
    f"train_20_02_{name}harm"
    for name in (
        "05_20sec_12",
        "05_20sec_8",
        "06_20sec_10",
        "06_20sec_5",
        "10_20sec_7",
        "10_30sec_12",
        "12_40sec_12",
        "12_50sec_12",
    )
]
IIWA = "joint_2_to_7_dynamic_motion"


@dataclass(frozen=True)
class Transfer:
    """A log, what is learned from and what judges; whether its torques are taken before the gear."""

    title: str
    log: str
    train: Sequence[str]
    test: Sequence[str]
    motor: bool = False


TRANSFERS: Mapping[str, Transfer] = {
    "lwr4": Transfer("LWR 4+, run 1 to run 2", "kuka_lwr4.h5", ["run_1"], ["run_2"]),
    "lwr4_back": Transfer("LWR 4+, run 2 to run 1", "kuka_lwr4.h5", ["run_2"], ["run_1"]),
    "ur10e_one": Transfer("UR10e, one to seven", "ur10e.h5", UR10E[:1], UR10E[1:], True),
    "ur10e_four": Transfer("UR10e, four to four", "ur10e.h5", UR10E[::2], UR10E[1::2], True),
    "panda": Transfer("Panda, 70 to 30 %", "panda.h5", ["exciting_trajectory_1[:10]"], ["exciting_trajectory_1[10:]"]),
    "iiwa14": Transfer("iiwa 14, halves", "iiwa14.h5", [f"{IIWA}[:90]"], [f"{IIWA}[90:]"]),
    "iiwa14_back": Transfer("iiwa 14, halves, back", "iiwa14.h5", [f"{IIWA}[90:]"], [f"{IIWA}[:90]"]),
}
HEADS = ("URDF", "friction line", "standard", "written")
FITTED = {
    "PEST": "model=pest model.friction=coulomb_viscous model.offset=true model.weighting=torque_spread",
    "standard": "model=standard",
}


@dataclass(frozen=True)
class Worth:
    """A line of the table, and the ratio of what is written to the friction line."""

    line: str
    ratio: float


def overrides_of(one: Transfer, data: Path) -> list[str]:
    """The log and its split, as the command line says it."""
    sets = {"train": one.train, "test": one.test}
    split = [f"data.{name}=[{','.join(repr(x) for x in chosen)}]" for name, chosen in sets.items()]
    return ["data=real_log", f"data.path='{data / one.log}'", *split, "data.validation=[]"]


def diagnosed(one: Transfer, data: Path, folder: Path) -> tuple[Diagnosis, float]:
    """The diagnosis that learns from one part, and the seconds that it took."""
    with initialize_config_dir(str(config_folder()), version_base="1.3"):
        config = compose("diagnose", [*overrides_of(one, data), "diagnosis.replay=false", "diagnosis.design=false"])
    started = time.perf_counter()
    return diagnose.execute(config, folder, Screen(quiet=True)), time.perf_counter() - started


def fitted(one: Transfer, data: Path, folder: Path, model: str) -> list[float]:
    """RMSE of every joint on the test set of `invdyn run`."""
    rotor = f"model.rotor_inertia={str(one.motor).lower()}"
    with initialize_config_dir(str(config_folder()), version_base="1.3"):
        config = compose(
            "run", [*overrides_of(one, data), *model.split(), rotor, "robot=from_log"], return_hydra_config=True
        )
    with open_dict(config):
        view = config.pop("hydra")
    record = run.execute(config, folder, view=view)
    return record.scores["test"].rmse.tolist()


def ratio(errors: Sequence[float], line: Sequence[float]) -> float:
    """Geometric mean of the ratios over joints."""
    return math.exp(sum(math.log(a / b) for a, b in zip(errors, line, strict=True)) / len(line))


def worth(one: Transfer, diagnosis: Diagnosis, seconds: float, runs: Mapping[str, Sequence[float]]) -> Worth:
    """What the table says of a transfer."""
    tables = (diagnosis.baseline, *(diagnosis.baselines[x] for x in ("friction", "standard")), diagnosis.extended)
    errors = [[x["rmse"] for x in table.values()] for table in tables]
    ratios = [ratio(x, errors[1]) for x in errors]
    cells = [f"{significant(sum(x) / len(x))} ({r:.2f})" for x, r in zip(errors, ratios, strict=True)]
    cells += [significant(sum(x) / len(x)) for x in runs.values()]
    return Worth(f"| {one.title} | {' | '.join(cells)} | {seconds:.0f} |", ratios[-1])


@dataclass(frozen=True)
class TransferExperiment(AbstractExperiment):
    """Diagnoses and fits on one part of real logs, judged on another."""

    row: ClassVar[type] = Worth
    page: ClassVar[str] = "experiments/transfer.md"

    only: Sequence[str] = ()
    data: str = "../shared/data"

    def plan(self, rows: Sequence[Worth]) -> Iterable[tuple]:
        """A job per transfer whose log is there; the others are left out."""
        wanted = {name: TRANSFERS[name].log for name in chosen("only", self.only, TRANSFERS)}
        return present(self.data, wanted)

    def run(self, folder: Path, name: str, path: str) -> Iterable[Worth]:
        """Diagnose and fit; the files of each go into a folder of their own."""
        one, data = TRANSFERS[name], Path(path).parent
        diagnosis, seconds = diagnosed(one, data, folder / name)
        runs = {key: fitted(one, data, folder / f"{name}_{key}", model) for key, model in FITTED.items()}
        yield worth(one, diagnosis, seconds, runs)

    def line(self, row: Worth) -> str:
        """The line of the table."""
        return row.line

    def table(self, rows: Sequence[Worth]) -> str:
        """A row per transfer, as Markdown, and the mean over them."""
        heads = [*(f"{x} RMSE (ratio)" for x in HEADS), *(f"run: {x}" for x in FITTED), "s"]
        lines = [f"| transfer | {' | '.join(heads)} |", "|---|" + "---:|" * len(heads), *(x.line for x in rows)]
        ratios = [x.ratio for x in rows]
        mean = math.exp(sum(map(math.log, ratios)) / len(ratios))
        lines += [
            "",
            f"Written beside the friction line: {mean:.2f} in the geometric mean, {max(ratios):.2f} at worst.",
        ]
        return "\n".join(lines)
