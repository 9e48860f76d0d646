"""invdyn run: one experiment, or a sweep of them, each into a folder of its own."""

import datetime
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from invdyn_cli import experiment, registry, store
from invdyn_cli.compiled import use_compilation_cache
from invdyn_cli.errors import RobotError, UsageError, listed
from invdyn_cli.files import relative
from invdyn_cli.functions.fitting import FitResult
from invdyn_cli.functions.inputs import named_by, with_joints
from invdyn_cli.interfaces import AbstractAdapter, AbstractModel, AbstractSource, Progress
from invdyn_cli.tracking.contract import AbstractTracker, Tracked, flat, mean_curves, numbers
from invdyn_cli.types import Header, Robot, RunRecord
from invdyn_cli.verbs import imports, origin, screen, sweep
from invdyn_cli.verbs.launch import in_sweep, job, launch
from invdyn_cli.verbs.objects import instantiate, refuse_other_class
from invdyn_cli.verbs.screen import Screen

FORMATS = ("png", "svg", "pdf")


def main(argv: Sequence[str]) -> int:
    """Run with the overrides in argv; the exit code."""
    return launch("run", sweep.with_folder("run", argv), task)


def task(config: DictConfig) -> float | None:
    """One job. In a sweep one that its folder already holds, complete, is kept, and a failure is a row, not the end.

    Returns:
        In a sweep, what a sweeper that searches (Optuna) makes small: the mean NMSE over joints of the validation set,
        or of the test set where there is no other; infinity for a failed job.
    """
    folder = Path(job().runtime.output_dir)
    if not in_sweep():
        execute(config, folder, Screen())
        return None
    number, asked = job().job.num, job().overrides.task
    made = sweep.made_for(number)
    status, message = "kept" if made is None and sweep.is_complete(config, folder) else "ran", ""
    if status == "ran":
        sweep.keep_status(folder, number, asked, "started")
        try:
            execute(config, folder, made=made)
        except Exception as error:
            status, message = "failed", sweep.reason("run", error, folder, asked)
    sweep.keep_status(folder, number, asked, status, message)
    screen.tell(f"job {number} {status}: {message or ' '.join(asked)}")
    return sweep.objective(folder) if status != "failed" else float("inf")


def execute(
    config: DictConfig,
    folder: Path,
    console: Screen | None = None,
    view: Any = None,
    made: sweep.Made | None = None,
) -> RunRecord:
    """Config -> objects -> experiment -> files in `folder`; prints the result on `console` if there is one.

    `view` is Hydra's view of the job (choices, overrides) if it is not the running one; `made` is the run if it exists
    already.
    """
    console = console or Screen(quiet=True)
    use_compilation_cache()
    started = datetime.datetime.now(datetime.UTC)
    refuse_options(config)
    source = make_object(config, "data", AbstractSource)
    model = make_object(config, "model", AbstractModel)
    adaptation = make_object(config, "adaptation", AbstractAdapter)
    tracker = make_tracker(config)
    header = source.header()
    maps = imports.show_all(source, console)
    robot = make_robot(config, header, optional=not (source.needs_robot or model.needs_robot), console=console)
    for note in robot.notes if robot else ():
        console.note(f"robot: {note}")
    with screen.stages(quiet=console.quiet) as stage:
        if made is None:
            plain = experiment.run(source, model, adaptation, robot, seed=config.seed, stage=stage)
            record = with_origin(plain, config, started, view or job())
        else:
            record = made.record
        result = FitResult(record)
        if made is None or not made.is_written():
            result.save(folder, tuple(config.figures.formats), stage("write"))
        untracked = track(tracker, record, config, folder, stage("track"))
    imports.keep(maps, folder, console)
    console.print(result)
    if untracked:
        screen.tell(f"invdyn: the run is complete, but was not tracked: {untracked}")
    console.whole(relative(folder))
    return record


def make_tracker(config: DictConfig) -> AbstractTracker:
    """The tracker that the config describes, after a check that its library is installed.

    Raises:
        UsageError: for anything else.
    """
    refuse_no_object(config, "tracker")
    made = instantiate(config.tracker)
    refuse_other_class(made, "tracker", config.tracker, AbstractTracker)
    made.refuse_missing()
    return made


def track(tracker: AbstractTracker, record: RunRecord, config: DictConfig, folder: Path, progress: Progress) -> str:
    """Give the run to the tracker; returns why that failed, or ""."""
    progress(0.0, type(tracker).__name__)
    plain = OmegaConf.to_container(config, resolve=True)
    metrics = json.loads((folder / store.METRICS).read_text(encoding="utf-8"))
    files = [*sorted((folder / "figures").glob("*")), folder / "report.html"]
    parts = folder.absolute().parts
    name = "-".join(parts[parts.index("outputs") + 2 :] if "outputs" in parts[:-2] else parts[-1:])
    params = {key: str(value) for key, value in flat(plain)}
    run = Tracked(name, folder, params, numbers(metrics), mean_curves(record.fit.history), files)
    try:
        tracker.track(run)
    except Exception as error:  # a server that is away, a full disk: of another's library it may be anything
        return f"{type(error).__name__}: {error}"
    return ""


def make_robot(config: DictConfig, header: Header | None, *, optional: bool, console: Screen) -> Robot | None:
    """The robot of the config; the data supply what it leaves open (path, joints). None if nothing names a robot, or if
    it is `optional` and the URDF that the data name is not usable, with a message."""
    node = config.robot
    if not isinstance(node, DictConfig) or "path" not in node:
        raise UsageError(f"robot={node}; allowed: {{path: arm.urdf, …}}", advice="robot=urdf robot.path=arm.urdf")
    path = node.path or (header.urdf if header else "")
    if not path:
        if header is None:
            raise UsageError(
                "robot=from_log, but these data name no robot", advice="robot=apollo_arm, or robot=urdf robot.path=…"
            )
        return None
    joints = node.joints
    if joints is None and header is not None and node.tip is None:
        joints = list(header.joints)
    try:
        path = str(node.path or named_by(header))
        robot = with_joints(lambda names: instantiate(node, path=path, joints=names)(), joints, logged=not node.joints)
    except RobotError as error:
        if not optional or node.path:
            raise
        console.warn(f"no robot: {error}")
        return None
    refuse_other_class(robot, "robot", node, Robot)
    return robot


def refuse_options(config: DictConfig) -> None:
    """Refuse values outside of any group, and empty groups."""
    for group in ("robot", "data", "model", "adaptation"):
        refuse_no_object(config, group)
    refuse_seed(config.seed)
    refuse_formats("figures.formats", config.figures.formats)


def refuse_no_object(config: DictConfig, group: str, advice: str = "") -> None:
    """Refuse a group that describes no object."""
    node = config.get(group)
    if not isinstance(node, DictConfig) or "_target_" not in node:
        raise UsageError(f"{group}={node}; allowed: a name that invdyn run --help lists", advice=advice)


def size_limit(config: DictConfig) -> float:
    """[bytes] of the option max_size [GB]: what may be read of a file."""
    if not isinstance(config.max_size, int | float) or not 0 < config.max_size < float("inf"):
        raise UsageError(f"max_size={config.max_size}; allowed: a number of GB above 0")
    return 1e9 * config.max_size


def refuse_seed(seed: Any) -> None:
    """Refuse seeds for which JAX has no random keys."""
    if type(seed) is not int or not 0 <= seed < 2**63:
        raise UsageError(f"seed={seed}; allowed: a whole number from 0 to 2^63 - 1")


def refuse_flags(config: DictConfig, *options: str) -> None:
    """Refuse options that are neither true nor false."""
    for option in options:
        value = OmegaConf.select(config, option)
        if not isinstance(value, bool):
            raise UsageError(f"{option}={value}; allowed: true or false")


def refuse_formats(option: str, formats: Any) -> None:
    """Refuse unknown formats of figures."""
    if not isinstance(formats, Sequence) or not set(formats) <= set(FORMATS):
        raise UsageError(f"{option}={formats}; allowed: a list of {listed(FORMATS)}")


def make_log_source(config: DictConfig) -> AbstractSource:
    """The data source of the config; UsageError for one that has no log."""
    refuse_no_object(config, "data", "data=real_log data.path=…")
    source = instantiate(config.data)
    if isinstance(source, AbstractSource) and source.has_log:
        return source
    got = f"data is a {type(source).__name__}, which has no log"
    raise UsageError(f"{got}; allowed: a measured log", advice="data=real_log data.path=…")


def make_object(config: DictConfig, group: str, kind: type) -> Any:
    """What a group's config makes, if it is of that kind and can be stored."""
    made = instantiate(config[group])
    refuse_other_class(made, group, config[group], kind)
    try:
        json.dumps(registry.encode(made))
    except TypeError:
        got = f"{group}: a {type(made).__name__} cannot be stored with its run"
        allowed = "a frozen dataclass whose fields are plain values or such dataclasses"
        raise UsageError(f"{got}; allowed: {allowed}") from None
    return made


def with_origin(record: RunRecord, config: DictConfig, started: datetime.datetime, view: Any) -> RunRecord:
    """The record with its provenance: choices, config, overrides (of Hydra's `view` of the job), versions, machine,
    times."""
    choices = {group: view.runtime.choices.get(group) for group in ("model", "data", "adaptation", "robot")}
    return replace(
        record,
        choices={**choices, **record.choices},
        config=OmegaConf.to_yaml(config, resolve=True),
        overrides=tuple(view.overrides.task),
        provenance=origin.origin(started),
    )
