"""The columns of a log: in the robot's order, with torques in N m where the drive gains are known."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invdyn_cli.errors import LogError, RobotError, listed
from invdyn_cli.log import CHANNELS, Log, RawTrajectory
from invdyn_cli.types import Robot


def ordered(log: Log, robot: Robot | None, notes: list[str]) -> Log:
    """The log with its columns in the robot's order of joints.

    Raises:
        RobotError: for a robot with other joints.
        LogError: for a channel that lacks columns.
    """
    if robot is None or robot.joints == log.joints:
        return log
    if robot.dofs != len(log.joints):
        got = f"robot {robot.name!r} moves {robot.dofs} joints: {listed(robot.joints)}; the log has {len(log.joints)}"
        raise RobotError(f"{got}: {listed(log.joints)}", advice="a URDF of the logged robot, robot.path=…")
    if known := set(robot.joints) & set(log.joints) if set(robot.joints) != set(log.joints) else set():
        got = f"robot {robot.name!r} moves {listed(robot.joints)}, the log has {listed(log.joints)}"
        raise RobotError(
            f"{got}: only {listed(sorted(known))} in both; allowed: the same names, or all others, taken in order",
            advice="robot.joints=[…] in the order of the log's columns, or another URDF",
        )
    if set(robot.joints) != set(log.joints):
        notes.append(f"the log's joints {listed(log.joints)} are read as the robot's {listed(robot.joints)}")
        return replace(log, joints=robot.joints)
    order = [log.joints.index(joint) for joint in robot.joints]
    gain = None if log.drive_gain is None else log.drive_gain[order]
    try:
        trajectories = tuple(
            replace(raw, **{c: getattr(raw, c)[:, order] for c in CHANNELS if getattr(raw, c) is not None})
            for raw in log.trajectories
        )
    except IndexError as error:
        got = f"a channel has fewer columns than joint_names: {error}"
        raise LogError(got, advice="a column for each joint") from error
    return replace(log, joints=robot.joints, drive_gain=gain, trajectories=trajectories)


def newton_metres(log: Log, raw: RawTrajectory) -> np.ndarray:
    """Torque (T, n) [N m; N], currents times their drive gains where these are known."""
    if log.torque_unit != "A" or log.drive_gain is None or raw.tau.shape[1:] != (len(log.joints),):
        return raw.tau
    return raw.tau * log.drive_gain


def in_newton_metres(log: Log) -> Log:
    """The log with torques in N m; unchanged where its drive gains are unknown."""
    if log.torque_unit != "A" or log.drive_gain is None:
        return log
    trajectories = tuple(replace(raw, tau=newton_metres(log, raw)) for raw in log.trajectories)
    return replace(log, torque_unit="N m", drive_gain=None, trajectories=trajectories)


def joined(logs: Sequence[Log], robot: Robot | None, notes: list[str]) -> Log:
    """One log of all trajectories, columns in the robot's order; of several logs in N m, a single one in its unit.

    Raises:
        RobotError, LogError: as `ordered`, and where some torques of several stay in A.
    """
    logs = [ordered(log, robot, notes) for log in logs]
    if len(logs) > 1:
        logs = [in_newton_metres(log) for log in logs]
    if len({log.torque_unit for log in logs}) > 1:
        raise LogError("some logs have torques in A without drive gains", advice="data.drive_gain=[…], N m per A")
    return replace(logs[0], trajectories=tuple(raw for log in logs for raw in log.trajectories))
