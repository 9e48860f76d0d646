"""Drives without power: brakes hold the arm, and the torque in the log is zero."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from invdyn_cli.diagnosis.checks.excitation import Excitation
from invdyn_cli.diagnosis.checks.samples import gather, gravity_torque
from invdyn_cli.interfaces import AbstractCheck
from invdyn_cli.log import Log, RawTrajectory
from invdyn_cli.recording.channels import newton_metres
from invdyn_cli.recording.rows import each, is_series, median_step, runs, taken, uninterrupted
from invdyn_cli.types import Check, Robot


class Follows(NamedTuple):
    """How the torque of each joint follows the URDF's while the arm moves: by which factor, and with which scatter,
    (n,) each."""

    factor: np.ndarray
    scatter: np.ndarray


@dataclass(frozen=True)
class PowerOff(AbstractCheck):
    """Torques of zero while the arm rests where gravity loads it: after an emergency stop, or in a pause under brakes.

    While the arm moves, a joint's torque follows the URDF's by a factor, which covers its unit and sign, and with a
    scatter, which covers friction and errors of the URDF. At rest a joint is judged where gravity loads it by far more
    than that scatter. Power is off where all joints rest, such a joint is among them, and none has a torque. A gear
    that holds its load by friction looks the same, and its torque tells as little.

    Attributes:
        window: [s] of a mean.
        beside: [s] before and after that are left out, too: a window, and 0.25 s in which the arm comes to rest or the
            brakes open (ours: brakes take 0.05 to 0.2 s).
        loaded: least load of a joint that is judged, in its scatters (ours: five standard deviations).
        none: largest torque that counts as none, of the load; of a joint that is not judged, of its torque in the log
            (ours: offsets of sensors are below).
        moving: least number of rows in motion that tell a joint's factor and scatter.
    """

    name: ClassVar[str] = "power_off"
    window: float = 0.5
    beside: float = 0.75
    loaded: float = 5.0
    none: float = 0.1
    moving: int = 50

    def examine(self, log: Log, robot: Robot | None) -> list[Check]:
        """Per trajectory; the value is the time without power [s]."""
        if robot is None:
            return [self.skipped("no robot")]
        if "gravity" in log.compensated:
            return [self.skipped("the log says that gravity is compensated")]
        follows = self._follows(log, robot)
        if follows is None:
            return [self.skipped("no motion")]
        found = [(raw, self._periods(log, raw, robot, follows)) for raw in log.trajectories if is_series(raw)]
        return [self._seen(raw, periods) for raw, periods in found if periods]

    def correct(self, log: Log, found: Sequence[Check], robot: Robot | None) -> tuple[Log, list[str]]:
        """Leave out the rows without power."""
        of = {one.trajectory: one for one in found}

        def change(raw: RawTrajectory) -> RawTrajectory:
            return taken(raw, ~self.rows_of(raw, of[raw.name]))

        words = "of the log left out, where the drives have no power"
        return each(log, change, of), [f"{name}: {one.value:.3g} s {words}" for name, one in of.items()]

    def rows_of(self, raw: RawTrajectory, one: Check) -> np.ndarray:
        """(T,) bool: rows of a trajectory in the periods that were found."""
        return _inside(raw.t, one.threshold["periods"])

    def _follows(self, log: Log, robot: Robot) -> Follows | None:
        """Medians over the rows in motion on which the URDF's torque is at least half of its 99 % quantile."""
        samples = gather(log, robot)
        moves = np.zeros(0, bool) if samples is None else (np.abs(samples.motion.qd) > Excitation().rest).any(axis=1)
        if samples is None or moves.sum() < self.moving:
            return None
        size = np.abs(samples.nominal[moves])
        strong = (size >= np.quantile(size, 0.99, axis=0) / 2) & (size > 0)
        tau, nominal = (np.where(strong, x[moves], np.nan) for x in (samples.tau, samples.nominal))
        factor = _median(tau / nominal)
        scatter = 1.48 * _median(np.abs(tau - factor * nominal))
        return Follows(factor, np.where(strong.sum(axis=0) < self.moving, np.inf, scatter))

    def _periods(self, log: Log, raw: RawTrajectory, robot: Robot, follows: Follows) -> list[tuple[float, float]]:
        """First and last time [s] of each period without power."""
        size = max(int(self.window / median_step(raw.t)), 1)
        parts = [rows[: len(rows) // size * size].reshape(-1, size) for rows in uninterrupted(raw)]
        rows = np.concatenate([np.empty((0, size), int), *parts])
        rows = rows[(np.ptp(raw.q[rows], axis=1) < Excitation().rest * self.window).all(axis=1)]
        if not len(rows):
            return []
        q = raw.q[rows].mean(axis=1)
        load = np.abs(follows.factor * gravity_torque(robot, q))
        judged = load > self.loaded * follows.scatter
        tau = newton_metres(log, raw)
        usual = np.quantile(np.abs(tau), 0.99, axis=0)  # a joint may have one though gravity does not load it there
        without = np.abs(tau[rows].mean(axis=1)) < self.none * np.where(judged, load, usual)
        rows = rows[judged.any(axis=1) & without.all(axis=1)]
        off = np.zeros(len(raw.t), bool)
        off[rows] = True
        return [(float(raw.t[a] - self.beside), float(raw.t[b - 1] + self.beside)) for a, b in runs(off)]

    def _seen(self, raw: RawTrajectory, periods: list[tuple[float, float]]) -> Check:
        seconds = float(median_step(raw.t) * np.sum(_inside(raw.t, periods)))
        times = "once" if len(periods) == 1 else f"{len(periods)} times"
        return Check(
            self.name,
            "warn",
            raw.name,
            value=seconds,
            threshold={"channel": "tau", "periods": periods},
            seen=f"the torques are zero {times} while the arm rests where gravity loads it, {seconds:.3g} s in all, "
            f"first at t = {periods[0][0] + self.beside:.3f} s",
            meaning="brakes hold the arm, after an emergency stop or in a pause, and the drives have no power",
            advice="nothing: these rows are left out",
            source="own choice: five standard deviations of measured less nominal torque in motion",
        )


def _inside(t: np.ndarray, periods: Sequence[tuple[float, float]]) -> np.ndarray:
    """(T,) bool: which of the times are in one of these periods."""
    return np.any([(t >= a) & (t <= b) for a, b in periods], axis=0)


def _median(x: np.ndarray) -> np.ndarray:
    """(n,) of the numbers in each column of x (R, n); 0 where there are none."""
    return np.array([np.median(some) if len(some := one[np.isfinite(one)]) else 0.0 for one in x.T])
