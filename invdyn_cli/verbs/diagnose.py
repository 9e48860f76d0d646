"""invdyn diagnose: what a simulation gets wrong on a log, as tables, diagnosis.json, a report and the better model."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np
from omegaconf import DictConfig, ListConfig, OmegaConf

from invdyn_cli import store
from invdyn_cli.design import next_motion
from invdyn_cli.design.trajectory import Design
from invdyn_cli.diagnosis import Options, diagnose
from invdyn_cli.diagnosis.columns.recording import Conditioning
from invdyn_cli.diagnosis.extension import Export, exported
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.errors import UsageError
from invdyn_cli.files import write_file
from invdyn_cli.interfaces import (
    AbstractBodyEffect,
    AbstractChannelEffect,
    AbstractEffect,
    AbstractForceEffect,
    AbstractGearEffect,
    AbstractModel,
    AbstractMotionEffect,
    AbstractTorqueEffect,
    Progress,
    silent,
)
from invdyn_cli.report import diagnosis_figures, diagnosis_page, diagnosis_tables
from invdyn_cli.report.better_simulation import replay_line
from invdyn_cli.simulation.played import write_csv
from invdyn_cli.types import Diagnosis
from invdyn_cli.verbs import check, imports, screen
from invdyn_cli.verbs.launch import in_sweep, instantiate, job, launch
from invdyn_cli.verbs.material import material_of
from invdyn_cli.verbs.run import make_robot, refuse_seed
from invdyn_cli.verbs.screen import Screen

DIAGNOSIS, MODEL, REPORT = "diagnosis.json", "extended_model.json", "report.html"
URDF, MJCF = "extended_model.urdf", "extended_model.mjcf.xml"
"""What the files are called; diagnosis.json is written last: where it is, the diagnosis is complete."""

KINDS = (
    AbstractTorqueEffect,
    AbstractChannelEffect,
    AbstractBodyEffect,
    AbstractMotionEffect,
    AbstractGearEffect,
    AbstractForceEffect,
)


def main(argv: Sequence[str]) -> int:
    """Run with the overrides in argv; the exit code."""
    return launch("diagnose", argv, task)


def task(config: DictConfig) -> None:
    """One diagnosis; exit code 1 where a check of the log failed under strict=true."""
    if not isinstance(config.strict, bool):
        raise UsageError(f"strict={config.strict}; allowed: true or false")
    diagnosis = execute(config, Path(job().runtime.output_dir), Screen())
    failed = any(one.severity == "fail" for one in diagnosis.examination.checks)
    if config.strict and not in_sweep() and failed:
        raise SystemExit(1)


def execute(config: DictConfig, folder: Path, console: Screen) -> Diagnosis:
    """Config -> objects -> diagnosis -> files in `folder`; tells the result on `console`."""
    screen.use_compilation_cache()
    options, effects, learner = options_of(config), effects_of(config), learner_of(config)
    if not isinstance(config.diagnosis.design, bool):
        raise UsageError(f"diagnosis.design={config.diagnosis.design}; allowed: true or false")
    refuse_seed(config.seed)
    if config.data is None or "_target_" not in config.data:
        raise UsageError(f"data={config.data}; allowed: real_log, plant")
    source = instantiate(config.data)
    with screen.stages(quiet=console.quiet) as stage:
        stage("read")
        brought = material_of(source)
    maps = imports.show_all(source, console)
    robot = make_robot(config, brought.header(), optional=False, console=console)
    if robot is None:
        got = "a diagnosis needs the robot's kinematics, and these data bring no URDF"
        raise UsageError(got, advice="robot=urdf robot.path=arm.urdf")
    for note in robot.notes:
        console.note(f"robot: {note}")
    with screen.stages(quiet=console.quiet) as stage:
        material = brought.material(robot, stage("data"))
        diagnosis = diagnose(
            material.log,
            robot,
            windows=material.windows,
            reference=material.reference,
            options=options,
            effects=effects,
            learner=learner,
            seed=config.seed,
            progress=stage("diagnose"),
        )
        design = None
        if config.diagnosis.design:
            diagnosis, design = next_motion.after(diagnosis, robot, seed=config.seed, progress=stage("next"))
        write(diagnosis, robot.name, folder, stage("write"), design)
    imports.keep(maps, folder, console)
    for note in material.notes:
        console.note(f"data: {note}")
    show(diagnosis, console)
    if design is not None:
        console.print(
            f"Some causes remain ambiguous. To distinguish them, play and log {next_motion.FILE} "
            f"({design.t[-1]:.3g} s), then diagnose both logs together."
        )
    console.whole(check.relative(folder))
    return diagnosis


def write(
    diagnosis: Diagnosis, robot_name: str, folder: Path, progress: Progress = silent, design: Design | None = None
) -> None:
    """All files of a diagnosis; of a log that is unusable there is no model, and nothing to draw. `design` is what to
    record next."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in (DIAGNOSIS, MODEL, REPORT, URDF, MJCF, next_motion.FILE):
        (folder / name).unlink(missing_ok=True)
    files, lacks = {"report": REPORT}, {}
    if diagnosis.model is not None:
        store.write_model(diagnosis.model, folder / MODEL)
        more, lacks = _write_simulations(exported(diagnosis.model), folder)
        files = {"model": MODEL, **more, **files}
    if design is not None:
        write_csv(folder / next_motion.FILE, design.t, np.asarray(design.motion.q), design.robot.joints)
        files["trajectory"] = next_motion.FILE
    drawn = diagnosis_figures.draw_all(diagnosis, folder / "figures") if diagnosis.signals is not None else []
    progress(0.9, "report")
    diagnosis_page.write_report(diagnosis, robot_name, drawn, folder / REPORT, lacks, files.get("trajectory", ""))
    store.write_diagnosis(diagnosis, folder / DIAGNOSIS, files)
    progress(1.0, "done")


def _write_simulations(export: Export, folder: Path) -> tuple[dict[str, str], dict[str, Sequence[str]]]:
    """The files for simulators, and what each of them does not hold."""
    files, lacks = {}, {}
    for kind, name, text, said in (
        ("urdf", URDF, export.urdf, export.urdf_lacks),
        ("mjcf", MJCF, export.mjcf, export.mjcf_lacks),
    ):
        if text:
            write_file(folder / name, text)
            files[kind], lacks[name] = name, said
    return files, lacks


def show(diagnosis: Diagnosis, console: Screen) -> None:
    """The verdict, the causes, the errors, what the user should know; the doctor's words where the log is unusable."""
    console.print(diagnosis_tables.verdict_line(diagnosis))
    if diagnosis.verdict == "log_unusable":
        console.print(check.shown(diagnosis.examination))
    else:
        console.print(diagnosis_tables.finding_table(diagnosis))
        usual = diagnosis_tables.standard_table(diagnosis)
        if usual is not None:
            console.print(usual)
        console.print(diagnosis_tables.error_table(diagnosis))
    if diagnosis.replay is not None:
        console.print(replay_line(diagnosis))
    for note in diagnosis.notes:
        console.note(note)


def options_of(config: DictConfig) -> Options:
    """What config.diagnosis says of causes and conditioning.

    Raises:
        UsageError: for what is out of range.
    """
    node = config.diagnosis
    if node.most is not None and (not isinstance(node.most, int) or isinstance(node.most, bool) or node.most < 0):
        raise UsageError(f"diagnosis.most={node.most}; allowed: a whole number from 0 up, or null")
    if not isinstance(node.replay, bool):
        raise UsageError(f"diagnosis.replay={node.replay}; allowed: true or false")
    conditioning = instantiate(node.conditioning)
    if not isinstance(conditioning, Conditioning):
        raise UsageError(f"diagnosis.conditioning makes a {type(conditioning).__name__}; allowed: a Conditioning")
    for one in fields(Conditioning):
        values = getattr(conditioning, one.name)
        several = values if isinstance(values, list | tuple) else [values]
        high = 1.0 if one.name == "train_share" else float("inf")
        if not several or not all(isinstance(x, int | float) and 0 < x < high for x in several):
            shared = config.data is not None and config.data.get(one.name) == values
            name = f"data.{one.name}" if shared else f"diagnosis.conditioning.{one.name}"
            raise UsageError(f"{name}={values}; allowed: above 0" + ", below 1" * (high == 1))
    known = node.known
    listed_ones = OmegaConf.to_container(known, resolve=True) if isinstance(known, ListConfig | DictConfig) else known
    if isinstance(listed_ones, str | Mapping):
        listed_ones = [listed_ones]
    if not isinstance(listed_ones, list):
        raise UsageError(f"diagnosis.known={known}; allowed: a list of effect, effect@joint, {{effect, joint, …}}")
    return Options(known=listed_ones, most=node.most, conditioning=conditioning, replay=node.replay)


def effects_of(config: DictConfig) -> dict[str, AbstractEffect]:
    """The catalogue and, beside it, the user's own effects; one of a catalogue's name takes its place."""
    nodes = config.diagnosis.effects
    made: dict[str, AbstractEffect] = dict(EFFECTS)
    if not isinstance(nodes, ListConfig):
        raise UsageError(f"diagnosis.effects={nodes}; allowed: a list of {{_target_: module.Class, …}}")
    for node in nodes:
        if not isinstance(node, DictConfig) or "_target_" not in node:
            raise UsageError(f"diagnosis.effects has {node}; allowed: {{_target_: module.Class, …}}")
        effect = instantiate(node)
        if not isinstance(effect, KINDS):
            kinds = ", ".join(kind.__name__ for kind in KINDS)
            raise UsageError(f"diagnosis.effects: {node._target_} gives a {type(effect).__name__}; allowed: {kinds}")
        made[effect.name] = effect
    return made


def learner_of(config: DictConfig) -> AbstractModel | None:
    """The model that measures what is left; None: the built-in nets."""
    node = config.diagnosis.learner
    if node is None:
        return None
    if not isinstance(node, DictConfig) or "_target_" not in node:
        raise UsageError(f"diagnosis.learner={node}; allowed: null, a model", advice="model@diagnosis.learner=ffnn")
    learner = instantiate(node)
    if not isinstance(learner, AbstractModel):
        got = f"diagnosis.learner: {node._target_} gives a {type(learner).__name__}"
        raise UsageError(f"{got}; allowed: an AbstractModel", advice="model@diagnosis.learner=ffnn")
    return learner
