"""invdyn models: models and adaptations with a line each, and one of them in full."""

import subprocess
import sys
from pathlib import Path

from invdyn_cli.verbs import options
from tests.commands import python


def test_the_list_is_whole(command):
    """Every model and adaptation stands in it, one of the working folder, too; nothing is too wide."""
    Path("model").mkdir()
    Path("model/mine.yaml").write_text("# The mean torque.\n_target_: mine.Mine\n")
    said = command("models")
    assert (said.code, said.err) == (0, [])
    first = [line.split()[0] for line in said.out if line.startswith("  ") and line[2] != " "]
    assert first == [name for group in ("model", "adaptation") for name in options.choices_of(group)]
    assert "mine" in first and "The mean torque" in "\n".join(said.out)
    assert not [line for line in said.out if len(line) > 80]


def test_one_in_full(command):
    """Its hyperparameters with default and unit, its class, its source and its config."""
    text = "\n".join(command("models", "pest").out)
    assert "model.rest_speed=0.02       [rad/s; m/s] " in text and "invdyn_cli/models/pest.py" in text
    assert "invdyn_cli.models.pest.Pest" in text and "conf/model/pest.yaml" in text
    assert "No hyperparameters." in command("models", "batch").out


def test_wrong_use(command):
    """A misspelt name is one line with what is allowed."""
    said = command("models", "pst")
    assert (said.code, len(said.err)) == (2, 1) and "did you mean 'pest'?" in said.err[0]


def test_nothing_heavy(tmp_path):
    """Neither the list nor a model in full loads JAX."""
    code = "import sys; from invdyn_cli.cli import main; main(['models', 'ffnn']); print('jax' in sys.modules)"
    assert python("-c", code, cwd=tmp_path).stdout.splitlines()[-1] == "False"


def test_head_may_read_less(tmp_path):
    """The reader of the list goes away before it is printed: no message, exit code 0."""
    command = [sys.executable, "-c", "from invdyn_cli.cli import entry; entry()", "models"]
    process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.close()
    process.stdout = None
    assert process.communicate()[1] == b"" and process.returncode == 0
