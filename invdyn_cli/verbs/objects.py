"""Objects from configs: what a config node names is imported, its values are compared with the annotations, and what
an object refuses is told in one line."""

import importlib.util
import sys
from collections.abc import Iterable, Iterator
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any, get_type_hints

import hydra
from hydra.errors import InstantiationException
from omegaconf import DictConfig, ListConfig, OmegaConf

from invdyn_cli.errors import InvdynError, UsageError
from invdyn_cli.fields import in_words, suits


def admit_modules(names: Iterable[str]) -> None:
    """Let the working directory be imported from, if one of these modules is there and nowhere else.

    It stands last on the path, and only where a config that was chosen, or the user, names a module of it: a file that
    happens to lie there is never imported in the place of an installed one.
    """
    cwd = Path.cwd()
    for top in {name.partition(".")[0] for name in names if name}:
        here = (cwd / top).is_dir() or (cwd / f"{top}.py").is_file()
        if here and str(cwd) not in sys.path and importlib.util.find_spec(top) is None:
            sys.path.append(str(cwd))


def trusted(config: DictConfig) -> list[str]:
    """The modules that the option `trust` names, which may lie in the working directory.

    Raises:
        UsageError: if it is no list of names.
    """
    names = list(config.trust) if isinstance(config.trust, ListConfig) else None
    if names is None or not all(isinstance(name, str) and name for name in names):
        raise UsageError(f"trust={config.trust}; allowed: a list of modules", advice="trust=[mine]")
    admit_modules(names)
    return names


def refuse_other_class(made: Any, option: str, node: DictConfig, *kinds: type, advice: str = "") -> None:
    """Refuse what a config node of an option makes, if it is of none of these classes.

    Raises:
        UsageError: with its class and those that are allowed.
    """
    if not isinstance(made, kinds):
        got = f"{option}: {node._target_} makes an object of class {type(made).__name__}"
        raise UsageError(f"{got}; allowed: {', '.join(kind.__name__ for kind in kinds)}", advice=advice)


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
        cause = cause_of(error)
        if isinstance(cause, InvdynError):
            raise cause from None
        raise UsageError(f"{node.get('_target_', 'a config')}: {type(cause).__name__}: {cause}") from error


def plain(value: Any) -> Any:
    """A value of a config in plain Python."""
    return OmegaConf.to_container(value, resolve=True) if OmegaConf.is_config(value) else value


def target_of(node: DictConfig) -> Any:
    """The class or function that a config node names; None where it cannot be found, which the instantiation tells."""
    admit_modules(_targets(node))
    try:
        return hydra.utils.get_object(node._target_)
    except Exception:
        return None


def _refuse_wrong_types(node: DictConfig) -> None:
    """Compare plain values with the annotations of the dataclass that takes them."""
    target = target_of(node)
    try:
        hints = get_type_hints(target) if is_dataclass(target) else {}
    except Exception:  # unreadable annotations are told by the instantiation itself
        return
    for name, hint in hints.items():
        if name not in node or OmegaConf.is_missing(node, name):
            continue
        value = node[name]
        if not suits(plain(value), hint):
            got = "null" if value is None else value
            raise UsageError(f"{node._get_full_key(name)}={got}; allowed: {in_words(hint)}")


def _targets(node: Any) -> Iterator[str]:
    """All classes and functions that a config names."""
    if isinstance(node, DictConfig):
        if isinstance(target := node.get("_target_"), str):
            yield target
        for name in node:
            if not OmegaConf.is_missing(node, name):
                yield from _targets(node[name])
    elif isinstance(node, ListConfig):
        for one in node:
            yield from _targets(one)


def cause_of(error: BaseException) -> BaseException:
    """The original failure, or the first one that has a message of invdyn."""
    while error.__cause__ is not None and not isinstance(error, InvdynError):
        error = error.__cause__
    return error
