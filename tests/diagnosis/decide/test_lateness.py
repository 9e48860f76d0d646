"""Delays of single joints that are perhaps one delay of all torques."""

import pytest

from invdyn_cli.diagnosis.decide import lateness
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.types import Check, Examination, Finding, Quantity


def late(joint: str, delay: float, reach: float, **more) -> Finding:
    """A torque delay of a joint with its interval."""
    size = Quantity(delay, "s", [delay - reach, delay + reach])
    return Finding("torque_delay", joint, "named", parameters={"delay": size}, **more)


@pytest.mark.parametrize(
    ("delays", "said"),
    [((-0.0197, -0.0194), True), ((0.0197, 0.0194), True), ((0.0197, 0.030), False), ((0.0197, -0.0194), False)],
)
def test_delays_that_agree_have_a_cause_in_common(delays, said):
    """Two delays with one value in both intervals are told together, with the way in which they are late."""
    notes = lateness.note_of([late(f"j{k}", x, 0.001) for k, x in enumerate(delays)], EFFECTS)
    assert bool(notes) is said
    assert not said or ("logged" if delays[0] < 0 else "delivered") in notes[0]


def test_one_delay_is_of_its_drive():
    """Nothing is said of one joint, nor of an effect that is never late, nor of what this log cannot show."""
    unseen = [Finding("torque_delay", f"j{k}", "not_excited") for k in (2, 3)]
    other = Finding("torque_offset", "j1", "named", parameters={"offset": Quantity(0.02, "N m", [0.01, 0.03])})
    assert lateness.note_of([late("j0", 0.02, 0.001), other, *unseen], EFFECTS) == ()


@pytest.mark.parametrize(("delay", "status"), [(-0.0055, "ambiguous"), (-0.012, "named"), (0.0055, "named")])
def test_a_delay_that_takes_back_a_shift_is_in_doubt(delay, status):
    """All torques were moved by 5.6 ms, and one joint's delay says the opposite: one of both is wrong. Other delays are
    what they are."""
    found = Finding("torque_delay", "axis2", "named", parameters={"delay": Quantity(delay, "s", [delay, delay])})
    shifted = Examination(True, (Check("time_offset", "warn", value=-0.0056),), {})
    (told,) = lateness.taken_back([found], EFFECTS, shifted)
    assert told.status == status
    assert ("correct=false" in told.advice) == (status == "ambiguous")
