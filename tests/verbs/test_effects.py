"""invdyn effects: the catalogue as a table, one effect in full, and effects of the working folder."""

import re
from pathlib import Path

import pytest

from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.verbs import effects
from tests.commands import ROOT


def own_effect() -> str:
    """The file of docs/own_effects.md."""
    page = (ROOT / "docs" / "own_effects.md").read_text()
    return next(code for code in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if code.startswith("# drag.py"))


def test_names_are_those_of_the_catalogue(tmp_path, monkeypatch):
    """The names that are read from the sources, for completion, are the catalogue's."""
    monkeypatch.chdir(tmp_path)
    assert sorted(effects.names()) == sorted(EFFECTS)


def test_the_list_is_whole(command):
    """Every effect has a row with its group and the point where it acts, and no line is too wide."""
    said = command("effects")
    assert (said.code, said.err) == (0, [])
    rows = {line.split()[0]: line.split()[1:3] for line in said.out if line and line[0] != " "}
    assert {name: rows.get(name) for name in EFFECTS} == {x.name: [x.group, x.point] for x in EFFECTS.values()}
    assert not [line for line in said.out if len(line) > 80]
    titles = " ".join(" ".join(said.out).split())
    assert [x.title for x in EFFECTS.values() if x.title.split()[0] not in titles] == []


def test_one_effect_in_full(command):
    """Its equation, every parameter with unit, bound and a typical size, its confounders, and both file formats."""
    text = "\n".join(command("effects", "stribeck_friction").out)
    effect = EFFECTS["stribeck_friction"]
    for name, bound in effect.parameters.items():
        assert re.search(rf"parameter {name} +\[{re.escape(bound.unit)}\]", text)
    assert text.count("typical ") == len(effect.parameters) + 1
    assert "equation  " in text and "in MJCF" in text and "in URDF" in text
    assert all(name in text for rivals in effect.confounders for name in rivals)


@pytest.mark.parametrize(
    ("name", "mjcf", "urdf"),
    [
        ("viscous_friction", "damping [N m s/rad]", "damping [N m s/rad]"),
        ("rotor_inertia", "armature [kg m^2 of the rotor]", "a URDF cannot contain it"),
        ("payload", "a body on the last link", "inertials"),
        ("base_tilt", "gravity", "a URDF does not contain gravity"),
    ],
)
def test_what_files_for_simulators_contain(name, mjcf, urdf):
    """What stands in an MJCF and a URDF is what an export writes and what it says that it lacks."""
    text = " ".join(" ".join(effects.one_in_words(name)).split())
    in_mjcf, in_urdf = text.split("in MJCF ")[1].split("in URDF ")
    assert mjcf in in_mjcf and urdf in in_urdf


def test_an_effect_of_ones_own_is_listed_and_not_run(command):
    """An effect in a Python file of the working folder stands in the list, and its file is not run for that."""
    Path("drag.py").write_text(own_effect().replace('"""A torque', 'print("run")\n    """A torque'))
    said = command("effects")
    [line] = [line for line in said.out if line.startswith("cable_drag")]
    assert line.split()[1:3] == ["anomaly", "torque"]
    assert "run" not in said.out
    assert "cable_drag" in command("completion", "candidates", "effects", "cab").out


def test_an_effect_of_ones_own_in_full(command):
    """Asked for by name, it is imported, and says as much as one of the catalogue."""
    Path("drag.py").write_text(own_effect())
    said = command("effects", "cable_drag")
    text = "\n".join(said.out)
    assert said.code == 0, said.err
    assert "[N m s³/rad³] at least 0" in text and "is held as damping at 1 rad/s" in text.replace("\n" + 30 * " ", " ")


def test_wrong_use(command):
    """A misspelt name, and a file that cannot be imported, are one line each."""
    said = command("effects", "coulomb_frictoin")
    assert (said.code, len(said.err)) == (2, 1) and "did you mean 'coulomb_friction'?" in said.err[0]
    Path("bad.py").write_text("import nowhere\nclass Bad(AbstractTorqueEffect):\n    name = 'bad'\n")
    said = command("effects", "bad")
    assert (said.code, len(said.err)) == (2, 1) and "No module named 'nowhere'" in said.err[0]
