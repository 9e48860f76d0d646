"""Offset and friction of each joint before and now: the two logs of a comparison, each fitted by itself.

What has changed too little to be named, or in a way that has several names, still shows there.
"""

from typing import Any

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Evidence
from invdyn_cli.diagnosis.decide.findings import Made
from invdyn_cli.diagnosis.decide.intervals import reach
from invdyn_cli.diagnosis.standard import SYSTEMATIC, TERMS, Beside, Columns, place_of, stretches
from invdyn_cli.effects.actuator import RotorInertia
from invdyn_cli.maths import standard

LOGS = ("reference", "now")

SURE = 2.3
"""95 % intervals by which two sizes differ for sure: that is 99.9 % with eight stretches of time (Student's t with 7
degrees of freedom), and an arm of seven joints has 21 pairs of sizes."""


def each_log(evidence: Evidence, made: Made, more: Beside) -> dict[str, dict[str, dict[str, Any]]]:
    """{joint: {term: {"reference": (value, lower, upper), "now": …, "differ": …}}} of offset, Coulomb and viscous
    friction: least squares of what links, rotors and all other changes leave of each log. They differ if that is
    SURE. Nothing where there is no reference."""
    columns, reference = more.columns, evidence.reference_rows
    if reference is None or not more.asked:
        return {}
    own = more.found.theta[~columns.inertial].reshape(-1, evidence.dofs)
    friction = np.array([TERMS[term][0] != RotorInertia.name for term in columns.terms])
    free = np.r_[np.zeros(len(columns.links), bool), np.repeat(friction, evidence.dofs)]
    left = made.whole - columns.of(np.where(free, 0.0, more.found.theta))
    fits = {log: _fitted(columns, left, rows, free) for log, rows in zip(LOGS, (reference, ~reference), strict=True)}
    out: dict[str, dict[str, dict[str, Any]]] = {joint: {} for joint in evidence.robot.joints}
    for t in np.flatnonzero(friction):
        name = TERMS[columns.terms[t]][1]
        for j, joint in enumerate(evidence.robot.joints):
            place = place_of(more.acting, columns.terms[t], j)
            changed = 0.0 if place is None else float(more.acting[place].parameters[name]) - own[t, j]
            values = [fits["reference"][0][t, j], fits["now"][0][t, j] + changed]
            halves = [fits[log][1][t, j] for log in LOGS]
            differ = abs(values[1] - values[0]) > SURE * np.hypot(*halves)
            told = {log: (float(x), float(x - h), float(x + h)) for log, x, h in zip(LOGS, values, halves, strict=True)}
            out[joint][columns.terms[t]] = told | {"differ": bool(differ)}
    return out


def _fitted(columns: Columns, left: np.ndarray, rows: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The terms (terms, n) by least squares of what is `left` (R, n) on some rows (R,), and half of their 95 %
    intervals: the scatter between stretches of time, and SYSTEMATIC."""
    parts = [columns.sums(left, x) for x in stretches(rows)]
    every = standard.line(parts, free)
    others = np.stack([standard.line([x for x in parts if x is not one], free) for one in parts])
    half = np.hypot(reach([others], np.zeros((1, len(every)))), 2 * SYSTEMATIC * every)
    return tuple(x[~columns.inertial].reshape(len(columns.terms), -1) for x in (every, half))
