"""invdyn figures: experiments become pictures and a page, and runs are kept while nothing changed."""

import pytest
import yaml

from invdyn_cli.verbs import origin
from tests.commands import TINY

SPEC = {
    "title": "Small",
    "source": "a test",
    "columns": "sets",
    "common": [*TINY, "data=sim_clean", "model=ffnn", "model.epochs=1"],
    "jobs": [{"name": "NN", "overrides": [], "sweep": {"data": ["sim_clean"], "data.split": ["interpolation"]}}],
    "figure": {"title": "One bar", "groups": ["data"], "bars": {"NN": {"name": "NN"}}},
    "figures": [
        {
            "file": "train",
            "title": "One more",
            "groups": ["data"],
            "bars": {"NN": {"name": "NN", "set": "train"}},
            "caption": "What was learned.",
        },
    ],
    "paper_tables": {"name": "NN"},
    "statements": [{"paper": "good", "claim": "always", "each": {"name": "NN"}, "band": [0, 1e6]}],
}
MISSING = {**SPEC, "title": "Far away", "common": ["data=real_log", "data.path=${real_data}/none.h5", "model=ffnn"]}


@pytest.fixture
def experiments(tmp_path):
    folder = tmp_path / "experiments"
    folder.mkdir()
    for name, spec in (("small", SPEC), ("far", MISSING)):
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(spec))
    return tmp_path


def test_a_page_of_all_experiments(experiments, command):
    """The figure in the formats asked for, the table, and a page with the paper's tables; an experiment whose logs are
    missing is left out with a word; run again, no job runs anew until the code of learning changes."""
    call = "figures", "shown=[small,far]", "formats=[svg]", "real_data=nowhere"
    done = command(*call)
    assert done.code == 0, done.err
    drawn = experiments / "outputs" / "figures"
    assert {path.name for path in drawn.iterdir()} == {f"small{x}.{y}" for x in ("", "_train") for y in ("png", "svg")}
    assert (experiments / "outputs/tables/small.md").is_file()
    page = (experiments / "outputs/paper/index.html").read_text()
    assert (
        "Of 1 statements" in page
        and ", 1 hold." in page
        and "What was learned." in page
        and "Table I:" in page
        and "Left out: experiment far needs" in page
    )
    assert any("far is left out" in line for line in done.out)
    run = next((experiments / "outputs/tables/small").glob("*/metrics.json"))
    before = run.stat().st_mtime_ns
    assert command(*call).code == 0 and run.stat().st_mtime_ns == before


def test_changed_code_runs_again(experiments, command, monkeypatch):
    """A complete run is no longer complete when the code that learned it has changed."""
    assert command("figures", "shown=[small]").code == 0
    run = next((experiments / "outputs/tables/small").glob("*/metrics.json"))
    before = run.stat().st_mtime_ns
    monkeypatch.setattr(origin, "fingerprint", lambda: "another")
    assert command("figures", "shown=[small]").code == 0 and run.stat().st_mtime_ns > before


@pytest.mark.parametrize(
    ("argument", "said"), [("shown=[smal]", "did you mean 'small'?"), ("formats=[gif]", "png, svg, pdf")]
)
def test_wrong_use_is_one_line(experiments, command, argument, said):
    """An unknown experiment or format is told in one line with exit code 2, and nothing is written."""
    done = command("figures", argument)
    assert done.code == 2 and len(done.err) == 1 and said in done.err[0]
    assert not (experiments / "outputs" / "paper").exists()
