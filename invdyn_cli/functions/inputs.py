"""What a function accepts as a log and as a robot: objects, paths, or arrays."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Unpack

from invdyn_cli.data.recorded import RealLog
from invdyn_cli.errors import RobotError, UsageError, listed
from invdyn_cli.formats.columns import numbered
from invdyn_cli.formats.joint_names import matched
from invdyn_cli.formats.reading import Columns
from invdyn_cli.functions.arrays import Arrays, from_arrays
from invdyn_cli.log import Log
from invdyn_cli.robots import load_urdf
from invdyn_cli.types import Header, Robot

LogLike = Log | str | Path
RobotLike = Robot | str | Path


def read(*paths: str | Path, columns: Columns = None, drive_gain: Sequence[float] | None = None) -> Log:
    """The log at a path, in any format (docs/formats.md), defects and all; several logs of one robot as one.

    Args:
        paths: invdyn logs, or files of other formats. Of several, trajectories are called "<file stem>/<name>".
        columns: the column map of another format, a YAML file or its entries; None: guessed.
        drive_gain: (n,) [N m/A] of a log whose torques are currents.

    Raises:
        LogError, UsageError: for a file that cannot be read, or columns that leave something open.
    """
    return RealLog([str(path) for path in paths], columns=columns, drive_gain=drive_gain).recorded(None).log


def log_of(log: LogLike | None, **arrays: Unpack[Arrays]) -> Log:
    """The log that is meant: itself, the one at a path, or the recording that the arrays are.

    Raises:
        UsageError: where both or neither are given; as `read` and `from_arrays` do.
    """
    beside = [name for name in arrays if name != "urdf"]
    if log is None:
        return from_arrays(**arrays)
    if beside:
        raise UsageError(
            f"a log and {listed(beside)} are given; allowed: a log alone, or the arrays q=, tau=, t= and their options"
        )
    if isinstance(log, str | Path):
        return read(log)
    if not isinstance(log, Log):
        got = f"the log is a {type(log).__name__}; allowed: a Log, the path of a file, or q=, tau=, t="
        raise UsageError(got, advice="invdyn.read(path), or invdyn.from_arrays(q=q, tau=tau, t=t)")
    return log


def robot_of(robot: RobotLike | None, log: Log, arrays: Arrays | None = None) -> Robot | None:
    """The robot that is meant: itself, that of a URDF with the log's joints, or the one that the log names; None where
    nobody names one.

    Raises:
        RobotError: for a URDF that cannot be read or lacks joints of the log.
    """
    robot = robot if robot is not None else (arrays or {}).get("urdf")
    if isinstance(robot, Robot):
        return robot
    if robot is not None and not isinstance(robot, str | Path):
        got = f"the robot is a {type(robot).__name__}; allowed: a Robot, or the path of a URDF"
        raise UsageError(got, advice="invdyn.load_urdf(path)")
    path = robot or named_by(Header(log.robot, log.joints, log.urdf))
    return with_joints(lambda joints: load_urdf(path, joints=joints), log.joints) if path else None


def named_by(header: Header | None) -> str:
    """The URDF that data name, "" for none.

    Raises:
        RobotError: for a xacro file, which runs code of whoever wrote the log.
    """
    path = header.urdf if header else ""
    if Path(path).suffix == ".xacro":
        got = f"the log names the robot description {path}; allowed there: .urdf, because a xacro file runs code"
        raise RobotError(got, advice="robot=urdf robot.path=…, if you trust that file")
    return path


def with_joints(
    load: Callable[[Sequence[str] | None], Any], joints: Sequence[str] | None, *, logged: bool = True
) -> Any:
    """The result of `load(joints)`; if names are not the URDF's, that of the URDF's joints that they match, or, if they
    are only numbers, or as many names of a log (`logged`), of all its joints: `recording.channels` says whether the
    order of the log's columns is known then."""
    try:
        return load(joints)
    except RobotError:
        if joints is None or isinstance(joints, str):
            raise
        try:
            whole = load(None)
        except RobotError:
            whole = None
        if whole is not None and tuple(joints) == numbered(len(joints)):
            return whole
        if logged and isinstance(whole, Robot) and whole.dofs == len(joints):
            return whole
        if not isinstance(whole, Robot) or not (found := matched(whole.joints, joints)):
            raise
        return load([whole.joints[k] for k in found])
