"""Lines of a residual over a joint's angle."""

import numpy as np

from invdyn_cli.maths import ripple


def test_many_cycles_at_once_are_as_each_alone():
    rng = np.random.default_rng(3)
    q, qd, residual = np.cumsum(rng.normal(0, 0.02, 900)), rng.normal(0, 2, 900), rng.normal(size=900)
    cycles = ripple.grid(q)
    together = ripple.power(residual, q, cycles, qd, cutoff=8.0)
    alone = [ripple.power(residual, q, cycles[k : k + 1], qd, cutoff=8.0)[0] for k in range(len(cycles))]
    np.testing.assert_allclose(together, alone, rtol=1e-9)  # 63 products of numbers with 16 digits


def test_the_cycles_of_a_hidden_line_and_its_share_are_found():
    rng = np.random.default_rng(4)
    q = 2.5 * np.sin(np.linspace(0, 40, 4000))
    residual = 0.3 * np.sin(37.4 * q + 1.0) + rng.normal(0, 0.3, q.size)
    cycles, share = ripple.strongest(residual, q)
    assert abs(cycles - 37.4) < 0.05
    assert abs(share - 1 / 3) < 0.05  # half the squared amplitude beside a variance of 0.09
