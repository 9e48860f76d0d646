"""Runs beside each other: a page, tables for the terminal, and a figure; of what metrics.json holds, and, for curves
over time, of the runs themselves."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from matplotlib.figure import Figure
from rich import box
from rich.table import Table
from rich.text import Text

from invdyn_cli.files import write_file
from invdyn_cli.report.canvas import COLOURS, add_legend, blank_figure, house_style, name_joints, plain, save
from invdyn_cli.report.html import document, folded, lively, picture, row, section, table
from invdyn_cli.report.interactive import Line, Panel, plots
from invdyn_cli.report.posture import posture
from invdyn_cli.report.run_plots import timeline
from invdyn_cli.report.tables import robot_of, round_by_error, significant, units
from invdyn_cli.types import RunRecord

LOOKS = ("blue", "vermillion", "green", "orange", "purple", "sky", "grey")
"""Colours of the runs, in their order."""

MOST_BARS, MOST_CURVES = len(LOOKS), 6
"""Runs up to which each has a bar for every joint; runs whose curves are drawn over time, the best ones."""

BARS = "compared"
BARS_CAPTION = "RMSE on the test set: of every joint where there are few runs, else the mean over joints of every run."
CURVES_CAPTION = "Measured torque of the test set, what each run predicts of it, and the residuals."


@dataclass(frozen=True)
class Compared:
    """A run among others.

    Attributes:
        name: what it is called there.
        metrics: what its metrics.json holds.
        record: the run itself, None where its curves are not wanted.
        link: of its own page as seen from the comparison's folder, "" without.
    """

    name: str
    metrics: Mapping[str, Any]
    record: RunRecord | None = None
    link: str = ""

    @property
    def judged(self) -> str:
        """The set on which it is scored: during adaptation, if it adapts."""
        return "test_adapted" if "test_adapted" in self.metrics else "test"

    def score(self, kind: str) -> float:
        """Mean "nmse" or "rmse" over joints; NaN where there is none."""
        return _number(self.metrics.get(self.judged, {}).get(kind, {}).get("mean"))

    def joint(self, kind: str, joint: str) -> float:
        """The same of a joint."""
        return _number(self.metrics.get(self.judged, {}).get(kind, {}).get("joint", {}).get(joint))


def write_page(runs: Sequence[Compared], folder: Path, title: str, *, told: str = "") -> Path:
    """Write the page of these runs, and its figure, into `folder`; `told` (HTML) stands below the heading."""
    figures = [folder / "figures" / f"{BARS}.png"] if runs else []
    with house_style():
        for path in figures:
            save(bars(runs), path)
    return write_file(folder / "report.html", page(runs, figures, title, told))


def page(runs: Sequence[Compared], figures: Sequence[Path], title: str, told: str = "") -> str:
    """The page as HTML text."""
    shown = [x for x in _best(runs) if x.record is not None]
    colours = dict(zip((x.name for x in (runs if len(runs) <= MOST_BARS else shown)), LOOKS, strict=False))
    over_time = "".join(lively(curves(same, colours), CURVES_CAPTION) for same in _same_data(shown))
    sections = [
        ("Runs", _overview(runs)),
        ("Errors", "".join(picture(x, BARS_CAPTION) for x in figures) + _joints(runs)),
        ("Over time", over_time),
        ("What differs in the configs", _configs(runs)),
        ("Base parameters", _base_parameters(runs)),
    ]
    lead = f'<p class="lead">{escape(summary(runs))}</p>\n'
    return document(title, lead + told + "".join(section(*x) for x in sections))


def summary(runs: Sequence[Compared]) -> str:
    """Which run has the lowest error, and what to know before trusting it."""
    ranked = sorted((x for x in runs if np.isfinite(x.score("rmse"))), key=lambda x: x.score("rmse"))
    if not ranked:
        return "No run has an error on a test set."
    first, *others = ranked
    if others and significant(first.score("rmse")) == significant(others[-1].score("rmse")):
        return f"All runs have the same mean RMSE on the test set: {significant(first.score('rmse'))} {_unit(runs)}."
    said = f"{first.name} has the lowest mean RMSE on the test set: {significant(first.score('rmse'))} {_unit(runs)}"
    said += f" (NMSE {significant(first.score('nmse'))})"
    if others:
        said += f"; the largest is {significant(others[-1].score('rmse'))} {_unit(runs)}, of {others[-1].name}"
    known = [x for x in runs if x.record is not None]
    groups = len(_same_data(known))
    return f"{said}." + (f" The test data are not the same: {groups} different sets." if groups > 1 else "")


def run_table(runs: Sequence[Compared]) -> Table:
    """A line for each run: scores, time of learning, parameters; the lowest error is bold."""
    shown = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    shown.add_column("", justify="right", no_wrap=True)
    shown.add_column("run", overflow="fold")
    for head in ("NMSE", f"RMSE\n[{_unit(runs)}]", "fit\n[s]", "para-\nmeters"):
        shown.add_column(Text(head), justify="right", no_wrap=True, vertical="bottom")
    best = _lowest([x.score("nmse") for x in runs])
    for i, x in enumerate(runs):
        cells = (significant(x.score("nmse")), significant(x.score("rmse")), *_cost(x))
        shown.add_row(str(i + 1), Text(x.name), *cells, style="bold" if i in best else "")
    return shown


def joint_table(runs: Sequence[Compared]) -> Table | None:
    """RMSE of every joint, a column for each run by its number in `run_table`; None for more than MOST_BARS."""
    if len(runs) > MOST_BARS:
        return None
    shown = Table(box=box.SIMPLE_HEAD, pad_edge=False, caption=f"test RMSE [{_unit(runs)}], runs by number")
    shown.add_column("joint", overflow="fold")
    for i in range(len(runs)):
        shown.add_column(str(i + 1), justify="right", no_wrap=True)
    for joint in _joints_of(runs):
        values = [x.joint("rmse", joint) for x in runs]
        best = _lowest(values)
        cells = (Text(significant(v), "bold" if i in best else "") for i, v in enumerate(values))
        shown.add_row(Text(joint), *cells)
    return shown


def bars(runs: Sequence[Compared]) -> Figure:
    """Test RMSE from zero: of every joint, a colour for each run, or of many runs the mean, a bar for each."""
    few, unit, joints = len(runs) <= MOST_BARS, _unit(runs), _joints_of(runs)
    figure = blank_figure(3.6 if few else 0.8 + 0.22 * len(runs))
    axes = figure.subplots()
    if few:
        width = 0.8 / len(runs)
        for k, (x, colour) in enumerate(zip(runs, LOOKS, strict=False)):
            where = np.arange(len(joints)) + (k - (len(runs) - 1) / 2) * width
            axes.bar(where, np.nan_to_num([x.joint("rmse", j) for j in joints]), 0.92 * width, color=COLOURS[colour],
                     label=plain(x.name))  # fmt: skip
        name_joints(axes, joints, 110)
        axes.set_ylabel(f"test RMSE [{unit}]")
        axes.grid(False, axis="x")
        add_legend(figure, axes)
    else:
        axes.barh(range(len(runs)), np.nan_to_num([x.score("rmse") for x in runs]), 0.7, color=COLOURS[LOOKS[0]])
        axes.set_yticks(range(len(runs)), [plain(x.name) for x in runs])
        axes.invert_yaxis()
        axes.set_xlabel(f"test RMSE, mean over joints [{unit}]")
        axes.grid(False, axis="y")
    return figure


def curves(runs: Sequence[Compared], colours: Mapping[str, str]) -> str:
    """Plots over time of runs with the same test data: torque and residual of every joint."""
    records = [x.record for x in runs if x.record is not None]
    data = records[0].predictions["test"].data
    robot = next((r for r in map(robot_of, records) if r is not None), None)
    looks = [(x.name, x.record.predictions[x.judged].tau, colours[x.name]) for x in runs if x.record is not None]
    panels = []
    for j, (joint, unit) in enumerate(zip(records[0].fit.joints, units(records[0]), strict=True)):
        measured = data.tau[:, j]
        lines = [Line(name, tau[:, j], colour, 1.1, frames=False) for name, tau, colour in looks]
        panels.append(Panel(joint, f"torque [{unit}]", [Line("measured", measured, "ink", 3.0), *lines], joint=j))
        left = [Line(name, measured - tau[:, j], colour, 1.1) for name, tau, colour in looks]
        panels.append(Panel(f"{joint}: residual", f"residual [{unit}]", left, joint=j, height=110, zero=True))
    time = timeline(data)
    return plots(time, panels, arm=posture(robot, time, np.asarray(data.motion.q)), label="runs over time")


def _overview(runs: Sequence[Compared]) -> str:
    best, body = _lowest([x.score("nmse") for x in runs]), ""
    for i, x in enumerate(runs):
        name = f'<a href="{escape(x.link, quote=True)}">{escape(x.name)}</a>' if x.link else escape(x.name)
        words = (escape(str(x.metrics.get(k))) for k in ("model", "data", "adaptation", "seed"))
        nmse = significant(x.score("nmse"))
        nmse = f"<b>{nmse}</b>" if i in best else nmse
        body += row(name, *words, nmse, significant(x.score("rmse")), *_cost(x))
    heads = ("run", "model", "data", "adaptation", "seed", "test NMSE", f"test RMSE [{_unit(runs)}]", "fit [s]",
             "parameters")  # fmt: skip
    note = "Mean over joints; of a run that adapts, during adaptation. The lowest NMSE is bold."
    return table(heads, body, "scores") + f'<p class="note">{note}</p>'


def _joints(runs: Sequence[Compared]) -> str:
    """NMSE and RMSE of every joint, a row for each run."""
    joints, out = _joints_of(runs), ""
    for kind, head in (("rmse", f"test RMSE [{_unit(runs)}]"), ("nmse", "test NMSE")):
        columns = [[x.joint(kind, j) for x in runs] for j in joints]
        best = [_lowest(column) for column in columns]
        body = ""
        for i, x in enumerate(runs):
            cells = (f"<b>{significant(c[i])}</b>" if i in b else significant(c[i])
                     for c, b in zip(columns, best, strict=True))  # fmt: skip
            body += row(escape(x.name), *cells)
        out += table((head, *joints), body, "joints")
    return out + '<p class="note">The lowest error of every joint is bold.</p>'


def _configs(runs: Sequence[Compared]) -> str:
    """A row for every option in which the runs differ."""
    found = [_flat(_read(x.record.config if x.record is not None else "")) for x in runs]
    names = list(dict.fromkeys(name for one in found for name in one))
    rows = [(name, [one.get(name, "-") for one in found]) for name in names]
    body = "".join(row(*map(escape, (name, *values))) for name, values in rows if len(set(values)) > 1 and all(found))
    return table(("option", *(x.name for x in runs)), body) if body and len(runs) <= MOST_BARS else ""


def _base_parameters(runs: Sequence[Compared]) -> str:
    """Values of base parameters with the same names, a column for each run that has them."""
    found = {x.name: dict(x.record.fit.details["base_parameters"]) for x in runs
             if x.record is not None and "base_parameters" in x.record.fit.details}  # fmt: skip
    names = [str(x) for x in next(iter(found.values()), {}).get("names", ())]
    same = {run: one for run, one in found.items() if [str(x) for x in one["names"]] == names}
    if len(same) < 2 or len(same) > MOST_BARS:
        return ""
    body = ""
    for i, name in enumerate(names):
        cells = (round_by_error(float(x["values"][i]), float(x["std"][i]) if "std" in x else np.nan)
                 for x in same.values())  # fmt: skip
        body += row(escape(name), *cells)
    return folded("values ± standard error", table(("base parameter", *same), body, ""))


def _best(runs: Sequence[Compared]) -> list[Compared]:
    """The MOST_CURVES runs with the lowest errors, in the order of all."""
    ranked = sorted(runs, key=lambda x: np.nan_to_num(x.score("rmse"), nan=np.inf))[:MOST_CURVES]
    return [x for x in runs if x in ranked]


def _same_data(runs: Sequence[Compared]) -> list[list[Compared]]:
    """Groups of runs whose test sets are the same, sample for sample."""
    groups: list[tuple[np.ndarray, list[Compared]]] = []
    for x in runs:
        if x.record is None or x.judged not in x.record.predictions:
            continue
        tau = x.record.predictions[x.judged].data.tau
        same = next((group for known, group in groups if np.array_equal(known, tau, equal_nan=True)), None)
        same.append(x) if same is not None else groups.append((tau, [x]))
    return [group for _, group in groups]


def _joints_of(runs: Sequence[Compared]) -> list[str]:
    return list(dict.fromkeys(joint for x in runs for joint in x.metrics["joints"]))


def _unit(runs: Sequence[Compared]) -> str:
    every = [unit for x in runs if x.record is not None for unit in units(x.record)]
    return "; ".join(dict.fromkeys(every)) or "N m"


def _cost(x: Compared) -> tuple[str, str]:
    return significant(_number(x.metrics.get("seconds", {}).get("fit"))), str(x.metrics.get("parameters", "-"))


def _lowest(values: Sequence[float]) -> set[int]:
    """Where the lowest finite value stands; nowhere, if all are the same."""
    finite = [v for v in values if np.isfinite(v)]
    return {i for i, v in enumerate(values) if v == min(finite)} if finite and min(finite) < max(finite) else set()


def _number(value: Any) -> float:
    return float(value) if isinstance(value, int | float) else float("nan")


def _read(config: str) -> Any:
    try:
        return yaml.safe_load(config)
    except yaml.YAMLError:
        return None


def _flat(node: Any, above: str = "") -> dict[str, str]:
    """Options by their dotted names; a class by its own name, without the module."""
    if not isinstance(node, dict):
        return {above: str(node)} if above else {}
    found = {above: str(node["_target_"]).rpartition(".")[2]} if above and "_target_" in node else {}
    inner = ((f"{above}.{name}" if above else str(name), x) for name, x in node.items() if name != "_target_")
    return found | {k: v for name, x in inner for k, v in _flat(x, name).items()}
