"""invdyn experiment NAME: runs an experiment of experiments/*.yaml; one that is a sweep of runs by `invdyn tables`."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill
from typing import Any

from omegaconf import OmegaConf

from invdyn_cli.abstract_experiment import AbstractExperiment
from invdyn_cli.errors import UsageError, closest, listed
from invdyn_cli.files import write_file
from invdyn_cli.verbs import listing
from invdyn_cli.verbs.launch import config_folder, failed
from invdyn_cli.verbs.objects import instantiate

SHARED = """
folder: null   # where table, figures and rows go; null: outputs/NAME
workers: 1     # processes that work at the same time
fresh: false   # true: run jobs again that have finished
docs: false    # true: put the table and the figures into the pages of this checkout
"""
"""The options of every experiment that is a class, as in its own YAML, which may set another default."""


@dataclass(frozen=True)
class Shared:
    """The values of these options."""

    folder: str | None
    workers: int
    fresh: bool
    docs: bool


def main(argv: Sequence[str]) -> int:
    """List the experiments, print the options of one, or run one; the exit code."""
    name, *rest = argv or ["--help"]
    if name in ("-h", "--help"):
        print(_list(), end="")
        return 0
    try:
        return _experiment(name.replace("-", "_"), rest)
    except Exception as error:
        return failed("experiment", error, argv)


def _experiment(name: str, argv: Sequence[str]) -> int:
    if "=" in name:
        raise UsageError(f"{name} is no experiment; the first argument must be one", advice="invdyn experiment")
    spec = listing.read(name)
    if "_target_" not in spec:
        from invdyn_cli.verbs import tables

        return tables.main([f"experiment={name}", *argv])
    if {"-h", "--help"} & set(argv):
        print(_help(name, spec), end="")
        return 0
    options = _options(name, spec, argv)
    shared = Shared.__dataclass_fields__
    common = instantiate(_node(f"{__name__}.Shared", {x: options[x] for x in shared}))
    listing.admit(listing.places())
    experiment = instantiate(_node(spec["_target_"], {x: y for x, y in options.items() if x not in shared}))
    if not isinstance(experiment, AbstractExperiment):
        raise UsageError(f"{spec['_target_']} is no AbstractExperiment (invdyn_cli.abstract_experiment)")
    return _run(name, experiment, common, " ".join(["invdyn experiment", name, *argv]))


def _run(name: str, experiment: AbstractExperiment, common: Shared, command: str) -> int:
    """Run the jobs, print the table, and write the files; 2 where a job failed."""
    from invdyn_cli.verbs import jobs, screen

    folder = Path(common.folder or f"outputs/{name}")
    if common.docs:
        _refuse_docs(name, experiment)
    with screen.stages() as stage:
        rows, failures = jobs.run_all(
            experiment, folder, workers=common.workers, fresh=common.fresh, progress=stage(name)
        )
    if rows:
        text = experiment.table(rows)
        print(text)
        write_file(folder / f"{name}.json", jobs.to_json(rows))
        page = write_file(folder / f"{name}.md", f"`{command}`\n\n{text}\n")
        figures = experiment.figures(rows)
        for path in [*_draw(folder, figures), *(_publish(name, experiment, text, figures) if common.docs else [])]:
            screen.Screen().whole(path)
        screen.Screen().whole(page)
    if failures:
        said = "1 job failed" if failures == 1 else f"{failures} jobs failed"
        screen.tell(f"invdyn: {said}; the same command tries again, and keeps the jobs that have finished")
    return 2 if failures else 0


def _draw(folder: Path, figures: Mapping[str, Any]) -> list[Path]:
    from invdyn_cli.report.canvas import save

    return [save(figure, folder / f"{title}.png") for title, figure in figures.items()]


def _refuse_docs(name: str, experiment: AbstractExperiment) -> None:
    if not (_root() / "docs" / "index.md").is_file():
        raise UsageError("docs=true writes into the docs of a source checkout; this installation has none")
    if not experiment.page and type(experiment).figures is AbstractExperiment.figures:
        raise UsageError(f"docs=true, but {name} has no table or figure in the docs")


def _publish(name: str, experiment: AbstractExperiment, text: str, figures: Mapping[str, Any]) -> list[Path]:
    """Figures and table into the pages of the checkout."""
    if experiment.page:
        put(_root() / experiment.page, name, text)
    return [*_draw(_root() / "docs", figures), *([_root() / experiment.page] if experiment.page else [])]


def _root() -> Path:
    return config_folder().parent


def put(page: Path, name: str, text: str) -> None:
    """Replace what stands between <!-- name --> and <!-- /name --> of a page.

    Raises:
        UsageError: if the page does not have both, in this order, once.
    """
    whole = page.read_text()
    start, end = f"<!-- {name} -->", f"<!-- /{name} -->"
    before, found, rest = whole.partition(start)
    _, closed, after = rest.partition(end)
    if not found or not closed or whole.count(start) + whole.count(end) != 2:
        raise UsageError(f"{page} must have {start} and {end}, once each")
    write_file(page, f"{before}{start}\n{text.strip()}\n{end}{after}")


def _options(name: str, spec: Mapping[str, Any], argv: Sequence[str]) -> dict[str, Any]:
    """The options of an experiment with their values: those of argv, else those of its YAML and of all experiments."""
    options = usual(spec)
    said = {}
    for argument in argv:
        option, equals, text = argument.partition("=")
        if not equals or option not in options:
            allowed = listed((f"{x}=…" for x in options), most=30)
            raise UsageError(
                f"there is no option {argument}; allowed: {allowed}{closest(option, options)}",
                advice=f"invdyn experiment {name} --help",
            )
        said[option] = _value(text, options[option])
        if type(said[option]) in (int, float) and said[option] < 0:
            raise UsageError(f"{argument}; allowed: a number of 0 or more")
    return options | said


def usual(spec: Mapping[str, Any]) -> dict[str, Any]:
    """The options of an experiment that is a class, with their defaults."""
    shared: Any = OmegaConf.to_container(OmegaConf.create(SHARED))
    return {**shared, **{x: y for x, y in spec.items() if x not in listing.CLASS}}


def _value(text: str, usual: Any) -> Any:
    """A value of the type of the default: a list is separated by commas, text stays text."""
    if isinstance(usual, list):
        texts = [x.strip() for x in text.strip("[]").split(",") if x.strip()]
        return [_value(x, usual[0] if usual else "") for x in texts]
    if isinstance(usual, str):
        return text
    for kind in (int, float):
        with suppress(ValueError):
            return kind(text)
    return {"true": True, "false": False, "null": None}.get(text, text)


def _node(target: str, options: Mapping[str, Any]) -> Any:
    return OmegaConf.create({"_target_": target, **options})


def _list() -> str:
    names = listing.names()
    margin = max(map(len, names), default=0) + 4
    lines = ["invdyn experiment: run an experiment, and write its table", ""]
    lines += ["usage: invdyn experiment NAME [option=value ...]", "       invdyn experiment NAME --help", ""]
    for name in names:
        with suppress(UsageError):
            title = str(listing.read(name)["title"])
            lines.append(fill(title, 80, initial_indent=f"  {name}".ljust(margin), subsequent_indent=margin * " "))
    return "\n".join([*lines, ""])


def _help(name: str, spec: Mapping[str, Any]) -> str:
    """The title, the options as their YAML files have them, and where the page is."""
    path = listing.path_of(name)
    own = path.read_text().partition("\n_target_:")[2].partition("\n")[2].strip()
    shared = [x for x in SHARED.strip().splitlines() if x.partition(":")[0] not in spec]
    head = [f"invdyn experiment {name}: {spec['title']}", "", f"usage: invdyn experiment {name} [option=value ...]"]
    page = path.with_suffix(".md")
    return "\n".join([*head, "", own, *shared, *(["", f"Question and results: {page}"] if page.is_file() else []), ""])
