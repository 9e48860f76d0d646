"""NMSE and RMSE: numbers done by hand, and what a score must not depend on."""

import numpy as np
import pytest

from invdyn_cli.maths.metrics import nmse, rmse
from invdyn_cli.types import Score

TARGET = np.array([[1.0, 10.0], [3.0, 10.0], [5.0, 16.0]])
SAID = np.array([[1.0, 10.0], [3.0, 10.0], [8.0, 10.0]])


def test_by_hand():
    """Joint 1: errors 0, 0, 3 and variance 8/3; joint 2: errors 0, 0, 6 and variance 8."""
    np.testing.assert_allclose(rmse(TARGET, SAID), [np.sqrt(3), np.sqrt(12)])
    np.testing.assert_allclose(nmse(TARGET, SAID), [9 / 8, 3 / 2])


def test_perfect_and_mean_predictions():
    """The truth has NMSE 0, the target's mean has NMSE 1."""
    np.testing.assert_array_equal(nmse(TARGET, TARGET), 0)
    np.testing.assert_allclose(nmse(TARGET, np.tile(TARGET.mean(0), (3, 1))), 1)


def test_nmse_has_no_unit_and_no_zero():
    """Another unit and another zero of the torque change the RMSE by the unit, the NMSE not at all."""
    np.testing.assert_allclose(nmse(1000 * TARGET + 7, 1000 * SAID + 7), nmse(TARGET, SAID))
    np.testing.assert_allclose(rmse(1000 * TARGET + 7, 1000 * SAID + 7), 1000 * rmse(TARGET, SAID))


def test_a_torque_that_never_changes_has_no_nmse():
    """NaN without a warning for that joint alone, and the mean is taken over the others."""
    target = TARGET * [1, 0]
    score = Score(("a", "b"), nmse(target, SAID), rmse(target, SAID))
    assert np.isnan(score.nmse[1]) and score.mean("nmse") == pytest.approx(9 / 8)
    assert score.mean("rmse") == pytest.approx((np.sqrt(3) + np.sqrt((100 + 100 + 100) / 3)) / 2)


def test_score_as_plain_data():
    """A score becomes the mapping of metrics.json: mean and joints by name."""
    plain = Score(("a", "b"), nmse(TARGET, SAID), rmse(TARGET, SAID)).as_dict()
    assert plain["nmse"] == {"mean": pytest.approx(21 / 16), "joint": {"a": pytest.approx(9 / 8), "b": 1.5}}
    assert set(plain) == {"nmse", "rmse"}
