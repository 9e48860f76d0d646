"""invdyn diagnose: what a simulation gets wrong on a log, as tables, diagnosis.json, a report and the better model."""

import multiprocessing
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import fields
from functools import cache, partial
from importlib import import_module
from pathlib import Path

from omegaconf import DictConfig, ListConfig

from invdyn_cli.compiled import use_compilation_cache
from invdyn_cli.diagnosis import Options
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.errors import UsageError
from invdyn_cli.files import relative
from invdyn_cli.functions.diagnosing import REPORT, explain
from invdyn_cli.interfaces import (
    AbstractBodyEffect,
    AbstractChannelEffect,
    AbstractEffect,
    AbstractForceEffect,
    AbstractGearEffect,
    AbstractModel,
    AbstractMotionEffect,
    AbstractTorqueEffect,
)
from invdyn_cli.maths.threads import cores, takes_one_core
from invdyn_cli.recording.pieces import Preparation
from invdyn_cli.report import diagnosis_figures
from invdyn_cli.types import Diagnosis
from invdyn_cli.verbs import imports, screen, sweep
from invdyn_cli.verbs.launch import in_sweep, job, launch
from invdyn_cli.verbs.objects import instantiate, plain, refuse_other_class
from invdyn_cli.verbs.run import make_log_source, make_robot, refuse_flags, refuse_seed
from invdyn_cli.verbs.screen import Screen

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
    """One diagnosis; exit code 1 where a check of the log failed under strict=true. In a sweep a log that cannot be
    diagnosed is a row of the fleet's page, not the end."""
    refuse_flags(config, "strict", "correct")
    folder = Path(job().runtime.output_dir)
    if in_sweep():
        _one_of_many(config, folder)
        return
    diagnosis = execute(config, folder, Screen(), helped=True)
    failed = any(one.severity == "fail" for one in diagnosis.examination.checks)
    if config.strict and failed:
        raise SystemExit(1)


def _one_of_many(config: DictConfig, folder: Path) -> None:
    """A diagnosis whose folder says how it went, and of which robot and log it is."""
    number, asked = job().job.num, job().overrides.task
    paths = config.data.get("path") or job().runtime.choices.data
    log = ", ".join(map(str, paths)) if isinstance(paths, ListConfig) else str(paths)
    robot, status, message = "", "ran", ""
    sweep.keep_status(folder, number, asked, "started", robot=robot, log=log)
    try:
        header = make_log_source(config).header()
        robot = header.robot if header else ""
        execute(config, folder, Screen(quiet=True), shows=True)
    except Exception as error:
        status, message = "failed", sweep.reason("diagnose", error, folder, asked)
    sweep.keep_status(folder, number, asked, status, message, robot=robot, log=log)
    screen.tell(f"job {number} {status}: {message or log}")


@contextmanager
def _drawer(wanted: bool) -> Iterator[Executor | None]:
    """Another process, which begins with what drawing imports; None where this one shall take one core."""
    if not wanted or takes_one_core() or cores() < 2:
        yield None
        return
    with sweep.writers(1) as drawer:
        drawer.submit(import_module, diagnosis_figures.__name__)
        try:
            yield drawer
        finally:
            for process in multiprocessing.active_children():
                process.terminate()  # by itself it would finish its imports, and take half a second to end


def execute(
    config: DictConfig, folder: Path, console: Screen, *, shows: bool = False, helped: bool = False
) -> Diagnosis:
    """Config -> objects -> diagnosis -> files in `folder`; prints the result on `console`, and shows progress unless
    `console` is quiet, or always if `shows` is true; `helped`: another process draws half of the figures."""
    use_compilation_cache()
    options, effects, learner = options_of(config), effects_of(config), learner_of(config)
    refuse_flags(config, "diagnosis.design")
    refuse_seed(config.seed)
    source = make_log_source(config)
    with screen.stages(quiet=console.quiet and not shows) as stage:
        stage("read")
        header = source.header()
    maps = imports.show_all(source, console)
    robot = make_robot(config, header, optional=False, console=console)
    if robot is None:
        got = "a diagnosis needs the robot's kinematics, but these data have no URDF"
        raise UsageError(got, advice="robot=urdf robot.path=arm.urdf")
    for note in robot.notes:
        console.note(f"robot: {note}")
    with screen.stages(quiet=console.quiet and not shows) as stage:
        found = source.recorded(robot, stage("data"))
        motion = cache(partial(stage, "next motion"))  # begins with its first report
        with _drawer(helped) as drawer:  # not before the input was read: wrong input is told without it
            result = explain(
                found.log,
                robot,
                windows=found.windows,
                reference=found.reference,
                options=options,
                effects=effects,
                learner=learner,
                design=config.diagnosis.design,
                seed=config.seed,
                progress=stage("diagnose"),
                designing=lambda done, note: motion()(done, note),
                notes=[f"data: {note}" for note in found.notes],
            )
            result.save(folder, stage("write"), drawer)
    imports.keep(maps, folder, console)
    console.print(result)
    console.whole(f"page: {relative(folder) / REPORT}")
    console.whole(relative(folder))
    return result.diagnosis


def options_of(config: DictConfig) -> Options:
    """The causes and the conditioning from config.diagnosis.

    Raises:
        UsageError: for what is out of range.
    """
    node = config.diagnosis
    if node.most is not None and (not isinstance(node.most, int) or isinstance(node.most, bool) or node.most < 0):
        raise UsageError(f"diagnosis.most={node.most}; allowed: a whole number from 0 up, or null")
    refuse_flags(config, "diagnosis.replay")
    conditioning = instantiate(node.conditioning)
    if not isinstance(conditioning, Preparation):
        got = f"diagnosis.conditioning is a {type(conditioning).__name__}"
        raise UsageError(f"{got}; allowed: invdyn_cli.recording.pieces.Preparation")
    for one in fields(Preparation):
        values = getattr(conditioning, one.name)
        several = values if isinstance(values, list | tuple) else [values]
        high = 1.0 if one.name == "train_share" else float("inf")
        if not several or not all(isinstance(x, int | float) and 0 < x < high for x in several):
            shared = config.data is not None and config.data.get(one.name) == values
            name = f"data.{one.name}" if shared else f"diagnosis.conditioning.{one.name}"
            raise UsageError(f"{name}={values}; allowed: above 0" + ", below 1" * (high == 1))
    known = plain(node.known)
    if isinstance(known, str | Mapping):
        known = [known]
    if not isinstance(known, list):
        raise UsageError(f"diagnosis.known={known}; allowed: a list of effect, effect@joint, {{effect, joint, …}}")
    return Options(known=known, most=node.most, conditioning=conditioning, replay=node.replay, correct=config.correct)


def effects_of(config: DictConfig) -> dict[str, AbstractEffect]:
    """The catalogue with the user's own effects; one with the name of a catalogue's effect replaces it."""
    nodes = config.diagnosis.effects
    made: dict[str, AbstractEffect] = dict(EFFECTS)
    if not isinstance(nodes, ListConfig):
        raise UsageError(f"diagnosis.effects={nodes}; allowed: a list of {{_target_: module.Class, …}}")
    for node in nodes:
        if not isinstance(node, DictConfig) or "_target_" not in node:
            raise UsageError(f"diagnosis.effects has {node}; allowed: {{_target_: module.Class, …}}")
        effect = instantiate(node)
        refuse_other_class(effect, "diagnosis.effects", node, *KINDS)
        made[effect.name] = effect
    return made


def learner_of(config: DictConfig) -> AbstractModel | None:
    """The model that is fitted to the residual; None: the built-in networks."""
    node = config.diagnosis.learner
    if node is None:
        return None
    if not isinstance(node, DictConfig) or "_target_" not in node:
        raise UsageError(f"diagnosis.learner={node}; allowed: null, a model", advice="model@diagnosis.learner=ffnn")
    learner = instantiate(node)
    refuse_other_class(learner, "diagnosis.learner", node, AbstractModel, advice="model@diagnosis.learner=ffnn")
    return learner
