"""Long sessions: what one log leaves in the process is gone when the next is diagnosed."""

import weakref

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from invdyn_cli import leftovers


@pytest.mark.parametrize(("share", "left"), [(0.0, 0), (1.0, 1)])
def test_compiled_programs_are_dropped_where_they_are_many(monkeypatch, share, left):
    """Above the share of memory maps nothing compiled is left, so that the process does not run out of them; below it,
    everything is."""
    double = jax.jit(lambda x: 2 * x)
    double(jnp.ones(3))
    monkeypatch.setattr(leftovers, "SHARE", share)
    leftovers.drop_programs()
    assert double._cache_size() == left
    assert float(double(jnp.ones(3))[0]) == 2.0


class Table:
    """Refers to itself, as an evidence and the functions that it keeps do."""

    def __init__(self) -> None:
        self.rows, self.kept = np.ones(1000), [self]


def test_tables_that_refer_to_themselves_are_freed():
    """They would stay until Python happens to look for them."""
    seen = weakref.ref(Table())
    leftovers.free_memory()
    assert seen() is None
