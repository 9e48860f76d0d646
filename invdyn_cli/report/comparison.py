"""The table of a published experiment, and the paper's statements with our result and a verdict."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

from invdyn_cli.report.tables import significant

Job = tuple[Mapping[str, str], Mapping[str, Any]]

SETS = {"train": "train", "test": "test", "test_clean": "test, clean inputs"}
"""Scored sets that a table by sets shows, and their column heads."""


BELOW = "samples_below "

STAGED = {
    "mean": "mean",
    "line_peak": "peak",
    "peak": "highest of all",
    f"{BELOW}0.1": "samples to 0.1",
    f"{BELOW}0.01": "to 0.01",
}
"""What a table by stages shows, and its column heads: peak is that of the median over repetitions."""


@dataclass(frozen=True)
class Grid:
    """A table: a head for each column, and rows of text."""

    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def by_sets(jobs: Sequence[Job]) -> Grid:
    """A row per job, a column per scored set: mean NMSE over joints, the range over seeds where there are several."""
    labels = _labels(jobs)
    rows = [
        (*_cells(job, labels), *(_band(values_of(metrics, name)) for name in SETS), _seconds(metrics))
        for job, metrics in jobs
    ]
    return Grid((*labels, *(f"NMSE {head}" for head in SETS.values()), "fit s"), tuple(rows))


def by_joints(jobs: Sequence[Job], floors: Mapping[str, Sequence[float]] | None = None) -> Grid:
    """Two rows per job, test NMSE and test RMSE [N m; N], a column per joint and the mean; `floors` (by the jobs'
    names) adds a row with the noise floor after a robot's last job."""
    labels = _labels(jobs)
    most = max(len(metrics["joints"]) for _, metrics in jobs)
    rows: list[tuple[str, ...]] = []
    for i, (job, metrics) in enumerate(jobs):
        for kind in ("nmse", "rmse"):
            found = metrics["test"][kind]
            cells = [significant(found["joint"][joint]) for joint in metrics["joints"]]
            rows.append((*_cells(job, labels), kind.upper(), *_filled(cells, most), significant(found["mean"])))
        floor = (floors or {}).get(job["name"])
        if floor is not None and (i + 1 == len(jobs) or jobs[i + 1][0]["name"] != job["name"]):
            cells = [significant(x) for x in floor]
            mean = significant(sum(floor) / len(floor))
            rows.append((job["name"], *("noise floor",) * (len(labels) - 1), "RMSE", *_filled(cells, most), mean))
    return Grid((*labels, "", *(f"J{j + 1}" for j in range(most)), "mean"), tuple(rows))


def by_stages(jobs: Sequence[Job]) -> Grid:
    """A row per method and stage, as it was learned and adapted: NMSE of blocks of 100 samples, mean over joints;
    samples until it is back below a level (`stages.until_below`); the time of an update. The median of the seeds, and
    their range."""
    rows: list[tuple[str, ...]] = []
    for labels, several in merged(jobs):
        for kind, shown in (("learned", "not adapted"), ("adapted", "adapted")):
            names = list(dict.fromkeys(s for m in several for s in _errors(m, kind).get("stages", {})))
            for where, said in [
                *((f".{name}", name) for name in names),
                *[("", "whole")] * (names not in ([], ["all"])),
            ]:
                numbers = [_middle([x for m in several for x in _picked(m, f"{kind}{where}.{key}")]) for key in STAGED]
                rows.append(
                    (", ".join(labels.values()), shown, said, *numbers, _update(several) if kind == "adapted" else "")
                )
    return Grid(("name", "", "stage", *STAGED.values(), "ms an update"), tuple(rows))


def merged(jobs: Sequence[Job]) -> list[tuple[Mapping[str, str], list[Mapping[str, Any]]]]:
    """Jobs that differ in their `seed` alone, together: the other labels, and the metrics of each seed."""
    found: dict[tuple, tuple[Mapping[str, str], list[Mapping[str, Any]]]] = {}
    for labels, metrics in jobs:
        own = {key: value for key, value in labels.items() if key != "seed"}
        found.setdefault(tuple(own.items()), (own, []))[1].append(metrics)
    return list(found.values())


def judge(statements: Sequence[Mapping[str, Any]], jobs: Sequence[Job]) -> Grid:
    """Each statement of the paper beside what was found: all values of the jobs that it picks, whether they are in its
    band, and if not, by what factor they miss it.

    A statement has `paper` (what it says), `claim` (what is compared), `each` (labels of the jobs it picks), `band`
    (lowest and highest value allowed; 0 and .inf: any), and may have `over` (jobs whose median divides the median of
    the picked ones, one by one; a single one stands against each of the others) and `why` (said where it does not
    hold).

    What is compared is `value` of the picked jobs, and `over_value`, else the same, of the others: the NMSE of a set
    ("test" if unsaid), or a path into errors along a repetition (`stages.scores`): "learned" or "adapted", a stage or
    nothing, "mean", "peak", "line_peak" or "samples_below LEVEL", as in "adapted.grasp.samples_below 0.1" (infinite:
    never), or "load.mass" [kg] or another number of every load that was believed in (`loads.Load`).
    """
    rows, together = [], merged(jobs)
    for statement in statements:
        value = statement.get("value", "test")
        picked = _values(together, statement["each"], value)
        if over := statement.get("over"):
            others = _values(together, over, statement.get("over_value", value))
            if picked and others and 1 in (len(picked), len(others)):
                most = max(len(picked), len(others))
                picked, others = (x * most if len(x) == 1 else x for x in (picked, others))
            picked = [[median(a) / median(b)] for a, b in zip(picked, others, strict=True)]
        values = [x for group in picked for x in group]
        low, high = statement["band"]
        verdict = _verdict(values, low, high)
        if verdict != "holds" and statement.get("why"):
            verdict += f"; {statement['why']}"
        rows.append((statement["paper"], statement["claim"], _allowed(low, high), _band(values), verdict))
    return Grid(("the paper", f"compared here ({_kind(statements)})", "expected", "found", "verdict"), tuple(rows))


def values_of(metrics: Mapping[str, Any], name: str) -> list[float]:
    """Mean NMSE on a set: of every seed where the fit has several, else of the model; none where it was not scored."""
    found = metrics.get("members", {}).get(name) or ([metrics[name]] if name in metrics else [])
    return [math.nan if x["nmse"]["mean"] is None else x["nmse"]["mean"] for x in found]


def band_of(
    statements: Sequence[Mapping[str, Any]], labels: Mapping[str, str], of: str = "test"
) -> tuple[float, float] | None:
    """What all statements on a set that pick this job by itself (not beside another) allow together; None if there is
    none."""
    alone = (x for x in statements if "over" not in x and x.get("value", "test") == of)
    bands = [x["band"] for x in alone if matches(labels, x["each"])]
    return (max(low for low, _ in bands), min(high for _, high in bands)) if bands else None


def matches(labels: Mapping[str, str], wanted: Mapping[str, Any]) -> bool:
    """Whether a job has all wanted labels; each is a value or a list of values."""
    lists = {key: value if isinstance(value, list) else [value] for key, value in wanted.items()}
    return all(labels.get(key) in [str(x) for x in values] for key, values in lists.items())


def markdown(grid: Grid) -> str:
    """The grid as a Markdown table."""
    lines = [grid.heads, ("---",) * len(grid.heads), *grid.rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines) + "\n"


def _values(together: Sequence[tuple], wanted: Mapping[str, Any], value: str) -> list[list[float]]:
    """For every wanted job: the values of all its seeds."""
    found = [[x for m in several for x in _picked(m, value)] for labels, several in together if matches(labels, wanted)]
    return [values for values in found if values]


def _picked(metrics: Mapping[str, Any], value: str) -> list[float]:
    """The `value` of a statement for one job; none if it does not exist."""
    kind, _, path = value.partition(".")
    if kind == "load":
        every = metrics.get("adaptation_scores", {}).get("loads", [])
        return [math.inf if x[path] is None else x[path] for x in every]
    if kind not in ("learned", "adapted"):
        return values_of(metrics, value)
    path, below, level = path.partition(BELOW)
    stage, _, key = path.rpartition(".")
    errors = _errors(metrics, kind)
    found = errors.get("stages", {}).get(stage, {}) if stage else errors.get("nmse", {})
    if below:
        found, key = found.get("samples_below", {}), level
    if key not in found:
        return []
    missing = math.inf if below else math.nan
    return [missing if found[key] is None else found[key]]


def _errors(metrics: Mapping[str, Any], kind: str) -> Mapping[str, Any]:
    """Errors along a repetition as learned, or adapted."""
    found = metrics.get("adaptation_scores", {})
    return found.get("as_learned", {}) if kind == "learned" else found


def _update(several: Sequence[Mapping[str, Any]]) -> str:
    times = [m["adaptation_scores"].get("seconds_per_update", {}).get("p50") for m in several]
    return _middle([1000 * x for x in times if x is not None])


def _middle(values: Sequence[float]) -> str:
    """The median, and in brackets the range, of several."""
    if not values:
        return ""
    middle, band = significant(median(values)), _band(values)
    return (middle if band == middle else f"{middle} ({band})").replace("inf", "never")


def _kind(statements: Sequence[Mapping[str, Any]]) -> str:
    return "NMSE" if any("value" in x for x in statements) else "test NMSE"


def _allowed(low: float, high: float) -> str:
    if not low:
        return f"below {significant(high)}"
    return f"above {significant(low)}" if math.isinf(high) else f"{significant(low)} to {significant(high)}"


def _verdict(values: Sequence[float], low: float, high: float) -> str:
    if not values:
        return "not run"
    if all(low <= x <= high for x in values):
        return "holds"
    inside = sum(low <= x <= high for x in values)
    under = max((low / x for x in values if 0 < x < low), default=1.0)
    over = max((x / high for x in values if x > high), default=1.0)
    if math.isinf(over):
        return f"{'differs' if not inside else f'holds for {inside} of {len(values)}'}: never"
    misses = [f"below by up to {under:.3g} x"] * (under > 1) + [f"above by up to {over:.3g} x"] * (over > 1)
    misses += ["no number"] * any(map(math.isnan, values))
    return f"{'differs' if not inside else f'holds for {inside} of {len(values)}'}: {', '.join(misses)}"


def _labels(jobs: Sequence[Job]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(key for labels, _ in jobs for key in labels))


def _cells(labels: Mapping[str, str], names: Sequence[str]) -> list[str]:
    return [labels.get(name, "") for name in names]


def _filled(cells: Sequence[str], most: int) -> list[str]:
    return [*cells, *[""] * (most - len(cells))]


def _band(values: Sequence[float]) -> str:
    if not values:
        return ""
    low, high = significant(min(values)), significant(max(values))
    return low if low == high else f"{low} to {high}"


def _seconds(metrics: Mapping[str, Any]) -> str:
    return f"{metrics['seconds']['fit']:.1f}"
