"""A check on the terminal: what is not ok and what to do, what can be corrected, and what the log excites."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from rich import box
from rich.console import Console, ConsoleOptions, Group, RenderResult
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from invdyn_cli.diagnosis import doctor
from invdyn_cli.errors import listed
from invdyn_cli.report.check_table import skipped_reasons
from invdyn_cli.report.tables import significant
from invdyn_cli.types import Check, Examination

STYLE = {"fail": "bold red", "warn": "yellow", "note": "cyan", "skipped": "dim", "ok": "green"}
MOST = 3
"""Lines of one check and severity on the screen; the file has them all."""


def shown(examination: Examination) -> Group:
    """What is not ok, what was skipped and why, what can be corrected, what the log excites; folds at any width."""
    parts: list[Any] = []
    seen = [one for one in examination.checks if one.severity not in ("ok", "skipped")]
    for (severity, name), group in groupby(seen, key=lambda one: (one.severity, one.check)):
        lines = list(group)
        parts.append(Text.assemble((severity, STYLE[severity]), f"  {name}"))
        for one in lines[:MOST]:
            what = f"{_where(one)}: {one.seen}" + (f": {one.meaning}" if one.meaning else "")
            parts.append(Padding(Text(what), (0, 0, 0, 2)))
            if one.advice:
                parts.append(Padding(Text(f"-> {one.advice}"), (0, 0, 0, 4)))
        if len(lines) > MOST:
            parts.append(Padding(Text(f"and {len(lines) - MOST} more, see check.json"), (0, 0, 0, 2)))
    reasons: dict[str, list[str]] = {}
    for why, names in skipped_reasons(examination.checks).items():
        reasons.setdefault(", ".join(names), []).append(why)
    for names, own in reasons.items():
        more = [f"and {len(own) - MOST} more, see check.json"] if len(own) > MOST else []
        parts += [Text.assemble(("skipped", STYLE["skipped"]), f"  {names}: {x}") for x in (*own[:MOST], *more)]
    quiet = dict.fromkeys(one.check for one in examination.checks if one.severity == "ok")
    if quiet:
        parts.append(Text(f"ok ({len(quiet)}): {', '.join(quiet)}", STYLE["ok"]))
    notes = doctor.done(examination)
    parts += [Text(f"correctable: {note}") for note in notes[: 3 * MOST]]
    if len(notes) > 3 * MOST:
        parts.append(Text(f"correctable: {len(notes) - 3 * MOST} more"))
    if examination.excitation:
        parts.append(ExcitationTable(examination))
    word = ("usable", STYLE["ok"]) if examination.usable else ("not usable", STYLE["fail"])
    once = " once it is corrected." if notes and examination.usable else "."
    return Group(*parts, Text.assemble("The log is ", word, once))


@dataclass(frozen=True)
class ExcitationTable:
    """One line a joint: how it moves, and the effects that this log cannot show on it. Two tables where one is too
    wide: no number is cut and no column is lost."""

    examination: Examination

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        tables = self._tables([range(8)])
        if tables[0].__rich_measure__(console, options.update(max_width=10_000)).minimum > options.max_width:
            tables = self._tables([range(4), range(4, 8)])
        yield from tables

    def _tables(self, parts: Sequence[Sequence[int]]) -> list[Table]:
        heads = ("q", "max |qd|", "max |qdd|", "tau", "reversals", "rest %", "slow %", "cannot show")
        excitation = self.examination.excitation
        condition = next(iter(excitation.values())).get("condition")
        known = "" if condition is None else f"condition of the regressor {significant(condition)}; "
        tables = []
        for part in parts:
            below = f"{known}q in rad or m, tau in N m or N" if part is parts[-1] else None
            table = Table(box=box.SIMPLE_HEAD, pad_edge=False, caption=below)
            table.add_column("joint", overflow="fold", min_width=10)
            for k in part:
                words = heads[k] == "cannot show"
                cells = [heads[k], *(_row(x)[k] for x in excitation.values())]
                width = 24 if words else max(map(len, cells))
                justify = "left" if words else "right"
                table.add_column(heads[k], justify=justify, overflow="fold", min_width=width, no_wrap=not words)
            for joint, x in excitation.items():
                table.add_row(Text(joint), *(Text(_row(x)[k]) for k in part))
            tables.append(table)
        return tables


def _row(x: Mapping[str, Any]) -> tuple[str, ...]:
    """The cells of a joint."""
    return (
        " … ".join(map(significant, x["q"])),
        significant(max(map(abs, x["qd"]))),
        significant(max(map(abs, x["qdd"]))),
        " … ".join(map(significant, x["torque"])),
        str(x["reversals"]),
        f"{100 * x['rest_share']:.0f}",
        f"{100 * x['slow_share']:.0f}",
        listed(x["cannot_show"], most=2) if x["cannot_show"] else "-",
    )


def _where(one: Check) -> str:
    return " ".join(x for x in (one.trajectory, one.joint) if x) or "whole log"
