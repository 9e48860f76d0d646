"""Delays of single joints that are perhaps one delay of all torques."""

from types import SimpleNamespace
from typing import Any

import pytest

from invdyn_cli.diagnosis import pipeline
from invdyn_cli.diagnosis.checks.commands import CommandLag
from invdyn_cli.diagnosis.checks.offset import TimeOffset
from invdyn_cli.diagnosis.decide import lateness
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.types import Check, Diagnosis, Examination, Finding, Quantity


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


@pytest.mark.parametrize(
    ("delays", "joints", "wrongly"),
    [
        ((-0.0055, -0.0058, -0.0056), 6, True),
        ((-0.0055, -0.0058), 6, False),
        ((-0.0055,), 1, False),
        ((0.0055, 0.0056), 3, False),
        ((-0.0055, -0.0056), 3, True),
    ],
)
def test_half_of_the_joints_say_that_all_were_shifted_wrongly(delays, joints, wrongly):
    """All torques were moved by 5.6 ms: where half of the joints, two at least, are late by as much, the shift was
    wrong; delays of a few joints, or the other way, do not tell that."""
    shifted = Examination(True, (Check("time_offset", "warn", value=-0.0056),), {})
    found = [late(f"j{k}", x, 0.001) for k, x in enumerate(delays)]
    assert lateness.shifted_wrongly(found, EFFECTS, shifted, joints) is wrongly
    sound = Examination(True, (Check("time_offset", "ok", value=-0.0056),), {})
    assert not lateness.shifted_wrongly(found, EFFECTS, sound, joints)


def test_after_a_wrong_shift_the_log_is_asked_again_without_it(monkeypatch):
    """The second answer is given, with a note, where the first takes back the shift; else the first one is."""
    log: Any = None
    robot: Any = SimpleNamespace(dofs=2)

    def answered(*given):
        assert any(isinstance(check, CommandLag) for check in given[-1])  # of the same name, and not in question
        shifts = any(isinstance(check, TimeOffset) for check in given[-1])
        checks = (Check("time_offset", "warn", value=-0.0056),) if shifts else ()
        found = tuple(late(f"j{k}", delay, 0.001) for k in range(2)) if shifts else ()
        return Diagnosis("explained", Examination(True, checks, {}), found, {}, {}, None, {})

    monkeypatch.setattr(pipeline, "prepared", answered)
    delay = -0.0055
    again = pipeline.diagnose(log, robot)
    assert again.findings == () and again.notes == (lateness.NOT_SHIFTED,)
    delay = 0.02
    first = pipeline.diagnose(log, robot)
    assert len(first.findings) == 2 and first.notes == ()
