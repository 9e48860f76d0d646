"""Gear play that no formula predicts: flanks that bounce.

A link with play flies from one flank to the other where the torque that its joint transmits changes its sign, and
bounces there. When and how often depends on less than a log shows, so that no model of play follows the torque. Its
blows are seen all the same: most of what is left on the joint lies in the moments after its load changed its sign.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from invdyn_cli.diagnosis.columns import gears
from invdyn_cli.diagnosis.columns.evidence import Evidence
from invdyn_cli.diagnosis.decide.doubt import UNKNOWN, or_else
from invdyn_cli.diagnosis.decide.findings import Made, joined
from invdyn_cli.diagnosis.residual_tests import around
from invdyn_cli.diagnosis.standard import Beside
from invdyn_cli.interfaces import AbstractEffect
from invdyn_cli.types import Finding, Quantity

FLIGHT = 0.2
"""[s] after a change of sign in which blows fall: a gap of 10 mrad takes a link at 0.5 rad/s² as long."""

BEFORE = -0.05
"""[s] up to which nothing is to be seen yet: the load is known no better."""

REVERSAL = 0.1
"""[s] around a joint's own reversal of velocity that does not count: friction is known least there."""

LOUDER = 20.0
"""Squares after a change of sign, in those far from one and in those before, of which blows are the cause. On 30 arms
without play, where load and velocity often change their signs together, they were at most 7 times as large; on 3 with
play 50 to 780 times."""

MOSTLY = 0.5
"""Share of what is left on the joint that must lie there, and of the changes of sign that must show it."""

FEWEST = 5
"""Changes of sign."""


class Blows(NamedTuple):
    """What is left on a joint after its load changed its sign.

    Attributes:
        louder: mean square there, in that far from such changes.
        share: of all squares that are left on the joint.
        count: number of such changes.
        moved: sum of squares, over the inertia that the joint carries.
    """

    louder: float
    share: float
    count: int
    moved: float


def told(evidence: Evidence, made: Made, more: Beside, effects: Mapping[str, AbstractEffect]) -> Made:
    """The claims with gear play of unknown size on the joint that rattles, if one does; where another gear effect is
    claimed there, play is its alternative."""
    play = next((e for e in effects.values() if e.yields and "load_zeros" in e.shows), None)
    if play is None or not any(c.effect is play for c in evidence.candidates):
        return made
    claims, terms = made.findings[: len(made.terms)], made.terms
    names = evidence.robot.joints
    load = evidence.nominal + more.columns.of(np.where(more.columns.inertial, more.found.theta, 0.0))
    left = np.array(more.residual)
    for one, term in zip(claims, terms, strict=True):
        effect = effects.get(one.effect)
        if effect is not None and effect.yields:
            left += term
        elif effect is not None and effect.reaches_others:
            load = load + term
    found = {j: x for j in range(evidence.dofs) if (x := blows(evidence, left[:, j], load[:, j], j))}
    if not found:
        return made
    j = max(found, key=lambda k: found[k].moved)
    one = found[j]
    if one.louder < LOUDER or one.share < MOSTLY:
        return made
    numbers = {"blows_over_rest": one.louder, "share_of_residual": one.share, "changes_of_load": one.count}
    gears_there = [f for f in claims if f.joint == names[j] and f.effect in effects and effects[f.effect].yields]
    if gears_there:
        doubted = [
            or_else(replace(f, evidence={**f.evidence, **numbers}), (play.name,))
            if f in gears_there and f.effect != play.name
            else f
            for f in claims
        ]
        return replace(made, findings=(*doubted, *made.findings[len(claims) :]))
    unknown = {x: Quantity(None, y.unit) for x, y in play.parameters.items() if x not in play.defaults}
    finding = Finding(
        play.name, names[j], "ambiguous", (UNKNOWN,), unknown, advice=play.advice, evidence=numbers, text=play.text
    )
    return joined(made, [finding], [np.zeros_like(left)])


def blows(evidence: Evidence, left: np.ndarray, load: np.ndarray, joint: int) -> Blows | None:
    """What is left (R,) of a joint's torque after its `load` (R,) changed its sign; None where it does so too rarely,
    or where that looks like what comes before."""
    t, used = evidence.on_rows("t"), evidence.valid[:, joint]
    if not used.any():
        return None
    since, turned = (around(x, evidence.piece, t, used, "").over for x in (load, evidence.on_rows("qd")[:, joint]))
    used = used & ~(np.abs(turned) < REVERSAL)
    after, far = used & (since >= 0) & (since < FLIGHT), used & ~np.isfinite(since)
    events = np.flatnonzero(np.diff(after.astype(int)) == 1)
    before = used & (since < BEFORE)
    if len(events) < FEWEST or far.sum() < after.sum():
        return None
    squares = left**2
    quiet = max(float(np.mean(squares[x])) for x in (far, before) if x.any())
    each = [float(np.mean(x)) for x in np.split(squares[after], np.flatnonzero(np.diff(np.flatnonzero(after)) > 1) + 1)]
    if not quiet > 0 or np.mean(np.array(each) > LOUDER * quiet) < MOSTLY:
        return None
    sum_there = float(np.sum(squares[after]))
    return Blows(
        float(np.mean(squares[after])) / quiet,
        sum_there / float(np.sum(squares[used])),
        len(each),
        sum_there / float(np.mean(gears.inertia_on(evidence, joint))),
    )
