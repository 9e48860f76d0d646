"""Options with values beyond reason, of the right type or not: one line, exit code 2, no folder left."""

import pytest

from tests.logs import make_log

LOG = ("data=real_log", "data.path=log.h5")
ODD = {
    "a seed beyond 64 bits": ("run", "seed=1e20", "seed=1e+20; allowed"),
    "a seed beyond 63 bits": ("run", "seed=18446744073709551615", "allowed: a whole number from 0 to 2^63 - 1"),
    "too many ripples": ("run", "model=pest model.ripples=100000", "allowed: a whole number from 0 to 50"),
    "a net of 100 million neurons": ("run", "model.hidden=[100000000]", "model.hidden"),
    "decimals of no number": ("run", "data.decimals=-400", "data.decimals=-400; allowed"),
    "a filter of order 1000": ("run", "data=real_log data.path=log.h5 data.filter_order=1000", "data.filter_order"),
    "an endless task": ("run", "data.duration=1e300", "data.duration"),
    "a rate beyond any clock": ("run", "data.rate=1e300", "data.rate"),
    "a robot that is a mapping": ("run", "robot._target_=builtins.dict", "class dict; allowed: Robot"),
    "a robot that is a number": ("run", "robot=5", "robot=5; allowed"),
    "a model that is code": ("run", "model._target_=os.getcwd", "os.getcwd: "),
    "options that are none": ("run", "figures=null", "figures=None; allowed: figures.formats=…"),
    "no figures": ("figures", "shown=5", "shown"),
    "a format that is none": ("report", "run formats=[exe]", "formats=['exe']; allowed"),
    "a limit on bytes below zero": ("check", "data.path=log.h5 data.max_size=-1", "data.max_size=-1"),
    "a limit on bytes that is reached": ("check", "data.path=log.h5 data.max_size=1e-6", "or a larger max_size"),
    "trust in a number": ("report", "run trust=5", "trust=5; allowed: a list of modules"),
    "endless substeps": ("simulate", "data.substeps=100000000", "substeps=100000000; allowed"),
    "another experiment": ("tables", "experiment=bent", "bent.yaml lacks title"),
    "no YAML": ("tables", "experiment=torn", "torn.yaml cannot be read as an experiment"),
}


@pytest.mark.parametrize("case", ODD)
def test_odd_values(case, command, tmp_path):
    """Each of these ended in a traceback, took the machine's memory, or had no line of its own."""
    verb, argv, words = ODD[case]
    make_log(tmp_path / "log.h5")
    (tmp_path / "experiments").mkdir()
    (tmp_path / "experiments" / "bent.yaml").write_text("jobs: [{name: a}]")
    (tmp_path / "experiments" / "torn.yaml").write_text("jobs: [")
    before = {path for path in tmp_path.rglob("*") if "outputs" not in path.parts}
    said = command(verb, *argv.split())
    assert said.code == 2 and len(said.err) == 1, said.err
    assert words in said.err[0]
    assert {path for path in tmp_path.rglob("*") if ".cache" not in path.parts} == before
