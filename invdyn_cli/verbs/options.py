"""The meaning of every option, without importing what it configures.

The text of an option is in one place: in the docstring (`Attributes:` or `Args:`) of the object that its config node
builds (`_target_`) or, if the option builds none, in the comment behind it in the verb's YAML.
"""

import ast
import importlib.util
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import hydra
from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig, OmegaConf

from invdyn_cli.verbs.launch import config_folder, search_path
from invdyn_cli.verbs.objects import plain

OBJECTS = {"control": "invdyn_cli.control.Sweep"}
"""Verbs whose own options are the fields of an object."""

_ENTRY = re.compile(r"(?P<names>\w+(?:, \w+)*): (?P<text>.+)")
_AS_IN = re.compile(r"as in (\w+)=(\w+)")
_OPTION = re.compile(r"(?P<indent> *)(?P<key>\w+):(?P<value>[^#]*)(?:# (?P<text>.*))?$")


class Option(NamedTuple):
    """An option: its name, its value as the command line writes it, what it means, and the group that it belongs to
    ("" for the verb's own)."""

    name: str
    value: str
    text: str
    group: str = ""


class Described(NamedTuple):
    """The options of a verb, and the choice of every group that it has (null: none)."""

    options: tuple[Option, ...]
    chosen: Mapping[str, str | None]


def described(verb: str, overrides: Sequence[str] = ()) -> Described:
    """All options of a verb with these overrides.

    Raises:
        HydraException: for overrides that do not compose.
    """
    config = composed(verb, overrides)
    choices = {str(name): choice for name, choice in reversed(config.hydra.runtime.choices.items())}
    chosen = {name: choice for name, choice in choices.items() if "/" not in name}
    texts = comments(config_folder() / f"{verb}.yaml")
    texts |= lines_of(OBJECTS[verb]) if verb in OBJECTS else {}
    own, grouped = [], []
    for option in _options(config, "", texts):
        group = option.name.partition(".")[0]
        (grouped if group in chosen else own).append(option._replace(group=group if group in chosen else ""))
    return Described((*own, *grouped), chosen)


def composed(verb: str, overrides: Sequence[str] = ()) -> DictConfig:
    """The verb's config with these overrides, Hydra's own options too.

    Raises:
        HydraException: for overrides that do not compose.
    """
    GlobalHydra.instance().clear()
    with hydra.initialize_config_dir(str(config_folder()), version_base="1.3"):
        return hydra.compose(verb, [*overrides, *search_path(overrides)], return_hydra_config=True)


def choices_of(group: str) -> dict[str, Path]:
    """The choices of a group and their files: the package's, then those of the working directory and its conf/."""
    places = [config_folder(), Path.cwd(), Path.cwd() / "conf"]
    files = [path for place in places for path in sorted((place / group).glob("*.yaml"))]
    found: dict[str, Path] = {}
    for path in files:
        found.setdefault(path.stem, path)
    return dict(sorted(found.items()))


def headline(path: Path) -> str:
    """The first sentence of the comment at the top of a YAML."""
    lines = []
    for line in path.read_text(encoding="utf-8").splitlines():
        if not line.startswith("# ") or line.startswith("#  "):
            break
        lines.append(line[2:])
    return first_sentence(" ".join(lines))


def first_sentence(text: str) -> str:
    """The text up to the first full stop before a capital letter, without it."""
    return re.split(r"\.(?=\s+[A-Z0-9`])|\.$", " ".join(text.split()), maxsplit=1)[0]


def lines_of(target: str) -> dict[str, str]:
    """The line of each field of a class, or argument of a function, from its docstring, which is parsed, not run.

    `as in GROUP=CHOICE` refers to the option of that name there. {} for what has no source here.
    """
    node = find(target)
    found: dict[str, str] = {}
    for names, text in _entries((ast.get_docstring(node) or "") if node else ""):
        reference = _AS_IN.match(text)
        if reference:
            other = OmegaConf.load(config_folder() / reference[1] / f"{reference[2]}.yaml")._target_
            found |= {name: lines_of(other)[name] for name in names if name in lines_of(other)}
        else:
            found |= dict.fromkeys(names, text)
    return found


def find(target: str) -> ast.ClassDef | ast.FunctionDef | None:
    """The class or function of that dotted name in its source; None where there is no source to read."""
    module, _, name = target.rpartition(".")
    path = source_of(module)
    if path is None:
        return None
    for node in _parsed(path, path.stat().st_mtime_ns).body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name == name:
            return node
        if isinstance(node, ast.ImportFrom) and node.module and any((x.asname or x.name) == name for x in node.names):
            return find(f"{node.module}.{next(x.name for x in node.names if (x.asname or x.name) == name)}")
    return None


@lru_cache(maxsize=64)
def _parsed(path: Path, changed: int) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def source_of(module: str) -> Path | None:
    """The file of a module; nothing of it is imported, and the working directory is searched last."""
    top, *rest = module.split(".")
    spec = importlib.util.find_spec(top) if top not in sys.modules or sys.modules[top].__spec__ else None
    roots = [Path(place) for place in (spec.submodule_search_locations or ())] if spec else []
    alone = [Path(spec.origin)] if spec and spec.origin and not rest and not roots else []
    for root in (*roots, Path.cwd() / top):
        place = root.joinpath(*rest)
        alone += [place.with_suffix(".py"), place / "__init__.py"]
    return next((path for path in alone if path.is_file()), None)


def comments(path: Path) -> dict[str, str]:
    """Dotted option -> the comment behind it in a YAML, with the lines of comment alone that continue it."""
    found: dict[str, str] = {}
    above: list[tuple[int, str]] = []
    last = ""
    for line in path.read_text(encoding="utf-8").splitlines():
        if last and re.match(r"\s+# ", line):
            found[last] += " " + line.split("# ", 1)[1]
            continue
        last = ""
        match = _OPTION.match(line)
        if match:
            indent = len(match["indent"])
            above = [*((at, key) for at, key in above if at < indent), (indent, match["key"])]
            if match["text"]:
                last = ".".join(key for _, key in above)
                found[last] = match["text"]
    return found


def _entries(docstring: str) -> Iterator[tuple[list[str], str]]:
    """(names, text) of each entry of the sections Attributes and Args."""
    inside, entry = False, ""
    for line in [*docstring.splitlines(), "end"]:
        indent = len(line) - len(line.lstrip())
        if inside and line.strip() and indent >= 8:
            entry += " " + line.strip()
            continue
        if entry and line.strip() and (match := _ENTRY.match(entry)):
            yield match["names"].split(", "), match["text"]
        if line.strip():
            entry = line.strip() if inside and indent == 4 else ""
            inside = (indent > 0 and inside) or line in ("Attributes:", "Args:")


def _options(node: DictConfig, place: str, texts: Mapping[str, str]) -> Iterator[Option]:
    """The options of a node, `texts` by their names within it or, of the verb's own, by their dotted names."""
    for key in map(str, node):
        name = f"{place}{key}"
        if key.startswith("_") or name == "hydra":
            continue
        text = texts.get(name, texts.get(key, ""))
        value = None if OmegaConf.is_missing(node, key) else node[key]
        if isinstance(value, DictConfig) and "_target_" in value:
            yield from _options(value, f"{name}.", lines_of(value["_target_"]))
        elif isinstance(value, DictConfig) and value and not text:
            yield from _options(value, f"{name}.", texts)
        else:
            yield Option(name, "" if OmegaConf.is_missing(node, key) else _shown(value), text.replace("None", "null"))


def _shown(value: Any) -> str:
    """A value in the syntax of the command line."""
    value = plain(value)
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{k}: {_shown(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_shown, value)) + "]"
    return {None: "null", True: "true", False: "false"}[value] if value is None or type(value) is bool else str(value)
