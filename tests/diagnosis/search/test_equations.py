"""Normal equations with columns that some rows do not have: of a joint that rests where the others move."""

import numpy as np
import pytest

from invdyn_cli.diagnosis.search import equations


@pytest.mark.parametrize("precision", [0.0, 1e-3])
def test_a_column_without_rows_changes_nothing(precision):
    """Its coefficient is zero, and those of the others are as without it; the inverse is finite. The
    column's own precision of 1e-9 multiplies rounding, of 1e-16, in the product of its root."""
    rng = np.random.default_rng(4)
    x, y = rng.normal(size=(50, 3)), rng.normal(size=50)
    wide = np.insert(x, 1, 0.0, axis=1)
    normal, moment, prior = wide.T @ wide, wide.T @ y, np.array([0.0, precision, 0.0, 0.0])
    alone = np.linalg.lstsq(x, y, rcond=None)[0]
    for theta in (equations.solved(normal, moment, prior), equations.inverted(normal, prior) @ moment):
        np.testing.assert_allclose(theta, np.insert(alone, 1, 0.0), rtol=1e-6, atol=1e-12)
    root = equations.inverse_root(normal, prior)
    assert np.isfinite(equations.inverted(normal, prior)).all()
    np.testing.assert_allclose(root @ root.T @ moment, np.insert(alone, 1, 0.0), rtol=1e-6, atol=1e-6)
