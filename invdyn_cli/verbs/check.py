"""invdyn check: what the doctor says of a measured log, as a table and as check.json."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import DictConfig
from rich import box
from rich.console import Console, Group
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from invdyn_cli import store
from invdyn_cli.data.conditioning import ordered
from invdyn_cli.data.recorded import RealLog
from invdyn_cli.data.selection import parse
from invdyn_cli.diagnosis import doctor
from invdyn_cli.errors import LogError, UsageError, listed
from invdyn_cli.logfile import Log, read_log, trajectory_names
from invdyn_cli.report.tables import significant
from invdyn_cli.types import Check, Examination, Header, Robot
from invdyn_cli.verbs import screen
from invdyn_cli.verbs.launch import in_sweep, instantiate, job, launch
from invdyn_cli.verbs.run import make_robot

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
    folder, console = Path(job().runtime.output_dir), Console()
    screen.use_compilation_cache()
    logs = read(instantiate(config.data))
    header = Header(logs[0].robot, logs[0].joints, next((log.urdf for log in logs if log.urdf), ""))
    robot = make_robot(config, header, optional=True, console=console)
    notes = list(robot.notes) if robot else ["no robot: what needs its kinematics was not looked at"]
    log = merged(logs, robot, notes)
    with screen.stages() as stage:
        report = stage("check")
        report(0.0, f"{len(log.trajectories)} trajectories")
        examination = doctor.examine(log, robot)
        _, mended = doctor.mend(log, examination, robot)
        report(1.0, "done")
    folder.mkdir(parents=True, exist_ok=True)
    store.write_check(examination, folder / "check.json")
    for note in notes:
        console.print(f"[dim]{escape(note)}[/]", highlight=False)
    console.print(shown(examination, mended))
    console.print(str(_relative(folder)), highlight=False, markup=False, soft_wrap=True)
    if config.strict and not in_sweep() and any(one.severity == "fail" for one in examination.checks):
        raise SystemExit(1)


def read(source: Any) -> list[Log]:
    """The logs that a `RealLog` names, defects and all, with its drive gains; of the trajectories those that its
    selections name, all where there are none.

    Raises:
        LogError: if a log cannot be read, or logs have different joints.
        UsageError: if the source is no measured log, or a selection cannot be read.
    """
    if not isinstance(source, RealLog):
        got = f"data is a {type(source).__name__}"
        raise UsageError(f"{got}; allowed: a measured log", advice="data=real_log data.path=…")
    paths = [Path(path).expanduser() for path in source.path]
    if not paths or len({path.stem for path in paths}) < len(paths):
        raise UsageError(f"data.path={listed(map(str, paths))}; allowed: one log or more, with different names")
    label = "{0.stem}/{1}" if len(paths) > 1 else "{1}"
    keys = {label.format(path, name): (path, name) for path in paths for name in trajectory_names(path)}
    options = ("train", "validation", "test", "adapt", "reference")
    asked = {name: value for name in options if isinstance(value := getattr(source, name, None), Sequence)}
    named = {parse(name, str(text), keys).key for name, texts in asked.items() for text in texts} or set(keys)
    logs = []
    for path in paths:
        log = read_log(path, [name for key, (at, name) in keys.items() if at == path and key in named], check=False)
        if source.drive_gain is not None and log.torque_unit == "A":
            log = replace(log, drive_gain=np.asarray(source.drive_gain, float))
        gain = log.drive_gain
        if gain is not None and np.shape(gain) != (len(log.joints),):
            got = f"{path}: drive gains {np.asarray(gain).tolist()}"
            raise LogError(f"{got}; allowed: {len(log.joints)} numbers [N m/A], one for each joint")
        names = {name: key for key, (at, name) in keys.items() if at == path}
        log = replace(log, trajectories=tuple(replace(raw, name=names[raw.name]) for raw in log.trajectories))
        if logs and log.joints != logs[0].joints:
            got = f"{path} has joints {listed(log.joints)}, {paths[0]} has {listed(logs[0].joints)}"
            raise LogError(f"{got}; allowed: logs of one robot")
        logs.append(log)
    return logs


def merged(logs: Sequence[Log], robot: Robot | None, notes: list[str]) -> Log:
    """One log of all trajectories, columns in the robot's order, torques in N m where gains are known."""
    try:
        logs = [in_newton_metres(ordered(log, robot, notes)) for log in logs]
    except IndexError as error:
        got = f"a channel has fewer columns than joint_names: {error}"
        raise LogError(got, advice="a column for each joint") from error
    if len({log.torque_unit for log in logs}) > 1:
        raise LogError("some logs have torques in A without drive gains", advice="data.drive_gain=[…], N m per A")
    return replace(logs[0], trajectories=tuple(raw for log in logs for raw in log.trajectories))


def in_newton_metres(log: Log) -> Log:
    """The log with currents times their drive gains; as it is where these are not known."""
    if log.torque_unit != "A" or log.drive_gain is None:
        return log
    scaled = tuple(
        replace(raw, tau=raw.tau * log.drive_gain) if raw.tau.shape[1:] == (len(log.joints),) else raw
        for raw in log.trajectories
    )
    return replace(log, torque_unit="N m", drive_gain=None, trajectories=scaled)


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


def _relative(folder: Path) -> Path:
    return folder.relative_to(Path.cwd()) if folder.is_relative_to(Path.cwd()) else folder
