"""Shows how a file of another format was read: the column map as a table, what is doubtful, and the map as YAML."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from invdyn_cli.data.recorded import RealLog
from invdyn_cli.errors import shortened
from invdyn_cli.files import write_file
from invdyn_cli.formats.columns import GIVEN, NONE, ColumnMap
from invdyn_cli.formats.map_file import to_yaml
from invdyn_cli.formats.reading import import_one, is_foreign
from invdyn_cli.log import CHANNELS, Log
from invdyn_cli.report.tables import text_table
from invdyn_cli.verbs.screen import Screen

Maps = list[tuple[Path, ColumnMap]]
"""Files, and how each was read."""


def show_all(source: Any, console: Screen) -> Maps:
    """Report for every file of a source that is not an invdyn log how it is read."""
    if not isinstance(source, RealLog):
        return []
    maps = []
    for path in (Path(x).expanduser() for x in source.path):
        if is_foreign(path):
            made = import_one(path, source.columns, source.limit)
            console.whole(f"{path} is read as:")
            show(made.log, made.columns, console)
            maps.append((path, made.columns))
    return maps


def keep(maps: Maps, folder: Path, console: Screen) -> None:
    """Write the maps into the folder of the results if there are any; a refused command leaves no folder."""
    for path, columns in maps:
        saved = write_file(folder / f"{path.stem}.columns.yaml", to_yaml(columns, path.name, folder))
        console.whole(f"column map: {saved} (data.columns= takes it)")


def show(log: Log, columns: ColumnMap, console: Screen) -> None:
    """The map as a table, the size of the log, and the notes."""
    console.print(text_table(("channel", "columns", "unit", "sign", "how known"), _rows(columns)))
    rows = sum(len(one.t) for one in log.trajectories)
    torque = "no torque" if columns.channel("tau").columns in ((), (NONE,)) else f"torque in {log.torque_unit}"
    side = columns.known.get("torque_side", "not said")
    count = f"{len(log.trajectories)} {'trajectory' if len(log.trajectories) == 1 else 'trajectories'}"
    console.print(
        f"{count}, {rows} rows, {log.rate:g} Hz, {torque}, torque side {log.torque_side} ({side}), "
        f"joints: {', '.join(log.joints)}"
    )
    for note in columns.notes:
        console.warn(note)


def _rows(columns: ColumnMap) -> Iterator[tuple[str, ...]]:
    for name in ("t", *CHANNELS):
        one = columns.channel(name)
        if one.columns in ((), (NONE,)):
            if name in ("t", "tau"):
                made = f"row number / {columns.rate:g} Hz" if name == "t" else "(none)"
                yield name, made, "s" if name == "t" else "", "", columns.known.get(name, "")
            continue
        known = columns.known.get(name, GIVEN), columns.known.get(f"{name}.unit", GIVEN)
        how = known[0] if known[0] == known[1] else f"{known[0]}; unit {known[1]}"
        sign = "".join("-" if x < 0 else "+" for x in one.sign) or "+"
        ends = [shortened(x, 40) for x in (one.columns[0], one.columns[-1])]
        named = ends[0] if len(one.columns) == 1 else f"{ends[0]} … {ends[1]} ({len(one.columns)})"
        yield name, named, ", ".join(dict.fromkeys(one.unit)), sign, how
