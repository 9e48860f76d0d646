"""Jobs of a sweep that differ by their seeds and learning rates alone are fitted in one program, and other processes
write their files.

Each of them then runs as if it were alone, with the run that is there already.
"""

import datetime
import json
import time
from collections.abc import Hashable, Iterable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
from omegaconf import DictConfig, OmegaConf

from invdyn_cli import experiment, interruption
from invdyn_cli.compiled import use_compilation_cache
from invdyn_cli.experiment import Prepared
from invdyn_cli.functions.fitting import FitResult
from invdyn_cli.interfaces import AbstractAdapter, AbstractModel, AbstractSource
from invdyn_cli.tracking.contract import flat
from invdyn_cli.types import Robot
from invdyn_cli.verbs import run, screen, sweep
from invdyn_cli.verbs.screen import Screen
from invdyn_cli.verbs.sweep import Made

OWN = ("seed", "figures", "tracker")
"""What a job may have for itself beside the model, whose `alike` says what it must share."""

WORTH = 6
"""Jobs in one program from which on other processes write their files: to start those takes about 2 s."""


@dataclass(frozen=True)
class Job:
    """A job of a sweep: its number, its config, Hydra's view of it and the folder that it will write into."""

    number: int
    config: DictConfig
    view: DictConfig
    folder: Path


@dataclass(frozen=True)
class _Asked:
    """A job as objects, and what it must have in common with those that it is fitted with; None: it is fitted alone."""

    job: Job
    source: AbstractSource
    model: AbstractModel
    adaptation: AbstractAdapter
    robot: Robot | None
    common: Hashable

    def fitted(self) -> AbstractModel:
        """The model that is fitted, with the parts that the adaptation adds."""
        return self.adaptation.extended(self.model)

    def made(self, prepared: Prepared, started: datetime.datetime, writers: Executor | None) -> Made:
        """Its run, with data and fit that are there already."""
        config, objects = self.job.config, (self.source, self.model, self.adaptation, self.robot)
        record = experiment.run(*objects, seed=config.seed, prepared=prepared)
        record = run.with_origin(record, config, started, self.job.view)
        save, formats = FitResult(record).save, tuple(config.figures.formats)
        return Made(record, writers.submit(save, self.job.folder, formats) if writers else None)


def made(jobs: Sequence[Job], writers: Executor) -> dict[int, Made]:
    """The runs, by job number, of all jobs that can be fitted in one program with others; says on stderr which."""
    waiting = [job for job in jobs if not sweep.is_complete(job.config, job.folder)]
    if len(waiting) < 2:
        return {}
    use_compilation_cache()
    asked = [one for job in waiting if (one := _asked(job)) is not None]
    groups: dict[Hashable, list[_Asked]] = {}
    for one in asked:
        groups.setdefault(one.common if one.common is not None else ("alone", one.job.number), []).append(one)
    found: dict[int, Made] = {}
    for group in groups.values():
        if len(group) > 1:
            found |= _fit(group, writers)
    for line in _why_alone([one for one in asked if one.job.number not in found]):
        screen.tell(line)
    return found


def _asked(job: Job) -> _Asked | None:
    """The job as objects; None for one that is refused, which it says itself when it runs."""
    try:
        run.refuse_options(job.config)
        source = run.make_object(job.config, "data", AbstractSource)
        adaptation = run.make_object(job.config, "adaptation", AbstractAdapter)
        model = run.make_object(job.config, "model", AbstractModel)
        fitted = adaptation.extended(model)
        alike = fitted.alike()
        if alike is None:
            return _Asked(job, source, model, adaptation, None, None)
        plain: Any = OmegaConf.to_container(job.config, resolve=True)
        shared = {name: value for name, value in plain.items() if name not in (*OWN, "model")}
        optional = not (source.needs_robot or fitted.needs_robot)
        robot = run.make_robot(job.config, source.header(), optional=optional, console=Screen(quiet=True))
        return _Asked(job, source, model, adaptation, robot, (json.dumps(shared, sort_keys=True, default=str), alike))
    except Exception:
        if interruption.was_asked():
            raise
        return None


def _fit(group: Sequence[_Asked], writers: Executor) -> dict[int, Made]:
    """The runs of a group, whose data are read once, as far as that works; what is wrong the other jobs will say."""
    first, numbers = group[0], [one.job.number for one in group]
    screen.tell(f"{_jobs(numbers)}: fitted in one program (they differ in {', '.join(_differing(group))})")
    found: dict[int, Made] = {}
    began, started = datetime.datetime.now(datetime.UTC), time.perf_counter()
    beside = sweep.started(writers) if len(group) >= WORTH else None
    try:
        with screen.stages() as stage:
            splits = first.source.load(first.robot, stage("data"))
            read = time.perf_counter()
            fits = first.fitted().fit_together(
                [one.fitted() for one in group],
                splits.train,
                [jax.random.key(one.job.config.seed) for one in group],
                validation=splits.validation,
                progress=stage("learn"),
            )
            seconds = (read - started) / len(group), (time.perf_counter() - read) / len(group)
            for one, fit in zip(group, fits, strict=True):
                found[one.job.number] = one.made(Prepared(splits, fit, *seconds), began, beside)
    except Exception as error:
        if interruption.was_asked():
            raise
        rest = [number for number in numbers if number not in found]
        screen.tell(f"{_jobs(rest)}: fitted one by one, because the program failed: {error}")
    return found


def _why_alone(asked: Sequence[_Asked]) -> Iterator[str]:
    """A line for each reason for which jobs are fitted one by one."""
    unable: dict[str, list[int]] = {}
    for one in asked:
        if one.common is None:
            unable.setdefault(type(one.model).__name__, []).append(one.job.number)
    for name, numbers in unable.items():
        yield f"{_jobs(numbers)}: fitted one by one, because {name} cannot be fitted with others in one program"
    single = [one for one in asked if one.common is not None]
    if single:
        names = ", ".join(name for name in _differing(single) if name != "seed")
        what = f"; these jobs also differ in {names}" if names else ""
        yield (
            f"{_jobs([one.job.number for one in single])}: fitted one by one, because jobs are fitted in one program "
            f"only if nothing but seed and learning rates differs{what}"
        )


def _differing(asked: Iterable[_Asked]) -> list[str]:
    """Options in which the jobs are not all the same."""
    configs = [dict(flat(OmegaConf.to_container(one.job.config, resolve=True))) for one in asked]
    names = dict.fromkeys(name for config in configs for name in config)
    return [name for name in names if len({str(config.get(name)) for config in configs}) > 1]


def _jobs(numbers: Sequence[int]) -> str:
    """'job 3', 'jobs 0 to 5, 7'."""
    runs: list[list[int]] = []
    for number in sorted(numbers):
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    parts = [str(x[0]) if len(x) == 1 else f"{x[0]} to {x[-1]}" for x in runs]
    return f"job{'s' * (len(numbers) > 1)} {', '.join(parts)}"
