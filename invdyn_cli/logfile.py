"""An invdyn log <-> trajectories: reads and writes `invdyn-log` version 1 (HDF5), and refuses a broken one.

A log stays as it was recorded, with its jitter, gaps and defects. `read_log` refuses a file that is no log at all, and
(unless `check=False`) one whose numbers cannot be computed with, which is what `refuse_defects` decides.
"""

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from invdyn_cli.errors import LogError, closest, listed

FORMAT, VERSION = "invdyn-log", 1
TORQUE_UNITS = ("N m", "A")
TORQUE_SIDES = ("link", "motor", "command", "unknown")
POSITION_SIDES = ("motor", "link", "unknown")
CHANNELS = ("q", "tau", "qd", "qdd", "q_ref", "q_link")
CONVERT = "docs/logs.md shows how a log is written"


@dataclass(frozen=True)
class RawTrajectory:
    """One trajectory as logged, torques at their own t, nothing shifted, filtered or resampled.

    Attributes:
        name: its name in the log.
        t: (T,) [s].
        q, qd, qdd: (T, n) [rad; m], and per second; None where not logged.
        tau: (T, n) in the log's torque unit.
        q_ref, q_link: (T, n) [rad; m] commanded, and measured behind the gear; None where not logged.
        stage: (T,) names or numbers of stages, None where there are none.
        payload_mass: [kg], NaN if unknown.
        notes: what the reader should know.
    """

    name: str
    t: np.ndarray
    q: np.ndarray
    tau: np.ndarray
    qd: np.ndarray | None = None
    qdd: np.ndarray | None = None
    q_ref: np.ndarray | None = None
    q_link: np.ndarray | None = None
    stage: np.ndarray | None = None
    payload_mass: float = float("nan")
    notes: str = ""


@dataclass(frozen=True)
class Log:
    """A recording of one robot with n joints: the words of DESIGN's log format, and its trajectories.

    `urdf` is a path that can be opened from here ("": none); `rate` [Hz] is nominal; `drive_gain` (n,) [N m/A] turns
    torques in "A" into "N m" (None: not known); `compensated` names effects that the torque already has taken out.
    """

    robot: str
    joints: tuple[str, ...]
    torque_side: str
    torque_unit: str
    rate: float
    trajectories: tuple[RawTrajectory, ...]
    urdf: str = ""
    drive_gain: np.ndarray | None = None
    source: str = ""
    licence: str = ""
    position_side: str = "unknown"
    compensated: tuple[str, ...] = ()


def read_log(path: str | Path, names: Iterable[str] | None = None, *, check: bool = True) -> Log:
    """The log at `path` with the trajectories called `names`, in that order; None: all, (): the header alone.

    Raises:
        LogError: if there is no readable log, a trajectory of that name, or (with `check`) if it has a defect.
    """
    path = Path(path)
    with _opened(path) as file:
        groups = _groups(path, file)
        chosen = list(groups) if names is None else list(names)
        for name in chosen:
            if name not in groups:
                raise LogError(f"{path}: no trajectory {name!r}{closest(name, groups)}; it has {listed(groups)}")
        log = _header(path, file, tuple(_trajectory(path, name, groups[name]) for name in chosen))
    if check:
        refuse_defects(log, str(path))
    return log


def trajectory_names(path: str | Path) -> tuple[str, ...]:
    """The names of all trajectories in a log, without reading them; LogError as `read_log` gives."""
    with _opened(Path(path)) as file:
        return tuple(_groups(Path(path), file))


def write_log(log: Log, path: str | Path) -> None:
    """Write a log, defects and all; written aside and renamed, so that `path` never holds half a log.

    Raises:
        LogError: if the file cannot be written.
    """
    path = Path(path)
    aside = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with h5py.File(aside, "w") as file:
            file.attrs.update(_attributes(log, path.parent))
            for trajectory in log.trajectories:
                group = file.create_group(f"trajectories/{trajectory.name}")
                group.attrs.update(payload_mass=trajectory.payload_mass, notes=trajectory.notes)
                for channel in ("t", *CHANNELS, "stage"):
                    values = getattr(trajectory, channel)
                    if values is not None:
                        _store(group, channel, np.asarray(values))
        aside.replace(path)
    except (OSError, ValueError) as error:
        raise LogError(f"cannot write {path}: {error}", advice="a folder that exists and can be written") from error
    finally:
        aside.unlink(missing_ok=True)


def refuse_defects(log: Log, where: str = "the log") -> None:
    """Raise a LogError on the first thing in a log that cannot be computed with; `where` names the log in it."""
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
    for trajectory in log.trajectories:
        _refuse_shapes(log, trajectory, f"{where}: trajectory {trajectory.name!r}")
        _refuse_values(log, trajectory, f"{where}: trajectory {trajectory.name!r}")


def _refuse_shapes(log: Log, trajectory: RawTrajectory, where: str) -> None:
    if np.ndim(trajectory.t) != 1 or not np.size(trajectory.t):
        raise LogError(f"{where}: t has shape {np.shape(trajectory.t)}; allowed: (T,) with at least one sample")
    samples, n = len(trajectory.t), len(log.joints)
    for channel in (*CHANNELS, "stage"):
        shape = np.shape(getattr(trajectory, channel))
        if getattr(trajectory, channel) is None:
            continue
        if shape[:1] != (samples,):
            raise LogError(f"{where}: {channel} has shape {shape}, t has {samples} rows; allowed: as many")
        if channel != "stage" and shape[1:] != (n,):
            raise LogError(f"{where}: {channel} has shape {shape}; allowed: ({samples}, {n}), as joint_names has {n}")


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
            advice="a log without these rows, or with the parts between as trajectories",
        )


@contextmanager
def _opened(path: Path) -> Iterator[h5py.File]:
    """An open HDF5 file; whatever h5py finds wrong on opening or reading becomes a LogError."""
    folder = path if path.is_dir() else path.parent
    logs = sorted(p.name for p in folder.glob("*.h5"))
    if path.is_dir():
        raise LogError(f"{path} is a folder, not an invdyn log; logs in it: {listed(logs)}", advice=CONVERT)
    if not path.exists():
        raise LogError(f"no log {path}{closest(path.name, logs)}; logs in that folder: {listed(logs)}")
    try:
        with h5py.File(path, "r") as file:
            yield file
    except (OSError, RuntimeError, KeyError) as error:
        if os.access(path, os.R_OK) and not h5py.is_hdf5(path):
            raise LogError(f"{path} is not an HDF5 file", advice=CONVERT) from error
        raise LogError(f"{path} is cut off or corrupt, HDF5 says: {error}", advice="a new copy of it") from error


def _groups(path: Path, file: h5py.File) -> dict[str, h5py.Group]:
    kind, version = (_text(file.attrs.get(name, "(none)")) for name in ("format", "version"))
    if kind != FORMAT:
        raise LogError(f"{path}: attribute format is {kind}; allowed: {FORMAT}", advice=CONVERT)
    if version.removesuffix(".0") != str(VERSION):
        raise LogError(f"{path}: {FORMAT} version is {version}; allowed: {VERSION}", advice="a newer invdyn")
    root = file.get("trajectories")
    groups = {k: v for k, v in root.items() if isinstance(v, h5py.Group)} if isinstance(root, h5py.Group) else {}
    if not groups:
        raise LogError(f"{path} has no trajectories; a log holds each as a group /trajectories/NAME with t, q, tau")
    return groups


def _header(path: Path, file: h5py.File, trajectories: tuple[RawTrajectory, ...]) -> Log:
    needed = ("robot", "joint_names", "torque_side", "torque_unit", "rate")
    for name in needed:
        if name not in file.attrs:
            raise LogError(f"{path} lacks the attribute {name}; a log needs {', '.join(needed)}")
    words = ("robot", "urdf", "torque_side", "torque_unit", "source", "licence")
    text = {name: _text(file.attrs.get(name, "")) for name in words}
    gain = file.attrs.get("drive_gain_N_m_per_A")
    return Log(
        **text | {"urdf": str(path.parent / text["urdf"]) if text["urdf"] else ""},
        joints=_texts(file.attrs["joint_names"]),
        rate=float(_numbers(f"{path}: rate", file.attrs["rate"]).reshape(-1)[0]),
        drive_gain=None if gain is None else _numbers(f"{path}: drive_gain_N_m_per_A", gain),
        position_side=_text(file.attrs.get("position_side", "unknown")) or "unknown",
        compensated=_texts(file.attrs.get("compensated", ())),
        trajectories=trajectories,
    )


def _trajectory(path: Path, name: str, group: Any) -> RawTrajectory:
    where = f"{path}: trajectory {name!r}"
    for channel in ("t", "q", "tau"):
        if not isinstance(group.get(channel), h5py.Dataset):
            raise LogError(f"{where} lacks the dataset {channel}; it needs t, q, tau, and has {listed(group)}")
    numbers = {c: _numbers(f"{where}: {c}", group[c][()]) for c in ("t", *CHANNELS) if c in group}
    stage = group.get("stage")
    if stage is not None:
        stage = stage.asstr()[()] if h5py.check_string_dtype(stage.dtype) else stage[()]
    mass = _numbers(f"{where}: payload_mass", group.attrs.get("payload_mass", np.nan)).reshape(-1)[0]
    notes = _text(group.attrs.get("notes", ""))
    return RawTrajectory(name=name, stage=stage, payload_mass=float(mass), notes=notes, **numbers)


def _attributes(log: Log, folder: Path) -> dict:
    words = ("robot", "torque_side", "torque_unit", "rate", "source", "licence", "position_side")
    attributes = {"format": FORMAT, "version": VERSION} | {name: getattr(log, name) for name in words}
    attributes["urdf"] = os.path.relpath(log.urdf, folder) if log.urdf else ""
    attributes["joint_names"] = np.array(log.joints, h5py.string_dtype())
    attributes["compensated"] = np.array(log.compensated, h5py.string_dtype())
    if log.drive_gain is not None:
        attributes["drive_gain_N_m_per_A"] = np.asarray(log.drive_gain, float)
    return attributes


def _store(group: h5py.Group, name: str, values: np.ndarray) -> None:
    """A number column, compressed without loss; or names, as variable-length text."""
    if values.dtype.kind in "UO":
        values = values.astype(h5py.string_dtype())
    group.create_dataset(name, data=values, **({"compression": "gzip", "shuffle": True} if values.size else {}))


def _text(value: Any) -> str:
    value = np.asarray(value).reshape(-1)[0] if np.size(value) else ""
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


def _texts(values: Any) -> tuple[str, ...]:
    return tuple(_text(value) for value in np.atleast_1d(np.asarray(values)) if _text(value))


def _numbers(what: str, values: Any) -> np.ndarray:
    try:
        return np.asarray(values, float)
    except (TypeError, ValueError) as error:
        raise LogError(f"{what} holds {np.asarray(values).dtype} values; allowed: numbers") from error
