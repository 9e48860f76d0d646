"""Rich objects as text and as HTML: the same words, what is written is escaped, nothing else on a page is touched."""

import re
from html import unescape

from rich import box
from rich.console import Group
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from invdyn_cli.report.fragment import Shown, as_html, as_text


def parts() -> Group:
    """A line, an indented one, and a table with units, numbers and a bold row."""
    table = Table(box=box.SIMPLE_HEAD, caption="RMSE in [N m]")
    table.add_column("joint")
    table.add_column("RMSE [N m]", justify="right")
    table.add_row(Text("<elbow>"), "0.25\n[0.1, 0.4]")
    table.add_row("mean", "0.5", style="bold")
    note = Text("a note", "dim")
    return Group(note, Text.assemble(("fail", "bold red"), "  <script>"), Padding(Text("a & b"), (0, 0, 0, 4)), table)


class Result(Shown):
    """What shows these parts."""

    def __rich__(self) -> Group:
        return parts()


def test_text_and_html_say_the_same():
    """Every word of the text stands in the HTML, brackets of units too."""
    html = as_html(parts())
    said = unescape(re.sub(r"<style>.*?</style>|<[^>]+>", " ", html, flags=re.DOTALL))
    words = set(as_text(parts()).replace("─", " ").split())
    assert words == set(said.split()) and {"[N", "m]", "<elbow>", "<script>", "fail"} <= words


def test_html_is_escaped_and_keeps_emphasis():
    """Names from a file are no tags; bold, colour, alignment and lines within a cell come through."""
    html = as_html(parts())
    assert "<script" not in html and "<elbow" not in html and "&lt;elbow&gt;" in html
    assert re.search(r'<b><span style="color: #\w+">fail</span></b>', html)
    assert (
        '<span class="soft">a note</span>' in html
        and "<b>mean</b>" in html
        and "0.25<br>[0.1, 0.4]" in html
        and "text-align: right" in html
    )


def test_a_result_shows_itself():
    """str, repr and HTML come from the same parts."""
    result = Result()
    assert str(result) == repr(result) == as_text(parts()) and result._repr_html_() == as_html(parts())
    assert max(map(len, str(result).splitlines())) <= 100 and "\x1b" not in str(result)
