"""invdyn tables: runs what experiments/NAME.yaml asks for, and writes its table beside the paper's statements."""

import csv
import io
import itertools
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import hydra
from omegaconf import DictConfig, OmegaConf, open_dict
from rich.console import Console
from rich.table import Table
from rich.text import Text

from invdyn_cli import store
from invdyn_cli.data.recorded import RealLog
from invdyn_cli.errors import LogError, UsageError, closest, listed
from invdyn_cli.maths import metrics
from invdyn_cli.report import comparison
from invdyn_cli.report.comparison import Grid, Job
from invdyn_cli.verbs import run, screen, sweep
from invdyn_cli.verbs.launch import config_folder, launch

WIDTH = 150
"""Columns of a table that goes into a file or a pipe."""


def main(argv: Sequence[str]) -> int:
    """Run with the overrides in argv; the exit code."""
    return launch("tables", argv, task)


def task(config: DictConfig) -> None:
    """Run what is not complete, then tell and write the table."""
    spec = read(str(config.experiment))
    real_data = Path(config.real_data).resolve()
    folder = Path(config.folder) / str(config.experiment)
    jobs = [(labels, _substituted(overrides, real_data)) for labels, overrides in expand(spec)]
    missing = sorted({path for _, overrides in jobs for path in _logs(overrides) if not path.is_file()})
    if missing:
        raise LogError(
            f"experiment {config.experiment} needs {listed(map(str, missing))}",
            advice="INVDYN_REAL_DATA=FOLDER of those",
        )
    done: list[Job] = []
    with screen.stages() as stage:
        report = stage("runs")
        for i, (labels, overrides) in enumerate(jobs):
            report(i / len(jobs), " ".join(labels.values()))
            done.append((labels, _metrics_of(overrides, folder / _slug(labels), fresh=config.fresh)))
    grid = _grid(spec, done, real_data)
    statements = comparison.judge(spec["statements"], done) if spec.get("statements") else None
    _write(spec, grid, statements, folder)
    console = Console(width=None if sys.stdout.isatty() else WIDTH)
    for title, found in ((spec["title"], grid), ("Beside the paper's statements", statements)):
        if found:
            console.print(_table(title, found))
    console.print(str(folder.with_suffix(".md")), highlight=False, soft_wrap=True)


def read(name: str) -> dict[str, Any]:
    """The experiment of that name: experiments/NAME.yaml beside the user, in the package, or in the checkout.

    Raises:
        UsageError: if there is none, naming those that there are.
    """
    places = [Path.cwd() / "experiments", config_folder().with_name("experiments")]
    for place in places:
        if (place / f"{name}.yaml").is_file():
            return OmegaConf.to_container(OmegaConf.load(place / f"{name}.yaml"), resolve=False)  # type: ignore[return-value]
    names = sorted({path.stem for place in places for path in place.glob("*.yaml")})
    raise UsageError(f"experiment={name}; allowed: {listed(names)}{closest(name, names)}")


def expand(spec: Mapping[str, Any]) -> Iterator[tuple[dict[str, str], list[str]]]:
    """(labels, overrides) of every job: the product of each job's sweep, values that `choices` knows spelled out."""
    choices = spec.get("choices", {})
    for job in spec["jobs"]:
        keys, values = list(job.get("sweep", {})), list(job.get("sweep", {}).values())
        for combination in itertools.product(*values):
            chosen = dict(zip(keys, map(str, combination), strict=True))
            spelled = [choices.get(key, {}).get(value, [f"{key}={value}"]) for key, value in chosen.items()]
            yield (
                {"name": job["name"], **chosen},
                [*spec.get("common", ()), *job["overrides"], *itertools.chain(*spelled)],
            )


def _metrics_of(overrides: Sequence[str], folder: Path, *, fresh: bool) -> dict[str, Any]:
    """metrics.json of the job, run now unless its folder holds it complete."""
    composed = hydra.compose("run", list(overrides), return_hydra_config=True)
    view = composed.hydra
    with open_dict(composed):
        del composed["hydra"]
    if fresh or not sweep.is_complete(composed, folder):
        run.execute(composed, folder, view=view)
    return json.loads((folder / store.METRICS).read_text())


def _grid(spec: Mapping[str, Any], done: Sequence[Job], real_data: Path) -> Grid:
    if spec["columns"] == "sets":
        return comparison.by_sets(done)
    floors = {
        name: _noise_floor(real_data / path, *repeated) for name, (path, *repeated) in spec.get("floors", {}).items()
    }
    return comparison.by_joints(done, floors)


def _noise_floor(path: Path, first: str, again: str) -> list[float]:
    """RMS of half the difference [N m] of a trajectory and its repetition, read as everything else is."""
    splits = RealLog(str(path), train=(first,), test=(again,), validation_share=0).load(None)
    one, other = splits.train, splits.tests["test"]
    return metrics.noise_floor(one.motion.q, one.tau, other.motion.q, other.tau).tolist()


def _substituted(overrides: Sequence[str], real_data: Path) -> list[str]:
    return [override.replace("${real_data}", str(real_data)) for override in overrides]


def _logs(overrides: Sequence[str]) -> Iterator[Path]:
    return (Path(x.removeprefix("data.path=")) for x in overrides if x.startswith("data.path="))


def _slug(labels: Mapping[str, str]) -> str:
    return "-".join("".join(c if c.isalnum() else "_" for c in value) for value in labels.values()).lower()


def _write(spec: Mapping[str, Any], grid: Grid, statements: Grid | None, folder: Path) -> None:
    """NAME.md and NAME.csv."""
    text = f"# {spec['title']}\n\n{spec['source']}\n\n{comparison.markdown(grid)}"
    if statements:
        text += f"\n## Beside the paper's statements\n\n{comparison.markdown(statements)}"
    rows = io.StringIO()
    csv.writer(rows, lineterminator="\n").writerows([grid.heads, *grid.rows])
    store.write_aside(folder.with_suffix(".md"), lambda part: part.write_text(text))
    store.write_aside(folder.with_suffix(".csv"), lambda part: part.write_text(rows.getvalue()))


def _table(title: str, grid: Grid) -> Table:
    table = Table(
        title=title, title_justify="left", show_lines=any(len(cell) > 60 for row in grid.rows for cell in row)
    )
    for head in grid.heads:
        table.add_column(head, overflow="fold")
    for row in grid.rows:
        table.add_row(*map(Text, row))
    return table
