"""What may be claimed: causes are judged whatever the search refined before them."""

from dataclasses import replace

import numpy as np
import pytest

from invdyn_cli.diagnosis.columns.evidence import judged
from invdyn_cli.diagnosis.decide import claim, refusals
from invdyn_cli.diagnosis.search.inquiry import Inquiry, Question
from invdyn_cli.diagnosis.search.naming import Rival
from invdyn_cli.diagnosis.search.whole import inquire
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.composition import TimeWindow
from invdyn_cli.types import Motion
from tests.diagnosis.analytic import arm, beyond, candidate, evidence_of, log_of, moved, on, raw


def test_a_delay_that_was_never_refined_is_judged():
    """With other rounding the search may come to a delay that the refinement dropped: it is judged by its own columns,
    and one that the data do not hold fails, without a sentence."""
    names = ("torque_delay", "actuator_lag", "coulomb_friction")
    friction = on(0, lambda t, q, qd, qdd: 2.0 * np.tanh(qd / 0.01))
    evidence = evidence_of(log_of(raw(*moved(20.0), friction, torque=0.02, position=1e-5)), names)
    inquiry = inquire(evidence, Question({name: EFFECTS[name] for name in names}, 3))
    assert ("coulomb_friction", 0) in {c.key for c in inquiry.hypothesis}
    late = next(c for c in evidence.candidates if c.effect.name == "torque_delay")
    assert late.key not in {a.key for a in inquiry.chosen.acting}
    hypothesis = (*inquiry.hypothesis, candidate(evidence, *late.key))
    every = np.ones_like(inquiry.judge.rows)
    whole, after = claim.exactly(inquiry, hypothesis, inquiry.whole, every), claim.left(inquiry, hypothesis)
    one = claim.Claim(inquiry, hypothesis, len(hypothesis) - 1, whole, inquiry.chosen, after)
    why = refusals.refusal(one)
    assert why is not None and why.why(one) == ""
    _, kept, _, refused = refusals.supported(replace(inquiry, hypothesis=hypothesis))
    (away,) = (x for x in refused if x.candidate.key == late.key)
    assert late.key not in {c.key for c in kept} and away.told == ""
    assert (away.criterion, away.required) == (why.name, why.least) and away.figure < away.required


def rubbed(seconds):
    """The inquiry of a log of that length with Coulomb friction on the first joint, by which alone it is explained."""
    friction = on(0, lambda t, q, qd, qdd: 2.0 * np.tanh(qd / 0.01))
    evidence = evidence_of(log_of(raw(*moved(seconds), friction, torque=0.02, position=1e-5)), ("coulomb_friction",))
    return inquire(evidence, Question({"coulomb_friction": EFFECTS["coulomb_friction"]}, 3))


def of_coulomb(inquiry):
    """The claim of Coulomb friction on the first joint."""
    (place,) = (i for i, c in enumerate(inquiry.hypothesis) if c.key == ("coulomb_friction", 0))
    return claim.Claim(
        inquiry, inquiry.hypothesis, place, inquiry.whole, inquiry.chosen, claim.left(inquiry, inquiry.hypothesis)
    )


@pytest.mark.parametrize(("share", "alike"), [(0.08, True), (1.0, False)])
def test_a_spring_on_a_short_way_may_be_a_ripple(share, alike):
    """Six times a turn is the longest ripple that gears and motors usually have: in 0.2 rad it is as straight as a
    spring, in 2 rad it is not. A slide has no turns."""
    t, m = moved(20.0)
    less = Motion(share * m.q, share * m.qd, share * m.qdd)
    spring = on(1, lambda t, q, qd, qdd: 2.0 * (q - 0.1))
    evidence = evidence_of(log_of(raw(t, less, spring, torque=0.2, position=1e-5)), ("joint_spring",))
    inquiry = inquire(evidence, Question({"joint_spring": EFFECTS["joint_spring"]}, 3))
    (found,) = inquiry.hypothesis
    one = claim.Claim(inquiry, (found,), 0, inquiry.whole, inquiry.chosen, claim.left(inquiry, (found,)))
    assert found.key == ("joint_spring", 1) and refusals.refusal(one) is None
    assert ("torque_ripple" in {r.candidate.effect.name for r in one.rivals if r.equal}) is alike
    robot = replace(evidence.robot, prismatic=np.array([False, True, False]))
    slide = replace(one, inquiry=replace(inquiry, evidence=replace(evidence, robot=robot)))
    assert "torque_ripple" not in {r.candidate.effect.name for r in slide.rivals}


def test_what_was_refused_beside_a_claim_is_no_rival_of_it():
    """A small body in the hand, and much friction on the first joint, which feels both: each is needed beside the
    other. If the friction is refused for a reason of its own, it does not explain the data as well as the body."""
    names = ("payload", "coulomb_friction")
    inertial = np.array(arm().inertial)
    inertial[-1, :2] += 0.1, 0.02
    heavier = replace(arm(), inertial=inertial)

    def term(t, m):
        return beyond(arm(), heavier, m) + on(0, lambda t, q, qd, qdd: 5.0 * np.sign(qd))(t, m)

    evidence = evidence_of(log_of(raw(*moved(20.0), term, torque=0.05, position=1e-5)), names)
    inquiry = inquire(evidence, Question({name: EFFECTS[name] for name in names}, 3))
    body, friction = sorted(inquiry.hypothesis, key=lambda c: c.effect.name, reverse=True)
    assert (body.key, friction.key) == (("payload", None), ("coulomb_friction", 0))
    one = claim.Claim(inquiry, (body,), 0, inquiry.whole, inquiry.chosen, claim.left(inquiry, (body,)))
    assert friction.key in {r.candidate.key for r in one.rivals if r.equal}
    assert not any(r.equal for r in replace(one, beside=(friction,)).rivals)


def test_what_is_impossible_on_all_rows_is_refused():
    """Sizes on all rows, beside what was not refused, may be others than those that the search judged."""
    inquiry = rubbed(20.0)
    one = of_coulomb(inquiry)
    negative = [replace(a, parameters={**a.parameters, "coulomb": -0.5}) for a in one.whole.acting]
    other = replace(one, whole=replace(one.whole, acting=tuple(negative)))
    (row,) = (x for x in refusals.REFUSALS if x.name == "possible size")
    assert [refusals.refusal(x, [row]) for x in (one, other)] == [None, row]
    assert row.why(other) == "its coulomb would be -0.5 N m; possible: 0 to ∞"


def test_rows_that_judge():
    """An effect is judged on held-out rows where it acts in several of their blocks; on all rows where it acts in one
    alone, as a gear's play that strikes once, or hardly at all."""
    evidence = evidence_of(log_of(raw(*moved(60.0))), ("coulomb_friction",))
    held = judged(evidence)
    blocks = np.unique(evidence.block[held])
    assert held.any() and not held.all() and len(blocks) >= 3
    often, once, hardly = (np.isin(evidence.block, own).astype(float) for own in (blocks, blocks[1], ()))
    hardly += ~held
    for squares, expected in ((often, held), (once, np.ones_like(held)), (hardly, np.ones_like(held))):
        np.testing.assert_array_equal(claim._judging(evidence, squares), expected)


@pytest.mark.parametrize(
    ("excess", "error", "refused"),
    [(-20.0, 1.0, True), (-20.0, 15.0, False), (-5.0, 1.0, False), (300.0, 1.0, False)],
)
def test_what_an_impossible_effect_explains_better_has_no_name(excess, error, refused):
    """A true friction is claimed, unless an effect of an impossible size in its place lowers the loss by more than ten
    noise variances beside the scatter of blocks; one of a possible size, however good, is another row's matter."""
    one = of_coulomb(rubbed(20.0))
    other = Rival(one.candidate, excess, error, False, "", {}, impossible=True)
    one.__dict__["rivals"] = [other, replace(other, excess=-500.0, impossible=False)]  # cached: made up here
    row = refusals.refusal(one)
    assert (row is not None and "impossible" in row.why(one)) == refused and (row is None) == (not refused)


@pytest.mark.parametrize(("share", "worn", "equal"), [(0.99, True, True), (0.9, True, False), (0.99, False, False)])
def test_what_explains_nearly_the_same_is_compared_beside_usual_links(share, worn, equal, monkeypatch):
    """On a worn arm, an encoder offset explained 99.8 % of what a tilt did; the rest was of links that were believed to
    be nearer to the URDF than they are. Such a rival is equal if it is so beside links that may be as far off as those
    of URDFs usually are."""
    inquiry, asked = rubbed(20.0), []
    usual = replace(inquiry, always=inquiry.always_usual)
    tilt = candidate(inquiry.evidence, "base_tilt", None)

    def rivals(judge, always, every, place, pool):
        asked.append(pool)
        return [Rival(tilt, 50.0, 20.0, len(asked) == 2, "", {}, share=share)]

    monkeypatch.setattr(claim.naming, "rivals", rivals)
    monkeypatch.setattr(Inquiry, "beside_usual_links", lambda _: usual)
    one = of_coulomb(replace(inquiry, wear=inquiry.hypothesis if worn else ()))
    assert [x.equal for x in one.rivals] == [equal]
    assert asked[1:] == ([[tilt]] if equal else [])


@pytest.mark.parametrize(("ends", "refused"), [((-0.1, 3.0), True), ((1.0, 3.0), False), ((-3.0, -1.0), False)])
def test_a_claim_has_a_size(ends, refused, monkeypatch):
    """A true effect is claimed unless its interval contains zero."""
    one = of_coulomb(rubbed(20.0))
    monkeypatch.setattr(claim.Claim, "_ends", lambda _, name: np.array(ends) if name else np.full(2, np.inf))
    row = refusals.refusal(one)
    assert (row is not None and "zero" in row.why(one)) == refused and (row is None) == (not refused)


@pytest.mark.parametrize(("end", "refused"), [(5.3, True), (5.5, False), (None, False)])
def test_a_jolt_is_no_event(end, refused):
    """What would act for 0.3 s is not claimed, for 0.5 s it may be; what always acts has no such length."""
    one = of_coulomb(rubbed(20.0))
    when = None if end is None else TimeWindow("run", 5.0, end)
    acting = tuple(replace(a, when=when) for a in one.whole.acting)
    hypothesis = tuple(replace(c, when=when) for c in one.hypothesis)
    one = replace(one, whole=replace(one.whole, acting=acting), hypothesis=hypothesis)
    (row,) = (x for x in refusals.REFUSALS if x.name == "length of its window")
    assert (refusals.refusal(one, [row]) is row) == refused


@pytest.mark.parametrize(("errors", "refused"), [(5.0, True), (8.0, False)])
def test_a_force_that_chance_may_find(errors, refused):
    """A force for a time that is five standard errors along one of its axes is not claimed, because many windows were
    tried; one of eight may be. Correlated errors do not matter: only what the data tell of the force does."""
    one = of_coulomb(rubbed(20.0))
    draw = np.random.default_rng(7)
    number = next(k for k, a in enumerate(one.whole.acting) if a.key == one.key)
    root = draw.normal(size=(5, 3))
    along = draw.normal(size=3)
    theta = errors * along / np.sqrt(along @ np.linalg.solve(root.T @ root, along))
    labels = tuple((number, "", k) for k in range(3))
    force = replace(one, whole=replace(one.whole, theta=theta, labels=labels, unknown=root))
    (row,) = (x for x in refusals.REFUSALS if x.name == "distance from no force")
    assert row.figure(force) == np.inf  # it always acts
    acting, hypothesis = (
        tuple(replace(x, when=TimeWindow("run", 5.0, 9.0)) for x in xs) for xs in (one.whole.acting, one.hypothesis)
    )
    force = replace(force, whole=replace(force.whole, acting=acting), hypothesis=hypothesis)
    assert row.figure(force) == pytest.approx(errors**2) and (refusals.refusal(force, [row]) is row) == refused


@pytest.mark.parametrize("even", [True, False])
def test_a_claim_surely_gains(even):
    """What makes the error smaller in all blocks of time is claimed; what makes it as much larger in every second one
    is not, though by chance it may gain."""
    one = of_coulomb(rubbed(20.0))
    worse = (one.inquiry.evidence.block % 2 > 0) & even
    one.__dict__["before"] = one.after * np.sqrt(np.where(worse, 0.4, 1.6))[:, None]  # cached: made up here
    gains = [x for x in refusals.REFUSALS if x.name.startswith("least gain")]
    assert (refusals.refusal(one, gains) is not None) == even
    passing = replace(one.candidate, when=TimeWindow("run", 2.0, 3.0))
    passes = tuple(passing if c is one.candidate else c for c in one.hypothesis)
    brief = replace(one, hypothesis=passes)
    brief.__dict__["before"] = one.before
    assert refusals.refusal(brief, gains) is None  # draws of blocks often miss it


def test_what_acts_in_one_block_surely_gains():
    """A drive that saturates once is claimed: most draws of blocks lack the one in which it does, and the interval of
    its gain then begins at zero."""
    one = of_coulomb(rubbed(60.0))
    block = one.inquiry.evidence.block
    once = block == block[judged(one.inquiry.evidence)][0]
    one.__dict__["before"] = one.after + 10.0 * once[:, None]  # cached: made up here
    assert all(gain.interval95[0] <= 0 for gain in one.gains.values())
    gains = [x for x in refusals.REFUSALS if x.name.startswith("least gain")]
    assert refusals.refusal(one, gains) is None


@pytest.mark.parametrize(
    ("name", "ends", "least"),
    [
        ("base_tilt", (-0.003, 0.004), 0.003 - 0.006),
        ("payload_change", (0.2, 0.4), 0.2),
        ("torque_gain_error", (0.9, 0.95), 0.05),
        ("torque_gain_error", (0.98, 1.05), -0.02),
        ("stribeck_friction", None, np.inf),
        ("backlash", None, np.inf),
        ("external_contact", ((-1.0, -1.0, 2.0), (1.0, 1.0, 4.0)), np.inf),
    ],
)
def test_least_sizes(name, ends, least, monkeypatch):
    """A size is counted from where there is no effect: a factor from one, anything else from zero. Effects without one
    such number have none that is least."""
    one = of_coulomb(rubbed(20.0))
    own = replace(one.candidate, effect=EFFECTS[name])
    one = replace(one, hypothesis=tuple(own if c is one.candidate else c for c in one.hypothesis))
    told = np.full(2, np.inf) if ends is None else np.array(ends, float)
    monkeypatch.setattr(claim.Claim, "_ends", lambda _, asked: told if asked else np.full(2, np.inf))
    assert one.size == pytest.approx(least)


@pytest.mark.parametrize(("own", "refused"), [(-20.0, True), (-5.0, False), (1.0, False)])
def test_an_effect_of_a_joint_does_not_make_that_joint_worse(own, refused):
    """What makes its own joint's torque worse by more than ten noise variances is no effect of that joint, though it
    saves a hundred on the next one; with less it may be, as a force on a link that its own joint does not feel."""
    one = of_coulomb(rubbed(20.0))
    variances = 1 / one.inquiry.noise.weights
    one.__dict__["saved"] = variances * np.array([own, 100.0, *np.zeros(len(variances) - 2)])  # cached: made up here
    row = refusals.refusal(one, [x for x in refusals.REFUSALS if x.name.startswith("gain on")])
    assert (row is not None) == refused and one.gain > 0


@pytest.mark.parametrize(("true", "expected"), [(1.0, 1.0), (0.0, -1.0), (0.5, 0.0)])
def test_an_effect_has_one_size(true, expected):
    """Of an effect's torque the residual has what is fast whole, and of the rest a share. What is saved of the rest
    tells, whatever is saved of that part. Theory: of a column x of which the residual has a x, it saves (2 a - 1) of
    x's squares."""
    one = of_coulomb(rubbed(40.0))
    evidence = one.inquiry.evidence
    t, cutoff = evidence.on_rows("t"), evidence.recording.filter.cutoffs[0]
    wave, fast = (np.sin(2 * np.pi * share * cutoff * t) for share in (0.05, 0.8))
    noise = 0.01 * np.random.default_rng(0).normal(size=evidence.valid.shape)
    before, after = noise.copy(), noise.copy()
    before[:, 0] += true * wave + 3 * fast
    after[:, 0] += (true - 1) * wave
    one = replace(one, after=after)
    one.__dict__["before"] = before  # cached: what the search left is replaced by what is made up here
    assert one.slow_gain == pytest.approx(expected, abs=0.35)  # three standard deviations of the blocks are added
    assert (one.slow_gain < refusals.ONE_SIZE) == (true < 1)


@pytest.mark.parametrize(("slow", "fast"), [(1.0, 3.0), (1.0, 1.0), (3.0, 1.0)])
def test_evidence_is_what_is_saved_where_the_arm_moves(slow, fast):
    """Two waves of these amplitudes are explained, one far below and one far above a quarter of the joint's band. The
    share of their squares that is slow is the share of the evidence that counts."""
    one = of_coulomb(rubbed(40.0))
    evidence = one.inquiry.evidence
    t, cutoff = evidence.on_rows("t"), evidence.recording.filter.cutoffs[0]
    made = sum(size * np.sin(2 * np.pi * share * cutoff * t) for size, share in ((slow, 0.05), (fast, 0.8)))
    after = 0.001 * np.random.default_rng(0).normal(size=evidence.valid.shape)
    before = after.copy()
    before[:, 0] += made
    one = replace(one, after=after)
    one.__dict__.update(before=before, evidence=1000.0)  # cached: made up here
    expected = 1000.0 * slow**2 / (slow**2 + fast**2)
    assert one.slow_evidence == pytest.approx(expected, abs=50.0)  # rests cut the waves, which mixes them a little


@pytest.mark.parametrize("wave", ["columns", "formula"])
def test_what_stays_unknown_is_left_by_the_exact_formula(wave):
    """A wave that the linear columns leave and the exact formula does not is no unknown cause, as at the edges of a
    window between two trials. What the formula leaves is one: at most half of the wave's square, as far as noise
    cannot have so much by chance."""
    one = of_coulomb(rubbed(40.0))
    evidence, (joint,) = one.inquiry.evidence, one.candidate.columns
    noise = 0.01 * np.random.default_rng(0).normal(size=evidence.valid.shape)
    with_wave = noise.copy()
    with_wave[:, joint] += np.sin(2 * np.pi * 0.2 * evidence.on_rows("t"))
    columns, formula = (with_wave, noise) if wave == "columns" else (noise, with_wave)
    one = replace(one, after=columns, chosen=replace(one.chosen, residual=formula))
    rows = np.sum(evidence.valid[:, joint] & one.rows)
    variances = one.unknown / (one.inquiry.noise.weights[joint] * rows)
    assert variances < 1e-3 if wave == "columns" else 0.25 < variances < 0.55
