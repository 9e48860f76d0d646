"""real_log: learning never sees what is tested on, all channels pass one filter, every misuse is one line."""

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest

from invdyn_cli.data.recorded import RealLog
from invdyn_cli.errors import InvdynError, LogError, RobotError, UsageError
from invdyn_cli.types import Robot
from tests.logs import make_log, motion, positions

REAL = Path(os.environ.get("INVDYN_REAL_DATA", Path(__file__).parents[2].parent / "shared" / "data"))


@pytest.fixture
def log(tmp_path):
    """Makes a log in the test's folder: log({"run": motion()}) -> its path as text."""
    return lambda trajectories=None, name="arm", **header: str(
        make_log(tmp_path / f"{name}.h5", trajectories, **header)
    )


def robot(*joints):
    """A robot of which only the joints' names matter."""
    n = len(joints)
    three, one, zero = np.zeros((n, 3)), np.ones(n), np.zeros(n)
    turn = np.tile(np.eye(3), (n, 1, 1))
    return Robot(
        "toy", joints, tuple(range(-1, n - 1)), (False,) * n, turn, three, three, np.zeros((n, 10)),
        np.zeros(3), -one, one, one, one, zero, zero,
    )  # fmt: skip


def only(dataset):
    """The one trajectory of a dataset."""
    [trajectory] = dataset.trajectories
    return trajectory


def whole(path, **options):
    """The one trajectory that RealLog makes of "run", "other" being there to be tested on."""
    return only(RealLog(path, train=["run"], test=["other"], validation=[], **options).load(None).train)


# What is split how


def test_header_says_what_the_log_knows_of_its_robot(log, tmp_path):
    """Robot, joints and a URDF path that can be opened, without reading any trajectory."""
    header = RealLog(log({"broken": motion() | {"q": np.full((1000, 2), np.nan)}})).header()
    assert (header.robot, header.joints, header.urdf) == ("two_link", ("shoulder", "elbow"), str(tmp_path / "arm.urdf"))


def test_default_split_is_blocks_in_time(log):
    """70 % of the time to learn from, its last tenth to watch, the last 30 % to test; nothing shuffled or twice."""
    splits = RealLog(log({"a": motion(), "b": motion(20.0)}), filter_cutoff=None).load(None)
    sets = (splits.train, splits.validation, splits.tests["test"])
    for i, seconds in ((0, 10.0), (1, 20.0)):
        clocks = [data.trajectories[i].t for data in sets]
        np.testing.assert_allclose([t[-1] / seconds for t in clocks], [0.63, 0.7, 1.0], atol=2e-3)
        np.testing.assert_allclose(np.concatenate(clocks), np.arange(seconds * 100) / 100)
    assert [x.name for x in splits.train.trajectories] == ["a[0:6.29]", "b[0:12.59]"]


def test_shares_can_be_set(log):
    """train_share and validation_share move the cuts; no validation share gives no validation set."""
    splits = RealLog(log(), train_share=0.5, validation_share=0.0, filter_cutoff=None).load(None)
    assert (splits.train.samples, splits.validation, splits.tests["test"].samples) == (500, None, 500)


def test_windows_are_half_open_seconds(log):
    """name[t0:t1] takes t0 <= t < t1, open ends reach to the trajectory's, and touching windows are no overlap."""
    path = log({"run": motion(), "x": motion()})
    source = RealLog(path, ["run[:2.5]", "x[1e0 : 2]"], ["run[2.5:4]"], ["run[4:]", "x[9.5:]"], filter_cutoff=None)
    splits = source.load(None)
    ranges = [
        [(x.t[0], x.t[-1]) for x in data.trajectories]
        for data in (splits.train, splits.validation, splits.tests["test"])
    ]
    assert ranges == [[(0.0, 2.49), (1.0, 1.99)], [(2.5, 3.99)], [(4.0, 9.99), (9.5, 9.99)]]


def test_with_train_or_test_alone_the_other_takes_the_rest(log):
    """Trajectories that nobody named go, whole, to the set that was not given."""
    path = log({"a": motion(), "b": motion(), "c": motion()})
    by_train = RealLog(path, train=["a", "b"]).load(None)
    by_test = RealLog(path, test="c", validation=["a"]).load(None)
    assert [x.name for x in by_train.tests["test"].trajectories] == ["c"]
    assert [x["window"] for x in by_train.description["validation"]] == [[9.0, 9.99]] * 2
    assert [x.name for x in by_test.train.trajectories] == ["b"]


def test_validation_named_by_the_user_is_left_out_of_the_default_split(log):
    """An explicit validation trajectory is watched whole; the others are split without a validation block."""
    splits = RealLog(log({"a": motion(), "b": motion()}), validation=["b"], filter_cutoff=None).load(None)
    assert (splits.train.samples, splits.validation.samples, splits.tests["test"].samples) == (700, 1000, 300)


def test_several_logs_are_one_source(log):
    """Trajectories are called stem/name; a plain name will do where only one log has it."""
    paths = [log({"run": motion(), "only": motion()}, "monday"), log({"run": motion()}, "tuesday")]
    splits = RealLog(paths, train=["only", "monday/run"], test=["tuesday/run"]).load(None)
    assert [x["trajectory"] for x in splits.description["train"]] == ["monday/only", "monday/run"]
    assert only(splits.tests["test"]).name == "tuesday/run"


def test_columns_follow_the_robots_order(log):
    """Joints are matched by name: a robot that counts them the other way round gets its columns turned round."""
    path = log(torque_unit="A", drive_gain_N_m_per_A=[2.0, 5.0])
    straight, turned = (
        RealLog(path).load(robot(*names)).train for names in (("shoulder", "elbow"), ("elbow", "shoulder"))
    )
    assert turned.joints == ("elbow", "shoulder")
    for one, other in ((straight.tau, turned.tau), (straight.motion.qdd, turned.motion.qdd)):
        np.testing.assert_array_equal(one[:, ::-1], other)


def test_foreign_joint_names_are_taken_in_order_and_noted(log):
    """As many joints under other names are accepted in the log's order, and the record says so."""
    splits = RealLog(log()).load(robot("j1", "j2"))
    assert splits.train.joints == ("j1", "j2") and "shoulder, elbow are read as" in splits.description["notes"][0]


def test_the_description_is_plain_json(log):
    """The description says in plain JSON what went where."""
    description = RealLog(log()).load(None).description
    assert json.loads(json.dumps(description))["train"][0]["window"] == [0.0, 6.29]


def test_progress_ends_at_one(log):
    """Progress climbs to 1 and names the block."""
    seen = []
    RealLog(log()).load(None, lambda share, note: seen.append((share, note)))
    assert [share for share, _ in seen] == sorted(share for share, _ in seen) and seen[-1][0] == 1.0
    assert seen[0][1].startswith("run[:")


# What happens to a block


@pytest.mark.parametrize("derivatives", ["positions", "auto"])
def test_a_sine_gives_its_analytic_derivatives(log, derivatives):
    """Filtered and differentiated, sines keep q and qd within 1e-3 of the truth, qdd within 5e-3, ends included."""
    make = positions if derivatives == "auto" else motion
    run = whole(log({"run": make(rate=1000.0), "other": make(rate=1000.0)}, rate=1000.0), derivatives=derivatives)
    true = motion(t=run.t)
    for name in ("q", "qd", "qdd"):
        error = np.abs(getattr(run.motion, name) - true[name]) / np.abs(true[name]).max(axis=0)
        np.testing.assert_array_less(error, 5e-3 if name == "qdd" else 1e-3, err_msg=name)


def test_torque_and_motion_pass_the_same_filter(log):
    """tau = 3 q with any noise in q survives resampling, filter and thinning to 1e-10: all are filtered alike."""
    rng = np.random.default_rng(0)
    t = np.sort(rng.uniform(0, 10, 1000))
    run = motion(t=t)
    run["q"] += 0.1 * rng.standard_normal(run["q"].shape)
    run |= {"tau": 3 * run["q"], "qd": -2 * run["q"], "qdd": 5 * run["q"]}
    made = whole(log({"run": run, "other": motion()}), decimate=3, max_gap=1.0)
    for factor, values in ((3, made.tau), (-2, made.motion.qd), (5, made.motion.qdd)):
        np.testing.assert_allclose(values, factor * made.motion.q, atol=1e-10)


def test_the_filter_takes_noise_and_leaves_the_phase(log):
    """A disturbance of 1 rad at 40 Hz is gone to 1e-4, and the sine under it is where it was."""
    run = positions(rate=1000.0)
    run["q"] += np.sin(2 * np.pi * 40 * run["t"])[:, None]
    made = whole(log({"run": run, "other": run}, rate=1000.0))
    np.testing.assert_allclose(made.motion.q[300:-300], motion(t=made.t)["q"][300:-300], atol=1e-4)


@pytest.mark.parametrize("make", [motion, positions])
def test_nothing_leaks_across_the_split(log, make):
    """Other samples in the tested part change not one bit of what is learned from or watched."""
    spoilt = make()
    spoilt["q"][spoilt["t"] > 0.7 * spoilt["t"][-1]] += 100.0
    one, other = (RealLog(log({"run": run}, name)).load(None) for run, name in ((make(), "one"), (spoilt, "other")))
    for kind in ("train", "validation"):
        first, second = only(getattr(one, kind)), only(getattr(other, kind))
        for name in ("q", "qd", "qdd"):
            np.testing.assert_array_equal(getattr(first.motion, name), getattr(second.motion, name))
    assert np.abs(only(one.tests["test"]).motion.q - only(other.tests["test"]).motion.q).min() > 90


def test_logged_derivatives_are_used_unless_positions_are_asked_for(log):
    """auto and logged take what was logged, positions ignores it; a logged qd alone is differentiated to qdd."""
    wrong = motion() | {"qd": motion()["qd"] * 2, "qdd": motion()["qdd"] * 2}
    halfway = {name: x for name, x in wrong.items() if name != "qdd"}
    path = log({"run": wrong, "halfway": halfway, "other": motion()})
    true = {name: np.abs(x).max() for name, x in motion().items()}
    for derivatives, name, factors in (
        ("logged", "run", (2, 2)),
        ("auto", "run", (2, 2)),
        ("auto", "halfway", (2, 2)),
        ("positions", "run", (1, 1)),
    ):
        made = only(RealLog(path, [name], [], ["other"], derivatives=derivatives).load(None).train)
        found = np.abs(made.motion.qd).max() / true["qd"], np.abs(made.motion.qdd).max() / true["qdd"]
        np.testing.assert_allclose(found, factors, rtol=0.02)


@pytest.mark.parametrize("make", [motion, positions])
@pytest.mark.parametrize("lag", [1, 3])
def test_torque_lag_pairs_a_state_with_an_earlier_torque(log, make, lag):
    """With lag k the state at t stands beside the torque that was logged k samples before."""
    path = log({"run": make(), "other": make()})
    plain, lagged = whole(path), whole(path, torque_lag=lag)
    np.testing.assert_array_equal(lagged.t, plain.t[lag:])
    np.testing.assert_array_equal(lagged.motion.q, plain.motion.q[lag:])
    np.testing.assert_array_equal(lagged.tau, plain.tau[:-lag])


def test_jitter_is_undone(log):
    """Samples taken at jittery times come out on a uniform clock, as the same sines within 1e-3."""
    rng = np.random.default_rng(1)
    t = np.arange(2000) / 200 + rng.uniform(-0.4, 0.4, 2000) / 200
    made = whole(log({"run": positions(t=t), "other": positions()}, rate=200.0))
    np.testing.assert_allclose(np.diff(made.t), 1 / 200, rtol=1e-9)
    np.testing.assert_allclose(made.motion.q, motion(t=made.t)["q"], atol=1e-3)


def test_a_uniform_clock_is_left_alone(log):
    """Without a filter, samples on a uniform clock come out bit for bit."""
    made, run = whole(log({"run": motion(), "other": motion()}), filter_cutoff=None, rate=100.0), motion()
    np.testing.assert_array_equal(made.tau, run["tau"])
    np.testing.assert_array_equal(made.motion.qdd, run["qdd"])


@pytest.mark.parametrize(
    ("nominal", "option", "expected"), [(110.0, None, 110.0), (500.0, None, 100.0), (100.0, 250.0, 250.0)]
)
def test_the_clock_is_the_nominal_one_unless_it_is_wrong(log, nominal, option, expected):
    """A nominal rate within 20 % of the median step is believed, another is not, and data.rate beats both."""
    made = whole(log({"run": motion(), "other": motion()}, rate=nominal), rate=option)
    np.testing.assert_allclose(np.diff(made.t), 1 / expected, rtol=1e-6)


def test_gaps_split_and_are_never_bridged(log):
    """A pause of more than max_gap makes two trajectories, each filtered on its own, without a sample in between."""
    t = np.concatenate([np.arange(400), np.arange(600, 1000)]) / 100
    splits = RealLog(log({"run": positions(t=t), "other": positions()}), ["run"], [], ["other"]).load(None)
    first, second = splits.train.trajectories
    assert (first.name, second.name) == ("run[0:3.99]", "run[6:9.99]")
    assert first.t[-1] < 4 and second.t[0] >= 6
    np.testing.assert_allclose(second.motion.qdd, motion(t=second.t)["qdd"], atol=0.3)
    assert whole(log({"run": positions(t=t), "other": positions()}), max_gap=3.0).name == "run"


def test_decimation_thins_what_was_filtered(log):
    """decimate=5 keeps every fifth of exactly the samples that there are without it."""
    path = log({"run": motion(), "other": motion()})
    full, thin = whole(path), whole(path, decimate=5)
    np.testing.assert_array_equal(thin.motion.qdd, full.motion.qdd[::5])
    np.testing.assert_array_equal(thin.tau, full.tau[::5])


@pytest.mark.parametrize(("option", "gains"), [(None, [2.0, -4.0]), ([10.0, 20.0], [10.0, 20.0])])
def test_currents_become_torques(log, option, gains):
    """Torques in A are multiplied by the log's drive gains, or by those of data.drive_gain."""
    header = {"torque_unit": "A"} | ({} if option else {"drive_gain_N_m_per_A": gains})
    amperes = whole(log({"run": motion(), "other": motion()}, **header), drive_gain=option)
    newton_metres = whole(log({"run": motion(), "other": motion()}, "nm"))
    np.testing.assert_allclose(amperes.tau, newton_metres.tau * gains, atol=1e-12)


def test_poses_need_no_clock(log):
    """With logged derivatives and no filter, seconds between samples neither split nor resample a log of poses."""
    poses = motion(t=np.arange(50) * 6.0)
    made = whole(log({"run": poses, "other": poses}), derivatives="logged", filter_cutoff=None)
    np.testing.assert_array_equal(made.t, poses["t"])
    np.testing.assert_array_equal(made.tau, poses["tau"])


def test_a_short_trajectory_is_left_out_of_the_default_split_and_noted(log):
    """What is too short to be filtered is dropped with a note; the others are used."""
    splits = RealLog(log({"run": positions(), "blip": positions(seconds=0.3)})).load(None)
    assert {x["trajectory"] for x in (*splits.description["train"], *splits.description["test"])} == {"run"}
    assert any(
        re.match(r"blip.*too short: 43 samples at 100 Hz are needed", note) for note in splits.description["notes"]
    )


# What is refused


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"train": ["run[0:5"]}, UsageError, [r"data.train: 'run\[0:5' is not a selection", "name.t0:t1."]),
        ({"test": ["run[5]"]}, UsageError, [r"data.test: 'run\[5\]' is not a selection"]),
        ({"train": ["run[a:b]"]}, UsageError, ["not a selection"]),
        ({"train": ["run[5:2]"]}, UsageError, [r"'run\[5:2\]' is empty", "t0 < t1"]),
        ({"train": ["run[20:]"], "test": ["x"]}, LogError, [r"no samples in run\[20:\]", "from 0 s to 9.99 s"]),
        ({"train": ["rum"]}, LogError, ["data.train: no trajectory 'rum', did you mean 'run'", "run, x"]),
        ({"train": ["run"], "test": ["run[8:]", "x"]}, UsageError, [r"train 'run' and data.test 'run\[8:\]' overlap"]),
        ({"train": ["run[:6]"], "test": ["run[5:]"]}, UsageError, [r"overlap in 'run\[5:6\]'"]),
        ({"train": ["x"], "validation": ["run"], "test": ["run"]}, UsageError, ["validation 'run' and data.test"]),
        ({"train": ["x", "x"]}, UsageError, ["data.train 'x' and data.train 'x'"]),
        ({"train": ["run", "x"]}, LogError, ["data.test is empty", "no trajectory is left"]),
        ({"train": []}, LogError, ["data.train is empty"]),
        ({"train": ["run[1:1.2]"], "test": ["x"]}, LogError, [r"run\[1:1", "43 samples at 100 Hz", "longest has"]),
        ({"derivatives": "logged"}, LogError, ["derivatives=logged", "'run' lacks qd and qdd", "auto"]),
        ({"derivatives": "spline"}, UsageError, ["data.derivatives=spline; allowed: auto, logged, positions"]),
        ({"filter_cutoff": 50.0}, UsageError, ["data.filter_cutoff=50 Hz", "'run' at 100 Hz", "below half"]),
        ({"filter_cutoff": 0.0}, UsageError, ["data.filter_cutoff=0 Hz", "above 0"]),
        ({"filter_order": 0}, UsageError, ["data.filter_order=0"]),
        ({"torque_lag": -1}, UsageError, ["data.torque_lag=-1", "0 or more"]),
        ({"torque_lag": 0.5}, UsageError, ["data.torque_lag=0.5", "whole number"]),
        ({"decimate": 2.0}, UsageError, ["data.decimate=2.0", "whole number"]),
        ({"decimate": 0}, UsageError, ["data.decimate=0", "1 or more"]),
        ({"decimate": "two"}, UsageError, ["data.decimate=two", "a number"]),
        ({"max_gap": None}, UsageError, ["data.max_gap=None"]),
        ({"max_gap": 0.0}, UsageError, ["data.max_gap=0.0", "above 0 s"]),
        ({"max_gap": 0.001}, LogError, ["data.train is empty", "the longest has 1"]),
        ({"rate": -5.0}, UsageError, ["data.rate=-5.0"]),
        ({"rate": 50.0}, UsageError, ["data.rate=50", "logged at 100 Hz", "data.decimate"]),
        ({"train_share": 1.0}, UsageError, ["data.train_share=1.0"]),
        ({"validation_share": -0.1}, UsageError, ["data.validation_share=-0.1"]),
        ({"drive_gain": [1.0, 2.0]}, UsageError, ["data.drive_gain is given, but the torques are in N m"]),
        ({"drive_gain": ["x", 2.0]}, UsageError, [r"data.drive_gain\[0\]=x"]),
    ],
)  # fmt: skip
def test_misuse_is_refused_in_one_line(log, options, error, words):
    """Every option that makes no sense here is refused by name, with what is allowed."""
    refused(lambda: RealLog(log({"run": positions(), "x": positions()}), **options).load(None), error, *words)


def refused(call, error, *words):
    """The call raises this InvdynError, of one line in which all words occur."""
    with pytest.raises(InvdynError) as caught:
        call()
    line = str(caught.value)
    assert type(caught.value) is error and "\n" not in line
    for word in words:
        assert re.search(word, line), f"{word!r} is not in: {line}"


def test_wrong_drive_gains_are_refused(log):
    """As many gains as joints; without any, the option that sets them is named."""
    path = log(torque_unit="A")
    refused(lambda: RealLog(path, drive_gain=[1.0]).load(None), LogError, r"drive gains \[1.0\]", "2 numbers")
    refused(lambda: RealLog(path).load(None), LogError, r"data.drive_gain=\[")


def test_logs_that_do_not_belong_together_are_refused(log):
    """Other joints, equal file names, and a name that two logs have."""
    a, b = log(name="a"), log(name="b")
    other = log(name="other", joint_names=["x", "y"])
    refused(lambda: RealLog([a, other]).header(), LogError, "other.h5 has joints x, y", "a.h5 has shoulder, elbow")
    refused(lambda: RealLog([a, a]).load(None), UsageError, "data.path=", "different names")
    refused(lambda: RealLog([]).load(None), UsageError, "data.path=")
    refused(lambda: RealLog([a, b], train=["run"]).load(None), LogError, "'run' is in several logs", "a/run, b/run")


def test_names_that_agree_only_in_part_are_refused(log):
    """Where some joints have the log's names and others do not, order proves nothing: it is refused, with the names."""
    with pytest.raises(RobotError, match="only elbow in common"):
        RealLog(log()).load(robot("elbow", "hand"))


def test_a_robot_with_other_joints_is_refused(log):
    """As many joints as the log has columns, or one line with both lists."""
    refused(
        lambda: RealLog(log()).load(robot("a", "b", "c")),
        RobotError,
        "moves 3 joints: a, b, c",
        "has 2: shoulder, elbow",
    )


# Logs of real robots


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("ur10e", {"train": ["pair1_unloaded"], "test": ["pair1_loaded"]}),
        ("panda", {"decimate": 10}),
        ("kuka_lwr4", {"train": ["run_1"], "test": ["run_2"]}),
        ("iiwa14", {"train": ["static_joints_2_to_7_b"], "test": ["static_joints_5_to_7"], "filter_cutoff": None}),
        ("sarcos", {"filter_cutoff": None}),
    ],
)  # fmt: skip
def test_logs_of_real_robots_load(name, options):
    """Real logs, jittery and gappy as they are, give finite samples in every set."""
    if not (REAL / f"{name}.h5").exists():
        pytest.skip(f"no {name}.h5: set INVDYN_REAL_DATA to a folder with the development logs")
    splits = RealLog(str(REAL / f"{name}.h5"), **options).load(None)
    for data in (splits.train, splits.validation, splits.tests["test"]):
        assert data is not None and data.samples > 10
        assert all(np.isfinite(x).all() for x in (data.motion.q, data.motion.qd, data.motion.qdd, data.tau))
