"""What a log excites: ranges, reversals, speeds, loads, the regressor's condition; and what it so cannot show.

Which effect needs what stands in DESIGN, section 6, and in the library of effects; the thresholds are fields.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from invdyn_cli.diagnosis.checks.evidence import SIZE, Evidence, Stretch, gather, regressor_rows, stretches
from invdyn_cli.logfile import Log
from invdyn_cli.maths import rigid_body
from invdyn_cli.types import Motion, Robot


@dataclass(frozen=True)
class Excitation:
    """Numbers per joint, and the effects that this log cannot show on it.

    Attributes:
        rest: [rad/s] below it a joint rests (ours: noise of a filtered encoder).
        slow: [rad/s] Stribeck velocities lie below (Armstrong-Hélouvry 1994: 0.01 to 0.1 rad/s at the joint).
        moved: [rad; m] below it a joint stands still.
        reversals: fewest changes of direction that part friction from offsets.
        speeds: ratio of the 90th to the 10th percentile of speed that parts a slope from a constant (ours: 2), and a
            square from a slope (`curved`, ours: 3).
        loads: relative spread of the nominal torque that shows friction growing with load.
        range: [rad] that tells a spring from gravity's slope; `turn`: [rad] that holds a period of ripple.
        acceleration: [rad/s^2] 95th percentile that shows a rotor's inertia (ours: with 0.1 kg m^2, 0.05 N m).
        agile: [Hz] ratio of acceleration to speed below which a gear's spring, 10 Hz or more with its link, adds less
            than a thousandth of the inertial torque (ours).
        warm, drift: [s] that friction takes to warm up, offsets to drift.
    """

    rest: float = 0.005
    slow: float = 0.05
    moved: float = 0.005
    reversals: int = 2
    speeds: float = 2.0
    curved: float = 3.0
    loads: float = 0.2
    range: float = 0.3
    turn: float = 0.5
    acceleration: float = 0.5
    agile: float = 0.3
    warm: float = 300.0
    drift: float = 60.0

    def measure(self, log: Log, robot: Robot | None) -> dict[str, dict[str, Any]]:
        """{joint: {"q", "qd", "qdd", "torque": [least, most], "peak_to_peak", "reversals", …, "cannot_show"}}."""
        parts = stretches(log)
        if not parts:
            return {}
        evidence = None if robot is None else gather(log, robot, parts=parts)
        condition = None if evidence is None or robot is None else condition_number(evidence, robot)
        seconds = sum(float(raw.t[-1] - raw.t[0]) for raw in log.trajectories if len(raw.t))
        channels = {c: np.concatenate([getattr(x, c) for x in parts]) for c in ("q", "qd", "qdd", "tau")}
        out = {}
        for joint, name in enumerate(log.joints):
            one = {c: x[:, joint] for c, x in channels.items()}
            nominal = None if evidence is None else evidence.nominal[:, joint]
            speed = np.abs(one["qd"])
            moves = np.ptp(one["q"]) > self.moved
            numbers: dict[str, Any] = {
                **{c: _ends(one[c]) for c in ("q", "qd", "qdd")},
                "torque": _ends(one["tau"]),
                "nominal_torque": None if nominal is None else _ends(nominal),
                "peak_to_peak": float(np.ptp(one["q"])),
                "reversals": sum(self._reversals(x, joint) for x in parts) if moves else 0,
                "rest_share": float(np.mean(speed < self.rest)),
                "slow_share": float(np.mean(speed < self.slow)),
                "creep_share": float(np.mean((speed > self.rest) & (speed < self.slow))),
                "condition": condition,
            }
            numbers["cannot_show"] = dict(self._cannot(log, numbers, speed, one["qdd"], nominal, moves, seconds))
            out[name] = numbers
        return out

    def _reversals(self, x: Stretch, joint: int) -> int:
        """Changes of direction, each with a speed above `rest` on both sides."""
        qd = x.qd[:, joint]
        signs = np.sign(qd[np.abs(qd) > self.rest])
        return int(np.sum(np.diff(signs) != 0))

    def _cannot(
        self,
        log: Log,
        numbers: dict[str, Any],
        speed: np.ndarray,
        qdd: np.ndarray,
        nominal: np.ndarray | None,
        moves: bool,
        seconds: float,
    ) -> Iterator[tuple[str, str]]:
        """(effect, why not) of this joint; the first reason counts."""
        if not moves:
            why = f"it moves by {numbers['peak_to_peak']:.2g} rad only"
            yield from ((effect, why) for effect in MOTION)
            return
        if seconds < self.warm:
            yield "thermal_friction_drift", f"{seconds:.0f} s of motion, friction takes {self.warm:.0f} s to warm up"
        if seconds < self.drift:
            yield "torque_offset_drift", f"{seconds:.0f} s of motion, a drift takes {self.drift:.0f} s to show"
        if numbers["reversals"] < self.reversals:
            why = f"{numbers['reversals']} reversals: friction that has a direction looks like an offset"
            yield from ((effect, why) for effect in DIRECTED)
        quick = speed[speed > self.rest]
        ratio = float(np.quantile(quick, 0.9) / np.quantile(quick, 0.1)) if len(quick) > 20 else 1.0
        if ratio < self.speeds:
            why = f"nearly one speed (90th over 10th percentile {ratio:.2g}): slopes look like constants"
            yield from ((effect, why) for effect in ("viscous_friction", "stribeck_friction", "quadratic_friction"))
        elif ratio < self.curved:
            yield "quadratic_friction", f"speeds spread by {ratio:.2g} only: a square looks like a slope"
        if numbers["creep_share"] < 0.01:
            why = f"{100 * numbers['creep_share']:.2g} % of the time between {self.rest:g} and {self.slow:g} rad/s"
            yield from ((effect, why) for effect in ("stribeck_friction", "presliding_hysteresis"))
        if numbers["peak_to_peak"] < self.range:
            why = f"it moves by {numbers['peak_to_peak']:.2g} rad: a spring looks like an offset"
            yield from ((effect, why) for effect in ("joint_spring", "encoder_offset"))
        if numbers["peak_to_peak"] < self.turn:
            yield "torque_ripple", f"it moves by {numbers['peak_to_peak']:.2g} rad, less than a period"
        fast = float(np.quantile(np.abs(qdd), 0.95))
        if fast < self.acceleration:
            yield "rotor_inertia", f"accelerations below {fast:.2g} rad/s^2"
        if nominal is not None:
            spread, size = float(np.std(nominal)), float(np.sqrt(np.mean(nominal**2)))
            varied = spread / size if size > 0 else 0.0
            loaded = float(np.std(np.abs(nominal)) / size) if size > 0 else 0.0
            if loaded < self.loads:
                yield "load_dependent_friction", f"the load varies by {100 * loaded:.2g} %"
            if varied < self.loads:
                why = f"the nominal torque varies by {100 * varied:.2g} %: a factor looks like an offset"
                yield from ((effect, why) for effect in ("torque_gain_error", "torque_delay", "actuator_lag"))
            low, high = np.quantile(nominal, [0.02, 0.98])
            if low * high > 0:
                yield "backlash", f"its load never changes sign ({low:.2g} to {high:.2g} N m): one flank carries all"
        rate = float(np.sqrt(np.mean(qdd**2) / max(np.mean(speed**2), 1e-12)) / (2 * np.pi))
        if rate < self.agile:
            yield "joint_elasticity", f"it moves at {rate:.2g} Hz, where a spring of a gear hardly bends"


MOTION = (
    "viscous_friction",
    "coulomb_friction",
    "asymmetric_coulomb_friction",
    "stribeck_friction",
    "load_dependent_friction",
    "quadratic_friction",
    "presliding_hysteresis",
    "thermal_friction_drift",
    "backlash",
    "joint_elasticity",
    "torque_ripple",
    "joint_spring",
    "rotor_inertia",
)
"""Effects that a joint shows only while it moves."""

JUDGED = (
    *MOTION, "torque_offset", "torque_offset_drift", "encoder_offset", "torque_gain_error", "torque_delay",
    "actuator_lag",
)  # fmt: skip
"""Every effect that `cannot_show` may name."""

BY_ROBOT = ("load_dependent_friction", "backlash", "torque_gain_error", "torque_delay", "actuator_lag")
"""Of these, those that are judged by the nominal torque: with a robot alone."""

DIRECTED = ("coulomb_friction", "asymmetric_coulomb_friction", "presliding_hysteresis", "torque_offset")


def condition_number(evidence: Evidence, robot: Robot) -> float:
    """Largest over smallest singular value of the regressor's identifiable part, columns in SI units (Gautier, Khalil
    1992: below 100 to 1000 parameters come out well); infinite where the motion leaves a direction out."""
    q, qd, qdd = rigid_body.random_states(robot, SIZE, seed=0)
    anywhere = regressor_rows(robot, Motion(q.T, qd.T, qdd.T))[1]
    anywhere = anywhere[:, ::4].reshape(-1, anywhere.shape[2])
    _, scale, directions = np.linalg.svd(np.linalg.qr(anywhere, mode="r"))
    possible = directions[scale > 1e-10 * scale[0]].T
    here = regressor_rows(robot, evidence.motion)[1]
    values = np.linalg.svd(np.linalg.qr(here.reshape(-1, here.shape[2]) @ possible, mode="r"), compute_uv=False)
    return float(values[0] / values[-1]) if values[-1] > 1e-10 * values[0] else float("inf")


def _ends(x: np.ndarray) -> list[float]:
    return [float(x.min()), float(x.max())]
