"""invdyn simulate: the log of a simulated arm that replaces the real one, and the truth about its hidden effects."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import DictConfig
from rich.table import Table

from invdyn_cli import registry
from invdyn_cli.data.plant import Plant
from invdyn_cli.errors import UsageError
from invdyn_cli.files import relative, write_file
from invdyn_cli.log import Log
from invdyn_cli.logfile import write_log
from invdyn_cli.types import Robot
from invdyn_cli.verbs import screen
from invdyn_cli.verbs.launch import job, launch
from invdyn_cli.verbs.objects import instantiate
from invdyn_cli.verbs.run import make_robot
from invdyn_cli.verbs.screen import Screen

LOG, URDF, TRUTH = "log.h5", "robot.urdf", "truth.json"
UNTOLD = ("tip", "gravity", "base_rpy", "payload")
"""Options of the robot that change what its URDF says: the log does not keep them."""


def main(argv: Sequence[str]) -> int:
    """Simulate with the overrides in argv; the exit code."""
    return launch("simulate", argv, task)


def task(config: DictConfig) -> None:
    """One log."""
    execute(config, Path(job().runtime.output_dir), Screen())


def execute(config: DictConfig, folder: Path, console: Screen) -> Log:
    """Config -> arm -> log.h5, robot.urdf and truth.json in `folder`; tells on `console` what was made."""
    if config.data is None or config.data.get("_target_") != f"{Plant.__module__}.{Plant.__name__}":
        got = "not set" if config.data is None else config.data.get("_target_")
        raise UsageError(f"data is {got}; allowed: data=plant, the only source with an arm to simulate")
    source: Plant = instantiate(config.data)
    robot = make_robot(config, source.header(), optional=False, console=console)
    assert robot is not None  # make_robot refuses data without a robot
    with screen.stages(quiet=console.quiet) as stage:
        log = source.record(robot, stage("simulate"))
    write(replace(log, urdf=str(folder / URDF) if robot.urdf else ""), source, robot, folder)
    console.print(_recordings(log))
    console.print(_hidden(source))
    for note in dict.fromkeys(raw.notes for raw in log.trajectories if raw.notes):
        console.warn(note)
    if untold := [f"robot.{name}" for name in UNTOLD if config.robot.get(name) is not None]:
        said = f"{URDF} does not contain {', '.join(untold)}: set the same options again when you read the log"
        console.warn(said)
    console.whole(relative(folder))
    return log


def write(log: Log, source: Plant, robot: Robot, folder: Path) -> None:
    """The three files."""
    if robot.urdf:
        write_file(folder / URDF, robot.urdf)
    write_log(log, folder / LOG)
    write_file(folder / TRUTH, json.dumps(truth(source, robot), indent=2) + "\n")


def truth(source: Plant, robot: Robot) -> dict[str, Any]:
    """The hidden effects, and all settings of the recording."""
    effects = []
    for x in source.told():
        where = {name: x["parameters"][name] for name in ("trajectory", "window") if name in x["parameters"]}
        parameters = {name: value for name, value in x["parameters"].items() if name not in where}
        effects.append({**x, "parameters": parameters, **where})
    return {
        "schema": "invdyn-truth/1",
        "robot": robot.name,
        "joints": list(robot.joints),
        "effects": effects,
        "source": registry.encode(source),
    }


def _recordings(log: Log) -> Table:
    table = Table(title=f"{log.robot}, {log.torque_side} torque, {log.rate:g} Hz", title_justify="left")
    for column in ("trajectory", "length [s]", "samples", "largest torque [N m; N]", "largest tracking error [rad; m]"):
        table.add_column(column, justify="left" if column == "trajectory" else "right")
    for raw in log.trajectories:
        off = np.abs(raw.q - raw.q_ref).max() if raw.q_ref is not None else np.nan
        length = len(raw.t) / log.rate
        table.add_row(raw.name, f"{length:g}", f"{len(raw.t)}", f"{np.abs(raw.tau).max():.3g}", f"{off:.2g}")
    return table


def _hidden(source: Plant) -> Table:
    table = Table("hidden effect", "joint", "parameters", title_justify="left")
    for one in source.told():
        table.add_row(one["effect"], one["joint"] or "(whole arm)", _words(one["parameters"]))
    if not source.effects:
        table.add_row("(none)", "", "")
    return table


def _words(parameters: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {value}" for name, value in parameters.items())
