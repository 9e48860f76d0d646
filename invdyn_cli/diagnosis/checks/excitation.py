"""What a log excites: ranges, reversals, speeds, loads, the condition of the regressor; and therefore what it cannot
show.

Effects declare what they need of a joint's motion (`AbstractEffect.needs`); the thresholds are fields here.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from invdyn_cli.diagnosis.checks.samples import SIZE, Samples, gather, regressor_rows
from invdyn_cli.effects.catalogue import EFFECTS
from invdyn_cli.interfaces import AbstractEffect
from invdyn_cli.joints import units
from invdyn_cli.log import Log
from invdyn_cli.maths import rigid_body
from invdyn_cli.maths.metrics import rms
from invdyn_cli.recording.stretches import Stretch, stretches
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
        together: share of the time in which a joint or the one before it moves, in which both do: below it a drive that
            both turn looks like one drive each.
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
    together: float = 0.05
    warm: float = 300.0
    drift: float = 60.0

    def measure(self, log: Log, robot: Robot | None) -> dict[str, dict[str, Any]]:
        """{joint: {"q", "qd", "qdd", "torque": [least, most], "peak_to_peak", "reversals", …, "cannot_show"}}."""
        parts = stretches(log)
        if not parts:
            return {}
        samples = None if robot is None else gather(log, robot, parts=parts)
        condition = None if samples is None or robot is None else condition_number(samples, robot)
        seconds = sum(float(raw.t[-1] - raw.t[0]) for raw in log.trajectories if len(raw.t))
        channels = {c: np.concatenate([getattr(x, c) for x in parts]) for c in ("q", "qd", "qdd", "tau")}
        out = {}
        for joint, name in enumerate(log.joints):
            one = {c: x[:, joint] for c, x in channels.items()}
            nominal = None if samples is None else samples.nominal[:, joint]
            speed = np.abs(one["qd"])
            moves, slides = np.ptp(one["q"]) > self.moved, robot is not None and robot.prismatic[joint]
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
            lacks = dict(self._lacks(numbers, speed, one["qdd"], nominal, moves, seconds, slides))
            before = -1 if robot is None else robot.parents[joint]
            if before >= 0 and moves:
                own, other = speed > self.rest, np.abs(channels["qd"][:, before]) > self.rest
                if np.mean(own & other) / max(np.mean(own | other), 1e-12) < self.together:
                    lacks["together"] = "it and the joint before it move one after the other"
            numbers["lacks"], numbers["cannot_show"] = lacks, cannot_show(lacks, EFFECTS)
            out[name] = numbers
        return out

    def _reversals(self, x: Stretch, joint: int) -> int:
        """Changes of direction, each with a speed above `rest` on both sides."""
        qd = x.qd[:, joint]
        signs = np.sign(qd[np.abs(qd) > self.rest])
        return int(np.sum(np.diff(signs) != 0))

    def _lacks(
        self,
        numbers: dict[str, Any],
        speed: np.ndarray,
        qdd: np.ndarray,
        nominal: np.ndarray | None,
        moves: bool,
        seconds: float,
        slides: bool,
    ) -> Iterator[tuple[str, str]]:
        """(need, reason) for each need that this joint's motion does not meet; for a joint at rest only the need of
        motion."""
        unit, torque = units(slides)
        way = f"it moves by {numbers['peak_to_peak']:.2g} {unit}"
        if not moves:
            yield "motion", f"{way} only"
            return
        if seconds < self.warm:
            yield "warming", f"{seconds:.3g} s of motion, friction takes {self.warm:.0f} s to warm up"
        if seconds < self.drift:
            yield "minutes", f"{seconds:.3g} s of motion, a drift takes {self.drift:.0f} s to show"
        if numbers["reversals"] < self.reversals:
            yield "reversals", f"{numbers['reversals']} reversals only: dry friction looks like an offset"
        quick = speed[speed > self.rest]
        ratio = float(np.quantile(quick, 0.9) / np.quantile(quick, 0.1)) if len(quick) > 20 else 1.0
        if ratio < self.speeds:
            yield "speeds", f"nearly one speed (90th over 10th percentile {ratio:.2g}): viscous friction looks constant"
        if ratio < self.curved:
            told = f"similar speeds (90th over 10th percentile {ratio:.2g})"
            yield "curvature", f"{told}: quadratic friction looks viscous"
        if numbers["creep_share"] < 0.01:
            seen = f"{100 * numbers['creep_share']:.2g} % of the time"
            yield "creep", f"it moves at {self.rest:g} to {self.slow:g} {unit}/s for only {seen}"
        if numbers["peak_to_peak"] < self.range:
            yield "range", f"{way}: a spring looks like an offset"
        if numbers["peak_to_peak"] < self.turn:
            yield "turn", f"{way}, less than a period"
        fast = float(np.quantile(np.abs(qdd), 0.95))
        if fast < self.acceleration:
            yield "acceleration", f"accelerations below {fast:.2g} {unit}/s^2"
        if nominal is not None:
            spread, size = float(np.std(nominal)), float(rms(nominal))
            varied = spread / size if size > 0 else 0.0
            loaded = float(np.std(np.abs(nominal)) / size) if size > 0 else 0.0
            if loaded < self.loads:
                yield "load", f"the load varies by {100 * loaded:.2g} %"
            if varied < self.loads:
                told = f"the nominal torque varies by only {100 * varied:.2g} %"
                yield "torque", f"{told}: a wrong gain looks like an offset, and a delay has no effect"
            low, high = np.quantile(nominal, [0.02, 0.98])
            if low * high > 0:
                yield (
                    "load_zeros",
                    f"its load never changes sign ({low:.2g} to {high:.2g} {torque}), and gear play is never crossed",
                )
        rate = float(np.sqrt(np.mean(qdd**2) / max(np.mean(speed**2), 1e-12)) / (2 * np.pi))
        if rate < self.agile:
            yield "frequency", f"it moves at only {rate:.2g} Hz, at which an elastic gear hardly deflects"


NEEDS: Mapping[str, str] = {
    "motion": "the joint moves",
    "reversals": "it changes its direction",
    "speeds": "it has several speeds",
    "curvature": "some of them are far apart",
    "creep": "it moves slowly for a while",
    "range": "it covers a range of angles",
    "turn": "it covers a period of ripple",
    "acceleration": "it accelerates",
    "load": "the size of its load varies",
    "torque": "its torque varies",
    "load_zeros": "its load changes sign",
    "frequency": "it moves fast to and fro",
    "together": "it moves while the joint before it moves",
    "minutes": "the recording lasts for minutes",
    "warming": "the recording lasts for as long as friction takes to warm up",
}
"""Requirements of effects on a joint's motion."""


OF_ROBOT = ("load", "torque", "load_zeros")
"""Those of them that follow from the nominal torque: they need a robot."""


def cannot_show(lacks: Mapping[str, str], effects: Mapping[str, AbstractEffect]) -> dict[str, str]:
    """{effect: reason} for the effects that need what a joint's motion `lacks`; the first missing need is the
    reason."""
    missing = {name: next((lacks[x] for x in effect.needs if x in lacks), "") for name, effect in effects.items()}
    return {name: why for name, why in missing.items() if why}


def condition_number(samples: Samples, robot: Robot) -> float:
    """Largest over smallest singular value of the regressor's identifiable part, columns in SI units (Gautier, Khalil
    1992: below 100 to 1000 parameters come out well); infinite where the motion leaves a direction out."""
    q, qd, qdd = rigid_body.random_states(robot, SIZE, seed=0)
    anywhere = regressor_rows(robot, Motion(q.T, qd.T, qdd.T))[1]
    anywhere = anywhere[:, ::4].reshape(-1, anywhere.shape[2])
    _, scale, directions = np.linalg.svd(np.linalg.qr(anywhere, mode="r"))
    possible = directions[scale > 1e-10 * scale[0]].T
    here = regressor_rows(robot, samples.motion)[1]
    values = np.linalg.svd(np.linalg.qr(here.reshape(-1, here.shape[2]) @ possible, mode="r"), compute_uv=False)
    return float(values[0] / values[-1]) if values[-1] > 1e-10 * values[0] else float("inf")


def _ends(x: np.ndarray) -> list[float]:
    return [float(x.min()), float(x.max())]
