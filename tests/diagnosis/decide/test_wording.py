"""The verdict."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from invdyn_cli.diagnosis.decide.wording import verdict
from invdyn_cli.types import Finding

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
