"""invdyn collect: all runs below folders as one table, on the terminal and as a file."""

import io
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from omegaconf import DictConfig, ListConfig
from rich import box
from rich.table import Table
from rich.text import Text

from invdyn_cli import store, untrusted
from invdyn_cli.errors import InvdynError, RunFileError, UsageError, listed
from invdyn_cli.files import relative, write_file
from invdyn_cli.report.tables import csv_text, shortened, significant
from invdyn_cli.tracking.contract import flat
from invdyn_cli.verbs import screen
from invdyn_cli.verbs.launch import launch, quoted
from invdyn_cli.verbs.screen import Screen

CHOSEN = ("model", "data", "adaptation", "seed")
SCORES = {
    "validation_nmse": "validation.nmse.mean",
    "test_nmse": "test.nmse.mean",
    "test_rmse": "test.rmse.mean",
    "adapted_nmse": "adaptation_scores.nmse.mean",
    "fit_seconds": "seconds.fit",
    "predict_seconds": "seconds.predict",
    "total_seconds": "seconds.total",
    "parameters": "parameters",
}
"""Columns of numbers, and where each stands in metrics.json; RMSE in N m (N), times in s."""

SHOWN = {"test_nmse": "test NMSE", "test_rmse": "test RMSE", "adapted_nmse": "adapted NMSE", "total_seconds": "seconds"}
FORMATS = (".csv", ".parquet")

Row = dict[str, Any]


def main(argv: Sequence[str]) -> int:
    """Collect with the overrides in argv, bare paths being the folders; the exit code."""
    bare = [a for a in argv if not a.startswith(("-", "output=", "folders=", "hydra.", "hydra/"))]
    folders = [f"folders=[{','.join(map(quoted, bare))}]"] * bool(bare)
    return launch("collect", [*(a for a in argv if a not in bare), *folders], task)


def task(config: DictConfig) -> None:
    """Find, read, show, write."""
    target = _target(config.output)
    folders = config.folders if isinstance(config.folders, ListConfig) else [config.folders]
    found = sorted({path for folder in folders for path in _runs(Path(str(folder)).expanduser())})
    runs: list[tuple[Row, set[str], Mapping[str, Any]]] = []
    with screen.stages() as stage:
        report = stage("read")
        for number, folder in enumerate(found):
            report(number / len(found), folder.name)
            try:
                runs.append(_read(folder))
            except (InvdynError, ValueError, TypeError, KeyError, AttributeError, yaml.YAMLError) as error:
                screen.tell(f"left out: {relative(folder)}: {error}")
    if not runs:
        raise UsageError(f"no complete run below {listed(map(str, folders))}", advice="the folder of a sweep")
    rows = _table(runs)
    console = Screen()
    console.print(_shown(rows))
    if target:
        _write(rows, target)
        console.whole(target)


def _target(output: Any) -> Path | None:
    if output is None:
        return None
    target = Path(str(output)).expanduser()
    if not isinstance(output, str) or target.suffix not in FORMATS:
        raise UsageError(f"output={output}; allowed: NAME.csv or NAME.parquet")
    if target.suffix == ".parquet":
        try:
            import pyarrow  # noqa: F401
        except ImportError:
            got = f"output={output} needs the library pyarrow, which is not installed"
            raise UsageError(got, advice="pip install 'invdyn[formats]', or output=runs.csv") from None
    return target


def _runs(folder: Path) -> Iterator[Path]:
    """Folders that hold a run or a part of one."""
    if not folder.is_dir():
        screen.tell(f"left out: {folder}: no such folder")
        return
    for name in (store.RUN, store.METRICS):
        yield from (path.parent.resolve() for path in folder.rglob(name))


def _read(folder: Path) -> tuple[Row, set[str], Mapping[str, Any]]:
    """A run's choices and numbers, the options that its command named, and all its options.

    Raises:
        InvdynError, ValueError, TypeError, KeyError, AttributeError, YAMLError: for what is no complete run.
    """
    if not (folder / store.METRICS).is_file():
        raise RunFileError(f"not finished: it has no {store.METRICS}")
    metrics = untrusted.read_json(folder / store.METRICS, RunFileError)
    if metrics.get("schema") != store.METRICS_SCHEMA:
        raise RunFileError(f"{store.METRICS} has schema {metrics.get('schema')!r}; allowed: {store.METRICS_SCHEMA!r}")
    config, overrides = store.load_asked(folder / store.RUN)
    numbers = dict(flat(metrics))
    values = {name: numbers.get(place) for name, place in SCORES.items()}
    row = {"run": str(relative(folder)), **{name: metrics[name] for name in CHOSEN}}
    row |= {name: None if x is None else float(x) for name, x in values.items()}
    return row, {x.lstrip("+~").partition("=")[0] for x in overrides}, dict(flat(_options(config)))


def _options(config: str) -> Any:
    """The values of a YAML without aliases, because a few aliases can stand for any amount of text."""
    if any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(config)):
        raise RunFileError(f"the config in {store.RUN} has YAML aliases; allowed: plain values")
    return yaml.safe_load(config)


def _table(runs: Sequence[tuple[Row, set[str], Mapping[str, Any]]]) -> list[Row]:
    """A row for every run: folder, choices, options that some command named and that differ, numbers."""
    named = sorted(set().union(*(names for _, names, _ in runs)) - set(CHOSEN))
    options = [name for name in named if len({str(config.get(name)) for _, _, config in runs}) > 1]
    return [
        {
            **{name: row[name] for name in ("run", *CHOSEN)},
            **{name: _plain(config.get(name)) for name in options},
            **{name: row[name] for name in SCORES},
        }
        for row, _, config in runs
    ]


def _plain(value: Any) -> Any:
    return value if value is None or isinstance(value, int | float) else str(value)


def _shown(rows: Sequence[Row]) -> Table:
    """Only options that differ, and numbers that some run has; the lowest test NMSE is marked, and folders are shown
    relative to the one that contains all of them."""
    above = os.path.commonpath([Path(row["run"]).parent for row in rows])
    rows = [{**row, "run": os.path.relpath(row["run"], above or ".")} for row in rows]
    names = [name for name in rows[0] if name not in SCORES and len({str(row[name]) for row in rows}) > 1]
    names = names or ["run"]
    numbers = [name for name in SHOWN if any(row[name] is not None for row in rows)]
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, caption=Text(f"{len(rows)} runs below {above or '.'}"))
    for name in names:
        table.add_column(Text(name), overflow="fold")
    for name in numbers:
        table.add_column(SHOWN[name], justify="right", no_wrap=True)
    finite = [x for x in (row["test_nmse"] for row in rows) if x is not None and math.isfinite(x)]
    for row in rows:
        texts = [Text("" if row[name] is None else shortened(str(row[name]))) for name in names]
        best = bool(finite) and row["test_nmse"] == min(finite)
        table.add_row(*texts, *(significant(row[name]) for name in numbers), style="bold" if best else "")
    return table


def _write(rows: Sequence[Row], target: Path) -> None:
    """Numbers as they are; an empty field where there is none."""
    if target.suffix == ".csv":
        write_file(target, csv_text([list(rows[0]), *(row.values() for row in rows)]))
        return
    import pyarrow
    from pyarrow import parquet

    columns = {name: [row[name] for row in rows] for name in rows[0]}
    mixed = {name for name, values in columns.items() if len({type(x) for x in values if x is not None}) > 1}
    texts = {name: [None if x is None else str(x) for x in columns[name]] for name in mixed}
    buffer = io.BytesIO()
    parquet.write_table(pyarrow.table(columns | texts), buffer)
    write_file(target, buffer.getvalue())
