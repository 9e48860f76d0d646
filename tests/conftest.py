"""Strictness for all tests (the numerical modules' annotations are checked as they run), and what several share.

`jax_numpy_rank_promotion="raise"` is not set: a number per joint meets rows of samples all over `rigid_body`.
"""

import gc
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from beartype import BeartypeConf
from beartype.claw import beartype_packages

from tests.commands import ENVIRONMENT, Said, at_home

os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(Path(ENVIRONMENT["XDG_CACHE_HOME"]) / "invdyn" / "jax"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.01")
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "0")
"""What one worker has compiled the other one, the commands and the next run take over; before jax is imported."""

gc.set_threshold(100_000, 50, 1000)
"""JAX makes many objects that live on: with Python's own thresholds the search for garbage took 8 % of the time."""

CHECKED = ("maths", "training", "experiment", "store", "adaptation")
beartype_packages([f"invdyn_cli.{name}" for name in CHECKED], conf=BeartypeConf(is_pep484_tower=True))


@pytest.fixture(autouse=True, scope="module")
def few_compiled_programs():
    """A worker runs thousands of tests, and compiles for most of them."""
    from invdyn_cli import leftovers

    leftovers.drop_programs()


@pytest.fixture(scope="session")
def apollo4():
    """The paper's reduced arm: the upper four joints."""
    from invdyn_cli.robots import load_urdf

    return load_urdf("apollo_arm", dofs=4)


@pytest.fixture(scope="session")
def apollo():
    """All seven joints of it."""
    from invdyn_cli.robots import load_urdf

    return load_urdf("apollo_arm")


@pytest.fixture(scope="session")
def data():
    """Twice a hundred samples of a chain of two joints, with its robot."""
    from tests.records import make_dataset, make_robot

    return make_dataset(make_robot(("a", "b")), np.random.default_rng(0), samples=100)


@pytest.fixture(scope="session")
def real_data():
    """Gives the path of a file among the logs and URDFs of real robots, or skips the test with a word."""
    folder = Path(os.environ.get("INVDYN_REAL_DATA", Path(__file__).parents[2] / "shared" / "data"))

    def path(name: str) -> Path:
        if not (folder / name).exists():
            pytest.skip(f"no {name}: set INVDYN_REAL_DATA to a folder with the development logs")
        return folder / name

    return path


@pytest.fixture
def command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd) -> Callable[..., Said]:
    """command("run", "model=pest", …) -> Said: the command line inside the test's own process, in tmp_path."""
    from invdyn_cli.cli import main

    at_home(monkeypatch, tmp_path)

    def call(*argv: str) -> Said:
        capfd.readouterr()
        code = main(argv)
        out, err = capfd.readouterr()
        return Said(code, out.splitlines(), err.splitlines())

    return call
