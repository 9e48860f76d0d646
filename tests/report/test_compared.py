"""Runs beside each other: which share a time axis, which colours they have, and what is said of them."""

import json
import re
from dataclasses import replace

from invdyn_cli import store
from invdyn_cli.report.compared import LOOKS, MOST_CURVES, Compared, bars, page, summary
from tests.records import make_record


def compared(name: str, **changes) -> Compared:
    record = make_record(2, **changes)
    return Compared(name, store.plain(store.metrics(record)), record)


def figures(text: str) -> list[dict]:
    return [json.loads(x) for x in re.findall(r'<script type="application/json">(.*?)</script>', text, re.DOTALL)]


def test_runs_on_the_same_test_data_share_an_axis():
    """Two runs on the same test set are in one figure, a third on another set in a figure of its own; each keeps the
    colour that its bar has, and the summary says that the sets differ."""
    runs = [compared("a"), compared("b", error=2.0), compared("c", samples=300)]
    both, alone = figures(page(runs, [], "x"))
    lines = {x["name"]: x["colour"] for x in both["panels"][0]["lines"]}
    assert lines == {"measured": "ink", "a": LOOKS[0], "b": LOOKS[1]}
    assert {x["name"]: x["colour"] for x in alone["panels"][0]["lines"]} == {"measured": "ink", "c": LOOKS[2]}
    assert "2 different sets" in summary(runs)


def test_the_best_of_many_have_curves():
    """Of more runs than have colours the MOST_CURVES with the lowest errors are drawn over time, and each has a bar of
    its mean error that begins at zero."""
    runs = [compared(f"run {i}", error=1.0 + i) for i in range(9)]
    [drawn] = figures(page(runs, [], "x"))
    assert [x["name"] for x in drawn["panels"][0]["lines"]] == ["measured", *(f"run {i}" for i in range(MOST_CURVES))]
    axes = bars(runs).axes[0]
    found = axes.patches
    assert len(found) == 9 and axes.get_xlim()[0] == 0


def test_what_differs_in_the_configs():
    """Options with other values stand in a table, those that are the same do not."""
    one, other = compared("a"), compared("b", error=2.0)
    assert other.record is not None
    other = replace(other, record=replace(other.record, config="model:\n  rate: 0.5\n  layers: [64, 64]\nseed: 0\n"))
    text = page([one, other], [], "x")
    assert "model.rate" in text and ">0.5</td>" in text and "model.layers" not in text


def test_a_run_without_a_test_set():
    """Numbers that are not there are dashes, and nothing is called the best."""
    bare = Compared("bare", {"joints": ["a"], "parameters": 3})
    text = page([bare, bare], [], "x")
    assert "No run has an error on a test set." in text and "<b>" not in text and "None s" not in text
