"""`diagnose`: what the simulation of a robot gets wrong on a log, and the model that is better."""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Unpack

import numpy as np
from rich.console import Group
from rich.text import Text

from invdyn_cli import diagnosis as steps
from invdyn_cli import store
from invdyn_cli.design import next_motion
from invdyn_cli.design.trajectory import Design
from invdyn_cli.diagnosis import Options
from invdyn_cli.diagnosis.extension import Export, exported
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.description import ExtendedModel
from invdyn_cli.errors import UsageError
from invdyn_cli.files import write_file
from invdyn_cli.functions.arrays import Arrays
from invdyn_cli.functions.inputs import LogLike, RobotLike, log_of, robot_of
from invdyn_cli.interfaces import AbstractEffect, AbstractModel, Progress, silent
from invdyn_cli.log import Log, Window
from invdyn_cli.recording.channels import ordered
from invdyn_cli.report import diagnosis_figures, diagnosis_page, diagnosis_tables
from invdyn_cli.report.better_simulation import replay_line
from invdyn_cli.report.check_terminal import shown
from invdyn_cli.report.fragment import Shown
from invdyn_cli.report.wording import CAUTION, advised
from invdyn_cli.simulation.played import write_csv
from invdyn_cli.types import Diagnosis, Finding, Robot

DIAGNOSIS, MODEL, REPORT = "diagnosis.json", "extended_model.json", "report.html"
URDF, MJCF = "extended_model.urdf", "extended_model.mjcf.xml"
"""What the files are called; diagnosis.json is written last: where it is, the diagnosis is complete."""

USUAL = Options(replay=True)


@dataclass(frozen=True, repr=False)
class DiagnosisResult(Shown):
    """A diagnosis, and what to record next.

    Attributes:
        diagnosis: all of it.
        robot: the nominal robot.
        design: a motion that distinguishes what stays ambiguous; None where nothing does, or no motion would.
        notes: what was ignored or taken for granted in the data.
    """

    diagnosis: Diagnosis
    robot: Robot
    design: Design | None = None
    notes: tuple[str, ...] = ()

    @property
    def verdict(self) -> str:
        """ "explained", "partly_explained", "nothing_found" or "log_unusable"."""
        return self.diagnosis.verdict

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The claims (status "named" or "ambiguous"), then what this log could not show."""
        return self.diagnosis.findings

    @property
    def model(self) -> ExtendedModel | None:
        """The better model, which predicts torques; None where the log is unusable."""
        return self.diagnosis.model

    def __rich__(self) -> Group:
        diagnosis = self.diagnosis
        parts: list = [Text(note, "dim") for note in self.notes]
        parts.append(diagnosis_tables.verdict_line(diagnosis))
        if diagnosis.verdict == "log_unusable":
            parts.append(shown(diagnosis.examination))
        else:
            tables = (
                diagnosis_tables.finding_table,
                diagnosis_tables.standard_table,
                diagnosis_tables.each_log_table,
                diagnosis_tables.unclaimed_line,
            )
            parts += [x for x in (table(diagnosis) for table in tables) if x is not None]
            parts.append(diagnosis_tables.error_table(diagnosis))
        if diagnosis.replay is not None:
            parts.append(Text(replay_line(diagnosis)))
        parts += [Text(note, "dim") for note in diagnosis.notes]
        if self.design is not None:
            said = f"To distinguish them, play and log {next_motion.FILE} ({self.design.t[-1]:.3g} s)"
            said += f", then diagnose both logs together. {CAUTION}"
            parts.append(Text(f"Some causes remain ambiguous. {said}"))
        else:
            parts += [Text(line) for line in advised(diagnosis)]
        return Group(*parts)

    def save(self, folder: str | Path, progress: Progress = silent, helper: Executor | None = None) -> None:
        """Write all files of `invdyn diagnose` into the folder: diagnosis.json, the page with its figures, the extended
        model as JSON, URDF and MJCF, and what to record next. Of an unusable log there is no model. A process of
        `helper` draws half of the figures."""
        folder, diagnosis = Path(folder), self.diagnosis
        folder.mkdir(parents=True, exist_ok=True)
        for name in (DIAGNOSIS, MODEL, REPORT, URDF, MJCF, next_motion.FILE):
            (folder / name).unlink(missing_ok=True)
        files, lacks = {"report": REPORT}, {}
        if diagnosis.model is not None:
            store.write_model(diagnosis.model, folder / MODEL)
            more, lacks = _write_simulations(exported(diagnosis.model), folder)
            files = {"model": MODEL, **more, **files}
        if (design := self.design) is not None:
            write_csv(folder / next_motion.FILE, design.t, np.asarray(design.motion.q), design.robot.joints)
            files["trajectory"] = next_motion.FILE
        figures = folder / "figures"
        drawn = diagnosis_figures.draw_all(diagnosis, figures, helper=helper) if diagnosis.signals is not None else []
        progress(0.9, "report")
        trajectory = files.get("trajectory", "")
        diagnosis_page.write_report(diagnosis, self.robot.name, drawn, folder / REPORT, lacks, trajectory)
        store.write_diagnosis(diagnosis, folder / DIAGNOSIS, files)
        progress(1.0, "done")


def _write_simulations(export: Export, folder: Path) -> tuple[dict[str, str], dict[str, Sequence[str]]]:
    """The files for simulators, and what each of them does not contain."""
    files, lacks = {}, {}
    for kind, name, text, said in (
        ("urdf", URDF, export.urdf, export.urdf_lacks),
        ("mjcf", MJCF, export.mjcf, export.mjcf_lacks),
    ):
        if text:
            write_file(folder / name, text)
            files[kind], lacks[name] = name, said
    return files, lacks


def diagnose(
    log: LogLike | None = None,
    robot: RobotLike | None = None,
    *,
    reference: LogLike | None = None,
    options: Options = USUAL,
    design: bool = True,
    learner: AbstractModel | None = None,
    seed: int = 0,
    progress: Progress = silent,
    **arrays: Unpack[Arrays],
) -> DiagnosisResult:
    """What the nominal model of a robot gets wrong on a recording, why, and how much each correction improves it.

    Args:
        log: a log or the path of a file in any format; or arrays: `q=, tau=, t=, urdf=` as in `from_arrays`.
        robot: a robot or the path of its URDF; None: the one that the log names.
        reference: an earlier log of the same robot: only what has changed since is looked for.
        options: causes that are known, the largest number of causes, rates and filters, replay.
        design: whether a motion is designed that distinguishes ambiguous causes.
        learner: a model that is fitted to the residual; None: small networks.
        seed: of the learner and the design.
        progress: called with the share that is done and a note.

    Raises:
        UsageError, LogError, RobotError: for what cannot be read, or does not belong together.
    """
    found = log_of(log, **arrays)
    nominal = robot_of(robot, found, arrays)
    if nominal is None:
        got = "a diagnosis needs the robot's kinematics, and the log names no URDF"
        raise UsageError(got, advice="diagnose(log, 'arm.urdf'), or urdf='arm.urdf' with arrays")
    notes: list[str] = []
    return explain(
        ordered(found, nominal, notes),
        nominal,
        reference=None if reference is None else ordered(log_of(reference), nominal, []),
        options=options,
        design=design,
        learner=learner,
        seed=seed,
        progress=progress,
        notes=[*(f"robot: {x}" for x in nominal.notes), *(f"data: {x}" for x in notes)],
    )


def explain(
    log: Log,
    robot: Robot,
    *,
    windows: Mapping[str, Sequence[Window]] | None = None,
    reference: Log | None = None,
    options: Options = USUAL,
    effects: Mapping[str, AbstractEffect] = EFFECTS,
    learner: AbstractModel | None = None,
    design: bool = True,
    seed: int = 0,
    progress: Progress = silent,
    designing: Progress = silent,
    notes: Sequence[str] = (),
) -> DiagnosisResult:
    """Diagnose a log whose columns are in the robot's order, and design what to record next; arguments as in
    `diagnosis.diagnose`, `notes` what the reader should know of the data."""
    diagnosis = steps.diagnose(
        log,
        robot,
        windows=windows,
        reference=reference,
        options=options,
        effects=effects,
        learner=learner,
        seed=seed,
        progress=progress,
    )
    made = None
    if design:
        diagnosis, made = next_motion.after(diagnosis, robot, seed=seed, progress=designing)
    return DiagnosisResult(diagnosis, robot, made, tuple(notes))
