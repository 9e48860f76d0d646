"""What several tests of a diagnosis share."""

import pytest

from tests.diagnosis.analytic import evidence_of, log_of, moved, raw


@pytest.fixture(scope="session")
def evidence():
    """A clean log of 40 s; its last 30 % are held out."""
    return evidence_of(log_of(raw(*moved())), ["viscous_friction"], cutoffs=(10.0,))
