"""invdyn completion: the words that it offers, and the scripts, asked as each shell asks them."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from invdyn_cli.cli import VERBS
from invdyn_cli.verbs import completion
from tests.commands import ENVIRONMENT, ROOT

BASH = r"""
source completion.bash
COMP_LINE=$1 COMP_POINT=${#1}
read -ra parts <<< "${1//=/ = }"
[[ $1 == *" " || $1 == *= ]] && parts+=("")
[[ $1 == *= ]] && unset 'parts[-1]'  # bash makes "=" itself the current word
COMP_WORDS=("${parts[@]}") COMP_CWORD=$((${#parts[@]} - 1))
compopt() { :; }  # works inside of a completion only
_invdyn
printf '%s\n' "${COMPREPLY[@]}"
"""


@pytest.fixture
def bash(tmp_path, monkeypatch):
    """bash(line) -> what bash would put in the place of the last word, by the script that is printed."""
    if shutil.which("bash") is None:
        pytest.skip("there is no bash")
    (tmp_path / "invdyn").write_text(
        f"#!/bin/sh\nexec {sys.executable} -c 'from invdyn_cli.cli import entry; entry()' \"$@\"\n"
    )
    (tmp_path / "invdyn").chmod(0o755)
    (tmp_path / "completion.bash").write_text(completion.BASH)
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "arm.h5").touch()
    env = {**ENVIRONMENT, "PATH": f"{tmp_path}:/usr/bin:/bin", "PYTHONPATH": str(ROOT), "HOME": str(tmp_path)}

    def ask(line: str) -> list[str]:
        done = subprocess.run(
            ["bash", "-c", BASH, "bash", line], cwd=tmp_path, env=env, capture_output=True, text=True, timeout=60
        )
        assert done.stderr == ""
        return done.stdout.splitlines()

    return ask


def test_bash_completes_every_kind_of_word(bash):
    """Verbs; groups and options with their "="; choices after it, without the part that bash keeps; files; effects."""
    assert bash("invdyn dia") == ["diagnose "]
    assert bash("invdyn run mod") == ["model=", "model."]
    assert bash("invdyn run model=pe") == ["pest ", "pest_coulomb ", "pest_friction "]
    assert {"dbm ", "ffnn ", "pest "} <= set(bash("invdyn run model="))
    assert bash("invdyn run model=pest model.thr") == ["model.threshold="]
    assert bash("invdyn check data.path=lo") == ["logs"]
    assert bash("invdyn check data.path=logs/a") == ["logs/arm.h5"]
    assert bash("invdyn effects stri") == ["stribeck_friction "]


def test_the_printed_scripts_are_those(command):
    """`invdyn completion SHELL` prints a script; anything else is one line."""
    for shell, script in completion.SCRIPTS.items():
        assert "\n".join(command("completion", shell).out) == script.rstrip("\n")
    for wrong in ((), ("tcsh",), ("bash", "zsh")):
        said = command("completion", *wrong)
        assert (said.code, len(said.err)) == (2, 1) and "allowed: bash, zsh, fish" in said.err[0]


@pytest.mark.parametrize(("shell", "argv"), [("zsh", ("-n",)), ("fish", ("--no-execute",)), ("bash", ("-n",))])
def test_the_shell_reads_its_script(shell, argv, tmp_path):
    """Where the shell is installed, it finds no error of syntax."""
    if shutil.which(shell) is None:
        pytest.skip(f"there is no {shell}")
    (tmp_path / "script").write_text(completion.SCRIPTS[shell])
    done = subprocess.run([shell, *argv, "script"], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")


def test_candidates(tmp_path, monkeypatch):
    """All verbs; sweeps go on after a comma; a choice of the working folder; booleans; experiments; a wrong word
    before does not matter; nothing for a free value, so that the shell offers files."""
    monkeypatch.chdir(tmp_path)
    Path("model").mkdir()
    Path("model/mine.yaml").write_text("_target_: mine.Mine\n")
    assert completion.candidates([""])[: len(VERBS)] == sorted(VERBS, key=completion.verbs().index)
    assert set(completion.verbs()) == set(VERBS)
    assert completion.candidates(["run", "-m", "model=pest,mi"]) == ["model=pest,mine"]
    assert completion.candidates(["run", "model=nonsense", "data=pl"]) == ["data=plant"]
    assert completion.candidates(["run", "model=pest", "model.offset="]) == ["model.offset=true", "model.offset=false"]
    assert completion.candidates(["diagnose", "model@diagnosis.learner=ffnn_"]) == ["model@diagnosis.learner=ffnn_deep"]
    assert "experiment=dbm" in completion.candidates(["tables", "experiment="])
    assert completion.candidates(["experiment", "conf"]) == ["confusion"]
    assert completion.candidates(["experiment", "taken-up", "lo"]) == ["logs="]
    assert completion.candidates(["experiment", "dbm", "fre"]) == completion.candidates(["tables", "fre"]) != []
    assert completion.candidates(["run", "robot.path="]) == []
    assert completion.candidates(["nonsense", "x"]) == []


def test_hydras_own_completion_is_answered(command):
    """What Hydra would install does not work with verbs; the line says what does."""
    said = command("run", "--shell-completion", "install=bash")
    assert (said.code, len(said.err)) == (2, 1) and "invdyn completion bash" in said.err[0]
