"""Column maps as YAML: written and read back, refused where a value cannot be."""

from pathlib import Path

import pytest

from invdyn_cli.errors import UsageError
from invdyn_cli.formats import map_file
from invdyn_cli.formats.columns import Channel, ColumnMap
from invdyn_cli.formats.reading import import_one
from tests.formats.recordings import csv, recording

WHOLE = """
robot_name: arm
urdf: arm.urdf
joints: [a, b]
rate: 500
torque_side: motor
drive_gain: [1.5, 2]
origin: our lab
time: {column: stamp, unit: ms}
q: {columns: [p1, p2], unit: [deg, mm], sign: [1, -1]}
tau: {columns: "i1:i2", unit: mA}
qd: none
"""


def test_all_entries(tmp_path):
    """Each entry becomes what it says; the URDF is beside the map."""
    (tmp_path / "arm.urdf").write_text("<robot/>")
    (tmp_path / "map.yaml").write_text(WHOLE)
    made = map_file.load(tmp_path / "map.yaml")
    assert (made.robot, made.joints, made.rate, made.torque_side) == ("arm", ("a", "b"), 500.0, "motor")
    assert made.urdf == str(tmp_path / "arm.urdf") and made.drive_gain == (1.5, 2.0) and made.source == "our lab"
    assert dict(made.channels) == {
        "t": Channel(("stamp",), ("ms",)),
        "q": Channel(("p1", "p2"), ("deg", "mm"), (1, -1)),
        "tau": Channel(("i1:i2",), ("mA",)),
        "qd": Channel(("none",)),
    }


def test_round_trip(tmp_path):
    """A map that was written is read as the same; guesses stand in its comments."""
    made = import_one(csv(tmp_path, recording()), {"tau": {"sign": -1}}).columns
    text = map_file.to_yaml(made, "run.csv", tmp_path)
    (tmp_path / "map.yaml").write_text(text)
    read = map_file.load(tmp_path / "map.yaml")
    assert read.channels == made.channels and read.joints == made.joints
    assert "# guessed from the name; guessed from values" in next(x for x in text.splitlines() if x.startswith("q:"))


def test_the_command_line_wins():
    """Of two maps the second wins, entry by entry and field by field."""
    first = map_file.from_plain({"robot_name": "a", "licence": "MIT", "q": {"columns": ["x"], "unit": "deg"}}, "one")
    second = map_file.from_plain({"robot_name": "b", "q": {"unit": "rad", "columns": None}, "tau": None}, "two")
    both = map_file.merged(first, second)
    assert (both.robot, both.licence, both.channel("q")) == ("b", "MIT", Channel(("x",), ("rad",)))
    assert map_file.merged(first, ColumnMap()) == first


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("q: {unit: parsec}", "q.unit=parsec; allowed: rad, deg"),
        ("q: {sign: 2}", r"q.sign=\[2.0\]; allowed: 1 or -1"),
        ("q: {colums: a}", "no 'colums'; allowed: columns"),
        ("time: {sign: 1}", "time has no 'sign'; allowed: column, unit"),
        ("torque_side: left", "torque_side=left; allowed: link, motor, command, unknown"),
        ("rate: -1", "rate=-1.0; allowed: above 0"),
        ("rate: fast", "rate=fast; allowed: a number"),
        ("joints: [[a]]", "joints=.*allowed: text"),
        ("urdf: nowhere.urdf", "nowhere.urdf is no file"),
        ("taus: 1", "no entry 'taus', did you mean 'tau'"),
        ("- 1", "holds no column map"),
        ("q: [", "no YAML"),
        ("a: &a [1]\nb: *a", "reference"),
        ("q: !!python/object/apply:os.system ['touch ran']", "no YAML"),
    ],
)
def test_refused(text, line, tmp_path, monkeypatch):
    """What a map cannot say is told in a line; YAML that would make objects, or repeat itself, is not followed."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "map.yaml").write_text(text)
    with pytest.raises(UsageError, match=line):
        map_file.load(tmp_path / "map.yaml")
    assert not Path("ran").exists()
