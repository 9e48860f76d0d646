"""docs/tutorial.md, word by word: its files and commands run in an empty folder and show what the page shows."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from tests.commands import ENVIRONMENT, ROOT, script
from tests.test_readme import console, skeleton

PAGE = (ROOT / "docs" / "tutorial.md").read_text()
FILES = {code.splitlines()[0][2:]: code for code in re.findall(r"```python\n(# \w+\.py\n.*?)```", PAGE, re.DOTALL)}
COMMANDS = console(PAGE)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """An empty folder with the page's files."""
    made = tmp_path_factory.mktemp("tutorial")
    for name, code in FILES.items():
        (made / name).write_text(code)
    return made


@pytest.fixture(scope="module")
def said(folder) -> dict[str, str]:
    """What each command prints, in the order of the page; each leaves what the next one needs."""
    made = {}
    for command, _ in COMMANDS:
        program, *argv = shlex.split(command)
        line = [sys.executable, *([script()] if program == "invdyn" else []), *argv]
        env = {**os.environ, **ENVIRONMENT, "COLUMNS": "100", "PYTHONPATH": str(ROOT)}
        done = subprocess.run(line, cwd=folder, env=env, capture_output=True, text=True, timeout=1200)
        assert done.returncode == 0, f"{command}: {done.stderr}"
        made[command] = done.stdout
    return made


def test_files_and_commands_are_there():
    """The page has the two scripts, and begins with a CSV."""
    assert set(FILES) == {"arm.py", "use.py"} and COMMANDS[0][0] == "python arm.py slow first.csv"


@pytest.mark.parametrize(("command", "shown"), [pair for pair in COMMANDS if pair[1]])
def test_a_command_shows_what_the_page_says(command, shown, said):
    """Every part of the output on the page stands in the command's output, in that order, but for digits."""
    rest = "\n".join(skeleton(said[command]))
    for part in shown.split("…\n"):
        wanted = "\n".join(skeleton(part.removesuffix("…")))
        assert wanted in rest
        rest = rest.split(wanted, 1)[1]
