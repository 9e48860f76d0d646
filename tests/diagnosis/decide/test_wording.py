"""The verdict."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from invdyn_cli.diagnosis.decide.wording import summary, verdict
from invdyn_cli.types import Diagnosis, Examination, Finding

CONTACT = Finding("external_contact", "a", "ambiguous", window=(4.0, 9.0), trajectory="one")


@pytest.mark.parametrize(
    ("alternatives", "said"),
    [((("payload_change",),), "explained"), ((("payload_change",), ("unknown",)), "partly_explained")],
)
def test_what_may_be_unknown_explains_nothing(alternatives, said):
    """A residual of noise alone: contacts that may be payloads explain the log, contacts that may be of an effect that
    is not in the catalogue do not."""
    finding = replace(CONTACT, alternatives=alternatives)
    made = SimpleNamespace(findings=(finding,), before=np.ones((10, 1)))
    nothing = np.zeros(1)
    extended = {"a": {"rmse": 0.01}}
    assert verdict(cast(Any, made), nothing, np.zeros(1, bool), nothing, None, extended) == said


@pytest.mark.parametrize(
    ("slides", "said"), [("z", "5 N m over all joints except z."), ("xyz", "6 N over all joints.")]
)
def test_an_error_has_one_unit(slides, said):
    """The error of all joints together is that of joints with one unit, the usual one; others are named."""
    errors = {"x": {"rmse": 3.0}, "y": {"rmse": np.sqrt(41)}, "z": {"rmse": np.sqrt(58)}}
    units = {joint: {"offset": {"unit": "N" if joint in slides else "N m"}} for joint in errors}
    still = dict.fromkeys(errors, 0.0)
    diagnosis = Diagnosis("nothing_found", Examination(True, (), {}), (), errors, errors, None, still, standard=units)
    assert said in summary(diagnosis, {})


@pytest.mark.parametrize(
    ("rmse", "said"),
    [
        (0.01, "is 3 N m over all joints; with its unclaimed links and standard terms, the written model has 0.01 N m"),
        (3.0, "is 3 N m over all joints."),
    ],
)
def test_what_is_written_though_nothing_is_claimed_is_said(rmse, said):
    """Where links that are all a little off explain a log, no cause has a name, but the written model is far better."""
    before, after = {"x": {"rmse": 3.0}}, {"x": {"rmse": rmse}}
    diagnosis = Diagnosis("nothing_found", Examination(True, (), {}), (), before, after, None, {"x": 0.0})
    assert said in summary(diagnosis, {})
