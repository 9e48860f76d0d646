"""A column map as plain values and as YAML: read with every value checked, written with how each entry is known."""

import json
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from invdyn_cli.errors import InvdynError, UsageError, closest, listed, shortened
from invdyn_cli.formats.columns import GIVEN, NONE, Channel, ColumnMap, numbered
from invdyn_cli.formats.units import ALLOWED, canonical
from invdyn_cli.log import CHANNELS, POSITION_SIDES, TORQUE_SIDES
from invdyn_cli.untrusted import read_text

TEXTS = ("robot_name", "urdf", "torque_side", "position_side", "origin", "licence", "topic")
FIELD = {"robot_name": "robot", "origin": "source"}
"""Entries with another name than in a log, because robot and source mean other things on the command line."""

SIDES = {"torque_side": TORQUE_SIDES, "position_side": POSITION_SIDES}
ENTRIES = (*TEXTS, "joints", "rate", "drive_gain", "time", *CHANNELS)
FIELDS = ("columns", "unit", "sign", "full_scale")


class _Plain(yaml.SafeLoader):
    """Safe YAML without references, because with them a small file can expand to a huge one."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.events.AliasEvent):
            raise yaml.YAMLError("it has a reference (*…)")
        return super().compose_node(parent, index)


def plain_yaml(path: Path, raises: type[InvdynError], advice: str = "") -> Any:
    """The plain values of a YAML file.

    Raises:
        `raises`: if it is no such file, or names objects or references.
    """
    try:
        return yaml.load(read_text(path, raises, advice), _Plain)
    except (yaml.YAMLError, RecursionError) as error:
        raise raises(f"{path} is no YAML that can be read: {error}", advice=advice) from error


def load(path: Path) -> ColumnMap:
    """The map of a YAML file; its URDF is relative to it.

    Raises:
        UsageError: if it is no such file.
    """
    advice = "docs/formats.md shows a column map"
    tree = plain_yaml(path, UsageError, advice)
    if not isinstance(tree, Mapping):
        raise UsageError(f"{path} holds no column map; allowed: {listed(ENTRIES, most=20)}", advice=advice)
    return from_plain(tree, str(path), path.parent)


def from_plain(tree: Mapping[Any, Any], where: str, folder: Path = Path()) -> ColumnMap:
    """The map of a nested mapping, in which None says nothing; paths are relative to `folder`.

    Raises:
        UsageError: for an entry that there is not, or a value that it cannot have; `where` names the mapping in it.
    """
    for name in tree:
        if name not in ENTRIES:
            got = f"{where}: no entry {shortened(name)!r}{closest(str(name), ENTRIES)}"
            raise UsageError(f"{got}; allowed: {listed(ENTRIES, most=20)}")
    given = {name: value for name, value in tree.items() if value is not None}
    said: dict[str, Any] = {}
    for name in TEXTS:
        if name in given:
            said[FIELD.get(name, name)] = _text(given[name], f"{where}: {name}")
    for name, allowed in SIDES.items():
        if said.get(name, allowed[0]) not in allowed:
            raise UsageError(f"{where}: {name}={said[name]}; allowed: {', '.join(allowed)}")
    if said.get("urdf"):
        said["urdf"] = str(folder / Path(said["urdf"]).expanduser())
        if not Path(said["urdf"]).is_file():
            raise UsageError(f"{where}: urdf={said['urdf']} is no file")
    if "rate" in given:
        said["rate"] = _number(given["rate"], f"{where}: rate")
        if not 0 < said["rate"] < float("inf"):
            raise UsageError(f"{where}: rate={said['rate']}; allowed: above 0 Hz")
    said["joints"] = tuple(_text(x, f"{where}: joints") for x in _list(given.get("joints", [])))
    said["drive_gain"] = tuple(_number(x, f"{where}: drive_gain") for x in _list(given.get("drive_gain", [])))
    channels = {name: _channel(given[name], name, where) for name in CHANNELS if name in given}
    if "time" in given:
        channels["t"] = _channel(_renamed(given["time"], f"{where}: time"), "t", where)
    return ColumnMap(channels={name: x for name, x in channels.items() if x != Channel()}, **said)


def merged(first: ColumnMap, second: ColumnMap) -> ColumnMap:
    """The entries of `second`, completed by those of `first`."""
    empty = ColumnMap()
    own = {name: value for name, value in vars(second).items() if value != getattr(empty, name)}
    channels = dict(first.channels)
    for name, one in second.channels.items():
        said = {field: getattr(one, field) for field in FIELDS if getattr(one, field)}
        channels[name] = replace(first.channel(name), **said)
    return replace(first, **own | {"channels": channels})


def to_yaml(columns: ColumnMap, source: str, folder: Path) -> str:
    """The map as YAML for a file in `folder`; a comment at every entry that was guessed says so."""
    lines = [f"# Column map of {source}: invdyn convert columns=THIS, or data.columns=THIS"]

    def put(name: str, value: Any, *known: str) -> None:
        guesses = dict.fromkeys(columns.known[k] for k in known if columns.known.get(k, GIVEN) != GIVEN)
        comment = f"  # {'; '.join(guesses)}" if guesses else ""
        lines.append(f"{name}: {json.dumps(value, ensure_ascii=False)}{comment}")

    for name in TEXTS:
        if (value := getattr(columns, FIELD.get(name, name))) and value != "unknown":
            put(name, os.path.relpath(value, folder) if name == "urdf" else value, name)
    for name in ("joints", "rate", "drive_gain"):
        if (value := getattr(columns, name)) and value != numbered(len(columns.joints)):
            put(name, value, name)
    for name in ("t", *CHANNELS):
        one = columns.channel(name)
        if one.columns:
            parts = {field: list(value) for field in FIELDS if (value := getattr(one, field))}
            parts |= {field: x[0] for field, x in parts.items() if len(x) == 1 and field != "columns"}
            if name == "t":
                parts = {"column": one.columns[0], "unit": parts.get("unit")}
            put("time" if name == "t" else name, parts, name, f"{name}.unit")
    return "\n".join(lines) + "\n"


def _channel(value: Any, name: str, where: str) -> Channel:
    """A channel of a mapping; a bare text or list names its columns."""
    label = f"{where}: {'time' if name == 't' else name}"
    tree = value if isinstance(value, Mapping) else {"columns": value}
    for key in tree:
        if key not in FIELDS:
            raise UsageError(f"{label} has no {shortened(key)!r}; allowed: {', '.join(FIELDS)}")
    said = {key: _list(x) for key, x in tree.items() if x is not None}
    signs = tuple(_number(x, f"{label}.sign") for x in said.get("sign", []))
    if set(signs) - {1.0, -1.0}:
        raise UsageError(f"{label}.sign={list(signs)}; allowed: 1 or -1, a single value or one per joint")
    names = tuple(_text(x, f"{label}.columns") for x in said.get("columns", []))
    return Channel(
        columns=(NONE,) if [x.lower() for x in names] == [NONE] else names,
        unit=tuple(_unit(x, name, label) for x in said.get("unit", [])),
        sign=tuple(int(x) for x in signs),
        full_scale=tuple(_number(x, f"{label}.full_scale") for x in said.get("full_scale", [])),
    )


def _renamed(value: Any, label: str) -> Any:
    """The entry of the clock, which has one column."""
    if not isinstance(value, Mapping):
        return value
    for key in value:
        if key not in ("column", "unit"):
            raise UsageError(f"{label} has no {shortened(key)!r}; allowed: column, unit")
    return {"columns" if key == "column" else key: x for key, x in value.items()}


def _unit(value: Any, name: str, label: str) -> str:
    unit = canonical(str(value)) or ""
    for end in ("", "/s", "/s^2"):  # qd.unit=deg means deg/s
        if unit + end in ALLOWED[name]:
            return unit + end
    raise UsageError(f"{label}.unit={shortened(value)}; allowed: {', '.join(ALLOWED[name])}")


def _list(value: Any) -> list[Any]:
    return list(value) if isinstance(value, list | tuple) else [value]


def _text(value: Any, label: str) -> str:
    if isinstance(value, bool) or not isinstance(value, str | int):
        raise UsageError(f"{label}={shortened(value)}; allowed: text")
    return str(value)


def _number(value: Any, label: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise UsageError(f"{label}={shortened(value)}; allowed: a number")
    return float(value)
