"""What a body can have: against bodies made of points, another parametrisation, and the semidefinite program."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize

from invdyn_cli.maths import pseudo_inertia as pi

jax.config.update("jax_enable_x64", True)


@jax.jit
def from_log_cholesky(coordinates) -> jax.Array:
    """The row (10,) of log-Cholesky coordinates (alpha, d1, d2, d3, s12, s23, s13, t1, t2, t3), any ten numbers: their
    pseudo inertia U U' is positive definite (Rucker and Wensing, RA-L 2022, eq. 11); pure jax."""
    alpha, d1, d2, d3, s12, s23, s13, t1, t2, t3 = jnp.asarray(coordinates)
    zero, one = jnp.zeros_like(alpha), jnp.ones_like(alpha)
    upper = jnp.exp(alpha) * jnp.array(
        [[jnp.exp(d1), s12, s13, t1], [zero, jnp.exp(d2), s23, t2], [zero, zero, jnp.exp(d3), t3], [zero] * 3 + [one]]
    )
    p = upper @ upper.T
    inertia = jnp.trace(p[:3, :3]) * jnp.eye(3) - p[:3, :3]
    return jnp.concatenate([p[3, 3:], p[:3, 3], inertia[(0, 0, 1, 0, 1, 2), (0, 1, 1, 2, 2, 2)]])


def log_cholesky(row) -> np.ndarray:
    """Log-Cholesky coordinates (10,) of a row (10,) with a positive definite pseudo inertia."""
    u = np.linalg.cholesky(pi.pseudo_inertia(row)[::-1, ::-1])[::-1, ::-1]
    scaled = u / u[3, 3]
    diagonal = np.log(np.diag(scaled)[:3])
    return np.array([np.log(u[3, 3]), *diagonal, scaled[0, 1], scaled[1, 2], scaled[0, 2], *scaled[:3, 3]])


def body(draw: np.random.Generator, points: int = 20) -> np.ndarray:
    """The row (10,) of positive point masses, summed up by the definition of inertia."""
    masses, places = draw.uniform(0.05, 0.5, points), draw.normal(draw.uniform(-0.2, 0.2, 3), 0.05, (points, 3))
    inertia = sum(m * (r @ r * np.eye(3) - np.outer(r, r)) for m, r in zip(masses, places, strict=True))
    xx, yy, zz, xy, xz, yz = *np.diag(inertia), inertia[0, 1], inertia[0, 2], inertia[1, 2]
    return np.array([masses.sum(), *(masses @ places), xx, xy, yy, xz, yz, zz])


def anything(draw: np.random.Generator) -> np.ndarray:
    """A row of ten numbers of any sign and of sizes over eight decades."""
    return draw.normal(size=10) * 10 ** draw.uniform(-6, 2, 10)


def about_centre(row: np.ndarray) -> np.ndarray:
    """Inertia (3, 3) about the centre of mass, by Huygens and Steiner."""
    m, c = row[0], row[1:4] / row[0]
    xx, xy, yy, xz, yz, zz = row[4:]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) - m * (c @ c * np.eye(3) - np.outer(c, c))


def fit(draw: np.random.Generator, bodies: int, directions: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Realisable references (n, 10), wanted rows that none can have, and an information (10 n, 10 n) of this rank."""
    reference = np.array([body(draw) for _ in range(bodies)])
    wanted = reference * draw.uniform(-1.0, 2.0, reference.shape)
    slopes = draw.normal(size=(directions, 10 * bodies)) * 10 ** draw.uniform(0, 2, (directions, 1))
    return reference, wanted, slopes.T @ slopes


def rises(rows: np.ndarray, wanted: np.ndarray, information: np.ndarray) -> float:
    """(phi - wanted)' N (phi - wanted)."""
    away = np.ravel(rows - wanted)
    return float(away @ information @ away)


@pytest.mark.parametrize("seed", range(5))
def test_a_pseudo_inertia_and_back(seed):
    """Row, matrix, row: nothing is lost but rounding; and the matrix of a body is the sum of its points' x x'."""
    draw = np.random.default_rng(seed)
    row = anything(draw)
    np.testing.assert_allclose(pi.row_of(pi.pseudo_inertia(row)), row, atol=1e-14 * np.abs(row).max())
    mass, place = 0.7, draw.normal(size=3)
    x, y, z = place
    point = mass * np.array([1, x, y, z, y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y])
    np.testing.assert_allclose(pi.pseudo_inertia(point), mass * np.outer([*place, 1], [*place, 1]), atol=1e-14)


def test_a_ball_is_a_ball():
    """2/5 m r^2 about every axis of its centre, with the volume of its mass of water (Archimedes)."""
    row = pi.ball(2.0, np.array([0.1, -0.2, 0.3]))
    radius = (0.002 / (4 / 3 * np.pi)) ** (1 / 3)
    np.testing.assert_allclose(row[:4], [2.0, 0.2, -0.4, 0.6])
    np.testing.assert_allclose(about_centre(row), 0.4 * 2.0 * radius**2 * np.eye(3), atol=1e-12)


def test_realisable_is_what_bodies_have():
    """A row is called realisable where mass, inertia about the centre and its triangle inequality say so, and nowhere
    else: over bodies of points, moved by changes that make about half of them none."""
    draw, seen = np.random.default_rng(1), []
    for _ in range(300):
        row = body(draw) * draw.uniform(0.8, 1.2, 10)
        principal = np.linalg.eigvalsh(about_centre(row))
        expected = row[0] > 0 and principal[0] > 0 and principal[2] < principal[0] + principal[1]
        assert pi.is_realisable(row) == expected
        seen.append(expected)
    assert 30 < sum(seen) < 270  # else the test would say little


def test_whatever_goes_in_a_body_comes_out():
    """Rows of any sign and size, negative masses, zeros and planes among them, come out positive definite."""
    draw = np.random.default_rng(2)
    flat = body(draw, 3)
    rows = [anything(draw) for _ in range(300)] + [np.zeros(10), -body(draw), flat, -np.eye(10)[0], np.eye(10)[3]]
    for row in rows:
        pseudo = pi.pseudo_inertia(pi.realisable(row))
        np.linalg.cholesky(pseudo)
        assert pi.realisable(row)[0] > 0


def test_what_is_a_body_stays_as_it_is():
    """A body's row comes back to the last bit."""
    draw = np.random.default_rng(3)
    for _ in range(50):
        row = body(draw)
        np.testing.assert_array_equal(pi.realisable(row), row)


def test_units_and_axes_do_not_choose_the_nearest_body():
    """In grammes, and in a frame whose axes are turned, the nearest body is the same one."""
    draw = np.random.default_rng(4)
    turn = np.eye(4)
    turn[:3, :3] = np.linalg.qr(draw.normal(size=(3, 3)))[0]
    for _ in range(20):
        row = body(draw)
        row[4:] *= draw.uniform(-1, 1, 6)
        assert not pi.is_realisable(row)
        nearest = pi.realisable(row)
        np.testing.assert_allclose(pi.realisable(1e3 * row) / 1e3, nearest, rtol=1e-6, atol=1e-9)
        turned = pi.realisable(pi.row_of(turn @ pi.pseudo_inertia(row) @ turn.T))
        np.testing.assert_allclose(turn.T @ pi.pseudo_inertia(turned) @ turn, pi.pseudo_inertia(nearest), atol=1e-9)


def test_any_ten_numbers_are_a_body():
    """Log-Cholesky coordinates: any ten numbers give a positive definite pseudo inertia, and every body has its ten."""
    draw = np.random.default_rng(5)
    for _ in range(50):
        coordinates = draw.normal(size=10)
        row = np.asarray(from_log_cholesky(coordinates))
        assert pi.is_realisable(row)
        np.testing.assert_allclose(log_cholesky(row), coordinates, atol=1e-7)
        made = body(draw)
        np.testing.assert_allclose(from_log_cholesky(log_cholesky(made)), made, rtol=1e-9, atol=1e-12)


def objective(coordinates, reference, wanted, information, pull):
    """Misfit and pull of one body, of its log-Cholesky coordinates (10,); `reference` is a pseudo inertia."""
    row = from_log_cholesky(coordinates)
    ratio = jnp.linalg.solve(reference, _pseudo(row))
    away = row - wanted
    return away @ information @ away / 2 + pull * (jnp.trace(ratio) - jnp.linalg.slogdet(ratio)[1] - 4)


def test_the_fit_is_the_minimum():
    """In another parametrisation, log-Cholesky coordinates, steps within a trust region from elsewhere come to the same
    misfit and pull, no lower by 1e-6 of it, and within 1e-4, which is how far they come where the valley is narrow."""
    values, slopes, curves = (jax.jit(f) for f in (objective, jax.grad(objective), jax.hessian(objective)))
    for seed in range(4):
        (reference,), (wanted,), information = fit(np.random.default_rng(seed), 1, 4 + 2 * seed)
        information *= 1e-3
        found = pi.consistent(reference[None], wanted[None], information, 0.1)
        problem = pi.pseudo_inertia(reference), wanted, information, 0.1
        other = optimize.minimize(
            values, log_cholesky(1.1 * reference), problem, "trust-exact", slopes, curves, options={"maxiter": 500}
        )
        mine = float(values(log_cholesky(found.rows[0]), *problem))
        assert mine <= other.fun * (1 + 1e-6) and other.fun <= mine * (1 + 1e-4), seed
        assert found.cost == pytest.approx(rises(found.rows, wanted[None], information), rel=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_no_body_fits_better(seed):
    """Weak duality: where the slope of the misfit, as a matrix, is positive semidefinite but for the pull, no body at
    all fits better by more than what the pull is paid; it is here, and at most 1 % of a noise variance."""
    reference, wanted, information = fit(np.random.default_rng(seed), 2, 20)
    information *= 100 / pi.consistent(reference, wanted, information).cost  # else EXACT is what is asked for
    found = pi.consistent(reference, wanted, information)
    basis = np.array([pi.pseudo_inertia(unit) for unit in np.eye(10)]).reshape(10, 16)
    slope = (information @ np.ravel(found.rows - wanted)).reshape(-1, 10)
    paid = 0.0
    for g, row, r in zip(slope, found.rows, reference, strict=True):
        dual = (np.linalg.pinv(basis) @ g).reshape(4, 4) + pi.PULL * np.linalg.inv(pi.pseudo_inertia(r))
        symmetric = (dual + dual.T) / 2
        assert np.linalg.eigvalsh(symmetric)[0] > -1e-6 * np.abs(symmetric).max()
        paid += np.trace(symmetric @ pi.pseudo_inertia(row))
    assert 2 * paid < 0.02


def test_what_the_data_do_not_show_is_free():
    """Wanted rows that are no body, data that see six directions only: a body fits them as well, and costs nothing."""
    draw = np.random.default_rng(8)
    truth = body(draw)
    slopes = 1e3 * draw.normal(size=(6, 10))
    unseen = np.linalg.svd(slopes)[2][6:]
    wanted = truth + 10 * unseen.sum(0)
    assert not pi.is_realisable(wanted)
    found = pi.consistent(body(draw)[None], wanted[None], slopes.T @ slopes)
    assert pi.is_realisable(found.rows[0]) and found.cost < 1e-4


def test_where_nothing_is_seen_the_reference_stays():
    """Without information, rows are the reference's."""
    draw = np.random.default_rng(9)
    reference = np.array([body(draw), body(draw)])
    found = pi.consistent(reference, reference * 3, np.zeros((20, 20)))
    np.testing.assert_allclose(found.rows, reference, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_the_fit_is_that_of_the_semidefinite_program(seed):
    """Against cvxpy and Clarabel, where they are: the cost is the least that is possible, but for what the pull takes
    (`PULL`: eight times it for each body)."""
    cvxpy = pytest.importorskip("cvxpy", reason='the semidefinite program needs pip install "invdyn[sdp]"')
    pytest.importorskip("clarabel", reason='the semidefinite program needs pip install "invdyn[sdp]"')
    reference, wanted, information = fit(np.random.default_rng(seed), 2, 16)
    basis = np.array([pi.pseudo_inertia(unit) for unit in np.eye(10)])
    rows = cvxpy.Variable(wanted.shape)
    values, vectors = np.linalg.eigh(information)
    factor = np.sqrt(np.maximum(values, 0))[:, None] * vectors.T
    misfit = cvxpy.sum_squares(factor @ (cvxpy.reshape(rows, wanted.size, order="C") - wanted.ravel()))
    cone = [sum(rows[k, c] * basis[c] for c in range(10)) >> 0 for k in range(len(wanted))]
    cvxpy.Problem(cvxpy.Minimize(misfit), cone).solve(solver="CLARABEL")
    least = float(misfit.value)
    found = pi.consistent(reference, wanted, information)
    assert least * (1 - 1e-5) - 1e-6 <= found.cost <= least * (1 + 1e-5) + 8 * pi.PULL * len(wanted) + 0.05


def _pseudo(row):
    """A pseudo inertia in jax, of a traced row."""
    m, x, y, z, xx, xy, yy, xz, yz, zz = row
    half = (xx + yy + zz) / 2
    return jnp.array([[half - xx, -xy, -xz, x], [-xy, half - yy, -yz, y], [-xz, -yz, half - zz, z], [x, y, z, m]])
