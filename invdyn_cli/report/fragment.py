"""A result that displays itself: as text like the command line, and as a piece of HTML for a notebook.

Both are made of the same rich objects. The HTML needs nothing else and leaves the rest of the page as it is.
"""

import abc
import io
from collections.abc import Iterable
from html import escape
from typing import Any

from rich.console import Console, Group
from rich.padding import Padding
from rich.style import Style
from rich.table import Table
from rich.text import Text

WIDTH = 100
"""Characters of a line of text."""

COLOURS = {"red": "#d9480f", "yellow": "#b7791f", "cyan": "#2b7fb8", "green": "#2f8f5b"}
"""Legible on light and on dark ground."""

STYLE = """.invdyn table { border-collapse: collapse; font-variant-numeric: tabular-nums; margin: .6em 0; }
.invdyn th, .invdyn td { padding: .2em .7em; border-bottom: 1px solid #8886; vertical-align: top; }
.invdyn thead th { border-bottom: 2px solid #888; vertical-align: bottom; }
.invdyn caption { caption-side: bottom; text-align: left; opacity: .75; } .invdyn p { margin: .2em 0; }
.invdyn .wide { overflow-x: auto; } .invdyn .soft { opacity: .7; }"""


class Shown(abc.ABC):
    """An object with parts for the terminal gets text and HTML from them."""

    @abc.abstractmethod
    def __rich__(self) -> Group:
        """The parts that the command line prints."""

    def __str__(self) -> str:
        return as_text(self.__rich__())

    __repr__ = __str__

    def _repr_html_(self) -> str:
        return as_html(self.__rich__())


def as_text(part: Any) -> str:
    """Rich objects as lines of plain text."""
    console = _console(WIDTH)
    console.print(part)
    text = console.file.getvalue()  # pyright: ignore[reportAttributeAccessIssue]: a StringIO
    return "\n".join(line.rstrip() for line in text.splitlines())


def as_html(part: Any) -> str:
    """Rich objects (texts, tables, groups and what yields them) as HTML in one element."""
    return f'<div class="invdyn"><style>{STYLE}</style>{"".join(_pieces(part))}</div>'


def _console(width: int) -> Console:
    """A console that keeps what it is given, in a notebook too, where rich would display it."""
    plain = {"markup": False, "emoji": False, "highlight": False, "color_system": None, "force_jupyter": False}
    return Console(file=io.StringIO(), width=width, **plain)


def _pieces(part: Any) -> Iterable[str]:
    if isinstance(part, str | Text):
        yield f"<p>{_inline(part)}</p>"
    elif isinstance(part, Padding):
        yield f'<div style="margin-left: {0.6 * part.left:g}em">{"".join(_pieces(part.renderable))}</div>'
    elif isinstance(part, Table):
        yield _table(part)
    elif isinstance(part, Group):
        for one in part.renderables:
            yield from _pieces(one)
    else:  # an object that makes tables for the width it is given
        console = _console(10_000)
        for one in part.__rich_console__(console, console.options):
            yield from _pieces(one)


def _table(table: Table) -> str:
    aligned = [f' style="text-align: {column.justify}"' for column in table.columns]
    head = "".join(f"<th{a}>{_inline(c.header)}</th>" for a, c in zip(aligned, table.columns, strict=True))
    body = ""
    for row, cells in zip(table.rows, zip(*(c.cells for c in table.columns), strict=True), strict=True):
        bold = isinstance(row.style, str) and "bold" in row.style
        texts = (f"<b>{_inline(x)}</b>" if bold else _inline(x) for x in cells)
        body += f"<tr>{''.join(f'<td{a}>{x}</td>' for a, x in zip(aligned, texts, strict=True))}</tr>"
    below = [_inline(x) for x in (table.title, table.caption) if x]
    caption = f"<caption>{'<br>'.join(below)}</caption>" if below else ""
    return f'<div class="wide"><table>{caption}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def _inline(text: Any) -> str:
    """A text with its bold, dim and coloured parts."""
    text = text.copy() if isinstance(text, Text) else Text(str(text))
    text.stylize(text.style or "")  # rich renders the style of a whole text only where a part has one too
    parts = text.render(_console(WIDTH), end="")
    return "".join(_styled(segment.text, segment.style) for segment in parts).replace("\n", "<br>")


def _styled(text: str, style: Style | None) -> str:
    said = escape(text)
    if style is None or not text:
        return said
    if style.color is not None and style.color.name in COLOURS:
        said = f'<span style="color: {COLOURS[style.color.name]}">{said}</span>'
    said = f'<span class="soft">{said}</span>' if style.dim else said
    return f"<b>{said}</b>" if style.bold else said
