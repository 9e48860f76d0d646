"""invdyn report: the figures and the page of a finished run, drawn anew from its run.h5."""

from collections.abc import Sequence
from pathlib import Path

from omegaconf import DictConfig

from invdyn_cli import store
from invdyn_cli.report import figures, page
from invdyn_cli.verbs.launch import launch, quoted
from invdyn_cli.verbs.objects import trusted
from invdyn_cli.verbs.run import refuse_formats, size_limit
from invdyn_cli.verbs.screen import Screen


def main(argv: Sequence[str]) -> int:
    """Run with the overrides in argv, a bare path meaning run=PATH; the exit code."""
    known = ("run=", "formats=", "trust=", "max_size=", "hydra.", "hydra/", "-")
    return launch("report", [a if a.startswith(known) else f"run={quoted(a)}" for a in argv], task)


def task(config: DictConfig) -> None:
    """Read, draw, say where."""
    refuse_formats("formats", config.formats)
    path = Path(str(config.run)).expanduser()
    path = path / store.RUN if path.is_dir() else path
    record = store.load_run(path, trusted(config), limit=size_limit(config))
    drawn = figures.draw_all(record, path.parent / "figures", ("png", *config.formats))
    page.write_page(record, [x for x in drawn if x.suffix == ".png"], path.parent / "report.html")
    Screen().whole(path.parent / "report.html")
