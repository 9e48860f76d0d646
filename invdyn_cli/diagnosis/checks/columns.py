"""Columns in another order than the robot's joints, or with the opposite sign: what the physics asks for
(`arrangement`), stated where nothing else is as likely, and corrected only then."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from invdyn_cli.diagnosis.checks.arrangement import (
    AFTER_ORDER,
    ALIKE,
    FOUND,
    SOURCE,
    Arrangement,
    arrangement,
    known_orders,
)
from invdyn_cli.diagnosis.checks.fits import left, share, slope
from invdyn_cli.diagnosis.checks.samples import EXCITED, NO_MOTION, Samples, gather
from invdyn_cli.diagnosis.checks.torques import matched
from invdyn_cli.interfaces import AbstractCheck
from invdyn_cli.log import Log, RawTrajectory
from invdyn_cli.maths.metrics import rms
from invdyn_cli.recording.rows import each, present
from invdyn_cli.types import Check, Robot

POSITIONS = ("q", "qd", "qdd", "q_ref", "q_link")


@dataclass(frozen=True)
class JointOrder(AbstractCheck):
    """Torque columns, or all columns, in another order of joints than the robot's.

    The value lists, for every joint of the robot, the column that belongs to it; `threshold` has the order of the
    positions ("order"), of the torques ("columns"), and the log of the odds that are asked for. Where others are as
    likely, all of them are listed ("alike", the best first), and nothing is corrected.
    """

    name: ClassVar[str] = "joint_order"

    def examine(self, log: Log, robot: Robot | None) -> list[Check]:
        """For the whole log."""
        if robot is None:
            return [self.skipped("no robot")]
        if len(log.joints) < 2:
            return [self.skipped("one joint has no order")]
        verdict = arrangement(log, robot)
        if verdict is None:
            return [self.skipped(NO_MOTION)]
        best, straight = verdict.best, tuple(range(robot.dofs))
        others = verdict.other_orders
        found = []
        unjudged = [log.joints[j] for j in np.flatnonzero(~verdict.judged)]
        if unjudged:
            why = "the order of these columns was not judged, because they show no rigid-body torque: "
            found.append(self.skipped(why + ", ".join(unjudged), "tau"))
        if (best.order, best.columns) == (straight, straight):
            if others:
                found.append(self._ambiguous("note", log, robot, "the columns as they stand", best, others))
            return found or [Check(self.name, "ok", value=list(straight), seen="no other order is as likely")]
        words = _words(log, robot, best.order, best.columns)
        if others:
            return [*found, self._ambiguous("warn", log, robot, words, best, others)]
        gain = best.beside(verdict.logged)
        return [*found, self._seen(robot, best, words, gain)]

    def correct(self, log: Log, found: Sequence[Check], robot: Robot | None) -> tuple[Log, list[str]]:
        """Put the columns in order."""
        known = next((c.threshold for c in found if c.severity == "fail"), None)
        if known is None:
            return log, []
        order, columns = known["order"], known["columns"]

        def change(raw: RawTrajectory) -> RawTrajectory:
            return replace(raw, **{c: x[:, columns if c == "tau" else order] for c, x in present(raw).items()})

        log = each(log, change)
        if log.drive_gain is not None:
            log = replace(log, drive_gain=np.asarray(log.drive_gain)[columns])
        both = {"all": order} if order == columns else {"position": order, "torque": columns}
        moves = {
            which: ", ".join(f"{log.joints[moved[j]]} -> {log.joints[j]}" for j in _moved(moved))
            for which, moved in both.items()
        }
        return log, [f"{which} columns put in the robot's order: {x}" for which, x in moves.items() if x]

    def _seen(self, robot: Robot, best: Arrangement, words: str, gain: float) -> Check:
        return Check(
            self.name,
            "fail",
            value=list(best.columns if best.order == tuple(sorted(best.order)) else best.order),
            threshold={"order": list(best.order), "columns": list(best.columns), "log_odds": FOUND},
            seen=f"{words}: log odds of {gain:.3g} against the order as logged; every other order is less likely by "
            f"log odds of {ALIKE:g} or more",
            meaning="torques are in the columns of other joints"
            if best.order == tuple(range(robot.dofs))
            else "the joint order of the log's columns is not the robot's",
            advice="check that joint_names has the order that the driver publishes",
            source=SOURCE,
        )

    def _ambiguous(self, severity: str, log: Log, robot: Robot, words: str, best: Arrangement, others: list) -> Check:
        said = [_words(log, robot, *one) for one in others[:3]]
        more = f" and {len(others) - 3} more" if len(others) > 3 else ""
        alike = [(best.order, best.columns), *others]
        joints = sorted({j for order, columns in others for j in (*_moved(order), *_moved(columns))})
        names = " and ".join(log.joints[j] for j in joints[:3])
        return Check(
            self.name,
            severity,
            value=None,
            threshold={"log_odds": ALIKE, "alike": [{"order": list(a), "columns": list(b)} for a, b in alike]},
            seen=f"ambiguous: {words}; as likely: {'; '.join(said)}{more}",
            meaning="this motion does not show which column is which; nothing is changed",
            advice=f"a recording in which {names} move one after another, where gravity loads them",
            source=SOURCE,
        )


@dataclass(frozen=True)
class SignError(AbstractCheck):
    """Torques, or positions with their velocities, that have the opposite sign, of all joints or of some.

    A flip is stated where no arrangement without it is as likely: neither a spring nor an offset, a rotor, a
    placeholder inertia or a tool explains the torque as well.

    Attributes:
        correlation: of torque and nominal torque, friction taken out, below minus which a torque that is left as it is
            is warned of (ours), unless friction takes `braked` of it.
        size: factor by which a single flipped torque may be larger or smaller than the nominal one (ours: a payload
            may turn the torque of the joint behind which it hangs, and makes it another size).
        plausible: median factor on all joints from the inverse of which to which sizes count (ours: else currents).
        driven: share of the torque by which friction would drive a joint instead of braking it, from which on its sign
            is doubted without the URDF's torque (ours: of sound logs of eighteen arms the largest was 0.07).
        explained: share of a torque that friction, nominal torque and rotor explain where that is asked (ours).
    """

    name: ClassVar[str] = "sign_error"
    correlation: float = 0.75
    size: float = 2.0
    plausible: float = 3.0
    driven: float = 0.3
    braked: float = 0.1
    explained: float = 0.8

    def examine(self, log: Log, robot: Robot | None) -> list[Check]:
        """All joints at once, else single ones; the value is the factor, -1."""
        if robot is None:
            return [self.skipped("no robot", "tau")]
        verdict = arrangement(log, robot)
        samples = gather(log, robot) if verdict is not None else None
        if verdict is None or samples is None:
            return [self.skipped(NO_MOTION, "tau")]
        if verdict.gravity is not None:
            return [self.skipped("the base is mounted otherwise than in the URDF, which turns torques", "tau")]
        sizes, values = self._sizes(samples)
        best, every = verdict.best, (verdict.best, *(verdict.alike if verdict.in_order else verdict.rivals))
        n = robot.dofs
        found = []
        pairs = [{(x.signs[j], x.turned[j]) for x in every} for j in range(n)]
        turned = [j for j in range(n) if pairs[j] <= {(1, -1), (-1, -1)} and len(pairs[j]) == 1 and verdict.judged[j]]
        moved = [j for j in range(n) if pairs[j] <= {(-1, 1), (-1, -1)} and len(pairs[j]) == 1]
        either = [j for j in range(n) if len(pairs[j]) > 1 and (1, 1) not in pairs[j]]
        gain = best.beside(verdict.logged)
        upright = [j for j in range(n) if best.turned[j] > 0 and verdict.judged[j]]
        if len(turned) > 1 and not upright and not moved:
            found.append(self._seen(log, None, "tau", gain, "the torque of all joints"))
        else:
            for j in turned:
                if j in moved:
                    what = f"the axis of {log.joints[j]} (q, qd and torque)"
                    found.append(self._seen(log, j, "q, tau", gain, what))
                elif self._fits(sizes, j):
                    found.append(self._seen(log, j, "tau", gain, f"the torque of {log.joints[j]}"))
        half = [j for j in moved if j not in turned]
        for j in half:
            torque = (
                "but not its torque" if verdict.judged[j] else "and perhaps its torque, which the motion does not show"
            )
            found.append(self._seen(log, j, "q", gain, f"the position and velocity of {log.joints[j]}, {torque}"))
        odds = f"log odds of {gain:.3g} against the signs as logged"
        found += [self._either(log, j, pairs[j], odds) for j in either]
        told = {c.joint for c in found}
        if None not in told:
            work, others = self._work(samples), [j for j in range(n) if log.joints[j] not in told]
            doubted = [j for j in others if values[j] < -self.correlation and self._fits(sizes, j)]
            doubted = [j for j in doubted if work[j] < self.braked]
            alone = not told and not doubted  # one wrong sign makes others look wrong
            driven = [j for j in others if work[j] < -self.driven and (alone or j in doubted)]
            doubted = [j for j in doubted if j not in driven]
            if (doubted or driven) and not verdict.in_order:
                names = ", ".join(log.joints[j] for j in (*doubted, *driven))
                found.append(self.skipped(f"the sign of the torque is in doubt: {names}; {AFTER_ORDER}", "tau"))
            else:
                found += [self._doubted(log, j, float(values[j])) for j in doubted]
                found += [self._either(log, j, {(1, -1), (-1, 1)}, _drives(work[j])) for j in driven]
        told = {c.joint for c in found}
        unsure = [j for j in range(n) if not verdict.judged[j] or len(pairs[j]) > 1]
        unsure = [log.joints[j] for j in unsure if log.joints[j] not in told or (j in half and not verdict.judged[j])]
        if unsure:
            found.append(self.skipped("this motion does not show the sign of " + ", ".join(unsure), "tau"))
        return found or [Check(self.name, "ok", value=1.0, seen="the fit is worse with any joint's sign reversed")]

    def correct(self, log: Log, found: Sequence[Check], robot: Robot | None) -> tuple[Log, list[str]]:
        """Turn them round."""
        signs = {"q": np.ones(len(log.joints)), "tau": np.ones(len(log.joints))}
        notes = []
        for check in found:
            if check.severity != "fail":
                continue
            channels = check.threshold["channel"].split(", ")
            for channel in channels:
                signs[channel][slice(None) if check.joint is None else log.joints.index(check.joint)] = -1
            words = {"q": "q and its derivatives", "tau": "torque"}
            what = " and ".join(words[c] for c in channels)
            notes.append(f"sign of {what} turned: {check.joint or 'all joints'}")
        if not notes:
            return log, []

        def change(raw: RawTrajectory) -> RawTrajectory:
            by = {c: signs["q" if c in POSITIONS else "tau"] for c in present(raw)}
            return replace(raw, **{c: x * by[c] for c, x in present(raw).items() if np.any(by[c] < 0)})

        return each(log, change), notes

    def _sizes(self, samples: Samples) -> tuple[np.ndarray, np.ndarray]:
        """(n,) slope of torque on nominal torque, friction taken out, NaN where a joint is not judged; correlation (0
        there)."""
        _, cosine, excited = matched(samples)
        slopes = np.full(len(excited), np.nan)
        for j in np.flatnonzero(excited > EXCITED):
            tau, nominal = (left(x[:, j], samples.columns(int(j))) for x in (samples.tau, samples.nominal))
            slopes[j] = slope(tau, nominal) if rms(nominal) > 0 else np.nan
        return slopes, np.where(np.isfinite(slopes), np.diag(cosine), 0.0)

    def _fits(self, sizes: np.ndarray, j: int) -> bool:
        """Whether a turned torque has the size of a turned torque."""
        known = np.abs(sizes[np.isfinite(sizes)])
        if not np.isfinite(sizes[j]):
            return True
        middle = float(np.median(known))
        currents = not 1 / self.plausible < middle < self.plausible
        return currents or 1 / self.size < abs(sizes[j]) < self.size

    def _work(self, samples: Samples) -> np.ndarray:
        """(n,) power that friction takes beside nominal torque and rotor, over that of torque and speed, both by RMS; 0
        where these do not explain the torque, or nominal torque and rotor do so as well where joints move in phase."""
        work = np.zeros(samples.tau.shape[1])
        for j, tau in enumerate(samples.tau.T):
            qd, friction = np.asarray(samples.motion.qd)[:, j], samples.columns(j)
            x = np.column_stack([friction, samples.nominal[:, j], samples.motion.qdd[:, j]])
            size = np.maximum(np.linalg.norm(x, axis=0), 1e-12)
            fitted = np.linalg.lstsq(x / size, tau, rcond=1e-8)[0] / size
            explained = share(tau - x @ fitted, tau)
            own = np.mean(friction[:, :2] @ fitted[:2] * qd) / max(float(tau.std() * rms(qd)), 1e-12)
            alone = explained - share(left(tau, x[:, 2:]), tau)
            if explained > self.explained and alone > own**2 / 2:
                work[j] = own
        return work

    def _either(self, log: Log, j: int, pairs: set, why: str) -> Check:
        names = {(1, -1): "its torque", (-1, 1): "its q and qd", (-1, -1): "its axis (q, qd and torque)"}
        words = " or ".join(name for pair, name in names.items() if pair in pairs)
        return Check(
            self.name,
            "warn",
            joint=log.joints[j],
            value=-1.0,
            threshold={"channel": "q or tau", "log_odds": FOUND},
            seen=f"ambiguous: {words} may have the opposite sign; {why}",
            meaning="a sign is wrong and this motion does not show which; nothing is changed",
            advice="a recording in which this joint moves alone, where gravity loads it",
            source=SOURCE,
        )

    def _doubted(self, log: Log, j: int, value: float) -> Check:
        return Check(
            self.name,
            "warn",
            joint=log.joints[j],
            value=value,
            threshold={"channel": "tau", "correlation": -self.correlation},
            seen=f"correlation of torque and nominal torque, without friction: {value:.2f}",
            meaning=f"the torque of {log.joints[j]} is opposite to the URDF's; a wrong sign, a spring or a wrong "
            "inertia in the URDF would explain this equally well, so nothing is changed",
            advice="check the sign convention of this torque, or record a motion in which gravity loads this joint",
            source=SOURCE,
        )

    def _seen(self, log: Log, j: int | None, channel: str, value: float, what: str) -> Check:
        return Check(
            self.name,
            "fail",
            joint=None if j is None else log.joints[j],
            value=-1.0,
            threshold={"channel": channel, "log_odds": FOUND},
            seen=f"log odds of {value:.3g} against the signs as logged; every explanation with the logged sign is less "
            f"likely by log odds of {ALIKE:g} or more",
            meaning=f"the sign is opposite to the URDF's: {what}. Either the torque of the load was logged instead of "
            "the drive's, or the axis is reversed",
            advice="check the sign convention of the channel: positive torque drives towards positive q",
            source=SOURCE,
        )


def _drives(work: float) -> str:
    return f"with the logged signs, friction would drive this joint (with {-work:.2g} of its torque) and not brake it"


def _words(log: Log, robot: Robot, order: tuple[int, ...], columns: tuple[int, ...]) -> str:
    """An arrangement in words."""
    straight = tuple(range(robot.dofs))
    if (order, columns) == (straight, straight):
        return "the columns as they stand"
    if order == columns:
        name = next((name for name, known in known_orders(robot).items() if known == order), None)
        exchanged = _exchange(log, order)
        if name and len(_moved(order)) > 2:
            return f"all columns are {name}"
        return f"all columns: {exchanged}" + (f" ({name})" if name else "")
    parts = []
    if order != straight:
        parts.append(f"positions: {_exchange(log, order)}")
    if columns != straight:
        parts.append(f"torques: {_exchange(log, columns)}")
    return ", ".join(parts)


def _exchange(log: Log, order: tuple[int, ...]) -> str:
    moved = _moved(order)
    if len(moved) == 2:
        return f"{log.joints[moved[0]]} and {log.joints[moved[1]]} exchanged"
    return ", ".join(f"{log.joints[order[j]]} is {log.joints[j]}" for j in moved)


def _moved(order: tuple[int, ...]) -> list[int]:
    return [j for j, i in enumerate(order) if i != j]
