"""docs/notebook.ipynb runs from its first cell to its last, and shows what comes out."""

import re

import pytest

from tests.commands import ENVIRONMENT, ROOT
from tests.test_readme import skeleton

nbformat = pytest.importorskip("nbformat", reason="nbclient is not installed")
nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed")
pytest.importorskip("ipykernel", reason="ipykernel is not installed")
pytest.importorskip("pandas", reason="pandas is not installed")

PATH = ROOT / "docs" / "notebook.ipynb"


def texts(notebook) -> list[list[str]]:
    """What each cell of code shows as text, without its digits and blanks."""
    shown = []
    for cell in notebook.cells:
        if cell.cell_type == "code":
            parts = (x.get("text") or x.get("data", {}).get("text/plain", "") for x in cell.outputs)
            shown.append(skeleton(re.sub(r"[─.\[\]-]", "", "\n".join(parts))))
    return shown


@pytest.mark.benchmark  # its calls are those of tests/functions
def test_the_notebook_shows_what_comes_out(monkeypatch):
    """Executed again, every cell shows the text that is committed, but for digits, which processors round otherwise; no
    output is an error."""
    for name, value in ENVIRONMENT.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    committed, notebook = nbformat.read(PATH, 4), nbformat.read(PATH, 4)
    nbclient.NotebookClient(notebook, timeout=900, resources={"metadata": {"path": str(ROOT / "docs")}}).execute()
    kinds = {x.output_type for cell in committed.cells if cell.cell_type == "code" for x in cell.outputs}
    assert kinds == {"execute_result", "display_data", "stream"}
    assert texts(notebook) == texts(committed)


def test_the_notebook_is_small_and_names_no_machine():
    """The file stays below 100 kB, and no output holds a path."""
    text = PATH.read_text()
    assert len(text) < 100_000 and not re.search(r"/(home|root|tmp|Users)/", text)
