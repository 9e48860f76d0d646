"""Links of the standard model's posterior: bodies, as likely as bodies can be."""

import numpy as np
import pytest

from invdyn_cli.maths.links import bodies
from invdyn_cli.maths.pseudo_inertia import is_realisable
from invdyn_cli.maths.standard import link_scales


def posterior(robot, share, further=3, seed=0):
    """A covariance (p, p) of all links' parameters, off by `share` of their scales, and some other coefficients."""
    draw = np.random.default_rng(seed)
    std = np.concatenate([share * link_scales(robot).ravel(), np.ones(further)])
    mixed = np.eye(len(std)) + 0.1 * draw.normal(size=(len(std), len(std)))
    return std[:, None] * (mixed @ mixed.T) * std, draw


def test_links_that_are_bodies_stay(apollo4):
    """A small change of the URDF's links, which are bodies, comes back digit for digit."""
    covariance, draw = posterior(apollo4, 0.01)
    theta = np.concatenate([0.001 * link_scales(apollo4).ravel(), draw.normal(size=3)])
    assert bodies(apollo4, theta, covariance) is theta


@pytest.mark.parametrize("seed", range(3))
def test_the_nearest_bodies(apollo4, seed):
    """Links with negative inertia become bodies, and no bodies near them are likelier: the misfit grows in every
    direction that stays among bodies."""
    covariance, draw = posterior(apollo4, 0.3, seed=seed)
    theta = np.concatenate([-1.2 * link_scales(apollo4).ravel() * draw.uniform(0, 1, 40), draw.normal(size=3)])
    found = bodies(apollo4, theta, covariance)
    rows = apollo4.inertial + found[:40].reshape(-1, 10)
    assert not all(is_realisable(row) for row in apollo4.inertial + theta[:40].reshape(-1, 10))
    assert all(is_realisable(row) for row in rows)
    information = np.linalg.inv(covariance)

    def misfit(x):
        return (x - theta) @ information @ (x - theta)

    for _ in range(50):
        aside = found + np.concatenate([0.02 * link_scales(apollo4).ravel(), np.full(3, 0.05)]) * draw.normal(size=43)
        if all(is_realisable(row) for row in apollo4.inertial + aside[:40].reshape(-1, 10)):
            assert misfit(aside) > misfit(found) - 0.1  # 0.1: the pull that keeps bodies inside the cone
