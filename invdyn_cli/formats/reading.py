"""Logs of any format: an invdyn log as it is, every other file by its column map, guessed where none is given."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from invdyn_cli import hdf5, logfile
from invdyn_cli.errors import LogError, UsageError, closest, listed
from invdyn_cli.formats import delimited, map_file, mat, npz, parquet, rosbag
from invdyn_cli.formats.columns import ColumnMap, log_from
from invdyn_cli.formats.guess import complete
from invdyn_cli.formats.table import Table
from invdyn_cli.log import Log

READERS = {".npz": npz.read, ".mat": mat.read, ".parquet": parquet.read}
READERS |= dict.fromkeys((".csv", ".tsv", ".txt", ".dat"), delimited.read)
BAGS = (".bag", ".db3", ".mcap")
KINDS = "csv, tsv, txt, npz, mat, parquet, bag, db3, mcap, the folder of a ROS 2 bag or of a LeRobot dataset"

FEWEST = 3
"""Least number of rows of a recording: with fewer there are no steps to compare."""

Columns = str | Path | Mapping[str, Any] | None
"""A column map: the path of a YAML file, its entries, or None: all is guessed."""


@dataclass(frozen=True)
class Imported:
    """A log from files of another format, and the whole map that made it."""

    log: Log
    columns: ColumnMap


def is_foreign(path: str | Path) -> bool:
    """Whether a path is a file of another format than invdyn's, by its ending, or by what a folder holds."""
    path = Path(path).expanduser()
    if path.is_dir():
        return rosbag.is_bag(path) or parquet.is_dataset(path)
    return path.is_file() and path.suffix.lower() in (*READERS, *BAGS)


def files_of(path: str | Path) -> list[Path]:
    """The files that a path means: of a folder that is no recording itself, all those of the one kind in it; text files
    beside others are notes. A folder of invdyn logs, and one without recordings, stay as they are.

    Raises:
        LogError: for a folder with files of several kinds.
    """
    path = Path(path).expanduser()
    if not path.is_dir() or is_foreign(path):
        return [path]
    files = sorted(x for x in path.iterdir() if is_foreign(x))
    if any(x.suffix in (".h5", ".hdf5") for x in path.iterdir()):
        return [path]
    files = [x for x in files if x.suffix.lower() != ".txt"] or files
    if len({x.suffix.lower() for x in files}) > 1:
        got = f"{path} is a folder of files of several kinds: {listed(x.name for x in files)}"
        raise LogError(f"{got}; allowed: one kind", advice=f"data.path=[{','.join(map(str, files[:2]))}], some of them")
    return files or [path]


def imported(paths: Sequence[str | Path], given: ColumnMap, limit: float = hdf5.LIMIT) -> Imported:
    """One log of files that have the same columns, a trajectory for each recording in them.

    Raises:
        LogError: for a file that cannot be read, columns that leave something open or differ between files.
    """
    paths = [file for path in paths for file in files_of(path)]
    tables = [table for path in paths for table in read_tables(path, limit, given.topic)]
    names = [table.name for table in tables]
    if len(set(names)) < len(names):
        twice = listed(dict.fromkeys(name for name in names if names.count(name) > 1))
        raise LogError(f"several recordings are called {twice}; allowed: files with different names")
    where = str(paths[0])
    for table in tables:
        if (rows := len(next(iter(table.columns.values()), ()))) < FEWEST:
            raise LogError(f"{where}: {table.name} has {rows} rows of numbers; allowed: at least {FEWEST}")
    columns = complete(where, tables[0], given)
    columns = replace(columns, notes=(*columns.notes, *(note for table in tables for note in table.notes)))
    return Imported(log_from(where, tables, columns), columns)


def read_tables(path: Path, limit: float, topic: str = "") -> tuple[Table, ...]:
    """The recordings of a file as it has them.

    Raises:
        LogError: if there is none, it has another format, is damaged, or holds more than `limit` [bytes].
    """
    if not path.exists():
        near = [p.name for p in path.parent.glob("*")] if path.parent.is_dir() else []
        raise LogError(f"no file {path}{closest(path.name, near)}")
    kind = path.suffix.lower()
    if path.is_dir() and parquet.is_dataset(path):
        return parquet.read(path, limit)
    if kind in BAGS or (path.is_dir() and rosbag.is_bag(path)):
        return rosbag.read(path, limit, topic)
    if path.is_file() and kind in READERS:
        return READERS[kind](path, limit)
    raise LogError(f"{path} has an unknown format; allowed: {KINDS}")


def import_one(path: str | Path, columns: Columns = None, limit: float = hdf5.LIMIT) -> Imported:
    """The log of one file; read once while the file and the map stay as they are.

    Raises:
        LogError, UsageError: as `imported` and `map_file.load`.
    """
    path = Path(path).expanduser()
    if columns is not None and not isinstance(columns, str | Path | Mapping):
        raise UsageError(f"data.columns={columns}; allowed: the path of a column map, or its entries")
    text = json.dumps(columns, sort_keys=True, default=str) if isinstance(columns, Mapping) else ""
    given = Path(columns).expanduser() if isinstance(columns, str | Path) else None
    return _kept(path, _stamp(path), text, given, _stamp(given) if given else (), limit)


@lru_cache(maxsize=16)
def _kept(path: Path, stamp: tuple, text: str, map_path: Path | None, map_stamp: tuple, limit: float) -> Imported:
    given = map_file.load(map_path) if map_path else ColumnMap()
    given = map_file.from_plain(json.loads(text), "data.columns") if text else given
    return imported([path], given, limit)


def read_log(
    path: str | Path,
    names: Iterable[str] | None = None,
    *,
    check: bool = True,
    columns: Columns = None,
    limit: float = hdf5.LIMIT,
) -> Log:
    """The log at `path`, in any format; otherwise as `logfile.read_log`.

    Raises:
        LogError, UsageError: as `logfile.read_log` and `import_one`.
    """
    if not is_foreign(path):
        return logfile.read_log(path, names, check=check, limit=limit)
    log = import_one(path, columns, limit).log
    found = {one.name: one for one in log.trajectories}
    chosen = list(found) if names is None else list(names)
    for name in chosen:
        if name not in found:
            raise LogError(f"{path}: no trajectory {name!r}{closest(name, found)}; it has {listed(found)}")
    log = replace(log, trajectories=tuple(found[name] for name in chosen))
    if check:
        logfile.refuse_defects(log, str(path))
    return log


def trajectory_names(path: str | Path, columns: Columns = None, limit: float = hdf5.LIMIT) -> tuple[str, ...]:
    """The names of all trajectories at `path`; failures as `read_log`."""
    if not is_foreign(path):
        return logfile.trajectory_names(path)
    return tuple(one.name for one in import_one(path, columns, limit).log.trajectories)


def _stamp(path: Path) -> tuple:
    """A value that changes when the file, or a file in the folder, changes."""
    files = sorted(path.rglob("*")) if path.is_dir() else [path]
    return tuple((str(x), s.st_mtime_ns, s.st_size) for x in files if x.is_file() for s in (x.stat(),))
