"""What the torque columns are: gravity in them, whose they are, and their signs, judged by the nominal model's torque.

Friction (ramped sign(qd), qd, 1) is taken out of both before they are compared; a joint is judged where its nominal
torque varies by a fair part of what this arm can ask of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from scipy.optimize import linear_sum_assignment

from invdyn_cli.diagnosis.checks.evidence import Evidence, gather, nominal_torque
from invdyn_cli.diagnosis.checks.fits import correlation, left, rms, slope, span
from invdyn_cli.diagnosis.checks.rows import each, present
from invdyn_cli.interfaces import AbstractCheck
from invdyn_cli.logfile import Log
from invdyn_cli.types import Check, Motion, Robot

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

    Attributes:
        share: of the nominal gravity torque's variance that friction and inertia may leave unexplained (ours: an arm
            that moves under gravity needs most of it; a twentieth is what compensation without a tool leaves).
        slope: of torque on gravity torque that still is none, on every joint that gravity loads (ours: with gravity in
            it, a payload or a wrong gain makes 0.5 to 2).
        correlation: of torque and gravity torque that still is none.
        inertial: least share, of what is left unexplained, that the nominal torque without gravity explains, unless
            next to nothing is left (ours: noise alone is no torque without gravity).
        varied: least RMS of the gravity torque, of what random states ask of a joint (ours).
    """

    name: ClassVar[str] = "gravity_removed"
    share: float = 0.05
    slope: float = 0.25
    correlation: float = 0.6
    inertial: float = 0.3
    varied: float = 0.1

    def examine(self, log: Log, robot: Robot | None) -> list[Check]:
        """For the whole log; the value is the slope of torque on gravity torque."""
        evidence = None if robot is None or not log.trajectories or "gravity" in log.compensated else gather(log, robot)
        if evidence is None or not np.ptp(evidence.tau, axis=0).any():
            return []
        slopes, moved, asked, inertial = [], 0.0, 0.0, 0.0
        for joint in range(len(log.joints)):
            columns = np.column_stack(
                [evidence.columns(joint), evidence.nominal[:, joint] - evidence.gravity[:, joint]]
            )
            gravity, tau = left(evidence.gravity[:, joint], columns), left(evidence.tau[:, joint], columns)
            moved, asked = moved + float(tau @ tau), asked + float(gravity @ gravity)
            before = left(evidence.tau[:, joint], evidence.columns(joint))
            inertial += float(before @ before - tau @ tau)
            if rms(gravity) > self.varied * evidence.reach[joint]:
                slopes.append(slope(tau, gravity))
                if abs(slopes[-1]) > self.slope or abs(correlation(tau, gravity)) > self.correlation:
                    return []
        if not slopes or moved > self.share * asked or inertial < self.inertial * moved > 1e-3 * asked:
            return []
        value = float(np.median(slopes))
        return [
            Check(
                self.name,
                "fail",
                value=value,
                threshold=self.slope,
                seen=f"on {len(slopes)} joints that gravity loads the torque follows it with a slope of {value:.2g}; "
                f"all torques together have {100 * moved / asked:.2g} % of its variance",
                meaning="gravity is taken out of this torque already: an external or a feedback torque",
                advice="attribute compensated=gravity in the log, or the driver's whole torque",
                source="ours: with gravity in it, payloads and gains make 0.5 to 2",
            )
        ]

    def mend(self, log: Log, found: Sequence[Check], robot: Robot | None) -> tuple[Log, list[str]]:
        """Declare it."""
        if not found:
            return log, []
        note = "torques are taken to have gravity compensated, as they follow none"
        return replace(log, compensated=(*log.compensated, "gravity")), [note]


@dataclass(frozen=True)
class JointOrder(AbstractCheck):
    """Torque columns, or all columns, in another order of joints than the robot's.

    The assignment of columns to joints with the highest likelihood (residual variances of friction + nominal torque).
    All channels are permuted only where no torque column fits its joint as it stands, by pairs, greedily.

    Attributes:
        ratio: of residual variances, geometric mean over the joints that change places (ours: noise and model errors do
            not shrink fourfold by chance; joints that move in phase do not reach it).
        explained: least share of variance that each explains in its new place.
        poor: mean squared correlation of torque and nominal torque below which orders of all channels are tried.
        good: what one of them has to reach; `clearly`: and by how much it has to be better (ours).
    """

    name: ClassVar[str] = "joint_order"
    ratio: float = 4.0
    explained: float = 0.7
    poor: float = 0.85
    good: float = 0.85
    clearly: float = 0.1

    def examine(self, log: Log, robot: Robot | None) -> list[Check]:
        """For the whole log; the value lists, for every joint of the robot, the column that belongs to it."""
        evidence = None if robot is None or not log.trajectories or len(log.joints) < 2 else gather(log, robot)
        if evidence is None or robot is None:
            return []
        columns, said = self._torques(log, evidence)
        whole, told, reached = self._whole(evidence, robot)
        if columns is not None and reached < _agreement(evidence, evidence.tau[:, columns]) + self.clearly:
            return [self._seen(log, "tau", columns, said)]
        return [] if whole is None else [self._seen(log, "all", whole, told)]

    def mend(self, log: Log, found: Sequence[Check], robot: Robot | None) -> tuple[Log, list[str]]:
        """Put the columns in order."""
        for check in found:
            order, channel = list(check.value), check.threshold["channel"]
            words = [f"{log.joints[i]} -> {log.joints[j]}" for j, i in enumerate(order) if i != j]

            def change(raw, order=order, channel=channel):
                chosen = present(raw) if channel == "all" else {"tau": raw.tau}
                return replace(raw, **{c: x[:, order] for c, x in chosen.items()})

            log = each(log, change)
            if channel == "all" and log.drive_gain is not None:
                log = replace(log, drive_gain=np.asarray(log.drive_gain)[order])
            what = "columns" if channel == "all" else "torque columns"
            return log, [f"{what} put in the robot's order: {', '.join(words)}"]
        return log, []

    def _torques(self, log: Log, evidence: Evidence) -> tuple[list[int] | None, str]:
        explained, _, excited = matched(evidence)
        unexplained = np.log(np.clip(1 - explained, 0, None) + 0.01)
        columns, joints = linear_sum_assignment(unexplained)
        order = list(range(len(excited)))
        for i, j in zip(columns, joints, strict=True):
            order[j] = int(i)
        kept = list(range(len(order)))
        for cycle in _cycles(order):
            gain = np.mean([unexplained[j, j] - unexplained[order[j], j] for j in cycle])
            judged = [j for j in cycle if excited[j] > EXCITED]
            if gain > np.log(self.ratio) and judged and all(explained[order[j], j] > self.explained for j in judged):
                for j in cycle:
                    kept[j] = order[j]
        if kept == list(range(len(kept))):
            return None, ""
        moved = [j for j, i in enumerate(kept) if i != j]
        said = "; ".join(
            f"column {log.joints[kept[j]]} explains {explained[kept[j], j]:.2g} of its variance as {log.joints[j]}, "
            f"{explained[kept[j], kept[j]]:.2g} in its own place"
            for j in moved
        )
        return kept, said

    def _whole(self, evidence: Evidence, robot: Robot) -> tuple[list[int] | None, str, float]:
        """The order of all columns that fits best, None where it gains little; in words, and how well it fits."""
        rows = slice(None, None, max(1, len(evidence.tau) // 1024))
        n = evidence.tau.shape[1]

        def score(order: list[int]) -> float:
            motion = Motion(*(x[rows][:, order] for x in (evidence.motion.q, evidence.motion.qd, evidence.motion.qdd)))
            nominal, gravity = nominal_torque(robot, motion)
            tau = evidence.tau[rows][:, order]
            return _agreement(replace(evidence, motion=motion, tau=tau, nominal=nominal, gravity=gravity))

        best = list(range(n))
        first = top = score(best)
        if first > self.poor:
            return None, "", 0.0
        alphabet = sorted(range(n), key=lambda j: robot.joints[j])
        starts = [best, best[::-1], [alphabet.index(j) for j in range(n)]]
        best = max(starts, key=score)
        top = score(best)
        for _ in range(3):
            swaps = [_swapped(best, a, b) for a in range(n) for b in range(a)]
            scores = [score(order) for order in swaps]
            if max(scores) <= top + 0.02:
                break
            best, top = swaps[int(np.argmax(scores))], max(scores)
        if top < self.good or top < first + self.clearly:
            return None, "", 0.0
        said = f"squared correlation of torque and nominal torque {first:.2g} as logged, {top:.2g} so reordered"
        return best, said, top

    def _seen(self, log: Log, channel: str, order: list[int], said: str) -> Check:
        return Check(
            self.name,
            "fail",
            value=order,
            threshold={"channel": channel, "ratio": self.ratio, "explained": self.explained},
            seen=said,
            meaning="torques stand in the columns of other joints"
            if channel == "tau"
            else "the log's columns stand in another order of joints than the robot's",
            advice="the order of joint_names, as the driver publishes them (ROS joint_states may be alphabetical)",
            source="ours: noise does not shrink fourfold by chance",
        )


@dataclass(frozen=True)
class SignError(AbstractCheck):
    """Torques with the opposite sign, of all joints or of some.

    Attributes:
        correlation: below minus this a joint is flipped, above this it is not (ours: with friction taken out, what is
            left of a well moved joint's torque is rigid-body dynamics; noise and model errors take from 1).
        size: factor by which a single flipped torque may be larger or smaller than the nominal one (ours: a payload
            may turn the torque of the joint behind which it hangs, and makes it another size).
        ratio: of the variances that stay when a spring, an inertia of the joint's own, friction and an offset are
            fitted beside the nominal torque as it is, and turned round: below it these explain the torque without a
            turn, and nothing is turned (ours, as in `JointOrder`).
    """

    name: ClassVar[str] = "sign_error"
    correlation: float = 0.75
    size: float = 2.0
    ratio: float = 4.0

    def examine(self, log: Log, robot: Robot | None) -> list[Check]:
        """All joints at once where none speaks against it, else single ones; the value is the correlation. Where a
        spring or another inertia would do as well it is a warning, and nothing is mended."""
        evidence = None if robot is None or not log.trajectories else gather(log, robot)
        if evidence is None:
            return []
        _, cosine, excited = matched(evidence)
        judged, values = excited > EXCITED, np.diag(cosine)
        flipped = np.flatnonzero(judged & (values < -self.correlation))
        upright = np.flatnonzero(judged & (values > self.correlation / 2))
        if not len(flipped):
            return []
        said = ", ".join(f"{log.joints[j]} {values[j]:.2f}" for j in np.flatnonzero(judged))
        seen = f"correlation of torque and nominal torque, friction taken out: {said}"
        sure = [bool(self._ratio(evidence, int(j)) > self.ratio) for j in flipped]
        if not len(upright) and len(flipped) >= min(2, len(log.joints)) and any(sure):
            return [self._seen(None, float(np.median(values[flipped])), seen, "all torques")]
        found = []
        for j, certain in zip(flipped, sure, strict=True):
            tau, nominal = (left(x[:, j], evidence.columns(int(j))) for x in (evidence.tau, evidence.nominal))
            if not 1 / self.size < abs(slope(tau, nominal)) < self.size:
                continue
            if certain:
                found.append(self._seen(log.joints[j], float(values[j]), seen, f"the torque of {log.joints[j]}"))
            else:
                found.append(self._doubted(log.joints[j], float(values[j]), seen))
        return found

    def mend(self, log: Log, found: Sequence[Check], robot: Robot | None) -> tuple[Log, list[str]]:
        """Turn them round."""
        sign = np.ones(len(log.joints))
        found = [check for check in found if check.severity == "fail"]
        for check in found:
            sign[slice(None) if check.joint is None else log.joints.index(check.joint)] = -1
        if not found:
            return log, []
        which = "all joints" if np.all(sign < 0) else ", ".join(str(c.joint) for c in found)
        return each(log, lambda raw: replace(raw, tau=raw.tau * sign)), [f"torque sign turned: {which}"]

    def _ratio(self, evidence: Evidence, joint: int) -> float:
        """What stays of a joint's torque beside its own terms and the nominal torque, over what stays with the nominal
        torque turned round."""
        motion, tau, nominal = evidence.motion, evidence.tau[:, joint], evidence.nominal[:, joint]
        own = np.column_stack([evidence.columns(joint), motion.q[:, joint], motion.qdd[:, joint]])
        plain, turned = (rms(left(tau - sign * nominal, own)) for sign in (1, -1))
        return float(plain / max(turned, 1e-300)) ** 2

    def _doubted(self, joint: str, value: float, seen: str) -> Check:
        return Check(
            self.name,
            "warn",
            joint=joint,
            value=value,
            threshold=-self.correlation,
            seen=seen,
            meaning=f"the torque of {joint} runs against the URDF's, and a spring, or another inertia than the URDF's, "
            "explains it as well as an opposite sign: it is left as it is",
            advice="the sign convention of this torque; a motion in which gravity loads the joint tells",
            source="ours: noise does not shrink fourfold by chance",
        )

    def _seen(self, joint: str | None, value: float, seen: str, what: str) -> Check:
        return Check(
            self.name,
            "fail",
            joint=joint,
            value=value,
            threshold=-self.correlation,
            seen=seen,
            meaning=f"{what} has the opposite sign of the URDF's: a load's instead of the drive's, or an axis reversed",
            advice="the sign convention of the torque channel; positive torque drives towards positive q",
            source="ours: on a well moved joint only noise and model errors take from a correlation of 1",
        )


def _agreement(evidence: Evidence, tau: np.ndarray | None = None) -> float:
    """Mean squared correlation of the judged joints' torque and nominal torque, negative ones as none."""
    _, cosine, excited = matched(evidence, tau)
    judged = excited > EXCITED
    return float(np.mean(np.clip(np.diag(cosine)[judged], 0, None) ** 2)) if judged.any() else 0.0


def _cycles(order: Sequence[int]) -> list[list[int]]:
    """Cycles of a permutation with more than one element."""
    seen: set[int] = set()
    found = []
    for start in range(len(order)):
        cycle, j = [], start
        while j not in seen:
            seen.add(j)
            cycle.append(j)
            j = order[j]
        if len(cycle) > 1:
            found.append(cycle)
    return found


def _swapped(order: list[int], a: int, b: int) -> list[int]:
    order = list(order)
    order[a], order[b] = order[b], order[a]
    return order
