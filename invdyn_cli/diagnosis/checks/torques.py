"""What the torque columns are: how well each follows the nominal model's torque, and whether gravity is in them.

Friction (ramped sign(qd), qd, 1) is taken out of both before they are compared; a joint is judged where its nominal
torque varies by a fair part of what this arm can ask of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from invdyn_cli.diagnosis.checks.arrangement import UNITS
from invdyn_cli.diagnosis.checks.evidence import Evidence, gather
from invdyn_cli.diagnosis.checks.fitness import fitness, rows_of
from invdyn_cli.diagnosis.checks.fits import correlation, left, rms, slope, span
from invdyn_cli.interfaces import AbstractCheck
from invdyn_cli.logfile import Log
from invdyn_cli.types import Check, Robot

EXCITED = 0.03
"""Least RMS of a joint's nominal torque, friction taken out, of what random states ask of it (ours: below it friction
and model errors rule)."""


def matched(evidence: Evidence, tau: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """How well torque column i fits joint j: R^2 with friction and nominal torque, and the correlation with the nominal
    torque after friction, (n, n) each; and RMS of the nominal torque after friction over `reach`, (n,)."""
    tau = evidence.tau if tau is None else tau
    n = tau.shape[1]
    explained, cosine, excited = np.zeros((n, n)), np.zeros((n, n)), np.zeros(n)
    total = np.maximum(np.sum((tau - tau.mean(0)) ** 2, axis=0), 1e-300)
    for j in range(n):
        basis = span(evidence.columns(j))
        rest = tau - basis @ (basis.T @ tau)
        nominal = evidence.nominal[:, j] - basis @ (basis.T @ evidence.nominal[:, j])
        excited[j] = rms(nominal) / max(evidence.reach[j], 1e-12)
        for i in range(n):
            cosine[i, j] = correlation(rest[:, i], nominal)
            after = float(rest[:, i] @ rest[:, i]) * (1 - cosine[i, j] ** 2)
            explained[i, j] = 1 - after / total[i]
    return explained, cosine, excited


@dataclass(frozen=True)
class GravityRemoved(AbstractCheck):
    """Torques that have gravity taken out already, as some drivers' "external" or "feedback" torques have.

    The URDF without gravity has to be likelier than with it (`fitness`: with errors in its inertials, and as it
    stands), and the torque must hardly follow gravity on the joints that it loads.

    Attributes:
        slope: median slope of torque on gravity torque that still is none (ours: with gravity in it, a payload or a
            wrong gain makes 0.5 to 2).
        odds: log of the likelihood ratio that it takes (ours: the odds against the defect, e^5, and e^8).
        varied: least RMS of the gravity torque, of what random states ask of a joint (ours).
        again: asked once more, when orders and signs are right: only what fails is said.
    """

    name: ClassVar[str] = "gravity_removed"
    slope: float = 0.25
    odds: float = 13.0
    varied: float = 0.1
    again: bool = False

    def examine(self, log: Log, robot: Robot | None) -> list[Check]:
        """For the whole log; the value is the slope of torque on gravity torque."""
        found = self._judged(log, robot)
        return [one for one in found if one.severity == "fail"] if self.again else found

    def _judged(self, log: Log, robot: Robot | None) -> list[Check]:
        if robot is None:
            return [self.skipped("no robot")]
        if "gravity" in log.compensated:
            return [self.skipped("the log says that gravity is compensated")]
        evidence = gather(log, robot, 1024) if log.trajectories else None
        if evidence is None or len(evidence.tau) < 100 or not np.ptp(evidence.tau, axis=0).any():
            return [self.skipped("no motion, or a torque that never changes")]
        slopes = []
        for joint in range(len(log.joints)):
            columns = np.column_stack(
                [evidence.columns(joint), evidence.nominal[:, joint] - evidence.gravity[:, joint]]
            )
            gravity, tau = left(evidence.gravity[:, joint], columns), left(evidence.tau[:, joint], columns)
            if rms(gravity) > self.varied * evidence.reach[joint]:
                slopes.append(slope(tau, gravity))
        if not slopes:
            return [self.skipped("gravity hardly varies on any joint in this motion")]
        value = float(np.median(np.abs(slopes)))
        if value > self.slope:
            return [Check(self.name, "ok", value=float(np.median(slopes)), seen="the torque follows gravity")]
        at = np.arange(robot.dofs)
        # Noise is judged where the log says that it is right: without gravity, if that is gone.
        noise = fitness(rows_of(evidence, without_gravity=True), robot, UNITS).effective
        both = [fitness(rows_of(evidence, without_gravity=x), robot, UNITS, noise) for x in (False, True)]
        gains = []
        for name in ("likelihood", "plain"):
            before, after = (getattr(x, name)[at, at].max(axis=(1, 2)).sum() for x in both)
            gains.append(after - before)
        gain = float(min(gains))
        if gain < self.odds:
            return []
        return [
            Check(
                self.name,
                "fail",
                value=float(np.median(slopes)),
                threshold=self.slope,
                seen=f"on {len(slopes)} joints that gravity loads the torque follows it with a slope of {value:.2g} "
                f"(median); the URDF without gravity is likelier, log of the ratio {gain:.3g}",
                meaning="gravity is taken out of this torque already: an external or a feedback torque",
                advice="attribute compensated=gravity in the log, or the driver's whole torque",
                source="ours: with gravity in it, payloads and gains make 0.5 to 2",
            )
        ]

    def mend(self, log: Log, found: Sequence[Check], robot: Robot | None) -> tuple[Log, list[str]]:
        """Declare it."""
        if not found or "gravity" in log.compensated:
            return log, []
        note = "torques are taken to have gravity compensated, as they follow none"
        return replace(log, compensated=(*log.compensated, "gravity")), [note]
