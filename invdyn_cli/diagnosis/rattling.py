"""Gear play that no formula predicts: flanks that bounce.

A link with play flies from one flank to the other where the torque that its joint transmits changes its sign, and
bounces there. When and how often depends on less than a log shows, so that no model of play follows the torque. Its
blows are seen all the same: most of the squared residual of the joint lies shortly after changes of sign of its load.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from invdyn_cli.diagnosis.columns import gears
from invdyn_cli.diagnosis.columns.evidence import Evidence
from invdyn_cli.diagnosis.decide.doubt import UNKNOWN, or_else
from invdyn_cli.diagnosis.decide.findings import Made, joined
from invdyn_cli.diagnosis.residual_tests import LAGS, near_changes_of_sign
from invdyn_cli.diagnosis.standard import Beside
from invdyn_cli.interfaces import AbstractEffect
from invdyn_cli.recording.rows import runs
from invdyn_cli.types import Finding, Quantity

FLIGHT = 0.2
"""[s] after a change of sign in which blows fall: a gap of 10 mrad takes a link at 0.5 rad/s² as long."""

BEFORE = -0.05
"""[s] up to which nothing is to be seen yet: the load is known no better."""

REVERSAL = 0.1
"""[s] around a joint's own reversal of velocity that does not count: friction is known least there."""

LOUDER = 10.0
"""Squares after a change of sign, in those far from one and in those before, of which blows are the cause. On 240
joints of 52 logs without play, three of real arms, they were at most 11 times as large and at most 37 % of all; on the
joints of 13 plays that bounced 37 to 670 times, and 70 to 99 %."""

CALM = 0.9
"""Share of the other rows, without the largest squares: the load also changes its sign by too little to be seen."""

MOSTLY = 0.5
"""Share of the joint's squared residual that must lie there, and of the changes of sign that must show it."""

FEWEST = 5
"""Changes of sign."""


class Blows(NamedTuple):
    """The squared residual of a joint after changes of sign of its load.

    Attributes:
        blows_over_rest: mean square there, in that far from such changes, or before them.
        share_of_residual: the squares there, of all of the joint.
        changes_of_load: their number.
        moved: the squares there over the inertia that the joint carries: largest where a blow falls, because by its
            joint's motion it makes less than that on all others.
    """

    blows_over_rest: float
    share_of_residual: float
    changes_of_load: int
    moved: float


def told(evidence: Evidence, made: Made, more: Beside, effects: Mapping[str, AbstractEffect]) -> Made:
    """The claims with gear play of unknown size on the joint that rattles, if one does; where another gear effect is
    claimed there, play is its alternative."""
    play = next((e for e in effects.values() if e.yields and "load_zeros" in e.shows), None)
    if play is None or not any(c.effect is play for c in evidence.candidates):
        return made
    claims, names = made.findings[: len(made.terms)], evidence.robot.joints
    load = evidence.nominal + more.columns.of(np.where(more.columns.inertial, more.found.theta, 0.0))
    left = np.array(more.residual)
    yields = [f.effect in effects and effects[f.effect].yields for f in claims]
    for one, term, gear in zip(claims, made.terms, yields, strict=True):
        if gear:
            left += term
        elif one.effect in effects and effects[one.effect].reaches_others:
            load = load + term
    found = {j: x for j in range(evidence.dofs) if (x := blows(evidence, left[:, j], load[:, j], j))}
    j = max(found, key=lambda k: found[k].moved, default=None)
    if j is None or found[j].blows_over_rest < LOUDER or found[j].share_of_residual < MOSTLY:
        return made
    numbers, share = found[j]._asdict(), 100 * found[j].share_of_residual
    there = [gear and f.joint == names[j] for f, gear in zip(claims, yields, strict=True)]
    if any(there):
        doubted = (
            or_else(replace(f, evidence={**f.evidence, **numbers}), (play.name,))
            if own and f.effect != play.name
            else f
            for f, own in zip(claims, there, strict=True)
        )
        return replace(made, findings=(*doubted, *made.findings[len(claims) :]))
    seen = (
        f"{share:.0f} % of the squared residual lie within {FLIGHT:g} s after the load of the joint changed its sign."
    )
    meaning = f"{play.meaning} Here its flanks seem to bounce, at times that no formula predicts: {seen}"
    sizes = {name: Quantity(None, x.unit) for name, x in play.parameters.items() if name not in play.defaults}
    said = {"advice": play.advice, "evidence": numbers, "text": play.text._replace(meaning=meaning)}
    return joined(made, [Finding(play.name, names[j], "ambiguous", (UNKNOWN,), sizes, **said)], [np.zeros_like(left)])


def blows(evidence: Evidence, left: np.ndarray, load: np.ndarray, joint: int) -> Blows | None:
    """The squared residual (R,) of a joint after changes of sign of its `load` (R,); None where these are too few, or
    where it is no larger than elsewhere."""
    valid = evidence.valid[:, joint]
    if not valid.any():
        return None

    turned, changed = (
        list(near_changes_of_sign(x, evidence.piece, evidence.on_rows("t"), valid))
        for x in (evidence.on_rows("qd")[:, joint], load)
    )

    def within(changes: list[tuple[np.ndarray, np.ndarray, float]], low: float, high: float) -> np.ndarray:
        """(R,) whether a change of sign was so long ago [s]."""
        there = np.zeros(len(valid), bool)
        for near, lag, _ in changes:
            there[near] |= (lag >= low) & (lag < high)
        return there

    used, after, squares = valid & ~within(turned, -REVERSAL, REVERSAL), within(changed, 0.0, FLIGHT), left**2
    before, far = used & ~after & within(changed, LAGS[0], BEFORE), used & ~within(changed, LAGS[0], LAGS[-1])
    events = [x[used[x]] for x in (np.arange(*run) for run in runs(after)) if used[x].any()]
    after = used & after
    if len(events) < FEWEST or far.sum() < after.sum():
        return None
    quiet = max(_mostly(squares[x]) for x in (far, before) if x.any())
    loud = [np.mean(squares[x]) > LOUDER * quiet for x in events]
    if not quiet > 0 or np.mean(loud) < MOSTLY:
        return None
    there = float(np.sum(squares[after]))
    return Blows(
        blows_over_rest=float(np.mean(squares[after])) / quiet,
        share_of_residual=there / float(np.sum(squares[used])),
        changes_of_load=len(events),
        moved=there / gears.inertia_on(evidence, joint),
    )


def _mostly(squares: np.ndarray) -> float:
    """The mean of the smallest of these."""
    return float(np.mean(np.sort(squares)[: max(1, int(CALM * len(squares)))]))
