"""The experiments of experiments/*.yaml: their jobs, which are run if they are not complete, and their tables."""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import hydra
from omegaconf import DictConfig, open_dict

from invdyn_cli import store, untrusted
from invdyn_cli.data.recorded import RealLog
from invdyn_cli.errors import LogError, RunFileError, UsageError, listed
from invdyn_cli.maths import metrics
from invdyn_cli.report import comparison
from invdyn_cli.report.comparison import Grid, Job
from invdyn_cli.types import RunRecord
from invdyn_cli.verbs import jobs as processes
from invdyn_cli.verbs import listing, run, screen, sweep


@dataclass(frozen=True)
class Published:
    """An experiment that was run: the contents of its file, its jobs and their folders, its table, and the paper's
    statements with a verdict each (None where it has none)."""

    name: str
    spec: Mapping[str, Any]
    jobs: tuple[Job, ...]
    folders: tuple[Path, ...]
    table: Grid
    verdicts: Grid | None
    trust: tuple[str, ...] = ()

    def records(
        self, wanted: Callable[[Mapping[str, str]], bool] = lambda _: True
    ) -> Iterator[tuple[Mapping[str, str], RunRecord]]:
        """The labels and the run of every wanted job, read one after the other."""
        for (labels, _), folder in zip(self.jobs, self.folders, strict=True):
            if wanted(labels):
                yield labels, store.load_run(folder / store.RUN, self.trust)


def run_all(
    name: str, folder: Path, real_data: Path, *, fresh: bool = False, trust: Sequence[str] = (), workers: int = 1
) -> Published:
    """Run what is not complete (all of it, if `fresh`), a folder per job in `folder`/`name`, in so many processes.

    `trust` names modules whose models may be read back.

    Raises:
        LogError: if there is a log that the experiment needs and `real_data` does not hold.
        UsageError: if there is no such experiment, or no worker.
    """
    spec = listing.read(name)
    if "_target_" in spec:
        raise UsageError(f"experiment={name} is no sweep of runs", advice=f"invdyn experiment {name}")
    jobs = [(labels, _substituted(overrides, real_data)) for labels, overrides in expand(spec)]
    missing = sorted({path for _, overrides in jobs for path in _logs(overrides) if not path.is_file()})
    if missing:
        raise LogError(
            f"experiment {name} needs files that do not exist: {listed(map(str, missing))}",
            advice="INVDYN_REAL_DATA=FOLDER, where FOLDER contains these logs",
        )
    folders = [folder / name / _slug(labels) for labels, _ in jobs]
    with screen.stages() as stage, processes.executor(workers) as pool:
        report, running = stage(f"runs of {name}"), set[Future]()
        for i, ((labels, overrides), own) in enumerate(zip(jobs, folders, strict=True)):
            running = _ended(running, workers - 1)
            report((i - len(running)) / len(jobs), " ".join(labels.values()))
            running |= _started(pool, overrides, own, fresh=fresh)
        _ended(running, 0)
    metrics_of = (untrusted.read_json(own / store.METRICS, RunFileError) for own in folders)
    done = [(labels, own) for (labels, _), own in zip(jobs, metrics_of, strict=True)]
    verdicts = comparison.judge(spec["statements"], done) if spec.get("statements") else None
    return Published(name, spec, tuple(done), tuple(folders), _grid(spec, done, real_data), verdicts, tuple(trust))


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


def _ended(running: set[Future], most: int) -> set[Future]:
    """What still runs when there are no more than so many jobs; raises what one of the others raised."""
    while len(running) > most:
        over, running = wait(running, return_when=FIRST_COMPLETED)
        for one in over:
            one.result()
    return running


def _started(pool: Executor, overrides: Sequence[str], folder: Path, *, fresh: bool) -> set[Future]:
    """The job, begun unless its folder holds it complete."""
    composed = hydra.compose("run", list(overrides), return_hydra_config=True)
    view = composed.hydra
    with open_dict(composed):
        del composed["hydra"]
    if not fresh and sweep.is_complete(composed, folder):
        return set()
    return {pool.submit(_run, composed, folder, view)}


def _run(config: DictConfig, folder: Path, view: Any) -> None:
    run.execute(config, folder, view=view)


def _grid(spec: Mapping[str, Any], done: Sequence[Job], real_data: Path) -> Grid:
    if spec["columns"] == "sets":
        return comparison.by_sets(done)
    if spec["columns"] == "stages":
        return comparison.by_stages(done)
    floors = {
        name: _noise_floor(real_data / path, *repeated) for name, (path, *repeated) in spec.get("floors", {}).items()
    }
    return comparison.by_joints(done, floors)


def _noise_floor(path: Path, first: str, again: str) -> list[float]:
    """RMS of half the difference [N m] between a trajectory and its repetition, read in the same way as the data."""
    splits = RealLog(str(path), train=(first,), test=(again,), validation_share=0).load(None)
    one, other = splits.train, splits.tests["test"]
    return metrics.noise_floor(one.motion.q, one.tau, other.motion.q, other.tau).tolist()


def _substituted(overrides: Sequence[str], real_data: Path) -> list[str]:
    return [override.replace("${real_data}", str(real_data)) for override in overrides]


def _logs(overrides: Sequence[str]) -> Iterator[Path]:
    return (Path(x.removeprefix("data.path=")) for x in overrides if x.startswith("data.path="))


def _slug(labels: Mapping[str, str]) -> str:
    return "-".join("".join(c if c.isalnum() else "_" for c in value) for value in labels.values()).lower()
