"""invdyn control: a learned feedforward in the control loop of the simulated arm, from stiff feedback to soft."""

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from invdyn_cli import control
from invdyn_cli.compiled import use_compilation_cache
from invdyn_cli.control import ControlRecord, Sweep
from invdyn_cli.data.tasks import AbstractTaskSource
from invdyn_cli.errors import UsageError
from invdyn_cli.files import relative, write_file
from invdyn_cli.interfaces import AbstractAdapter, AbstractModel
from invdyn_cli.report import control_page, controlled
from invdyn_cli.verbs import screen
from invdyn_cli.verbs.launch import job, launch
from invdyn_cli.verbs.objects import instantiate, target_of
from invdyn_cli.verbs.run import make_object, make_robot, refuse_options
from invdyn_cli.verbs.screen import Screen


def main(argv: Sequence[str]) -> int:
    """Control with the overrides in argv; the exit code."""
    return launch("control", argv, task)


def task(config: DictConfig) -> None:
    """One job."""
    execute(config, Path(job().runtime.output_dir), Screen())


def execute(config: DictConfig, folder: Path, console: Screen) -> ControlRecord:
    """Config -> objects -> the arm in closed loop -> files in `folder`; prints the result on `console`."""
    use_compilation_cache()
    refuse_options(config)
    target = f"{Sweep.__module__}.{Sweep.__name__}"
    sweep: Sweep = instantiate(
        OmegaConf.create({"_target_": target, **{f.name: config[f.name] for f in fields(Sweep)}})
    )
    kind = target_of(config.data)
    if isinstance(kind, type) and not issubclass(kind, AbstractTaskSource):
        raise UsageError(f"{config.data._target_} has no task for the arm; allowed: data=pick_place")
    source = make_object(config, "data", AbstractTaskSource)
    model = make_object(config, "model", AbstractModel)
    adaptation = make_object(config, "adaptation", AbstractAdapter)
    robot = make_robot(config, None, optional=False, console=console)
    assert robot is not None  # make_robot refuses a source that brings none
    with screen.stages(quiet=console.quiet) as stage:
        record = control.run(source, model, adaptation, robot, sweep, seed=config.seed, stage=stage)
    choices = {name: job().runtime.choices.get(name) for name in ("model", "data", "adaptation", "robot")}
    write(record, {**choices, "seed": config.seed, "data_seed": source.seed}, folder, tuple(config.figures.formats))
    for note in robot.notes:
        console.note(f"robot: {note}")
    console.print(controlled.table(record))
    for line in controlled.sentences(record):
        console.print(line)
    for warning in record.warnings:
        console.warn(warning)
    console.whole(relative(folder))
    return record


def write(record: ControlRecord, choices: dict, folder: Path, formats: Sequence[str] = ()) -> None:
    """control.csv, figures/control.png, report.html and, last, control.json."""
    write_file(folder / "control.csv", controlled.as_csv(record))
    named = f"{choices['model']}, {choices['adaptation']}"
    controlled.draw(record, named, [folder / "figures" / f"control.{x}" for x in sorted({"png", *formats})])
    write_file(folder / "report.html", control_page.page(record, choices, folder / "figures" / "control.png"))
    write_file(folder / "control.json", controlled.as_json(record, choices))
