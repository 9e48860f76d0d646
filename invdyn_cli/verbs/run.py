"""invdyn run: one experiment, or a sweep of them, each into a folder of its own."""

import datetime
import importlib.metadata
import json
import platform
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from invdyn_cli import experiment, store
from invdyn_cli.errors import InvdynError, UsageError
from invdyn_cli.interfaces import AbstractAdapter, AbstractModel, AbstractSource
from invdyn_cli.report import figures, page, tables
from invdyn_cli.types import Header, Robot, RunRecord
from invdyn_cli.verbs import screen, sweep
from invdyn_cli.verbs.launch import in_sweep, instantiate, job, launch

PACKAGES = ("invdyn", "jax", "jaxlib", "flax", "optax", "numpy", "scipy", "pin", "hydra-core", "h5py")


def main(argv: Sequence[str]) -> int:
    """Run with the overrides in argv; the exit code."""
    return launch("run", sweep.with_folder("run", argv), task)


def task(config: DictConfig) -> None:
    """One job: skipped where its folder already holds the same job, finished; in a sweep a failure is a row, not the end."""
    folder = Path(job().runtime.output_dir)
    if not in_sweep():
        execute(config, folder, Console())
        return
    if sweep.is_complete(config, folder):
        sweep.keep_status(folder, "kept")
        return
    try:
        sweep.keep_status(folder, "started")
        execute(config, folder, None)
        sweep.keep_status(folder, "ran")
    except Exception as error:
        sweep.keep_status(folder, "failed", str(error) if isinstance(error, InvdynError) else f"{type(error).__name__}: {error}")


def execute(config: DictConfig, folder: Path, console: Console | None) -> RunRecord:
    """Config -> objects -> experiment -> files in `folder`; tells the result on `console` where there is one."""
    screen.use_compilation_cache()
    started = datetime.datetime.now(datetime.UTC)
    source = _object(config, "data", AbstractSource)
    model = _object(config, "model", AbstractModel)
    adaptation = _object(config, "adaptation", AbstractAdapter)
    robot = make_robot(config, source.header())
    for note in robot.notes if robot and console else ():
        console.print(f"[dim]robot: {note}[/]", highlight=False)
    with screen.stages(quiet=console is None) as stage:
        made = experiment.run(source, model, adaptation, robot, seed=config.seed, stage=stage)
        record = _with_origin(made, config, started)
        write(record, folder, tuple(config.figures.formats), stage("write"))
    if console:
        console.print(tables.score_table(record))
        for warning in record.fit.warnings:
            console.print(f"[yellow]{warning}[/]", highlight=False)
        console.print(f"{_relative(folder)}", highlight=False, soft_wrap=True)
    return record


def write(record: RunRecord, folder: Path, formats: Sequence[str] = ("png",), progress=lambda done, note: None) -> None:
    """All files of a run; metrics.json comes last: where it is, the run is complete."""
    folder.mkdir(parents=True, exist_ok=True)
    store.write_run(record, folder / "run.h5")
    progress(0.2, "figures")
    drawn = figures.draw_all(record, folder / "figures", tuple({"png", *formats}))
    progress(0.9, "report")
    page.write_page(record, [path for path in drawn if path.suffix == ".png"], folder / "report.html")
    store.write_metrics(record, folder / "metrics.json")
    progress(1.0, "done")


def make_robot(config: DictConfig, header: Header | None) -> Robot | None:
    """The robot of the config; what it leaves open (path, joints) the data fill in. None where nobody knows any."""
    node = config.robot
    path = node.path or (header.urdf if header else "")
    if not path:
        if header is None:
            raise UsageError("robot=from_log, but these data bring no robot", advice="robot=apollo_arm, or robot=urdf robot.path=…")
        return None
    joints = node.joints
    if joints is None and header is not None and node.tip is None:
        joints = list(header.joints)
    return instantiate(node, path=str(path), joints=joints)()


def _object(config: DictConfig, group: str, kind: type) -> Any:
    made = instantiate(config[group])
    if not isinstance(made, kind):
        raise UsageError(
            f"{group}={job().runtime.choices.get(group)} gives a {type(made).__name__}; allowed: a {kind.__name__}"
        )
    return made


def _with_origin(record: RunRecord, config: DictConfig, started: datetime.datetime) -> RunRecord:
    """The record with where it came from: choices, config, overrides, versions, machine, times."""
    from dataclasses import replace

    import jax

    choices = {group: job().runtime.choices.get(group) for group in ("model", "data", "adaptation", "robot")}
    return replace(
        record,
        choices={**choices, **record.choices},
        config=OmegaConf.to_yaml(config, resolve=True),
        overrides=tuple(job().overrides.task),
        provenance={
            "started": started.isoformat(timespec="seconds"),
            "versions": {name: _version(name) for name in PACKAGES} | {"python": platform.python_version()},
            "git": _git_state(),
            "device": str(jax.devices()[0].device_kind),
            "platform": platform.platform(),
        },
    )


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def _git_state() -> str:
    """Commit of the checkout that this code runs from, "+" where it was changed since; "" outside of one."""
    here = Path(__file__).parent
    try:
        commands = ["rev-parse", "--short=12", "HEAD"], ["status", "--porcelain", "--", "."]
        commit, changed = (
            subprocess.run(["git", "-C", str(here), *c], capture_output=True, text=True, check=True).stdout.strip()
            for c in commands
        )
    except (OSError, subprocess.CalledProcessError):
        return ""
    return commit + "+" * bool(changed)


def _relative(folder: Path) -> Path:
    try:
        return folder.relative_to(Path.cwd())
    except ValueError:
        return folder
