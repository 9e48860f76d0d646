"""One-joint functions: what they span, and their slopes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from invdyn_cli.maths.bezier import BASES, functions

ALPHA = 0.8


@pytest.mark.parametrize("degree", [1, 2])
def test_both_bases_span_the_trigonometric_polynomials(degree):
    """Every Bézier function is a combination of 1, cos x, sin x, ... to rounding, as many as there are of those; at the
    half turn, where the curve's parameter is infinite, too."""
    x = np.linspace(-np.pi, np.pi, 60)
    trig, bezier = (np.asarray(functions(basis, degree, x, ALPHA)[0]) for basis in BASES)
    waves = np.stack([np.ones_like(x), *(f(k * x) for k in range(1, degree + 1) for f in (np.cos, np.sin))])
    np.testing.assert_allclose(trig, waves, atol=1e-15)
    factors, *_ = np.linalg.lstsq(waves.T, bezier.T)
    np.testing.assert_allclose(waves.T @ factors, bezier.T, atol=1e-12 * np.abs(bezier).max())
    assert np.linalg.matrix_rank(bezier) == 2 * degree + 1


def test_the_bezier_form_is_the_rational_curve():
    """With tan(x / 2) = (2 t - 1) tan(alpha / 2), the functions are the Bernstein polynomials of t over the curve's
    denominator cos^2(alpha / 2) / cos^2(x / 2), but for factors that x does not change."""
    x = np.linspace(-0.7, 0.7, 40)
    t = (1 + np.tan(x / 2) / np.tan(ALPHA / 2)) / 2
    denominator = np.cos(ALPHA / 2) ** 2 / np.cos(x / 2) ** 2
    bernstein = np.stack([(1 - t) ** 2, 2 * t * (1 - t), t**2]) / denominator
    ratio = np.asarray(functions("bezier", 1, x, ALPHA)[0]) / bernstein
    np.testing.assert_allclose(ratio, ratio[:, :1] * np.ones(len(x)), rtol=1e-12)


@pytest.mark.parametrize("basis", BASES)
@pytest.mark.parametrize("degree", [1, 2])
def test_slopes_are_derivatives(basis, degree):
    """Slopes agree with automatic differentiation of the values."""
    x = jnp.linspace(-3, 3, 31)
    values, slopes = functions(basis, degree, x, ALPHA)
    _, tangent = jax.jvp(lambda y: functions(basis, degree, y, ALPHA)[0], (x,), (jnp.ones_like(x),))
    assert values.shape == slopes.shape == (2 * degree + 1, 31)
    np.testing.assert_allclose(slopes, tangent, atol=1e-11 * float(jnp.abs(tangent).max()))


def test_the_bezier_form_is_better_conditioned_on_an_arc():
    """Over half a circle its degree-2 columns, at length 1, have less than a fifth of the condition number of the
    trigonometric ones; over a full circle more than those."""

    def condition(basis, half, alpha):
        x = np.linspace(-half, half, 400)
        columns = np.asarray(functions(basis, 2, x, alpha)[0])
        return np.linalg.cond(columns / np.linalg.norm(columns, axis=1, keepdims=True))

    arc = 0.65 * np.pi / 2
    assert condition("bezier", np.pi / 2, arc) < 0.2 * condition("trig", np.pi / 2, arc)
    assert condition("trig", np.pi, np.pi / 2) < condition("bezier", np.pi, np.pi / 2)
