"""Units: factors between what a channel says and what it should, where they are those of a dictionary."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from invdyn_cli.diagnosis.checks.derivatives import drawn_forward
from invdyn_cli.diagnosis.checks.fits import correlation, slope
from invdyn_cli.diagnosis.checks.samples import EXCITED, gather
from invdyn_cli.diagnosis.checks.torques import matched
from invdyn_cli.diagnosis.checks.unit_factors import CLOCKS, DEGREE, POSITIONS, RATES, SCALES, TURNS, nearest
from invdyn_cli.interfaces import AbstractCheck
from invdyn_cli.log import Log, RawTrajectory
from invdyn_cli.maths.metrics import rms
from invdyn_cli.recording.rows import each, is_series, median_step
from invdyn_cli.recording.stretches import Stretch, stretches
from invdyn_cli.types import Check, Robot

CLEAR = 0.98
"""Share of a slow joint's logged velocity that the derivative of its position has to explain: noise then bends their
ratio by no more than `MotionUnits.within`."""

SECOND = 0.1
"""Relative distance of a logged acceleration's ratio, as `MotionUnits.within`: it is filtered harder."""


@dataclass(frozen=True)
class MotionUnits(AbstractCheck):
    """The clock in ms, positions in degrees, velocities in rpm, and so on.

    Positions are judged by the robot's limits (without any, by `turns`), and by which unit lets the nominal torque fit;
    velocities and accelerations by their ratio to the derivative of the position.

    Attributes:
        within: relative distance of a ratio from the dictionary's (ours: logged and filtered derivatives differ by some
            per cent; no two entries are nearer than 7 %).
        most: share of the moving joints that have to agree (ours: one joint's gain is an effect, not a unit).
        turns: [rad] beyond which a position without limits is no radian (ours: two turns of a joint).
        times: a joint's limit beyond which a position is no radian (ours: homing errors and other arms go less far).
        slow: [rad/s] joints below it are not judged.
        better: ratio of what the nominal torque leaves unexplained, as logged and converted (ours).
    """

    name: ClassVar[str] = "unit_error"
    within: float = 0.03
    most: float = 0.8
    turns: float = 4 * np.pi
    times: float = 3.0
    slow: float = 0.01
    better: float = 4.0

    def examine(self, log: Log, robot: Robot | None) -> list[Check]:
        """t, then q, then qd and qdd, each with the ones before put right."""
        found = self._clock(log)
        log, _ = self.correct(log, found, robot)
        positions = self._positions(log, robot)
        log, _ = self.correct(log, positions, robot)
        return found + positions + self._derivatives(log, robot)

    def correct(self, log: Log, found: Sequence[Check], robot: Robot | None) -> tuple[Log, list[str]]:
        """Divide by the exact factor."""
        notes = []

        def change(raw: RawTrajectory) -> RawTrajectory:
            for check in found:
                if check.severity != "fail" or check.trajectory not in (None, raw.name):
                    continue
                channel, factor = check.threshold["channel"], check.threshold["factor"]
                if factor is None:
                    continue
                kept = np.array(robot.prismatic) if robot else np.zeros(len(log.joints), bool)
                kept = kept | np.array([check.joint not in (None, name) for name in log.joints])
                by = factor if channel == "t" else np.where(kept, 1.0, factor)
                together = [x for x in ("q_ref", "q_link") if channel == "q" and _alike(getattr(raw, x), raw.q, ~kept)]
                parts = {c: getattr(raw, c) / by for c in (channel, *together) if getattr(raw, c) is not None}
                raw = replace(raw, **parts)
                of = f" of {check.joint}" if check.joint else ""
                notes.append(
                    f"{raw.name}: {', '.join(parts)}{of} divided by {factor:.7g}, {check.meaning.split(':')[0]}"
                )
            return raw

        return each(log, change), notes

    def _clock(self, log: Log) -> list[Check]:
        found = []
        for raw in log.trajectories:
            ratio = log.rate * median_step(raw.t)
            factor = nearest(ratio, CLOCKS, 0.1)
            if factor and is_series(raw):
                seen = f"the median step is {median_step(raw.t):.4g} at a nominal {log.rate:g} Hz"
                found.append(self._seen("t", raw.name, ratio, factor, CLOCKS[factor], seen))
        return found

    def _positions(self, log: Log, robot: Robot | None) -> list[Check]:
        turning = ~np.array(robot.prismatic) if robot else np.ones(len(log.joints), bool)
        limit = np.full(len(log.joints), self.turns)
        if robot is not None:
            bounds = np.maximum(np.abs(robot.lower), np.abs(robot.upper))
            limit = np.where(np.isfinite(bounds), np.minimum(self.times * bounds, self.turns), self.turns)
        found = []
        for raw in log.trajectories:
            finite = raw.q[np.isfinite(raw.q).all(1)]
            reach = np.abs(finite).max(0, initial=0)
            beyond = turning & (reach > limit)
            if np.any(turning & (reach / DEGREE > limit)):
                found += self._large(log, raw, robot, turning, limit)
                continue
            if not beyond.any():
                continue
            derived = self._degrees_by_velocity(log, raw, turning, beyond, reach)
            if derived:
                found += derived
                continue
            sure = beyond.sum() >= max(1, 0.3 * turning.sum()) and (robot is not None or beyond.sum() > 1)
            if robot is not None:
                one = replace(log, trajectories=(raw,))
                some = [_judged(one, robot, DEGREE, which)[0] for which in (turning, beyond)]
                if not beyond[turning].all() and some[1] > max(some[0], 0.5) + 0.1:
                    found += [
                        self._single(log, raw.name, int(j), float(reach[j]), some) for j in np.flatnonzero(beyond)
                    ]
                    continue
                sure = sure and not some[0] < _judged(one, robot, 1.0, turning)[0] - 0.05
            joint = log.joints[int(np.argmax(np.where(turning, reach / limit, 0)))]
            against = "the limits" if robot is not None else f"{self.turns:.3g} rad"
            seen = f"{beyond.sum()} joints go beyond {against}, {joint} to {reach[log.joints.index(joint)]:.4g}; "
            seen += "divided by 57.3 all are within"
            severity = "fail" if sure else "warn"
            found.append(self._seen("q", raw.name, DEGREE, DEGREE, "degrees", seen, severity))
        if found or robot is None or not log.trajectories:
            return found
        scales = (1.0, *POSITIONS)
        tried = {k: _judged(log, robot, k, turning)[0] for k in scales}
        best = max(tried, key=lambda k: tried[k])
        if best != 1.0 and tried[best] > 0.9 and 1 - tried[1.0] > self.better * (1 - tried[best]):
            seen = (
                f"with q divided by {best:.4g} the nominal torque explains {tried[best]:.2g} of the torque, as logged "
            )
            seen += f"{tried[1.0]:.2g}"
            found.append(self._seen("q", None, best, best, POSITIONS[best], seen))
        return found

    def _degrees_by_velocity(
        self, log: Log, raw: RawTrajectory, turning: np.ndarray, beyond: np.ndarray, reach: np.ndarray
    ) -> list[Check]:
        """Positions in degrees whose velocities are in rad/s: dq/dt over qd is the unit on all joints that are beyond
        their limits; nothing where it is not. All joints have it, too, unless one's velocity is nearer to rad/s."""
        ratios = 1 / _rates(stretches(replace(log, trajectories=(raw,))), "qd", len(log.joints), self.slow)
        finite = turning & np.isfinite(ratios)
        in_degrees = finite & (np.abs(ratios / DEGREE - 1) < self.within)
        if not (beyond & finite).any() or not in_degrees[beyond & finite].all():
            return []
        names = [None] if np.all(ratios[finite] > np.sqrt(DEGREE)) else np.flatnonzero(in_degrees | beyond)
        found = []
        for name in names:
            j = int(np.argmax(np.where(beyond, reach, 0))) if name is None else int(name)
            seen = f"{log.joints[j]} goes to {reach[j]:.4g}"
            if finite[j]:
                seen += f"; the derivative of q is {ratios[j]:.5g} times qd"
            joint = None if name is None else log.joints[j]
            found.append(replace(self._seen("q", raw.name, DEGREE, DEGREE, "degrees", seen), joint=joint))
        return found

    def _single(self, log: Log, trajectory: str, j: int, reach: float, fits: list[float]) -> Check:
        seen = f"{log.joints[j]} goes to {reach:.4g}, beyond its limits; if only such joints are divided by 57.3, the "
        seen += f"nominal torque explains {fits[1]:.2g} of the torque; if all joints are, {fits[0]:.2g}"
        return replace(self._seen("q", trajectory, DEGREE, DEGREE, "degrees", seen), joint=log.joints[j])

    def _large(
        self, log: Log, raw: RawTrajectory, robot: Robot | None, turning: np.ndarray, limit: np.ndarray
    ) -> list[Check]:
        """Positions that are beyond the limits most of the time, as degrees too. Their unit is that of SCALES
        of which qd is the derivative, or else with which the nominal torque fits; if there is none, they are wrong."""
        finite = raw.q[np.isfinite(raw.q).all(1)]
        size = np.quantile(np.abs(finite), 0.9, axis=0)
        which = turning & (size > DEGREE * limit)
        if not which.any() or not is_series(raw):
            return []
        one = replace(log, trajectories=(raw,))
        able = [k for k in SCALES if np.all(size[which] / k < limit[which])]
        known = self._by_velocity(one, able, turning, which) or self._by_torque(one, robot, able, turning, which)
        factor, which, how = known or (None, which, "no unit that is known here makes them fit")
        unit = SCALES[factor] if factor else "neither radians nor degrees but, perhaps, encoder counts"
        most = float(size.max(where=which, initial=0))
        seen = f"q reaches {most:.4g}, far beyond the limits; {how}"
        found = self._seen("q", raw.name, factor or most, factor, unit, seen)
        found = replace(found, advice="positions in rad; for encoder counts: counts per turn, gear ratio and zero")
        names = [None] if which[turning].all() else [log.joints[j] for j in np.flatnonzero(which)]
        return [replace(found, joint=name) for name in names]

    def _by_velocity(
        self, log: Log, able: Sequence[float], turning: np.ndarray, which: np.ndarray
    ) -> tuple[float, np.ndarray, str] | None:
        """By what q of which joints has to be divided, and how it shows: dq/dt over qd, where that is one unit on the
        joints that are beyond; others may have it, too."""
        ratios = 1 / _rates(stretches(log), "qd", len(log.joints), self.slow)
        own = ratios[which & np.isfinite(ratios)]
        factor = nearest(float(np.median(own)), SCALES, self.within) if len(own) else None
        if factor not in able or factor is None or np.mean(np.abs(own / factor - 1) < self.within) < self.most:
            return None
        joints = which | (turning & (np.abs(ratios / factor - 1) < self.within))
        return factor, joints, "the derivative of q over qd: " + ", ".join(f"{x:.5g}" for x in own)

    def _by_torque(
        self, log: Log, robot: Robot | None, able: Sequence[float], turning: np.ndarray, which: np.ndarray
    ) -> tuple[float, np.ndarray, str] | None:
        """The same by the fit of the nominal torque, where no other factor comes near: of all turning joints or of
        those that are beyond. Factors leave qd in a known unit, and as many joints to be judged as others do."""
        if robot is None:
            return None
        rates = _rates(stretches(log), "qd", len(log.joints), self.slow)[which]
        rate = float(np.median(rates[np.isfinite(rates)])) if np.isfinite(rates).any() else None
        able = [k for k in able if rate is None or nearest(rate * k, RATES | {1.0: "rad/s"}, self.within)]
        sets = (turning,) if which[turning].all() else (turning, which)
        fits = [(*_judged(log, robot, k, one), k, one) for k in able for one in sets]
        most = max((count for _, count, *_ in fits), default=0)
        fits = [(fit, k, one) for fit, count, k, one in fits if count > 0.7 * most]
        if not fits:
            return None
        best, factor, joints = max(fits, key=lambda x: x[0])
        if best < 0.9 or any(1 - fit < self.better * (1 - best) for fit, k, _ in fits if k != factor):
            return None
        return factor, joints, f"with q divided by {factor:.6g} the nominal torque explains {best:.2g} of the torque"

    def _derivatives(self, log: Log, robot: Robot | None) -> list[Check]:
        found = []
        if all(raw.qd is None and raw.qdd is None for raw in log.trajectories):
            return [self.skipped("neither qd nor qdd is logged", "qd")]
        parts = stretches(log)
        for name in dict.fromkeys(x.trajectory for x in parts):
            mine = [x for x in parts if x.trajectory == name]
            for channel in ("qd", "qdd"):
                if any(channel not in x.extra for x in mine):
                    continue
                every = _rates(mine, channel, len(log.joints), self.slow)
                ratios = every[np.isfinite(every)]
                if not len(ratios):
                    continue
                ratio = float(np.median(ratios))
                factor = nearest(ratio, RATES | TURNS, self.within)
                if not factor or np.mean(np.abs(ratios / factor - 1) < self.within) < self.most:
                    found += self._odd(log, robot, name, channel, every)
                    continue
                seen = f"{channel} is {ratio:.5g} times the derivative of q on {len(ratios)} moving joints"
                if factor in TURNS:
                    if channel == "qd":
                        found.append(self._seen("q", name, 1 / factor, 1 / factor, "revolutions", seen))
                    continue
                raw = next(x for x in log.trajectories if x.name == name)
                per = "" if channel == "qd" else " per second"
                if factor == 1e3 and channel == "qd" and median_step(raw.t) > 0.2:
                    return [*found, self._seen("t", None, ratio, 1e3, "milliseconds", seen)]
                found.append(self._seen(channel, name, ratio, factor, RATES[factor] + per, seen))
        return found

    def _odd(self, log: Log, robot: Robot | None, trajectory: str, channel: str, ratios: np.ndarray) -> list[Check]:
        """Joints whose position or velocity alone is in another unit: qd over dq/dt is an exact ratio of units there,
        and 1 on most of the others. Degrees of q within the limits, or a qd that was converted once too often: limits,
        qdd and torque decide, and else neither is corrected."""
        near = np.abs(ratios - 1) < self.within
        found = []
        for j in np.flatnonzero(np.isfinite(ratios) & ~near):
            factor = nearest(float(ratios[j]), RATES | TURNS, self.within)
            others = near[np.isfinite(ratios) & (np.arange(len(ratios)) != j)]
            if factor is None or channel != "qd" or not len(others) or others.mean() < 0.5:
                continue
            seen = f"qd of {log.joints[j]} is {ratios[j]:.5g} times the derivative of its q; "
            seen += "on most other joints both are equal"
            if factor in TURNS:
                one = self._seen("q", trajectory, 1 / factor, 1 / factor, "revolutions", seen)
            elif factor == 1 / DEGREE and (degrees := self._in_degrees(log, robot, trajectory, int(j))) is not False:
                unit = "degrees" if degrees else "degrees, or qd is too small by 57.3"
                one = self._seen("q", trajectory, DEGREE, DEGREE, unit, seen, "fail" if degrees else "warn")
            else:
                one = self._seen("qd", trajectory, float(ratios[j]), factor, RATES[factor], seen)
            found.append(replace(one, joint=log.joints[j]))
        return found

    def _in_degrees(self, log: Log, robot: Robot | None, trajectory: str, j: int) -> bool | None:
        """Whether q of a joint is in degrees, by its limits, by qdd, which has the unit of qd or of q, or else by the
        torque's fit; None: none of them tells."""
        one = replace(log, trajectories=tuple(raw for raw in log.trajectories if raw.name == trajectory))
        second = _rates(stretches(one), "qdd", len(log.joints), self.slow)[j]
        if any(abs(second * x - 1) < SECOND for x in (1.0, DEGREE)):
            return bool(second < 0.5)
        if robot is None:
            return None
        if np.nanmax(np.abs(one.trajectories[0].q[:, j])) > np.maximum(abs(robot.lower[j]), abs(robot.upper[j])):
            return True
        logged, turned = (_judged(one, robot, x, np.arange(robot.dofs) == j)[0] for x in (1.0, DEGREE))
        return None if abs(turned - logged) < 0.1 else bool(turned > logged)

    def _seen(
        self,
        channel: str,
        trajectory: str | None,
        value: float,
        factor: float | None,
        unit: str,
        seen: str,
        severity="fail",
    ) -> Check:
        return Check(
            self.name,
            severity,
            trajectory,
            value=float(value),
            threshold={"channel": channel, "factor": factor, "within": self.within},
            seen=seen,
            meaning=f"{channel} is in {unit}: every derived torque would be wrong",
            advice=f"{channel} in SI units, rad and s",
            source="exact ratio of two units",
        )


def _rates(parts: Sequence[Stretch], channel: str, joints: int, slow: float) -> np.ndarray:
    """(joints,) slope of logged derivatives (qd or qdd) on those of q at their common lag, NaN where none are logged,
    and on joints slower than `slow` [rad/s] that do not follow clearly."""
    if not parts or any(channel not in x.extra for x in parts):
        return np.full(joints, np.nan)
    own = np.concatenate([getattr(x, channel) for x in parts])
    moving = rms(np.concatenate([x.qd for x in parts])) > slow
    _, logged = drawn_forward(parts, channel, np.flatnonzero(moving))
    slopes = np.array([slope(y, x) for y, x in zip(logged.T, own.T, strict=True)])
    follows = np.array([correlation(y, x) ** 2 > CLEAR for y, x in zip(logged.T, own.T, strict=True)])
    return np.where(moving | follows, slopes, np.nan)


def _alike(x: np.ndarray | None, q: np.ndarray, which: np.ndarray) -> bool:
    """Whether further positions x (T, n) range as far as q does on these joints: then they have its unit."""
    if x is None:
        return False
    ratio = np.median(np.nanstd(x[:, which], axis=0) / np.maximum(np.nanstd(q[:, which], axis=0), 1e-300))
    return bool(1 / 3 < ratio < 3)


def _judged(log: Log, robot: Robot, factor: float, which: np.ndarray) -> tuple[float, int]:
    """Mean over joints of the squared correlation of torque and nominal torque, friction taken out, with the positions
    of some joints (n,) divided by a factor; 0 without data. And the number of joints whose nominal torque varies enough
    to count."""
    by = np.where(which, factor, 1.0)  # filters and derivatives are linear
    parts = tuple(replace(x, q=x.q / by, qd=x.qd / by, qdd=x.qdd / by) for x in stretches(log))
    samples = gather(log, robot, 1024, parts)
    if samples is None:
        return 0.0, 0
    _, cosine, excited = matched(samples)
    squares = np.diag(cosine)[excited > EXCITED] ** 2
    return (float(np.mean(squares)) if len(squares) else 0.0), len(squares)
