"""Losses are those of a direct least squares on the rows; the search finds what was put in."""

from dataclasses import replace

import numpy as np
import pytest

from invdyn_cli.diagnosis.columns.candidates import trial_at
from invdyn_cli.diagnosis.search import noise, shared_part
from invdyn_cli.diagnosis.search.grams import FOLDS
from invdyn_cli.diagnosis.search.judge import HypothesisScorer, parameters_of
from invdyn_cli.diagnosis.search.shared_part import HELD
from invdyn_cli.diagnosis.search.steps import free_beside, search
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.composition import EffectInstance
from tests.diagnosis.analytic import candidate, evidence_of, log_of, moved, on, raw, scorer_of

NAMES = [
    "viscous_friction", "coulomb_friction", "joint_spring", "torque_offset", "payload", "base_tilt", "torque_delay",
    "backlash",
]  # fmt: skip
WEIGHTS = np.array([1.0, 4.0, 0.5])


@pytest.fixture(scope="module")
def evidence():
    """Viscous friction and an offset on two joints, in noise."""

    def term(t, m):
        one, other = (on(0, lambda t, q, qd, qdd: 1.0 * qd), on(2, lambda t, q, qd, qdd: 0.2 + 0 * q))
        return one(t, m) + other(t, m)

    return evidence_of(log_of(raw(*moved(), term, torque=0.1)), NAMES, cutoffs=(10.0,))


@pytest.fixture(scope="module")
def judge(evidence):
    made = HypothesisScorer(evidence, evidence.role == 0, WEIGHTS, 0.03 * np.ones(3))
    made.refresh()
    return made


def direct(evidence, hypothesis, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Columns (rows x joints, k) and torque (rows x joints,), weighted; row after row."""
    k = sum(len(c.precision) for c in hypothesis)
    x, y = np.zeros((rows.sum(), 3, k)), np.zeros((rows.sum(), 3))
    for j, table in enumerate(evidence.tables):
        scale = np.sqrt(WEIGHTS[j]) * evidence.valid[rows, j]
        y[:, j] = scale * table[rows, 0]
        start = 0
        for c in hypothesis:
            if j in c.columns:
                x[:, j, start : start + len(c.precision)] = scale[:, None] * table[rows][:, list(c.columns[j][1])]
            start += len(c.precision)
    return x.reshape(y.size, k), y.ravel()


def fitted(x: np.ndarray, y: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """Least squares with what is known beforehand, as rows of their own."""
    return np.linalg.lstsq(np.vstack([x, np.diag(np.sqrt(precision))]), np.append(y, 0 * precision))[0]


HYPOTHESES = {
    "friction": [("viscous_friction", 0), ("coulomb_friction", 0)],
    "all over": [("viscous_friction", 0), ("torque_offset", 2), ("payload", None), ("base_tilt", None)],
}


@pytest.mark.parametrize("name", HYPOTHESES)
def test_losses_are_those_of_a_direct_least_squares(name, evidence, judge):
    """Coefficients, the loss on the data that fit, and that of every block held out with its fold but for HELD, to
    1e-5: NumPy's lstsq on the rows themselves, one fit for every fold."""
    hypothesis = tuple(candidate(evidence, *key) for key in HYPOTHESES[name])
    precision = np.concatenate([c.precision for c in hypothesis])
    x, y = direct(evidence, hypothesis, judge.rows)
    theta = fitted(x, y, precision)
    loss = np.sum((y - x @ theta) ** 2) + precision @ theta**2
    value, own = judge.quick(hypothesis)
    assert value - judge.price(hypothesis) == pytest.approx(loss, rel=1e-5)
    np.testing.assert_allclose(x @ own, x @ theta, atol=1e-5 * np.abs(y).max())
    verdict = judge.verdict(hypothesis)
    number = np.repeat(np.unique(evidence.block[judge.rows], return_inverse=True)[1], 3)
    for fold in range(FOLDS):
        counts = np.sqrt(np.where(number % FOLDS == fold, HELD, 1.0))
        held = fitted(counts[:, None] * x, counts * y, precision)
        for b in range(fold, number.max() + 1, FOLDS):
            wanted = np.sum((y[number == b] - x[number == b] @ held) ** 2)
            assert verdict.blocks[b] == pytest.approx(wanted, rel=1e-5)
    assert verdict.loss == pytest.approx(verdict.blocks.sum() + precision @ own**2 + judge.price(hypothesis), rel=1e-5)
    assert judge.loss(hypothesis) == pytest.approx(verdict.loss, rel=1e-9)


def test_what_one_block_tells_alone_is_no_fault(monkeypatch):
    """A joint goes back once, for two seconds: without these an offset is the same as Coulomb friction. The loss of
    both, which are there, is that of noise; a fit without that block leaves many times as much of it."""
    t, m = moved(32.0)
    back = np.exp(-(((t - 17.0) / 0.5) ** 4))
    qd, q, qdd = m.qd.copy(), m.q.copy(), m.qdd.copy()
    qd[:, 0] = 0.1 - 0.4 * back
    q[:, 0], qdd[:, 0] = np.cumsum(qd[:, 0]) * t[1], np.gradient(qd[:, 0], t)
    term = on(0, lambda t, q, qd, qdd: 1.0 + 2.0 * np.tanh(qd / 0.001))
    names = ["coulomb_friction", "torque_offset"]
    evidence = evidence_of(log_of(raw(t, type(m)(q, qd, qdd), term, torque=0.1)), names, cutoffs=(10.0,))
    rows = np.ones(len(evidence.role), bool)
    measured = noise.measure(evidence, rows)
    judge = HypothesisScorer(evidence, rows, measured.weights, measured.deviation)
    judge.refresh()
    hypothesis = tuple(candidate(evidence, name, 0) for name in names)
    assert judge.verdict(hypothesis).blocks.sum() < 1.3 * judge.floor
    monkeypatch.setattr(shared_part, "HELD", 0.0)
    whole = HypothesisScorer(evidence, rows, measured.weights, measured.deviation)
    whole.refresh()
    assert whole.verdict(hypothesis).blocks.sum() > 3 * judge.floor


def test_nothing_costs_nothing(evidence, judge):
    """The empty hypothesis has no price, and its loss is the weighted square of what the nominal model leaves."""
    _, y = direct(evidence, (), judge.rows)
    assert judge.verdict(()).loss == pytest.approx(y @ y, rel=1e-9)


def test_freedom_is_what_data_determine(evidence, judge):
    """A column that the data show counts one; of a payload's ten, fewer."""
    assert judge.freedom(candidate(evidence, "viscous_friction", 0)) == 1.0
    assert 4 < judge.freedom(candidate(evidence, "payload", None)) < 10


def test_the_search_finds_what_was_put_in(evidence):
    """Of all candidates just the two that were put in, on their joints, with their sizes within 5 %."""
    judge = scorer_of(evidence)
    found = search(judge, evidence.candidates)
    assert {c.key for c in found} == {("viscous_friction", 0), ("torque_offset", 2)}
    theta = dict(zip((c.key for c in found), judge.verdict(found).theta, strict=True))
    assert theta["viscous_friction", 0] == pytest.approx(1.0, rel=0.05)
    assert theta["torque_offset", 2] == pytest.approx(0.2, rel=0.05)
    assert search(judge, evidence.candidates, most=1)[0].key == ("viscous_friction", 0)


def test_negative_friction_is_refused(evidence, judge):
    """Coefficients out of the bounds are said to be no physics; of what is allowed for anyway, they are not."""
    one = candidate(evidence, "viscous_friction", 0)
    assert "damping would be -1.0" in judge.refused((one,), np.array([-1.0]))
    assert judge.refused((one,), np.array([1.0])) == ""
    allowing = HypothesisScorer(evidence, judge.rows, WEIGHTS, 0.03 * np.ones(3), always=(one,))
    assert allowing.refused((one,), np.array([-1.0])) == ""


def test_what_others_would_have_to_take_back_is_refused(evidence, judge):
    """An offset ten times what the nominal model leaves on its joint is no physics on this log; one as large may be."""
    offset = candidate(evidence, "torque_offset", 1)
    left = np.sqrt(np.mean(evidence.tables[1][evidence.role == 0, 0] ** 2))
    assert "cancel most of it" in judge.refused((offset,), np.array([10 * left]))
    assert judge.refused((offset,), np.array([left])) == ""


def test_beside_a_reference_what_both_logs_show_may_be_taken_back(evidence, judge):
    """What a reference alone shows, and what has gone since, cancel each other in the later log: an offset ten times
    the residual is possible beside a drag of that size which is always there, and impossible beside none."""
    drag, offset = candidate(evidence, "viscous_friction", 1), candidate(evidence, "torque_offset", 1)
    compared = replace(evidence, reference_rows=np.zeros(len(evidence.role), bool))
    beside = HypothesisScorer(compared, judge.rows, WEIGHTS, 0.03 * np.ones(3), always=(drag,))
    beside.refresh()
    left, speed = (
        np.sqrt(np.mean(evidence.tables[1][evidence.role == 0, column] ** 2)) for column in (0, drag.columns[1][1][0])
    )
    assert beside.refused((drag, offset), np.array([10 * left / speed, -10 * left])) == ""
    assert "cancel most of it" in beside.refused((drag, offset), np.array([0.0, -10 * left]))


@pytest.mark.parametrize("name", HYPOTHESES)
def test_many_are_judged_at_once_as_one_by_one(name, evidence, judge):
    """The losses of a hypothesis with each candidate beside it are those of fitting every such set anew, to 1e-6 of
    what there is to explain; trials with fixed columns, of one joint and of all, among them."""
    base = tuple(candidate(evidence, *key) for key in HYPOTHESES[name])
    others = [c for c in evidence.candidates if not any(c is b for b in base)]
    assert {c.is_trial for c in others} == {True, False}
    wanted = [judge.quick((*base, c))[0] for c in others]
    nothing = judge.quick(())[0]
    losses, factors = judge.extended(base, others)
    np.testing.assert_allclose(losses, wanted, rtol=0, atol=1e-6 * nothing)
    assert [len(x) for x in factors] == [len(c.precision) for c in others]


def test_a_joint_has_one_level_of_friction(evidence):
    """What contains Coulomb friction is not put beside it, nor beside another that does: two levels on one joint are
    one number written as two. In the place of its special case it is a candidate."""
    names = ["coulomb_friction", "stribeck_friction", "presliding_hysteresis", "viscous_friction"]
    pool = evidence_of(log_of(raw(*moved())), names).candidates
    for name in names[:3]:
        (one, *_) = [c for c in pool if c.key == (name, 0)]
        beside = {c.effect.name for c in free_beside([one], pool) if c.joint == 0}
        assert beside == {"viscous_friction"}
        assert {c.effect.name for c in free_beside([one], pool) if c.joint == 1} == set(names)
    coulomb = candidate(evidence, "coulomb_friction", 0)
    instead = {c.effect.name for c in free_beside([coulomb], pool, instead=True) if c.joint == 0}
    assert instead == {"stribeck_friction", "presliding_hysteresis", "viscous_friction"}


def test_a_torque_is_late_once():
    """Beside a delay a joint has no lag, and beside a lag no delay: of opposite signs they make a second derivative.
    Another joint may have either."""
    pool = evidence_of(log_of(raw(*moved())), ["torque_delay", "actuator_lag"]).candidates
    for name in ("torque_delay", "actuator_lag"):
        one = next(c for c in pool if c.key == (name, 0))
        for move in (False, True):
            beside = {c.key for c in free_beside([one], pool, instead=move) if c.effect.late_by}
            assert beside == {(late, joint) for late in ("torque_delay", "actuator_lag") for joint in (1, 2)}


@pytest.mark.parametrize("name", ["payload", "base_tilt"])
def test_a_body_that_was_tried_is_read_with_its_correction(name):
    """The candidate at parameters that were found has them without a correction, and both together with one."""
    evidence = evidence_of(log_of(raw(*moved(10.0))), (name,))
    effect = EFFECTS[name]
    draw = np.random.default_rng(0)
    scale = np.array([move[-1] for move in effect.directions(evidence.robot, None)])
    first, more = 0.05 * scale * draw.normal(size=(2, len(scale)))
    tried = trial_at(evidence, EffectInstance(effect, None, effect.read(first, evidence.robot, None)))
    for correction in (0 * more, more):
        found = parameters_of(evidence, tried, correction)
        expected = effect.read(first + correction, evidence.robot, None)
        assert all(np.allclose(found[key], expected[key], rtol=1e-9, atol=1e-12) for key in expected)
