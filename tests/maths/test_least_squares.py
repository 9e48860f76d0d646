"""Least squares by triangles against numpy on all rows at once, and the strength that is chosen."""

import numpy as np
import pytest

from invdyn_cli.maths.least_squares import STRENGTHS, solve, triangle


def drawn(rows: int, columns: int, targets: int = 1, seed: int = 0, noise: float = 0.1):
    """Columns of very different lengths, one of them twice, and targets with noise."""
    draw = np.random.default_rng(seed)
    x = draw.normal(size=(rows, columns)) * 10.0 ** draw.uniform(-3, 3, columns)
    x[:, -1] = x[:, 0]
    theta = draw.normal(size=(columns, targets)) / np.linalg.norm(x, axis=0)[:, None]
    return x, x @ theta + noise * draw.normal(size=(rows, targets)) / np.sqrt(rows)


def parts(x, y, sizes):
    """(triangle, rows) of consecutive rows, in blocks of 7."""
    out, at = [], 0
    for size in sizes:
        rows = np.concatenate([x, y], axis=1)[at : at + size]
        out.append((triangle(rows[k : k + 7] for k in range(0, size, 7)), size))
        at += size
    return out


def test_a_triangle_stands_for_its_rows():
    """R'R is the rows' Gram matrix, however they were parted; fewer rows than columns are kept as they are."""
    rows = np.random.default_rng(0).normal(size=(100, 8))
    for size in (3, 8, 40, 100):
        r = triangle(rows[k : k + size] for k in range(0, 100, size))
        assert r.shape == (8, 8)
        np.testing.assert_allclose(r.T @ r, rows.T @ rows, atol=1e-12)
    assert triangle([rows[:3]]).shape == (3, 8)


def test_plain_least_squares_are_numpys():
    """lstsq is the solution of smallest norm that numpy finds for all rows with columns at length 1."""
    x, y = drawn(120, 9, targets=2)
    length = np.linalg.norm(x, axis=0)
    expected = np.linalg.lstsq(x / length, y)[0] / length[:, None]
    found = solve(parts(x, y, (50, 70)), 2, "lstsq")
    assert found.rank == 8
    np.testing.assert_allclose(found.theta, expected, rtol=1e-8, atol=1e-10 * np.abs(expected).max())


def test_precision_is_not_squared():
    """Columns whose condition number is 1e10 give a prediction to 1e-10; a Gram matrix would leave nothing of them."""
    draw = np.random.default_rng(1)
    u, v = np.linalg.qr(draw.normal(size=(200, 10)))[0], np.linalg.qr(draw.normal(size=(10, 10)))[0]
    x = u * np.geomspace(1, 1e-10, 10) @ v.T
    y = x @ draw.normal(size=(10, 1))
    found = solve(parts(x, y, (200,)), 1, "lstsq")
    assert np.abs(x @ found.theta - y).max() < 1e-10 * np.abs(y).max()


def test_ridge_solves_its_normal_equations():
    """(X'X + strength s^2 I) theta = X'y for columns at length 1, s the largest singular value."""
    x, y = drawn(80, 6)
    length = np.linalg.norm(x, axis=0)
    scaled = x / length
    damping = 1e-3 * np.linalg.norm(scaled, 2) ** 2
    expected = np.linalg.solve(scaled.T @ scaled + damping * np.eye(6), scaled.T @ y) / length[:, None]
    np.testing.assert_allclose(solve(parts(x, y, (30, 50)), 1, "ridge", 1e-3).theta, expected, rtol=1e-8)


@pytest.mark.parametrize("noise", [1e-6, 10.0])
@pytest.mark.parametrize("solver", ["ridge", "tsvd"])
def test_the_strength_predicts_each_group_best(solver, noise):
    """The strength in use is the one that leaves least, on average, on groups that were left out, each of which was
    solved for again without it."""
    x, y = drawn(90, 30, noise=noise)
    groups, left = parts(x, y, (30, 30, 30)), np.zeros(len(STRENGTHS[solver]))
    for k in range(3):
        own = slice(30 * k, 30 * k + 30)
        for s, strength in enumerate(STRENGTHS[solver]):
            theta = solve(groups[:k] + groups[k + 1 :], 1, solver, float(strength)).theta
            left[s] += np.mean((x[own] @ theta - y[own]) ** 2) / 3
    found = solve(groups, 1, solver)
    np.testing.assert_allclose(found.left_out[:, 0], left, rtol=1e-6)
    chosen = left[STRENGTHS[solver] == found.strength[0]]  # the weakest ones leave the same, but for rounding
    assert chosen <= left.min() * (1 + 1e-6)
