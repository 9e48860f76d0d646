"""The common frame of all pages: one HTML file that needs nothing else, for light, dark and print, also without
JavaScript.

Colours are those of Okabe and Ito, by the names that `canvas` has; on a dark ground some are lighter.
"""

import base64
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from invdyn_cli.report.interactive import SCRIPT, STYLES

STYLE = """
:root { color-scheme: light dark; --ink: #1d2329; --soft: #5c6670; --line: #d8dde2; --ground: #fff; --mark: #fff3e0;
  --worst: #b84e00; --grid: #eceff2; --black: #000; --orange: #e69f00; --sky: #56b4e9; --green: #009e73;
  --blue: #0072b2; --vermillion: #d55e00; --purple: #cc79a7; --grey: #8a8f94; }
@media screen and (prefers-color-scheme: dark) {
  :root { --ink: #e4e7ea; --soft: #9aa4ae; --line: #3a424a; --ground: #15191d; --mark: #3d2c12; --worst: #ff9a57;
    --grid: #262c32; --black: #fff; --orange: #f0b440; --sky: #8fd0f5; --green: #35c79a; --blue: #4a9fe0;
    --vermillion: #ff7f32; --purple: #e39cc4; --grey: #8a9199; }
  figure img { filter: invert(.92) hue-rotate(180deg); } }
body { max-width: 68rem; margin: 2rem auto; padding: 0 1.2rem; color: var(--ink); background: var(--ground);
  font: 1rem/1.5 system-ui, sans-serif; }
h1 { font-size: 1.6rem; margin-bottom: 0; } h2 { font-size: 1.15rem; margin: 2.2rem 0 .5rem; }
.sub, figcaption, caption, .note { color: var(--soft); font-size: .9rem; } .sub { margin-top: .2rem; }
.lead { font-size: 1.1rem; max-width: 52rem; } .warning { background: var(--mark); border-left: 4px solid #d55e00;
  padding: .4rem .8rem; margin: .4rem 0; }
.wide { overflow-x: auto; background: linear-gradient(to left, var(--ground) 40%, transparent) right / 3rem 100%
  no-repeat local, linear-gradient(to left, var(--line), transparent) right / 1.2rem 100% no-repeat scroll; }
.wide + .wide { margin-top: 1.2rem; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: .92rem; }
th, td { padding: .2rem .7rem; text-align: right; border-bottom: 1px solid var(--line); white-space: nowrap; }
thead th { white-space: normal; vertical-align: bottom; }
th:first-child, td:first-child { text-align: left; }
.wide td:first-child, .wide tr:first-child th:first-child { position: sticky; left: 0; background: var(--ground); }
table.words td, table.words th { text-align: left; white-space: normal; vertical-align: top; }
table.words td.whole { white-space: nowrap; } thead th { border-bottom: 2px solid var(--soft); }
thead tr:first-child th[colspan] { text-align: center; border-bottom: 0; }
tr.mean td { font-weight: 600; border-top: 2px solid var(--soft); } b.worst { color: var(--worst); }
.scores td:nth-child(even), thead th[colspan], thead tr + tr th:nth-child(odd) { padding-left: 1.8rem; }
thead tr + tr th:first-child { text-align: right; }
table.pairs td { text-align: left; white-space: normal; overflow-wrap: anywhere; vertical-align: top; }
table.pairs td:first-child { color: var(--soft); white-space: nowrap; }
figure { margin: 1.4rem 0; break-inside: avoid; } figure img { width: 100%; box-sizing: border-box; padding: .4rem;
  background: #fff; border-radius: 4px; }
td small { display: block; white-space: normal; max-width: 40rem; color: var(--soft); }
pre { overflow-x: auto; border: 1px solid var(--line); padding: .7rem; font-size: .85rem; } details { margin: .8rem 0; }
summary { cursor: pointer; margin-bottom: .4rem; }
@media (max-width: 46rem) { figure:not(.live) { overflow-x: auto; } figure img { width: 46rem; }
  figcaption { position: sticky; left: 0; }
  th, td { padding: .2rem .45rem; }
  table.words, table.words tbody, table.words tr, table.words td { display: block; }
  table.words thead { display: none; }
  table.words tr { border-bottom: 1px solid var(--line); padding: .5rem 0; } table.words td { border: 0;
    padding: .1rem 0; } table.words td:empty { display: none; }
  table.words td[data-head]::before { content: attr(data-head) ": "; color: var(--soft); } }
@media print { html { font-size: 9pt; } body { max-width: none; margin: 0; padding: 0; }
  .wide { overflow: visible; background: none; }
  th, td { padding: .15rem .5rem; } h2 { break-after: avoid; } pre { white-space: pre-wrap; }
  details::details-content { content-visibility: visible; } }
"""


def document(title: str, body: str, style: str = "") -> str:
    """A page with this title (plain text) and this body (HTML); `style` is added to STYLE."""
    script = ""
    if '<div class="plots"' in body:
        style += STYLES.read_text(encoding="utf-8")
        script = f"<script>{SCRIPT.read_text(encoding='utf-8')}</script>"
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE}{style}</style></head>\n<body>"
        f"<h1>{escape(title)}</h1>{body}{script}</body></html>\n"
    )


def section(title: str, content: str) -> str:
    """A heading (plain text) and what stands below it (HTML); nothing without content."""
    return f"<section><h2>{escape(title)}</h2>{content}</section>\n" if content else ""


def picture(path: Path, caption: str, alt: str = "", live: str = "", *, replaced: bool = False) -> str:
    """A PNG put inside the page, its caption (plain text) below; `alt` is read in its place, else the caption's first
    sentence. For print and readers without a script alone: beside plots (`interactive.plots`) as `live`, or where the
    plots of another picture have `replaced` it."""
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    alt = escape(alt or caption.partition(".")[0], quote=True)
    image = f'<img alt="{alt}" src="data:image/png;base64,{data}">'
    kind = ' class="replaced"' if replaced else ""
    return f"<figure{kind}>{live}{image}<figcaption>{escape(caption)}</figcaption></figure>\n"


def lively(plots: str, caption: str) -> str:
    """Plots (`interactive.plots`) with a caption (plain text), for the screen and with a script alone."""
    return f'<figure class="lively">{plots}<figcaption>{escape(caption)}</figcaption></figure>\n' if plots else ""


def table(heads: Sequence[str], body: str, style: str = "words") -> str:
    """A table that scrolls if it is too wide, its first column in view; one of `words` is a list on a phone. Heads are
    plain text, the body is HTML."""
    head = "".join(f"<th>{escape(x)}</th>" for x in heads)
    if "words" in style.split():
        body = "<tr".join(_named(one, heads) for one in body.split("<tr"))
    return f'<div class="wide"><table class="{style}"><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def row(*cells: str) -> str:
    """A row of a table, its cells HTML."""
    return f"<tr>{''.join(f'<td>{x}</td>' for x in cells)}</tr>"


def _named(one: str, heads: Sequence[str]) -> str:
    """A row of a table (HTML) whose cells but the first know the head of their column."""
    start, *cells = one.split("<td")
    names = ["", *(f' data-head="{escape(x, quote=True)}"' if x else "" for x in heads[1:])]
    return start + "".join(f"<td{name}{cell}" for name, cell in zip(names, cells, strict=False))


def folded(label: str, content: str, *, shown: bool = False) -> str:
    """HTML that opens on a click on a line (plain text)."""
    return f"<details{' open' * shown}><summary>{escape(label)}</summary>{content}</details>"


def pairs(facts: Mapping[str, Any]) -> str:
    """A two-column table; nested values have dotted names, empty ones are left out. A list of mappings is a table of
    its own, folded."""
    tables = {k: v for k, v in facts.items() if isinstance(v, list | tuple) and v and isinstance(v[0], Mapping)}
    plain = {k: v for k, v in facts.items() if k not in tables}
    rows = "".join(row(escape(k), escape(v)) for k, v in _flat(plain) if v)
    shown = f'<table class="pairs"><tbody>{rows}</tbody></table>' if rows else ""
    return shown + "".join(folded(f"{k} ({len(v)})", _records(v)) for k, v in tables.items())


def _records(records: Sequence[Mapping[str, Any]]) -> str:
    """A row for each mapping, a column for each name."""
    names = list(dict.fromkeys(name for one in records for name in one))
    lines = (dict(_flat({name: one.get(name) for name in names})) for one in records)
    body = "".join(row(*(escape(one.get(name, "")) for name in names)) for one in lines)
    return table([name.replace("_", " ") for name in names], body, "")


def _flat(facts: Mapping[str, Any], above: str = "") -> Iterable[tuple[str, str]]:
    for name, value in facts.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{above}{name}.")
        elif isinstance(value, list | tuple):
            yield f"{above}{name}", ", ".join(map(str, value))
        elif isinstance(value, float | np.floating):
            yield f"{above}{name}", f"{value:.6g}"
        else:
            yield f"{above}{name}", "" if value is None else str(value)
