"""What is guessed of columns, and what is asked for instead."""

import numpy as np
import pytest

from invdyn_cli.errors import LogError
from invdyn_cli.formats import values
from invdyn_cli.formats.columns import ColumnMap, log_from
from invdyn_cli.formats.guess import complete
from invdyn_cli.formats.map_file import from_plain
from invdyn_cli.formats.table import Table
from tests.formats.recordings import named, recording

DATA = recording()
DEG = np.pi / 180


def table(columns) -> Table:
    return Table("run", dict(columns))


def guessed(columns, **given) -> ColumnMap:
    """The whole map of columns, with these entries given."""
    return complete("run.csv", table(columns), from_plain(given, "test"))


def log(columns, **given):
    """The trajectory that the guessed map makes."""
    return log_from("run.csv", [table(columns)], guessed(columns, **given)).trajectories[0]


def refused(columns, **given) -> str:
    """The line that asks."""
    with pytest.raises(LogError) as caught:
        guessed(columns, **given)
    assert "Try: invdyn convert" in str(caught.value)
    return str(caught.value)


def scaled(**factors) -> dict:
    """The recording in other units."""
    return DATA | {name: x * factors[name] for name, x in DATA.items() if name in factors}


def test_a_controllers_log():
    """Of a UR controller's log the measured channels are taken, in the order of their numbers; targets are q_ref."""
    data = DATA | {"q_ref": DATA["q"] + 1e-3}
    columns = {"timestamp": data["t"]}
    for k in (1, 0):
        columns |= {f"target_q_{k}": data["q_ref"][:, k], f"actual_q_{k}": data["q"][:, k]}
        columns |= {f"target_qd_{k}": data["qd"][:, k], f"actual_qd_{k}": data["qd"][:, k]}
        columns |= {f"actual_current_{k}": data["tau"][:, k], f"target_moment_{k}": data["tau"][:, k]}
        columns |= {f"actual_TCP_pose_{k}": data["q"][:, k], f"joint_temperatures_{k}": data["t"]}
    found = guessed(columns)
    assert {name: one.columns for name, one in found.channels.items()} == {
        "t": ("timestamp",),
        "q": ("actual_q_0", "actual_q_1"),
        "qd": ("actual_qd_0", "actual_qd_1"),
        "tau": ("actual_current_0", "actual_current_1"),
        "q_ref": ("target_q_0", "target_q_1"),
    }
    assert found.channel("tau").unit == ("A",) and found.torque_side == "motor"
    assert found.known["tau.unit"] == "guessed from values" and found.known["q"] == "guessed from the name"


def test_joints_of_one_letter():
    """A joint may be called T, as time is, or A, as currents are measured in."""
    columns = {"time": DATA["t"]}
    for k, joint in enumerate("TA"):
        columns |= {f"{joint}_position": DATA["q"][:, k], f"tau_{joint}": DATA["tau"][:, k]}
    found = guessed(columns)
    assert found.joints == ("T", "A")
    assert found.channel("tau").columns == ("tau_T", "tau_A")


@pytest.mark.parametrize(
    ("names", "factors"),
    [
        ({"head": "t [s]", "q": "q_{} [deg]", "tau": "tau_{} [N mm]"}, {"q": 1 / DEG, "tau": 1000}),
        ({"head": "time_ms", "q": "{}_pos_rad", "tau": "{}_torque_Nm"}, {"t": 1000}),
        ({"head": "t_us", "q": "pos_{}", "tau": "tau_{}", "qd": "vel_{}_deg_s"}, {"t": 1e6, "qd": 1 / DEG}),
    ],
)
def test_units_in_names(names, factors):
    """Units that names have are applied: the log is in s, rad and N m."""
    one = log(named(scaled(**factors), **names))
    for channel in ("t", *(c for c in names if c != "head")):
        np.testing.assert_allclose(getattr(one, channel), DATA[channel], atol=1e-9)


def test_a_unit_for_each_joint():
    """A slide in mm beside a hinge in deg: each joint has its own unit; signs of q and qd are kept apart."""
    data = scaled(q=np.array([1 / DEG, 1000]), qd=-1.0)
    names = {"t": data["t"], "q1 [deg]": data["q"][:, 0], "q2 [mm]": data["q"][:, 1]}
    names |= {f"tau{k + 1}": data["tau"][:, k] for k in (0, 1)} | {f"dq{k + 1}": data["qd"][:, k] for k in (0, 1)}
    one = log(names, qd={"sign": -1})
    np.testing.assert_allclose(one.q, DATA["q"], atol=1e-9)
    np.testing.assert_allclose(one.qd, DATA["qd"], atol=1e-9)


def test_units_from_values():
    """Without units in names: a clock in ms, positions in degrees, and velocities in the unit that makes them the
    derivatives of positions."""
    data = scaled(t=1000, q=1 / DEG, qd=60 / (2 * np.pi))
    columns = named(data, q="q_{}", qd="dq_{}", tau="tau_{}")
    found = guessed(columns)
    assert [found.channel(x).unit for x in ("t", "q", "qd")] == [("ms",), ("deg",), ("rpm",)]
    assert found.known["qd.unit"] == "guessed from values"


@pytest.mark.parametrize(("largest", "unit"), [(0.3, None), (0.4, "rad"), (6.0, "rad"), (8.0, None), (20.0, "deg")])
def test_the_unit_of_the_largest_angle(largest, unit):
    """No motion is a third of a degree, no joint turns by more than a turn and a bit in radians."""
    assert values.angle_unit(largest * np.sin(np.linspace(0, 20, 200))[:, None]) == unit


def test_what_both_may_be_is_asked():
    """Small positions may be rad or deg, steps of one may count rows, a load may be anything: all is asked at once."""
    columns = named(scaled(q=0.3, t=100), head="time", q="q_{}", tau="load_{}")
    line = refused(columns)
    for question in (
        "unit of time (median step 1)",
        "unit of q",
        "largest 0.3",
        "unit of tau",
        "time.unit=",
        "q.unit=",
    ):
        assert question in line
    found = guessed(columns, time={"unit": "ms"}, q={"unit": "rad"}, tau={"unit": "percent", "full_scale": [3.5]})
    assert found.known["q.unit"] == "given"


def test_two_candidates_are_asked():
    """Of two groups of columns that may be the torque none is taken."""
    columns = named(DATA, q="q_{}", tau="tau_{}") | named(DATA, tau="torque_{}")
    line = refused(columns)
    assert "which columns are tau: tau_shoulder:tau_elbow, torque_shoulder:torque_elbow" in line
    twice = named(DATA, q="q_{}", tau="motor_torque_{}") | named(DATA, tau="joint_torque_{}")
    assert "which columns are tau" in refused(twice)
    assert guessed(columns, tau="torque_shoulder:torque_elbow").channel("tau").columns[0] == "torque_shoulder"


def test_no_header():
    """Without names the positions are the block whose derivative is the block behind it; the torque is asked for."""
    q, qd, tau = (DATA[x] for x in ("q", "qd", "tau"))
    blocks = np.column_stack([DATA["t"], q, qd, np.abs(tau), tau**2])
    columns = {f"c{k + 1}": x for k, x in enumerate(blocks.T)}
    assert "which columns are tau: c6:c7, c8:c9" in refused(columns)
    found = guessed(columns, tau={"columns": "c6:c7", "unit": "Nm"})
    assert found.channel("q").columns == ("c2", "c3") and found.channel("qd").columns == ("c4", "c5")
    noise = {f"c{k}": x for k, x in enumerate(np.random.default_rng(0).normal(size=(12, 1000)))}
    assert "the positions among" in refused({"t": DATA["t"]} | noise)


def test_no_clock():
    """Rows without a clock are asked for a rate, which then makes one."""
    columns = {k: x for k, x in named(DATA, q="q_{}", tau="tau_{}").items() if k != "t"}
    assert "rate=HZ" in refused(columns)
    np.testing.assert_allclose(log(columns, rate=100.0).t, DATA["t"], atol=1e-12)


def test_a_clock_in_another_language():
    """A first column of an unknown name that grows as a clock does is the clock of named channels; an index is not."""
    columns = {"Aika": 1000 * DATA["t"]} | {k: x for k, x in named(DATA, q="q_{}", tau="tau_{}").items() if k != "t"}
    found = guessed(columns)
    assert (found.channel("t").columns, found.channel("t").unit) == (("Aika",), ("ms",))
    assert "rate=HZ" in refused(columns | {"Aika": np.arange(len(DATA["t"]))})


def test_no_torques():
    """A position servo's log keeps what it has: tau is NaN, and a note says what that leaves undone."""
    columns = named(DATA | {"q_ref": DATA["q"]}, q="present_position_{}", q_ref="goal_position_{}")
    found = guessed(columns)
    assert "no torques or currents" in " ".join(found.notes) and set(found.channels) == {"t", "q", "q_ref", "tau"}
    assert np.isnan(log(columns).tau).all()


def test_forces_beside_torques():
    """A slide's force stands in the same channel as the torques of the hinges; the unit of each is its own."""
    columns = {"t": DATA["t"], "base pos [rad]": DATA["q"][:, 0], "quill pos [mm]": 1000 * DATA["q"][:, 1]}
    columns |= {"base torque [N mm]": 1000 * DATA["tau"][:, 0], "quill force [N]": DATA["tau"][:, 1]}
    found = guessed(columns | {"force_x": DATA["t"], "force_y": DATA["t"]})
    assert found.channel("tau").columns == ("base torque [N mm]", "quill force [N]")
    np.testing.assert_allclose(log(columns).tau, DATA["tau"])


def test_a_clock_beside_a_column_that_stays():
    """A time since 1970 is the clock; an epoch that is the same in every row is not, wherever it stands."""
    columns = {k: x for k, x in named(DATA, q="q_{}", tau="tau_{}").items() if k != "t"}
    columns = {"epoch": np.full(len(DATA["t"]), 3.0)} | columns | {"unix_time": 1.7643e9 + DATA["t"]}
    assert guessed(columns).channel("t").columns == ("unix_time",)
    np.testing.assert_allclose(log(columns).t, DATA["t"], atol=1e-6)


def test_percent():
    """A load in percent with its full scale is a torque; without, a note says that it is stored like a current."""
    columns = named(scaled(tau=10), q="q_{}", tau="load_{}")
    one = log(columns, tau={"unit": "percent", "full_scale": [2.0, 5.0]})
    np.testing.assert_allclose(one.tau, DATA["tau"] * 10 * [0.02, 0.05])
    found = guessed(columns, tau={"unit": "%"})
    assert "percent" in " ".join(found.notes) and log_from("x", [table(columns)], found).torque_unit == "A"


def test_what_is_given_is_taken():
    """Signs, order, names, side, gains, robot: what is given stands in the log."""
    columns = named(DATA, q="q_{}", tau="i_{}")
    given = {"joints": ["elbow", "shoulder"], "tau": {"unit": "mA", "sign": [1, -1]}, "robot_name": "arm", "rate": 99.0}
    given |= {"torque_side": "motor", "drive_gain": [2.0, 3.0], "licence": "CC0", "origin": "our lab"}
    made = log_from("run.csv", [table(columns)], guessed(columns, **given))
    assert (made.robot, made.rate, made.torque_side, made.licence, made.source) == (
        "arm",
        99,
        "motor",
        "CC0",
        "our lab",
    )
    assert made.joints == ("elbow", "shoulder") and list(made.drive_gain) == [2, 3]
    np.testing.assert_allclose(made.trajectories[0].q, DATA["q"][:, ::-1])
    np.testing.assert_allclose(made.trajectories[0].tau, DATA["tau"][:, ::-1] * 1e-3 * [1, -1])


def test_a_wrong_velocity_is_left_out():
    """A velocity that is no derivative of the positions in any unit is not stated as one."""
    columns = named(DATA | {"qd": np.roll(DATA["qd"], 300, axis=0)}, q="q_{}", qd="dq_{}", tau="tau_{}")
    found = guessed(columns)
    assert "qd" not in found.channels and "qd (dq_shoulder:dq_elbow) is left out" in " ".join(found.notes)


@pytest.mark.parametrize("column", ["q_shoulder", "tau_elbow"])
def test_defects_stay(column):
    """NaN in a column is no reason to refuse a file: the log keeps it for `invdyn check`."""
    columns = named(DATA, q="q_{}", qd="dq_{}", tau="tau_{}")
    columns[column] = np.where(np.arange(len(DATA["t"])) == 7, np.nan, columns[column])
    one = log(columns)
    assert np.isnan(one.q).sum() + np.isnan(one.tau).sum() == 1


@pytest.mark.parametrize("n", [1, 7])
def test_counts_of_joints(n):
    """One joint or seven: columns without numbers are one joint, q10 comes after q9."""
    names = ["q"] if n == 1 else [f"q{k}" for k in range(4, 4 + n)]
    columns = {"t": DATA["t"]} | {name: DATA["q"][:, 0] + k / 10 for k, name in enumerate(names)}
    columns |= {name.replace("q", "tau"): np.full(len(DATA["t"]), float(k)) for k, name in enumerate(names)}
    shuffled = dict(sorted(columns.items()))
    assert list(log(shuffled).tau[0]) == list(range(n))


def test_velocities_beside_angles_within_a_turn():
    """Velocities and commands of an angle that was logged within one turn are recognised by their values."""
    q, wrap = 5 * DATA["q"], lambda x: np.pi - (np.pi - x) % (2 * np.pi)
    data = DATA | {"q": wrap(q), "qd": 5 * DATA["qd"], "q_ref": wrap(q + 1e-3)}
    found = guessed(named(data, q="q_{}", qd="dq_{}", q_ref="target_q_{}", tau="tau_{}"))
    assert found.channel("qd").unit == ("rad/s",) and found.channel("q_ref").unit == ("rad",)


@pytest.mark.parametrize("count", [2, 4])
def test_torques_of_other_joints_than_the_positions(count):
    """A file with them is none without torques, be they too many or called otherwise: which columns belong together is
    asked for."""
    columns = named(DATA, q="pos_{}", tau="effort_{}")
    others = {name: x for name, x in columns.items() if not name.startswith("effort")}
    others |= {f"effort_{k}": DATA["tau"][:, 0] for k in range(1, count + 1)}
    said = refused(others)
    assert f"the joints of effort_1:effort_{count} ({count}) are not those of pos_shoulder" in said
