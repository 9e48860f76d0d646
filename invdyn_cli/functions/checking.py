"""`check`: whether a log is sound, what can be corrected in it, and what its motion excites."""

from dataclasses import dataclass
from pathlib import Path
from typing import Unpack

from rich.console import Group
from rich.text import Text

from invdyn_cli import store
from invdyn_cli.diagnosis import doctor
from invdyn_cli.diagnosis.marks import Mark, located
from invdyn_cli.files import write_file
from invdyn_cli.functions.arrays import Arrays
from invdyn_cli.functions.inputs import LogLike, RobotLike, log_of, robot_of
from invdyn_cli.interfaces import Progress, silent
from invdyn_cli.log import Log
from invdyn_cli.maths.threads import one_blas_thread
from invdyn_cli.recording.channels import in_newton_metres, ordered
from invdyn_cli.report import check_figures, check_page, check_plots
from invdyn_cli.report.check_terminal import shown
from invdyn_cli.report.checked_log import CheckedLog
from invdyn_cli.report.fragment import Shown
from invdyn_cli.types import Check, Examination, Robot

CHECK, REPORT = "check.json", "report.html"
NO_ROBOT = "no robot: checks that need its kinematics were skipped"


@dataclass(frozen=True, repr=False)
class CheckResult(Shown):
    """The result of the checks of a log.

    Attributes:
        log: what was checked, columns in the robot's order.
        robot: None where there is none.
        examination: every check, what the motion excites.
        corrected: the log with all corrections, as a diagnosis takes it.
        marks: where in the log each finding is.
        notes: what the reader should know beside.
    """

    log: Log
    robot: Robot | None
    examination: Examination
    corrected: Log
    marks: tuple[Mark, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def corrections(self) -> tuple[str, ...]:
        """One sentence for each."""
        return doctor.done(self.examination)

    @property
    def usable(self) -> bool:
        """Whether a diagnosis can start from this log."""
        return self.examination.usable

    @property
    def checks(self) -> tuple[Check, ...]:
        """Every check with severity, place, value and advice."""
        return self.examination.checks

    def __rich__(self) -> Group:
        return Group(*(Text(x, "dim") for x in self.notes), shown(self.examination))

    def save(self, folder: str | Path, progress: Progress = silent) -> Path:
        """Write check.json, report.html and figures/ into the folder, as `invdyn check` does; the page's path."""
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        progress(0.8, "report")
        drawn = CheckedLog(self.log, self.corrected, self.marks, self.robot)
        figures, lacking = check_figures.draw_all(drawn, folder / "figures")
        notes, live = [*self.notes, *lacking], check_plots.all_plots(drawn)
        text = check_page.page(self.examination, self.log, self.robot, figures, notes, live)
        page = write_file(folder / REPORT, text)
        store.write_check(self.examination, folder / CHECK)
        progress(1.0, "done")
        return page


def check(
    log: LogLike | None = None, robot: RobotLike | None = None, *, correct: bool = True, **arrays: Unpack[Arrays]
) -> CheckResult:
    """Check a recording; nothing in it is too broken to be described.

    Args:
        log: a log or the path of a file in any format; or arrays: `q=, tau=, t=, urdf=` as in `from_arrays`.
        robot: a robot or the path of its URDF; None: the one that the log names, or none.
        correct: False: the log is examined as recorded; nothing is corrected.

    Raises:
        UsageError, LogError, RobotError: for what cannot be read at all, or does not belong together.
    """
    found = log_of(log, **arrays)
    return examine(found, robot_of(robot, found, arrays), correct=correct)


def examine(log: Log, robot: Robot | None, *, correct: bool = True) -> CheckResult:
    """Check all trajectories of a log together; nothing is corrected where `correct` is False."""
    notes = list(robot.notes) if robot else [NO_ROBOT]
    log = in_newton_metres(ordered(log, robot, notes))
    with one_blas_thread():
        corrected, examination, marks = located(log, robot, correct=correct)
    return CheckResult(log, robot, examination, corrected, marks, tuple(notes))
