"""The checks of a log: whether it is sound, what can be corrected, and what it excites.

Checks run one after the other, each on the log as corrected by those before it: torques are checked when the clock and
the units are right.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from invdyn_cli.diagnosis.checks.channels import CommandCopiesMeasurement, NotMoving, Quantisation
from invdyn_cli.diagnosis.checks.clock import ClockJitter, Duplicates, Gaps, TooShort
from invdyn_cli.diagnosis.checks.columns import JointOrder, SignError
from invdyn_cli.diagnosis.checks.commands import CommandLag, CommandSigns, CommandUnits
from invdyn_cli.diagnosis.checks.derivatives import DerivativeConsistency
from invdyn_cli.diagnosis.checks.description import OTHERWISE_MOUNTED, Description
from invdyn_cli.diagnosis.checks.excitation import Excitation
from invdyn_cli.diagnosis.checks.held_rows import HeldRows
from invdyn_cli.diagnosis.checks.model import ModelMismatch
from invdyn_cli.diagnosis.checks.offset import TimeOffset
from invdyn_cli.diagnosis.checks.power import PowerOff
from invdyn_cli.diagnosis.checks.saturation import Saturation
from invdyn_cli.diagnosis.checks.stamps import IrregularStamps
from invdyn_cli.diagnosis.checks.torque_units import TorqueUnits
from invdyn_cli.diagnosis.checks.torques import GravityRemoved
from invdyn_cli.diagnosis.checks.turns import WrappedAngles
from invdyn_cli.diagnosis.checks.units import MotionUnits
from invdyn_cli.diagnosis.checks.values import NotFinite, Outliers
from invdyn_cli.errors import LogError, RobotError, listed
from invdyn_cli.interfaces import AbstractCheck
from invdyn_cli.log import POSITION_SIDES, TORQUE_SIDES, Log
from invdyn_cli.logfile import refuse_defects
from invdyn_cli.types import Check, Examination, Robot

CHECKS: tuple[AbstractCheck, ...] = (
    NotFinite(),
    HeldRows(),
    Duplicates(),
    WrappedAngles(),
    MotionUnits(),
    IrregularStamps(),
    ClockJitter(),
    Gaps(),
    Outliers(),
    DerivativeConsistency(),
    CommandUnits(),
    CommandSigns(),
    CommandLag(),
    TooShort(),
    NotMoving(),
    Quantisation(),
    PowerOff(),
    GravityRemoved(),
    JointOrder(),
    SignError(),
    GravityRemoved(again=True),
    TorqueUnits(),
    Saturation(),
    TimeOffset(),
    CommandCopiesMeasurement(),
    ModelMismatch(),
    Description(),
)
"""The checks in their order: what is readable, the clock, the motion, then the torque."""

SEVERITIES = ("ok", "skipped", "note", "warn", "fail")
"""ok: examined, nothing found; skipped: not examined, `seen` says why; note: useful to know; warn: it reduces accuracy;
fail: the log must be corrected before it is diagnosed."""

FAULT = "a fault of invdyn, not of the log"


def examine(log: Log, robot: Robot | None, checks: Sequence[AbstractCheck] = CHECKS) -> Examination:
    """What there is to say of a log; without a robot, what can be told without one.

    `usable` is true if no failure remains after correction, and the corrected log can be computed with.

    Raises:
        RobotError: if the robot has another number of joints than the log.
    """
    return correct(log, robot, checks)[1]


def correct(
    log: Log,
    robot: Robot | None,
    checks: Sequence[AbstractCheck] = CHECKS,
    follow: Callable[[Log, Sequence[Check]], None] | None = None,
    change: bool = True,
) -> tuple[Log, Examination]:
    """The log with every certain defect corrected and hopeless trajectories left out, and what there is to say of it.

    The corrected log passes `logfile.refuse_defects` where the examination calls it usable. `follow` is told every
    check's findings, and the log that it saw. Where `change` is False the log stays as recorded.

    Raises:
        RobotError: if the robot has another number of joints than the log.
    """
    _refuse_other(log, robot)
    found: list[Check] = []
    hopeless = False
    log, notes = _worded(log) if change else (log, [])
    corrections = [{"check": "header", "done": note} for note in notes]
    with np.errstate(all="ignore"):
        for check in checks:
            seen = _asked(check, log, robot)
            found += seen if seen or check.again else [Check(check.name, "ok", seen="nothing seen")]
            mine = _correctable(seen)
            if follow is not None:
                follow(log, mine)
            failed = any(one.severity == "fail" for one in seen)
            if change:
                corrected, notes = check.correct(log, mine, robot)
                log = corrected if notes else log  # the same object as long as nothing changes: see `once_for_a_log`
                corrections += [{"check": check.name, "done": note} for note in notes]
            hopeless |= failed and (not change or any(one.severity == "fail" for one in _asked(check, log, robot)))
        try:
            refuse_defects(log, "the corrected log" if change else "the log")
        except LogError as error:
            found.append(_unreadable(error))
            hopeless = True
        usable = not hopeless and bool(log.trajectories)
        excitation = Excitation().measure(log, robot) if log.trajectories and (change or usable) else {}
    return log, Examination(usable, _ordered(found), excitation, tuple(corrections), not change)


def done(examination: Examination) -> tuple[str, ...]:
    """A sentence for every correction."""
    return tuple(one["done"] for one in examination.corrections)


def doubts(examination: Examination) -> tuple[str, ...]:
    """A sentence for what no correction heals, and without which a diagnosis is of another arm: its mounting."""
    found = (x for x in examination.checks if x.meaning == OTHERWISE_MOUNTED)
    return tuple(f"{x.seen[:1].upper()}{x.seen[1:]}: {x.meaning}; try {x.advice}." for x in found)


def _asked(check: AbstractCheck, log: Log, robot: Robot | None) -> list[Check]:
    """The findings of a check; if a numerical failure ends it, a finding that says so."""
    try:
        return check.examine(log, robot)
    except (ArithmeticError, ValueError, IndexError, np.linalg.LinAlgError) as error:
        said = f"{type(check).__name__} could not be made: {type(error).__name__}: {error}"
        return [Check(check.name, "skipped", seen=said, meaning=FAULT)]


def _correctable(found: Sequence[Check]) -> list[Check]:
    """The findings that a check may correct: its own, except those about a failure of the check."""
    return [one for one in found if one.meaning != FAULT and one.severity not in ("ok", "skipped")]


def _ordered(found: Sequence[Check]) -> tuple[Check, ...]:
    """The most severe findings first; "nothing seen" once per check, and only if nothing was found."""
    told = {one.check for one in found if one.severity not in ("ok", "skipped")}
    lines = []
    for one in found:
        if one.severity == "ok" and one.value is None:
            if one.check in told:
                continue
            told.add(one.check)
        lines.append(one)
    return tuple(sorted(lines, key=lambda one: -SEVERITIES.index(one.severity)))


def _worded(log: Log) -> tuple[Log, list[str]]:
    """The log with unknown words in its header replaced by unknown, and obvious spellings corrected."""
    notes = []
    for word, allowed in (("torque_side", TORQUE_SIDES), ("position_side", POSITION_SIDES)):
        if getattr(log, word) not in allowed:
            notes.append(f"{word} {getattr(log, word)!r} is taken for unknown; allowed: {listed(allowed)}")
            log = replace(log, **{word: "unknown"})
    if log.torque_unit in ("Nm", "N.m", "N*m", "Newton meter"):
        notes.append(f"torque_unit {log.torque_unit!r} is taken for 'N m'")
        log = replace(log, torque_unit="N m")
    return log, notes


def _unreadable(error: LogError) -> Check:
    return Check(
        "not_finite",
        "fail",
        seen=error.got,
        meaning="what remains cannot be used",
        advice=error.advice,
        source="arithmetic",
    )


def _refuse_other(log: Log, robot: Robot | None) -> None:
    if robot is not None and robot.dofs != len(log.joints):
        got = f"robot {robot.name!r} moves {robot.dofs} joints, the log has {len(log.joints)}"
        raise RobotError(f"{got}: {listed(log.joints)}", advice="a URDF of the logged robot")
