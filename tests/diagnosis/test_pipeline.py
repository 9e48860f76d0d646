"""From a log to its diagnosis: references, declared causes, windows, senseless logs; the same log says the same."""

from dataclasses import replace

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from experiments.arms import random_arm
from experiments.cases import inverse_dynamics
from experiments.confusion import claims
from experiments.worn import drawn
from invdyn_cli.diagnosis import diagnose, pipeline, since
from invdyn_cli.diagnosis.case import Options, prepared
from invdyn_cli.diagnosis.columns.evidence import Candidate
from invdyn_cli.diagnosis.search import judge, naming
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.errors import LogError
from invdyn_cli.functions import checking
from invdyn_cli.robots import load_urdf
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.simulation.plant import record
from invdyn_cli.simulation.references import ConstantSpeed, Multisine
from invdyn_cli.simulation.sensors import Noise
from tests.diagnosis import analytic
from tests.diagnosis.analytic import said

LOAD = {"mass": 0.8, "com": [0.02, -0.01, 0.1]}
DAMPING = 0.6


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """Path of a three-joint arm's URDF."""
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    path.write_text(random_arm(np.random.default_rng(0), 3))
    return path


@pytest.fixture(scope="module")
def robot(arm):
    """The arm as everybody believes it to be."""
    return load_urdf(arm)


@pytest.fixture(scope="module")
def rubbing(robot):
    """Viscous friction on all joints."""
    return [Hidden("viscous_friction", joint, {"damping": DAMPING}) for joint in robot.joints]


def recorded(robot, hidden, bases=(0.1,), duration=20.0, **options):
    """A log with little noise: multisines of these base frequencies [Hz]."""
    references = [Multisine(base=base) for base in bases]
    return record(robot, references, hidden, noise=Noise(position=1e-6, torque=0.02), duration=duration, **options)


@pytest.fixture(scope="module")
def loaded(robot, rubbing):
    """A log with friction and a payload."""
    return recorded(robot, [*rubbing, Hidden("payload", None, LOAD)], duration=14.0, seed=1)


FRICTION = {("viscous_friction", f"axis{i}") for i in (1, 2, 3)}


def test_linear_algebra_of_a_diagnosis_has_one_thread(monkeypatch, robot, loaded):
    """Two threads for small matrices wait for other processes' cores; what the caller has set is left as it was."""
    seen: list[set[int]] = []

    def look(*_, **__):
        seen.append({x["num_threads"] for x in threadpool_info() if x["user_api"] == "blas"})
        raise LogError("enough")

    monkeypatch.setattr(pipeline, "prepared", look)
    monkeypatch.setattr(checking, "located", look)
    with threadpool_limits(2, user_api="blas"):
        for start in (diagnose, checking.examine):
            with pytest.raises(LogError, match="enough"):
                start(loaded, robot)
        with pytest.raises(LogError, match="enough"):
            look()
    assert seen == [{1}, {1}, {2}]


def test_several_effects_at_once(loaded, robot):
    """A payload and friction on every joint: four claims, sizes within 5 % (the noise is a permille of the torque).
    The search says that it has one effect beside the standard model; the share that is done never falls."""
    told: list[tuple[float, str]] = []
    diagnosis = diagnose(loaded, robot, progress=lambda *now: told.append(now))
    shares, notes = zip(*told, strict=True)
    assert sorted(shares) == list(shares)
    assert "search, effects so far: 1" in notes
    assert said(diagnosis) == {("payload", None), *FRICTION}
    for f in claims(diagnosis):
        if f.effect == "viscous_friction":
            assert f.parameters["damping"].value == pytest.approx(DAMPING, rel=0.05)
        else:
            assert f.parameters["mass"].value == pytest.approx(LOAD["mass"], rel=0.05)
            np.testing.assert_allclose(f.parameters["com"].value, LOAD["com"], atol=0.005)


def test_a_declared_payload_is_not_reported(loaded, robot, arm):
    """Declared as known, or given with the robot: the friction is found, the payload is not; declared, it is part of
    the extended model all the same."""
    declared = diagnose(loaded, robot, options=Options(known=[{"effect": "payload", **LOAD}]))
    assert said(declared) == FRICTION
    (load,) = (a.parameters for a in declared.model.acting if a.effect.name == "payload")
    assert load["mass"] == LOAD["mass"]
    assert said(diagnose(loaded, load_urdf(arm, payload=LOAD))) == FRICTION


def test_a_reference_leaves_what_has_changed(loaded, robot, rubbing):
    """Beside an earlier log with the same friction only the payload is new. The written model is that of the robot as
    it is now: it has the friction that both logs show, within 5 %, and is off by a third of what a friction line is."""
    diagnosis = diagnose(loaded, robot, reference=recorded(robot, rubbing, duration=14.0, seed=2))
    assert said(diagnosis) == {("payload", None)}
    (found,) = claims(diagnosis)
    assert found.parameters["mass"].value == pytest.approx(LOAD["mass"], rel=0.05)
    terms = [a for a in diagnosis.model.acting if a.effect.name == "viscous_friction"]
    assert [a.parameters["damping"] for a in terms] == pytest.approx([DAMPING] * robot.dofs, rel=0.05)
    for joint, line in diagnosis.baselines["friction"].items():
        assert diagnosis.extended[joint]["rmse"] < line["rmse"] / 3
    assert not any(x["claimed"] for j in robot.joints for x in diagnosis.standard[j].values())
    assert diagnosis.summary.startswith("Since the reference, payload (or an alternative) has changed.")


def test_a_payload_that_was_taken_off_since_a_reference(loaded, robot, rubbing):
    """A tool that only the reference had is a payload of negative mass, with its centre, and no link that is lighter
    than its model."""
    diagnosis = diagnose(recorded(robot, rubbing, duration=14.0, seed=2), robot, reference=loaded)
    (found,) = claims(diagnosis)
    assert found.effect == "payload"
    assert found.parameters["mass"].value == pytest.approx(-LOAD["mass"], rel=0.05)
    np.testing.assert_allclose(found.parameters["com"].value, LOAD["com"], atol=0.005)


def test_a_drive_that_was_weak_for_a_time_since_a_reference(robot, rubbing):
    """Beside an earlier log with the same friction, a drive that was weaker for some seconds, drawn at random, is found
    with its factor within 2 % and its window within the 0.3 s in which a joint turns back."""
    draw = np.random.default_rng(11)
    gain, start, end = draw.uniform(0.6, 0.85), draw.uniform(3, 5), draw.uniform(9, 11)
    weak = Hidden("torque_gain_change", "axis2", {"gain": gain, "window": [start, end]})
    log = recorded(robot, [*rubbing, weak], duration=14.0, seed=1)
    diagnosis = diagnose(log, robot, reference=recorded(robot, rubbing, duration=14.0, seed=2))
    (found,) = claims(diagnosis)
    assert (found.effect, found.joint, found.status) == ("torque_gain_change", "axis2", "named")
    assert found.parameters["gain"].value == pytest.approx(gain, rel=0.02)
    assert found.window == pytest.approx((start, end), abs=0.3)
    assert diagnosis.summary.startswith("In this log only, and only for a time, there is torque gain change on axis2.")


@pytest.mark.benchmark  # a drive that was weak since a reference is looked for always
@pytest.mark.parametrize("weak_at_rest", [True, False])
def test_a_drive_that_was_weak_while_its_joint_moved(robot, weak_at_rest):
    """Joints that sweep one after the other: a drive that is weak from a second before its joint moves has, while that
    rests, the torque of a sound one, so that it may have become weak. Of one that always is, this is not said."""
    sweeps = ConstantSpeed(speeds=(0.3, 0.6), by_joint=True)
    plain = record(robot, [sweeps], noise=Noise(position=1e-6, torque=0.02), duration=30.0, seed=3)
    moves = np.abs(np.diff(plain.trajectories[0].q[:, 1])) > 1e-5
    start = 0.0 if weak_at_rest else plain.trajectories[0].t[np.argmax(moves)] - 1.0
    assert weak_at_rest or start > 3
    gain = float(np.random.default_rng(5).uniform(0.6, 0.85))
    weak = Hidden("torque_gain_error", "axis2", {"gain": gain})
    weak = weak if weak_at_rest else Hidden("torque_gain_change", "axis2", {"gain": gain, "window": [start, 30.0]})
    log = record(robot, [sweeps], [weak], noise=Noise(position=1e-6, torque=0.02), duration=30.0, seed=3)
    (found,) = claims(diagnose(log, robot))
    possible = {found.effect, *(name for one in found.alternatives for name in one)}
    assert "torque_gain_error" in possible and ("torque_gain_change" in possible) is not weak_at_rest


@pytest.mark.benchmark  # a payload and a Stribeck friction that came are looked for always
def test_friction_that_fell_since_a_reference(robot, rubbing):
    """A joint that has lost a part of its viscous friction, drawn at random, has a negative change within 5 %, and
    the written model has the friction that is left. Without a reference negative friction is refused."""
    left = DAMPING * float(np.random.default_rng(7).uniform(0.4, 0.8))
    fewer = [replace(x, parameters={"damping": left}) if x.joint == "axis2" else x for x in rubbing]
    later = recorded(robot, fewer, duration=14.0, seed=3)
    diagnosis = diagnose(later, robot, reference=recorded(robot, rubbing, duration=14.0, seed=4))
    (found,) = claims(diagnosis)
    assert (found.effect, found.joint) == ("viscous_friction", "axis2")
    assert found.parameters["damping"].value == pytest.approx(left - DAMPING, rel=0.05)
    terms = {a.joint: a.parameters["damping"] for a in diagnosis.model.acting if a.effect.name == "viscous_friction"}
    assert terms[1] == pytest.approx(left, rel=0.05)
    for name in ("viscous_friction", "coulomb_friction"):
        size = next(iter(EFFECTS[name].parameters))
        assert EFFECTS[name].refuse({size: -1.0}) and not EFFECTS[name].as_change().refuse({size: -1.0})


@pytest.mark.parametrize(("change", "claimed"), [(0.028, False), (-0.038, False), (0.2, True), (-0.2, True)])
def test_two_motions_of_an_arm_differ_by_some_percent(change, claimed):
    """A pair of logs of the same arm, a multisine and a pick and place, had Coulomb friction lower by 2.8 % and viscous
    friction higher by 3.8 % for sure, by their intervals. An offset that has come counts, however small."""
    before = np.array([[0.02, -0.5, 0.0]])
    assert np.all(since.beyond_motions(before, (1 + change) * before)[0, :2] == claimed)
    assert since.beyond_motions(before, before + 0.01)[0, 2]


def bristly(robot, coulomb, damping):
    """Bristles and viscous friction of these sizes (n,) on every joint."""
    return [
        one
        for joint, held, rubs in zip(robot.joints, coulomb, damping, strict=True)
        for one in (
            Hidden("presliding_hysteresis", joint, {"coulomb": float(held), "stiffness": 4000.0}),
            Hidden("viscous_friction", joint, {"damping": float(rubs)}),
        )
    ]


@pytest.fixture(scope="module")
def cold(robot):
    """Sizes (2, n) of bristles and viscous friction, drawn at random, and a log of an arm with them."""
    sizes = np.random.default_rng(9).uniform(0.2, 0.6, (2, robot.dofs))
    return sizes, recorded(robot, bristly(robot, *sizes), (0.1,), duration=20.0, seed=11)


@pytest.mark.benchmark  # up to 40 s; one joint whose friction fell is below
def test_all_joints_that_warmed_up_since_a_reference(robot, cold):
    """Friction of all joints falls by shares drawn at random, 15 to 25 %, with another motion than in the reference;
    both logs have bristles at every reversal. Nothing else has changed. The table tells both logs' own sizes within
    7 %, because bristles look viscous in part, and changes of a fifth, whose errors partly cancel, within 15 % of
    themselves."""
    sizes, before = cold
    warm = np.random.default_rng(10).uniform(0.75, 0.85, sizes.shape)
    later = recorded(robot, bristly(robot, *(warm * sizes)), (0.15,), duration=20.0, seed=12)
    diagnosis = diagnose(later, robot, reference=before)
    found = {(f.effect, f.joint): next(iter(f.parameters.values())).value for f in claims(diagnosis)}
    names = ("coulomb_friction", "viscous_friction")
    changes = {(name, j): x for name, row in zip(names, (warm - 1) * sizes, strict=True) for j, x in enumerate(row)}
    assert found == pytest.approx({(name, robot.joints[j]): x for (name, j), x in changes.items()}, rel=0.15)
    for j, joint in enumerate(robot.joints):
        for k, term in enumerate(("coulomb", "viscous")):
            row = diagnosis.standard[joint][term]
            assert row["reference"][0] == pytest.approx(sizes[k, j], rel=0.07) and row["differ"]
            assert row["now"][0] == pytest.approx((warm * sizes)[k, j], rel=0.07)


@pytest.mark.benchmark  # half a minute; nothing has changed below, too
def test_of_two_logs_of_an_arm_with_bristles_nothing_differs(robot, cold):
    """The table tells no standard term of the same arm as changed, with another motion."""
    sizes, before = cold
    same = recorded(robot, bristly(robot, *sizes), (0.12,), duration=20.0, seed=11)
    rows = [x for joint in robot.joints for x in diagnose(same, robot, reference=before).standard[joint].values()]
    assert not any(x.get("differ") for x in rows)


@pytest.mark.benchmark  # 36 s of sweeps; joints that share a gear are in test_hidden
def test_joints_that_move_one_after_the_other_share_no_gear(robot):
    """Friction of two joints that never move at the same time is that of each, though a shared drive would be one
    effect fewer; the log cannot show such a drive."""
    hidden = [Hidden("coulomb_friction", joint, {"coulomb": 1.5}) for joint in robot.joints]
    log = record(robot, [ConstantSpeed()], hidden, noise=Noise(position=1e-6, torque=0.02), duration=36.0, seed=13)
    diagnosis = diagnose(log, robot)
    assert {(f.effect, f.joint) for f in claims(diagnosis)} == {("coulomb_friction", joint) for joint in robot.joints}
    hidden_ones = {f.joint for f in diagnosis.findings if f.effect == "coupled_friction" and f.status == "not_excited"}
    assert hidden_ones == {"axis2", "axis3"}


GANTRY = """<robot name="gantry"><link name="base"/>
<link name="x"><inertial><mass value="9"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="y"><inertial><mass value="6"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="along" type="prismatic"><parent link="base"/><child link="x"/><axis xyz="1 0 0"/>
<limit lower="-0.8" upper="0.8" velocity="1.0" effort="900"/></joint>
<joint name="across" type="prismatic"><parent link="x"/><child link="y"/><axis xyz="0 1 0"/>
<limit lower="-0.5" upper="0.5" velocity="1.0" effort="900"/></joint></robot>"""


@pytest.mark.benchmark  # tests of naming.simplified have the same of a made-up pool
def test_the_rotor_of_a_slide_is_no_weak_drive(tmp_path):
    """A slide pushes one mass: a rotor, drawn at random, makes the same force as a drive that gives a part of what is
    logged, and every drive has one. Friction is then told as it is, within 3 %; the gain is the alternative, and if a
    search comes to it, the rotor takes its place."""
    (tmp_path / "gantry.urdf").write_text(GANTRY)
    gantry = load_urdf(tmp_path / "gantry.urdf")
    rotor, coulomb = np.random.default_rng(14).uniform([6.0, 10.0], [12.0, 20.0])
    hidden = [
        Hidden("rotor_inertia", "along", {"armature": float(rotor)}),
        Hidden("coulomb_friction", "along", {"coulomb": float(coulomb)}),
    ]
    log = recorded(gantry, hidden, (0.3,), seed=15)
    inquiry, _ = pipeline.searched(prepared(log, gantry, None, None, Options(), EFFECTS))
    rest = tuple(c for c in inquiry.hypothesis if c.effect.name != "rotor_inertia")
    gains = [c for c in inquiry.pool if c.key == ("torque_gain_error", 0)]
    gain = min(gains, key=lambda c: inquiry.judge.loss((*inquiry.always, *rest, c)))
    simpler = naming.simplified(inquiry.judge, inquiry.always, (*rest, gain), inquiry.pool)
    assert {c.key for c in simpler} == {c.key for c in rest} | {("rotor_inertia", 0)}
    diagnosis = diagnose(log, gantry)
    found = {f.effect: f for f in claims(diagnosis) if f.joint == "along"}
    assert "torque_gain_error" not in found and ("torque_gain_error",) in found["rotor_inertia"].alternatives
    row = diagnosis.standard["along"]
    sizes = [row[term]["value"] for term in ("armature", "coulomb")]
    np.testing.assert_allclose(sizes, [rotor, coulomb], rtol=0.03)


@pytest.mark.parametrize("beside", ["load_dependent_friction", "viscous_friction"])
def test_friction_does_not_fall_beside_what_looks_like_it(beside):
    """Less Coulomb friction beside a new friction that grows with the load corrects that one's formula; less viscous
    friction beside it may be true, and so may it fall on another joint."""
    one = Candidate(EFFECTS["coulomb_friction"].as_change(), 1, {}, {}, np.zeros(1))
    others = [Candidate(EFFECTS[beside], joint, {}, {}, np.zeros(1)) for joint in (1, 2)]
    refused = [bool(judge.falls_beside_its_like(one, np.array([-0.3]), [one, x])) for x in others]
    assert refused == [beside == "load_dependent_friction", False]
    assert not judge.falls_beside_its_like(one, np.array([0.3]), [one, *others])


@pytest.mark.benchmark  # the drive that was weak for a time is such a one
def test_a_drive_that_became_weaker_since_a_reference(robot, rubbing):
    """A drive's gain, drawn at random, scales friction that was there before, too; that is no lighter link with less
    friction, and the gain is told within 1 %."""
    worn = [*rubbing, *[Hidden("coulomb_friction", joint, {"coulomb": 1.5}) for joint in robot.joints]]
    gain = float(np.random.default_rng(8).uniform(0.8, 0.9))
    later = recorded(robot, [*worn, Hidden("torque_gain_error", "axis3", {"gain": gain})], duration=14.0, seed=7)
    diagnosis = diagnose(later, robot, reference=recorded(robot, worn, duration=14.0, seed=8))
    (found,) = claims(diagnosis)
    assert (found.effect, found.joint) == ("torque_gain_error", "axis3")
    assert found.parameters["gain"].value == pytest.approx(gain, rel=0.01)


@pytest.mark.benchmark  # a quarter of a minute
def test_changes_that_predict_worse_are_not_told():
    """A joint turns for some seconds in each log, and its drive became weaker. Fitted by itself, each log shows another
    offset, which alone predicts held-out data worse than no change does; friction or a gain predict them better, and
    the log does not tell which."""
    one = drawn(21004, "torque_gain_error")
    (found,) = claims(diagnose(one.log, one.scene.robot, reference=one.before()))
    assert found.status == "ambiguous"
    assert "torque_gain_error" in {found.effect, *(name for names in found.alternatives for name in names)}


def test_nothing_has_changed_since_a_reference(robot, rubbing):
    """Two logs of the same arm: no change, and the error told is that of one model of both."""
    both = [recorded(robot, rubbing, duration=14.0, seed=seed) for seed in (5, 6)]
    diagnosis = diagnose(both[0], robot, reference=both[1])
    assert not claims(diagnosis) and "No change since the reference was identified" in diagnosis.summary
    error = float(diagnosis.summary.split(" of one model of both logs is ")[1].split()[0])
    assert error < 0.03  # the noise is 0.02 N m


@pytest.fixture(scope="module")
def twice(robot):
    """Two trajectories with Coulomb friction on one joint."""
    hidden = [Hidden("coulomb_friction", "axis2", {"coulomb": 1.5})]
    return recorded(robot, hidden, (0.1, 0.15), duration=14.0)


WINDOWS = {
    "the first chooses": {"train": [("trajectory_1", 0.0, np.inf)], "test": [("trajectory_2", 0.0, np.inf)]},
    "the second chooses": {"train": [("trajectory_2", 0.0, np.inf)], "test": [("trajectory_1", 0.0, np.inf)]},
    "stretches": {
        "train": [("trajectory_1", 3.0, 10.0), ("trajectory_2", 2.0, 6.0)],
        "test": [("trajectory_2", 7.0, 12.0)],
    },
}


@pytest.fixture(scope="module")
def usual(twice, robot):
    """Its diagnosis."""
    return diagnose(twice, robot)


@pytest.mark.benchmark  # the order of trajectories does not matter, below
@pytest.mark.parametrize("windows", WINDOWS)
def test_it_does_not_matter_what_chooses(windows, twice, robot):
    """Whichever stretches choose and judge, the same cause is found, its size within 2 %."""
    (found,) = claims(diagnose(twice, robot, windows=WINDOWS[windows]))
    assert (found.effect, found.joint, found.status) == ("coulomb_friction", "axis2", "named")
    assert found.parameters["coulomb"].value == pytest.approx(1.5, rel=0.02)


@pytest.mark.benchmark  # rows and blocks are summed
def test_the_order_of_trajectories_does_not_matter(usual, twice, robot):
    """The same log with its trajectories the other way round gives the same cause; its size differs by less than its
    interval is wide."""
    (one,) = claims(usual)
    (other,) = claims(diagnose(replace(twice, trajectories=twice.trajectories[::-1]), robot))
    assert (one.effect, one.joint, one.status) == (other.effect, other.joint, other.status)
    low, high = one.parameters["coulomb"].interval95
    assert abs(one.parameters["coulomb"].value - other.parameters["coulomb"].value) < high - low


def test_the_same_log_gives_the_same_diagnosis(usual, twice, robot):
    """Nothing is left to chance: twice the same numbers, to the last bit."""
    other = diagnose(twice, robot)
    assert usual.findings == other.findings and usual.unexplained == other.unexplained


def zero(raw, robot):
    return replace(raw, q=0 * raw.q, tau=0 * raw.tau)


def constant(raw, robot):
    return replace(raw, q=raw.q[:1] + 0 * raw.q, tau=raw.tau[:1] + 0 * raw.tau)


def one_joint(raw, robot):
    """Only the second joint moves, and the torques are the nominal ones with a little noise."""
    t, still = raw.t[:, None], np.zeros((len(raw.t), robot.dofs))
    q, qd, qdd = (still.copy() for _ in range(3))
    for size, w in ((0.5, 2.0), (0.3, 3.7)):
        q[:, 1:2] += size * np.sin(w * t)
        qd[:, 1:2] += size * w * np.cos(w * t)
        qdd[:, 1:2] -= size * w**2 * np.sin(w * t)
    tau = inverse_dynamics(robot, q, qd, qdd)
    return replace(raw, q=q, tau=tau + 0.02 * np.random.default_rng(0).normal(size=tau.shape))


def noise(raw, robot):
    return replace(raw, tau=10 * np.random.default_rng(0).normal(size=raw.tau.shape))


def short(raw, robot):
    return replace(raw, **{x: getattr(raw, x)[:500] for x in ("t", "q", "tau")})


SENSELESS = {f.__name__: f for f in (zero, constant, one_joint, noise, short)}


@pytest.mark.parametrize("name", SENSELESS)
def test_a_senseless_log_names_nothing(name, twice, robot):
    """Whatever is in a log, there is a verdict in words, and no name."""
    raw = replace(twice.trajectories[0], qd=None, qdd=None, q_ref=None, q_link=None)
    diagnosis = diagnose(replace(twice, trajectories=(SENSELESS[name](raw, robot),)), robot)
    assert diagnosis.verdict in ("nothing_found", "log_unusable")
    assert said(diagnosis) == set() and diagnosis.summary
    assert (diagnosis.model is None) == (diagnosis.verdict == "log_unusable")


def test_nothing_is_corrected_on_request(loaded, robot):
    """With `correct=False` a wild sample that is else interpolated stays; notes and written model say so."""
    raw = loaded.trajectories[0]
    tau = raw.tau.copy()
    tau[len(tau) // 2, 0] += 5 * np.ptp(tau[:, 0])
    wild = replace(loaded, trajectories=(replace(raw, tau=tau), *loaded.trajectories[1:]))
    made = diagnose(wild, robot, options=Options(correct=False))
    assert [c.check for c in made.examination.checks if c.severity == "warn"] == ["outliers"]
    assert made.examination.as_recorded and made.examination.corrections == ()
    assert any("as recorded" in note for note in made.notes)
    assert made.model is not None
    assert made.model.provenance["as_recorded"] is True and made.model.provenance["corrections"] == []


def test_friction_that_a_log_calls_compensated_and_has():
    """A drive that subtracts Coulomb friction, says so, and leaves 1 N m of it: that is told on every joint of the worn
    arm, not searched for."""
    robot, (t, m) = analytic.arm(), analytic.moved(seconds=8.0, rate=200.0)
    other = replace(robot, inertial=robot.inertial * np.random.default_rng(3).uniform(0.85, 1.15, 3)[:, None])
    friction = np.sign(m.qd) + 0.4 * m.qd + analytic.beyond(robot, other, m)
    log = analytic.log_of(analytic.raw(t, m, lambda *_: friction, torque=0.05, position=1e-5))
    found = diagnose(replace(log, compensated=("coulomb_friction",)), robot)
    sizes = [f.parameters["coulomb"].value for f in claims(found) if f.effect == "coulomb_friction"]
    assert sizes == pytest.approx([1.0] * 3, rel=0.05) and found.verdict == "explained"


def rubbed(seed: int, coulomb: float, drop: float):
    """A log of the arm with Coulomb friction of 1 N m and viscous friction, and on its second joint this much more
    Coulomb friction, and a Stribeck friction that falls by `drop` [N m] over 0.08 rad/s."""
    t, m = analytic.moved(seconds=30.0, rate=200.0, seed=seed)
    friction = np.sign(m.qd) + 0.4 * m.qd
    friction[:, 1] += (coulomb + drop * np.exp(-((m.qd[:, 1] / 0.08) ** 2))) * np.sign(m.qd[:, 1])
    return analytic.log_of(analytic.raw(t, m, lambda *_: friction, torque=0.02, position=1e-6, seed=seed))


def test_stribeck_friction_that_has_come_since_a_reference():
    """A change may have any ratio of its levels, here 4: it is named within 5 %, and each log's Coulomb friction is
    told with what has come, to 1 %."""
    robot, (extra, drop) = analytic.arm(), (0.5, 1.5)
    found = diagnose(rubbed(4, extra, drop), robot, reference=rubbed(0, 0.0, 0.0))
    (one,) = claims(found)
    assert (one.effect, one.joint, one.status) == ("stribeck_friction", robot.joints[1], "named")
    sizes = [one.parameters[x].value for x in ("coulomb", "static", "velocity")]
    assert sizes == pytest.approx([extra, extra + drop, 0.08], rel=0.05)
    row = found.standard[robot.joints[1]]["coulomb"]
    assert (row["reference"][0], row["now"][0], row["value"]) == pytest.approx((1.0, 1.5, 1.5), rel=0.01)
    assert row["differ"] and row["with"] == ["stribeck_friction"]
