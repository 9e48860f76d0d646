"""diagnosis.json: the schema invdyn-diagnosis/1, numbers raw."""

import json
import math
from dataclasses import fields, replace

import jax.numpy as jnp
import numpy as np
import pytest

from invdyn_cli import store
from invdyn_cli.types import Check, Gain, Quantity
from tests.diagnoses import log_unusable, make_diagnosis, nothing_found

FILES = {"model": "extended_model.json", "report": "report.html"}
FINDING = {
    "effect",
    "group",
    "joint",
    "status",
    "alternatives",
    "parameters",
    "trajectory",
    "window",
    "gain",
    "evidence",
    "rejected",
    "advice",
}
DESIGN = {
    "schema",
    "verdict",
    "log_checks",
    "standard",
    "baselines",
    "findings",
    "residual_tests",
    "baseline",
    "extended",
    "noise_floor",
    "unexplained",
    "files",
}


def written(diagnosis, folder):
    store.write_diagnosis(diagnosis, folder / "diagnosis.json", FILES)
    assert [x.name for x in folder.iterdir()] == ["diagnosis.json"]
    return json.loads((folder / "diagnosis.json").read_text("utf-8"))


@pytest.mark.parametrize("make", [make_diagnosis, nothing_found, log_unusable])
def test_keys_are_those_of_the_schema(make, tmp_path):
    """The file has exactly the keys of the schema and five additions, down to parameters, gains and checks."""
    diagnosis = make()
    tree = written(diagnosis, tmp_path)
    assert set(tree) == DESIGN | {"summary", "unclaimed", "replay", "notes", "details"}
    assert tree["schema"] == "invdyn-diagnosis/1" and tree["files"] == FILES
    assert set(tree["log_checks"]) == {"usable", "as_recorded", "checks", "corrections", "excitation"}
    assert all(set(x) == {f.name for f in fields(Check)} for x in tree["log_checks"]["checks"])
    assert len(tree["findings"]) == len(diagnosis.findings)
    for x in tree["findings"]:
        assert set(x) == FINDING
        assert all(set(p) == {"value", "unit", "interval95"} for p in x["parameters"].values())
        assert all(set(g) == {f.name for f in fields(Gain)} for g in x["gain"].values())
        assert all(set(r) == {"effect", "why"} for r in x["rejected"])


def test_numbers_are_raw(tmp_path):
    """No number is rounded, and vectors are lists."""
    diagnosis = make_diagnosis()
    tree = written(diagnosis, tmp_path)
    assert tree["baseline"] == diagnosis.baseline
    assert tree["findings"][0]["parameters"]["com"]["value"] == [0.002, 0.02, 0.1]
    assert tree["findings"][4]["alternatives"] == [
        ["asymmetric_coulomb_friction"],
        ["joint_spring", "coulomb_friction"],
    ]
    assert tree["findings"][1]["gain"]["joint2"]["rmse_after"] == diagnosis.findings[1].gain["joint2"].rmse_after


def test_arrays_and_nan(tmp_path):
    """Arrays of numpy and jax become lists, their numbers plain ones, NaN and infinity null; what is unknown, text."""
    diagnosis = make_diagnosis()
    finding = replace(
        diagnosis.findings[0],
        parameters={"mass": Quantity(np.float32(0.5), "kg", jnp.array([0.25, jnp.inf]))},
        evidence={
            "flag": np.bool_(True),
            "count": np.int64(3),
            "deep": {"x": (math.nan, np.array([1, 2]))},
            4: tmp_path,
        },
        window=(np.float64(1.5), 2.0),
    )
    found = written(replace(diagnosis, findings=(finding,)), tmp_path)["findings"][0]
    assert found["parameters"]["mass"] == {"value": 0.5, "unit": "kg", "interval95": [0.25, None]}
    assert found["evidence"] == {"flag": True, "count": 3, "deep": {"x": [None, [1, 2]]}, "4": str(tmp_path)}
    assert found["window"] == [1.5, 2.0]


def test_residual_tests_are_rows_of_their_joint(tmp_path):
    """A row per test under its joint, with the keys of the schema; pictures' curves stay out."""
    diagnosis = make_diagnosis()
    tree = written(diagnosis, tmp_path)["residual_tests"]
    assert sum(map(len, tree.values())) == len(diagnosis.tests)
    assert all({"against", "statistic", "p", "passed"} <= set(x) for rows in tree.values() for x in rows)
    assert not any({"curve", "joint"} & set(x) for rows in tree.values() for x in rows)
    (failed,) = [(joint, x["against"]) for joint, rows in tree.items() for x in rows if not x["passed"]]
    assert failed == ("joint7", "angle")


def test_examination_stands_alone():
    """The same encoder serves check.json: usable, the checks with all their fields in order, excitation."""
    tree = store.examination_as_dict(replace(log_unusable().examination, excitation={"j": {"x": np.nan}}))
    assert tree["usable"] is False and tree["excitation"] == {"j": {"x": None}}
    assert list(tree["checks"][0]) == [f.name for f in fields(Check)]
    assert tree["checks"][0]["value"] == 57.2958
