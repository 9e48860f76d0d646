"""An invdyn log <-> trajectories: reads and writes `invdyn-log` version 1 (HDF5), and refuses a broken one.

A log stays as it was recorded, with its jitter, gaps and defects. `read_log` refuses a file that is no log at all, and
(unless `check=False`) one whose numbers cannot be computed with, which is what `refuse_defects` decides.
"""

import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from invdyn_cli import hdf5
from invdyn_cli.errors import LogError, closest, listed, shortened
from invdyn_cli.hdf5 import Group, Stored
from invdyn_cli.log import CHANNELS, POSITION_SIDES, TORQUE_SIDES, TORQUE_UNITS, Log, RawTrajectory

FORMAT, VERSION = "invdyn-log", 1
CONVERT = "invdyn convert for csv, parquet, npz, mat and bags; docs/logs.md shows how a log is written"
HISTORY = " | "
"""Separator between the sentences of a log's history."""

LONGEST_NAME, LONGEST_TEXT = 200, 10_000
"""Largest number of characters of a name and of a note; longer ones are cut."""


def read_log(
    path: str | Path, names: Iterable[str] | None = None, *, check: bool = True, limit: float = hdf5.LIMIT
) -> Log:
    """The log at `path` with the trajectories called `names`, in that order; None: all, (): the header alone.

    Raises:
        LogError: if there is no readable log, a trajectory of that name, more than `limit` [bytes] to read, or (with
            `check`) if it has a defect.
    """
    path = Path(path)
    root, groups = _opened(path)
    chosen = list(groups) if names is None else list(names)
    for name in chosen:
        if name not in groups:
            raise LogError(f"{path}: no trajectory {name!r}{closest(name, groups)}; it has {listed(groups)}")
    log = _header(path, root)
    channels = {name: _channels(path, name, groups[name]) for name in chosen}
    for name, stored in channels.items():
        _refuse_clock(stored["t"].shape or (), f"{path}: trajectory {name!r}")
    if check:
        _refuse_header(log, str(path))
        for name, stored in channels.items():
            _refuse_shapes(len(log.joints), stored, f"{path}: trajectory {name!r}")
    wanted = [f"trajectories/{name}/{channel}" for name, stored in channels.items() for channel in stored]
    values = hdf5.read(path, wanted, LogError, limit)
    trajectories = tuple(
        _trajectory(path, name, groups[name], {c: values[f"trajectories/{name}/{c}"] for c in stored})
        for name, stored in channels.items()
    )
    log = replace(log, trajectories=trajectories)
    if check:
        refuse_defects(log, str(path))
    return log


def trajectory_names(path: str | Path) -> tuple[str, ...]:
    """The names of all trajectories in a log, without reading them; LogError as `read_log` gives."""
    return tuple(_opened(Path(path))[1])


def write_log(log: Log, path: str | Path) -> None:
    """Write a log with its defects, completely or not at all.

    Raises:
        LogError: if the file cannot be written, or the names of its trajectories cannot stand in one.
    """
    path = Path(path)
    names = [one.name for one in log.trajectories]
    for name in names:
        if not name or "/" in name or name in (".", "..") or names.count(name) > 1:
            raise LogError(f"cannot write {path}: a trajectory is named {name!r}; allowed: unique names without /")
    groups = {
        one.name: Group(
            {"payload_mass": one.payload_mass, "notes": one.notes},
            {c: _as_stored(getattr(one, c)) for c in ("t", *CHANNELS, "stage") if getattr(one, c) is not None},
        )
        for one in log.trajectories
    }
    try:
        hdf5.write(path, Group(_attributes(log, path.parent), {"trajectories": groups}))
    except OSError as error:
        got = f"cannot write {path}: {error.strerror or error}"
        raise LogError(got, advice="a writable folder, on a disk with free space") from error


def refuse_defects(log: Log, where: str = "the log") -> None:
    """Raise a LogError for the first defect of a log that makes it unusable; `where` names the log in the message."""
    _refuse_header(log, where)
    for trajectory in log.trajectories:
        _refuse_shapes(len(log.joints), vars(trajectory), f"{where}: trajectory {trajectory.name!r}")
        _refuse_values(log, trajectory, f"{where}: trajectory {trajectory.name!r}")


def _refuse_header(log: Log, where: str) -> None:
    n = len(log.joints)
    twice = [name for name in log.joints if log.joints.count(name) > 1]
    if twice or not n:
        got = f"{twice[0]!r} twice" if twice else "no names"
        raise LogError(f"{where}: joint_names has {got}; allowed: a name for each joint, each once")
    for word, value, allowed in (
        ("torque_unit", log.torque_unit, TORQUE_UNITS),
        ("torque_side", log.torque_side, TORQUE_SIDES),
        ("position_side", log.position_side, POSITION_SIDES),
    ):
        if value not in allowed:
            raise LogError(f"{where}: {word} is {value!r}; allowed: {', '.join(allowed)}")
    if not (np.isfinite(log.rate) and log.rate > 0):
        raise LogError(f"{where}: rate is {log.rate} Hz; allowed: above 0")
    gain = log.drive_gain
    if log.torque_unit == "A" and gain is None:
        raise LogError(
            f"{where}: torque_unit is 'A' and there is no drive_gain_N_m_per_A",
            advice=f"data.drive_gain=[…], {n} numbers in N m per A",
        )
    if gain is not None and (np.shape(gain) != (n,) or not np.all(np.isfinite(gain)) or np.any(np.equal(gain, 0))):
        raise LogError(f"{where}: drive gains {np.asarray(gain).tolist()}; allowed: {n} numbers [N m/A], none 0")


def _refuse_clock(shape: tuple[int, ...], where: str) -> None:
    if len(shape) != 1 or not shape[0]:
        raise LogError(f"{where}: t has shape {shape}; allowed: (T,) with at least one sample")


def _refuse_shapes(n: int, channels: Mapping[str, Any], where: str) -> None:
    """Compare the shapes of the channels (arrays, or what a file declares) with t and the number of joints."""
    _refuse_clock(np.shape(channels["t"]), where)
    samples = np.shape(channels["t"])[0]
    for channel in (*CHANNELS, "stage"):
        if channels.get(channel) is None:
            continue
        shape = np.shape(channels[channel])
        if shape[:1] != (samples,):
            raise LogError(f"{where}: {channel} has shape {shape}; allowed: {samples} rows, one for each sample of t")
        if channel != "stage" and shape[1:] != (n,):
            got = f"{where}: {channel} has shape {shape}"
            raise LogError(f"{got}; allowed: ({samples}, {n}), because joint_names has {n} names")


def _refuse_values(log: Log, trajectory: RawTrajectory, where: str) -> None:
    for channel in ("t", *CHANNELS):
        values = getattr(trajectory, channel)
        if values is None:
            continue
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            joint = f" of joint {log.joints[bad[0, 1]]}" if channel != "t" else ""
            got = f"{channel}{joint} is {values[tuple(bad[0])]} in row {bad[0, 0]}"
            raise LogError(
                f"{where}: {got}, {len(bad)} such values in {channel}; allowed: finite ones",
                advice="a log without these rows",
            )
    stuck = np.flatnonzero(np.diff(trajectory.t) <= 0)
    if len(stuck):
        row, t = stuck[0] + 1, trajectory.t
        what = "repeats" if t[row] == t[row - 1] else "runs backwards"
        raise LogError(
            f"{where}: time {what} in row {row}, from {t[row - 1]:.6g} s to {t[row]:.6g} s; {len(stuck)} such rows",
            advice="a log without these rows, or a trajectory for each part between them",
        )


def _opened(path: Path) -> tuple[Group, dict[str, Group]]:
    """The tree of a log and the groups of its trajectories, as the file declares them."""
    folder = path if path.is_dir() else path.parent
    logs = sorted(p.name for p in folder.glob("*.h5"))
    if path.is_dir():
        raise LogError(f"{path} is a folder, not an invdyn log; logs in it: {listed(logs)}", advice=CONVERT)
    if not path.exists():
        near = [p.name for p in folder.glob("*") if p.suffix.lower() == path.suffix.lower()]
        raise LogError(f"no log {path}{closest(path.name, near)}; there: {listed(sorted({*near, *logs}))}")
    if path.suffix.lower() in (".urdf", ".xacro"):
        raise LogError(f"{path} describes a robot, it is no log", advice=f"robot.path={path} data.path=…")
    if not path.is_file() or not _is_hdf5(path):
        raise LogError(f"{path} is not an HDF5 file", advice=CONVERT)
    root = hdf5.outline(path, LogError)
    kind, version = (_text(root.attributes.get(name)) or "(none)" for name in ("format", "version"))
    if kind != FORMAT:
        raise LogError(f"{path}: attribute format is {kind}; allowed: {FORMAT}", advice=CONVERT)
    if version.removesuffix(".0") != str(VERSION):
        raise LogError(f"{path}: {FORMAT} version is {version}; allowed: {VERSION}", advice="a newer invdyn")
    place = root.members.get("trajectories")
    groups = {k: v for k, v in place.members.items() if isinstance(v, Group)} if isinstance(place, Group) else {}
    if not groups:
        raise LogError(f"{path} has no trajectories; a log holds each as a group /trajectories/NAME with t, q, tau")
    for name in groups:
        if name != shortened(name, LONGEST_NAME):
            got = f"{path}: a trajectory is called {shortened(name)!r}"
            raise LogError(f"{got}; allowed: names of at most {LONGEST_NAME} printable characters")
    return root, groups


def _is_hdf5(path: Path) -> bool:
    """Whether the HDF5 signature is at one of the allowed places: 0, 512, 1024, 2048, … bytes. An unreadable file may
    be an HDF5 file."""
    try:
        with path.open("rb") as file:
            size, place = path.stat().st_size, 0
            while place < size:
                file.seek(place)
                if file.read(8) == b"\x89HDF\r\n\x1a\n":
                    return True
                place = 2 * place or 512
    except OSError as error:
        raise LogError(f"{path} cannot be read: {error.strerror or error}") from error
    return False


def _header(path: Path, root: Group) -> Log:
    """The log without its trajectories."""
    needed = ("robot", "joint_names", "torque_side", "torque_unit", "rate")
    attributes = root.attributes
    for name in needed:
        if name not in attributes:
            raise LogError(f"{path} lacks the attribute {name}; a log needs {', '.join(needed)}")
    words = ("robot", "urdf", "torque_side", "torque_unit")
    text = {name: _text(attributes.get(name)) for name in words}
    text |= {name: _text(attributes.get(name), LONGEST_TEXT) for name in ("source", "licence")}
    gain, joints = attributes.get("drive_gain_N_m_per_A"), _texts(attributes["joint_names"])
    if not joints:
        raise LogError(f"{path}: joint_names has no names; allowed: a name for each joint, each once")
    return Log(
        **text | {"urdf": str(path.parent / text["urdf"]) if text["urdf"] else ""},
        joints=joints,
        rate=_number(f"{path}: rate", attributes["rate"]),
        drive_gain=None if gain is None else _numbers(f"{path}: drive_gain_N_m_per_A", gain),
        position_side=_text(attributes.get("position_side")) or "unknown",
        compensated=_texts(attributes.get("compensated")),
        history=tuple(x for x in _text(attributes.get("history"), LONGEST_TEXT).split(HISTORY) if x),
        trajectories=(),
    )


def _channels(path: Path, name: str, group: Group) -> dict[str, Stored]:
    """The channels of a trajectory as the file declares them, without those that hold nothing."""
    where = f"{path}: trajectory {name!r}"
    found = {}
    for channel in ("t", *CHANNELS, "stage"):
        one = group.members.get(channel)
        allowed = ("number", "text") if channel == "stage" else ("number",)
        if isinstance(one, Group) or (one is not None and one.kind not in (*allowed, "empty")):
            got = "is a group" if isinstance(one, Group) else f"holds {one.kind}"
            raise LogError(f"{where}: {channel} {got}; allowed: {' or '.join(allowed).replace('number', 'numbers')}")
        if one is not None and one.kind != "empty":
            found[channel] = one
        elif channel in ("t", "q", "tau"):
            got = f"{where} lacks the dataset {channel}"
            raise LogError(f"{got}; it needs t, q, tau, and has {listed(group.members)}")
    return found


def _trajectory(path: Path, name: str, group: Group, values: Mapping[str, Any]) -> RawTrajectory:
    """A trajectory from its channels' values."""
    numbers = {c: np.asarray(x, float) for c, x in values.items() if c != "stage"}
    stage = None if (given := values.get("stage")) is None else np.asarray(given)
    if stage is not None and stage.dtype.kind == "U":
        stage = np.array([shortened(x, LONGEST_NAME) for x in stage.ravel()], object).reshape(stage.shape)
    mass = _number(f"{path}: trajectory {name!r}: payload_mass", group.attributes.get("payload_mass"))
    notes = _text(group.attributes.get("notes"), LONGEST_TEXT)
    return RawTrajectory(name=name, stage=stage, payload_mass=mass, notes=notes, **numbers)


def _attributes(log: Log, folder: Path) -> dict[str, Any]:
    words = ("robot", "torque_side", "torque_unit", "rate", "source", "licence", "position_side")
    attributes = {"format": FORMAT, "version": VERSION} | {name: getattr(log, name) for name in words}
    attributes["urdf"] = os.path.relpath(log.urdf, folder) if log.urdf else ""
    attributes["joint_names"] = list(log.joints)
    attributes["compensated"] = list(log.compensated)
    if log.history:
        attributes["history"] = HISTORY.join(log.history)
    if log.drive_gain is not None:
        attributes["drive_gain_N_m_per_A"] = np.asarray(log.drive_gain, float)
    return attributes


def _as_stored(values: Any) -> Any:
    """An array of numbers as it is, names as a list of texts."""
    values = np.asarray(values)
    return [str(x) for x in values] if values.dtype.kind in "UO" else values


def _text(stored: Stored | None, longest: int = LONGEST_NAME) -> str:
    """The first value of an attribute as text that can be printed; "" where there is none."""
    values = None if stored is None else stored.values
    return shortened(values[0], longest) if values else ""


def _texts(stored: Stored | None) -> tuple[str, ...]:
    values = None if stored is None else stored.values
    return tuple(shortened(x, LONGEST_NAME) for x in values or () if str(x))


def _numbers(what: str, stored: Stored) -> np.ndarray:
    if stored.kind != "number":
        raise LogError(f"{what} holds {stored.kind} values; allowed: numbers")
    return np.reshape(np.asarray(stored.values, float), stored.shape or ())


def _number(what: str, stored: Stored | None) -> float:
    """The first value of an attribute; NaN where there is none."""
    if stored is None or not stored.values:
        return math.nan
    return float(_numbers(what, stored).reshape(-1)[0])
