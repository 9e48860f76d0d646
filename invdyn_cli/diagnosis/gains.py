"""Drive gains of a log of currents that does not say them, from the masses of the URDF.

    gain_j current_j = Y_j (phi + dphi) + offset + coulomb sign(qd) + viscous qd + armature qdd   (a gain per joint)

Divided by the gain the equation is linear: the nominal torque of a joint is one more column of the standard model
(`maths/standard.py`), and its factor is 1 / gain. Gravity and inertia of known links tell it; where neither shows on a
joint, friction and rotor alone remain, of which only ratios are known. Gautier and Briot, ASME JDSMC 2014.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from invdyn_cli.diagnosis import wear
from invdyn_cli.diagnosis.columns.evidence import started
from invdyn_cli.diagnosis.decide.wording import SINCE
from invdyn_cli.diagnosis.since import LOGS
from invdyn_cli.diagnosis.standard_columns import columns_of, std_of
from invdyn_cli.joints import units
from invdyn_cli.log import Log
from invdyn_cli.maths.metrics import rms
from invdyn_cli.recording.channels import in_newton_metres
from invdyn_cli.recording.pieces import Preparation, prepare
from invdyn_cli.types import Diagnosis, Finding, Gain, Quantity, Robot

KNOWN = 0.1
"""Relative standard error above which a gain is not known: sizes within 10 % are called right (`experiments.worn`)."""

SHOWN = 1.0
"""RMS of what is left of a joint's torque, which its nominal torque must exceed for its factor to be believed: friction
that no standard term has goes with gravity and inertia as well (a UR10e's second wrist: 0.3, and half its gain)."""

ROUNDS = 3
"""Of fitting and dividing by the factor: filters and noise depend on the torque's scale."""


@dataclass(frozen=True)
class Gains:
    """Drive gains (n,) with their standard errors; `known` (n,): whether masses tell them; `units`: N m/A, N/A of a
    joint that slides."""

    joints: tuple[str, ...]
    units: tuple[str, ...]
    value: np.ndarray
    error: np.ndarray

    @property
    def known(self) -> np.ndarray:
        """(n,) bool."""
        return self.error < KNOWN * self.value

    def told(self) -> dict[str, dict[str, Any]]:
        """As the written model records them."""
        rows = zip(self.joints, self.units, self.value, self.error, self.known, strict=True)
        return {
            joint: {"value": float(x), "standard_error": float(e), "unit": unit, "known": bool(known)}
            for joint, unit, x, e, known in rows
        }

    def note(self) -> str:
        """What the report says of them."""
        rows = list(zip(self.joints, self.value, self.error, self.known, strict=True))
        told = ", ".join(f"{joint} {x:.4g} ± {1.96 * e:.2g}" for joint, x, e, known in rows if known)
        others = ", ".join(joint for joint, *_, known in rows if not known)
        units = "; ".join(dict.fromkeys(self.units))
        said = "The log has currents without drive gains."
        if told:
            said += f" These gains [{units}] were estimated from the masses in the URDF: {told}. "
            said += "They are too small if the URDF lacks a tool."
        if others:
            said += f" Gravity and inertia hardly act on {others}: only ratios of sizes are known there, in A."
        return said


def lacks(log: Log) -> bool:
    """Whether a log has currents and no drive gains."""
    return log.torque_unit == "A" and log.drive_gain is None


def estimated(log: Log, robot: Robot, inertia: np.ndarray, windows, options: Preparation) -> Gains:
    """The gains of a log of currents, its other defects corrected; a joint whose gain is not known gets 1, or more
    where its nominal torque would else be larger than the log allows.

    Raises:
        LogError: if no piece is long enough.
    """
    value, relative = np.ones(robot.dofs), np.ones(robot.dofs)
    for number in range(ROUNDS):
        recording = prepare(in_newton_metres(replace(log, drive_gain=value)), inertia, windows, options)
        evidence = started(robot, recording)
        columns = columns_of(evidence, log.torque_side)
        own = np.concatenate([columns.own, evidence.nominal.T[None]])
        columns = replace(columns, terms=(*columns.terms, "gain"), own=own)
        rows = evidence.of_role("train")
        if number == 0:  # each joint by itself, links as they are
            factor = columns.line(evidence.tau, rows)[-robot.dofs :]
            error, shown = np.zeros(robot.dofs), factor > 0
        else:
            fitted = columns.fit(evidence.tau, rows)
            factor, error = (x[-robot.dofs :] for x in (fitted.theta, std_of(fitted)))
            left = (evidence.tau - columns.of(fitted.theta))[rows]
            shown = factor * rms(evidence.nominal[rows]) > SHOWN * rms(left)
        known = shown & (error < KNOWN * factor)
        # where nothing tells, the nominal torque is at most what the log allows of it; else currents stay as they are
        most = np.maximum(factor + error, 1e-9)
        value = np.where(known, value / np.where(known, factor, 1.0), np.maximum(value / most, 1.0))
        relative = np.where(known, np.hypot(error / np.where(known, factor, 1.0), wear.WORN), 1.0)
    per_ampere = tuple(f"{units(slides).torque}/A" for slides in robot.prismatic)
    return Gains(robot.joints, per_ampere, value, value * relative)


def beside(diagnosis: Diagnosis, gains: Gains) -> Diagnosis:
    """The diagnosis with the gains' errors in the intervals of its sizes, and with everything of a joint whose gain is
    not known in A."""
    if diagnosis.signals is None:
        return diagnosis
    rows = zip(gains.joints, gains.value, gains.error, gains.known, strict=True)
    scales = {j: Scale(1.0, 1.96 * e / g) if known else Scale(float(g), 0.0) for j, g, e, known in rows}
    by, signals = np.array([x.by for x in scales.values()]), diagnosis.signals
    arrays = {name: np.asarray(getattr(signals, name)) / by for name in ("tau", "nominal", "extended")}
    floor = diagnosis.noise_floor
    since = {k: [_scores(x, scales) for x in v] for k, v in diagnosis.details.items() if k == SINCE}
    links = dict(diagnosis.standard.get("inertials", {}))
    if links:
        links["worth"] = {joint: x / scales[joint].by for joint, x in links["worth"].items()}
    terms = {j: {k: scales[j].row(v) for k, v in x.items()} for j, x in diagnosis.standard.items() if j in scales}
    return replace(
        diagnosis,
        findings=tuple(_finding(f, scales) for f in diagnosis.findings),
        unclaimed=tuple(_finding(f, scales) for f in diagnosis.unclaimed),
        baseline=_scores(diagnosis.baseline, scales),
        extended=_scores(diagnosis.extended, scales),
        baselines={name: _scores(x, scales) for name, x in diagnosis.baselines.items()},
        noise_floor=None if floor is None else _scores(floor, scales),
        standard=terms | ({"inertials": links} if links else {}),
        tests=tuple(replace(x, torque=x.torque / scales[x.joint].by) for x in diagnosis.tests),
        signals=replace(signals, **arrays, terms=tuple(np.asarray(x) / by for x in signals.terms)),
        details={**diagnosis.details, **since, "torque_in_A": [j for j, x in scales.items() if not x.error]},
    )


@dataclass(frozen=True)
class Scale:
    """What torques of a joint are divided `by` [N m/A], 1 where they stay in N m; half of the 95 % interval of its gain
    over the gain, 0 where it is not known and sizes are in A."""

    by: float
    error: float

    def quantity(self, quantity: Quantity) -> Quantity:
        """A size in the joint's unit."""
        if not quantity.unit.startswith(TORQUES) or quantity.value is None or quantity.interval95 is None:
            return quantity
        value = np.asarray(quantity.value, float)
        low, high = (np.asarray(x, float) - value for x in quantity.interval95)
        own = self.error * np.abs(value)
        ends = [(value - np.hypot(low, own)) / self.by, (value + np.hypot(high, own)) / self.by]
        unit = quantity.unit if self.error else _unit(quantity.unit)
        return Quantity((value / self.by).tolist(), unit, [x.tolist() for x in ends])

    def row(self, row: Mapping[str, Any]) -> dict[str, Any]:
        """A row of the table of standard terms."""
        told = self.quantity(Quantity(row["value"], row["unit"], row["interval95"]))
        each = {log: self.quantity(Quantity(row[log][0], row["unit"], row[log][1:])) for log in LOGS if log in row}
        logs = {log: (x.value, *x.interval95) for log, x in each.items()}
        return {**row, "value": told.value, "unit": told.unit, "interval95": told.interval95, **logs}

    def gain(self, gain: Gain) -> Gain:
        """The errors without and with an effect."""
        low, high = gain.interval95
        ends = low / self.by, high / self.by
        return replace(
            gain, rmse_before=gain.rmse_before / self.by, rmse_after=gain.rmse_after / self.by, interval95=ends
        )


TORQUES = ("N", "kg")
"""How the units of sizes begin that go with the torque of a joint."""


def _finding(finding: Finding, scales: Mapping[str, Scale]) -> Finding:
    finding = replace(finding, gain={joint: scales[joint].gain(x) for joint, x in finding.gain.items()})
    if finding.joint is None or finding.joint not in scales:
        return finding
    own = scales[finding.joint]
    return replace(finding, parameters={name: own.quantity(q) for name, q in finding.parameters.items()})


def _unit(unit: str) -> str:
    """A unit of torque, damping, stiffness or inertia at a joint, over N m/A; of a joint that slides, over N/A."""
    if unit.startswith("kg"):
        return "A s²/rad" if unit == "kg m²" else "A s²/m"
    return unit.replace("N m", "A", 1) if unit.startswith("N m") else "A" + unit[1:]


def _scores(scores: Mapping[str, Mapping[str, float]], scales: Mapping[str, Scale]) -> dict[str, dict[str, float]]:
    return {
        joint: {k: x / scales[joint].by if k == "rmse" else x for k, x in row.items()} for joint, row in scores.items()
    }
