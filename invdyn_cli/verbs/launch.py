"""How Hydra is called: where configs are, how a verb is run once or in a sweep, how wrong use is told in one line."""

import contextlib
import difflib
import functools
import logging
import os
import re
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import hydra
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import (
    ConfigCompositionException,
    HydraException,
    MissingConfigException,
    OverrideParseException,
)
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from invdyn_cli import interruption
from invdyn_cli.errors import LONGEST, InvdynError, UsageError, closest, listed, shortened
from invdyn_cli.files import write_file
from invdyn_cli.interruption import closed_pipe
from invdyn_cli.verbs import folders as named
from invdyn_cli.verbs import meant
from invdyn_cli.verbs.objects import cause_of

TRACEBACK = "traceback.txt"


def config_folder() -> Path:
    """The folder conf/: inside an installed package, beside the package in a checkout."""
    package = Path(__file__).parents[1]
    for folder in (package / "conf", package.parent / "conf"):
        if (folder / "run.yaml").is_file():
            return folder
    raise UsageError(f"no configs beside {package}", advice="installing invdyn again")


def paper_joints(path: str | None) -> int | None:
    """Joints that robot=apollo_four keeps: the paper's four of the built-in arm, all (None) of another robot.path=."""
    return 4 if path == "apollo_arm" else None


OmegaConf.register_new_resolver("paper_joints", paper_joints, replace=True)


def quoted(text: str) -> str:
    """A text as a value of an override, as it is: only before a quote, or at the end, a backslash says something."""
    return "'" + re.sub(r"(\\*)('|$)", lambda at: 2 * at[1] + at[2].replace("'", r"\'"), text) + "'"


def launch(verb: str, argv: Sequence[str], task: Callable[[DictConfig], Any]) -> int:
    """Compose the verb's config with the overrides in argv, run the task (once, or for every job of a sweep).

    Returns:
        The exit code: 0; 2 for wrong use, told on stderr in one line, or where a job of a sweep failed; 3 for an error
        of ours, whose traceback is in a file. Ctrl-C goes on as KeyboardInterrupt.
    """
    argv = list(argv)
    try:
        argv += search_path(argv)
        argv += named.of_jobs(argv)
    except OSError:
        return complain("the working directory no longer exists. Try: cd to an existing one")
    logging.getLogger("hydra").addHandler(logging.NullHandler())  # what cannot be imported is told in our own line
    warnings.filterwarnings("ignore", "provider=.* is not available")  # nor can a folder that was removed
    os.environ["HYDRA_FULL_ERROR"] = "1"  # exceptions come to us instead of being printed
    overrides = [a for a in argv if "=" in a and not a.startswith("-")]
    sys.argv = [f"invdyn {verb}", *overrides, *(a for a in argv if a not in overrides)]  # argparse wants them together
    before = _existing(overrides)
    failures: list[Exception] = []
    folders: list[Path] = []
    finished: list[Path] = []

    @functools.wraps(task)
    def guarded(config: DictConfig) -> Any:
        folders.append(Path(job().runtime.output_dir))
        finished[:] = [Path(job().sweep.dir) if in_sweep() else folders[0]]
        try:
            _refuse_no_options(config, OmegaConf.to_container(OmegaConf.load(config_folder() / f"{verb}.yaml")))
            return task(config)
        except Exception as error:
            failures.append(error)  # raised outside of Hydra, which would print a line of its own

    try:
        _refuse_no_choice(overrides)
        _refuse_flags(verb, argv)
        hydra.main(version_base="1.3", config_path=str(config_folder()), config_name=verb)(guarded)()
        if failures:
            raise failures[0]
        _point_to(finished)
        return 0
    except SystemExit as end:  # what a verb decides, or a callback at the end of a sweep
        if end.code == 1:
            _point_to(finished)
        return end.code if isinstance(end.code, int) else 2
    except KeyboardInterrupt:
        _remove_empty(folders, before)
        raise
    except BrokenPipeError:
        code = closed_pipe()
    except Exception as error:
        if interruption.was_asked():  # which may come in an import and end as anything
            _remove_empty(folders, before)
            raise KeyboardInterrupt from error
        line = told(verb, error, argv)
        code = complain(line) if line else _own_error(error, folders[0] if folders else None)
    _remove_empty(folders, before)
    return code


def search_path(argv: Sequence[str]) -> list[str]:
    """The override by which Hydra finds what users keep beside them: ./model/mine.yaml, or ./conf/model/mine.yaml.

    The package's own configs come first, so that a folder of somebody else's changes none of them. [] where argv has
    such an override already.
    """
    if any(a.startswith(("hydra.searchpath", "+hydra.searchpath")) for a in argv):
        return []
    cwd = Path.cwd()
    places = [f"file://{place}".replace("'", r"\'") for place in (cwd, cwd / "conf") if place.is_dir()]
    return ["hydra.searchpath=[" + ",".join(f"'{place}'" for place in places) + "]"]


def told(verb: str, error: Exception, argv: Sequence[str]) -> str:
    """The message for wrong use; "" for an error of invdyn."""
    if isinstance(error, InvdynError):
        return str(error)
    if isinstance(error, HydraException | OmegaConfBaseException):
        return _composing(verb, error, argv)
    if isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in str(error):
        return f"out of memory: {error}"
    if isinstance(error, OSError):
        where = error.filename or "a file of the output"
        return f"{where}: {error.strerror or error}. Try: another folder (hydra.run.dir=…)"
    if _raised_by(error) in ("hydra", "omegaconf"):
        return f"the config cannot be composed: {error}"
    return ""


def failed(verb: str, error: Exception, argv: Sequence[str]) -> int:
    """Tell what ended a command that is not composed by Hydra; the exit code. Ctrl-C goes on as KeyboardInterrupt."""
    if interruption.was_asked():
        raise KeyboardInterrupt from error
    if isinstance(error, BrokenPipeError):
        return closed_pipe()
    line = told(verb, error, argv)
    return complain(line) if line else _own_error(error, None)


def _raised_by(error: Exception) -> str:
    """The top-level package in which an exception was raised."""
    frames = [frame.f_globals.get("__name__", "") for frame, _ in traceback.walk_tb(error.__traceback__)]
    return frames[-1].partition(".")[0] if frames else ""


def _own_error(error: Exception, folder: Path | None) -> int:
    """Write the traceback of an error of invdyn to a file, in the run's folder if possible, and say where it is."""
    text = "".join(traceback.format_exception(error))
    kept = "the command that you typed (its traceback could not be written to a file)"
    for place in (folder or Path(), Path(tempfile.gettempdir())):
        with contextlib.suppress(OSError):
            kept = str(write_file((place / TRACEBACK).absolute(), text))
            break
    what = shortened(" ".join(f"{type(error).__name__}: {error}".split()), 200)
    return complain(f"an error of invdyn's own ({what}). Please report it, with {kept}", 3)


def _point_to(finished: Sequence[Path]) -> None:
    for folder in finished:
        named.point_to(folder)


def _existing(overrides: Sequence[str]) -> set[Path]:
    """The folder that the overrides name, the working directory, and those above them, as far as they exist already."""
    given = [a.partition("=")[2].strip("'\"") for a in overrides if a.startswith(("hydra.run.dir=", "folder="))]
    named = [Path(x).absolute() for x in given if x]
    return {place for one in (*named, Path.cwd()) for place in (one, *one.parents) if place.is_dir()}


def _remove_empty(folders: Iterable[Path], before: set[Path]) -> None:
    """Remove the folder of a command that was refused, if nothing but Hydra's own notes came into it, and the empty
    ones above it; what was there before stays."""
    for folder in folders:
        _remove_one(folder, before)


def _remove_one(folder: Path, before: set[Path]) -> None:
    with contextlib.suppress(OSError):
        notes = folder / ".hydra"
        if {path for path in folder.iterdir() if path != notes}:
            return
        for path in notes.glob("*.yaml"):
            path.unlink()
        notes.rmdir() if notes.is_dir() else None
    for place in (folder, *folder.parents):
        if place.absolute() in before:
            return
        try:
            if [path.name for path in place.iterdir()] == ["multirun.yaml"]:  # a sweep of refused jobs
                (place / "multirun.yaml").unlink()
            place.rmdir()
        except OSError:
            return


def _refuse_no_choice(overrides: Sequence[str]) -> None:
    """A group of configs is chosen by name: refuse null or a number, for which Hydra has no clear message."""
    parser = OverridesParser.create()
    for text in overrides:
        try:
            one = parser.parse_override(text)
        except HydraException:
            continue  # Hydra tells it
        folder = config_folder() / one.key_or_group
        chosen = one.is_sweep_override() or one.is_delete() or isinstance(one.value(), str | list | dict)
        if folder.is_dir() and not chosen:
            choices = sorted(path.stem for path in folder.glob("*.yaml"))
            raise UsageError(f"{text}; allowed: {listed(choices)}")


def _refuse_no_options(config: Any, usual: Any, place: str = "") -> None:
    """Options that belong together (figures.formats) are given one by one: refuse any other value in their place."""
    for name, options in usual.items():
        if name in ("defaults", "hydra") or not isinstance(options, dict):
            continue
        got, here = config.get(name), f"{place}{name}"
        if not isinstance(got, DictConfig):
            raise UsageError(f"{here}={got}; allowed: {listed(f'{here}.{option}=…' for option in options)}")
        _refuse_no_options(got, options, f"{here}.")


def _refuse_flags(verb: str, argv: Sequence[str]) -> None:
    """Refuse --name value and --name=value, as other programs have their options."""
    for name, key, value in meant.flags(argv):
        likely = meant.option(key, [f"{key}={value}"], _names(_composed(verb, argv))) or f"{key}={value or '…'}"
        raise UsageError(f"{name} is not an option: options are written name=value, without dashes", advice=likely)


def complain(line: str, code: int = 2) -> int:
    """Say on stderr what was wrong, in one line; the exit code, that of wrong use unless another is given."""
    with contextlib.suppress(OSError):
        print(f"invdyn: {shortened(' '.join(line.split()), 2 * LONGEST)}", file=sys.stderr)
    return code


def job() -> Any:
    """Hydra's view of this run: output folder, choices, overrides, whether it is one job of a sweep."""
    return HydraConfig.get()


def in_sweep() -> bool:
    """Whether this is one job of a sweep."""
    return job().mode == RunMode.MULTIRUN


def _composing(verb: str, error: Exception, argv: Sequence[str]) -> str:
    """The many lines of Hydra and OmegaConf as one line, with the allowed values and the nearest match."""
    text = str(error)
    if isinstance(error, MissingConfigException) and error.options:
        group, wanted = error.missing_cfg_file.rsplit("/", 1) if error.missing_cfg_file else ("", "")
        if likely := meant.choice(group, wanted, error.options):
            return f"{group}={wanted} is no choice. Try: {likely}"
        return f"{group}={wanted}; allowed: {listed(sorted(error.options))}{closest(wanted, error.options)}"
    if isinstance(error, ConfigCompositionException) and "Could not override" in text:
        key = getattr(cause_of(error), "full_key", None) or text.split("'")[1]
        if key == "data.path":
            return "data.path belongs to measured logs. Try: data=real_log data.path=…"
        config = _composed(verb, argv)
        if likely := meant.option(key, argv, _names(config)):
            return f"there is no option {key}. Try: {likely}"
        allowed = _siblings(config, key)
        offer = f"; allowed: {listed(allowed, most=30)}{closest(key, allowed)}" if allowed else ""
        return f"there is no option {key}{offer}"
    if isinstance(error, OverrideParseException):
        got = error.override or ""
        advice = f". Try: {meant.of_file(got)}{got}" if Path(got).is_file() else ""
        return f"{got!r} is no option; allowed: group=choice, option=value{advice}"
    if "Missing mandatory value" in text:
        key = getattr(error, "full_key", None) or text.split(":")[-1].strip()
        return f"{key} is not set. Try: {meant.MISSING.get((verb, key), f'{key}=…')}"
    return text.split("\nfull_key")[0].split("\nSee https")[0].split("\nSet the environment")[0]


def _composed(verb: str, argv: Sequence[str]) -> DictConfig:
    """The verb's config with the choices of groups in argv; empty if it cannot be composed."""
    groups = [p.name for p in config_folder().iterdir() if p.is_dir()]
    chosen = [a for a in argv if a.split("=")[0] in (*groups, "hydra.searchpath")]
    try:
        GlobalHydra.instance().clear()
        with hydra.initialize_config_dir(str(config_folder()), version_base="1.3"):
            return hydra.compose(verb, chosen)
    except (HydraException, OmegaConfBaseException):
        return OmegaConf.create({})


def _names(node: DictConfig, above: str = "") -> Iterator[str]:
    """The full names of all options in a config."""
    for name in node:
        inside = None if OmegaConf.is_missing(node, name) else node._get_node(name)
        if isinstance(inside, DictConfig) and not inside._is_none():
            yield from _names(inside, f"{above}{name}.")
        elif not str(name).startswith("_"):
            yield f"{above}{name}"


def _siblings(config: DictConfig, key: str) -> list[str]:
    """The options beside `key`."""
    parent = key.rsplit(".", 1)[0] if "." in key else ""
    try:
        node = OmegaConf.select(config, parent) if parent else config
        names = [str(name) for name in node if not str(name).startswith("_")]
    except (OmegaConfBaseException, TypeError):
        return []
    full = [f"{parent}.{name}" if parent else name for name in names]
    return sorted(full, key=lambda name: -difflib.SequenceMatcher(None, name, key).ratio())
