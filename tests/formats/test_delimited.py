"""Text tables: delimiters, headers, decimal commas, times, bad rows."""

from pathlib import Path

import numpy as np
import pytest

from invdyn_cli.errors import LogError
from invdyn_cli.formats import delimited

ROWS = [(0.0, 1.5, -2.25), (0.01, 1.25, 2.5e-3), (0.02, -1.0, 7.0)]


def table(folder: Path, text: str, encoding: str = "utf-8"):
    """The table of a text."""
    path = folder / "log.csv"
    path.write_bytes(text.encode(encoding))
    (found,) = delimited.read(path, 1e9)
    return found


def lines(delimiter: str, comma: bool = False) -> str:
    rows = "\n".join(delimiter.join(repr(x) for x in row) for row in ROWS)
    return rows.replace(".", ",") if comma else rows


@pytest.mark.parametrize(
    ("delimiter", "comma"),
    [(",", False), (";", False), (";", True), ("\t", False), ("\t", True), (" ", False), ("  ", True)],
)
@pytest.mark.parametrize("head", [True, False])
def test_delimiters(delimiter, comma, head, tmp_path):
    """Comma, semicolon, tab and spaces are told, decimal commas too, with a header or without."""
    text = (delimiter.join(("t", "q1", "tau1")) + "\n" if head else "") + lines(delimiter, comma)
    found = table(tmp_path, text)
    assert list(found.columns) == (["t", "q1", "tau1"] if head else ["c1", "c2", "c3"])
    np.testing.assert_array_equal(np.column_stack(list(found.columns.values())), ROWS)


def test_headers(tmp_path):
    """A byte-order mark is no part of a name, a commented header counts, a second row of units is put to the names,
    names that stand twice stay apart."""
    assert list(table(tmp_path, "t,q1,tau1\n" + lines(","), "utf-8-sig").columns) == ["t", "q1", "tau1"]
    assert list(table(tmp_path, "# a log\n# t,q1,tau1\n" + lines(",")).columns) == ["t", "q1", "tau1"]
    assert list(table(tmp_path, "t;q1;tau1\ns;deg;Nm\n" + lines(";")).columns) == ["t [s]", "q1 [deg]", "tau1 [Nm]"]
    assert list(table(tmp_path, "t,q1,q1\n" + lines(",")).columns) == ["t", "q1", "q1.3"]


def test_quoted_cells(tmp_path):
    """Quotes as RFC 4180 has them, text columns are left out, Windows' line ends make no difference."""
    found = table(tmp_path, '"t","mode, now","q1"\r\n0,"run, free",1\r\n1,"run, free",2\r\n')
    assert list(found.columns) == ["t", "q1"] and list(found.columns["q1"]) == [1.0, 2.0]


def test_times(tmp_path):
    """ISO times are nanoseconds since 1970, with Z or an offset too; whole nanoseconds keep every digit."""
    found = table(tmp_path, "when,q1\n2024-05-01T10:00:00.000000001Z,1\n2024-05-01T10:00:00.010Z,2\n")
    assert np.diff(found.columns["when"])[0] == 10_000_000 - 1 and found.told["when"].unit == "ns"
    found = table(tmp_path, "t_ns,q1\n1700000000000000001,1\n1700000000000000002,2\n")
    assert list(found.columns["t_ns"]) == [1700000000000000001, 1700000000000000002]


def test_bad_rows(tmp_path):
    """Rows that are cut off or hold words are left out, and the first is told with its line; an empty cell is NaN."""
    good = [f"{k / 100},{k},{k}" for k in range(100)]
    found = table(tmp_path, "\n".join(["t,q1,tau1", *good[:50], "0.5,12", *good[50:], "1.0,oops,3", "1.01,,3"]))
    assert len(found.columns["t"]) == 101 and np.isnan(found.columns["q1"][-1])
    assert found.notes == ("2 of 103 rows are left out; line 52 has 2 cells, not 3.",)


@pytest.mark.parametrize(("above", "end"), [("", ","), ("An arm\n", ""), ("An arm, at night\n\n", ""), ("", ",,")])
def test_what_loggers_write_about_a_table(above, end, tmp_path):
    """Titles above the header, and delimiters after the last cell of each row, are no part of it."""
    text = above + "t,q1,tau1\n" + "".join(f"{k},{k},{2 * k}{end}\n" for k in range(5))
    found = table(tmp_path, text)
    assert {name: list(x) for name, x in found.columns.items()} == {
        name: [factor * k for k in range(5)] for name, factor in (("t", 1), ("q1", 1), ("tau1", 2))
    }


@pytest.mark.parametrize("head", ["t,q1", "t,q1,tau1,tau2", "An arm", "hello world"])
def test_a_header_of_another_length(head, tmp_path):
    """Nothing is assigned to names that are fewer or more than the columns."""
    text = head + "\n" + "".join(f"{k},{k},{k}\n" for k in range(5))
    with pytest.raises(LogError, match=rf"line 2 has 3 cells, the header has {len(head.split(','))};"):
        table(tmp_path, text)


@pytest.mark.parametrize("text", ["", "\n\n", "hello\nworld\n", "t,q\n", "# only a comment\n"])
def test_no_tables(text, tmp_path):
    """What has no numbers is refused in a line."""
    with pytest.raises(LogError, match=r"log\.csv"):
        table(tmp_path, text)


def test_mostly_bad(tmp_path):
    """A file of which more than a tenth is no table of numbers was not understood, and is refused."""
    text = "t,q1\n" + "\n".join(f"{k},{k}" if k % 3 else f"{k},{k},x" for k in range(60))
    with pytest.raises(LogError, match="20 of 60 rows"):
        table(tmp_path, text)
