"""The diagnoses of many logs on one page: which robot, which causes, what has changed, and since when."""

import itertools
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape

from rich import box
from rich.table import Table
from rich.text import Text

from invdyn_cli.report.html import document, row, section, table
from invdyn_cli.report.quantities import quantity_text
from invdyn_cli.report.tables import STATUS_STYLE, csv_text
from invdyn_cli.report.wording import CLAIMS, UNSEEN, capital, cause, headline_of, words
from invdyn_cli.types import Finding, Quantity

TORQUE = "rms_of_term_N_m"
"""Where a finding's evidence has the RMS torque of its effect on each joint."""

DATE = re.compile(r"(?<!\d)(20\d\d)-?([01]\d)-?([0-3]\d)(?:[-_T ]?([0-2]\d)[-_:h]?([0-5]\d))?(?!\d)")
"""A date in a file's name, with or without a time: 2026-11-24, 20261124_2103."""


@dataclass(frozen=True)
class Diagnosed:
    """One log of a fleet.

    Attributes:
        number: of the job; the logs' order where their names have no dates.
        robot: its name in the log; "" where that could not be read.
        log: name of the log's file.
        folder: of its report, relative to the page.
        verdict: as in diagnosis.json; "failed" where there is no diagnosis.
        message: why it failed.
        findings: as in diagnosis.json.
        terms: every standard term of the written model by (effect, joint), named or not.
        errors: held-out RMSE [N m; N] that the extended model leaves on each joint.
    """

    number: int
    robot: str
    log: str
    folder: str
    verdict: str
    message: str = ""
    findings: tuple[Finding, ...] = ()
    terms: Mapping[tuple[str, str | None], Quantity] = field(default_factory=dict)
    errors: Mapping[str, float] = field(default_factory=dict)

    @property
    def date(self) -> str:
        """'2026-11-24 21:03' from the log's name, "" where it has none."""
        found = DATE.search(self.log)
        if found is None:
            return ""
        year, month, day, hour, minute = found.groups()
        return f"{year}-{month}-{day}" + (f" {hour}:{minute}" if hour else "")

    @property
    def is_usable(self) -> bool:
        """Whether causes could be looked for."""
        return self.verdict not in ("failed", "log_unusable")

    @property
    def causes(self) -> tuple[Finding, ...]:
        """What is named or ambiguous, beyond the standard terms of every arm."""
        return tuple(x for x in self.findings if x.status in CLAIMS and x.group != "standard")

    @property
    def standard(self) -> str:
        """The standard terms that are named, with their joints: 'Coulomb friction (joint_2, joint_3)'; "" for none."""
        joints: dict[str, list[str]] = {}
        for x in self.findings:
            if x.status in CLAIMS and x.group == "standard":
                joints.setdefault(words(x.effect), []).extend([x.joint] if x.joint else [])
        return "; ".join(name + (f" ({', '.join(some)})" if some else "") for name, some in joints.items())


@dataclass(frozen=True)
class Change:
    """What differs between a log and the one before it, of the same robot."""

    robot: str
    since: Diagnosed
    before: Diagnosed
    text: str


def by_robot(logs: Iterable[Diagnosed]) -> dict[str, list[Diagnosed]]:
    """The logs of each robot in time: by the dates in their names if all have one, else in the order of the jobs."""
    found: dict[str, list[Diagnosed]] = {}
    for one in sorted(logs, key=lambda x: x.number):
        found.setdefault(one.robot, []).append(one)
    return {robot: sorted(x, key=lambda y: y.date) if all(y.date for y in x) else x for robot, x in found.items()}


def changes(logs: Sequence[Diagnosed]) -> list[Change]:
    """What has changed from each usable log of one robot to the next, in time.

    A cause that the earlier log could not have shown, or the later one, is no change. Sizes differ where their 95 %
    intervals do not meet. A standard term (every arm has friction) that only one log proves is a change if the other
    log's size of it differs so, or if that log has no such term and leaves less torque than it makes.
    """
    usable = [one for one in logs if one.is_usable]
    found: list[Change] = []
    for before, after in itertools.pairwise(usable):
        for text in (
            *_come(before, after), *_gone(before, after), *_resized(before, after), *_terms(before, after),
        ):  # fmt: skip
            found.append(Change(after.robot, after, before, text))
    return found


def _come(before: Diagnosed, after: Diagnosed) -> Iterator[str]:
    for one in after.causes:
        if not _holds(before, one):
            yield f"new: {_told(one)}" + _unless_hidden(before, one)


def _gone(before: Diagnosed, after: Diagnosed) -> Iterator[str]:
    for one in before.causes:
        if not _holds(after, one) and not _hides(after, one):
            yield f"no longer found: {_told(one)}"


def _resized(before: Diagnosed, after: Diagnosed) -> Iterator[str]:
    earlier = {(x.effect, x.joint): x for x in before.findings if x.status == "named"}
    for one in after.findings:
        other = earlier.get((one.effect, one.joint))
        if one.status != "named" or other is None:
            continue
        for name, now in one.parameters.items():
            was = other.parameters.get(name)
            if was is not None and _apart(was, now):
                where = f" of {one.joint}" if one.joint else ""
                sizes = f"{quantity_text(was, interval=False)} to {quantity_text(now, interval=False)}"
                yield f"{words(one.effect)}{where}: {name.replace('_', ' ')} from {sizes}"


def _terms(before: Diagnosed, after: Diagnosed) -> Iterator[str]:
    """The standard terms that one of both logs proves, and the other one does without or has in another size."""
    for one, log, other in [(x, after, before) for x in after.findings] + [(x, before, after) for x in before.findings]:
        if one.status != "named" or one.group != "standard" or _holds(other, one) or _hides(other, one):
            continue
        was, size, *others = other.terms.get((one.effect, one.joint)), *one.parameters.values()
        if was is not None:
            if _apart(was, size):
                first, last = (was, size) if log is after else (size, was)
                sizes = f"{quantity_text(first, interval=False)} to {quantity_text(last, interval=False)}"
                yield f"{words(one.effect)} of {one.joint} from {sizes}"
        elif other.errors.get(one.joint or "", math.inf) < one.evidence.get(TORQUE, {}).get(one.joint, 0.0):
            own = "" if others else f", {quantity_text(size, interval=False)}"  # of a link, there are several
            yield f"{'new' if log is after else 'no longer found'}: {_told(one)}{own}"


def _apart(one: Quantity, other: Quantity) -> bool:
    """Whether two numbers have intervals that do not overlap."""
    bounds = []
    for x in (one, other):
        numbers = x.interval95 if isinstance(x.interval95, list | tuple) and len(x.interval95) == 2 else ()
        if isinstance(x.value, bool) or not isinstance(x.value, int | float) or not numbers:
            return False
        if not all(isinstance(bound, int | float) for bound in numbers):
            return False
        bounds.append(numbers)
    return one.unit == other.unit and (bounds[0][1] < bounds[1][0] or bounds[1][1] < bounds[0][0])


def _holds(log: Diagnosed, finding: Finding) -> bool:
    """Whether the log has this cause on this joint, or cannot distinguish it from one that it has."""
    sets = {(finding.effect,), *finding.alternatives}
    return any(
        x.joint == finding.joint and sets & {(x.effect,), *x.alternatives} for x in log.findings if x.status in CLAIMS
    )


def _hides(log: Diagnosed, finding: Finding) -> bool:
    """Whether the log could not have shown it."""
    return any(
        x.effect == finding.effect and x.joint in (finding.joint, None) for x in log.findings if x.status in UNSEEN
    )


def _unless_hidden(before: Diagnosed, finding: Finding) -> str:
    return f" (not detectable in the log before, {before.log})" if _hides(before, finding) else ""


def _told(finding: Finding) -> str:
    return f"{cause(finding)} on {finding.joint}" if finding.joint else cause(finding)


def fleet_table(logs: Sequence[Diagnosed]) -> Table:
    """A line per log: robot, log, verdict, causes, or why it failed."""
    shown = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for head in ("robot", "log", "verdict", "causes"):
        shown.add_column(head, overflow="fold")
    for robot, some in by_robot(logs).items():
        for one in some:
            style = STATUS_STYLE["failed"] if one.verdict == "failed" else ""
            verdict = Text(one.verdict.replace("_", " "), style)
            told = one.message or "; ".join(filter(None, (*map(_told, one.causes), one.standard))) or "-"
            shown.add_row(Text(robot or "-"), Text(one.log), verdict, Text(told))
    return shown


def change_lines(logs: Sequence[Diagnosed]) -> list[str]:
    """A sentence such as 'arm, since b.h5 (a.h5 before): new: payload'."""
    every = (change for some in by_robot(logs).values() for change in changes(some))
    return [f"{x.robot or '-'}, since {x.since.log} ({x.before.log} before): {x.text}" for x in every]


def fleet_csv(logs: Sequence[Diagnosed]) -> str:
    """A row per cause of every log; one without a cause, or that failed, has a row of its own."""
    rows: list[tuple[str, ...]] = [
        ("robot", "log", "date", "verdict", "effect", "joint", "status", "message", "folder")
    ]
    for one in logs:
        head = (one.robot, one.log, one.date, one.verdict)
        for finding in one.causes or (None,):
            about = (finding.effect, finding.joint or "", finding.status) if finding else ("", "", "")
            rows.append((*head, *about, one.message, one.folder))
    return csv_text(rows)


def page(logs: Sequence[Diagnosed]) -> str:
    """The page: what has changed, then every robot's logs in time with their causes and a link to each report."""
    robots = by_robot(logs)
    failed = sum(one.verdict == "failed" for one in logs)
    known = sum(robot != "" for robot in robots)
    count = f"{len(logs)} log{'s' * (len(logs) != 1)} of {known} robot{'s' * (known != 1)}"
    lead = f'<p class="lead">{count}{f", {failed} of them not diagnosed" if failed else ""}.</p>'
    changed = [change for some in robots.values() for change in changes(some)]
    body = "".join(row(*map(escape, (x.robot or "-", x.since.log, x.before.log, capital(x.text)))) for x in changed)
    told = table(("robot", "since", "log before", "what has changed"), body) if changed else "<p>Nothing.</p>"
    note = (
        '<p class="note">Each log is diagnosed by itself, and diagnoses are compared. A size has changed where its '
        "95 % intervals do not meet. More sensitive: diagnose the later log with data.reference= the earlier one.</p>"
    )
    parts = [section("What has changed", told + note)]
    for robot, some in robots.items():
        dated = all(one.date for one in some)
        order = "by the dates in their names" if dated else "in the order in which they were given"
        rows = "".join(map(_row, some))
        parts.append(
            section(
                robot or "Robot not known",
                f'<p class="note">Logs {order}.</p>' + table(("log", "verdict", "causes", "report"), rows),
            )
        )
    return document("Diagnoses of a fleet", lead + "".join(parts), STYLE)


STYLE = """
@media (min-width: 40rem) { table.words td:first-child { white-space: nowrap; } } """


def _row(one: Diagnosed) -> str:
    told = [*map(_headline, one.causes), *filter(None, [capital(one.standard), one.message])]
    causes = "<br>".join(map(escape, told)) or ("none" if one.is_usable else "not looked for")
    link = f'<a href="{escape(one.folder, quote=True)}/report.html">report</a>' if one.verdict != "failed" else ""
    verdict = escape(one.verdict.replace("_", " "))
    verdict = f'<b class="worst">{verdict}</b>' if one.verdict == "failed" else verdict
    return row(escape(one.log), verdict, causes, link)


def _headline(finding: Finding) -> str:
    where = f"{finding.joint}: " if finding.joint else ""
    return where + capital(headline_of(finding)) + (" (ambiguous)" if finding.status == "ambiguous" else "")
