"""The page beside the paper: its two tables, its count of statements, what is left out."""

from dataclasses import replace

import pytest

from invdyn_cli.models.ffnn import Ffnn
from invdyn_cli.report import paper
from invdyn_cli.report.comparison import Grid
from invdyn_cli.report.paper import Exhibit
from tests.records import make_record


def grid(*verdicts):
    return Grid(("the paper", "verdict"), tuple((f"statement {i}", x) for i, x in enumerate(verdicts)))


def run(learned, tested):
    record = make_record(2)
    return replace(record, split={"train_Hz": learned, "test_Hz": tested}, samples={"train": 9, "test": 4})


def test_our_nets_are_those_of_table_one():
    """What `model=ffnn` is by default is Table I for all seven joints; a net that differs is said to."""
    assert {row[-1] for row in paper.table_one(Ffnn()).rows} == {"the same"} and len(paper.table_one(Ffnn()).rows) == 7
    changed = paper.table_one(Ffnn(epochs=50, joints={2: {"hidden": [100, 100]}}))
    assert {row[-1] for row in changed.rows} == {"differs"}


def test_tasks_are_compared_with_table_two():
    """The tasks that a run learned and tested stand beside the paper's, a row for each set there is a run of."""
    runs = {
        ("sim_clean", "interpolation"): run([0.1, 0.2, 0.3, 0.4, 0.7, 0.8], [0.5, 0.6]),
        ("sim_noisy", "extrapolation"): run([0.1, 0.2, 0.3, 0.4, 0.5], [0.7, 0.8]),
    }
    rows = paper.table_two(runs).rows
    assert [row[-1].split(":")[0] for row in rows] == ["the same tasks", "differs"]
    assert rows[0][3] == "27,000, 9,000" and rows[0][4] == "9, 0, 4"


@pytest.mark.parametrize(
    ("verdict", "kind"),
    [
        ("holds", "holds"),
        ("holds for 1 of 2: above by up to 3 x; why", "partly"),
        ("differs: below by up to 2 x", "differs"),
        ("not run", "not"),
    ],
)
def test_kinds_of_verdicts(verdict, kind):
    """A verdict in words has one of four kinds."""
    assert paper.kind_of(verdict) == kind


def test_statements_are_counted():
    """The lead counts all statements of all experiments by their kind, and names no kind that there is not."""
    said = paper.summary([grid("holds", "holds for 1 of 2: x"), grid("holds", "differs: y")])
    assert "Of 4 statements" in said and ", 2 hold, 1 hold in part, 1 do not hold." in said


def test_what_is_left_out_is_said():
    """An experiment without its logs stays on the page with the reason; text of a user's is no markup."""
    shown = Exhibit("Here <1>", "source", "command", table=grid("x"), verdicts=grid("holds; because <b>"))
    text = paper.page([shown, Exhibit("There", "source", "command", absent="needs a log")], None, None)
    assert "Left out: needs a log" in text and "Here &lt;1&gt;" in text and "because &lt;b&gt;" in text
    assert "Table I" not in text
