"""The command line inside the test's own process: as a user would call it, in an empty folder."""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from invdyn_cli.cli import main
from tests.commands import ENVIRONMENT


@dataclass(frozen=True)
class Said:
    """What a command left: exit code, lines on stdout and stderr."""

    code: int
    out: list[str]
    err: list[str]


@pytest.fixture
def command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd) -> Callable[..., Said]:
    """command("run", "model=pest", …) -> Said, in tmp_path; what it changes in the process is undone."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr(sys, "argv", list(sys.argv))
    for name, value in {**ENVIRONMENT, "HYDRA_FULL_ERROR": "1"}.items():
        monkeypatch.setenv(name, value)

    def call(*argv: str) -> Said:
        capfd.readouterr()
        code = main(argv)
        out, err = capfd.readouterr()
        return Said(code, out.splitlines(), err.splitlines())

    return call
