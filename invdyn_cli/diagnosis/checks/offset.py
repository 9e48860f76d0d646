"""Time between channels: torque against motion, command against measurement."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import scipy

from invdyn_cli.diagnosis.checks.fits import left, lowest, span
from invdyn_cli.diagnosis.checks.samples import EXCITED, Samples, gather
from invdyn_cli.diagnosis.checks.torques import matched
from invdyn_cli.interfaces import AbstractCheck
from invdyn_cli.log import Log, RawTrajectory
from invdyn_cli.maths.metrics import rms
from invdyn_cli.recording.channels import newton_metres
from invdyn_cli.recording.rows import each, taken
from invdyn_cli.recording.stretches import Stretch, stretches
from invdyn_cli.types import Check, Robot

LENGTHS, FINE = (1e-3, 5e-3), 200.0
"""[rad; m] over which bristles bend (effects.md A4: 1e-4 to 1e-2), and the rate [Hz] of their positions."""

MARGIN = 2
"""Samples at either end of a stretch beyond the largest shift."""


@dataclass(frozen=True)
class TimeOffset(AbstractCheck):
    """How much later the torque of all joints comes than the motion that it drives, positive: torque late.

    For every shift the torque is fitted by nominal torque, friction (quadratic, too) and rotor inertia: without its
    column a rotor looks like an early torque. The shift with the least residual wins, joint by joint, refined by a
    parabola; on all rows, or on those where the joint is not slow, wherever the residual grows more sharply beside it:
    friction may turn before the joint does, and on all rows the torque then seems early. An offset of the channel is
    the median of the joints, each weighted by that sharpness; its standard error follows from how far the joints lie
    from it. What one joint has alone is an effect of its drive, found later.

    Attributes:
        samples: that are normal (first order: half a sample for a controller's hold, one for the order of reading).
        least: [s] (ours: filters of drives make 1 to 4 ms, effects.md E4).
        agree: share of the offset within which a joint is that shows it clearly.
        most: share of all joints' weights that those near it must have (ours: 0.60 where friction alone was early, 0.96
            and more on ten logs that were shifted).
        sure: standard errors that the offset has to be from zero (ours).
        explained: share of a joint's torque that nominal torque and friction explain at its shift where it is judged.
        slow: share [-] of a joint's RMS speed below which it is slow.
        often: share [-] of the rows in which it must not be slow for these to count alone.
        moved: share of what friction leaves that the motion explains then (ours: friction sets in late by itself, gear
            play and presliding delay it).
        widest: [s] of shifts that are tried.
        sharp: by how much the residual variance has to be higher at no shift (ours).
        drive: [s] beyond which a joint of its own is taken for a poor fit, not for a delay (E4: 1 to 20 ms).
    """

    name: ClassVar[str] = "time_offset"
    samples: float = 1.5
    least: float = 0.004
    agree: float = 0.2
    most: float = 2 / 3
    sure: float = 3.0
    slow: float = 0.5
    often: float = 0.25
    explained: float = 0.8
    moved: float = 0.5
    widest: float = 0.5
    sharp: float = 1.15
    drive: float = 0.05

    def examine(self, log: Log, robot: Robot | None) -> list[Check]:
        """One for a session, the recordings of a file, where all that can tell agree; else per recording. The value is
        the offset [s]."""
        if robot is None:
            return [self.skipped("no robot", "tau")]
        found: list[Check] = []
        sessions: dict[str, list[RawTrajectory]] = {}
        for raw in log.trajectories:
            sessions.setdefault(raw.name.rpartition("/")[0], []).append(raw)
        for session in sessions.values():
            shifts = [self._timed(replace(log, trajectories=(raw,)), raw, robot) for raw in session]
            found += self._session(log, [x for x in shifts if x is not None], session)
        return found or [
            self.skipped(
                "no joint's torque follows the one computed from the URDF well enough to measure its delay", "tau"
            )
        ]

    def correct(self, log: Log, found: Sequence[Check], robot: Robot | None) -> tuple[Log, list[str]]:
        """Give the torque the time at which it drove."""
        offsets = {name: c.value for c in found if c.severity == "warn" for name in c.threshold["trajectories"]}
        notes = []

        def change(raw: RawTrajectory) -> RawTrajectory:
            at = raw.t + offsets[raw.name]
            inside = (at >= raw.t[0]) & (at <= raw.t[-1])
            tau = np.stack([np.interp(at, raw.t, column) for column in raw.tau.T], axis=1)
            notes.append(f"{raw.name}: torques shifted by {-1e3 * offsets[raw.name]:+.3g} ms (negative: earlier)")
            return taken(replace(raw, tau=tau), inside)

        return each(log, change, offsets), notes

    def _session(self, log: Log, shifts: list["_Shifts"], session: list[RawTrajectory]) -> list[Check]:
        """What the recordings of one session say together."""
        sure = [x for x in shifts if self._shared(x, log)]
        late = [x for x in sure if abs(x.common) > self._limit(x)]
        found = [c for x in shifts for c in self._single(x, log)]
        weights = [sum(x.gains.values()) for x in sure]
        value = float(np.average([x.common for x in sure], weights=weights)) if sure else 0.0
        if late and len(session) > 1 and not any(self._contradicts(x, value, x in sure) for x in shifts):
            told = f"the {len(sure)} of {len(session)}" if len(sure) < len(session) else f"all {len(session)}"
            seen = f"the torque comes {_apart(value)}, the same in {told} recordings of this session: "
            seen += ", ".join(f"{x.trajectory} {1e3 * x.common:.3g} ms" for x in sure)
            return [*found, self._late(None, value, self._limit(late[0]), seen, tuple(raw.name for raw in session))]
        for x in shifts:
            if x in late:
                said = ", ".join(f"{log.joints[j]} {1e3 * s:.3g}" for j, s in x.offsets.items())
                seen = f"the torque comes {_apart(x.common)} (per joint [ms]: {said})"
                found.append(self._late(x.trajectory, x.common, self._limit(x), seen, (x.trajectory,)))
            elif x in sure:
                seen = f"torque and motion agree to {1e3 * abs(x.common):.2g} ms on {len(x.offsets)} joints"
                threshold = {"channel": "tau", "seconds": self._limit(x)}
                found.append(Check(self.name, "ok", x.trajectory, value=x.common, threshold=threshold, seen=seen))
            else:
                found.append(self._unsure(x))
        return found

    def _contradicts(self, x: "_Shifts", value: float, sure: bool) -> bool:
        """Whether a recording has another offset than its session's; one that is not sure of its own, by its error."""
        far = abs(x.common - value) - self._limit(x)
        return far > 0 if sure else far > self.sure * x.error and len(x.offsets) > 1

    def _limit(self, x: "_Shifts") -> float:
        return max(self.samples / x.rate, self.least)

    def _shared(self, x: "_Shifts", log: Log) -> bool:
        """Whether most that is told of it is of one offset, known to what is normal, and at least two joints say so
        clearly, because one may have a late drive: friction at reversals seems to come before the motion, joint by
        joint, and gravity does not."""
        limit = self._limit(x)
        if len(x.offsets) < min(3, len(log.joints)) or x.error > limit:
            return False
        if self.sure * x.error > max(abs(x.common), 2 * limit):
            return False
        if abs(x.common) <= limit:
            return True
        near = [j for j, s in x.offsets.items() if abs(s - x.common) < max(self.agree * abs(x.common), limit / 2)]
        most = sum(x.weights[j] for j in near) > self.most * sum(x.weights.values())
        return most and sum(x.gains[j] > self.sharp for j in near) >= min(2, len(x.offsets))

    def _unsure(self, x: "_Shifts") -> Check:
        """Too few joints tell an offset, or they do not agree on one; the value is what they say together."""
        offsets = [1e3 * s for s in x.offsets.values()]
        seen = f"the torques come {min(offsets):.3g} to {max(offsets):.3g} ms after the motion, by joint; "
        seen += f"the weighted median is {1e3 * x.common:.3g} ms, its standard error {1e3 * x.error:.2g} ms"
        if len(offsets) == 1:
            seen = f"a single joint can be timed ({offsets[0]:.3g} ms)"
        if len(offsets) == 1 or abs(x.common) <= max(self._limit(x), x.error):
            one = self.skipped(f"{seen}: a common offset cannot be determined", "tau", x.trajectory)
            return replace(one, value=x.common)
        return Check(
            self.name,
            "note",
            x.trajectory,
            value=x.common,
            threshold={"channel": "tau", "seconds": self._limit(x)},
            seen=seen,
            meaning="the torque may come late or early, or the URDF's inertials are wrong; nothing is changed",
            advice="record faster motion, or check the clocks of both channels",
            source="own choice: the scatter of the joints' offsets",
        )

    def _late(self, trajectory: str | None, value: float, limit: float, seen: str, names: tuple[str, ...]) -> Check:
        return Check(
            self.name,
            "warn",
            trajectory,
            value=value,
            threshold={"channel": "tau", "seconds": limit, "trajectories": list(names)},
            seen=seen,
            meaning="each channel has its own clock, or one was filtered or buffered",
            advice="use one clock for both channels, or set data.torque_lag",
            source="first order: a zero-order hold and the order of reading cause up to 1.5 samples of delay",
        )

    def _single(self, x: "_Shifts", log: Log) -> list[Check]:
        """Joints that differ from the others."""
        limit = self._limit(x)
        return [
            Check(
                self.name,
                "note",
                x.trajectory,
                log.joints[joint],
                value=float(s),
                threshold={"channel": "tau", "seconds": limit},
                seen=f"this joint's torque comes {_apart(s)}; the others' torque comes {_apart(x.common)}",
                meaning="delay or lag of the drive, or gear play: an effect, not a defect of the log",
                source="own choice",
            )
            for joint, s in x.offsets.items()
            if 2 * limit < abs(s - x.common) < self.drive and x.gains[joint] > 2 * self.sharp and len(x.offsets) > 2
        ]

    def _timed(self, log: Log, raw: RawTrajectory, robot: Robot) -> "_Shifts | None":
        """The shift of every joint that can be timed; as sure as it is the same beside bristles of friction, which turn
        after the joint does and look like a late torque."""
        found = self._shifts(log, raw, robot)
        if found is None or abs(found.common) <= self._limit(found):
            return found
        other = self._shifts(log, raw, robot, bristles=True)
        away = np.inf if other is None else abs(other.common - found.common)
        return replace(found, error=max(found.error, away)) if away > self._limit(found) else found

    def _shifts(self, log: Log, raw: RawTrajectory, robot: Robot, *, bristles: bool = False) -> "_Shifts | None":
        """The shift of every joint that can be timed; None where none can."""
        parts = stretches(log)
        most = int(self.widest * parts[0].rate) if parts else 0
        parts = tuple(x for x in parts if len(x.q) > 4 * most + 20 and np.isclose(x.rate, parts[0].rate, rtol=1e-3))
        if not parts or not np.ptp(newton_metres(log, raw), axis=0).any():
            return None
        inner = tuple(_inside(x, most + MARGIN) for x in parts)
        samples = gather(log, robot, 2048, inner)
        if samples is None:
            return None
        _, _, excited = matched(samples)
        bent = [_bristles(x.q, x.rate) for x in inner] if bristles else []
        offsets, gains, weights = {}, {}, {}
        for joint in np.flatnonzero(excited > EXCITED).tolist():
            speed = np.abs(samples.motion.qd[:, joint])
            moving = speed > self.slow * rms(speed)
            all_rows = np.ones_like(moving)
            kept = [all_rows, moving] if np.mean(moving) > self.often else [all_rows]
            friction = samples.columns(joint)
            if bent:
                own = [bent[i][row, :, joint] for i, row in zip(samples.stretch, samples.row, strict=True)]
                friction = np.column_stack([own, friction])
            every = [self._shift(parts, samples, joint, rows, most, friction[rows]) for rows in kept]
            found = max((x for x in every if x is not None), key=lambda x: x[2], default=None)
            if found is not None:
                offsets[joint], gains[joint], weights[joint] = found[0] / parts[0].rate, *found[1:]
        if not offsets:
            return None
        common, error = _weighted_median(np.array(list(offsets.values())), np.array(list(weights.values())))
        return _Shifts(raw.name, offsets, gains, weights, common, error, parts[0].rate)

    def _shift(
        self,
        parts: tuple[Stretch, ...],
        samples: Samples,
        joint: int,
        rows: np.ndarray,
        most: int,
        friction: np.ndarray,
    ) -> tuple[float, float, float] | None:
        """Of one joint on some rows (R,) bool, beside columns of friction: the shift of the least residual, of `most`
        samples, refined; how much more is left without one; and how sharply that grows beside it. None where the motion
        does not explain the torque."""
        motion = samples.motion
        qd, qdd = motion.qd[rows, joint], motion.qdd[rows, joint]
        basis = span(np.column_stack([friction, samples.nominal[rows, joint], qdd, qd * np.abs(qd)]))
        width = max(1, most // 25)

        def torque(shift: int) -> np.ndarray:
            """(R,) so many samples later than the rows."""
            stretch, row = samples.stretch[rows], samples.row[rows] + most + MARGIN + shift
            return np.concatenate([x.tau[row[stretch == i], joint] for i, x in enumerate(parts)])

        def residual(shift: int) -> float:
            tau = torque(shift)
            rest = tau - basis @ (basis.T @ tau)
            return float(rest @ rest)

        shifts = np.arange(-most, most + 1, width)
        coarse = shifts[int(np.argmin([residual(int(s)) for s in shifts]))]
        fine = np.arange(max(-most, coarse - width), min(most, coarse + width) + 1)
        fine = fine[:: max(1, len(fine) // 60)]
        values = [residual(int(s)) for s in fine]
        best = int(np.argmin(values))
        tau = torque(int(fine[best]))
        whole, rest = (np.sum(left(tau, x) ** 2) for x in (friction[:, -1:], friction))
        if not 0 < best < len(fine) - 1 or values[best] >= min((1 - self.explained) * whole, (1 - self.moved) * rest):
            return None
        least = max(values[best], 1e-300)
        beside = [np.clip(fine[best] + way * width, -most, most) for way in (-1, 1)]
        sharpness = float(np.log(np.mean([residual(int(s)) for s in beside]) / least))
        return lowest(fine, np.array(values)), residual(0) / least, sharpness


@dataclass(frozen=True)
class _Shifts:
    """Of one recording: joint -> seconds that its torque comes late, how much higher the residual variance is without a
    shift, and the weight of what it says; the offset of all and its standard error [s], and the rate [Hz]."""

    trajectory: str
    offsets: dict[int, float]
    gains: dict[int, float]
    weights: dict[int, float]
    common: float
    error: float
    rate: float


def _weighted_median(x: np.ndarray, weights: np.ndarray) -> tuple[float, float]:
    """Weighted median of x (k,), and its standard error by the weighted median deviation (normal: 1.48 of it)."""
    weights = np.maximum(weights, 1e-12)

    def middle(y: np.ndarray) -> float:
        order = np.argsort(y)
        share = (np.cumsum(weights[order]) - weights[order] / 2) / weights.sum()
        return float(np.interp(0.5, share, y[order]))

    common = middle(x)
    return common, 1.25 * 1.48 * middle(np.abs(x - common)) * float(np.sqrt(np.sum(weights**2)) / weights.sum())


def _bristles(q: np.ndarray, rate: float) -> np.ndarray:
    """(T, 2, n) friction of size one of bristles with these lengths at positions q (T, n) (Dahl 1968)."""
    every = max(1, int(rate / FINE))
    q, at = q[::every], np.arange(len(q)) / every
    length = np.array(LENGTHS)[:, None]
    made = np.zeros((len(q), len(LENGTHS), q.shape[1]))
    for k, step in enumerate(np.diff(q, axis=0)):
        side = np.sign(step)
        made[k + 1] = side + (made[k] - side) * np.exp(-np.abs(step) / length)
    return scipy.interpolate.interp1d(np.arange(len(q)), made, axis=0, fill_value="extrapolate")(at)


def _apart(seconds: float) -> str:
    return f"{1e3 * abs(seconds):.3g} ms {'after' if seconds > 0 else 'before'} the motion that it drives"


def _inside(x: Stretch, margin: int) -> Stretch:
    rows = slice(margin, len(x.q) - margin)
    return replace(x, q=x.q[rows], qd=x.qd[rows], qdd=x.qdd[rows], tau=x.tau[rows], extra={})
