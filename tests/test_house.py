"""Rules of the house that a reader would have to remember."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.commands import ROOT, python

PACKAGE = ROOT / "invdyn_cli"
MODULES = sorted(PACKAGE.rglob("*.py"))
MOST_LINES = 450
"""A file is one idea; near 200 lines is usual, above 400 asks for a hard look."""


def lint_imports(folder: Path):
    """The contracts of a folder's pyproject.toml, checked on the package beside it."""
    tool = Path(sys.executable).parent / "lint-imports"
    return python(str(tool), "--no-cache", cwd=folder, PYTHONPATH=str(folder))


def test_files_stay_short():
    """No file of the package is longer than MOST_LINES lines."""
    lengths = {str(p.relative_to(ROOT)): len(p.read_text().splitlines()) for p in MODULES}
    assert {name: n for name, n in lengths.items() if n > MOST_LINES} == {}


def test_nothing_is_called_utils():
    """No module is named after nothing in particular."""
    assert [p for p in MODULES if {"util", "utils", "helpers", "misc", "common"} & set(p.with_suffix("").parts)] == []


def test_every_module_says_what_it_is():
    """Each module begins with a docstring, empty __init__.py files aside."""
    assert [p for p in MODULES if p.read_text() and not p.read_text().startswith(('"""', 'r"""'))] == []


def test_parts_of_scipy_are_imported_where_they_are_used():
    """`import scipy` alone: commands that use no part of it do not wait for it."""
    said = {
        str(p.relative_to(ROOT)) for p in MODULES if re.search(r"^\s*(from scipy|import scipy\.)", p.read_text(), re.M)
    }
    assert said == set()


@pytest.mark.parametrize("tool", ["ruff check --quiet", "ruff format --check --quiet", "pyright"])
def test_lint_finds_nothing(tool):
    """Style, formatting and types are those of `make lint`, which `make test` does not call: here it is done beside
    other tests."""
    name, *argv = tool.split()
    argv += ["--pythonpath", sys.executable] if name == "pyright" else []
    said = subprocess.run([Path(sys.executable).parent / name, *argv], cwd=ROOT, capture_output=True, text=True)
    assert said.returncode == 0, said.stdout + said.stderr


def test_imports_run_down_only():
    """The contracts of pyproject.toml hold: layers, and who may open HDF5, read configs, see Pinocchio or MuJoCo."""
    said = lint_imports(ROOT)
    assert said.returncode == 0, said.stdout


BREACHES = {
    "maths/metrics.py": ("from invdyn_cli import experiment", "Imports run down only"),
    "models/pest.py": ("from invdyn_cli.data import sim", "Imports run down only"),
    "report/page.py": ("import h5py", "hdf5 is the only door to h5py"),
    "store.py": ("from omegaconf import OmegaConf", "Only the verbs know of configs"),
    "data/sim.py": ("import pinocchio", "robots is the only door to Pinocchio"),
    "training.py": ("import mujoco", "Only the simulation opens MuJoCo"),
}


@pytest.fixture(scope="module")
def breached(tmp_path_factory) -> str:
    """What is said of a copy of the package in which every contract is broken."""
    folder = tmp_path_factory.mktemp("breached")
    shutil.copy(ROOT / "pyproject.toml", folder)
    shutil.copytree(PACKAGE, folder / "invdyn_cli")
    for name, (line, _) in BREACHES.items():
        path = folder / "invdyn_cli" / name
        path.write_text(f"{line}\n{path.read_text()}")
    said = lint_imports(folder)
    assert said.returncode == 1
    return said.stdout


@pytest.mark.parametrize("name", BREACHES)
def test_the_contracts_bite(name, breached):
    """One import against the rules is found and named, for every contract."""
    contract = BREACHES[name][1]
    module = "invdyn_cli." + name.removesuffix(".py").replace("/", ".")
    assert f"{contract} BROKEN" in breached
    assert module in breached.split("Broken contracts")[1].split(contract, 1)[1]
