"""What is said of a loop follows from its runs: a smaller, a larger or the same error, or out of control."""

import json

import numpy as np
import pytest

from invdyn_cli.control import ADAPTED, ALONE, LEARNED, Case, ControlRecord, Sweep
from invdyn_cli.report import controlled


def record(learned: float, adapted: float) -> ControlRecord:
    """Two joints, one gain, feedback alone off by 5 degrees; NaN for a run that failed."""
    cases = []
    for loaded in (False, True):
        for kind, off in ((ALONE, 5.0), (LEARNED, learned), (ADAPTED, adapted)):
            error = np.full(2, off)
            why = "" if np.isfinite(off) else "it fell"
            what = {"stages": {"grasp": error}, "feedback": error, "torque": np.full(2, 10.0), "tick": (1e-4, 1e-3)}
            cases.append(Case(20.0, loaded, kind, 1, error=error, peak=2 * error, failed=why, **what))
    return ControlRecord(("a", "b"), np.ones(2), Sweep(gains=(20.0,)), tuple(cases), (), {"total": 1.0})


@pytest.mark.parametrize(
    ("learned", "adapted", "words"),
    [
        (1.0, 0.5, ("5.0 times smaller", "10.0 times smaller, 2.0 times smaller than without adaptation")),
        (1.0, 1.0, ("the same as without adaptation",)),
        (0.820, 0.787, ("6.4 times smaller, 4 % smaller than without adaptation",)),
        (0.787, 0.820, ("6.1 times smaller, 4 % larger than without adaptation",)),
        (1.0, 0.995, ("the same as without adaptation",)),
        (1.0, 1.005, ("the same as without adaptation",)),
        (1.0, 0.840, ("16 % smaller than without adaptation",)),
        (1.0, 0.830, ("1.2 times smaller than without adaptation",)),
        (4.5, 5.5, ("the model it is 10 % smaller", "adapted model it is 10 % larger, 1.2 times larger than")),
        (0.5, 2.0, ("4.0 times larger than without adaptation",)),
        (10.0, np.nan, ("2.0 times larger", "adapted: it fell")),
    ],
)
def test_sentences_follow_from_the_runs(learned, adapted, words):
    """Ratios are those of the errors, the right way round, in per cent where they are small; who fell is told."""
    said = " ".join(controlled.sentences(record(learned, adapted)))
    assert all(word in said for word in words), said
    assert "nan" not in said and "smaller smaller" not in said


def test_files_hold_no_nan(tmp_path):
    """A run that failed is null in the JSON, empty in the CSV, and missing in the figure."""
    made = record(1.0, np.nan)
    cases = json.loads(controlled.as_json(made, {"model": "m"}))["cases"]
    assert [x["error_deg"]["rms"] for x in cases] == [5.0, 1.0, None] * 2
    assert cases[2]["failed"] == "it fell" and cases[0]["failed"] is None
    assert "nan" not in controlled.as_csv(made)
    controlled.draw(made, "m, a", [tmp_path / "control.png"])
    assert (tmp_path / "control.png").stat().st_size > 1000
