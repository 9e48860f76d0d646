"""The door to Hydra: where configs lie, how a config becomes objects, how failures of use are told in one line."""

import difflib
import functools
import logging
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import hydra
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import (
    ConfigCompositionException,
    HydraException,
    InstantiationException,
    MissingConfigException,
    OverrideParseException,
)
from hydra.types import RunMode
from omegaconf import DictConfig, ListConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from invdyn_cli.errors import InvdynError, UsageError, closest, listed

WORDS = {int: "a whole number", float: "a number", str: "text", bool: "true or false", NoneType: "null"}
"""Plain types, and how they are called before a user."""


def config_folder() -> Path:
    """conf/, inside the package where it was installed from a wheel, beside it in a checkout."""
    package = Path(__file__).parents[1]
    for folder in (package / "conf", package.parent / "conf"):
        if (folder / "run.yaml").is_file():
            return folder
    raise UsageError(f"no configs beside {package}", advice="installing invdyn again")


def launch(verb: str, argv: Sequence[str], task: Callable[[DictConfig], Any]) -> int:
    """Compose the verb's config with the overrides in argv, run the task (once, or for every job of a sweep).

    Returns:
        The exit code: 0; 2 for wrong use, told on stderr in one line, or where a job of a sweep failed; 130: stopped.
    """
    argv = list(argv)
    cwd = Path.cwd()
    sys.path.insert(0, str(cwd))
    # Whatever a user keeps beside them is found too: ./model/mine.yaml, or ./conf/model/mine.yaml.
    if not any(a.startswith(("hydra.searchpath", "+hydra.searchpath")) for a in argv):
        places = [f"file://{place}".replace("'", r"\'") for place in (cwd, cwd / "conf") if place.is_dir()]
        argv.append("hydra.searchpath=[" + ",".join(f"'{place}'" for place in places) + "]")
    logging.getLogger("hydra").addHandler(logging.NullHandler())  # what cannot be imported is told in our own line
    os.environ["HYDRA_FULL_ERROR"] = "1"  # exceptions come to us instead of being printed
    overrides = [a for a in argv if "=" in a and not a.startswith("-")]
    sys.argv = [f"invdyn {verb}", *overrides, *(a for a in argv if a not in overrides)]  # argparse wants them together
    failures: list[Exception] = []

    @functools.wraps(task)
    def guarded(config: DictConfig) -> None:
        try:
            task(config)
        except (InvdynError, OSError, MemoryError, OmegaConfBaseException) as error:
            failures.append(error)  # raised outside of Hydra, which would print a line of its own

    try:
        _refuse_no_choice(overrides)
        hydra.main(version_base="1.3", config_path=str(config_folder()), config_name=verb)(guarded)()
        if failures:
            raise failures[0]
    except InvdynError as error:
        return complain(str(error))
    except (HydraException, OmegaConfBaseException) as error:
        return complain(_told(verb, error, argv))
    except MemoryError as error:
        return complain(f"out of memory: {error}")
    except BrokenPipeError:  # the reader of our output (head, less) has gone
        sys.stdout = None
    except OSError as error:
        where = error.filename or "a file"
        return complain(f"{where}: {error.strerror or error}. Try: another folder (hydra.run.dir=…)")
    except SystemExit as end:  # what a callback at the end of a sweep decides; Hydra itself swallows its exceptions
        return end.code if isinstance(end.code, int) else 2
    except KeyboardInterrupt:
        complain("stopped")
        return 130
    return 0


def _refuse_no_choice(overrides: Sequence[str]) -> None:
    """A group of configs is chosen from by name: null or a number is none, and Hydra has no line for it."""
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


def complain(line: str) -> int:
    """Say on stderr what was wrong, in one line; the exit code for wrong use."""
    print(f"invdyn: {' '.join(line.split())}", file=sys.stderr)
    return 2


def instantiate(node: DictConfig, **more: Any) -> Any:
    """The object that a config node describes (`_target_`), nested ones too, in plain Python values.

    Raises:
        UsageError: for a value of the wrong type, a field that the class does not have, a `_target_` that cannot be
            imported.
        InvdynError: whatever the object itself refuses.
    """
    _refuse_wrong_types(node)
    try:
        return hydra.utils.instantiate(node, **more, _convert_="all")
    except InstantiationException as error:
        cause = _cause(error)
        if isinstance(cause, InvdynError):
            raise cause from None
        raise UsageError(f"{node.get('_target_', 'a config')}: {type(cause).__name__}: {cause}") from error


def _refuse_wrong_types(node: DictConfig) -> None:
    """Compare plain values with the annotations of the dataclass that takes them."""
    try:
        target = hydra.utils.get_object(node._target_)
        hints = get_type_hints(target) if is_dataclass(target) else {}
    except Exception:  # what cannot be found or has unreadable annotations is told by the instantiation itself
        return
    for name, hint in hints.items():
        if name in node and not OmegaConf.is_missing(node, name) and not _fits(node[name], hint):
            raise UsageError(
                f"{node._get_full_key(name)}={'null' if node[name] is None else node[name]}; allowed: {_in_words(hint)}"
            )


def _fits(value: Any, hint: Any) -> bool:
    """Whether a plain value suits an annotation of plain types; annotations of anything else suit everything."""
    if get_origin(hint) is Literal:
        return value in get_args(hint)
    if get_origin(hint) in (Union, UnionType):
        return any(_fits(value, one) for one in get_args(hint))
    if _is_list(hint):
        return isinstance(value, ListConfig) and all(_fits(one, get_args(hint)[0]) for one in value)
    if hint is float:
        return type(value) in (int, float)
    return hint not in WORDS or type(value) is hint


def _is_list(hint: Any) -> bool:
    """Whether an annotation is tuple[X, ...] or Sequence[X] with a plain X."""
    return get_origin(hint) in (tuple, Sequence) and get_args(hint)[0] in WORDS


def _in_words(hint: Any) -> str:
    """An annotation of plain types as a user would say it."""
    if get_origin(hint) is Literal:
        return listed(map(str, get_args(hint)))
    if get_origin(hint) in (Union, UnionType):
        return " or ".join(map(_in_words, get_args(hint)))
    return f"a list, each {_in_words(get_args(hint)[0])}" if _is_list(hint) else WORDS.get(hint, str(hint))


def job() -> Any:
    """Hydra's view of this run: output folder, choices, overrides, whether it is one job of a sweep."""
    return HydraConfig.get()


def in_sweep() -> bool:
    """Whether this is one job of a sweep."""
    return job().mode == RunMode.MULTIRUN


def _cause(error: BaseException) -> BaseException:
    """The failure that started it all, or the first that is told in our own words."""
    while error.__cause__ is not None and not isinstance(error, InvdynError):
        error = error.__cause__
    return error


def _told(verb: str, error: Exception, argv: list[str]) -> str:
    """Hydra's and OmegaConf's many lines as one, with what is allowed and the nearest match."""
    text = str(error)
    if isinstance(error, MissingConfigException) and error.options:
        group, wanted = error.missing_cfg_file.rsplit("/", 1) if error.missing_cfg_file else ("", "")
        return f"{group}={wanted}; allowed: {listed(sorted(error.options))}{closest(wanted, error.options)}"
    if isinstance(error, ConfigCompositionException) and "Could not override" in text:
        key = getattr(_cause(error), "full_key", None) or text.split("'")[1]
        allowed = _siblings(verb, key, argv)
        offer = f"; allowed: {listed(allowed, most=30)}{closest(key, allowed)}" if allowed else ""
        return f"there is no option {key}{offer}"
    if isinstance(error, OverrideParseException):
        return f"{error.override!r} cannot be read as an override; allowed: group=choice, option=value"
    if "Missing mandatory value" in text:
        key = getattr(error, "full_key", None) or text.split(":")[-1].strip()
        return f"{key} is not set. Try: {key}=…"
    return text.split("\nfull_key")[0].split("\nSee https")[0].split("\nSet the environment")[0]


def _siblings(verb: str, key: str, argv: list[str]) -> list[str]:
    """The options beside `key` in the config that the other overrides give."""
    groups = [p.name for p in config_folder().iterdir() if p.is_dir()]
    chosen = [a for a in argv if a.split("=")[0] in (*groups, "hydra.searchpath")]
    parent = key.rsplit(".", 1)[0] if "." in key else ""
    try:
        GlobalHydra.instance().clear()
        with hydra.initialize_config_dir(str(config_folder()), version_base="1.3"):
            config = hydra.compose(verb, chosen)
        node = OmegaConf.select(config, parent) if parent else config
        names = [str(name) for name in node if not str(name).startswith("_")]
    except (HydraException, OmegaConfBaseException, TypeError):
        return []
    full = [f"{parent}.{name}" if parent else name for name in names]
    return sorted(full, key=lambda name: -difflib.SequenceMatcher(None, name, key).ratio())
