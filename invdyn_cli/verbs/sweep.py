"""Sweeps: a folder that the same command finds again, complete jobs that are kept, and a table of all at the end."""

import json
import multiprocessing
import os
import traceback
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from html import escape
from pathlib import Path
from types import MappingProxyType
from typing import Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig, OmegaConf

from invdyn_cli import interruption, store, untrusted
from invdyn_cli.errors import InvdynError, RunFileError
from invdyn_cli.files import write_file
from invdyn_cli.maths.threads import cores
from invdyn_cli.report import compared, tables
from invdyn_cli.types import RunRecord
from invdyn_cli.verbs import folders, origin
from invdyn_cli.verbs.finished import finished
from invdyn_cli.verbs.launch import TRACEBACK, config_folder, told
from invdyn_cli.verbs.screen import Screen

STATUS = "status.json"

SIDE_BY_SIDE = ("joblib", "submitit_local")
"""Launchers that run several jobs on this machine at once."""

ONE_THREAD = {"OMP_NUM_THREADS": "1", "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false"}
"""Environment variables that limit a process to one thread; processes that start later inherit them."""

SILENT = "ignore:resource_tracker"
"""Of Python's warnings the one about semaphores of a process that Ctrl-C stopped."""


def with_folder(verb: str, argv: Sequence[str]) -> list[str]:
    """argv with a sweep folder named after the jobs, unless it names one: run again, the same sweep goes on."""
    argv = list(argv)
    if not {"-m", "--multirun"} & set(argv) or any(a.startswith("hydra.sweep.dir=") for a in argv):
        return argv
    overrides = [a for a in argv if not a.startswith(("-", "hydra.", "hydra/"))]
    listed: Any = OmegaConf.to_container(OmegaConf.load(config_folder() / f"{verb}.yaml"), resolve=False)
    defaults = {k: v for one in listed["defaults"] if isinstance(one, dict) for k, v in one.items()}
    return [*argv, f"hydra.sweep.dir='{folders.sweep_folder(overrides, defaults)}'"]


def is_complete(config: DictConfig, folder: Path) -> bool:
    """Whether the folder contains exactly this job, complete, and nothing has changed since: its logs, its URDF, the
    code."""
    done = folder / store.METRICS
    if not done.is_file() or not (folder / store.RUN).is_file():
        return False
    named = [config.data.get("path") or [], config.robot.get("path") or []]
    files = [Path(x).expanduser() for given in named for x in ([given] if isinstance(given, str) else given)]
    if any(file.is_file() and file.stat().st_mtime > done.stat().st_mtime for file in files):
        return False
    try:
        kept, provenance = store.load_origin(folder / store.RUN)
    except InvdynError:  # whatever is wrong with that file, the job has to run again
        return False
    return kept == OmegaConf.to_yaml(config, resolve=True) and provenance.get("code") == origin.fingerprint()


def keep_status(
    folder: Path, number: int, overrides: Sequence[str], status: str, message: str = "", **facts: str
) -> None:
    """Write a job's number, its overrides and its outcome (started, ran, kept, failed) into its folder."""
    left = {"job": number, "overrides": list(overrides), "status": status, "message": message, **facts}
    write_file(folder / STATUS, json.dumps(left))


def reason(verb: str, error: Exception, folder: Path, asked: Sequence[str]) -> str:
    """Why a job failed, in a line; the traceback of an error of ours is kept in its folder."""
    if line := told(verb, error, asked):
        return line
    write_file(folder / TRACEBACK, "".join(traceback.format_exception(error)))
    return f"{type(error).__name__}: {error}"


def run_side_by_side(config: DictConfig) -> None:
    """Let processes that are started from now on take one thread, where the launcher runs several of them here."""
    if config.hydra.runtime.choices.get("hydra/launcher") in SIDE_BY_SIDE:
        flags = f"{os.environ.get('XLA_FLAGS', '')} {ONE_THREAD['XLA_FLAGS']}".strip()
        os.environ.update(ONE_THREAD | {"XLA_FLAGS": flags})


def objective(folder: Path) -> float:
    """Mean NMSE over joints of the finished run in `folder`: of the validation set, else of the test set."""
    found = untrusted.read_json(folder / store.METRICS, RunFileError)
    return float((found.get("validation") or found["test"])["nmse"]["mean"])


@dataclass(frozen=True)
class Made:
    """A job's run that exists before the job runs, and what another process is doing to write its files; None: nobody
    writes them."""

    record: RunRecord
    writing: Future | None

    def is_written(self) -> bool:
        """Whether its files are there, as soon as the other process has ended; if that failed, this one tries, too."""
        return self.writing is not None and self.writing.exception() is None


@contextmanager
def writers(most: int | None = None) -> Iterator[Executor]:
    """Processes that write files, one per core but at most so many, started when there is something to write; they end
    with this one."""
    os.environ["PYTHONWARNINGS"] = ",".join(x for x in (os.environ.get("PYTHONWARNINGS"), SILENT) if x)
    pool = ProcessPoolExecutor(min(cores(), most or cores()), multiprocessing.get_context("spawn"), initializer=_begin)
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)


def started(writers: Executor) -> Executor:
    """The same processes, which begin with their imports."""
    for _ in range(cores()):
        writers.submit(int)
    return writers


def _begin() -> None:
    """Leave Ctrl-C to the process that started this one, and end when it does."""
    interruption.ignore()
    interruption.end_with_parent()


@contextmanager
def made(found: Mapping[int, Made]) -> Iterator[None]:
    """Within it, `made_for` returns the runs of jobs with these numbers."""
    token = _made.set(found)
    try:
        yield
    finally:
        _made.reset(token)


def made_for(number: int) -> Made | None:
    """The run of a job, where it is there already."""
    return _made.get().get(number)


_made: ContextVar[Mapping[int, Made]] = ContextVar("made", default=MappingProxyType({}))


class Summary(Callback):
    """Prints the table of all jobs when a sweep ends, and writes sweep.csv and report.html beside them; whatever
    launcher ran them.

    Raises SystemExit with exit code 2 if a job failed.
    """

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Forget how the jobs of an earlier sweep in this folder went; what they wrote stays. Jobs that run side by
        side take a thread each."""
        run_side_by_side(config)
        for path in Path(config.hydra.sweep.dir).glob(f"*/{STATUS}"):
            path.unlink()

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Read what the jobs left in their folders."""
        folder = Path(config.hydra.sweep.dir)
        rows = sorted((_row(path.parent) for path in folder.glob(f"*/{STATUS}")), key=lambda row: row["job"])
        write_file(folder / "sweep.csv", tables.sweep_csv(rows))
        named = [{**row, "overrides": name} for row, name in zip(rows, _names(rows), strict=True)]
        console = Screen()
        console.print(tables.sweep_table(named))
        write_page(named, folder)
        console.whole(folder)
        end(folder, [row["status"] == "failed" for row in rows])


def end(folder: Path, failed: Sequence[bool]) -> None:
    """Let outputs/latest lead to a sweep in which not every job failed.

    Raises SystemExit with exit code 2 if one did.
    """
    if not all(failed):
        folders.point_to(folder)
    if any(failed):
        raise SystemExit(2)


def write_page(rows: Sequence[Mapping[str, Any]], folder: Path) -> Path:
    """Write the page of a sweep: its finished jobs beside each other, and a table of all.

    Args:
        rows: of `tables.SWEEP_FIELDS`, one for every job; its name in the page is `overrides`.
        folder: of the sweep, where report.html and figures/ are written.
    """
    names = [f"{row['job']}: {row['overrides']}" if row["overrides"] else str(row["job"]) for row in rows]
    done = [i for i, row in enumerate(rows) if row["status"] != "failed"]
    runs = finished([folder / str(rows[i]["folder"]) for i in done], [names[i] for i in done], folder)
    failed = [row for row in rows if row["status"] == "failed"]
    sentences = "".join(
        f'<p class="warning">Job {row["job"]} failed ({escape(row["overrides"])}): {escape(row["message"])}</p>\n'
        for row in failed
    )
    return compared.write_page(runs, folder, f"A sweep of {len(rows)} jobs", told=sentences)


def _names(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """The overrides of each job that it does not share with all others; of model.hidden the last part, hidden, unless
    two options end so."""
    jobs = [row["overrides"].split() for row in rows]
    shared = set.intersection(*map(set, jobs)) if len(jobs) > 1 else set()
    own = [[override.partition("=") for override in job if override not in shared] for job in jobs]
    ends = Counter(key.rpartition(".")[2] for key in {key for job in own for key, *_ in job})
    short = {key: end for job in own for key, *_ in job if ends[end := key.rpartition(".")[2]] == 1}
    return [" ".join(f"{short.get(key, key)}{equals}{value}" for key, equals, value in job) for job in own]


def _row(folder: Path) -> dict[str, Any]:
    """What a job left in its folder; one that was killed, or left something else, has failed."""
    row = {"job": 0, "folder": folder.name, "overrides": folder.name}
    scores = {"test_nmse": None, "test_rmse": None, "seconds": None}
    try:
        left = untrusted.read_json(folder / STATUS, RunFileError)
        row["job"] = int(left["job"])
        row["overrides"] = " ".join(untrusted.names(left["overrides"], "overrides"))
        status, message = str(left["status"]), str(left["message"])
        if status == "started":
            status, message = "failed", "killed"
        if status != "failed":
            found = untrusted.read_json(folder / store.METRICS, RunFileError)
            test, seconds = found["test"], found["seconds"]["total"]
            values = (test["nmse"]["mean"], test["rmse"]["mean"], seconds)
            scores = {name: None if x is None else float(x) for name, x in zip(scores, values, strict=True)}
    except (InvdynError, ValueError, TypeError, KeyError) as error:
        status, message = "failed", f"{folder.name} holds something else: {error}"
    return {**row, "status": status, "message": message, **scores}
