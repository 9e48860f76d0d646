"""Checks of single channels: their resolution, joints at rest, and copies of other channels."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from invdyn_cli.diagnosis.checks.samples import NO_MOTION, gather
from invdyn_cli.interfaces import AbstractCheck
from invdyn_cli.joints import units
from invdyn_cli.log import Log
from invdyn_cli.maths.metrics import rms
from invdyn_cli.maths.signals import lattice
from invdyn_cli.recording.rows import is_series, largest_ranges, median_step
from invdyn_cli.recording.stretches import stretches
from invdyn_cli.types import Check, Robot


@dataclass(frozen=True)
class Quantisation(AbstractCheck):
    """Values that are multiples of a step, and whether this step is too coarse for what is computed from the channel.

    Rounding to a step s is white noise of variance s^2 / 12 (Widrow 1956); a zero-phase low-pass at f leaves of it,
    after two derivatives, s / sqrt(12) (2 pi)^2 sqrt(f^5 / 5 / (rate / 2)).

    Attributes:
        share: of that noise in the RMS of qdd (ours: at 0.3, a tenth of the variance of qdd is rounding).
        levels: fewest steps that a torque's range should have (ours: rounding then is below 1 % of the range).
        cutoff: [Hz] of the low-pass, as in data.real_log.
    """

    name: ClassVar[str] = "quantisation"
    share: float = 0.3
    levels: int = 50
    cutoff: float = 10.0

    def examine(self, log: Log, robot: Robot | None) -> list[Check]:
        """Per joint, where it moves farthest; the value is the step."""
        raws = [raw for raw in log.trajectories if len(raw.t) > 100 and is_series(raw)]
        if not raws:
            return [self.skipped("no time series of 100 rows")]
        moving = stretches(log)
        found = []
        for joint, name in enumerate(log.joints):
            raw = max(raws, key=lambda x: np.ptp(x.q[:, joint]))
            rate = 1 / median_step(raw.t)
            cutoff = min(self.cutoff, rate / 5)
            step = lattice(raw.q[:, joint])
            moves = np.ptp(raw.q[:, joint]) > max(10 * step, 0.02)
            qdd = [x.qdd[:, joint] for x in moving if x.trajectory == raw.name]
            if step > 0 and moves and qdd:
                noise = step / np.sqrt(12) * (2 * np.pi) ** 2 * np.sqrt(cutoff**5 / 5 / (rate / 2))
                unit = units(robot is not None and robot.prismatic[joint]).position + "/s^2"
                share = noise / max(float(rms(np.concatenate(qdd))), 1e-12)
                found.append(
                    Check(
                        self.name,
                        "warn" if share > self.share else "note",
                        raw.name,
                        name,
                        value=step,
                        threshold={"channel": "q", "share": self.share},
                        seen=f"q is quantised in steps of {step:.3g}: rounding adds {noise:.2g} {unit} of noise to qdd,"
                        f" {share:.2g} of its RMS",
                        meaning="accelerations from these positions are mostly rounding noise"
                        if share > self.share
                        else "rounding does not matter after the filter",
                        advice="a lower data.filter_cutoff, or velocities from the drive" if share > self.share else "",
                        source="first order: s^2/12 through two derivatives and a low-pass at 10 Hz",
                    )
                )
            step = lattice(raw.tau[:, joint])
            levels = np.ptp(raw.tau[:, joint]) / step if step > 0 else np.inf
            if levels < self.levels:
                found.append(
                    Check(
                        self.name,
                        "warn" if moves else "note",
                        raw.name,
                        name,
                        value=step,
                        threshold={"channel": "tau", "steps": self.levels},
                        seen=f"tau is quantised in steps of {step:.3g}: {levels:.3g} steps cover its whole range",
                        meaning="torques smaller than a step cannot be distinguished from rounding",
                        advice="a logger that keeps more digits, or motion that needs more torque at this joint",
                        source="own choice: rounding is then above 1 % of the range",
                    )
                )
        return found


@dataclass(frozen=True)
class NotMoving(AbstractCheck):
    """Joints that stand still in every trajectory.

    Attributes:
        least: [rad; m] range of q (ours: a quarter of a degree is what controllers wobble while they hold).
    """

    name: ClassVar[str] = "not_moving"
    least: float = 0.005

    def examine(self, log: Log, robot: Robot | None) -> list[Check]:
        """Per joint; the value is the largest range of q in a trajectory [rad; m]."""
        if not log.trajectories:
            return []
        ranges = largest_ranges(log, "q")
        still = np.flatnonzero(ranges < self.least)
        if len(still) == len(log.joints):
            return [self._seen("fail", None, float(ranges.max()), "no joint moves")]
        return [self._seen("note", log.joints[i], float(ranges[i]), "it stands still") for i in still]

    def _seen(self, severity: str, joint: str | None, value: float, what: str) -> Check:
        return Check(
            self.name,
            severity,
            None,
            joint,
            value=value,
            threshold=self.least,
            seen=f"{what}: q ranges over {value:.2g}",
            meaning="nothing can be learned about friction, drive or inertia",
            advice="a motion that moves the joint back and forth",
            source="own choice: a controller that holds a joint moves it less",
        )


@dataclass(frozen=True)
class CommandCopiesMeasurement(AbstractCheck):
    """Channels that should be measured but are copies: q_ref equals q, or tau the torque of the nominal model.

    Attributes:
        equal: [rad; m] largest difference of q_ref and q at which one is a copy (ours: below the resolution
            of any encoder).
        unexplained: share of the torque's variance that the nominal model leaves (ours: no measured torque of an arm
            agrees with its URDF to 1e-6; simulated torques do, in spite of the filters and derivatives here).
    """

    name: ClassVar[str] = "command_copies_measurement"
    equal: float = 1e-9
    unexplained: float = 1e-6

    def examine(self, log: Log, robot: Robot | None) -> list[Check]:
        """Per trajectory for positions, once for the torque."""
        found = []
        for raw in log.trajectories:
            if raw.q_ref is None or not np.ptp(raw.q, axis=0).max() > 0:
                continue
            apart = float(np.max(np.abs(raw.q_ref - raw.q)))
            if apart <= self.equal:
                found.append(
                    Check(
                        self.name,
                        "warn",
                        raw.name,
                        value=apart,
                        threshold=self.equal,
                        seen=f"q_ref and q differ by at most {apart:.1g}",
                        meaning="one is a copy of the other: the command was logged as the position, or the reverse",
                        advice="check the topic or field that q is taken from",
                        source="own choice: no controller tracks better than its encoder resolves",
                    )
                )
        if all(raw.q_ref is None for raw in log.trajectories):
            found.append(self.skipped("q_ref is not logged", "q_ref"))
        if robot is None:
            return [*found, self.skipped("no robot", "tau")]
        samples = gather(log, robot) if log.trajectories else None
        if samples is None or not np.ptp(samples.tau, axis=0).any():
            return [*found, self.skipped(NO_MOTION, "tau")]
        spread = np.var(samples.tau, axis=0)
        judged = spread > 1e-12 * spread.max()
        missed = np.mean((samples.tau - samples.nominal) ** 2, axis=0)[judged] / spread[judged]
        if missed.max() < self.unexplained:
            found.append(
                Check(
                    self.name,
                    "warn",
                    value=float(missed.max()),
                    threshold=self.unexplained,
                    seen="the torque equals the nominal model's inverse dynamics: their difference has at most "
                    f"{missed.max():.1g} of the torque's variance",
                    meaning="this torque was computed, not measured: nothing can be learned from it about the robot",
                    advice="log the measured torque or current instead",
                    source="own choice: no measured torque agrees with a URDF so closely",
                )
            )
        return found
