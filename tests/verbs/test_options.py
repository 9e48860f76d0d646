"""`invdyn VERB --help`: every option has a line, and nothing heavy is loaded for it."""

import sys
from pathlib import Path

import pytest

from invdyn_cli.verbs import options
from tests.commands import ROOT, python

VERBS = sorted(path.stem for path in (ROOT / "conf").glob("*.yaml"))
CHOICES = sorted((p.parent.name, p.stem) for p in (ROOT / "conf").glob("*/*.yaml"))
HEAVY = ("jax", "matplotlib", "mujoco", "numpy", "pinocchio", "scipy")


def without_line(found: options.Described) -> list[str]:
    """The options of which nothing is said, and those with a fractional value and no unit."""
    silent = [one.name for one in found.options if not one.text]
    return silent + [one.name for one in found.options if _is_float(one.value) and "[" not in one.text]


def _is_float(value: str) -> bool:
    return "." in value and value.replace(".", "").replace("e-", "").isdigit()


@pytest.mark.parametrize("verb", VERBS)
def test_every_option_of_a_verb_has_a_line(verb):
    """Each option of each verb says what it means; a fractional number has a unit in brackets."""
    found = options.described(verb)
    assert found.options
    assert without_line(found) == []


@pytest.mark.parametrize(("group", "choice"), CHOICES)
def test_every_option_of_a_choice_has_a_line(group, choice):
    """So does each option of each choice of each group, nested ones too, and the choice has a line itself."""
    found = options.described("run", [f"{group}={choice}"])
    assert without_line(found) == []
    assert found.chosen[group] == choice
    assert options.headline(options.choices_of(group)[choice])


def test_an_undocumented_option_is_noticed(tmp_path, monkeypatch):
    """A field without a line in its class's docstring is reported: the tests above can fail."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "mine", raising=False)  # of another test's folder
    Path("mine.py").write_text(
        'class Mine:\n    """A model.\n\n    Attributes:\n        said: [m] something.\n    """\n'
    )
    Path("model").mkdir()
    Path("model/mine.yaml").write_text("# A model of mine.\n_target_: mine.Mine\nsaid: 1.0\nunsaid: 2.0\n")
    found = options.described("run", ["model=mine"])
    assert without_line(found) == ["model.unsaid", "model.unsaid"]
    assert [one.text for one in found.options if one.name == "model.said"] == ["[m] something."]
    assert options.headline(options.choices_of("model")["mine"]) == "A model of mine"


def test_docstrings_are_read_not_run(tmp_path, monkeypatch):
    """The help of a model of one's own runs none of its code."""
    monkeypatch.chdir(tmp_path)
    Path("mean.py").write_text('raise SystemExit("run")\nclass Mean:\n    """A model."""\n')
    assert options.lines_of("mean.Mean") == {}
    assert options.find("mean.Mean") is not None


def test_a_shared_line_stands_once():
    """`as in data=real_log` gives the line that stands there."""
    lines = options.lines_of("invdyn_cli.data.plant.Plant")
    assert lines["filter_cutoff"] == options.lines_of("invdyn_cli.data.recorded.RealLog")["filter_cutoff"]
    assert "[Hz]" in lines["filter_cutoff"]


@pytest.mark.parametrize("verb", VERBS)
def test_help_fits_a_terminal(verb, command):
    """No line is wider than 80 columns; each group that the verb has stands with its choices."""
    said = command(verb, "--help")
    assert (said.code, said.err) == (0, [])
    assert [line for line in said.out if len(line) > 80] == []
    text = "\n".join(said.out)
    assert f"invdyn {verb}" in text and "$" not in text
    for group in options.described(verb).chosen:
        assert f"  {group}=" in text
        assert [x for x in options.choices_of(group.partition("@")[0]) if f" {x} " not in text] == []


def test_help_shows_what_was_chosen(command):
    """Overrides beside --help change what it shows; a wrong one is told in one line."""
    text = "\n".join(command("run", "model=pest", "model.threshold=0.5", "--help").out)
    assert "model.threshold=0.5 " in text and "* pest " in text and "model.epochs" not in text
    said = command("run", "model=ffn", "--help")
    assert (said.code, len(said.err)) == (2, 1) and "did you mean 'ffnn'?" in said.err[0]


def test_help_loads_nothing_heavy(tmp_path):
    """`invdyn run --help` reads docstrings and imports none of the numerical packages."""
    code = "import sys; from invdyn_cli.cli import main; main(['run', '--help']); print('loaded:', *sys.modules)"
    said = python("-c", code, cwd=tmp_path)
    loaded = {name.split(".")[0] for name in said.stdout.split("loaded:")[1].split()}
    assert "hydra" in loaded and not loaded & set(HEAVY)
    assert not list(tmp_path.iterdir())
