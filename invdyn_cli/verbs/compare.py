"""invdyn compare: finished runs of one robot beside each other, as a table and as a page."""

from collections.abc import Sequence
from pathlib import Path

from omegaconf import DictConfig, ListConfig

from invdyn_cli import store
from invdyn_cli.errors import UsageError, listed
from invdyn_cli.files import relative
from invdyn_cli.report import compared
from invdyn_cli.report.compared import Compared
from invdyn_cli.report.tables import robot_of
from invdyn_cli.verbs.finished import page_of
from invdyn_cli.verbs.launch import job, launch, quoted
from invdyn_cli.verbs.objects import trusted
from invdyn_cli.verbs.run import size_limit
from invdyn_cli.verbs.screen import Screen, stages


def main(argv: Sequence[str]) -> int:
    """Run with the overrides in argv, bare paths meaning runs=[PATH,…]; the exit code."""
    known = ("runs=", "trust=", "max_size=", "hydra.", "hydra/", "-")
    paths = [quoted(a) for a in argv if not a.startswith(known)]
    runs = [f"runs=[{','.join(paths)}]"] * bool(paths)
    return launch("compare", [*(a for a in argv if a.startswith(known)), *runs], task)


def task(config: DictConfig) -> None:
    """Read, compare, write, tell."""
    given = config.runs if isinstance(config.runs, ListConfig) else [config.runs]
    paths = [x for one in given for x in _runs(Path(str(one)).expanduser())]
    if len(paths) < 2:
        raise UsageError(
            f"compare got {len(paths)} runs ({listed(map(str, paths))}); allowed: two or more",
            advice="invdyn compare RUN RUN; RUN: the folder in the last line of `invdyn run`",
        )
    trust, limit = trusted(config), size_limit(config)
    folder, console = Path(job().runtime.output_dir), Screen()
    with stages() as stage:
        report = stage("read")
        runs = []
        for i, (path, name) in enumerate(zip(paths, _names(paths), strict=True)):
            report(i / len(paths), name)
            record = store.load_run(path, trust, limit=limit)
            runs.append(Compared(name, store.plain(store.metrics(record)), record, page_of(path.parent, folder)))
    refuse_others(runs)
    page = compared.write_page(runs, folder, f"{len(runs)} runs compared")
    console.print(compared.run_table(runs))
    if (joints := compared.joint_table(runs)) is not None:
        console.print(joints)
    console.print(compared.summary(runs))
    console.whole(relative(page))


def refuse_others(runs: Sequence[Compared]) -> None:
    """Raise a UsageError where two runs are of different robots or joints."""
    first, robots = runs[0], {}
    for x in runs:
        if x.metrics["joints"] != first.metrics["joints"]:
            got = (
                f"{first.name} has the joints {listed(first.metrics['joints'])}, {x.name} {listed(x.metrics['joints'])}"
            )
            raise UsageError(f"{got}; allowed: runs with the same joints in the same order")
        robot = robot_of(x.record) if x.record is not None else None
        if robot is not None:
            robots.setdefault(robot.name, x.name)
    if len(robots) > 1:
        got = ", ".join(f"{run} is of {robot}" for robot, run in robots.items())
        raise UsageError(f"{got}; allowed: runs of one robot")


def _runs(path: Path) -> list[Path]:
    """The run.h5 of a folder or of all jobs of a sweep; the path itself, if it is a file."""
    if not path.is_dir():
        return [path]
    jobs = sorted(path.glob(f"*/{store.RUN}"), key=lambda x: (len(x.parent.name), x.parent.name))
    return [path / store.RUN] if (path / store.RUN).is_file() or not jobs else jobs


def _names(paths: Sequence[Path]) -> list[str]:
    """The names of the runs' folders, with those above as far as it takes to distinguish them."""
    places = [x.absolute().parent for x in paths]
    deepest = max(len(x.parts) for x in places)
    for depth in range(1, deepest + 1):
        names = ["/".join(x.parts[-depth:]) for x in places]
        if len(set(names)) == len(names) and not any(x.isdigit() for x in names):  # a sweep's jobs are numbered
            return names
    raise UsageError(f"a run is named twice among {listed(map(str, paths))}; allowed: different runs")
