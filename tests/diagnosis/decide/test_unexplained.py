"""What a learner can still predict: nothing of noise, most of what an unknown cause makes; it casts doubt on names."""

import numpy as np
import pytest

from invdyn_cli.diagnosis.decide.doubt import BEYOND
from invdyn_cli.diagnosis.decide.unexplained import (
    LATE_UNKNOWN,
    MOSTLY_UNKNOWN,
    UNKNOWN,
    in_doubt,
    shares,
)
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.types import Finding, Gain


def angle(evidence, joint: int) -> np.ndarray:
    """(R,) its rows' angles."""
    kept = [evidence.recording.filter.rows(len(p.t)) for p in evidence.recording.pieces]
    return np.concatenate([p.q[joint, rows] for p, rows in zip(evidence.recording.pieces, kept, strict=True)])


def test_noise_and_an_unknown_cause(evidence):
    """White noise: below 5 %; a smooth function of the angle above it: more than half; nothing at all: 0."""
    noise = np.random.default_rng(0).normal(size=evidence.tau.shape)
    residual = noise * np.array([1.0, 0.3, 0.0])
    residual[:, 1] += np.sin(4 * angle(evidence, 1))
    found = shares(evidence, residual, None, 0)
    assert found[0] < 0.05 and found[1] > 0.5 and found[2] == 0.0
    assert np.array_equal(found, shares(evidence, residual, None, 0))


def test_what_is_tiny_does_not_count(evidence):
    """A smooth rest of a ten-thousandth of the torque explains no robot: below 2 %."""
    residual = np.zeros_like(evidence.tau)
    residual[:, 1] = 1e-4 * np.sqrt(np.mean(evidence.tau[:, 1] ** 2)) * np.sin(4 * angle(evidence, 1))
    assert shares(evidence, residual, None, 0)[1] < 0.02


def claimed(effect: str, left: float) -> Finding:
    """A named effect on axis1 that brings 1 N m of error down to what is `left`."""
    return Finding(effect, "axis1", "named", gain={"axis1": Gain(1.0, left, 1.0, left**2, (0.0, 1.0))})


@pytest.mark.parametrize(
    ("effect", "learned", "times"),
    [
        ("coulomb_friction", UNKNOWN - 0.1, BEYOND),
        ("coulomb_friction", UNKNOWN + 0.1, MOSTLY_UNKNOWN),
        ("actuator_lag", UNKNOWN - 0.1, BEYOND),
        ("actuator_lag", UNKNOWN + 0.1, LATE_UNKNOWN),
        ("torque_delay", UNKNOWN + 0.1, LATE_UNKNOWN),
        ("link_inertia_error", UNKNOWN + 0.1, LATE_UNKNOWN),
    ],
)
def test_a_name_must_outweigh_what_has_none(effect, learned, times):
    """An effect that saves a tenth more than so many times what is still predicted is named, with a tenth less it is
    not. The factor is larger where a learner predicts most of the residual, and largest for a delay or a lag."""
    for factor, status in ((1.1, "named"), (0.9, "ambiguous")):
        left = (1 + factor * times * learned) ** -0.5
        (found,) = in_doubt([claimed(effect, left)], EFFECTS, {"axis1": learned})
        assert found.status == status
        assert found.alternatives == ((("unknown",),) if status == "ambiguous" else ())


def test_noise_alone_casts_no_doubt():
    """Where a learner finds nothing, the least gain keeps its name."""
    (found,) = in_doubt([claimed("actuator_lag", 0.999)], EFFECTS, {"axis1": 0.0})
    assert found.status == "named"
