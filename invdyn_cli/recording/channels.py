"""The columns of a log: in the robot's order, with torques in N m where the drive gains are known."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invdyn_cli.errors import LogError, RobotError, listed
from invdyn_cli.formats.columns import numbered
from invdyn_cli.formats.joint_names import elsewhere, matched
from invdyn_cli.log import Log, RawTrajectory
from invdyn_cli.recording.rows import each, present
from invdyn_cli.types import Robot


def ordered(log: Log, robot: Robot | None, notes: list[str]) -> Log:
    """The log with its columns in the robot's order of joints: by their names in any order; if no name is a joint's, as
    they stand, and a note says so.

    Raises:
        RobotError: for a robot with another number of joints, or names of which only some are joints'.
        LogError: for a channel that lacks columns.
    """
    if robot is None or robot.joints == log.joints:
        return log
    if robot.dofs != len(log.joints):
        got = f"robot {robot.name!r} moves {robot.dofs} joints: {listed(robot.joints)}; the log has {len(log.joints)}"
        raise RobotError(f"{got}: {listed(log.joints)}", advice="a URDF of the logged robot, robot.path=…")
    order = _order(log.joints, robot, notes)
    gain = None if log.drive_gain is None else log.drive_gain[order]
    try:
        log = each(log, lambda raw: replace(raw, **{c: x[:, order] for c, x in present(raw).items()}))
    except IndexError as error:
        got = f"a channel has fewer columns than joint_names: {error}"
        raise LogError(got, advice="a column for each joint") from error
    return replace(log, joints=robot.joints, drive_gain=gain)


def _order(joints: Sequence[str], robot: Robot, notes: list[str]) -> list[int]:
    """The column of each of the robot's joints; RobotError where names leave it open."""
    wanted = robot.columns or robot.joints
    counted = tuple(joints) == numbered(len(joints))
    found = None if counted and robot.columns else matched(joints, robot.joints)
    if found:
        if set(joints) != set(robot.joints):
            own, means = listed(joints[k] for k in found), "numbers" if counted else "names"
            notes.append(f"the log's joints {own} are read as the robot's {listed(robot.joints)}, by their {means}")
        return found
    known = sorted(set(wanted) & set(joints))
    apart = [] if counted else elsewhere(joints, wanted)
    if known or apart:
        said = f"they have only {listed(known)} in common"
        if not known:
            said = f"{apart[0][0]} resembles {apart[0][1]}, which has another place in the order"
        got = f"robot {robot.name!r} moves {listed(wanted)}, the log has {listed(joints)}: {said}"
        raise RobotError(
            f"{got}; allowed: exactly the robot's names (in any order), or none of its names (in the robot's order)",
            advice="'data.columns={joints: […]}', the robot's names in the order of the log's columns; or another URDF",
        )
    notes.append(f"the log's joints {listed(joints)} are read as the robot's {listed(wanted)}, in this order")
    return [wanted.index(name) for name in robot.joints]


def newton_metres(log: Log, raw: RawTrajectory) -> np.ndarray:
    """Torque (T, n) [N m; N], currents times their drive gains where these are known."""
    if log.torque_unit != "A" or log.drive_gain is None or raw.tau.shape[1:] != (len(log.joints),):
        return raw.tau
    return raw.tau * log.drive_gain


def in_newton_metres(log: Log) -> Log:
    """The log with torques in N m; unchanged where its drive gains are unknown."""
    if log.torque_unit != "A" or log.drive_gain is None:
        return log
    made = each(log, lambda raw: replace(raw, tau=newton_metres(log, raw)))
    return replace(made, torque_unit="N m", drive_gain=None)


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
