"""Effects on a joint's torque: the linear form that the search uses is the formula that stands in the model."""

import jax.numpy as jnp
import numpy as np
import pytest

from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.interfaces import AbstractTorqueEffect, JointState
from tests.effects.drawn import joint_state, named, parameters

NAMES = named(AbstractTorqueEffect)


@pytest.mark.parametrize("name", NAMES)
def test_columns_make_the_term(name):
    """The term lies in the span of the columns at its own nonlinear parameters, to rounding, and `read` gives its
    parameters back from the coefficients: both forms are one formula."""
    effect = EFFECTS[name]
    for seed in range(10):
        draw = np.random.default_rng(seed)
        state, given = joint_state(draw), parameters(name, draw)
        shape = {k: given[k] for k in effect.nonlinear}
        columns = np.stack(effect.basis(state, shape))
        coefficients, *_ = np.linalg.lstsq(columns.T, effect.term(given, state))
        np.testing.assert_allclose(columns.T @ coefficients, effect.term(given, state), atol=1e-9)
        told = effect.read([float(x) for x in coefficients], shape)
        assert set(told) == set(effect.parameters)
        np.testing.assert_allclose([told[k] for k in given], list(given.values()), rtol=1e-7)


@pytest.mark.parametrize("name", NAMES)
def test_shapes_are_complete(name):
    """Every trial gives a value, within its bounds, to just the nonlinear parameters; a ripple's come from a scan."""
    effect = EFFECTS[name]
    shapes = effect.shapes(joint_state(np.random.default_rng(0)))
    assert len(shapes) > 0 or name == "torque_ripple"
    for shape in shapes:
        assert set(shape) == set(effect.nonlinear)
        assert all(effect.parameters[k].lower <= v <= effect.parameters[k].upper for k, v in shape.items())


@pytest.mark.parametrize("name", NAMES)
def test_numpy_and_jax_agree(name):
    """Term and columns are the same of either arrays, to rounding, and jax arrays stay jax arrays."""
    effect, draw = EFFECTS[name], np.random.default_rng(0)
    state, given = joint_state(draw), parameters(name, draw)
    there = JointState(*(jnp.asarray(x) for x in state))
    term = effect.term(given, there)
    assert isinstance(effect.term(given, state), np.ndarray) and isinstance(term, jnp.ndarray)
    np.testing.assert_allclose(term, effect.term(given, state), rtol=1e-12)
    shape = {k: given[k] for k in effect.nonlinear}
    for x, y in zip(effect.basis(there, shape), effect.basis(state, shape), strict=True):
        assert isinstance(x, jnp.ndarray)
        np.testing.assert_allclose(x, y, rtol=1e-12, atol=1e-300)


@pytest.mark.parametrize("name", [n for n in NAMES if n.endswith("friction") or n.startswith("thermal")])
def test_friction_takes_power(name):
    """Friction acts against the motion: logged torque times velocity is never negative."""
    effect, draw = EFFECTS[name], np.random.default_rng(1)
    state = joint_state(draw)
    state = state._replace(sign=np.sign(state.qd))
    assert np.all(effect.term(parameters(name, draw), state) * state.qd >= 0)
