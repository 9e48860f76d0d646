"""What a learner can still predict: nothing of noise, most of what an unknown cause makes."""

import numpy as np
import pytest

from invdyn_cli.diagnosis.decide.unexplained import shares
from tests.diagnosis.analytic import evidence_of, log_of, moved, raw


@pytest.fixture(scope="module")
def evidence():
    """A clean log."""
    return evidence_of(log_of(raw(*moved())), ["viscous_friction"], cutoffs=(10.0,))


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
