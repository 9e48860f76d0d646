"""What a finding is worth."""

from dataclasses import replace

import numpy as np
import pytest

from invdyn_cli.diagnosis.decide.findings import gain_of
from tests.diagnosis.analytic import evidence_of, log_of, moved, raw


def test_rest_is_no_gain_and_no_loss():
    """Residuals of 2 and 1 N m while a joint moves: its gain is that, whatever they are while it rests."""
    evidence = evidence_of(log_of(raw(*moved(20.0), torque=0.02, position=1e-5)), ())
    resting = np.arange(len(evidence.role)) % 3 == 0
    evidence = replace(evidence, valid=evidence.valid & ~resting[:, None])
    before, after = (np.where(evidence.valid, x, y) for x, y in ((2.0, 5.0), (1.0, 50.0)))
    gain = gain_of(evidence, 0, before, after)
    assert gain is not None and (gain.rmse_before, gain.rmse_after) == pytest.approx((2.0, 1.0))
