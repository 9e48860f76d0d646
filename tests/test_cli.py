"""The command's own words: help at once, verbs, version."""

import importlib.util
from importlib.metadata import version

from invdyn_cli.cli import VERBS
from tests.commands import invdyn, python

HEAVY = ("hydra", "jax", "matplotlib", "numpy", "omegaconf", "pinocchio", "rich", "scipy")


def test_help_imports_nothing_heavy(tmp_path):
    """`invdyn --help` answers without loading any package but its own, so that it answers at once."""
    code = "import sys; from invdyn_cli.cli import main; main(['--help']); print('loaded:', *sys.modules)"
    said = python("-c", code, cwd=tmp_path)
    loaded = {name.split(".")[0] for name in said.stdout.split("loaded:")[1].split()}
    assert "invdyn_cli" in loaded
    assert not loaded & set(HEAVY)


def test_help_lists_the_verbs(tmp_path):
    """`invdyn --help`, and `invdyn` alone, list every verb with what it does, and exit with 0."""
    for argv in (["--help"], []):
        said = invdyn(*argv, cwd=tmp_path)
        assert said.returncode == 0
        for verb, what in VERBS.items():
            assert f"  {verb} " in said.stdout
            assert what in said.stdout


def test_every_listed_verb_exists():
    """No verb is promised that has no file."""
    assert [verb for verb in VERBS if not importlib.util.find_spec(f"invdyn_cli.verbs.{verb}")] == []


def test_unknown_verb(tmp_path):
    """A misspelt verb is one line that lists the verbs and names the nearest; exit code 2."""
    said = invdyn("rum", cwd=tmp_path)
    assert said.returncode == 2
    assert said.stdout == ""
    assert len(said.stderr.splitlines()) == 1
    assert "did you mean 'run'?" in said.stderr


def test_version(tmp_path):
    """`invdyn --version` gives the installed package's version."""
    said = invdyn("--version", cwd=tmp_path)
    assert (said.returncode, said.stdout) == (0, f"invdyn {version('invdyn')}\n")
