"""invdyn figures: the figures of experiments/*.yaml, and the page that compares all of them with the paper."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from omegaconf import DictConfig, ListConfig

from invdyn_cli.errors import LogError, UsageError
from invdyn_cli.files import write_file
from invdyn_cli.report import bars, comparison, curves, paper, repetitions
from invdyn_cli.report.canvas import save_all
from invdyn_cli.report.comparison import Grid
from invdyn_cli.report.paper import Exhibit
from invdyn_cli.verbs import published, screen, tables
from invdyn_cli.verbs.launch import launch
from invdyn_cli.verbs.listing import read
from invdyn_cli.verbs.objects import trusted
from invdyn_cli.verbs.published import Published
from invdyn_cli.verbs.run import refuse_formats
from invdyn_cli.verbs.screen import Screen


def main(argv: Sequence[str]) -> int:
    """Run with the overrides in argv; the exit code."""
    return launch("figures", argv, task)


def task(config: DictConfig) -> None:
    """Run what is not complete, draw, and write the page."""
    refuse_formats("formats", config.formats)
    console, real_data, own = Screen(), Path(config.real_data).resolve(), Path(config.tables)
    if not isinstance(config.shown, ListConfig) or not all(isinstance(name, str) for name in config.shown):
        raise UsageError(f"shown={config.shown}; allowed: a list of experiments", advice="shown=[batch_simulated]")
    exhibits: list[Exhibit] = []
    trust = trusted(config)
    nets: Grid | None = None
    sets: Grid | None = None
    for name in config.shown:
        try:
            done = published.run_all(name, own, real_data, fresh=config.fresh, trust=trust, workers=config.workers)
        except LogError as error:
            spec = read(name)
            console.warn(f"{name} is left out: {error}")
            exhibits.append(Exhibit(spec["title"], spec["source"], _command(name), absent=str(error)))
            continue
        tables.write(done, own)
        with screen.stages() as stage:
            stage(f"draw {name}")
            drawn = _draw(done, Path(config.folder), sorted({"png", *config.formats}))
        for path, _ in drawn:
            console.whole(path)
        exhibits.append(_exhibit(done, drawn))
        if picked := done.spec.get("paper_tables"):
            nets, sets = _paper_tables(done, picked)
    written = write_file(Path(config.page), paper.page(exhibits, nets, sets))
    console.whole(written)


def _draw(done: Published, folder: Path, formats: Sequence[str]) -> list[tuple[Path, str]]:
    """Files and captions of the experiment's `figure` as NAME, its `figures` as NAME_FILE, once per format; none where
    it has none."""
    specs = [(done.name, done.spec["figure"])] if "figure" in done.spec else []
    specs += [(f"{done.name}_{spec['file']}", spec) for spec in done.spec.get("figures", ())]
    courses: list[curves.Run] = []
    if any(spec.get("kind") == "curves" for _, spec in specs):
        courses = [(labels, curves.course(record)) for labels, record in done.records()]
    drawn: list[tuple[Path, str]] = []
    for name, spec in specs:
        figure = _figure(done, spec, courses)
        drawn += [(path, spec.get("caption", paper.CAPTION)) for path in save_all(figure, folder, name, formats)]
    return drawn


def _figure(done: Published, spec: Mapping[str, Any], courses: Sequence[curves.Run]) -> Figure:
    """By its `kind`: bars (if it says none), curves, or torques of the first job."""
    kind = spec.get("kind", "bars")
    if kind == "curves":
        return curves.draw(spec, courses)
    if kind == "torques":
        return repetitions.draw(spec, next(done.records())[1])
    return bars.draw(spec, done.spec.get("statements", ()), done.jobs)


def _exhibit(done: Published, drawn: Sequence[tuple[Path, str]]) -> Exhibit:
    return Exhibit(
        done.spec["title"],
        done.spec["source"],
        _command(done.name),
        figures=tuple(one for one in drawn if one[0].suffix == ".png"),
        table=done.table,
        verdicts=done.verdicts,
    )


def _command(name: str) -> str:
    return f"invdyn experiment {name}"


def _paper_tables(done: Published, picked: dict[str, str]) -> tuple[Grid, Grid]:
    """Tables I and II beside what the runs of the picked jobs had."""
    runs = {
        (labels["data"], labels["data.split"]): record
        for labels, record in done.records(lambda labels: comparison.matches(labels, picked))
    }
    return paper.table_one(next(iter(runs.values())).model), paper.table_two(runs)
