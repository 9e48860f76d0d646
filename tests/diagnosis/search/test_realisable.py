"""Bodies that can be, on logs written down by formulas: what moves, what it costs, and what is said."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from experiments.cases import inverse_dynamics
from invdyn_cli.diagnosis.columns.evidence import Evidence
from invdyn_cli.diagnosis.decide.intervals import intervals
from invdyn_cli.diagnosis.search.composed import Model, Refined
from invdyn_cli.diagnosis.search.exact import refine
from invdyn_cli.diagnosis.search.realisable import realisable
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.composition import EffectInstance
from invdyn_cli.maths import pseudo_inertia
from invdyn_cli.types import Motion, Robot
from tests.diagnosis.analytic import arm, gather, log_of, moved, raw, recording_of

NOISE = 0.02
"""[N m] of the torque."""

KNOWN = 0.02
"""[kg; kg m; kg m^2] Width of an interval below which a parameter of the arm's links, of kilogrammes, is known."""

NAMES = ("first", "second", "third")
TOOL = {"mass": 0.8, "com": np.array([0.02, -0.01, 0.1]), "inertia": np.array([1e-3, 0, 1e-3, 0, 0, 1e-3])}
ZERO = {"mass": 0.0, "moment": np.zeros(3), "inertia": np.zeros(6)}


def link_change(share: float) -> dict:
    """The second link's error where all of its inertials are this share of themselves more."""
    row = share * np.asarray(arm().inertial)[1]
    return {"mass": float(row[0]), "moment": row[1:4], "inertia": row[4:]}


def hidden(robot: Robot, *bodies: tuple[str, int | None, dict]) -> Robot:
    """The robot with these body effects."""
    for name, joint, parameters in bodies:
        robot = EFFECTS[name].changed(parameters, robot, joint)
    return robot


def torque(robot: Robot, m: Motion) -> np.ndarray:
    """Torques (T, n) of inertials that no body may have, which Pinocchio refuses; but torque is linear: that
    with heavy balls on all links, less that of the balls."""
    heavy = np.array([20.0, 0, 0, 0, 20, 0, 20, 0, 0, 20])
    first, second = (replace(robot, inertial=x) for x in (robot.inertial + heavy, np.tile(heavy, (robot.dofs, 1))))
    return inverse_dynamics(first, m.q, m.qd, m.qdd) - inverse_dynamics(second, m.q, m.qd, m.qdd)


@cache
def refined(case: str) -> tuple[Evidence, Model, Refined]:
    """The free fit of a payload, a second link that weighs thrice as much, or both, to the log of an arm that has them;
    or of a link that weighs less than nothing."""
    made = {
        "payload": (("payload", None, TOOL),),
        "link": (("link_inertia_error", 1, link_change(2.0)),),
        "both": (("payload", None, TOOL), ("link_inertia_error", 1, link_change(0.3))),
        "impossible": (("link_inertia_error", 1, link_change(-1.6)),),
    }[case]
    t, m = moved(rate=250.0)
    noise = NOISE * np.random.default_rng(0).normal(size=m.q.shape)
    evidence = _evidence(arm(), replace(raw(t, m), tau=torque(hidden(arm(), *made), m) + noise))
    light = {"mass": 0.1, "com": np.zeros(3), "inertia": np.zeros(6)}
    return evidence, *_fit(evidence, [EffectInstance(EFFECTS[x], j, light if j is None else ZERO) for x, j, _ in made])


def _evidence(robot: Robot, trajectory) -> Evidence:
    effects = [EFFECTS[name] for name in ("payload", "link_inertia_error")]
    return gather(robot, recording_of(log_of(trajectory), cutoffs=(10.0,)), effects, "unknown")


def _fit(evidence: Evidence, acting, sharper: float = 1.0) -> tuple[Model, Refined]:
    model, rows = Model(evidence), np.ones(len(evidence.role), bool)
    return model, refine(evidence, model, acting, rows, np.full(3, 0.1 * sharper / NOISE**2))


def bodies(evidence: Evidence, found: Refined) -> list[np.ndarray]:
    """Rows (10,) of the payload as it is, and of the links with their change."""
    rows = []
    for one in found.acting:
        empty = replace(evidence.robot, inertial=np.zeros_like(evidence.robot.inertial))
        base = empty if one.effect.name == "payload" else evidence.robot
        link = -1 if one.joint is None else one.joint
        rows.append(np.asarray(one.effect.changed(one.parameters, base, one.joint).inertial)[link])
    return rows


@pytest.mark.parametrize("case", ["link", "both", "impossible"])
def test_what_comes_out_are_bodies(case):
    """Payload and link come out with positive definite pseudo inertias, whose free fit is none."""
    evidence, model, found = refined(case)
    after, _, _ = realisable(evidence, model, found, NAMES)
    assert not all(pseudo_inertia.is_realisable(row) for row in bodies(evidence, found))  # else nothing was asked
    for row in bodies(evidence, after):
        np.linalg.cholesky(pseudo_inertia.pseudo_inertia(row))


@pytest.mark.parametrize("case", ["link", "both"])
def test_what_the_data_do_not_show_costs_nothing(case):
    """An arm with bodies on it that can be: the free fit is none only where the data do not look. Nothing is said, and
    the torque stays the same to a hundredth of the noise; where that is taken for nearly nothing, to 1e-6 of its RMS.
    """
    evidence, model, found = refined(case)
    after, said, _ = realisable(evidence, model, found, NAMES)
    assert said == ()
    assert np.all(rms(after.residual - found.residual) < 0.01 * NOISE)
    np.testing.assert_allclose(after.residual, model.residual(after.acting), atol=1e-9)
    _, sharp = _fit(evidence, found.acting, 1e6)
    after, said, _ = realisable(evidence, model, sharp, NAMES)
    assert said == () and np.any(after.theta != sharp.theta)
    assert np.all(rms(after.residual - sharp.residual) < 1e-6 * rms(evidence.tau))


def rms(x: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(x**2, axis=0))


@pytest.mark.parametrize("case", ["link", "both"])
def test_values_stay_within_their_intervals(case):
    """What the data determine is where it was: every parameter of a link that is known to KNOWN stays within its
    interval, and that as wide as it was."""
    evidence, model, found = refined(case)
    after, _, _ = realisable(evidence, model, found, NAMES)
    before, now = (intervals(evidence, x)[-1] for x in (found, after))
    count = 0
    for name, (_, low, high) in before.items():
        known = np.asarray(high - low < KNOWN)
        count += known.sum()
        value, now_low, now_high = (np.asarray(x) for x in now[name])
        assert np.all((low <= value) & (value <= high) | ~known), name
        np.testing.assert_allclose((now_high - now_low)[known], (high - low)[known], rtol=0.1, atol=1e-4)
    assert count >= 2


def test_bodies_that_can_be_stay():
    """Where the free fit is a body already, nothing moves, to the last bit, and nothing is said."""
    evidence, model, found = refined("payload")
    assert all(pseudo_inertia.is_realisable(row) for row in bodies(evidence, found))
    after, said, costs = realisable(evidence, model, found, NAMES)
    assert after is found and said == () and not costs


def test_it_is_said_where_the_data_want_no_body():
    """A second link with 1.6 times its own inertials too few has less than nothing: the fit finds it, no body does, and
    the sentence names the link, and the error that it leaves, which is above the noise. The effect is in doubt."""
    evidence, model, found = refined("impossible")
    after, said, costs = realisable(evidence, model, found, NAMES)
    ((number, cost),) = costs.items()
    assert cost > 100  # of 30 by chance
    assert (found.acting[number].effect.name, found.acting[number].joint) == ("link_inertia_error", 1)
    assert len(said) == 1 and "second" in said[0] and "not physically consistent" in said[0]
    assert np.max(rms(after.residual)) > 2 * np.max(rms(found.residual))


def test_a_urdf_that_has_no_body_is_not_the_logs_fault():
    """The second link's inertia in the URDF is nearly nothing along one axis, against the triangle inequality: a true
    payload and a small error of that link are found without a word against the data, and the URDF is told of."""
    nominal = arm()
    inertial = np.array(nominal.inertial)
    own = pseudo_inertia.pseudo_inertia(inertial[1])
    own[1, 1] = -0.5 * own[1, 1]
    inertial[1] = pseudo_inertia.row_of(own)
    wrong = replace(nominal, inertial=inertial)
    t, m = moved(rate=250.0)
    true = hidden(wrong, ("link_inertia_error", 1, link_change(0.1)))
    tau = torque(true, m) + NOISE * np.random.default_rng(0).normal(size=m.q.shape)
    evidence = _evidence(wrong, replace(raw(t, m), tau=tau))
    model, found = _fit(evidence, [EffectInstance(EFFECTS["link_inertia_error"], 1, ZERO)])
    after, said, costs = realisable(evidence, model, found, NAMES)
    assert not costs and len(said) == 1 and "URDF" in said[0] and "second" in said[0]
    assert np.all(rms(after.residual - found.residual) < 0.01 * NOISE)
