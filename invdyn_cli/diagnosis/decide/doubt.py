"""A finding that may be something else."""

from dataclasses import replace

from invdyn_cli.types import Finding

UNKNOWN = ("unknown",)
"""The alternative of a finding that may be of an effect which is not in the catalogue."""

BEYOND = 3.0
"""An effect is named if it saves this many times the variance that stays unexplained on its joints, noise not counted,
and this many times what a learner still predicts there; else it is "or unknown"."""


def or_else(found: Finding, *others: tuple[str, ...], advice: str = "") -> Finding:
    """The same, ambiguous with these sets of effects beside its own alternatives; `advice` in the place of its own."""
    alternatives = tuple(dict.fromkeys((*found.alternatives, *others)))
    return replace(found, status="ambiguous", alternatives=alternatives, advice=advice or found.advice)
