"""invdyn check: what the doctor says of a measured log, as a table and as check.json."""

from collections.abc import Iterable, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

from omegaconf import DictConfig
from rich import box
from rich.console import Group
from rich.table import Table
from rich.text import Text

from invdyn_cli import store
from invdyn_cli.data.recorded import RealLog
from invdyn_cli.data.selection import SETS
from invdyn_cli.diagnosis import doctor
from invdyn_cli.errors import UsageError, listed
from invdyn_cli.logfile import Log
from invdyn_cli.report.tables import significant
from invdyn_cli.types import Check, Examination, Header
from invdyn_cli.verbs import raw, screen
from invdyn_cli.verbs.launch import in_sweep, instantiate, job, launch
from invdyn_cli.verbs.run import make_robot
from invdyn_cli.verbs.screen import Screen

STYLE = {"fail": "bold red", "warn": "yellow", "note": "cyan", "ok": "green"}
MOST = 3
"""Lines of one check and severity on the screen; the file has them all."""


def main(argv: Sequence[str]) -> int:
    """Run with the overrides in argv; the exit code."""
    return launch("check", argv, task)


def task(config: DictConfig) -> None:
    """Read, examine, write, tell; exit code 1 where a check failed under strict=true."""
    if not isinstance(config.strict, bool):
        raise UsageError(f"strict={config.strict}; allowed: true or false")
    folder, console = Path(job().runtime.output_dir), Screen()
    screen.use_compilation_cache()
    logs = read(raw.refuse_other(instantiate(config.data)))
    header = Header(logs[0].robot, logs[0].joints, next((log.urdf for log in logs if log.urdf), ""))
    robot = make_robot(config, header, optional=True, console=console)
    notes = list(robot.notes) if robot else ["no robot: what needs its kinematics was not looked at"]
    log = raw.merged(logs, robot, notes)
    with screen.stages() as stage:
        report = stage("check")
        report(0.0, f"{len(log.trajectories)} trajectories")
        examination = doctor.examine(log, robot)
        _, mended = doctor.mend(log, examination, robot)
        report(1.0, "done")
    store.write_check(examination, folder / "check.json")
    for note in notes:
        console.note(note)
    console.print(shown(examination, mended))
    console.whole(relative(folder))
    if config.strict and not in_sweep() and any(one.severity == "fail" for one in examination.checks):
        raise SystemExit(1)


def read(source: RealLog) -> list[Log]:
    """Its logs, defects and all, with its drive gains; of the trajectories those that its selections name, all where
    there are none.

    Raises:
        LogError: if a log cannot be read, or logs have different joints.
        UsageError: if a selection cannot be read.
    """
    keys = raw.keys_of(source.path)
    options = SETS if raw.reference_files(source, keys) else (*SETS, "reference")
    named = {block.key for blocks in raw.asked(source, keys, options).values() for block in blocks or ()}
    return raw.read(keys, named or keys, source)


def shown(examination: Examination, mended: Iterable[str]) -> Group:
    """What is not ok, what was mended, what the log excites."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for head in ("", "check", "where", "seen", "advice"):
        table.add_column(head, overflow="fold", no_wrap=head in ("", "check"))
    seen = [one for one in examination.checks if one.severity != "ok"]
    for (severity, name), group in groupby(seen, key=lambda one: (one.severity, one.check)):
        lines = list(group)
        for one in lines[:MOST]:
            what = one.seen + (f": {one.meaning}" if one.meaning else "")
            table.add_row(Text(severity, STYLE[severity]), name, Text(_where(one)), Text(what), Text(one.advice))
        if len(lines) > MOST:
            more = f"and {len(lines) - MOST} more, see check.json"
            table.add_row(Text(severity, STYLE[severity]), name, "", more, "")
    quiet = [one.check for one in examination.checks if one.severity == "ok"]
    parts: list[Any] = [table] if seen else []
    if quiet:
        parts.append(Text(f"ok ({len(quiet)}): {', '.join(quiet)}", STYLE["ok"]))
    notes = list(mended)
    parts += [Text(f"can be mended: {note}") for note in notes[: 3 * MOST]]
    if len(notes) > 3 * MOST:
        parts.append(Text(f"can be mended: {len(notes) - 3 * MOST} more"))
    if examination.excitation:
        parts.append(excitation_table(examination))
    word = ("usable", STYLE["ok"]) if examination.usable else ("not usable", STYLE["fail"])
    once = " once it is mended." if notes and examination.usable else "."
    return Group(*parts, Text.assemble("The log is ", word, once))


def excitation_table(examination: Examination) -> Table:
    """One line a joint: how it moves, and how many effects this log cannot show on it."""
    condition = next(iter(examination.excitation.values())).get("condition")
    caption = "" if condition is None else f"condition of the regressor {significant(condition)}; "
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, caption=f"{caption}q in rad or m, tau in N m or N")
    for head in ("joint", "q", "max |qd|", "max |qdd|", "tau", "reversals", "rest %", "slow %"):
        table.add_column(head, justify="left" if head == "joint" else "right", no_wrap=head != "joint", overflow="fold")
    table.add_column("cannot show", overflow="fold")
    for joint, x in examination.excitation.items():
        numbers = [
            " … ".join(map(significant, x["q"])),
            significant(max(map(abs, x["qd"]))),
            significant(max(map(abs, x["qdd"]))),
            " … ".join(map(significant, x["torque"])),
            str(x["reversals"]),
            f"{100 * x['rest_share']:.0f}",
            f"{100 * x['slow_share']:.0f}",
        ]
        table.add_row(Text(joint), *numbers, Text(listed(x["cannot_show"], most=2) if x["cannot_show"] else "-"))
    return table


def _where(one: Check) -> str:
    return " ".join(x for x in (one.trajectory, one.joint) if x) or "whole log"


def relative(folder: Path) -> Path:
    """The folder as it is called from here."""
    return folder.relative_to(Path.cwd()) if folder.is_relative_to(Path.cwd()) else folder
