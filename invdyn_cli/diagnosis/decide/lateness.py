"""Delays of single joints that are perhaps one delay of all torques."""

from collections.abc import Mapping, Sequence

import numpy as np

from invdyn_cli.diagnosis.checks.offset import TimeOffset
from invdyn_cli.diagnosis.decide import doubt
from invdyn_cli.interfaces import AbstractEffect
from invdyn_cli.types import Examination, Finding, Quantity

TAKEN_BACK = 0.25
"""Share of a shift of all torques by which a joint's delay that takes it back may differ from it."""

NOT_SHIFTED = (
    "The torques keep the times of the log. A check suggested to shift all of them in time, but after that shift at "
    "least half of the joints had a delay of the same size, which undoes it."
)


def taken_back(
    found: Sequence[Finding], effects: Mapping[str, AbstractEffect], examination: Examination
) -> tuple[Finding, ...]:
    """The findings; a delay that takes back the shift by which the torques of all joints were corrected is ambiguous:
    other joints may have told that shift by what they have beside it."""
    advice = "diagnose the log with correct=false: this delay undoes the correction that shifted all torques in time"
    return tuple(
        doubt.or_else(one, doubt.UNKNOWN, advice=advice)
        if one.status == "named" and _takes_back(one, effects, examination)
        else one
        for one in found
    )


def shifted_wrongly(
    found: Sequence[Finding], effects: Mapping[str, AbstractEffect], examination: Examination, joints: int
) -> bool:
    """Whether the delays of half of the joints, and of two at least, take back the shift of all torques: what the arm
    has beside its nominal model, a payload say, had told that shift."""
    claimed = [f for f in found if f.status in ("named", "ambiguous") and f.window is None]
    back = {f.joint for f in claimed if _takes_back(f, effects, examination)}
    return len(back) >= max(2, joints / 2)


def _takes_back(one: Finding, effects: Mapping[str, AbstractEffect], examination: Examination) -> bool:
    """Whether it is a delay as large as the shift by which all torques were corrected."""
    checks = [c for c in examination.checks if c.check == TimeOffset.name and c.joint is None]
    shifts = [float(c.value) for c in checks if c.severity in ("warn", "fail") and c.value is not None]
    delay = one.parameters.get(effects[one.effect].late_by)
    return delay is not None and any(abs(delay.value - shift) < TAKEN_BACK * abs(shift) for shift in shifts)


def note_of(found: Sequence[Finding], effects: Mapping[str, AbstractEffect]) -> tuple[str, ...]:
    """That the delays, or the lags, of several joints agree within their intervals, if they do: then one cause is
    likelier than several."""
    said = []
    for effect in (e for e in effects.values() if e.late_by):
        own = [f for f in found if f.effect == effect.name and effect.late_by in f.parameters and f.window is None]
        late = [f.parameters[effect.late_by] for f in own]
        if len(own) > 1 and _agree(late):
            middle = 1e3 * np.mean([x.value for x in late])
            which = "logged" if middle < 0 else "delivered"
            said.append(
                f"The torques of {', '.join(str(f.joint) for f in own)} are {which} {abs(middle):.3g} ms late, all "
                "alike: suspect what they have in common (the logger, a filter, the bus) rather than each drive."
            )
    return tuple(said)


def _agree(late: Sequence[Quantity]) -> bool:
    """Whether there is a value in all of the intervals."""
    ends = [x.interval95 for x in late if x.interval95 is not None]
    return len(ends) == len(late) and max(x[0] for x in ends) < min(x[1] for x in ends)
