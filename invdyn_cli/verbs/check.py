"""invdyn check: what the doctor says of a measured log, as a table, as check.json and as a page."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any

from omegaconf import DictConfig
from rich import box
from rich.console import Console, ConsoleOptions, Group, RenderResult
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from invdyn_cli import store
from invdyn_cli.data.recorded import RealLog
from invdyn_cli.data.selection import SETS
from invdyn_cli.diagnosis import doctor
from invdyn_cli.diagnosis.marks import located
from invdyn_cli.errors import UsageError, listed
from invdyn_cli.logfile import Log, write_log
from invdyn_cli.report import check_figures, check_page
from invdyn_cli.report.checked_log import CheckedLog
from invdyn_cli.report.tables import significant
from invdyn_cli.types import Check, Examination, Header
from invdyn_cli.verbs import imports, raw, screen
from invdyn_cli.verbs.launch import in_sweep, instantiate, job, launch
from invdyn_cli.verbs.run import make_robot
from invdyn_cli.verbs.screen import Screen

STYLE = {"fail": "bold red", "warn": "yellow", "note": "cyan", "skipped": "dim", "ok": "green"}
REPORT = "report.html"
MOST = 3
"""Lines of one check and severity on the screen; the file has them all."""


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
    notes = list(robot.notes) if robot else ["no robot: what needs its kinematics was not looked at"]
    log = raw.merged(logs, robot, notes)
    with screen.stages() as stage:
        report = stage("check")
        report(0.0, f"{len(log.trajectories)} trajectories")
        corrected, examination, marks = located(log, robot, correct=config.correct)
        report(0.8, "report")
        page = draw(CheckedLog(log, corrected, marks, robot), examination, folder, notes)
        report(1.0, "done")
    if config.write is not None and not examination.usable:
        notes.append(f"{config.write} is not written: the log is not usable, corrected either")
    elif config.write is not None:
        done = doctor.done(examination)
        notes.append(f"{len(done)} corrections written into {write(corrected, done, config)}")
    store.write_check(examination, folder / "check.json")
    imports.keep(maps, folder, console)
    for note in notes:
        console.note(note)
    console.print(shown(examination))
    console.whole(f"page: {relative(folder) / page.name}")
    console.whole(relative(folder))
    if config.strict and not in_sweep() and any(one.severity == "fail" for one in examination.checks):
        raise SystemExit(1)


def draw(checked: CheckedLog, examination: Examination, folder: Path, notes: Sequence[str]) -> Path:
    """Write figures/*.png and report.html into the folder: the page's path."""
    figures, lacking = check_figures.draw_all(checked, folder / "figures")
    return check_page.write_page(examination, checked.log, checked.robot, figures, folder / REPORT, [*notes, *lacking])


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


def write(log: Log, corrections: Sequence[str], config: DictConfig) -> Path:
    """Write the corrected log, what was corrected as its history; of several logs one, LOG/NAME called LOG.NAME.

    Raises:
        LogError: if it cannot be written.
    """
    target = Path(config.write).expanduser()
    named = tuple(replace(one, name=one.name.replace("/", ".")) for one in log.trajectories)
    history = (*log.history, *(f"invdyn check: {one}" for one in corrections))
    write_log(replace(log, trajectories=named, history=history), target)
    return target


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


def shown(examination: Examination) -> Group:
    """What is not ok, what was skipped and why, what can be corrected, what the log excites; folds at any width."""
    parts: list[Any] = []
    seen = [one for one in examination.checks if one.severity not in ("ok", "skipped")]
    for (severity, name), group in groupby(seen, key=lambda one: (one.severity, one.check)):
        lines = list(group)
        parts.append(Text.assemble((severity, STYLE[severity]), f"  {name}"))
        for one in lines[:MOST]:
            what = f"{_where(one)}: {one.seen}" + (f": {one.meaning}" if one.meaning else "")
            parts.append(Padding(Text(what), (0, 0, 0, 2)))
            if one.advice:
                parts.append(Padding(Text(f"-> {one.advice}"), (0, 0, 0, 4)))
        if len(lines) > MOST:
            parts.append(Padding(Text(f"and {len(lines) - MOST} more, see check.json"), (0, 0, 0, 2)))
    skipped: dict[str, dict[str, None]] = {}
    for one in examination.checks:
        if one.severity == "skipped":
            skipped.setdefault(one.seen, {})[one.check] = None
    parts += [Text.assemble(("skipped", STYLE["skipped"]), f"  {', '.join(x)}: {why}") for why, x in skipped.items()]
    quiet = dict.fromkeys(one.check for one in examination.checks if one.severity == "ok")
    if quiet:
        parts.append(Text(f"ok ({len(quiet)}): {', '.join(quiet)}", STYLE["ok"]))
    notes = doctor.done(examination)
    parts += [Text(f"correctable: {note}") for note in notes[: 3 * MOST]]
    if len(notes) > 3 * MOST:
        parts.append(Text(f"correctable: {len(notes) - 3 * MOST} more"))
    if examination.excitation:
        parts.append(ExcitationTable(examination))
    word = ("usable", STYLE["ok"]) if examination.usable else ("not usable", STYLE["fail"])
    once = " once it is corrected." if notes and examination.usable else "."
    return Group(*parts, Text.assemble("The log is ", word, once))


@dataclass(frozen=True)
class ExcitationTable:
    """One line a joint: how it moves, and the effects that this log cannot show on it. Two tables where one is too
    wide: no number is cut and no column is lost."""

    examination: Examination

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        tables = self._tables([range(8)])
        if tables[0].__rich_measure__(console, options.update(max_width=10_000)).minimum > options.max_width:
            tables = self._tables([range(4), range(4, 8)])
        yield from tables

    def _tables(self, parts: Sequence[Sequence[int]]) -> list[Table]:
        heads = ("q", "max |qd|", "max |qdd|", "tau", "reversals", "rest %", "slow %", "cannot show")
        excitation = self.examination.excitation
        condition = next(iter(excitation.values())).get("condition")
        known = "" if condition is None else f"condition of the regressor {significant(condition)}; "
        tables = []
        for part in parts:
            below = f"{known}q in rad or m, tau in N m or N" if part is parts[-1] else None
            table = Table(box=box.SIMPLE_HEAD, pad_edge=False, caption=below)
            table.add_column("joint", overflow="fold", min_width=10)
            for k in part:
                words = heads[k] == "cannot show"
                cells = [heads[k], *(_row(x)[k] for x in excitation.values())]
                width = 24 if words else max(map(len, cells))
                justify = "left" if words else "right"
                table.add_column(heads[k], justify=justify, overflow="fold", min_width=width, no_wrap=not words)
            for joint, x in excitation.items():
                table.add_row(Text(joint), *(Text(_row(x)[k]) for k in part))
            tables.append(table)
        return tables


def _row(x: Mapping[str, Any]) -> tuple[str, ...]:
    """The cells of a joint."""
    return (
        " … ".join(map(significant, x["q"])),
        significant(max(map(abs, x["qd"]))),
        significant(max(map(abs, x["qdd"]))),
        " … ".join(map(significant, x["torque"])),
        str(x["reversals"]),
        f"{100 * x['rest_share']:.0f}",
        f"{100 * x['slow_share']:.0f}",
        listed(x["cannot_show"], most=2) if x["cannot_show"] else "-",
    )


def _where(one: Check) -> str:
    return " ".join(x for x in (one.trajectory, one.joint) if x) or "whole log"


def relative(folder: Path) -> Path:
    """The folder as it is called from here."""
    return folder.relative_to(Path.cwd()) if folder.is_relative_to(Path.cwd()) else folder
