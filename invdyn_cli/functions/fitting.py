"""`fit`: a model that is fitted to one part of a log and tested on the rest; `simulate`: the log of a simulated arm."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Group
from rich.text import Text

from invdyn_cli import experiment, store
from invdyn_cli.adaptation.batch import Batch
from invdyn_cli.data.held import HeldLog
from invdyn_cli.data.plant import Plant
from invdyn_cli.data.recorded import RealLog
from invdyn_cli.errors import RobotError
from invdyn_cli.fields import made
from invdyn_cli.functions.inputs import LogLike, RobotLike, log_of, robot_of
from invdyn_cli.interfaces import AbstractModel, Progress, silent
from invdyn_cli.log import Log
from invdyn_cli.recording.conditioning import Conditioning
from invdyn_cli.registry import make_model
from invdyn_cli.report import figures, page, tables
from invdyn_cli.report.fragment import Shown
from invdyn_cli.robots import load_urdf
from invdyn_cli.store import FittedModel
from invdyn_cli.types import Array, Robot, RunRecord, Score


@dataclass(frozen=True, repr=False)
class FitResult(Shown):
    """A fitted model and how well it predicts.

    Attributes:
        record: the whole experiment: fit, predictions, scores, split.
    """

    record: RunRecord

    @property
    def scores(self) -> dict[str, Score]:
        """NMSE and RMSE [N m; N] of every joint, of the parts "train", "validation" (where there is one), "test"."""
        return dict(self.record.scores)

    def predict(self, q: Array, qd: Array, qdd: Array) -> np.ndarray:
        """Torques (T, n) [N m; N] of a motion (T, n), or (n,) for one sample; ValueError for other shapes."""
        return FittedModel(self.record.model, self.record.fit).predict(q, qd, qdd)

    def __rich__(self) -> Group:
        notes = [Text(f"data: {note}", "dim") for note in self.record.split.get("notes", ())]
        loads = tables.load_table(self.record)
        warnings = [Text(x, "yellow") for x in self.record.fit.warnings]
        return Group(*notes, tables.score_table(self.record), *([loads] if loads else []), *warnings)

    def save(self, folder: str | Path, formats: tuple[str, ...] = ("png",), progress: Progress = silent) -> None:
        """Write run.h5, figures/, report.html and metrics.json into the folder, as `invdyn run` does; metrics.json
        comes last: where it is, the run is complete."""
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        (folder / store.METRICS).unlink(missing_ok=True)
        store.write_run(self.record, folder / store.RUN)
        progress(0.2, "figures")
        drawn = figures.draw_all(self.record, folder / "figures", tuple({"png", *formats}))
        progress(0.9, "report")
        page.write_page(self.record, [path for path in drawn if path.suffix == ".png"], folder / "report.html")
        store.write_metrics(self.record, folder / store.METRICS)
        progress(1.0, "done")


def fit(
    model: str | AbstractModel,
    log: LogLike,
    robot: RobotLike | None = None,
    *,
    seed: int = 0,
    progress: Progress = silent,
    **options: Any,
) -> FitResult:
    """Fit a model to the first part of a log and test it on the rest.

    Args:
        model: a name (`make_model` says which) or an object.
        log: a log, or the path of a file in any format.
        robot: a robot or the path of its URDF; None: the one that the log names. `ffnn` and `dbm` need none.
        seed: of everything random.
        progress: called with the share that is done and a note.
        options: selection and conditioning as in `data=real_log`: train, validation, test, train_share, filter_cutoff,
            decimate, ….

    Raises:
        UsageError, LogError, RobotError: for what cannot be read, does not belong together, or is out of range.
    """
    found, chosen = log_of(log), make_model(model)
    name = model if isinstance(model, str) else type(model).__name__.lower()
    how = Conditioning.of(made(RealLog, {"path": "", **options}, "the selection of data"))
    nominal = _robot(robot, found, chosen.needs_robot)
    stage = lambda step: lambda done, note: progress(done, f"{step} {note}".rstrip())  # noqa: E731
    record = experiment.run(HeldLog(found, how), chosen, Batch(), nominal, seed=seed, stage=stage)
    choices = {"model": name, "data": found.source or "log", "adaptation": "batch", **record.choices}
    return FitResult(replace(record, choices=choices))


def _robot(robot: RobotLike | None, log: Log, needed: bool) -> Robot | None:
    """The robot; None where the log names one that cannot be used, and the model needs none."""
    try:
        return robot_of(robot, log)
    except RobotError:
        if needed or robot is not None:
            raise
        return None


def simulate(robot: RobotLike = "apollo_arm", *, progress: Progress = silent, **options: Any) -> Log:
    """The log of a simulated arm (MuJoCo) in which effects are hidden, as `invdyn simulate` makes it.

    Args:
        robot: a robot, the path of its URDF, or the name of a built-in one.
        progress: called with the share that is done and a note.
        options: of `data=plant` (docs/plant.md): effects, trajectories, duration, torque_noise, seed, ….

    Raises:
        UsageError, RobotError: for options that are not allowed, or effects that this robot cannot have.
    """
    plant = made(Plant, options, "the simulated arm")
    return plant.record(robot if isinstance(robot, Robot) else load_urdf(robot), progress)
