"""Measured logs as they were recorded, defects and all, and what selections name there: for `check` and `diagnose`."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from invdyn_cli.data.conditioning import ordered
from invdyn_cli.data.recorded import RealLog
from invdyn_cli.data.selection import SETS, Block, parse
from invdyn_cli.errors import LogError, UsageError, listed
from invdyn_cli.formats.reading import is_foreign, read_log
from invdyn_cli.logfile import Log
from invdyn_cli.types import Robot

Keys = Mapping[str, tuple[Path, str]]
"""What a trajectory is called in selections -> its log, and its name there."""


def keys_of(paths: Iterable[str | Path], source: RealLog) -> dict[str, tuple[Path, str]]:
    """All trajectories of one or several logs, read as `source` says: "name", or "<file stem>/<name>" of several logs.

    Raises:
        LogError: for a file that is no log.
        UsageError: for logs of one name.
    """
    files = [Path(path).expanduser() for path in paths]
    if not files or len({path.stem for path in files}) < len(files):
        raise UsageError(f"data.path={listed(map(str, files))}; allowed: one log or more, with different names")
    label = "{0.stem}/{1}" if len(files) > 1 else "{1}"
    return {label.format(path, name): (path, name) for path in files for name in source.names(path)}


def refuse_other(source: Any) -> RealLog:
    """The source, if it is a measured log."""
    if not isinstance(source, RealLog):
        got = f"data is a {type(source).__name__}"
        raise UsageError(f"{got}; allowed: a measured log", advice="data=real_log data.path=…")
    return source


def reference_files(source: RealLog, keys: Iterable[str]) -> tuple[Path, ...]:
    """The logs that data.reference names; () where it names trajectories, or nothing.

    Raises:
        UsageError: if it names both.
    """
    named = [str(one) for one in source.reference or ()]
    files = [one for one in named if one not in keys and _is_file(one)]
    if files and len(files) < len(named):
        got = f"data.reference={listed(named)}"
        raise UsageError(f"{got}; allowed: other logs, or trajectories of data.path, not both")
    return tuple(Path(one).expanduser() for one in files)


def _is_file(text: str) -> bool:
    return text.endswith((".h5", ".hdf5")) or Path(text).expanduser().is_file() or is_foreign(text)


def asked(source: Any, keys: Iterable[str], names: Sequence[str] = SETS) -> dict[str, list[Block] | None]:
    """The blocks that a source's selections of these `names` mean, None where nothing was said."""
    options = {name: getattr(source, name, None) for name in names}
    return {k: None if v is None else [parse(k, str(text), keys) for text in v] for k, v in options.items()}


def read(keys: Keys, used: Iterable[str], source: RealLog) -> list[Log]:
    """The logs of `keys`, each with those of its trajectories that are `used`, called by their keys; drive gains and
    the limit on bytes are the source's.

    Raises:
        LogError: if a log cannot be read, or logs have different joints.
    """
    used, logs = set(used), []
    paths = list(dict.fromkeys(path for path, _ in keys.values()))
    for path in paths:
        names = {name: key for key, (at, name) in keys.items() if at == path}
        chosen = [name for name, key in names.items() if key in used]
        log = read_log(path, chosen, check=False, columns=source.columns, limit=source.limit)
        if source.drive_gain is not None and log.torque_unit == "A":
            log = replace(log, drive_gain=np.asarray(source.drive_gain, float))
        gain = log.drive_gain
        if source.drive_gain is not None and gain is not None and not (np.isfinite(gain) & (gain != 0)).all():
            raise LogError(f"data.drive_gain={list(source.drive_gain)}; allowed: numbers [N m/A], none 0")
        if gain is not None and np.shape(gain) != (len(log.joints),):
            got = f"{path}: drive gains {np.asarray(gain).tolist()}"
            raise LogError(f"{got}; allowed: {len(log.joints)} numbers [N m/A], one for each joint")
        log = replace(log, trajectories=tuple(replace(raw, name=names[raw.name]) for raw in log.trajectories))
        if logs and log.joints != logs[0].joints:
            got = f"{path} has joints {listed(log.joints)}, {paths[0]} has {listed(logs[0].joints)}"
            raise LogError(f"{got}; allowed: logs of one robot")
        logs.append(log)
    return logs


def merged(logs: Sequence[Log], robot: Robot | None, notes: list[str], *, currents: bool = False) -> Log:
    """One log of all trajectories, columns in the robot's order, torques in N m where gains are known; with `currents`,
    a single log in A stays in A."""
    try:
        logs = [ordered(log, robot, notes) for log in logs]
        logs = logs if currents and len(logs) == 1 else [in_newton_metres(log) for log in logs]
    except IndexError as error:
        got = f"a channel has fewer columns than joint_names: {error}"
        raise LogError(got, advice="a column for each joint") from error
    if len({log.torque_unit for log in logs}) > 1:
        raise LogError("some logs have torques in A without drive gains", advice="data.drive_gain=[…], N m per A")
    return replace(logs[0], trajectories=tuple(raw for log in logs for raw in log.trajectories))


def in_newton_metres(log: Log) -> Log:
    """The log with currents times their drive gains; as it is where these are not known."""
    if log.torque_unit != "A" or log.drive_gain is None:
        return log
    scaled = tuple(
        replace(raw, tau=raw.tau * log.drive_gain) if raw.tau.shape[1:] == (len(log.joints),) else raw
        for raw in log.trajectories
    )
    return replace(log, torque_unit="N m", drive_gain=None, trajectories=scaled)
