"""Logged velocities and accelerations beside the derivatives of the logged positions."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from invdyn_cli.diagnosis.checks.fits import slope
from invdyn_cli.interfaces import AbstractCheck
from invdyn_cli.log import Log, RawTrajectory
from invdyn_cli.maths.metrics import rms
from invdyn_cli.recording.rows import each, is_series, median_step
from invdyn_cli.recording.stretches import Stretch, stretches
from invdyn_cli.types import Check, Robot

WIDEST = 0.1
"""[s] of lags of a logged derivative that are tried."""

CLOCK = "the clock is probably wrong by this factor, or rows are missing"


@dataclass(frozen=True)
class DerivativeConsistency(AbstractCheck):
    """Slope, lag and rest of qd on dq/dt (and of qdd on its derivative), both filtered alike; and rows without order.

    Attributes:
        slope: relative (ours: an observer's or a filter's gain stays within 5 % where an arm moves).
        rest: RMS of what remains over RMS of the channel, its lag taken out (ours: a tenth of the variance).
        wrong: slope or rest from which on a channel is not the derivative of q at all (ours).
        alike: relative distance of all joints' slopes from their median that makes it the clock's fault (ours).
        lag: [samples] (first order: a hold and a difference quotient lag by half a sample each).
        still: [s] median step from which on rows are poses.
        slow: [rad/s] joints below it are not judged.
    """

    name: ClassVar[str] = "derivative_consistency"
    slope: float = 0.1
    rest: float = 0.3
    wrong: float = 0.7
    alike: float = 0.25
    still: float = 0.5
    lag: float = 1.5
    slow: float = 0.02

    def examine(self, log: Log, robot: Robot | None) -> list[Check]:
        """Per trajectory and channel, on the joint where it is worst; the value is the slope."""
        found = [
            self._poses(raw)
            for raw in log.trajectories
            if len(raw.t) and (not is_series(raw) or median_step(raw.t) > self.still)
        ]
        if all(raw.qd is None and raw.qdd is None for raw in log.trajectories):
            return found or [self.skipped("neither qd nor qdd is logged")]
        parts = stretches(log)
        for name in dict.fromkeys(x.trajectory for x in parts):
            mine = [x for x in parts if x.trajectory == name]
            seen = []
            for channel in ("qd", "qdd"):
                if all(channel in x.extra for x in mine):
                    seen += self._channel(log, name, mine, channel)
            if any(CLOCK in c.meaning for c in seen):  # it makes both wrong
                seen = [replace(c, severity="warn") if c.severity == "fail" else c for c in seen]
            found += seen
        return found

    def correct(self, log: Log, found: Sequence[Check], robot: Robot | None) -> tuple[Log, list[str]]:
        """Leave out poses; leave out channels that are no derivatives of q (they are made from q instead)."""
        notes = []

        def change(raw: RawTrajectory) -> list[RawTrajectory]:
            mine = [c for c in found if c.trajectory == raw.name]
            if any(c.threshold["channel"] == "q" for c in mine):
                notes.append(f"{raw.name}: left out, its rows are poses and no motion")
                return []
            wrong = {c.threshold["channel"] for c in mine if c.severity == "fail"}
            wrong |= {"qdd"} if "qd" in wrong and raw.qdd is not None else set()
            if wrong:
                raw = replace(raw, **dict.fromkeys(wrong))
                notes.append(f"{raw.name}: logged {' and '.join(sorted(wrong))} left out, made from q instead")
            return [raw]

        return each(log, change), notes

    def _channel(self, log: Log, name: str, parts: list[Stretch], channel: str) -> list[Check]:
        moving = np.flatnonzero(rms(np.concatenate([x.qd for x in parts])) > self.slow)
        if not len(moving):
            return []
        lag, logged = drawn_forward(parts, channel, moving)
        own, logged = np.concatenate([getattr(x, channel) for x in parts])[:, moving], logged[:, moving]
        slopes = np.array([slope(y, x) for y, x in zip(logged.T, own.T, strict=True)])
        size = rms(logged)
        rest = rms(logged - slopes * own) / np.maximum(size, 1e-12)
        rest[size == 0], slopes[size == 0] = 1.0, 0.0
        common = float(np.median(slopes))
        alike = common > 0 and np.all(np.abs(slopes / common - 1) < self.alike)
        clock = alike and abs(common - 1) > self.slope and len(moving) > 1
        bad = (np.abs(slopes - 1) > self.wrong) | (rest > self.wrong)
        worst = int(np.argmax(np.maximum(np.abs(slopes - 1), rest)))
        off = abs(slopes[worst] - 1) > self.slope or rest[worst] > self.rest
        fast = abs(lag) > self.lag
        if not off and not fast:
            return []
        severity = "note" if not off else "fail" if bad.any() and not clock else "warn"
        joint = log.joints[moving[worst]] if off and not clock else None
        value = common if clock else float(slopes[worst])
        of = {"qd": "dq/dt", "qdd": "d2q/dt2"}[channel]
        meaning = "a filter or an observer delays it; in a fit that uses both channels the phases do not agree"
        if clock:
            meaning = f"all joints agree on about {common:.3g}: {CLOCK}"
        elif off:
            meaning = f"{channel} is another quantity, or was filtered hard"
        return [
            Check(
                self.name,
                severity,
                name,
                joint,
                value=value,
                threshold={"channel": channel, "slope": self.slope, "rest": self.rest, "lag": self.lag},
                seen=f"{channel} is {value:.3g} times {of} with a lag of {lag} samples; the RMS of the difference is "
                f"{100 * rest[worst]:.2g} % of that of {channel}",
                meaning=meaning,
                advice="use data.derivatives=positions for a run; a diagnosis always takes derivatives from q"
                if not clock
                else "correct the time stamps t in this log",
                source="own choice: a tenth of the variance; lag of a zero-order hold and a difference quotient",
            )
        ]

    def _poses(self, raw: RawTrajectory) -> Check:
        seen = "consecutive positions are unrelated, as those of no motion are"
        if is_series(raw):
            seen = f"the median step of time is {median_step(raw.t):.3g} s, longer than {self.still:g} s"
        return Check(
            self.name,
            "warn",
            raw.name,
            value=None,
            threshold={"channel": "q"},
            seen=seen,
            meaning="these are single poses, or rows without order: there is no motion to differentiate",
            advice="recordings of motions; single poses show gravity only",
            source="variance of white noise's differences, first and second: 2 and 6",
        )


def drawn_forward(parts: Sequence[Stretch], channel: str, moving: np.ndarray) -> tuple[int, np.ndarray]:
    """Samples by which a logged channel comes later than the derivative, by correlation over the moving joints, within
    WIDEST; and the channel (R, n) of all stretches drawn forward by them, the ends of each repeated."""
    most = max(1, min(int(WIDEST * parts[0].rate), min(len(x.q) for x in parts) // 4))
    lags = np.arange(-most, most + 1)
    score = np.zeros(len(lags))
    for x in parts:
        rows = np.unique(np.linspace(most, len(x.q) - most - 1, 2000).astype(int))
        for j in moving:
            later = x.extra[channel][rows[:, None] + lags, j]
            own = getattr(x, channel)[rows, j]
            power = np.sqrt((own @ own) * np.sum(later**2, axis=0))
            score += np.divide(own @ later, power, out=np.zeros(len(lags)), where=power > 0)
    lag = int(lags[np.argmax(score)])
    shifted = [x.extra[channel][np.clip(np.arange(len(x.q)) + lag, 0, len(x.q) - 1)] for x in parts]
    return lag, np.concatenate(shifted)
