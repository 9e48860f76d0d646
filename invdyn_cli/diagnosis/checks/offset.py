"""Time between channels: torque against motion, command against measurement."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from invdyn_cli.diagnosis.checks.evidence import Stretch, gather, stretches
from invdyn_cli.diagnosis.checks.fits import rms, span
from invdyn_cli.diagnosis.checks.rows import each, newton_metres, taken
from invdyn_cli.diagnosis.checks.torques import EXCITED, matched
from invdyn_cli.interfaces import AbstractCheck
from invdyn_cli.logfile import Log, RawTrajectory
from invdyn_cli.types import Check, Robot


@dataclass(frozen=True)
class TimeOffset(AbstractCheck):
    """How much later the torque of all joints comes than the motion that it drives, positive: torque late.

    For every shift the torque is fitted by nominal torque + friction; the shift with the least residual wins, joint by
    joint, refined by a parabola. What most joints share is an offset of the channel; what one joint has alone is an
    effect of its drive, found later.

    Attributes:
        samples: that are normal (first order: half a sample for a controller's hold, one for the order of reading).
        least: [s] (ours: filters of drives make 1 to 4 ms, effects.md E4).
        agree: [s] or share of the offset within which joints have to be, most of them.
        explained: share of a joint's torque that nominal torque and friction explain where it is judged.
        widest: [s] of shifts that are tried.
        sharp: by how much the residual variance has to be higher at no shift (ours).
        lag: [s] of q behind q_ref that is worth a note.
        drive: [s] beyond which a joint of its own is taken for a poor fit, not for a delay (E4: 1 to 20 ms).
    """

    name: ClassVar[str] = "time_offset"
    samples: float = 1.5
    least: float = 0.004
    agree: float = 0.2
    explained: float = 0.8
    widest: float = 0.5
    sharp: float = 1.15
    lag: float = 0.01
    drive: float = 0.05

    def examine(self, log: Log, robot: Robot | None) -> list[Check]:
        """Per trajectory; the value is the offset [s]."""
        found = self._commands(log)
        if robot is None:
            return found
        for raw in log.trajectories:
            found += self._torque(replace(log, trajectories=(raw,)), raw, robot)
        return found

    def mend(self, log: Log, found: Sequence[Check], robot: Robot | None) -> tuple[Log, list[str]]:
        """Give the torque the time at which it drove."""
        offsets = {c.trajectory: float(c.value) for c in found if c.severity in ("warn", "fail") and c.joint is None}
        notes = []

        def change(raw: RawTrajectory) -> RawTrajectory:
            if raw.name not in offsets:
                return raw
            at = raw.t + offsets[raw.name]
            inside = (at >= raw.t[0]) & (at <= raw.t[-1])
            tau = np.stack([np.interp(at, raw.t, column) for column in raw.tau.T], axis=1)
            notes.append(f"{raw.name}: torques moved by {-1e3 * offsets[raw.name]:+.3g} ms against the motion")
            return taken(replace(raw, tau=tau), inside)

        return each(log, change), notes

    def _torque(self, log: Log, raw: RawTrajectory, robot: Robot) -> list[Check]:
        parts = stretches(log)
        most = int(self.widest * parts[0].rate) if parts else 0
        parts = tuple(x for x in parts if len(x.q) > 4 * most + 20 and x.rate == parts[0].rate)
        if not parts or not np.ptp(newton_metres(log, raw), axis=0).any():
            return []
        shifts = np.arange(-most, most + 1, max(1, most // 25))
        inner = tuple(_inside(x, most + 2) for x in parts)
        evidence = gather(log, robot, 2048, inner)
        if evidence is None:
            return []
        explained, _, excited = matched(evidence)
        judged = np.flatnonzero((excited > EXCITED) & (np.diag(explained) > self.explained))
        offsets, gains = {}, {}
        for joint in judged.tolist():
            basis = span(np.column_stack([evidence.columns(joint), evidence.nominal[:, joint]]))

            def residual(shift: int, joint: int = joint, basis: np.ndarray = basis) -> float:
                tau = _torque_at(parts, evidence.stretch, evidence.row + most + 2, joint, shift)
                rest = tau - basis @ (basis.T @ tau)
                return float(rest @ rest)

            coarse = shifts[int(np.argmin([residual(int(s)) for s in shifts]))]
            width = max(1, most // 25)
            fine = np.arange(max(-most, coarse - width), min(most, coarse + width) + 1)
            fine = fine[:: max(1, len(fine) // 60)]
            values = [residual(int(s)) for s in fine]
            best = int(np.argmin(values))
            if 0 < best < len(fine) - 1:
                offsets[joint] = _vertex(fine[best - 1 : best + 2], values[best - 1 : best + 2]) / parts[0].rate
                gains[joint] = residual(0) / max(values[best], 1e-300)
        return self._judged(raw.name, log, offsets, gains, parts[0].rate)

    def _judged(
        self, trajectory: str, log: Log, offsets: dict[int, float], gains: dict[int, float], rate: float
    ) -> list[Check]:
        """What the joints share, and who differs."""
        if not offsets:
            return []
        values = np.array(list(offsets.values()))
        common = float(np.median(values))
        limit = max(self.samples / rate, self.least)
        near = np.abs(values - common) < np.maximum(self.agree * abs(common), limit / 2)
        sharp = np.array([gains[j] for j in offsets]) > self.sharp
        shared = near.mean() > 0.6 and near.sum() >= min(3, len(log.joints)) and np.sum(near & sharp) >= 1
        said = ", ".join(f"{log.joints[j]} {1e3 * x:.3g}" for j, x in offsets.items())
        if abs(common) > limit and shared:
            return [
                Check(
                    self.name,
                    "warn",
                    trajectory,
                    value=common,
                    threshold=limit,
                    seen=f"the torque comes {1e3 * abs(common):.3g} ms {'after' if common > 0 else 'before'} the "
                    f"motion that it drives (per joint [ms]: {said})",
                    meaning="two clocks, or one channel that was filtered or buffered",
                    advice="one clock for both channels, or data.torque_lag",
                    source="first order: a hold and the order of reading make up to 1.5 samples",
                )
            ]
        found = []
        for joint, x in offsets.items():
            if 2 * limit < abs(x - common) < self.drive and gains[joint] > 2 * self.sharp and len(offsets) > 2:
                found.append(
                    Check(
                        self.name,
                        "note",
                        trajectory,
                        log.joints[joint],
                        value=float(x),
                        threshold=limit,
                        seen=f"this joint's torque alone comes {1e3 * x:.3g} ms later (others {1e3 * common:.3g} ms)",
                        meaning="a delay or a lag of its drive, or gear play: an effect, not a defect of the log",
                        advice="",
                        source="ours",
                    )
                )
        return found

    def _commands(self, log: Log) -> list[Check]:
        """How far q follows behind q_ref."""
        found = []
        parts = stretches(log) if any(raw.q_ref is not None for raw in log.trajectories) else ()
        for name in dict.fromkeys(x.trajectory for x in parts if "q_ref" in x.extra):
            mine = [x for x in parts if x.trajectory == name]
            error = np.concatenate([x.extra["q_ref"] - x.q for x in mine])
            speed = np.concatenate([x.qd for x in mine])
            moving = rms(speed) > 0.01
            power = np.sum(speed[:, moving] ** 2)
            lag = float(np.sum(error[:, moving] * speed[:, moving]) / power) if power > 0 else 0.0
            if abs(lag) > max(self.lag, self.samples / mine[0].rate):
                found.append(
                    Check(
                        self.name,
                        "note",
                        name,
                        value=lag,
                        threshold=self.lag,
                        seen=f"q follows q_ref {1e3 * lag:.3g} ms later",
                        meaning="the controller's tracking error; commanded positions are no measured ones",
                        advice="",
                        source="ours",
                    )
                )
        return found


def _inside(x: Stretch, margin: int) -> Stretch:
    rows = slice(margin, len(x.q) - margin)
    return replace(x, q=x.q[rows], qd=x.qd[rows], qdd=x.qdd[rows], tau=x.tau[rows], extra={})


def _torque_at(parts: tuple[Stretch, ...], stretch: np.ndarray, row: np.ndarray, joint: int, shift: int) -> np.ndarray:
    """(R,) the torque `shift` samples later than the rows."""
    return np.concatenate([x.tau[row[stretch == i] + shift, joint] for i, x in enumerate(parts)])


def _vertex(x: np.ndarray, y: Sequence[float]) -> float:
    """Where the parabola through three evenly spaced points is lowest."""
    curve = y[0] - 2 * y[1] + y[2]
    return float(x[1] + (0.5 * (y[0] - y[2]) / curve if curve > 0 else 0.0) * (x[1] - x[0]))
