"""Columns beside the logged torque: what enters, and in which blocks."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.cases import inverse_dynamics
from invdyn_cli.diagnosis.columns.candidates import kind_of, passing_candidate
from invdyn_cli.diagnosis.columns.evidence import BLOCK
from invdyn_cli.diagnosis.columns.gears import YIELD
from invdyn_cli.diagnosis.columns.shown import beside_gain
from invdyn_cli.diagnosis.search.composed import Model
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.effects.composition import EffectInstance, TimeWindow
from invdyn_cli.interfaces import AbstractTorqueEffect, JointState
from invdyn_cli.simulation.references import PickPlace
from invdyn_cli.types import Motion
from tests.diagnosis.analytic import arm, candidate, column, evidence_of, gather, log_of, moved, on, raw, recording_of


def test_samples_at_rest_do_not_enter():
    """A joint that stands may have any friction within its limits: rows within the filter's reach of a rest are not
    valid, and without them 2 N m of Coulomb friction and no offset come out within 0.02 N m; with them an offset of
    more than 0.1 N m would be invented."""
    rate, draw = 500.0, np.random.default_rng(0)
    m = PickPlace(dwell=0.8).motion(arm(), 40.0, rate, 0)
    t = np.arange(len(m.q)) / rate
    rests = np.abs(m.qd[:, 1]) < 1e-9
    which = np.cumsum(np.diff(rests.astype(int), prepend=0) == 1)
    stuck = draw.uniform(0.5, 2, which.max() + 1)[which]
    term = on(1, lambda t, q, qd, qdd: np.where(rests, stuck, 2.0 * np.sign(qd)))
    names = ["coulomb_friction", "torque_offset"]
    evidence = evidence_of(log_of(raw(t, m, term)), names, cutoffs=(10.0,))
    x, y = np.column_stack([column(evidence, name, 1) for name in names]), evidence.tables[1][:, 0]
    valid = evidence.valid[:, 1]
    assert 0.2 < valid.mean() < 0.9
    np.testing.assert_allclose(np.linalg.lstsq(x[valid], y[valid])[0], [2.0, 0.0], atol=0.02)
    assert np.linalg.lstsq(x, y)[0][1] > 0.1


LINEAR = [name for name, e in EFFECTS.items() if isinstance(e, AbstractTorqueEffect) and not (e.nonlinear or e.sum_of)]


@pytest.mark.parametrize("name", LINEAR)
def test_columns_reproduce_a_term_without_noise(name):
    """The torque of a known effect lies in its columns to 0.4 %, on the joint's own table alone; what is left is the
    log's: a reversal between two of its samples is known to half a millisecond."""
    parameters = {
        "viscous_friction": {"damping": 0.7},
        "coulomb_friction": {"coulomb": 1.0},
        "load_dependent_friction": {"mu": 0.1},
        "quadratic_friction": {"drag": 0.4},
        "joint_spring": {"stiffness": 3.0, "rest": 0.2},
        "rotor_inertia": {"armature": 0.1},
        "torque_offset": {"offset": 0.4},
        "torque_offset_drift": {"rate": 0.05},
    }[name]

    def term(t, m):
        load = inverse_dynamics(arm(), m.q, m.qd, m.qdd)[:, 1]
        state = JointState(t, m.q[:, 1], m.qd[:, 1], m.qdd[:, 1], np.sign(m.qd[:, 1]), load)
        out = np.zeros_like(m.q)
        out[:, 1] = EFFECTS[name].term(parameters, state)
        return out

    evidence = evidence_of(log_of(raw(*moved(seconds=20, rate=1000.0), term)), [name], cutoffs=(10.0,))
    y, (_, free) = evidence.tables[1][:, 0], candidate(evidence, name, 1).columns[1]
    x = evidence.tables[1][:, list(free)]
    left = y - x @ np.linalg.lstsq(x, y)[0]
    assert np.sqrt(np.mean(left**2)) < 4e-3 * np.sqrt(np.mean(y**2))
    assert np.abs(evidence.tables[0][:, 0]).max() < 1e-3 * np.abs(y).max()


def test_load_beside_coarse_angles():
    """Friction that grows with the load has its size to 10 %, and so has Coulomb friction beside it, where the steps of
    encoders, 1.5 mrad, make noise of accelerations that is larger than the load; by its formula little is left, too."""
    load, step = EFFECTS["load_dependent_friction"], 1.5e-3
    t, m = moved(seconds=60, rate=250.0)
    made = inverse_dynamics(arm(), m.q, m.qd, m.qdd)
    friction = np.zeros_like(m.q)
    friction[:, 1] = (0.5 + 0.2 * np.abs(made[:, 1])) * np.sign(m.qd[:, 1])
    trajectory = raw(t, m, lambda *_: friction)
    trajectory = replace(trajectory, q=step * np.round(trajectory.q / step))
    names = ["coulomb_friction", load.name]
    evidence = evidence_of(log_of(trajectory), names, cutoffs=(4.0,))
    x, y = np.column_stack([column(evidence, name, 1) for name in names]), evidence.tables[1][:, 0]
    used = evidence.valid[:, 1]
    sizes = np.linalg.lstsq(x[used], y[used])[0]
    np.testing.assert_allclose(sizes, [0.5, 0.2], rtol=0.1)
    acting = [EffectInstance(EFFECTS[names[0]], 1, {"coulomb": 0.5}), EffectInstance(load, 1, {"mu": 0.2})]
    left = Model(evidence).residual(acting)[used, 1]
    assert np.std(left) < 0.15 * np.std(y[used])


def test_columns_of_what_comes_and_goes():
    """A weight that hangs at the last frame's origin for a time, by Pinocchio, lies in the columns of a contact in that
    window to 1 % (its edges are known to a sample), and less than half of it in those of half the window."""
    robot, heavier = arm(), np.array(arm().inertial)
    heavier[-1, 0] += 0.5

    def hanging(t, m):
        both = (
            inverse_dynamics(replace(robot, inertial=x), m.q, 0 * m.qd, 0 * m.qdd) for x in (heavier, robot.inertial)
        )
        return np.subtract(*both) * ((t > 3) & (t < 6))[:, None]

    evidence = evidence_of(log_of(raw(*moved(seconds=10.0), hanging)), [], cutoffs=(10.0,))
    y, share = (evidence.tau - evidence.nominal).T, []
    for end in (6.0, 4.5):
        made = passing_candidate(evidence, EFFECTS["external_contact"], 2, TimeWindow("run", 3.0, end))
        x = np.stack([evidence.tables[j][:, list(made.columns[j][1])] for j in range(3)]).reshape(y.size, -1)
        share.append(np.sum((y.ravel() - x @ np.linalg.lstsq(x, y.ravel())[0]) ** 2) / np.sum(y**2))
    assert share[0] < 0.01**2 and share[1] > 0.25


def test_column_of_a_drive_that_is_weak_from_some_time_on():
    """What a drive lacks from one tenth of a log on is its column, to 1 %: friction and an offset, which it makes less
    of, too, are fitted beside the change, and the torque that it lacks is not taken for an offset (9 % otherwise)."""
    names, start = ["coulomb_friction", "viscous_friction", "torque_offset"], 3.0

    def weak(t, m):
        friction = np.zeros_like(m.q)
        friction[:, 1] = np.sign(m.qd[:, 1]) + 0.5 * m.qd[:, 1]
        whole = (friction + inverse_dynamics(arm(), m.q, m.qd, m.qdd)) * (np.arange(3) == 1)
        return friction + (1 / 0.8 - 1) * whole * (t > start)[:, None]

    evidence = evidence_of(log_of(raw(*moved(30.0), weak)), names, cutoffs=(10.0,))
    evidence.shown = np.column_stack([beside_gain(evidence, j) for j in range(3)])
    made = passing_candidate(evidence, EFFECTS["torque_gain_change"], 1, TimeWindow("run", start, 30.0))
    own = np.column_stack([column(evidence, name, 1) for name in names])
    x, used = evidence.tables[1][:, list(made.columns[1][1])], evidence.valid[:, 1]
    lacks = evidence.tables[1][:, 0] - own @ [1.0, 0.5, 0.0]
    left = lacks - (1 / 0.8 - 1) * x[:, 0]
    assert np.std(left[used]) < 0.01 * np.std(lacks[used])


@pytest.mark.parametrize(
    ("name", "parameter", "value"), [("backlash", "gap", 0.004), ("joint_elasticity", "stiffness", 150.0)]
)
def test_columns_of_a_gear(name, parameter, value):
    """What a gear that yields changes of the torque is the fixed column of its trial, to 5 %, and its free one is the
    slope of that over a tenth more and less compliance, likewise: they leave out what the link's other speed makes."""
    evidence = evidence_of(log_of(raw(*moved(seconds=10.0))), [], cutoffs=(10.0,))
    effect = EFFECTS[name]
    made, model, change = kind_of(effect).candidate(evidence, effect, 1, {parameter: value}), Model(evidence), {}
    compliance = effect.compliance({parameter: value})
    for factor in (1 - YIELD, 1.0, 1 + YIELD):
        gear = EffectInstance(effect, 1, effect.from_compliance(factor * compliance))
        change[factor] = model.residual(()) - model.residual([gear])
    fixed, free = (np.stack([evidence.tables[j][:, made.columns[j][k][0]] for j in range(3)], axis=1) for k in (0, 1))
    step = (change[1 + YIELD] - change[1 - YIELD]) / (2 * YIELD * compliance)
    for got, wanted in ((fixed, change[1.0]), (free, step)):
        assert np.linalg.norm(got - wanted) < 0.05 * np.linalg.norm(wanted)


def test_what_a_hypothesis_leaves():
    """`left` is the logged torque less the nominal one less columns times coefficients, table by table."""
    evidence = evidence_of(log_of(raw(*moved(seconds=20), torque=0.1)), ["viscous_friction"])
    one, tilt = candidate(evidence, "viscous_friction", 1), candidate(evidence, "base_tilt", None)
    left = evidence.residual((one, tilt), np.array([0.3, 0.1, -0.2]))
    for j, table in enumerate(evidence.tables):
        wanted = table[:, 0] - table[:, list(tilt.columns[j][1])] @ [0.1, -0.2]
        np.testing.assert_allclose(left[:, j], wanted - (j == 1) * 0.3 * column(evidence, "viscous_friction", 1))


def test_blocks_are_long_and_of_one_piece():
    """Every block is at least two seconds of one piece with one role; numbers count up without a gap."""
    evidence = evidence_of(log_of(raw(*moved(seconds=33))), ["viscous_friction"])
    assert np.array_equal(np.unique(evidence.block), np.arange(evidence.block.max() + 1))
    times = np.concatenate([p.t[evidence.recording.filter.rows(len(p.t))] for p in evidence.recording.pieces])
    for b in np.unique(evidence.block):
        own = evidence.block == b
        assert len({*zip(evidence.piece[own], evidence.role[own], strict=True)}) == 1
        assert np.ptp(times[own]) > BLOCK - 0.05


def test_a_slow_joint_moves_all_the_same():
    """A hundredth of the speed of the others' is no rest where it is the joint's usual speed."""
    t, m = moved()
    slow = np.array([1.0, 0.01, 1.0])
    evidence = evidence_of(log_of(raw(t, Motion(slow * m.q, slow * m.qd, slow * m.qdd))), [], cutoffs=(10.0,))
    assert np.all(evidence.valid.mean(0) > 0.8)


def test_a_joint_that_creeps_rests():
    """At 0.006 rad/s an encoder of 16 bit makes a step every 16 ms; the derivative between them turns back, but the
    joint does not: its friction is not asked for there."""
    rate, step, slow = 1000.0, 2 * np.pi / 2**16, 0.006
    t, m = moved(24.0, rate=rate)
    creeps = (t > 8) & (t < 16)
    qd = np.where(creeps, slow, m.qd[:, 1])
    q = m.q.copy()
    q[:, 1] = m.q[0, 1] + np.cumsum(qd) / rate
    one = raw(t, Motion(q, m.qd, m.qdd), torque=0.02, position=1e-6)
    evidence = evidence_of(log_of(replace(one, q=step * np.round(one.q / step))), [], cutoffs=(22.0,))
    inside = (evidence.on_rows("t") > 8.5) & (evidence.on_rows("t") < 15.5)
    assert evidence.on_rows("qd")[inside, 1].min() < 0  # so it seems
    assert not evidence.valid[inside, 1].any() and evidence.valid[:, 0].mean() > 0.8


def test_without_gravity_no_base_is_tilted():
    """What a tilt would turn is not there."""
    robot = replace(arm(), gravity=np.zeros(3))
    evidence = gather(robot, recording_of(log_of(raw(*moved()))), list(EFFECTS.values()), "unknown")
    assert not any(c.effect.name == "base_tilt" for c in evidence.candidates)


def test_a_joint_that_carries_no_inertia_has_no_gear_to_yield():
    """A URDF whose last link is massless: gears of the joints before it are tried, and none of the last joint's."""
    massless = replace(arm(), inertial=arm().inertial * np.array([1.0, 1.0, 0.0])[:, None])
    gears = [EFFECTS["joint_elasticity"], EFFECTS["backlash"]]
    evidence = gather(massless, recording_of(log_of(raw(*moved(10.0), torque=0.02))), gears, "unknown")
    assert {c.joint for c in evidence.candidates} == {0, 1}
