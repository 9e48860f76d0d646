"""docs/tutorial.md, word by word: its files and commands run in an empty folder and show what the page shows."""

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from tests.commands import ENVIRONMENT, ROOT, script
from tests.test_readme import console, skeleton

PAGE = (ROOT / "docs" / "tutorial.md").read_text()
FILES = {
    "arm.py": (ROOT / "docs" / "arm.py").read_text(),
    "use.py": PAGE.split("```python\n# use.py\n")[1].split("```")[0],
}
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


def test_the_page_begins_with_a_csv_and_stays_short():
    """The first command writes a CSV, the last loads the model; no page of docs/ has more than 150 lines."""
    assert (COMMANDS[0][0], COMMANDS[-1][0]) == ("python arm.py slow first.csv", "python use.py")
    pages = {page.name: len(page.read_text().splitlines()) for page in (ROOT / "docs").glob("*.md")}
    assert {name: n for name, n in pages.items() if n > 150} == {}


@pytest.mark.benchmark  # two minutes; the README's session is the suite's
@pytest.mark.parametrize(("command", "shown"), [pair for pair in COMMANDS if pair[1]])
def test_a_command_shows_what_the_page_says(command, shown, said):
    """Every part of the output on the page stands in the command's output, in that order, but for digits."""
    rest = "\n".join(skeleton(said[command]))
    for part in shown.split("…\n"):
        wanted = "\n".join(skeleton(part.removesuffix("…")))
        assert wanted in rest
        rest = rest[rest.index(wanted) + len(wanted) :]
