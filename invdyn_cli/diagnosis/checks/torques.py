"""The torque columns: how well each follows the nominal model's torque, and whether gravity is in them.

Friction (ramped sign(qd), qd, 1) is removed from both before they are compared. A joint is judged if its nominal torque
varies by a considerable part of what is possible on this arm.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from invdyn_cli.diagnosis.checks.arrangement import FLAW, OWN, UNITS, known_orders
from invdyn_cli.diagnosis.checks.fitness import fitness, rows_of
from invdyn_cli.diagnosis.checks.fits import correlation, left, slope
from invdyn_cli.diagnosis.checks.samples import NO_MOTION, Samples, gather_changing
from invdyn_cli.interfaces import AbstractCheck
from invdyn_cli.log import Log
from invdyn_cli.maths.metrics import rms
from invdyn_cli.types import Check, Robot


def matched(samples: Samples) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """How well torque column i fits joint j: R^2 with friction and nominal torque, and the correlation with the nominal
    torque after friction, (n, n) each; and RMS of the nominal torque after friction over `reach`, (n,)."""
    tau = samples.tau
    n = tau.shape[1]
    explained, cosine, excited = np.zeros((n, n)), np.zeros((n, n)), np.zeros(n)
    total = np.maximum(np.sum((tau - tau.mean(0)) ** 2, axis=0), 1e-300)
    for j in range(n):
        *rest, nominal = left(np.column_stack([tau, samples.nominal[:, j]]), samples.columns(j)).T
        excited[j] = rms(nominal) / max(samples.reach[j], 1e-12)
        for i, one in enumerate(rest):
            cosine[i, j] = correlation(one, nominal)
            after = float(one @ one) * (1 - cosine[i, j] ** 2)
            explained[i, j] = 1 - after / total[i]
    return explained, cosine, excited


def _without_gravity(samples: Samples, robot: Robot) -> tuple[float, float]:
    """Log of the likelihood ratio of the URDF without gravity to that with it, and the share of the torque's variance
    that it explains then, median over the joints. Each joint may have its own sign and factor, at their odds.

    A joint that gravity alone loads is compared, too: `reach` is zero, so that both fit all joints with errors in the
    inertials, and noise is judged as if gravity were gone.
    """
    n = robot.dofs
    every = [replace(rows_of(samples, without_gravity=x), reach=np.zeros(n)) for x in (False, True)]
    noise = fitness(every[1], robot, UNITS).effective
    before, after = (fitness(rows, robot, UNITS, noise) for rows in every)
    at = np.arange(n)
    cost = np.add.outer([0.0, FLAW + np.log(n)], [*(0.0 for _ in UNITS), OWN])
    sums = [
        [float((x[at, at] - cost).max(axis=(1, 2)).sum()) for x in (fit.likelihood, fit.plain)]
        for fit in (before, after)
    ]
    return min(b - a for a, b in zip(*sums, strict=True)), float(np.median(after.explained[at, at]))


@dataclass(frozen=True)
class GravityRemoved(AbstractCheck):
    """Torques from which gravity is already subtracted, as some drivers' "external" or "feedback" torques.

    The URDF without gravity must be more likely than with it (`fitness`: with errors in its inertials, and unchanged),
    and the torque must hardly follow gravity on the joints that it loads. If neither is more likely, this is reported
    once orders and signs are right.

    Attributes:
        slope: median slope of torque on gravity torque that still is none (ours: with gravity in it, a payload or a
            wrong gain makes 0.5 to 2).
        odds: log of the likelihood ratio that it takes (ours: the odds against the defect, e^5, and e^8); before the
            order is known, times the number of orders, one of which may look like it.
        varied: least RMS of the gravity torque, of what random states ask of a joint (ours).
        explained: share of the torque's variance that the bodies without gravity have to explain before "ambiguous" is
            said, median over the joints (ours: noise and wrong columns stay below).
        again: asked once more, when orders and signs are right: only what is found is said.
    """

    name: ClassVar[str] = "gravity_removed"
    slope: float = 0.25
    odds: float = 13.0
    varied: float = 0.1
    explained: float = 0.8
    again: bool = False

    def examine(self, log: Log, robot: Robot | None) -> list[Check]:
        """For the whole log; the value is the slope of torque on gravity torque."""
        found = self._judged(log, robot)
        return [one for one in found if one.severity in ("fail", "note")] if self.again else found

    def _judged(self, log: Log, robot: Robot | None) -> list[Check]:
        if robot is None:
            return [self.skipped("no robot")]
        if "gravity" in log.compensated:
            return [self.skipped("the log says that gravity is compensated")]
        samples = gather_changing(log, robot)
        if samples is None:
            return [self.skipped(NO_MOTION)]
        slopes = self._slopes(samples)
        if not slopes:
            return [self.skipped("gravity hardly varies on any joint in this motion")]
        value = float(np.median(np.abs(slopes)))
        if value > self.slope:
            return [Check(self.name, "ok", value=float(np.median(slopes)), seen="the torque follows gravity")]
        gain, explained = _without_gravity(samples, robot)
        n = robot.dofs
        orders = 1 if self.again else n * (n - 1) / 2 + len(known_orders(robot))
        gain -= np.log(max(orders, 1))
        if gain < self.odds and not (self.again and gain > -self.odds and explained > self.explained):
            why = f"the torque follows gravity with a slope of {value:.2g} only, but the URDF without gravity is not "
            why += "more likely"
            return [self.skipped(why)]
        return [self._seen(slopes, gain)]

    def _slopes(self, samples: Samples) -> list[float]:
        """Slope of torque over gravity torque, without friction and the other nominal torque, for the joints on which
        gravity varies."""
        slopes = []
        for joint in range(samples.tau.shape[1]):
            columns = np.column_stack([samples.columns(joint), samples.nominal[:, joint] - samples.gravity[:, joint]])
            gravity, tau = left(samples.gravity[:, joint], columns), left(samples.tau[:, joint], columns)
            if rms(gravity) > self.varied * samples.reach[joint]:
                slopes.append(slope(tau, gravity))
        return slopes

    def _seen(self, slopes: list[float], gain: float) -> Check:
        value = float(np.median(slopes))
        seen = (
            f"on {len(slopes)} joints that gravity loads the torque follows it with a slope of {value:.2g} (median); "
        )
        sure = gain > self.odds
        if sure:
            seen += f"the URDF without gravity is more likely, log of the likelihood ratio {gain:.3g}"
            meaning = "gravity is already subtracted from this torque: it is an external or a feedback torque"
        else:
            seen = f"ambiguous: {seen}the URDF with other masses explains this as well, log of the "
            seen += f"likelihood ratio {gain:.3g}"
            meaning = "gravity may already be subtracted from this torque; nothing is changed"
        return Check(
            self.name,
            "fail" if sure else "note",
            value=value,
            threshold=self.slope,
            seen=seen,
            meaning=meaning,
            advice="set the attribute compensated=gravity in the log, or log the driver's whole torque",
            source="own choice: with gravity, payloads and gains change the slope by a factor of 2 at most",
        )

    def correct(self, log: Log, found: Sequence[Check], robot: Robot | None) -> tuple[Log, list[str]]:
        """Declare it, where it is certain."""
        if all(one.severity != "fail" for one in found):
            return log, []
        note = "gravity is assumed to be compensated, because the torques do not follow it"
        return replace(log, compensated=(*log.compensated, "gravity")), [note]
