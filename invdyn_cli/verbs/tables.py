"""invdyn tables: runs what experiments/NAME.yaml asks for, and writes its table beside the paper's statements."""

import sys
from collections.abc import Sequence
from pathlib import Path

from omegaconf import DictConfig
from rich.table import Table
from rich.text import Text

from invdyn_cli.files import write_file
from invdyn_cli.report import comparison
from invdyn_cli.report.comparison import Grid
from invdyn_cli.report.tables import csv_text
from invdyn_cli.verbs import published
from invdyn_cli.verbs.launch import launch
from invdyn_cli.verbs.objects import trusted
from invdyn_cli.verbs.published import Published
from invdyn_cli.verbs.screen import Screen

WIDTH = 150
"""Columns of a table that goes into a file or a pipe."""


def main(argv: Sequence[str]) -> int:
    """Run with the overrides in argv; the exit code."""
    return launch("tables", argv, task)


def task(config: DictConfig) -> None:
    """Run what is not complete, then tell and write the table."""
    done = published.run_all(
        str(config.experiment),
        Path(config.folder),
        Path(config.real_data).resolve(),
        fresh=config.fresh,
        trust=trusted(config),
        workers=config.workers,
    )
    path = write(done, Path(config.folder))
    console = Screen(width=None if sys.stdout.isatty() else WIDTH)
    for title, found in ((done.spec["title"], done.table), ("Beside the paper's statements", done.verdicts)):
        if found:
            console.print(_table(title, found))
    console.whole(path)


def write(done: Published, folder: Path) -> Path:
    """NAME.csv and NAME.md in `folder`; the latter's path."""
    text = f"# {done.spec['title']}\n\n{done.spec['source']}\n\n{comparison.markdown(done.table)}"
    if done.verdicts:
        text += f"\n## Beside the paper's statements\n\n{comparison.markdown(done.verdicts)}"
    write_file(folder / f"{done.name}.csv", csv_text([done.table.heads, *done.table.rows]))
    return write_file(folder / f"{done.name}.md", text)


def _table(title: str, grid: Grid) -> Table:
    table = Table(
        title=title, title_justify="left", show_lines=any(len(cell) > 60 for row in grid.rows for cell in row)
    )
    for head in grid.heads:
        table.add_column(head, overflow="fold")
    for row in grid.rows:
        table.add_row(*map(Text, row))
    return table
