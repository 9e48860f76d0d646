"""What an effect explains in a window, with all that lasts fitted anew, as a least-squares fit of each window does."""

from itertools import product

import numpy as np
import pytest

from invdyn_cli.diagnosis.search.shared_part import columns_of, precision_of
from invdyn_cli.diagnosis.search.windowed import Lasting, Windowed, best_windows
from tests.diagnosis.analytic import evidence_of, log_of, moved, raw


def test_gains_are_those_of_a_fit_for_each_window():
    rng = np.random.default_rng(5)
    log = log_of(raw(*moved(8.0, 100.0, 1), lambda t, m: m.qd * [2.0, 0.5, 1.0], torque=0.02, seed=1))
    evidence = evidence_of(log, ("viscous_friction", "torque_offset"))
    lasting, left = tuple(evidence.candidates), evidence.tau + rng.normal(size=evidence.tau.shape)
    used = rng.uniform(0.5, 1.0, evidence.tau.shape)
    columns, precision = rng.normal(size=(2, 3, len(evidence.tau))), np.array([0.3, 0.7])
    beside = Lasting.beside(evidence, lasting, used)
    rows = np.arange(len(evidence.tau))
    windowed = Windowed(beside, columns, precision, left, beside.explained(left), rows)
    grid = np.array([0, 40, 200, 311, len(rows)])
    first, last = np.triu_indices(len(grid), 1)

    whole = [columns_of(lasting, j)[1:] for j in range(evidence.dofs)]
    prior = precision_of(lasting)
    stands = []
    for j, (free, place) in enumerate(whole):
        x = np.zeros((len(rows), len(prior)))
        x[:, place] = evidence.tables[j][:, free]
        stands.append(x * np.sqrt(used[:, j, None]))
    x, y = np.concatenate(stands), (left * np.sqrt(used)).T.ravel()

    def loss(x, y, prior):
        x, y = np.concatenate([x, np.diag(np.sqrt(prior))]), np.append(y, np.zeros(len(prior)))
        return float(np.sum((y - x @ np.linalg.lstsq(x, y)[0]) ** 2))

    expected = []
    for a, b in zip(grid[first], grid[last], strict=True):
        there = (rows >= a) & (rows < b)
        own = np.concatenate([(columns[:, j] * there * np.sqrt(used[:, j])).T for j in range(evidence.dofs)])
        expected.append(loss(x, y, prior) - loss(np.hstack([x, own]), y, np.append(prior, precision)))
    assert windowed.gains(grid, first, last) == pytest.approx(expected, rel=1e-6)
    each = np.array([windowed.between(a, b) for a, b in zip(grid[first], grid[last], strict=True)])
    assert windowed.gain(each) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("seed", range(20))
def test_no_windows_save_more(seed):
    """Of all ways to part eleven rows into windows that cost something each."""
    draw = np.random.default_rng(seed)
    saved, price = draw.normal(0.3, 2.0, 11), draw.uniform(0.5, 4.0)

    def worth(there: np.ndarray) -> float:
        return float(saved @ there - price * np.sum(np.diff(there, prepend=0) > 0))

    ways = np.array(list(product([0, 1], repeat=len(saved))))
    there = np.zeros(len(saved))
    for a, b in best_windows(saved, price):
        there[a:b] = 1
    assert worth(there) == pytest.approx(max(map(worth, ways)))
