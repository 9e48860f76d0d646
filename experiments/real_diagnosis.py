"""invdyn diagnose on real robots' logs: what it names, and what that is worth on held-out data (real_diagnosis.md)."""

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from hydra import compose, initialize_config_dir

from invdyn_cli.abstract_experiment import AbstractExperiment, chosen
from invdyn_cli.errors import UsageError, listed
from invdyn_cli.files import write_file
from invdyn_cli.report.tables import significant
from invdyn_cli.report.wording import capital, cause, claims, estimates, joints_of, place, words
from invdyn_cli.types import Diagnosis
from invdyn_cli.verbs import diagnose
from invdyn_cli.verbs.launch import config_folder
from invdyn_cli.verbs.screen import Screen


@dataclass(frozen=True)
class Job:
    """One diagnosis: title, log, what the command line says of it, and the mass [kg] that was put on, if any."""

    title: str
    log: str
    overrides: Sequence[str] = ()
    mass: float | None = None


@dataclass(frozen=True)
class Done:
    """A job, its diagnosis as Markdown (a section, and a row of the table), and the masses [kg] put on and found."""

    title: str
    section: str
    row: str
    true: float | None
    found: float | None


def windows(lengths: Mapping[str, float], share: float = 0.7) -> list[str]:
    """The first share of these trajectories [s] chooses, the rest judges."""
    cuts = {name: round(share * length) for name, length in lengths.items()}
    train = ",".join(f"'{name}[:{cut}]'" for name, cut in cuts.items())
    test = ",".join(f"'{name}[{cut}:]'" for name, cut in cuts.items())
    return [f"data.train=[{train}]", f"data.test=[{test}]"]


def _speeds(*names: str) -> str:
    return ",".join(f"friction_joint_1_vel_{name}" for name in names)


JOBS: Mapping[str, Job] = {
    "lwr4": Job("LWR 4+", "kuka_lwr4.h5"),
    "panda": Job("Panda", "panda.h5"),
    "iiwa14": Job(
        "iiwa 14, dynamic",
        "iiwa14.h5",
        windows({"joint_2_to_7_dynamic_motion": 180.7, "joint_3_to_7_dynamic_motion": 63.2}),
    ),
    "iiwa14_joint_1": Job(
        "iiwa 14, joint 1 at several speeds",
        "iiwa14.h5",
        [
            f"data.train=[{_speeds('p2', 'p35', 'p4', 'p6')}]",
            f"data.test=[{_speeds('p25', 'p5')}]",
        ],
    ),
    "ur10e": Job(
        "UR10e, unloaded",
        "ur10e.h5",
        [
            "data.train=[train_20_02_05_20sec_12harm,train_20_02_05_20sec_8harm,train_20_02_06_20sec_10harm,"
            "train_20_02_06_20sec_5harm,train_20_02_10_20sec_7harm,train_20_02_10_30sec_12harm]",
            "data.test=[train_20_02_12_40sec_12harm,train_20_02_12_50sec_12harm]",
        ],
    ),
    "ur10e_pair1": Job(
        "UR10e, 1.069 kg against unloaded",
        "ur10e.h5",
        ["data.reference=[pair1_unloaded]", *windows({"pair1_loaded": 22.3})],
        mass=1.069,
    ),
    "ur10e_pair2": Job(
        "UR10e, 2.805 kg against unloaded",
        "ur10e.h5",
        ["data.reference=[pair2_unloaded]", *windows({"pair2_loaded": 55.8})],
        mass=2.805,
    ),
}
LOW = 1.15
"""The UR10e's published drive gains are low by about this factor (data README), and so are masses."""


def present(data: str, logs: Mapping[str, str]) -> list[tuple[str, str]]:
    """(name, path) of the logs that the folder `data` holds.

    Raises:
        UsageError: if it holds none.
    """
    found = [(name, str(Path(data) / log)) for name, log in logs.items() if (Path(data) / log).is_file()]
    if not found:
        raise UsageError(f"data={data} holds none of {listed(set(logs.values()))}", advice="data=FOLDER of the logs")
    return found


def mass_of(diagnosis: Diagnosis) -> float | None:
    """The payload's mass [kg], None where no payload was found."""
    return next((float(f.parameters["mass"].value) for f in claims(diagnosis) if f.effect == "payload"), None)


def section(title: str, diagnosis: Diagnosis, seconds: float) -> str:
    """A diagnosis as Markdown: verdict, findings, errors per joint."""
    lines = [f"## {title}", "", diagnosis.summary, f"{seconds:.0f} s.", ""]
    lines += [f"- {note}" for note in diagnosis.notes] + [""] * bool(diagnosis.notes)
    if claims(diagnosis):
        lines += ["| cause | joint | status | estimate [95 %] |", "|---|---|---|---|"]
    for f in claims(diagnosis):
        lines.append(f"| {capital(cause(f))} | {place(f)} | {f.status} | {'<br>'.join(estimates(f))} |")
    lines += ["", "| joint | RMSE nominal | extended | noise floor | unexplained |", "|---|---:|---:|---:|---:|"]
    for joint in joints_of(diagnosis):  # none where the log is unusable
        floor = (diagnosis.noise_floor or {}).get(joint, {}).get("rmse")
        numbers = [diagnosis.baseline[joint]["rmse"], diagnosis.extended[joint]["rmse"], floor]
        cells = " | ".join(map(significant, numbers))
        share = diagnosis.unexplained.get(joint, math.nan)
        lines.append(f"| {joint} | {cells} | {'not judged' if math.isnan(share) else f'{100 * share:.0f} %'} |")
    return "\n".join([*lines, ""])


def short(title: str, diagnosis: Diagnosis, seconds: float) -> str:
    """A row of the table: verdict, what was claimed, held-out RMSE over all joints before and after."""
    said = {}
    for status in ("named", "ambiguous"):
        found = [f"{words(f.effect)} ({place(f)})" for f in claims(diagnosis) if f.status == status]
        said[status] = "; ".join(found) or "-"
    errors = [_over_joints(x) for x in (diagnosis.baseline, diagnosis.extended, diagnosis.noise_floor or {})]
    cells = [title, diagnosis.verdict.replace("_", " "), *said.values(), *map(significant, errors)]
    return f"| {' | '.join(cells)} | {seconds:.0f} |"


def _over_joints(errors: Mapping[str, Mapping[str, float]]) -> float | None:
    """RMS of the joints' RMSE [N m]."""
    squares = [x["rmse"] ** 2 for x in errors.values()]
    return (sum(squares) / len(squares)) ** 0.5 if squares else None


def masses(rows: Sequence[Done]) -> str:
    """The masses found beside those that were put on, and their ratio; nothing where there are none."""
    loaded = [x for x in rows if x.true is not None]
    if not loaded:
        return ""
    lines = [f"| log | true [kg] | found [kg] | found times {LOW} [kg] |", "|---|---:|---:|---:|"]
    for x in loaded:
        shown = "no payload | -" if x.found is None else f"{x.found:.3f} | {LOW * x.found:.3f}"
        lines.append(f"| {x.title} | {x.true:.3f} | {shown} |")
    if len(loaded) == 2 and None not in (loaded[0].found, loaded[1].found):
        true, found = (getattr(loaded[1], name) / getattr(loaded[0], name) for name in ("true", "found"))
        lines += ["", f"Ratio {found:.3f}; true {true:.3f}. The drive gains cancel in it."]
    return "\n".join(lines)


@dataclass(frozen=True)
class RealDiagnosis(AbstractExperiment):
    """The diagnoses of the command line, each with its files in a folder of its own."""

    row: ClassVar[type] = Done
    page: ClassVar[str] = "experiments/real_diagnosis.md"

    only: Sequence[str] = ()
    data: str = "../shared/data"
    seed: int = 0

    def plan(self, rows: Sequence[Done]) -> Iterable[tuple]:
        """A job per log that is there; the others are left out."""
        wanted = {name: JOBS[name].log for name in chosen("only", self.only, JOBS)}
        return [(*one, self.seed) for one in present(self.data, wanted)]

    def run(self, folder: Path, name: str, path: str, seed: int) -> Iterable[Done]:
        """One diagnosis, shown as the command line shows it."""
        job, console, started = JOBS[name], Screen(width=120), time.perf_counter()
        overrides = ["data=real_log", f"data.path='{path}'", *job.overrides, f"seed={seed}"]
        with initialize_config_dir(str(config_folder()), version_base="1.3"):
            config = compose("diagnose", overrides)
        console.rule(job.title)
        diagnosis = diagnose.execute(config, folder / name, console)
        said = job.title, diagnosis, time.perf_counter() - started
        text = section(*said)
        write_file(folder / name / "section.md", text)
        yield Done(job.title, text, short(*said), job.mass, mass_of(diagnosis))

    def line(self, row: Done) -> str:
        """The row of the table."""
        return row.row

    def table(self, rows: Sequence[Done]) -> str:
        """A row per log, as Markdown, and the masses; folder/NAME/section.md has all findings of one."""
        lines = ["| log | verdict | named | ambiguous | RMSE nominal | extended | noise floor | s |"]
        lines += ["|---|---|---|---|---:|---:|---:|---:|", *(x.row for x in rows)]
        return "\n".join([*lines, "", masses(rows)])
