"""invdyn diagnose on real robots' logs: what it names, with which numbers, and what that is worth on held-out data.

    python experiments/real_diagnosis.py [only=panda,ur10e] [data=../shared/data] [folder=outputs/real_diagnosis]
                                         [docs=false]

The logs are not part of the project; they are looked for in `data`, else in INVDYN_REAL_DATA, else in ../shared/data,
and what is not there is left out with a word. Every diagnosis is that of the command line with these overrides; its
files (report.html, diagnosis.json, figures/) lie in a folder of its own, and summary.md holds the tables of all.
docs=true puts the short table into experiments/real_diagnosis.md.
"""

import math
import os
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from hydra import compose, initialize_config_dir

from experiments.marked import ROOT, put
from experiments.options import only_of, options_of
from invdyn_cli.errors import InvdynError
from invdyn_cli.report.tables import significant
from invdyn_cli.report.wording import VERDICT_WORDS, capital, cause, claims, estimates, joints_of, place, words
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
    """A job with its diagnosis and the seconds that it took, files and all."""

    job: Job
    diagnosis: Diagnosis
    seconds: float


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


@dataclass(frozen=True)
class Options:
    """What the command line may say."""

    only: Sequence[str] = tuple(JOBS)
    data: str = os.environ.get("INVDYN_REAL_DATA", "../shared/data")
    folder: str = "outputs/real_diagnosis"
    seed: int = 0
    docs: bool = False


def run(job: Job, data: Path, folder: Path, console: Screen, seed: int = 0) -> Done:
    """The diagnosis of one job, told on the console, its files in `folder`."""
    overrides = ["data=real_log", f"data.path='{data / job.log}'", *job.overrides, f"seed={seed}"]
    with initialize_config_dir(str(config_folder()), version_base="1.3"):
        config = compose("diagnose", overrides)
    started = time.perf_counter()
    diagnosis = diagnose.execute(config, folder, console)
    return Done(job, diagnosis, time.perf_counter() - started)


def mass_of(diagnosis: Diagnosis) -> float | None:
    """The payload's mass [kg], None where no payload was found."""
    return next((float(f.parameters["mass"].value) for f in claims(diagnosis) if f.effect == "payload"), None)


def section(done: Done) -> str:
    """A diagnosis as Markdown: verdict, findings, errors per joint."""
    diagnosis = done.diagnosis
    lines = [f"## {done.job.title}", "", diagnosis.summary, f"{done.seconds:.0f} s.", ""]
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


def short(all_done: Sequence[Done]) -> str:
    """A row per log as Markdown: verdict, what was claimed, held-out RMSE over all joints before and after."""
    lines = ["| log | verdict | named | ambiguous | RMSE nominal | extended | noise floor | s |"]
    lines.append("|---|---|---|---|---:|---:|---:|---:|")
    for done in all_done:
        d, said = done.diagnosis, {}
        for status in ("named", "ambiguous"):
            found = [f"{words(f.effect)} ({place(f)})" for f in claims(d) if f.status == status]
            said[status] = "; ".join(found) or "-"
        errors = [_over_joints(x) for x in (d.baseline, d.extended, d.noise_floor or {})]
        cells = [done.job.title, VERDICT_WORDS[d.verdict], *said.values(), *map(significant, errors)]
        lines.append(f"| {' | '.join(cells)} | {done.seconds:.0f} |")
    return "\n".join(lines)


def _over_joints(errors: Mapping[str, Mapping[str, float]]) -> float | None:
    """RMS of the joints' RMSE [N m]."""
    squares = [x["rmse"] ** 2 for x in errors.values()]
    return (sum(squares) / len(squares)) ** 0.5 if squares else None


def masses(all_done: Sequence[Done]) -> str:
    """The masses found beside those that were put on, and their ratio; nothing where there are none."""
    loaded = [d for d in all_done if d.job.mass is not None]
    if not loaded:
        return ""
    lines = [f"| log | true [kg] | found [kg] | found times {LOW} [kg] |", "|---|---:|---:|---:|"]
    found = [mass_of(d.diagnosis) for d in loaded]
    for d, mass in zip(loaded, found, strict=True):
        shown = "no payload | -" if mass is None else f"{mass:.3f} | {LOW * mass:.3f}"
        lines.append(f"| {d.job.title} | {d.job.mass:.3f} | {shown} |")
    if len(loaded) == 2 and None not in found:
        true = loaded[1].job.mass / loaded[0].job.mass
        lines += ["", f"Ratio {found[1] / found[0]:.3f}; true {true:.3f}. The drive gains cancel in it."]
    return "\n".join([*lines, ""])


def main(argv: Sequence[str]) -> int:
    """Run as the docstring says."""
    options = options_of(argv, Options(), __doc__)
    data, folder = Path(options.data), Path(options.folder)
    console, all_done = Screen(width=120), []
    for name in only_of("only", options.only, JOBS):
        job = JOBS[name]
        console.rule(job.title)
        if not (data / job.log).is_file():
            console.print(f"left out: no {data / job.log}; INVDYN_REAL_DATA=FOLDER of the logs")
            continue
        try:
            all_done.append(run(job, data, folder / name, console, options.seed))
        except InvdynError as error:
            console.print(f"left out: {error}")
            continue
        console.print(f"{all_done[-1].seconds:.0f} s")
    if not all_done:
        return 0
    text = "\n".join([short(all_done), "", *map(section, all_done), "## Masses", "", masses(all_done)])
    (folder / "summary.md").write_text(text)
    if options.docs:
        put(ROOT / "experiments" / "real_diagnosis.md", "found", f"{short(all_done)}\n\n{masses(all_done)}")
    console.print(masses(all_done))
    console.print(str(folder / "summary.md"))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
