"""The verdict."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from invdyn_cli.diagnosis.decide.wording import summary, verdict
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.types import Diagnosis, Examination, Finding, Gain, ResidualTest

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


def test_what_may_be_unknown_is_listed():
    """Of a contact and a friction that both may be of an effect that is not in the catalogue, the contact is listed: a
    residual with friction alone explains a log."""
    friction = Finding("coulomb_friction", "b", "ambiguous", group="standard", alternatives=(("unknown",),))
    found = (replace(CONTACT, alternatives=(("unknown",),)), friction)
    errors = {"a": {"rmse": 2.0}, "b": {"rmse": 1.0}}
    diagnosis = Diagnosis("partly_explained", Examination(True, (), {}), found, errors, errors, None, {"a": 0.0})
    told = summary(diagnosis, EFFECTS)
    assert told.endswith("An effect that is not in the catalogue may act instead of external contact on a.")


def test_joints_that_fail_tests_are_listed_too():
    """Beside a joint on which a learner finds something, the summary lists another one whose residual tests find as
    large a share, with those that find most; of more than four it tells the number."""
    against = ("level", "velocity", "angle", "load", "reversals")
    test = ResidualTest("b", "level", 9.0, 1.0, 1e-9, 1.0, 0.2, False, (), "", np.zeros((3, 0)))
    tests = [replace(test, against=x, torque=size) for size, x in enumerate(against, 1)]
    tests.append(replace(test, joint="c", share=0.1))
    errors = {"a": {"rmse": 2.0}, "b": {"rmse": 1.0}, "c": {"rmse": 1.0}}
    still = {"a": 0.5, "b": 0.0, "c": 0.0}
    made = Diagnosis("nothing_found", Examination(True, (), {}), (), errors, errors, None, still, tests=tuple(tests))
    told = summary(made, {})
    assert "An unknown effect remains on a:" in told
    assert told.endswith("on b is not noise according to these tests: reversals, load torque, angle and 2 others.")


@pytest.mark.parametrize("other", ["torque_ripple", "quadratic_friction"])
def test_a_log_of_friction_alone_says_so(other):
    """Where a residual is no noise, the summary says that nothing but friction was found, or not: beside a ripple."""
    found = tuple(Finding(x, "a", "named") for x in ("coulomb_friction", "presliding_hysteresis", other))
    errors = {"a": {"rmse": 2.0}}
    diagnosis = Diagnosis("partly_explained", Examination(True, (), {}), found, errors, errors, None, {"a": 0.5})
    assert ("No other cause than friction was found." in summary(diagnosis, EFFECTS)) == (other == "quadratic_friction")


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


def test_what_most_arms_do_not_have_is_said_first():
    """A ripple stands before friction that makes far more."""
    ripple = Finding("torque_ripple", "b", "named", gain={"b": Gain(1.1, 1.0, 1.1, 1.0, (0.05, 0.15))})
    friction = Finding("coulomb_friction", "a", "named", gain={"a": Gain(9.0, 1.0, 9.0, 1.0, (7.0, 9.0))})
    row = {"coulomb": {"effect": "coulomb_friction", "claimed": True}}
    errors, still = {"a": {"rmse": 1.0}, "b": {"rmse": 1.0}}, {"a": 0.0, "b": 0.0}
    found = (friction, ripple)
    made = Diagnosis("explained", Examination(True, (), {}), found, errors, errors, None, still, standard={"a": row})
    said = summary(made, EFFECTS)
    assert said.startswith("The simulation lacks torque ripple on b and Coulomb friction on a.")


@pytest.mark.parametrize(
    ("others", "said"), [(10.0, "10 to 10 N m over all joints, on b from 1 to 0.5 N m."), (0.1, "joints. ")]
)
def test_the_joint_that_gains_is_named_where_others_hide_it(others, said):
    """A wrist's error falls by half beside a shoulder's that is ten times as large; alone, the whole arm's tells it."""
    found = (Finding("torque_gain_error", "b", "named", gain={"b": Gain(1.0, 0.5, 1.0, 0.5, (0.4, 0.6))}),)
    before, after = ({"a": {"rmse": np.sqrt(2) * others}, "b": {"rmse": x}} for x in (1.0, 0.5))
    still = {"a": 0.0, "b": 0.0}
    made = Diagnosis("explained", Examination(True, (), {}), found, before, after, None, still)
    assert said in summary(made, EFFECTS)
