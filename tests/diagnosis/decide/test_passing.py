"""What comes and goes is in doubt where two such effects may be one that nobody knows."""

from dataclasses import replace

import pytest

from invdyn_cli.diagnosis.decide.passing import doubted
from invdyn_cli.types import Finding, Gain

ENDS = {"one": (0.0, 40.0), "two": (0.0, 40.0)}


def felt(by: float) -> Gain:
    """A joint whose error falls from 1 by this much."""
    return Gain(1.0, 1.0 - by, 0.1, 0.03, (0.4, 0.6))


@pytest.mark.parametrize(
    ("other", "open_ones"),
    [
        ({"window": (5.0, 8.0)}, True),
        ({"window": (9.5, 12.0)}, False),
        ({"window": (5.0, 8.0), "joint": "b"}, False),
        ({"window": (5.0, 8.0), "effect": "external_contact"}, False),
        ({"window": (5.0, 8.0), "trajectory": "two"}, False),
        ({"window": None}, False),
    ],
)
def test_two_of_one_kind_at_once_may_be_unknown(other, open_ones):
    """A gain that changes while it is changed already, on the same joint, is the shape of something else; one after the
    other, elsewhere, or of different kinds they may both be true."""
    one = Finding("torque_gain_change", "a", "named", window=(4.0, 9.0), trajectory="one")
    found = doubted([one, replace(one, **other)], ENDS)
    assert [f.status for f in found] == ["ambiguous" if open_ones else "named"] * 2
    assert all((("unknown",) in f.alternatives) == open_ones for f in found)


def test_contacts_and_gains_of_one_joint_alone_are_in_doubt():
    """A contact that one joint feels, another making its prediction worse, and a gain of that joint that changes at
    another time are the shape of something else, as of a torque at one posture. What a second joint feels, what is of
    one effect, or what lasts, is not."""
    pushed = Finding("external_contact", "b", "named", window=(4.0, 9.0), trajectory="one")
    pushed = replace(pushed, gain={"a": felt(0.5), "b": felt(-0.1)})
    weaker = replace(pushed, effect="torque_gain_change", joint="a", window=(12.0, 13.0), gain={"a": felt(0.3)})
    assert [f.status for f in doubted([pushed, weaker], ENDS)] == ["ambiguous"] * 2
    both = replace(pushed, gain={"a": felt(0.5), "b": felt(0.1)})
    lasting = replace(weaker, window=None, trajectory=None)
    for other in (both, lasting, replace(weaker, window=(20.0, 22.0))):
        assert [f.status for f in doubted([other, weaker], ENDS)] == ["named"] * 2


@pytest.mark.parametrize(
    ("moment", "strength", "load", "gain"),
    [
        (25.0, 0.2, "named", "ambiguous"),  # the gain ends when the load comes, and does less
        (25.0, 0.8, "ambiguous", "named"),
        (27.0, 0.2, "named", "named"),  # two seconds apart they are two
    ],
)
def test_what_begins_when_another_ends_may_be_a_part_of_it(moment, strength, load, gain):
    """An encoder that jumps at 25 s is like a load that comes then and a gain that goes: the weaker one is in doubt,
    and neither if they are of different moments. Both may begin with the trajectory, or end with it."""
    comes = Finding("payload_change", None, "named", window=(25.1, 40.0), trajectory="one", gain={"a": felt(0.5)})
    goes = Finding(
        "torque_gain_change", "a", "named", window=(0.0, moment), trajectory="one", gain={"b": felt(strength)}
    )
    assert [f.status for f in doubted([comes, goes], ENDS)] == [load, gain]
    both = {"a": felt(0.5), "b": felt(0.5)}
    from_start = replace(goes, effect="external_contact", window=(0.0, 11.0), gain=both)
    assert [f.status for f in doubted([goes, from_start], ENDS)] == ["named"] * 2
