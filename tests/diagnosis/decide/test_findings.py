"""What a learner still predicts casts doubt on names."""

from dataclasses import replace

import numpy as np
import pytest

from invdyn_cli.diagnosis.decide.findings import LATE_UNKNOWN, MOSTLY_UNKNOWN, UNKNOWN, UNKNOWN_FIRST, gain_of, in_doubt
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.types import Finding, Gain
from tests.diagnosis.analytic import evidence_of, log_of, moved, raw


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


def test_rest_is_no_gain_and_no_loss():
    """Residuals of 2 and 1 N m while a joint moves: its gain is that, whatever they are while it rests."""
    evidence = evidence_of(log_of(raw(*moved(20.0), torque=0.02, position=1e-5)), ())
    resting = np.arange(len(evidence.role)) % 3 == 0
    evidence = replace(evidence, valid=evidence.valid & ~resting[:, None])
    before, after = (np.where(evidence.valid, x, y) for x, y in ((2.0, 5.0), (1.0, 50.0)))
    gain = gain_of(evidence, 0, before, after)
    assert gain is not None and (gain.rmse_before, gain.rmse_after) == pytest.approx((2.0, 1.0))
