"""The benchmark for causes: what counts as right, what a tool gets and what it may do wrong, and the adapters."""

import json
import sys

import numpy as np
import pytest

from experiments import causes
from experiments.arms import random_arm
from experiments.causes import TOOLS, Causes, Made, ask, command_of, lacks, score
from invdyn_cli.errors import UsageError
from invdyn_cli.logfile import write_log
from invdyn_cli.robots import load_urdf
from invdyn_cli.simulation import plant
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.simulation.references import Multisine
from invdyn_cli.simulation.sensors import Noise
from invdyn_cli.types import Finding, Quantity

FRICTION = Hidden("coulomb_friction", "axis2", {"coulomb": 1.5})
PLAY = Hidden("backlash", "a", {"gap": 0.01, "rotor": 0.2})
WEAR = [
    Hidden(effect, joint, {name: 1.0})
    for joint in "ab"
    for effect, name in (("coulomb_friction", "coulomb"), ("viscous_friction", "damping"))
]

WRITE = "import sys\nopen(sys.argv[3], 'w').write({!r})"
"""A tool that answers some text."""


def said(effect, joint, *alternatives, **sizes):
    """A finding, ambiguous if it has alternatives."""
    status = "ambiguous" if alternatives else "named"
    sets = tuple((x,) for x in alternatives)
    return Finding(effect, joint, status, sets, {k: Quantity(x, "") for k, x in sizes.items()})


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A log of an arm of two joints with dry friction on one of them, its file and that of the URDF."""
    folder = tmp_path_factory.mktemp("made")
    urdf = folder / "robot.urdf"
    urdf.write_text(random_arm(np.random.default_rng(3), 2))
    robot = load_urdf(urdf)
    noise = Noise(position=1e-6, torque=0.02)
    log = plant.record(robot, [Multisine()], [FRICTION], noise=noise, duration=20.0, rate=250.0, urdf=str(urdf))
    write_log(log, folder / "log.h5")
    return Made(log, robot, FRICTION, (), 10.0), folder / "log.h5", urdf


@pytest.fixture
def tool(tmp_path):
    """Gives the command of a tool that runs some lines of Python."""

    def write(lines):
        (tmp_path / "tool.py").write_text(lines)
        return [sys.executable, str(tmp_path / "tool.py")]

    return write


@pytest.mark.parametrize(
    ("found", "result", "here", "false"),
    [
        ([], "missed", (), ()),
        ([said("backlash", "a")], "named", ("backlash",), ()),
        ([said("backlash", "b")], "missed", (), ("backlash@b",)),
        ([said("backlash", "a", "presliding_hysteresis")], "ambiguous", ("backlash|presliding_hysteresis",), ()),
        ([said("backlash", "a", "payload")], "missed", ("backlash|payload",), ("backlash|payload@a",)),
        ([said("rotor_inertia", "a")], "missed", ("rotor_inertia",), ()),
        ([said("rotor_inertia", "b")], "missed", (), ("rotor_inertia@b",)),
        ([said("coulomb_friction", "a"), said("viscous_friction", "b")], "missed", (), ()),
        (
            [said("torque_offset", "a"), said("backlash", "a")],
            "named",
            ("torque_offset", "backlash"),
            ("torque_offset@a",),
        ),
        ([said("torque_delay", "b", "viscous_friction")], "missed", (), ()),
        ([said("coulomb_friction", "b", "unknown")], "missed", (), ()),
    ],
)
def test_what_is_right_and_what_is_false(found, result, here, false):
    """Gear play in a worn arm: only play on its joint is right, or what theory cannot distinguish from it; wear and the
    gear's rotor are no false claims, a rotor stands among what was named; all else is false."""
    scored = score(PLAY, WEAR, found)
    assert scored[:3] == (result, here, false)


def test_an_arm_without_wear_has_no_friction():
    """The same claim of friction is true of a worn arm and false of one without; nothing is right where nothing is."""
    found = [said("coulomb_friction", "a")]
    assert score(None, WEAR, found) == ("none", (), (), ())
    assert score(None, [], found).false == ("coulomb_friction@a",)


def test_what_is_no_claim_counts_for_nothing():
    """A finding that says it could not have been seen is neither right nor false."""
    assert score(PLAY, [], [Finding("backlash", "a", "not_excited")]).result == "missed"
    assert score(None, [], [Finding("backlash", "a", "not_observable")]).false == ()


def test_unequal_friction_may_be_said_in_two_words():
    """Asymmetric friction is Coulomb friction and an offset: both together are right, one alone is false."""
    hidden = Hidden("asymmetric_coulomb_friction", "a", {"positive": 2.0, "negative": 1.0})
    parts = [said("coulomb_friction", "a"), said("torque_offset", "a")]
    assert score(hidden, [], parts)[::2] == ("named", ())
    assert score(hidden, [], parts[:1])[::2] == ("missed", ("coulomb_friction@a",))


def test_sizes_are_judged_where_they_are_the_causes_own():
    """The error is relative, of a gain from its distance to one; friction that adds to wear is not judged."""
    gain = Hidden("torque_gain_error", "a", {"gain": 1.2})
    assert score(gain, [], [said("torque_gain_error", "a", gain=1.25)]).errors == pytest.approx((0.25,))
    stribeck = Hidden("stribeck_friction", "a", {"coulomb": 1.0, "static": 2.0, "velocity": 0.1})
    claim = [said("stribeck_friction", "a", coulomb=1.1, static=2.0, velocity=0.1)]
    assert score(stribeck, [], claim).errors == pytest.approx((0.1, 0.0))
    assert score(stribeck, WEAR, claim) == ("named", ("stribeck_friction",), (), ())


def test_a_tool_sees_the_log_and_the_urdf_alone(made, tool):
    """It gets the names of three files, in a folder that holds two of them and nothing else."""
    lines = "import json, os, sys\nseen = [*sys.argv[1:], *sorted(os.listdir('.'))]\n"
    lines += "json.dump([{'effect': x, 'joint': None} for x in seen], open(sys.argv[3], 'w'))"
    found, seconds = ask(tool(lines), made[1], made[2], 60)
    assert not isinstance(found, str), found
    assert [f.effect for f in found] == ["log.h5", "robot.urdf", "answer.json", "log.h5", "robot.urdf"]
    assert seconds > 0


@pytest.mark.parametrize(
    ("lines", "why"),
    [
        ("print('starts')\nraise ValueError('no such joint')", "exit code 1: ValueError: no such joint"),
        ("pass", "No such file"),
        (WRITE.format("friction!"), "is no list of findings: Expecting value"),
        (WRITE.format('[{"joint": "a"}]'), "objects that have effect and joint"),
        (WRITE.format('{"verdict": 1}'), "objects that have effect and joint"),
        (WRITE.format('[{"effect": "payload", "joint": null, "parameters": {"mass": "big"}}]'), "to float: 'big'"),
        ("import time\ntime.sleep(60)", "no answer within 1 s"),
    ],
)
def test_a_tool_that_gives_no_answer_has_failed(made, tool, lines, why):
    """A crash, no file, rubbish and endless work are one line each, and no traceback."""
    said, _ = ask(tool(lines), made[1], made[2], 1 if "sleep" in lines else 60)
    assert isinstance(said, str) and why in said and "\n" not in said


@pytest.mark.parametrize("name", TOOLS)
def test_every_adapter_names_dry_friction(name, made):
    """Dry friction on one joint is named there by each tool, its size within 15 % (the noise is 1 % of it, and low-pass
    filters round its edges)."""
    if missing := lacks(name):
        pytest.skip(missing)
    found, _ = ask(command_of(name), made[1], made[2], 300)
    assert not isinstance(found, str), found
    scored = score(FRICTION, (), found)
    assert scored.result == "named" and max(scored.errors) < 0.15


def test_the_truth_is_written_apart(made, tmp_path, tool, monkeypatch):
    """A log's folder holds what tools get; what was hidden lies in another; every tool has a row, and a failure too."""
    monkeypatch.setattr(causes, "make", lambda *_: made[0])
    crash = " ".join(tool("raise SystemExit('out of order')"))
    rows = list(Causes().run(tmp_path / "out", 7, 1, "perfect", "coulomb_friction", "least_squares", crash))
    files = sorted(str(p.relative_to(tmp_path / "out")) for p in (tmp_path / "out").rglob("*") if p.is_file())
    assert files == ["logs/007/log.h5", "logs/007/robot.urdf", "truth/007.json"]
    truth = json.loads((tmp_path / "out/truth/007.json").read_text())
    assert truth["hidden"]["effect"] == "coulomb_friction" and truth["beside"] == []
    assert [(row.result, row.note) for row in rows] == [("named", ""), ("failed", "exit code 1: out of order")]
    text = Causes().table(rows)
    assert (
        "| least_squares | 1 | 1 | 0 | 0 | 0 |" in text and "| coulomb_friction | 1 | coulomb_friction 1 |  |" in text
    )


def test_a_tool_is_an_adapter_or_a_command(tmp_path):
    """Files among the words of a command are found from any folder; a name that is neither is refused before a log is
    made; every kind of log comes, and no cause a second time before the others of its kind."""
    (tmp_path / "own.py").touch()
    assert command_of(f"{sys.executable} {tmp_path}/own.py --fast")[1:] == [str(tmp_path / "own.py"), "--fast"]
    with pytest.raises(UsageError, match="did you mean 'ours'"):
        list(Causes(tool=["our"]).plan(()))
    plan = list(Causes(tool=["ours"], logs=20).plan(()))
    assert {job[2] for job in plan} == set(causes.KINDS) and len({job[1] for job in plan}) == 20
    worn = [job[3] for job in plan if job[2] == "worn"]
    assert len(set(worn)) == len(worn) == 8


def test_what_is_not_installed_is_said(monkeypatch):
    """A tool that is not installed is left out with what to install; where none is left, nothing runs."""
    monkeypatch.setattr(causes, "find_spec", lambda name: None)
    assert {job[4:] for job in Causes(logs=1).plan(())} == {("ours", "least_squares", "pest")}
    assert "figaroh was left out: it needs figaroh (pip install 'invdyn[causes]')" in Causes().table([])
    with pytest.raises(UsageError, match="pip install"):
        list(Causes(tool=["figaroh"]).plan(()))
