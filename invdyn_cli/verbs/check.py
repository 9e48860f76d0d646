"""invdyn check: the checks of a measured log, as a table, as check.json and as a page."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from omegaconf import DictConfig

from invdyn_cli.compiled import use_compilation_cache
from invdyn_cli.errors import UsageError
from invdyn_cli.files import relative
from invdyn_cli.functions import checking
from invdyn_cli.interfaces import AbstractSource
from invdyn_cli.logfile import write_log
from invdyn_cli.verbs import imports, screen
from invdyn_cli.verbs.launch import in_sweep, job, launch
from invdyn_cli.verbs.run import make_log_source, make_robot, refuse_flags
from invdyn_cli.verbs.screen import Screen


def main(argv: Sequence[str]) -> int:
    """Run with the overrides in argv; the exit code."""
    return launch("check", argv, task)


def task(config: DictConfig) -> None:
    """Read, examine, write and report; exit code 1 if a check failed under strict=true."""
    refuse_flags(config, "strict", "correct")
    source = make_log_source(config)
    refuse_target(config, source)
    folder, console = Path(job().runtime.output_dir), Screen()
    use_compilation_cache()
    robot = make_robot(config, source.header(), optional=not source.needs_robot, console=console)
    with screen.stages() as stage:
        found = source.recorded(robot, stage("read"))
    maps = imports.show_all(source, console)
    with screen.stages() as stage:
        report = stage("check")
        report(0.0, f"{len(found.log.trajectories)} trajectories")
        result = checking.examine(found.log, robot, correct=config.correct)
        notes = (*found.notes, *written(result, config))
        page = result.save(folder, report)
    imports.keep(maps, folder, console)
    console.print(replace(result, notes=(*result.notes, *notes)))
    console.whole(f"page: {relative(folder) / page.name}")
    console.whole(relative(folder))
    if config.strict and not in_sweep() and any(one.severity == "fail" for one in result.checks):
        raise SystemExit(1)


def refuse_target(config: DictConfig, source: AbstractSource) -> None:
    """Raise a UsageError if `write` is not the path of a new log."""
    if config.write is None:
        return
    if not config.correct:
        raise UsageError(f"write={config.write} needs correct=true", advice="correct=true, or no write=")
    target = Path(str(config.write)).expanduser()
    sources = {Path(str(x)).expanduser().resolve() for x in getattr(source, "path", ())}
    if not isinstance(config.write, str) or target.suffix not in (".h5", ".hdf5"):
        raise UsageError(f"write={config.write}; allowed: the path of a new log, NAME.h5")
    if target.resolve() in sources:
        raise UsageError(f"write={config.write} is the log itself; allowed: the path of a new log")


def written(result: checking.CheckResult, config: DictConfig) -> tuple[str, ...]:
    """Write the corrected log if it is asked for, with the corrections as its history. If there are several logs, they
    become one, with LOG/NAME called LOG.NAME. Returns a sentence on the result.

    Raises:
        LogError: if it cannot be written.
    """
    if config.write is None:
        return ()
    if not result.usable:
        return (f"{config.write} was not written: the log is not usable, even after correction",)
    target, log = Path(config.write).expanduser(), result.corrected
    named = tuple(replace(one, name=one.name.replace("/", ".")) for one in log.trajectories)
    history = (*log.history, *(f"invdyn check: {one}" for one in result.corrections))
    write_log(replace(log, trajectories=named, history=history), target)
    count = len(result.corrections)
    return (f"{count} {'correction' if count == 1 else 'corrections'} written into {target}",)
