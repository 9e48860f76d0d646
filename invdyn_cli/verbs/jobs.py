"""Runs the jobs of an experiment, in one process or several, and keeps the rows of those that have finished."""

import hashlib
import json
import multiprocessing
import signal
import sys
import traceback
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from invdyn_cli import interruption
from invdyn_cli.abstract_experiment import WAIT, AbstractExperiment
from invdyn_cli.compiled import use_compilation_cache
from invdyn_cli.errors import InvdynError, RunFileError, UsageError
from invdyn_cli.files import write_file
from invdyn_cli.interfaces import Progress
from invdyn_cli.untrusted import read_json
from invdyn_cli.verbs import origin
from invdyn_cli.verbs.listing import admit, places
from invdyn_cli.verbs.screen import tell

KEPT = "jobs"
"""The folder of the rows of finished jobs, inside the experiment's."""


def run_all(
    experiment: AbstractExperiment, folder: Path, *, workers: int, fresh: bool, progress: Progress
) -> tuple[list[Any], int]:
    """Run the jobs of the plan whose rows are not in `folder` yet (all of them, if `fresh`).

    Returns:
        The rows in the order of the plan, and how many jobs failed; what failed is told on stderr.
    """
    total = sum(job != WAIT for job in experiment.plan(()))
    code, rows, failed = _code(experiment), [], 0
    numbered: dict[int, list[Any]] = {}
    with closing(_finished(experiment, folder, rows, workers, code, fresh)) as finished:
        for (number, job), found, is_new in finished:
            if isinstance(found, BaseException):
                failed += 1
                _tell_failure(job, found)
                continue
            if is_new:
                _keep(folder, job, code, found)
                print(*map(experiment.line, found), sep="\n", end="\n" if found else "", flush=True)
            numbered[number] = found
            rows.extend(found)
            progress(len(numbered) / total, f"{len(numbered)} of {total} jobs")
    return [row for number in sorted(numbered) for row in numbered[number]], failed


def _finished(
    experiment: AbstractExperiment, folder: Path, rows: Sequence[Any], workers: int, code: str, fresh: bool
) -> Generator[tuple[tuple[int, tuple], list[Any] | BaseException, bool], None, None]:
    """Number and job, its rows or what it raised, and whether it was run now, in the order in which jobs finish."""
    plan, held = enumerate(experiment.plan(rows)), False
    waiting: dict[Future, tuple[int, tuple]] = {}
    with executor(workers) as pool:
        while True:
            held = held and bool(waiting)
            while len(waiting) < workers and not held and (following := next(plan, None)):
                if following[1] == WAIT:
                    held = bool(waiting)
                    continue
                kept = None if fresh else _kept(folder, experiment, following[1], code)
                if kept is not None:
                    yield following, kept, False
                else:
                    waiting[pool.submit(_rows, experiment, folder, following[1])] = following
            if not waiting:
                return
            for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                yield waiting.pop(future), future.exception() or future.result(), True


def _rows(experiment: AbstractExperiment, folder: Path, job: tuple) -> list[Any]:
    return list(experiment.run(folder, *job))


def _tell_failure(job: tuple, error: BaseException) -> None:
    """One line for wrong use, the traceback for an error of invdyn; a process that died ends the whole run."""
    if isinstance(error, BrokenProcessPool):
        raise UsageError("a process of the experiment was killed; finished jobs are kept", advice="workers=1")
    if isinstance(error, InvdynError):
        tell(f"job {job}: {error}")
    else:
        tell(f"job {job}: {''.join(traceback.format_exception(error))}")


class _Here(Executor):
    """Runs a job immediately, in this process."""

    def submit(self, fn: Callable, /, *args: Any, **kwargs: Any) -> Future:
        """The future of a call that is over."""
        future: Future = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


@contextmanager
def executor(workers: int) -> Iterator[Executor]:
    """A pool of processes if there are several workers; Ctrl-C and errors end them. UsageError where there is none."""
    if type(workers) is not int or workers < 1:
        raise UsageError(f"workers={workers}; allowed: 1 and more")
    if workers == 1:
        use_compilation_cache()
        yield _Here()
        return
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), _begin, (places(), sys.path))
    try:
        yield pool
    except BaseException:
        for process in multiprocessing.active_children():
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _begin(folders: list[Path], path: list[str]) -> None:
    """A new process finds experiments where its parent does, and ends silently on Ctrl-C and with its parent."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    interruption.end_with_parent()
    sys.path[:] = path
    admit(folders)
    use_compilation_cache()


def _code(experiment: AbstractExperiment) -> str:
    """A hash of the code that rows depend on: the package's and that of the experiment's folder."""
    file = Path(str(sys.modules[type(experiment).__module__].__file__))
    return origin.hash_of([*origin.PACKAGE.rglob("*.py"), *file.parent.glob("*.py")])


def _path(folder: Path, job: tuple) -> Path:
    return folder / KEPT / f"{hashlib.sha256(_json(job).encode()).hexdigest()[:16]}.json"


def _keep(folder: Path, job: tuple, code: str, rows: Sequence[Any]) -> None:
    content = {"job": job, "code": code, "rows": [asdict(row) for row in rows]}
    write_file(_path(folder, job), _json(content))


def _kept(folder: Path, experiment: AbstractExperiment, job: tuple, code: str) -> list[Any] | None:
    """The rows of a job that finished with this very code; None if there are none."""
    try:
        content = read_json(_path(folder, job), RunFileError)
        if content["code"] == code and _json(content["job"]) == _json(job):
            return [experiment.row(**{name: _tuples(x) for name, x in row.items()}) for row in content["rows"]]
    except (InvdynError, TypeError, KeyError, AttributeError):  # whatever is wrong with that file, the job runs again
        pass
    return None


def to_json(rows: Sequence[Any]) -> str:
    """The rows as a JSON list."""
    return _json([asdict(row) for row in rows], indent=1) + "\n"


def _json(content: Any, indent: int | None = None) -> str:
    return json.dumps(content, indent=indent, default=lambda x: x.tolist())


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value
