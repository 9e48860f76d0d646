"""The standard model against dense algebra: stacked rows, a multivariate normal, a general optimiser."""

import numpy as np
import pytest
from scipy import optimize, stats

from invdyn_cli.maths import standard
from invdyn_cli.maths.standard import SHARES, Prior, Sums


def sums(x: np.ndarray, y: np.ndarray) -> Sums:
    """Of rows x (n, T, p) and torques y (n, T)."""
    table = np.concatenate([x, y[..., None]], axis=-1)
    return Sums(np.einsum("jta,jtb->jab", table, table), np.full(len(y), y.shape[1]))


def drawn(rng, joints=2, rows=80, p=6, share=0.1, noise=(0.3, 0.05)):
    """A motion: rows, torques, and the coefficients behind them; the first four are inertial, of scale 1."""
    theta = np.concatenate([share * rng.normal(size=4), rng.normal(size=p - 4)])
    x = rng.normal(size=(joints, rows, p)) * rng.uniform(0.2, 2, p)
    return x, theta, np.array(noise[:joints])[:, None]


def prior(p=6, **positive) -> Prior:
    scale = np.r_[np.ones(4), np.full(p - 4, 3.0)]
    mask = np.zeros(p, bool)
    mask[list(positive.get("positive", ()))] = True
    return Prior(scale, np.arange(p) < 4, mask, np.zeros(p))


def test_the_posterior_is_that_of_stacked_rows():
    """Coefficients and covariance are those of dense least squares on rows over their noise, a row for each prior."""
    rng = np.random.default_rng(1)
    x, theta, noise = drawn(rng)
    y = x @ theta + noise * rng.normal(size=x.shape[:2])
    times, known = np.array([3.0, 1.5]), prior()
    found = standard.fit([sums(x, y)], known, times, 0.1)
    weight = 1 / (found.noise * np.sqrt(times))
    rows = np.concatenate([*(w * part for w, part in zip(weight, x, strict=True)), np.diag(1 / known.at(0.1))])
    right = np.concatenate([*(w * part for w, part in zip(weight, y, strict=True)), np.zeros(6)])
    dense = np.linalg.lstsq(rows, right, rcond=None)[0]
    np.testing.assert_allclose(found.theta, dense, rtol=2e-3, atol=1e-5)  # the noise is iterated to 1e-3
    np.testing.assert_allclose(found.covariance, np.linalg.inv(rows.T @ rows), rtol=5e-3, atol=1e-9)
    np.testing.assert_allclose(found.noise, noise[:, 0], rtol=0.25)  # 80 rows: 8 %, three of them


@pytest.mark.parametrize("share", [0.01, 0.1, 1.0])
def test_the_evidence_is_a_marginal_likelihood(share):
    """Log evidence is the density of the torques under N(0, noise + columns prior columns'), but for a constant."""
    rng = np.random.default_rng(2)
    x, theta, noise = drawn(rng, joints=1)
    y = x @ theta + noise * rng.normal(size=x.shape[:2])
    one, known = sums(x, y), prior()
    got = standard.evidence(one, known, np.ones(1), share)
    sigma = standard.fit([one], known, np.ones(1), share).noise[0]
    columns = x[0] * known.at(share)
    covariance = sigma**2 * np.eye(len(y[0])) + columns @ columns.T
    whole = stats.multivariate_normal(cov=covariance).logpdf(y[0])
    assert got == pytest.approx(whole + len(y[0]) / 2 * (np.log(2 * np.pi) + 1), abs=0.05)


@pytest.mark.parametrize("seed", range(5))
def test_noise_asks_for_nothing(seed):
    """Torques that are noise have more evidence for the nominal model; those of columns have less."""
    rng = np.random.default_rng(seed)
    x, theta, noise = drawn(rng)
    hiss = noise * rng.normal(size=x.shape[:2])
    gains = [standard.fit([sums(x, y)], prior(), np.ones(2), 0.1).gain for y in (hiss, x @ theta + hiss)]
    assert gains[0] < 0 < gains[1]


def test_bounds_are_those_of_a_general_optimiser():
    """Where friction would be negative it is zero, and all else is what is then likeliest."""
    rng = np.random.default_rng(3)
    x, theta, noise = drawn(rng)
    x[:, :, 4] += 0.5 * x[:, :, 5]
    theta[4], theta[5] = -0.5, 1.0
    y = x @ theta + noise * rng.normal(size=x.shape[:2])
    known, times = prior(positive=(4, 5)), np.ones(2)
    found = standard.fit([sums(x, y)], known, times, 0.1)

    def cost(theta):
        left = (y - x @ theta) / found.noise[:, None]
        return np.sum(left**2) + np.sum((theta / known.at(0.1)) ** 2)

    bounds = [(0 if positive else None, None) for positive in known.positive]
    other = optimize.minimize(cost, np.full(6, 0.1), bounds=bounds, method="L-BFGS-B", options={"maxiter": 5000})
    assert found.theta[4] == 0 and cost(found.theta) <= other.fun * (1 + 1e-6)


@pytest.mark.parametrize(
    ("motions", "true", "allowed"),
    [(1, 0.0, SHARES[:2]), (4, 0.0, SHARES[:3]), (1, 0.1, SHARES[2:5]), (4, 0.1, SHARES[2:])],
)
def test_the_share_is_learned(motions, true, allowed):
    """From one motion and from several: a right URDF is left alone, one that is 10 % off is corrected; ten draws each,
    nine of which must do (four coefficients say little of their spread). Where motions are plenty a wide prior predicts
    as well as the right one, and may be chosen."""
    right = 0
    for seed in range(10):
        rng = np.random.default_rng([4, seed])
        x, theta, noise = drawn(rng, share=true, noise=(0.05, 0.05))
        made = []
        for _ in range(motions):
            x = rng.normal(size=x.shape) * rng.uniform(0.2, 2, x.shape[-1])
            made.append(sums(x, x @ theta + noise * rng.normal(size=x.shape[:2])))
        found = standard.fit(made, prior(), np.ones(2))
        assert found.chosen == ("evidence" if motions == 1 else "left out")
        right += found.share in allowed
    assert right >= 9


def test_repeats_are_one_motion():
    """The same path twice, a little off, is one motion; another draw is another."""
    rng = np.random.default_rng(5)
    x, theta, _ = drawn(rng, rows=2000)
    again = x + 0.01 * rng.normal(size=x.shape)
    other = x @ np.diag(rng.uniform(0.5, 2, 6)) + x[..., ::-1]
    y = [part @ theta for part in (x, again, other)]
    found = standard.distinct([sums(x, y[0]), sums(other, y[2]), sums(again, y[1])])
    assert len(found) == 2 and found[0].rows[0] == 4000


def test_a_line_is_least_squares_of_each_joint():
    """Coefficients of some columns, without a prior; a column that is zero has none."""
    rng = np.random.default_rng(6)
    x, theta, _ = drawn(rng)
    x[:, :, 5] = 0
    y = x @ theta + rng.normal(size=x.shape[:2])
    got = standard.line([sums(x[:1], y[:1])], np.array([0, 0, 0, 1, 1, 1], bool))
    np.testing.assert_allclose(got[3:5], np.linalg.lstsq(x[0][:, 3:5], y[0], rcond=None)[0], rtol=1e-8)
    assert not got[[0, 1, 2, 5]].any()


def test_bounds_hold_beside_a_column_without_rows():
    """A joint that rests on all rows has no coefficient: the bounded ones are those of the model without it."""
    rng = np.random.default_rng(11)
    x, theta, noise = drawn(rng)
    y = x @ theta + noise * rng.normal(size=x.shape[:2])
    known = prior(positive=(4, 5))
    found = standard.fit([sums(x, y)], known, np.ones(2), 0.1)
    moved = np.r_[found.theta[:4], -0.2, found.theta[5]]
    wide = Prior(*(np.insert(part, 4, zero) for part, zero in zip(vars(known).values(), (0.0, 0, 0, 0.0), strict=True)))
    covariance = np.insert(np.insert(found.covariance, 4, 0.0, axis=0), 4, 0.0, axis=1)
    got = standard.within(wide, np.insert(moved, 4, 0.0), covariance)
    np.testing.assert_allclose(np.delete(got, 4), standard.within(known, moved, found.covariance), atol=1e-12)
    assert got[4] == 0 and got[5] == 0
