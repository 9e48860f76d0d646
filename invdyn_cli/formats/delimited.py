"""Text tables (csv, tsv, txt): any delimiter, a header or none, decimal commas, ISO times, bad rows."""

import csv
import re
import statistics
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from invdyn_cli.errors import LogError, shortened
from invdyn_cli.formats.table import Table, Told, refuse_size
from invdyn_cli.formats.units import canonical

DELIMITERS = (";", "\t", ",", " ")
SAMPLE = 200
"""Number of lines from which the delimiter is determined."""

MOST_BAD = 0.1
"""Share of rows that may be left out; with more, the file was probably misread."""

_NUMBER = re.compile(r"[-+]?(\d+[.,]?\d*|[.,]\d+)([eE][-+]?\d+)?|[-+]?(nan|inf|infinity)", re.IGNORECASE)
_DATE = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d.*")
_ZONE = re.compile(r"(Z|[-+]\d\d:?\d\d)$")


def read(path: Path, limit: float) -> tuple[Table, ...]:
    """The table of a text file; columns without a header are called c1, c2, ….

    Raises:
        LogError: if it is no table of numbers, or larger than `limit` [bytes].
    """
    refuse_size(path, path.stat().st_size, limit)
    try:
        text = path.read_bytes().decode("utf-8-sig", errors="replace")
    except OSError as error:
        raise LogError(f"{path} cannot be read: {error.strerror or error}") from error
    lines = [(k, line) for k, line in enumerate(text.splitlines(), 1) if line.strip()]
    comments = [line.lstrip(" #%") for _, line in lines if line.lstrip()[0] in "#%"]
    lines = [(k, line) for k, line in lines if line.lstrip()[0] not in "#%"]
    if not lines:
        raise LogError(f"{path} has no rows; allowed: a table of numbers")
    delimiter = _delimiter([line for _, line in lines[1 : 1 + SAMPLE]] or [lines[0][1]])
    rows = list(zip((k for k, _ in lines), _split([line for _, line in lines], delimiter), strict=True))
    names, rows = _header(_below_titles(rows))
    if not names and comments and len(last := _split(comments[-1:], delimiter)[0]) == len(rows[-1][1]):
        names = last
    width = len(names) or statistics.mode(len(row) for _, row in rows)
    names = _unique(names or [f"c{k}" for k in range(1, width + 1)])
    if not rows:
        raise LogError(f"{path} has a header and no rows")
    rows = [(k, row if any(row[width:]) else row[:width]) for k, row in rows]  # without delimiters at their ends
    if all(len(row) != width for _, row in rows):
        (k, row), *_ = rows
        got = f"{path}: line {k} has {len(row)} cells, the header has {width}"
        raise LogError(f"{got}; allowed: one name for each column")
    return (_table(path, names, rows, comma=delimiter != ","),)


def _table(path: Path, names: Sequence[str], rows: list[tuple[int, list[str]]], comma: bool) -> Table:
    """Columns of numbers and times; rows with other contents or another number of cells are left out, with a note."""
    total, first_bad = len(rows), ""
    whole = [(k, row) for k, row in rows if len(row) == len(names)]
    if len(whole) < total:
        k, row = next((k, row) for k, row in rows if len(row) != len(names))
        first_bad = f"line {k} has {len(row)} cells, not {len(names)}"
    columns: dict[str, np.ndarray] = {}
    told: dict[str, Told] = {}
    good = np.ones(len(whole), bool)
    for name, cells in zip(names, zip(*(row for _, row in whole), strict=True), strict=True):
        if _is_times(cells):
            columns[name], told[name] = _times(path, name, cells), Told("t", unit="ns")
            continue
        numbers, bad = _numbers(cells, comma)
        if bad.mean() > 0.5 or np.isnan(numbers).all():
            continue  # text, or nothing
        if bad.any() and not first_bad:
            at = int(np.flatnonzero(bad)[0])
            first_bad = f"line {whole[at][0]} has {shortened(cells[at], 30)!r} in {name}"
        columns[name] = numbers
        good &= ~bad
    left_out = total - int(good.sum())
    if not columns or left_out > MOST_BAD * total:
        got = f"{path}: {left_out} of {total} rows are no numbers" if columns else f"{path} has no column of numbers"
        raise LogError(f"{got}{f', {first_bad}' if first_bad else ''}; allowed: a table with one delimiter")
    notes = (f"{left_out} of {total} rows are left out; {first_bad}.",) if left_out else ()
    return Table(path.stem, {name: x[good] for name, x in columns.items()}, told, notes, "the form of its cells")


def _delimiter(lines: Sequence[str]) -> str:
    """The delimiter that makes most cells numbers in rows of one length."""

    def score(delimiter: str) -> tuple[float, int]:
        rows = _split(lines, delimiter)
        width = statistics.mode(map(len, rows))
        cells = [cell for row in rows if len(row) == width for cell in row]
        numbers = sum(1 for cell in cells if _is_number(cell, delimiter != ",") or not cell or _DATE.fullmatch(cell))
        return numbers / sum(map(len, rows)), width

    return max(DELIMITERS, key=score)


def _split(lines: Sequence[str], delimiter: str) -> list[list[str]]:
    if delimiter == " ":
        return [line.split() for line in lines]
    return [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=delimiter, skipinitialspace=True)]


def _below_titles(rows: list[tuple[int, list[str]]]) -> list[tuple[int, list[str]]]:
    """The rows from the header on, where lines of another length stand above it."""
    widths = [len(row) for _, row in rows]
    first = widths.index(statistics.mode(widths))
    return rows if any(_is_number(cell, True) for cell in rows[first][1]) else rows[first:]


def _header(rows: list[tuple[int, list[str]]]) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """The names in the first row, with the units of a second row of words; [] where the first row has numbers."""
    if any(_is_number(cell, True) for cell in rows[0][1]):
        return [], rows
    names, rest = rows[0][1], rows[1:]
    if rest and len(rest[0][1]) == len(names) and not any(_is_number(cell, True) for cell in rest[0][1]):
        units = rest[0][1]
        if sum(canonical(unit.strip("[]()")) is not None for unit in units) >= 0.5 * len(units):
            return [f"{n} [{u.strip('[]()')}]" for n, u in zip(names, units, strict=True)], rest[1:]
    return names, rest


def _unique(names: Sequence[str]) -> list[str]:
    out: list[str] = []
    for k, name in enumerate(names, 1):
        name = shortened(name, 200) or f"c{k}"
        out.append(name if name not in out else f"{name}.{k}")
    return out


def _is_number(cell: str, comma: bool) -> bool:
    return bool(_NUMBER.fullmatch(cell)) and (comma or "," not in cell)


def _is_times(cells: Sequence[str]) -> bool:
    return bool(_DATE.fullmatch(cells[0])) and bool(_DATE.fullmatch(cells[-1]))


def _times(path: Path, name: str, cells: Sequence[str]) -> np.ndarray:
    """ISO times as nanoseconds, the zone of the first row left out."""
    try:
        plain = [_ZONE.sub("", cell.replace(" ", "T", 1)) for cell in cells]
        return np.array(plain, "datetime64[ns]").astype(np.int64)
    except ValueError as error:
        raise LogError(f"{path}: {name} holds times that cannot be read: {error}", advice="ISO 8601") from error


def _numbers(cells: Sequence[str], comma: bool) -> tuple[np.ndarray, np.ndarray]:
    """The numbers (T,) of a column, and which cells (T,) are not numbers; empty cells are NaN."""
    text = [cell.replace(",", ".") for cell in cells] if comma else list(cells)
    bad = np.zeros(len(text), bool)
    try:
        numbers = np.array(text, float)
    except ValueError:
        numbers = np.full(len(text), np.nan)
        for k, cell in enumerate(text):
            if _is_number(cell, False):
                numbers[k] = float(cell)
            else:
                bad[k] = cell.lower() not in ("", "na", "n/a", "null", "none")
    if len(numbers) and np.abs(numbers[~bad]).max(initial=0) > 2**53 and all(x.lstrip("+-").isdigit() for x in text):
        return np.array([int(x) for x in text], np.int64), bad
    return numbers, bad
