"""Whether the robot description can belong to this log."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from invdyn_cli.diagnosis.checks.samples import EXCITED, Samples, gather, regressor_rows
from invdyn_cli.diagnosis.checks.torques import matched
from invdyn_cli.interfaces import AbstractCheck
from invdyn_cli.joints import units
from invdyn_cli.log import Log
from invdyn_cli.recording.rows import largest_ranges, usable_rows
from invdyn_cli.types import Check, Robot


@dataclass(frozen=True)
class ModelMismatch(AbstractCheck):
    """A log of another robot, a wrong URDF, or a torque that never changes.

    Per joint: the share of the torque's variance that friction and a scaled nominal torque explain. If it is low on
    most joints, all inertial parameters (with friction, and rotor inertias) are fitted to every other block of the log
    and tested on the blocks between. This fit is good with another payload, another hand or wrong inertials, but not
    with the kinematics of another robot.

    Attributes:
        nominal: median share below which the refit is made, and a warning due.
        refit: median held-out share of the refit below which the log fails (ours: of noise
            in place of a torque it is below 0).
        beyond: [rad] past the URDF's limits that is worth a warning (ours: more than a homing error).
        blocks: into which the log is cut.
    """

    name: ClassVar[str] = "model_mismatch"
    nominal: float = 0.3
    refit: float = 0.3
    beyond: float = 0.1
    blocks: int = 16

    def examine(self, log: Log, robot: Robot | None) -> list[Check]:
        """The value is the explained share of variance, or the torque or travel of a joint."""
        if not log.trajectories:
            return []
        found = self._dead(log)
        if robot is None:
            return [*found, self.skipped("no robot: neither its limits nor its inertials are compared")]
        if any(c.severity == "fail" for c in found):
            return found
        found += self._limits(log, robot)
        samples = gather(log, robot)
        if samples is None:
            return found
        explained, _, excited = matched(samples)
        judged = np.flatnonzero(excited > EXCITED)
        nominal = np.diag(explained)[judged]
        if len(judged) < min(2, len(log.joints)) or len(samples.tau) < 200:
            return [*found, self.skipped("fewer than two joints whose rigid-body torque varies in this motion")]
        if np.median(nominal) > self.nominal:
            return found
        refit = float(np.median(self._refit(samples, robot)[judged]))
        fails = refit < self.refit
        found.append(
            Check(
                self.name,
                "fail" if fails else "warn",
                value=refit if fails else float(np.median(nominal)),
                threshold=self.refit if fails else self.nominal,
                seen=f"nominal torque and friction explain {np.median(nominal):.2g} of the torque's variance (median "
                f"of {len(judged)} joints), refitted inertials explain {refit:.2g} on held-out data",
                meaning="the kinematics are not this robot's, or this channel is not a torque"
                if fails
                else "the URDF's inertials are far from this robot's, or the URDF lacks a heavy tool",
                advice="use the logged robot's URDF; check the order of its joints and the topic of the torque"
                if fails
                else "use robot.payload, the URDF of the arm with its tool, or model=pest",
                source="own choice: the model explains nothing of pure noise on held-out data",
            )
        )
        return found

    def _dead(self, log: Log) -> list[Check]:
        """Torque channels that never change."""
        dead = np.flatnonzero(largest_ranges(log, "tau") == 0)
        every = len(dead) == len(log.joints)
        return [
            Check(
                self.name,
                "fail" if every else "note",
                joint=name,
                value=0.0,
                threshold=0.0,
                seen=f"the torque {'of every joint ' if every else ''}never changes",
                meaning="there is no torque in this channel",
                advice="check the topic or field that tau is taken from",
                source="a torque without any noise is no measurement",
            )
            for name in ([None] if every else [log.joints[j] for j in dead])
        ]

    def _limits(self, log: Log, robot: Robot) -> list[Check]:
        """Joints that leave the URDF's limits."""
        found = []
        rows = [raw.q[usable_rows(raw)] for raw in log.trajectories]
        rows = [q for q in rows if len(q)]
        if not rows:
            return []
        low, high = np.min([q.min(0) for q in rows], axis=0), np.max([q.max(0) for q in rows], axis=0)
        past = np.maximum(np.asarray(robot.lower) - low, high - np.asarray(robot.upper))
        for joint in np.flatnonzero(past > self.beyond):
            found.append(
                Check(
                    self.name,
                    "warn",
                    joint=log.joints[joint],
                    value=float(past[joint]),
                    threshold=self.beyond,
                    seen=f"q goes {past[joint]:.3g} {units(robot.prismatic[joint]).position} past the URDF's limits",
                    meaning="the joint's zero or the sign of its axis differs, or it is another robot",
                    advice="check the joint's zero and direction in the URDF",
                    source="own choice: more than a homing error",
                )
            )
        return found

    def _refit(self, samples: Samples, robot: Robot) -> np.ndarray:
        """(n,) share of held-out variance that all base parameters, friction and rotor inertias explain."""
        rows, inertial = regressor_rows(robot, samples.motion)
        qdd, tau = np.asarray(samples.motion.qdd)[rows].T, samples.tau[rows].T
        n = len(tau)
        extra = np.zeros((n, len(rows), 4 * n))
        for j in range(n):
            extra[j, :, 4 * j : 4 * j + 4] = np.column_stack([samples.columns(j)[rows], qdd[j]])
        weights = 1 / np.maximum(tau.std(1), 1e-9 * max(tau.std(), 1e-300))
        columns = np.concatenate([inertial, extra], axis=2) * weights[:, None, None]
        target = tau * weights[:, None]
        odd = (np.arange(len(rows)) * self.blocks // len(rows)) % 2 == 1
        missed = np.zeros((n, len(rows)))
        for held in (odd, ~odd):
            known = columns[:, ~held].reshape(-1, columns.shape[2])
            norms = np.maximum(np.linalg.norm(known, axis=0), 1e-9)
            psi, *_ = np.linalg.lstsq(known / norms, target[:, ~held].reshape(-1), rcond=1e-4)
            missed[:, held] = target[:, held] - (columns[:, held] / norms) @ psi
        total = np.maximum(np.sum((target - target.mean(1, keepdims=True)) ** 2, axis=1), 1e-300)
        return 1 - np.sum(missed**2, axis=1) / total
