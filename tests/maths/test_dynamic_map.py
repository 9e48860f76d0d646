"""How many products there are, that an arm needs all of them, and that they obey Lagrange's equations."""
# pyright: reportAttributeAccessIssue=false

from functools import partial

import jax
import numpy as np
import pinocchio as pin
import pytest

from experiments.arms import random_robot
from invdyn_cli.maths import bezier
from invdyn_cli.maths.dynamic_map import Arc, DynamicMap, coriolis, inertia, pairs, products, velocities
from invdyn_cli.robots import pinocchio_model
from invdyn_cli.types import Motion

JOINTS = 4


def arc(n: int) -> Arc:
    return Arc(np.linspace(-0.3, 0.4, n), np.full(n, 0.8))


def test_closed_forms_of_the_counts():
    """For one to seven joints, the columns are as many as the sums of derived closed forms say: shared H
    sum (5^m - 3^m) / 2 and U 3^n - 1; naive [n + n (n + 1) / 2] 5^n + 3^n a joint; the last joint's structured torque
    has its H, C and g counted by hand for four joints."""
    for n in range(1, 8):
        shared = DynamicMap("shared", "trig", n)
        assert shared.sizes == (sum((5**m - 3**m) // 2 for m in range(1, n + 1)) + 3**n - 1,)
        naive = DynamicMap("naive", "bezier", n)
        assert naive.parameters == n * ((n + n * (n + 1) // 2) * 5**n + 3**n)
    # joint 4 of 4, H_4j: 27 + 9 + 3 + 1; g: 54; C_4jk without k = 4: sorted (j, k): 6 x the degree-1 zone from j to k,
    # and degree 2 beyond: (1,1): 125 ... each counted as 3^(b - a) 5^(4 - b)
    across = [3 ** (k - j) * 5 ** (4 - k) for j in range(1, 4) for k in range(j, 4)]
    assert DynamicMap("structured", "trig", 4).sizes[3] == 27 + 9 + 3 + 1 + 54 + sum(across)
    assert DynamicMap("shared", "trig", 7).parameters == 49374


@pytest.mark.parametrize("basis", bezier.BASES)
@pytest.mark.parametrize("form", ["naive", "structured", "shared"])
def test_columns_are_as_many_as_announced(form, basis):
    """The arrays have the sizes that are told before memory is taken."""
    n = 3
    motion = Motion(*np.random.default_rng(0).normal(size=(3, n)))
    dynamic = DynamicMap(form, basis, n)
    assert tuple(x.shape[-1] for x in dynamic.columns(arc(n), motion)) == dynamic.sizes


@pytest.mark.parametrize("basis", bezier.BASES)
def test_shared_columns_obey_lagrange(basis):
    """With any coefficients, the torque of the shared form is d/dt dL/dqd - dL/dq of the Lagrangian that the same
    coefficients of H and U make, by automatic differentiation."""
    n, dynamic = 3, DynamicMap("shared", basis, 3)
    draw = np.random.default_rng(1)
    theta = draw.normal(size=dynamic.sizes[0])

    def lagrangian(q, qd):
        tables = {d: bezier.functions(basis, d, q - arc(n).middle, arc(n).alpha) for d in (1, 2)}
        energy, at = 0.0, 0
        for i, j in pairs(n):
            values = products(tables, inertia(n, i, j))
            h = theta[at : at + len(values)] @ values
            energy, at = energy + h * qd[i] * qd[j] * (0.5 if i == j else 1.0), at + len(values)
        return energy - theta[at:] @ products(tables, (1,) * n)[1:]

    for _ in range(3):
        q, qd, qdd = draw.normal(size=(3, n))
        momentum = partial(jax.grad, argnums=1)(lagrangian)
        change = jax.jvp(momentum, (q, qd), (qd, qdd))[1]
        expected = change - jax.grad(lagrangian)(q, qd)
        columns = dynamic.columns(arc(n), Motion(q, qd, qdd))[0]
        np.testing.assert_allclose(columns @ theta, expected, atol=1e-10)


@pytest.fixture(scope="module")
def coefficients():
    """700 postures (T, 4) of an arm that was drawn, and there: H (T, 4, 4), C (T, 4, 4, 4) of qd_j qd_k, j <= k, and g
    (T, 4), by Pinocchio."""
    robot = random_robot(np.random.default_rng(8), JOINTS)
    model = pinocchio_model(robot)
    data = model.createData()
    unit, still = np.eye(JOINTS), np.zeros(JOINTS)
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (700, JOINTS))
    h, c, g = np.zeros((700, JOINTS, JOINTS)), np.zeros((700, JOINTS, JOINTS, JOINTS)), np.zeros((700, JOINTS))
    for t, posture in enumerate(q):
        weight = pin.rnea(model, data, posture, still, still)
        g[t] = weight
        h[t] = np.stack([pin.rnea(model, data, posture, still, e) - weight for e in unit], axis=1)
        alone = [pin.rnea(model, data, posture, e, still) - weight for e in unit]
        for j, k in pairs(JOINTS):
            both = alone[j] if j == k else pin.rnea(model, data, posture, unit[j] + unit[k], still) - weight
            c[t, :, j, k] = both if j == k else both - alone[j] - alone[k]
    return q, h, c, g


def unexplained(q: np.ndarray, target: np.ndarray, degrees, **options) -> float:
    """RMS of what the products leave of a coefficient, over its own RMS."""
    place = arc(JOINTS)
    tables = {d: bezier.functions("trig", d, q - place.middle, place.alpha) for d in (1, 2)}
    columns = np.asarray(
        jax.vmap(lambda *x: products({1: x[:2], 2: x[2:]}, degrees, **options), in_axes=1)(*tables[1], *tables[2])
    )
    columns = columns / np.linalg.norm(columns, axis=0)
    left = target - columns @ np.linalg.lstsq(columns, target)[0]
    return float(np.linalg.norm(left) / np.linalg.norm(target))


def terms():
    """Every coefficient of four joints: which of H, C, g, its indices, its degrees."""
    for i, j in pairs(JOINTS):
        yield "h", (i, j), inertia(JOINTS, i, j)
    for i in range(JOINTS):
        for j, k in velocities(JOINTS, i):
            yield "c", (i, j, k), coriolis(JOINTS, i, j, k)


def test_an_arm_lies_in_the_span(coefficients):
    """Every H_ij, C_ijk and g_i of a drawn four-joint arm is a combination of its products, but for 1e-12; and C_iji
    with j <= i, which has none, is zero."""
    q, h, c, g = coefficients
    loud = {"h": np.abs(h).max(), "c": np.abs(c).max()}
    for kind, place, degrees in terms():
        target = {"h": h, "c": c}[kind][(slice(None), *place)]
        if np.abs(target).max() > 1e-9 * loud[kind]:
            assert unexplained(q, target, degrees) < 1e-12, (kind, place)
    for i in range(JOINTS):
        if np.abs(g[:, i]).max() > 1e-9 * np.abs(g).max():
            assert unexplained(q, g[:, i], (1,) * JOINTS, sloped=i, constant=False) < 1e-12
        assert max(np.abs(c[:, i, j, i]).max() for j in range(i + 1)) < 1e-12 * loud["c"]


def test_every_degree_is_needed(coefficients):
    """One degree less in any joint leaves a thousandth of the coefficient or more: the lowest that was seen on drawn
    arms is 1e-2, rounding is 1e-13."""
    q, h, c, _ = coefficients
    for kind, place, degrees in terms():
        for joint, degree in enumerate(degrees):
            if degree:
                fewer = (*degrees[:joint], degree - 1, *degrees[joint + 1 :])
                target = {"h": h, "c": c}[kind][(slice(None), *place)]
                assert unexplained(q, target, fewer) > 1e-3, (kind, place, joint)
