"""Runs the command line as a user would, in a process of its own, and nowhere near the user's home."""

import os
import subprocess
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
ENVIRONMENT = {
    "XDG_CACHE_HOME": str(ROOT / ".cache"),
    "JAX_PLATFORMS": "cpu",
    "COLUMNS": "200",
    "INVDYN_PROGRESS": "off",
}
"""What makes commands quick and alike: compiled programs stay in the checkout's .cache, which git ignores, and a slow
machine adds no lines of progress to stderr."""

TINY = ("data.duration=2", "robot.dofs=2")
"""Simulated data that are made at once: two joints, half a second of each task after trimming 500 samples."""


@dataclass(frozen=True)
class Said:
    """What a command left: exit code, lines on stdout and stderr."""

    code: int
    out: list[str]
    err: list[str]


def python(*argv: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """`python argv…` in `cwd`."""
    env = {**os.environ, **ENVIRONMENT, **environment}
    return subprocess.run([sys.executable, *argv], cwd=cwd, env=env, capture_output=True, text=True, timeout=300)


def invdyn(*argv: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """`invdyn argv…` in `cwd`, by the installed script."""
    return python(script(), *argv, cwd=cwd, **environment)


def at_home(patch: pytest.MonkeyPatch, folder: Path) -> None:
    """Until the patch ends this process is in a folder, with a command's environment and a search path of its own."""
    patch.chdir(folder)
    patch.setattr(sys, "path", list(sys.path))
    patch.setattr(sys, "argv", list(sys.argv))
    for name, value in {**ENVIRONMENT, "HYDRA_FULL_ERROR": "1"}.items():
        patch.setenv(name, value)


def in_process(*argv: str, cwd: Path) -> int:
    """A command in this process, for fixtures of a module (tests have the fixture `command`): its exit code."""
    from invdyn_cli.cli import main

    with pytest.MonkeyPatch.context() as patch:
        at_home(patch, cwd)
        return main(argv)


def script(folder: Path | None = None) -> str:
    """The `invdyn` that was installed into a folder; None: beside this Python."""
    return str((folder or Path(sys.executable).parent) / "invdyn")


def usually(always: Iterable[Any], values: Iterable[Any]) -> list[Any]:
    """The values of a test of which `make test` tries some, and `make test marked=benchmark` the others."""
    later = pytest.mark.benchmark
    return [x if x in always else pytest.param(*(x if isinstance(x, tuple) else (x,)), marks=later) for x in values]


def tree(folder: Path) -> Mapping[str, float]:
    """All files below a folder, and when each was written."""
    return {str(p.relative_to(folder)): p.stat().st_mtime_ns for p in sorted(folder.rglob("*")) if p.is_file()}
