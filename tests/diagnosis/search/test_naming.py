"""Rivals: who takes an effect's place, and when the simpler name is given."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from invdyn_cli.diagnosis.columns.evidence import Evidence
from invdyn_cli.diagnosis.search import naming, noise
from invdyn_cli.diagnosis.search.further import acting_of, related
from invdyn_cli.diagnosis.search.judge import HypothesisScorer
from invdyn_cli.diagnosis.search.steps import search
from invdyn_cli.recording.filter import Filter
from tests.diagnosis.analytic import FRICTIONS, candidate, evidence_of, judged, log_of, moved, on, raw, scorer_of


def stribeck(t, q, qd, qdd):
    return (1.0 + 0.8 * np.exp(-((qd / 0.08) ** 2))) * np.sign(qd)


@pytest.fixture(scope="module")
def dry():
    """Coulomb friction of 1 N m."""
    return judged(lambda t, q, qd, qdd: np.sign(qd))


@pytest.fixture(scope="module")
def dropping():
    """A static level of 1.8 N m that drops to 1."""
    return judged(stribeck)


def test_no_drop_no_stribeck(dry):
    """Where friction does not drop with speed, the simpler Coulomb friction takes Stribeck's place."""
    evidence, judge = dry
    whole = (candidate(evidence, "stribeck_friction", 1, velocity=0.08),)
    assert [c.key for c in naming.simplified(judge, (), whole, evidence.candidates)] == [("coulomb_friction", 1)]


def test_a_drop_keeps_stribeck(dropping):
    """Where it drops, Stribeck stays."""
    evidence, judge = dropping
    whole = (candidate(evidence, "stribeck_friction", 1, velocity=0.08),)
    assert naming.simplified(judge, (), whole, evidence.candidates) == whole


@pytest.mark.parametrize("exponent", [1.0, 2.0])
def test_the_exponent_of_a_drop(exponent):
    """Friction that falls as exp(-(qd/v)^2) is found as Bo and Pavelescu's, and stays it beside the trials of Tustin's;
    one that falls as exp(-|qd|/v) becomes Tustin's. None of the velocities that are tried is the true one."""
    evidence, judge = judged(lambda t, q, qd, qdd: (1 + 0.8 * np.exp(-(np.abs(qd / 0.1) ** exponent))) * np.sign(qd))
    found = search(judge, evidence.candidates)
    pool = [*evidence.candidates, *related(evidence, acting_of(judge, (), found)[0])]
    judge.refresh()
    (again,) = search(judge, pool, start=found)
    assert again.key == ("stribeck_friction", 1) and again.shape["exponent"] == exponent


def test_of_friction_that_is_always_there_a_drop_adds_little(dropping):
    """Where Coulomb friction is part of every hypothesis, as on a worn arm, a drop is found that adds more than noise,
    though less than what a torque must be worth, if the whole friction is worth it; else none is."""
    evidence, judge = dropping
    coulomb, joint = candidate(evidence, "coulomb_friction", 1), 1
    pool = [c for c in evidence.candidates if c.effect.name == "stribeck_friction" and c.joint == joint]
    for share, found in ((0.5, 1), (40.0, 0)):  # of what the whole friction is worth, what it has to be
        judge = HypothesisScorer(evidence, judge.rows, judge.weights, judge.deviation, (coulomb,), worn=True)
        judge.least[joint] = share * judge.quick(())[0]
        assert len(search(judge, pool, (coulomb,))) == found


def test_a_general_effect_is_asked_for():
    """By SPECIAL standard errors of the blocks' mean, or in nearly all blocks although one has most of it; not where
    half of the blocks speak against it."""
    draw = np.random.default_rng(0)
    assert naming.asked_for(20 + draw.normal(size=12), -8.0)
    seldom = np.append(draw.uniform(5, 50, 16), [1600.0, -80.0])
    assert naming.asked_for(seldom, -8.0) and seldom.sum() < naming.SPECIAL * np.std(seldom) * np.sqrt(18)
    assert not naming.asked_for(np.append(draw.normal(0, 50, 16), [1600.0, -80.0]), -8.0)


@pytest.mark.parametrize(
    ("each", "together", "stays"), [(200.0, 450.0, True), (600.0, 1200.0, False), (20.0, 900.0, False)]
)
def test_smaller_effects_do_not_replace_a_general_one(each, together, stays, monkeypatch):
    """A spring saves 1,000 noise variances beyond a constant offset, but in eight blocks not evenly, because two others
    do a part of the same. Without them it does so evenly: it stays if they are worth less than half of that, each and
    together. Two that do the same may each look like little."""
    evidence = evidence_of(log_of(raw(*moved(), torque=0.1)), ["joint_spring", "torque_offset", "encoder_offset"])
    spring, *others = (
        candidate(evidence, *x) for x in (("joint_spring", 1), ("encoder_offset", 1), ("encoder_offset", 2))
    )
    offset = candidate(evidence, "torque_offset", 1)
    uneven = np.array([2000.0, 900.0, -600.0, -500.0, -400.0, -300.0, -100.0, 0.0])

    def lost(judge, always, simpler, hypothesis):
        if offset in simpler:
            return (uneven if len(hypothesis) == 3 else np.full(8, 125.0)), 0.0
        return np.full(8, (each if len(simpler) == 2 else together) / 8), 0.0

    monkeypatch.setattr(naming, "_lost", lost)
    kept = naming.simplified(cast(HypothesisScorer, None), (), (spring, *others), [offset])
    assert kept == ((spring, *others) if stays else (offset, *others))


def test_rivals_of_what_is_there_are_rejected(dry):
    """No other effect does as well as Coulomb friction on its joint, the nearest says by how much it is worse, and the
    general case is told as such, or as no physics where its best sizes are none."""
    evidence, judge = dry
    made = naming.rivals(judge, (), (candidate(evidence, "coulomb_friction", 1),), 0, evidence.candidates)
    assert not any(r.equal for r in made)
    why = {r.candidate.key: r.why for r in made}
    assert any(word in why["stribeck_friction", 1] for word in ("more general", "static level is below"))
    assert "standard errors" in why["viscous_friction", 1]
    assert ("coulomb_friction", 1) not in why


def test_a_general_effect_that_is_better_is_a_rival(dry, dropping, monkeypatch):
    """Beside a reference Coulomb friction in the place of a friction that drops is not enough for the data: the drop is
    its equal at least. Without a drop it is none."""
    for (evidence, judge), better in ((dry, False), (dropping, True)):
        monkeypatch.setattr(evidence, "reference_rows", np.zeros(len(evidence.role), bool))
        made = naming.rivals(judge, (), (candidate(evidence, "coulomb_friction", 1),), 0, evidence.candidates)
        (drop,) = (r for r in made if r.candidate.effect.name == "stribeck_friction")
        assert drop.equal == better


def test_a_rival_that_does_as_well_is_equal():
    """Viscous and quadratic friction of a joint whose speed hardly changes are the same: each is the other's equal."""
    t = np.arange(20_000) / 500
    rows = 0.8 + 0.002 * np.sin(0.7 * t)  # one way only: 0.8 rad/s, 0.2 % up and down
    q = np.cumsum(rows) / 500 - 16
    still = np.zeros_like(q)
    _, m = moved()
    both = type(m)(*(np.column_stack([x[:, 0], y, x[:, 2]]) for x, y in ((m.q, q), (m.qd, rows), (m.qdd, still))))
    log = log_of(raw(t, both, on(1, lambda t, q, qd, qdd: 1.0 * qd), torque=0.05))
    evidence = evidence_of(log, FRICTIONS, cutoffs=(20.0,))
    choosing = evidence.role == 0
    measured = noise.measure(evidence, choosing)
    judge = HypothesisScorer(evidence, choosing, measured.weights, measured.deviation)
    judge.refresh()
    made = naming.rivals(judge, (), (candidate(evidence, "viscous_friction", 1),), 0, evidence.candidates)
    assert {"quadratic_friction", "coulomb_friction"} <= {r.candidate.effect.name for r in made if r.equal}


@pytest.mark.parametrize(("speed", "blind"), [(1.0, False), (6.0, True)])
def test_fast_motion_cannot_tell_stribeck(speed, blind):
    """In the same noise a motion that crosses low speeds in no time cannot exclude an ordinary drop, a slow one can."""
    evidence, judge = judged(lambda t, q, qd, qdd: np.sign(qd), speed=speed, torque=0.3)
    friction = (candidate(evidence, "coulomb_friction", 1),)
    assert naming.blind_to_stribeck(judge, (), *friction, evidence.candidates) == blind


def test_chance():
    """Blocks that all speak against a rival leave it none; blocks that speak half and half leave it much."""
    draw = np.random.default_rng(0)
    assert naming.chance(20 + draw.normal(size=20), 0.0) == 0.0
    assert naming.chance(draw.normal(size=20), 0.0) > 0.5
    assert naming.chance(np.append(np.zeros(19), 500.0), 0.0) == 0.0  # one block, denied by none
    assert naming.chance(np.append(-50 * np.ones(5), 300.0), 0.0) > naming.DOUBT  # one block, denied by five


def test_structure_is_what_is_no_noise():
    """White noise has none (to 5 % of its variance, 4,000 rows), a slow wave has its own variance, apart by joints; a
    wave on rows that are not valid does not count."""
    rows = np.arange(4000)
    noise_, wave = np.random.default_rng(0).normal(size=4000), 2 * np.sin(rows / 50)
    valid, piece = np.ones((4000, 3), bool), np.zeros(4000, int)
    valid[:, 2] = False
    filter = Filter(250.0, (40.0,) * 3, 2, (40.0,) * 3)
    rows = SimpleNamespace(recording=SimpleNamespace(filter=filter), piece=piece)
    got = naming.structure(cast(Evidence, rows), np.column_stack([noise_, noise_ + wave, wave]), valid)
    assert got[0] < 0.05 and got[1] == pytest.approx(2.0, rel=0.1) and got[2] == 0.0


@pytest.mark.parametrize(
    ("size", "start", "expected"),
    [
        *((1.3, start, {("rotor_inertia", 0), ("rotor_inertia", 1)}) for start in range(3)),
        (-0.1, 1, {("link_inertia_error", 1)}),
    ],
)
def test_rotors_are_no_link(size, start, expected):
    """The inertia of two rotors, which the inertia of one link can imitate, is that of rotors, wherever the search
    begins: every arm has them. Less inertia than the URDF's is no rotor's."""

    def rotors(t, m):
        return np.column_stack([size * m.qdd[:, 0], 1.1 * size * m.qdd[:, 1], 0 * t])

    names = ["rotor_inertia", "link_inertia_error", "coulomb_friction", "viscous_friction", "torque_offset"]
    evidence = evidence_of(log_of(raw(*moved(), rotors, torque=0.02)), names, cutoffs=(10.0,))
    judge = scorer_of(evidence)
    found = search(judge, evidence.candidates, start=(candidate(evidence, "link_inertia_error", start),))
    kept = naming.simplified(judge, (), found, evidence.candidates)
    assert {c.key for c in kept} == expected
