"""Parquet tables, a file or a LeRobot dataset (a folder with meta/info.json): a trajectory for each episode."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from invdyn_cli.errors import LogError, listed, shortened
from invdyn_cli.formats.table import ASK, Table, Told, as_column, missing, refuse_size
from invdyn_cli.untrusted import read_json

INFO = Path("meta", "info.json")
EPISODE = "episode_index"
CHANNELS = {
    "observation.state": Told("q", unit=ASK),
    "action": Told("q_ref", unit=ASK),
    "observation.velocity": Told("qd", unit=ASK),
    "observation.effort": Told("tau", unit=ASK),
    "observation.torque": Told("tau", unit=ASK),
    "observation.current": Told("tau", unit=ASK),
}
"""LeRobot's names of a log's channels. It defines no units: they may be degrees, or percent of a joint's range."""

BY = "LeRobot's names"


def is_dataset(folder: Path) -> bool:
    """Whether a folder is a LeRobot dataset."""
    return (folder / INFO).is_file()


def read(path: Path, limit: float) -> tuple[Table, ...]:
    """The tables of a parquet file, or of all files of a LeRobot dataset.

    Raises:
        LogError: if it cannot be read, or holds more than `limit` [bytes].
    """
    names: dict[str, list[str]] = {}
    files = [path]
    if path.is_dir():
        files = sorted(path.glob("data/**/*.parquet"))
        names = _feature_names(path / INFO)
        if not files:
            raise LogError(f"{path} has no data/**/*.parquet; allowed: a whole LeRobot dataset")
    tables: list[Table] = []
    left = limit
    for file in files:
        columns, size = _columns(file, left)
        left -= size
        tables += _episodes(path.stem if len(files) == 1 else file.stem, columns, names)
    labels = [table.name for table in tables]
    if len(set(labels)) < len(labels):
        raise LogError(f"{path}: several episodes are called {listed(x for x in labels if labels.count(x) > 1)}")
    return tuple(tables)


def _feature_names(info: Path) -> dict[str, list[str]]:
    """Feature -> names of its elements, as far as the description has them."""
    tree = read_json(info, LogError)
    features = tree.get("features") if isinstance(tree, Mapping) else None
    out: dict[str, list[str]] = {}
    for name, one in (features if isinstance(features, Mapping) else {}).items():
        given: Any = one.get("names") if isinstance(one, Mapping) else None
        if isinstance(given, Mapping):  # {"motors": [...]}
            given = next(iter(given.values()), None)
        if isinstance(given, list) and all(isinstance(x, str) for x in given):
            out[name] = [shortened(x, 200) for x in given]
    return out


def _columns(path: Path, limit: float) -> tuple[dict[str, np.ndarray], float]:
    """Numbers of a file: (T,) or (T, n) by column, and the bytes that they take."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise missing(path, "pyarrow") from None
    try:
        with pyarrow.parquet.ParquetFile(path, memory_map=False) as file:
            groups = [file.metadata.row_group(k) for k in range(file.metadata.num_row_groups)]
            size = 8.0 * sum(g.column(k).num_values for g in groups for k in range(g.num_columns))
            refuse_size(path, size, limit)
            kept = [f.name for f in file.schema_arrow if _is_numeric(pyarrow, f.type)]
            table = file.read(columns=kept)
        return {name: _array(pyarrow, table.column(name), path, name) for name in kept}, size
    except (pyarrow.ArrowException, OSError, MemoryError) as error:
        raise LogError(f"{path} is no parquet file that can be read: {error}", advice="a new copy of it") from error


def _is_numeric(pyarrow: Any, kind: Any) -> bool:
    types = pyarrow.types
    if types.is_list(kind) or types.is_fixed_size_list(kind) or types.is_large_list(kind):
        return types.is_floating(kind.value_type) or types.is_integer(kind.value_type)
    return types.is_floating(kind) or types.is_integer(kind) or types.is_timestamp(kind)


def _array(pyarrow: Any, column: Any, path: Path, name: str) -> np.ndarray:
    kind, rows = column.type, len(column)
    if pyarrow.types.is_timestamp(kind):
        return column.cast(pyarrow.timestamp("ns")).cast(pyarrow.int64()).to_numpy()
    if hasattr(kind, "value_type"):
        flat = pyarrow.concat_arrays([chunk.flatten() for chunk in column.chunks]).to_numpy(zero_copy_only=False)
        if rows == 0 or len(flat) % rows:
            raise LogError(f"{path}: the lists of {name} differ in length; allowed: one number for each joint")
        return np.reshape(flat, (rows, -1))
    return column.to_numpy()


def _episodes(name: str, columns: Mapping[str, np.ndarray], names: Mapping[str, list[str]]) -> list[Table]:
    """The rows of each episode as a table; a file without episodes is one."""
    flat: dict[str, np.ndarray] = {}
    told: dict[str, Told] = {}
    lerobot = bool(set(columns) & set(CHANNELS))
    for column, x in columns.items():
        if x.ndim == 1:
            flat[column] = as_column(x)
            continue
        given = names.get(column, [])
        parts = given if len(given) == x.shape[1] else [str(k) for k in range(x.shape[1])]
        for k, part in enumerate(parts):
            flat[f"{column}/{part}"] = as_column(x[:, k])
            if column in CHANNELS:
                told[f"{column}/{part}"] = replace(CHANNELS[column], joint=part.removesuffix(".pos"))
    if lerobot and "timestamp" in flat:
        told["timestamp"] = Told("t", unit="s")
    episodes = flat.pop(EPISODE, None)
    if not lerobot or episodes is None or len(np.unique(episodes)) == 1:
        return [Table(name, flat, told, by=BY)]
    return [
        Table(f"episode_{k:06d}", {c: x[episodes == k] for c, x in flat.items()}, told, by=BY)
        for k in np.unique(episodes)
    ]
