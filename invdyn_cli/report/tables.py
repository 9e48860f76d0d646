"""Numbers for readers: the score table of a run, the table and the CSV of a sweep, a value rounded by its error.

Everything here is a pure function of its arguments; the tables are rich objects, which the caller prints.
"""

import csv
import io
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from rich import box
from rich.table import Table
from rich.text import Text

from invdyn_cli import joints
from invdyn_cli.maths import loads
from invdyn_cli.types import Robot, RunRecord

ORDER = ("train", "validation", "test")
"""The sets that come first, in this order; others follow as the record has them."""

SWEEP_FIELDS = ("job", "overrides", "status", "test_nmse", "test_rmse", "seconds", "folder", "message")
STATUS_STYLE = {"ran": "green", "kept": "cyan", "failed": "bold red"}


def choice(record: RunRecord, role: str) -> str:
    """The name under which the command line knows the model, data or adaptation of this run, else its class."""
    return str(record.choices.get(role) or type(getattr(record, role, None)).__name__)


def scored_sets(record: RunRecord) -> tuple[str, ...]:
    """Names of the scored sets in the order in which they are shown."""
    return tuple(x for x in ORDER if x in record.scores) + tuple(x for x in record.scores if x not in ORDER)


def robot_of(record: RunRecord) -> Robot | None:
    """The robot that the model or the data of this run know, None where neither does."""
    judged = (x.data.robot for x in record.predictions.values())
    return next((x for x in (record.fit.robot, *judged) if x is not None), None)


def units(record: RunRecord) -> tuple[str, ...]:
    """Unit of every joint's torque: N for a joint known to slide, else N m."""
    robot = robot_of(record)
    slides = dict(zip(robot.joints, robot.prismatic, strict=True)) if robot else {}
    return tuple(joints.units(slides.get(joint, False)).torque for joint in record.fit.joints)


def units_said(record: RunRecord) -> str:
    """'N m', 'N', or 'N m (N for lift)' where some joints slide and others turn."""
    every = units(record)
    sliding = [joint for joint, unit in zip(record.fit.joints, every, strict=True) if unit == "N"]
    return f"N m (N for {', '.join(sliding)})" if 0 < len(sliding) < len(every) else every[0]


def position_unit(torque: str) -> str:
    """rad, or m of a joint whose torque is in N."""
    return "m" if torque == "N" else "rad"


def shortened(text: str) -> str:
    """Numbers of more than six decimals in a text with four significant digits, as a search draws them."""
    return re.sub(r"\d+\.\d{7,}(e[+-]?\d+)?", lambda found: f"{float(found[0]):.4g}", text)


def significant(value: float | None) -> str:
    """Three significant digits, in scientific notation below 1e-3 and from 1e6; a dash for None and NaN."""
    if value is None or math.isnan(value):
        return "-"
    if value == 0 or math.isinf(value):
        return f"{value:g}"
    value = float(f"{value:.2e}")
    if not 1e-3 <= abs(value) < 1e6:
        return f"{value:.2e}"
    return f"{value:.{max(0, 2 - math.floor(math.log10(abs(value))))}f}"


def round_by_error(value: float, std: float) -> str:
    """'value ± std', both cut where the second significant digit of the standard error is.

    A standard error that is zero or not finite says nothing about digits: the value then stands alone with six of them.
    """
    if not math.isfinite(value) or not math.isfinite(std) or std <= 0:
        return f"{value:.6g}"
    std = float(f"{std:.1e}")
    top = math.floor(math.log10(max(abs(value), std)))
    last = math.floor(math.log10(std)) - 1
    if -4 <= top < 6:
        decimals = max(0, -last)
        return f"{round(value, -last) + 0.0:.{decimals}f} ± {std:.{decimals}f}"
    decimals, scale = max(0, top - last), 10.0**-top
    return f"({value * scale:.{decimals}f} ± {std * scale:.{decimals}f})e{top:+03d}"


def score_rows(record: RunRecord, sets: Sequence[str] = ()) -> list[tuple[str, list[float]]]:
    """(joint, [NMSE, RMSE of the first set, NMSE, RMSE of the next, …]) per joint, and the mean over joints last; all
    sets unless some are named."""
    scores = [record.scores[name] for name in sets or scored_sets(record)]
    columns = [np.asarray(x, float) for score in scores for x in (score.nmse, score.rmse)]
    rows = [(joint, [float(x[i]) for x in columns]) for i, joint in enumerate(record.fit.joints)]
    return [*rows, ("mean", [score.mean(kind) for score in scores for kind in ("nmse", "rmse")])]


def member_spread(record: RunRecord) -> str:
    """A sentence on the scatter between the seeds of one fit; empty for a fit of one."""
    name = next((x for x in ("test", *scored_sets(record)) if len(record.member_scores.get(x, ())) > 1), None)
    if name is None:
        return ""
    means = [score.mean("nmse") for score in record.member_scores[name]]
    ends = " to ".join(significant(x) for x in (np.min(means), np.max(means)))
    return f"{len(means)} members: mean {name} NMSE {ends}."


def score_table(record: RunRecord, *, most: int = 3) -> Table:
    """NMSE and RMSE [N m; N] per joint and their mean, two columns for every scored set; the validation set gives way
    where there are more than `most`, so that the table fits into 80 columns."""
    sets = scored_sets(record)
    sets = tuple(x for x in sets if x != "validation" or len(sets) <= most)
    caption = Text(f"RMSE in {units_said(record)}. {member_spread(record)}".rstrip())
    table = Table(box=box.SIMPLE_HEAD, collapse_padding=True, pad_edge=False, caption=caption)
    table.add_column("joint", overflow="fold", vertical="bottom", min_width=8)
    for name in sets:
        head = Text(name.replace("_", "\n") + "\nNMSE")
        table.add_column(head, justify="right", no_wrap=True, vertical="bottom")
        table.add_column("RMSE", justify="right", no_wrap=True, vertical="bottom")
    *joints, mean = score_rows(record, sets)
    for label, values in joints:
        table.add_row(Text(label), *map(significant, values))
    table.add_section()
    table.add_row(mean[0], *map(significant, mean[1]), style="bold")
    return table


LOAD_HEADS = ("recording", "picked up [s]", "released [s]", "mass [kg]", "centre of mass [m], last joint's frame")


def load_rows(record: RunRecord) -> list[tuple[str, ...]]:
    """A row under `LOAD_HEADS` for every load that was reported along the test set."""
    if "test_adapted" not in record.predictions:
        return []
    return [
        (
            x.trajectory,
            f"{x.came:.2f}",
            "-" if x.went is None else f"{x.went:.2f}",
            round_by_error(x.mass, x.mass_std),
            ", ".join(round_by_error(*each) for each in zip(x.com, x.com_std, strict=True)),
        )
        for x in loads.believed(record.predictions["test_adapted"].data, record.trace)
    ]


def load_table(record: RunRecord) -> Table | None:
    """The loads that were reported; None if there are none."""
    rows = load_rows(record)
    return text_table(LOAD_HEADS, rows, title="Loads", title_justify="left") if rows else None


def text_table(heads: Iterable[str], rows: Iterable[Iterable[str]], **options: Any) -> Table:
    """Texts that fold under their heads; `options` as rich's Table has them."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, **options)
    for head in heads:
        table.add_column(Text(head), overflow="fold")
    for row in rows:
        table.add_row(*map(Text, row))
    return table


def sweep_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """One line per job of a sweep; the lowest test NMSE is marked, a failed job says why."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("job", justify="right", no_wrap=True)
    table.add_column("overrides", overflow="fold", ratio=2)
    table.add_column("status", no_wrap=True)
    for title in ("test NMSE", "test RMSE", "seconds"):
        table.add_column(title, justify="right", no_wrap=True)
    told = any(row.get("message") for row in rows)
    if told:
        table.add_column("message", overflow="fold", ratio=3)
    best = min((x for x in (row.get("test_nmse") for row in rows) if x is not None and math.isfinite(x)), default=None)
    for row in rows:
        wins = best is not None and row.get("test_nmse") == best
        numbers = (significant(row.get(key)) for key in ("test_nmse", "test_rmse", "seconds"))
        status = Text(str(row["status"]), style=STATUS_STYLE.get(row["status"], ""))
        message = (Text(str(row.get("message") or "")),) if told else ()
        line = (str(row["job"]), Text(shortened(str(row["overrides"]))), status, *numbers, *message)
        table.add_row(*line, style="bold" if wins else "")
    return table


def sweep_csv(rows: Sequence[Mapping[str, Any]]) -> str:
    """The same rows as CSV with a header line, numbers unrounded, an empty field for None."""
    return csv_text([SWEEP_FIELDS, *([row.get(name) for name in SWEEP_FIELDS] for row in rows)])


def csv_text(rows: Iterable[Iterable[Any]]) -> str:
    """Rows, the first of them the heads, as CSV."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()
