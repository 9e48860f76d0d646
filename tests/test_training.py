"""The training loop itself: what a net depends on, how epochs are bitten off, where it starts."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from invdyn_cli import training

KEYS = jax.random.split(jax.random.key(0), 1)


def data(samples: int = 70) -> training.Data:
    x = np.random.default_rng(0).normal(size=(samples, 6))
    y = np.stack([np.sin(x[:, 0]), x[:, 1] * x[:, 2], x[:, 3]], axis=1)
    return training.Data(jnp.asarray(x, jnp.float32), jnp.asarray(y, jnp.float32))


def leaves(tree):
    return [np.asarray(x) for x in jax.tree.leaves(tree)]


def test_a_net_does_not_depend_on_its_neighbours():
    """The net of one column is the same to float32's rounding, trained alone or in a stack with others."""
    schedule = training.Schedule(2, 32)
    [stack] = training.train([training.Group((8,), (0, 1, 2), (0.01, 0.02, 0.03))], schedule, data(), None, KEYS)
    [alone] = training.train([training.Group((8,), (1,), (0.02,))], schedule, data(), None, KEYS)
    for a, b in zip(leaves(stack.params), leaves(alone.params), strict=True):
        np.testing.assert_allclose(a[:, 1:2], b, rtol=2e-4, atol=2e-5)
    assert np.isnan(alone.validation_loss).all() and alone.train_loss.shape == (2, 1, 1)


@pytest.mark.parametrize("epochs", [1, 7, 19, 20, 21, 39, 100, 1000])
def test_bites_are_all_epochs_in_few_shapes(epochs):
    """Bites add up to the epochs; there are at most about twenty, of at most two sizes, each of which compiles once."""
    bites = training._bites(epochs)
    assert sum(bites) == epochs and len(set(bites)) <= 2 and len(bites) <= 20


def test_bites_do_not_change_the_training():
    """Forty epochs, told in twenty bites, go on where the last bite stopped: the loss curve has no step back, and its
    first two epochs are those of a training of two."""
    group = training.Group((8,), (0,), (0.01,))
    [long] = training.train([group], training.Schedule(40, 32), data(), None, KEYS)
    [short] = training.train([group], training.Schedule(2, 32), data(), None, KEYS)
    np.testing.assert_allclose(long.train_loss[:2], short.train_loss, rtol=1e-4)
    assert long.train_loss.shape == (40, 1, 1) and long.train_loss[-1] < 0.5 * long.train_loss[0]


def test_shuffles_use_every_row_once_an_epoch():
    """With weights that stand still (a vanishing rate) and batches that divide the rows, the mean loss of an epoch is
    the loss over all rows, however they are shuffled."""
    group = training.Group((8,), (0,), (1e-12,))
    [one] = training.train([group], training.Schedule(3, 35), data(), data(), KEYS)
    np.testing.assert_allclose(one.train_loss, one.validation_loss, rtol=1e-5)


def test_progress_is_that_of_all_groups():
    """Two groups, side by side or one after the other, report shares that never fall and end at 1, with the mean
    loss in words."""
    groups = [training.Group((8,), (0,), (0.01,)), training.Group((8, 8), (1,), (0.01,))]
    seen = []
    training.train(groups, training.Schedule(4, 32), data(), None, KEYS, lambda share, note: seen.append((share, note)))
    shares = [share for share, _ in seen]
    assert shares == sorted(shares) and shares[-1] == 1.0 and seen[-1][1].startswith("loss ")
