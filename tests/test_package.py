"""One import offers what the docs use, and loads nothing before it is needed."""

import ast
import re
import tomllib

import pytest

import invdyn_cli as invdyn
from tests.commands import ROOT, python
from tests.test_cli import HEAVY


def test_import_loads_nothing_heavy(tmp_path):
    """`import invdyn_cli`, and asking what it offers, load no package but its own."""
    code = "import sys, invdyn_cli; dir(invdyn_cli); print(*sys.modules)"
    said = python("-c", code, cwd=tmp_path)
    loaded = {name.split(".")[0] for name in said.stdout.split()}
    assert "invdyn_cli" in loaded and not loaded & {*HEAVY, "pandas", "sklearn"}


def test_what_only_describes_leaves_jax_as_it_is(tmp_path):
    """`invdyn_cli.types` and `log` may stand beside other code that uses jax in 32 bit; what computes switches it."""
    show = "import sys, jax, invdyn_cli.types, invdyn_cli.log; print(jax.config.jax_enable_x64); "
    said = python("-c", f"{show} import invdyn_cli.interfaces; print(jax.config.jax_enable_x64)", cwd=tmp_path)
    assert said.stdout.split() == ["False", "True"], said.stderr
    said = python("-c", "import jax, invdyn_cli.maths; print(jax.config.jax_enable_x64)", cwd=tmp_path)
    assert said.stdout.split() == ["True"], said.stderr


def test_editors_see_what_is_offered():
    """The imports for type checkers, `__all__`, the table of modules and `dir()` name the same things, from the same
    modules."""
    tree = ast.parse((ROOT / "invdyn_cli" / "__init__.py").read_text())
    typed = next(node for node in tree.body if isinstance(node, ast.If))
    seen = {x.name: (one.module or "").removeprefix("invdyn_cli.") for one in typed.body
            if isinstance(one, ast.ImportFrom) for x in one.names}  # fmt: skip
    assert seen == invdyn._OFFERED and sorted(seen) == invdyn.__all__
    assert set(invdyn.__all__) <= set(dir(invdyn))


@pytest.mark.parametrize("name", [x for x in invdyn.__all__ if x != "InverseDynamicsRegressor"])
def test_everything_offered_is_there(name):
    """Every name leads to an object of that name."""
    assert getattr(invdyn, name).__name__ == name


def test_what_is_not_offered_is_no_attribute():
    """A misspelt name is an AttributeError, as of any module."""
    with pytest.raises(AttributeError, match="'invdyn_cli' has no attribute 'diagnoze'"):
        _ = invdyn.diagnoze


def test_the_docs_use_what_is_offered():
    """README, page and notebook use no other name of the package, and the page leaves none out."""
    pages = {name: (ROOT / name).read_text() for name in ("README.md", "docs/python.md", "docs/notebook.ipynb")}
    used = {name for text in pages.values() for name in re.findall(r"\binvdyn\.([A-Za-z]\w*)", text)}
    assert used <= set(invdyn.__all__)
    assert [name for name in invdyn.__all__ if not re.search(rf"\b{name}\b", pages["docs/python.md"])] == []


def test_what_make_and_the_docs_install_exists():
    """Every dependency group that the Makefile asks for, and every extra that code, docs and README name, is one of
    pyproject.toml; a group that was missing made `make docs` end with an error."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    groups = re.findall(r"--group (\w+)", (ROOT / "Makefile").read_text())
    assert groups and set(groups) <= set(project["dependency-groups"])
    pages = [ROOT / "README.md", *(ROOT / "docs").glob("*.md"), *(ROOT / "invdyn_cli").rglob("*.py")]
    extras = re.findall(r"invdyn\[(\w+(?:,\w+)*)\]", "".join(page.read_text() for page in pages))
    assert extras
    assert {one for some in extras for one in some.split(",")} <= set(project["project"]["optional-dependencies"])
