"""invdyn check: what the doctor says of a measured log, as a table, as check.json and as a page."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from omegaconf import DictConfig

from invdyn_cli.data import raw
from invdyn_cli.data.recorded import RealLog
from invdyn_cli.data.selection import SETS
from invdyn_cli.errors import UsageError
from invdyn_cli.functions import checking
from invdyn_cli.logfile import Log, write_log
from invdyn_cli.types import Header
from invdyn_cli.verbs import imports, screen
from invdyn_cli.verbs.launch import in_sweep, instantiate, job, launch
from invdyn_cli.verbs.run import make_robot
from invdyn_cli.verbs.screen import Screen


def main(argv: Sequence[str]) -> int:
    """Run with the overrides in argv; the exit code."""
    return launch("check", argv, task)


def task(config: DictConfig) -> None:
    """Read, examine, write, tell; exit code 1 where a check failed under strict=true."""
    for option in ("strict", "correct"):
        if not isinstance(config[option], bool):
            raise UsageError(f"{option}={config[option]}; allowed: true or false")
    refuse_target(config)
    folder, console = Path(job().runtime.output_dir), Screen()
    screen.use_compilation_cache()
    source = raw.refuse_other(instantiate(config.data))
    with screen.stages() as stage:
        stage("read")
        logs = read(source)
    maps = imports.show_all(source, console)
    header = Header(logs[0].robot, logs[0].joints, next((log.urdf for log in logs if log.urdf), ""))
    robot = make_robot(config, header, optional=True, console=console)
    with screen.stages() as stage:
        report = stage("check")
        report(0.0, f"{sum(len(log.trajectories) for log in logs)} trajectories")
        result = checking.examine(logs, robot, correct=config.correct)
        notes = written(result, config)
        page = result.save(folder, report)
    imports.keep(maps, folder, console)
    console.print(replace(result, notes=(*result.notes, *notes)))
    console.whole(f"page: {relative(folder) / page.name}")
    console.whole(relative(folder))
    if config.strict and not in_sweep() and any(one.severity == "fail" for one in result.checks):
        raise SystemExit(1)


def refuse_target(config: DictConfig) -> None:
    """Raise a UsageError where `write` is no new log."""
    if config.write is None:
        return
    if not config.correct:
        raise UsageError(f"write={config.write} needs correct=true", advice="leave one of both out")
    target = Path(str(config.write)).expanduser()
    sources = {Path(str(x)).expanduser().resolve() for x in raw.refuse_other(instantiate(config.data)).path}
    if not isinstance(config.write, str) or target.suffix not in (".h5", ".hdf5"):
        raise UsageError(f"write={config.write}; allowed: the path of a new log, NAME.h5")
    if target.resolve() in sources:
        raise UsageError(f"write={config.write} is the log itself; allowed: the path of a new log")


def written(result: checking.CheckResult, config: DictConfig) -> tuple[str, ...]:
    """Write the corrected log where one is asked for, what was corrected as its history; of several logs one, LOG/NAME
    called LOG.NAME. What became of it, in a sentence.

    Raises:
        LogError: if it cannot be written.
    """
    if config.write is None:
        return ()
    if not result.usable:
        return (f"{config.write} is not written: the log is not usable, corrected either",)
    target, log = Path(config.write).expanduser(), result.corrected
    named = tuple(replace(one, name=one.name.replace("/", ".")) for one in log.trajectories)
    history = (*log.history, *(f"invdyn check: {one}" for one in result.corrections))
    write_log(replace(log, trajectories=named, history=history), target)
    return (f"{len(result.corrections)} corrections written into {target}",)


def read(source: RealLog) -> list[Log]:
    """Its logs, defects and all, with its drive gains; of the trajectories those that its selections name, all where
    there are none.

    Raises:
        LogError: if a log cannot be read, or logs have different joints.
        UsageError: if a selection cannot be read.
    """
    keys = raw.keys_of(source.path, source)
    options = SETS if raw.reference_files(source, keys) else (*SETS, "reference")
    named = {block.key for blocks in raw.asked(source, keys, options).values() for block in blocks or ()}
    return raw.read(keys, named or keys, source)


def relative(folder: Path) -> Path:
    """The folder as it is called from here."""
    return folder.relative_to(Path.cwd()) if folder.is_relative_to(Path.cwd()) else folder
