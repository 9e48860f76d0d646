"""invdyn figures: the figures of experiments/*.yaml, and the page that puts all of it beside the paper."""

from collections.abc import Sequence
from pathlib import Path

from omegaconf import DictConfig
from rich.console import Console

from invdyn_cli import store
from invdyn_cli.errors import LogError
from invdyn_cli.report import bars, comparison, html, paper
from invdyn_cli.report.comparison import Grid
from invdyn_cli.report.paper import Exhibit
from invdyn_cli.verbs import published, tables
from invdyn_cli.verbs.launch import launch
from invdyn_cli.verbs.published import Published
from invdyn_cli.verbs.run import refuse_formats


def main(argv: Sequence[str]) -> int:
    """Run with the overrides in argv; the exit code."""
    return launch("figures", argv, task)


def task(config: DictConfig) -> None:
    """Run what is not complete, draw, and write the page."""
    refuse_formats("formats", config.formats)
    console, real_data, own = Console(), Path(config.real_data).resolve(), Path(config.tables)
    exhibits: list[Exhibit] = []
    nets: Grid | None = None
    sets: Grid | None = None
    for name in config.shown:
        try:
            done = published.run_all(name, own, real_data, fresh=config.fresh)
        except LogError as error:
            spec = published.read(name)
            console.print(f"[yellow]{name} is left out: {error}[/]", highlight=False, soft_wrap=True)
            exhibits.append(Exhibit(spec["title"], spec["source"], _command(name), absent=str(error)))
            continue
        tables.write(done, own)
        drawn = _draw(done, Path(config.folder), sorted({"png", *config.formats}))
        for path in drawn:
            console.print(str(path), highlight=False, soft_wrap=True)
        exhibits.append(_exhibit(done, drawn))
        if picked := done.spec.get("paper_tables"):
            nets, sets = _paper_tables(done, picked)
    Path(config.page).parent.mkdir(parents=True, exist_ok=True)
    written = html.write_whole(Path(config.page), paper.page(exhibits, nets, sets))
    console.print(str(written), highlight=False, soft_wrap=True)


def _draw(done: Published, folder: Path, formats: Sequence[str]) -> list[Path]:
    """The experiment's figure, once per format; nothing where it has none."""
    if "figure" not in done.spec:
        return []
    figure = bars.draw(done.spec["figure"], done.spec.get("statements", ()), done.jobs)
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{done.name}.{suffix}" for suffix in formats]
    for path in paths:
        store.write_aside(path, lambda part, kind=path.suffix[1:]: figure.savefig(part, dpi=110, format=kind))
    return paths


def _exhibit(done: Published, drawn: Sequence[Path]) -> Exhibit:
    return Exhibit(
        done.spec["title"],
        done.spec["source"],
        _command(done.name),
        figure=next((path for path in drawn if path.suffix == ".png"), None),
        table=done.table,
        verdicts=done.verdicts,
    )


def _command(name: str) -> str:
    return f"invdyn tables experiment={name}"


def _paper_tables(done: Published, picked: dict[str, str]) -> tuple[Grid, Grid]:
    """Tables I and II beside what the runs of the picked jobs had."""
    runs = {
        (labels["data"], labels["data.split"]): store.load_run(folder / store.RUN)
        for (labels, _), folder in zip(done.jobs, done.folders, strict=True)
        if comparison.matches(labels, picked)
    }
    return paper.table_one(next(iter(runs.values())).model), paper.table_two(runs)
