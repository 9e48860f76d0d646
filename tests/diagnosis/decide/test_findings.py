"""What a learner still predicts casts doubt on names."""

import pytest

from invdyn_cli.diagnosis.decide.findings import LATE_UNKNOWN, MOSTLY_UNKNOWN, UNKNOWN, UNKNOWN_FIRST, in_doubt
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.types import Finding, Gain


def claimed(effect: str, left: float) -> Finding:
    """A named effect on axis1 that brings 1 N m of error down to what is `left`."""
    return Finding(effect, "axis1", "named", gain={"axis1": Gain(1.0, left, 1.0, left**2, (0.0, 1.0))})


@pytest.mark.parametrize(
    ("effect", "learned", "times"),
    [
        ("coulomb_friction", UNKNOWN - 0.1, UNKNOWN_FIRST),
        ("coulomb_friction", UNKNOWN + 0.1, MOSTLY_UNKNOWN),
        ("actuator_lag", UNKNOWN - 0.1, UNKNOWN_FIRST),
        ("actuator_lag", UNKNOWN + 0.1, LATE_UNKNOWN),
        ("torque_delay", UNKNOWN + 0.1, LATE_UNKNOWN),
    ],
)
def test_a_name_must_outweigh_what_has_none(effect, learned, times):
    """Of an effect that saves so many times what is still predicted, a tenth more is enough and a tenth less is not;
    more is asked for where most of what is left is no noise, and most of what is like many others."""
    for factor, status in ((1.1, "named"), (0.9, "ambiguous")):
        left = (1 + factor * times * learned) ** -0.5
        (found,) = in_doubt([claimed(effect, left)], EFFECTS, {"axis1": learned})
        assert found.status == status
        assert found.alternatives == ((("unknown",),) if status == "ambiguous" else ())


def test_noise_alone_casts_no_doubt():
    """Where a learner finds nothing, the least gain keeps its name."""
    (found,) = in_doubt([claimed("actuator_lag", 0.999)], EFFECTS, {"axis1": 0.0})
    assert found.status == "named"
