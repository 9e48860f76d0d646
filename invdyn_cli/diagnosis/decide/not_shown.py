"""What a log could not have shown: effects that may or may not be present."""

from collections.abc import Mapping, Sequence

from invdyn_cli.diagnosis.checks.excitation import cannot_show
from invdyn_cli.interfaces import AbstractEffect
from invdyn_cli.types import Examination, Finding


def unseen(
    effects: Mapping[str, AbstractEffect],
    claims: Sequence[Finding],
    examination: Examination,
    side: str,
    position_side: str,
) -> list[Finding]:
    """What this log could not have shown: no claims, but where not to look for absence."""
    claimed = {(f.effect, f.joint) for f in claims}
    out = [
        Finding(
            name,
            None,
            "not_observable",
            advice=f"a torque measured at the {' or '.join(s for s in e.sides if s != 'unknown')} side",
            evidence={"why": f"a torque measured at the {side} does not contain it"},
        )
        for name, e in effects.items()
        if side not in e.sides
    ]
    out += [
        Finding(
            name,
            None,
            "not_observable",
            advice="angles of the motor, or on both sides of the gear",
            evidence={"why": f"angles measured at the {position_side} do not contain it"},
        )
        for name, e in effects.items()
        if position_side not in e.position_sides and side in e.sides
    ]
    for joint, numbers in examination.excitation.items():
        for name, why in cannot_show(numbers.get("lacks", {}), effects).items():
            if (name, joint) in claimed or name in {f.effect for f in out if f.joint is None}:
                continue
            advice = effects[name].advice
            out.append(Finding(name, joint, "not_excited", evidence={"why": why}, advice=advice))
    return out
