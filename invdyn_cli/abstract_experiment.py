"""The contract of an experiment that needs code: experiments/NAME.py has one class of it, NAME.yaml its options."""

import abc
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

from invdyn_cli.errors import UsageError, closest, listed

WAIT = ()
"""In a plan: what follows depends on the rows of all jobs before."""


class AbstractExperiment(abc.ABC):
    """A plan of jobs, the rows that each job gives, and the table of all rows.

    A frozen dataclass whose fields are the experiment's options; NAME.yaml lists each of them with the same default.
    `invdyn experiment` runs the jobs (in several processes with workers=N), keeps the rows of every finished job, and
    writes the table, the figures and all rows.
    """

    row: ClassVar[type]
    """The frozen dataclass of a row: plain values, and tuples of them. Rows are kept as JSON."""
    page: ClassVar[str] = ""
    """The page of a checkout in which docs=true replaces what stands between <!-- NAME --> and <!-- /NAME -->."""

    @abc.abstractmethod
    def plan(self, rows: Sequence[Any]) -> Iterable[tuple]:
        """The jobs in their order: plain values, all that the rows of a job depend on.

        Args:
            rows: of the jobs that have finished; it grows while the jobs are taken one by one. After WAIT it has those
                of all jobs before.

        Raises:
            UsageError: for an option that is not allowed, before the first job.
        """

    @abc.abstractmethod
    def run(self, folder: Path, *job: Any) -> Iterable[Any]:
        """The rows of one job, in any process. Other files of the job go into `folder`."""

    @abc.abstractmethod
    def table(self, rows: Sequence[Any]) -> str:
        """All rows, in the order of the plan, as Markdown."""

    def line(self, row: Any) -> str:
        """What is printed of a row when its job has finished."""
        return str(row)

    def figures(self, rows: Sequence[Any]) -> Mapping[str, Any]:
        """Figures of matplotlib by their file's name, without suffix."""
        return {}


def chosen(option: str, names: Sequence[str], allowed: Iterable[str]) -> list[str]:
    """The names that an option lists, or all that are allowed where it lists none.

    Raises:
        UsageError: for a name that is not allowed.
    """
    allowed = list(allowed)
    for name in names:
        if name not in allowed:
            raise UsageError(f"{option}={name}; allowed: {listed(allowed, most=30)}{closest(name, allowed)}")
    return list(names) or allowed
