"""Names that options have elsewhere are answered with the name that they have here."""

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from invdyn_cli.cli import main
from invdyn_cli.verbs.launch import quoted

MISTAKES = {
    "run robot.urdf=arm.urdf": "robot=urdf robot.path=arm.urdf",
    "check robot=urdf robot.urdf=arm.urdf": "robot.path=arm.urdf",
    "check robot.file=arm.urdf": "robot=urdf robot.path=arm.urdf",
    "run urdf=arm.urdf": "robot=urdf robot.path=arm.urdf",
    "run robot=arm.urdf": "robot=urdf robot.path=arm.urdf",
    "diagnose data.file=log.csv": "data.path=log.csv",
    "check data.log=log.csv": "data.path=log.csv",
    "check path=log.csv": "data.path=log.csv",
    "run data.file=log.csv": "data=real_log data.path=log.csv",
    "run data=log.csv": "data=real_log data.path=log.csv",
    "run model.lr=0.1": "model.learning_rate=0.1",
    "run lr=0.1": "model.learning_rate=0.1",
    "run epochs=3": "model.epochs=3",
    "run model.layers=[3,3]": "model.hidden=[3,3]",
    "run model=mlp": "model=ffnn",
    "run random_state=1": "seed=1",
    "check data.sample_rate=100": "data.rate=100",
    "run output=here": "hydra.run.dir=here",
    "diagnose --log log.csv --urdf arm.urdf": "data.path=log.csv",
    "run --epochs=3": "model.epochs=3",
    "run --random-state 1": "seed=1",
    "run --nonsense": "nonsense=…",
    "check data.columns.q.unit=deg": "'data.columns={q: {unit: deg}}'",
    "check time.unit=ms": "'data.columns={time: {unit: ms}}'",
    "convert log.csv": "invdyn convert SOURCE OUT.h5",
    "check data.path=arm.urdf": "robot.path=arm.urdf data.path=…",
}
"""What somebody types who knows other programs, and what is meant."""


@pytest.mark.parametrize("typed", MISTAKES)
def test_a_name_from_elsewhere_is_answered_with_ours(typed, capsys, tmp_path, monkeypatch):
    """Exit code 2, one line, which ends in the option as it is typed here; nothing is written."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.urdf").touch()
    assert main(typed.split()) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1 and line.endswith(f"Try: {MISTAKES[typed]}\n")
    assert [path.name for path in tmp_path.iterdir()] == ["arm.urdf"]


def test_a_misspelt_option_is_answered_with_the_nearest(capsys, tmp_path, monkeypatch):
    """An option that was nearly right is no name from elsewhere: seeds is seed, not model.seeds."""
    monkeypatch.chdir(tmp_path)
    assert main(["run", "seeds=3"]) == 2
    assert capsys.readouterr().err.endswith("did you mean 'seed'?\n")


@pytest.mark.parametrize("path", ["a b", "it's", r"a\b.csv", "folder\\", r"\\server\log\it\'s", "a,b=[c]", "\\'"])
def test_a_path_is_an_override_s_value(path):
    """Hydra reads it as it was given, alone and in a list."""
    one, several = OverridesParser.create().parse_overrides([f"run={quoted(path)}", f"runs=[{quoted(path)}]"])
    assert one.value() == path and several.value() == [path]
