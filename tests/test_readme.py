"""The README and the docs are true: commands compose, outputs are those that come, links lead somewhere."""

import re
import shlex
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir

from tests.commands import ENVIRONMENT, ROOT

PAGES = [ROOT / "README.md", ROOT / "ARCHITECTURE.md", *sorted((ROOT / "docs").glob("*.md"))]


def console(text: str) -> list[tuple[str, str]]:
    """(command, output) of every `$ command` in the console blocks of a page."""
    found = []
    for block in re.findall(r"```console\n(.*?)```", text, re.DOTALL):
        for part in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]:
            command, _, output = part.partition("\n")
            found.append((command.split(" #")[0].strip(), output.rstrip()))
    return found


COMMANDS = [pair for page in PAGES for pair in console(page.read_text())]


def runs() -> list[str]:
    """The `invdyn run …` commands, each once, that name no config of the reader's own."""
    asked = [c for c, output in COMMANDS if c.startswith("invdyn run") and "invdyn:" not in output and "mine" not in c]
    return list(dict.fromkeys(asked))


def skeleton(text: str) -> list[str]:
    """Lines without their digits and blanks."""
    numbers = re.sub(r"\d+(\.\d+)?(e[-+]\d+)?", "#", text)
    return [" ".join(line.split()) for line in numbers.splitlines() if line.strip()]


@pytest.mark.parametrize("command", runs())
def test_commands_compose(command):
    """Every `invdyn run` in the pages composes: its groups, choices and options exist."""
    given = shlex.split(command.removesuffix("\\"))[2:]
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        compose("run", [one_of(x) for x in given if not x.startswith(("-", "hydra"))])


def one_of(override: str) -> str:
    """The override of one job of a sweep: its first value, or the beginning of its interval."""
    key, value = override.split("=", 1)
    if interval := re.search(r"interval\(([^,]+),", value):
        return f"{key}={interval[1]}"
    return override if value.startswith(("[", "{")) else f"{key}={value.split(',')[0]}"


def test_wrong_use_is_answered_as_the_readme_says(monkeypatch, tmp_path, capfd):
    """The README's example of wrong use gives the very line that it shows."""
    from invdyn_cli.cli import main

    command, said = next((c, output) for c, output in COMMANDS if output.startswith("invdyn:"))
    monkeypatch.chdir(tmp_path)
    for name, value in ENVIRONMENT.items():
        monkeypatch.setenv(name, value)
    assert main(shlex.split(command)[1:]) == 2
    assert capfd.readouterr().err.strip() == said


def test_the_session_is_real(command, monkeypatch):
    """The README's session shows what its command prints, but for the digits that a processor may round otherwise and
    the folder's time."""
    monkeypatch.setenv("COLUMNS", "80")
    typed, shown = COMMANDS[2]
    said = command(*shlex.split(typed)[1:])
    assert said.code == 0, said.err
    assert skeleton("\n".join(said.out)) == skeleton(shown)


@pytest.mark.benchmark  # half a minute; what a diagnosis prints and writes, test_diagnose holds on a smaller arm
def test_the_diagnosis_is_real(command, monkeypatch):
    """So does its diagnosis of a simulated arm, as far as it is shown."""
    monkeypatch.setenv("COLUMNS", "100")
    at = next(i for i, (typed, _) in enumerate(COMMANDS) if typed.startswith("invdyn diagnose"))
    for typed in (COMMANDS[at - 2][0], COMMANDS[at][0]):
        said = command(*shlex.split(typed)[1:])
        assert said.code == 0, said.err
    shown = skeleton(COMMANDS[at][1])[:-1]
    assert COMMANDS[at][1].endswith("…") and skeleton("\n".join(said.out))[: len(shown)] == shown


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path):
    """Every relative link names a file or folder that is there."""
    for target in re.findall(r"\]\(([^)#]+)\)", page.read_text()):
        assert target.startswith("http") or (page.parent / target).exists(), target


def test_lists_of_choices_are_whole():
    """The verbs that --help lists each have a file, and a config if they take options."""
    from invdyn_cli.cli import UNCONFIGURED, VERBS

    for verb in VERBS:
        assert (ROOT / "invdyn_cli" / "verbs" / f"{verb}.py").is_file()
        assert (ROOT / "conf" / f"{verb}.yaml").is_file() != (verb in UNCONFIGURED)
