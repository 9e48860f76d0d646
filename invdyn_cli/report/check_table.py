"""Lines of an examination as a table: severity, check, place, what was seen, what to do."""

from collections.abc import Iterable
from html import escape

from invdyn_cli.report.html import table
from invdyn_cli.report.wording import capital
from invdyn_cli.types import Check

SEVERITIES = {"fail": "fails", "warn": "warning"}
"""Severities that are called differently."""

PILLS = """
.pill { display: inline-block; padding: 0 .55rem; border-radius: 1rem; font-size: .82rem; border: 1px solid;
  white-space: nowrap; color: #0072b2; } .pill.ambiguous, .pill.warn { color: #b35a00; }
.pill.not_excited, .pill.not_observable, .pill.note { color: var(--soft); } .pill.fail { color: #c2410c;
  border-width: 2px; font-weight: 600; }
@media (prefers-color-scheme: dark) { .pill { color: #6cc0f5; } .pill.ambiguous, .pill.warn { color: #f2a65a; }
  .pill.fail { color: #ff8a5c; } }
"""


def check_table(checks: Iterable[Check]) -> str:
    """A row per line of check.json; nothing without any."""
    body = "".join(_row(x) for x in checks)
    return table(("", "check", "where", "what was seen", "what to do"), body) if body else ""


def skipped_reasons(checks: Iterable[Check]) -> dict[str, dict[str, None]]:
    """Why checks were skipped -> their names."""
    reasons: dict[str, dict[str, None]] = {}
    for x in checks:
        if x.severity == "skipped":
            reasons.setdefault(x.seen, {})[x.check] = None
    return reasons


def pill(kind: str, said: str = "") -> str:
    """A word, else the kind itself, in a frame with the colour of the kind."""
    return f'<span class="pill {escape(kind)}">{escape(said or kind.replace("_", " "))}</span>'


def _row(check: Check) -> str:
    where = ", ".join(x for x in (check.trajectory, check.joint) if x) or "everywhere"
    meaning = f"<small>{escape(capital(check.meaning))}</small>" if check.meaning else ""
    return (
        f"<tr><td>{pill(check.severity, SEVERITIES.get(check.severity, ''))}</td>"
        f'<td class="whole">{escape(check.check.replace("_", " "))}</td><td>{escape(where)}</td>'
        f"<td>{escape(capital(check.seen))}{meaning}</td><td>{escape(capital(check.advice))}</td></tr>"
    )
