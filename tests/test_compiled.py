"""Long sessions: what was compiled is dropped before it takes up all memory maps of the process."""

import jax
import jax.numpy as jnp
import pytest

from invdyn_cli import compiled


@pytest.mark.parametrize(("share", "left"), [(0.0, 0), (1.0, 1)])
def test_compiled_programs_are_dropped_where_they_are_many(monkeypatch, share, left):
    """Above the share of maps nothing compiled is left; below it, everything is."""
    double = jax.jit(lambda x: 2 * x)
    double(jnp.ones(3))
    monkeypatch.setattr(compiled, "SHARE", share)
    compiled.drop_many()
    assert double._cache_size() == left
    assert float(double(jnp.ones(3))[0]) == 2.0
