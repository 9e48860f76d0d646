"""The column map: which columns of a file are which channels of a log, in which units and signs, and how that is known.

A map may be partial: `guess.complete` guesses missing entries or asks for them. `log_from` applies a complete one.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from invdyn_cli.errors import LogError, UsageError, closest, listed, shortened
from invdyn_cli.formats.table import Table
from invdyn_cli.formats.units import CURRENTS, TIME, factor
from invdyn_cli.log import CHANNELS, Log, RawTrajectory
from invdyn_cli.logfile import LONGEST_NAME

NONE = "none"
"""In place of the columns of a channel: the file does not contain this channel."""

GIVEN = "given"


@dataclass(frozen=True)
class Channel:
    """Where a channel of n joints comes from.

    Attributes:
        columns: names, one for each joint in order; "first:last" stands for a range, an array's name for its columns.
        unit: one for all joints, or one for each; () not said.
        sign: 1 or -1 likewise; () all 1.
        full_scale: [N m] at 100 percent likewise, for `tau` in percent; () not known.
    """

    columns: tuple[str, ...] = ()
    unit: tuple[str, ...] = ()
    sign: tuple[int, ...] = ()
    full_scale: tuple[float, ...] = ()


@dataclass(frozen=True)
class ColumnMap:
    """What a file's columns mean, and the attributes of its log. Empty values are not given.

    Attributes:
        channels: by the log's name: "t", "q", "tau", "qd", "qdd", "q_ref", "q_link".
        joints: names, in the order of the columns.
        robot, urdf, torque_side, position_side, source, licence: as in a log; `urdf` can be opened from here.
        rate: [Hz] nominal; without a clock, that of the rows.
        drive_gain: [N m/A] one for each joint.
        topic: of a bag.
        known: how each entry is known, by "q", "q.unit", "torque_side", …: GIVEN, or a phrase "guessed from …".
        notes: sentences on what was left out or is doubtful.
    """

    channels: Mapping[str, Channel] = field(default_factory=dict)
    joints: tuple[str, ...] = ()
    robot: str = ""
    urdf: str = ""
    rate: float | None = None
    torque_side: str = ""
    position_side: str = ""
    drive_gain: tuple[float, ...] = ()
    source: str = ""
    licence: str = ""
    topic: str = ""
    known: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def channel(self, name: str) -> Channel:
        """A channel; an empty one if the map does not mention it."""
        return self.channels.get(name, Channel())


def numbered(n: int) -> tuple[str, ...]:
    """Names of joints that a file does not name."""
    return tuple(f"joint_{k}" for k in range(1, n + 1))


def expanded(where: str, table: Table, names: Sequence[str]) -> tuple[str, ...]:
    """The columns that `names` mean in a table: themselves, ranges "first:last", the columns of an array.

    Raises:
        LogError: for a name that the table does not have.
    """
    order, out = list(table.columns), []
    for name in names:
        first, _, last = name.partition(":")
        array = [x for x in order if x.rpartition("/")[0] == name]
        if name in order:
            out.append(name)
        elif first in order and last in order:
            out += order[order.index(first) : order.index(last) + 1]
        elif array:
            out += array
        else:
            got = f"{where}: no column {name!r}{closest(name, order)}"
            raise LogError(f"{got}; allowed: {listed(order, most=40)}, or a range first:last of them")
    return tuple(out)


def log_from(where: str, tables: Sequence[Table], columns: ColumnMap) -> Log:
    """The log of tables with the same columns, a trajectory each; t starts at 0.

    Raises:
        LogError: if a table lacks a column, or counts of columns differ from that of the joints.
        UsageError: for counts of units, signs or gains that differ from it.
    """
    trajectories = tuple(_trajectory(f"{where}: {table.name}", table, columns) for table in tables)
    rate = columns.rate or _measured_rate(trajectories[0].t)
    tau = columns.channel("tau")
    current = bool(set(tau.unit) & set(CURRENTS)) and not tau.full_scale
    if current and not set(tau.unit) <= set(CURRENTS):
        raise UsageError(f"tau.unit={list(tau.unit)}; allowed: torques on all joints, or currents on all joints")
    if columns.drive_gain and not current:
        raise UsageError("drive_gain is given, but tau is not a current", advice="tau.unit=A")
    gain = each("drive_gain", columns.drive_gain, len(columns.joints)) if columns.drive_gain else None
    return Log(
        robot=columns.robot or "robot",
        joints=columns.joints,
        torque_side=columns.torque_side or "unknown",
        torque_unit="A" if current else "N m",
        rate=rate,
        trajectories=trajectories,
        urdf=columns.urdf,
        drive_gain=None if gain is None else np.array(gain),
        source=columns.source or Path(where).name,
        licence=columns.licence,
        position_side=columns.position_side or "unknown",
        history=(f"converted from {Path(where).name}", *columns.notes),
    )


def seconds(where: str, table: Table, columns: ColumnMap) -> np.ndarray:
    """The clock (T,) [s] from 0: of the map's column, or of its rate.

    Raises:
        LogError: if the map says neither.
    """
    t = columns.channel("t")
    rows = len(next(iter(table.columns.values())))
    if t.columns in ((), (NONE,)):
        if not columns.rate:
            raise LogError(f"{where}: no clock; allowed: time.column=NAME, or rate=HZ of the rows")
        return np.arange(rows) / columns.rate
    values = table.columns[expanded(where, table, t.columns)[0]]
    return (values - values[0]) * TIME[t.unit[0]]


def _trajectory(where: str, table: Table, columns: ColumnMap) -> RawTrajectory:
    t = seconds(where, table, columns)
    n = len(columns.joints)
    made = {name: _values(where, table, columns, name) for name in CHANNELS if columns.channel(name).columns}
    made = {name: x for name, x in made.items() if x is not None}
    tau = made.pop("tau", np.full((len(t), n), np.nan))
    name, notes = shortened(table.name.replace("/", "."), LONGEST_NAME), " ".join(table.notes)
    return RawTrajectory(name, t, made.pop("q"), tau, notes=notes, **made)  # pyright: ignore[reportArgumentType]


def _values(where: str, table: Table, columns: ColumnMap, name: str) -> np.ndarray | None:
    """A channel (T, n) in the log's unit; None where the map says that there is none."""
    one, n = columns.channel(name), len(columns.joints)
    if one.columns == (NONE,):
        return None
    found = expanded(where, table, one.columns)
    if len(found) != n:
        got = f"{where}: {name}.columns are {len(found)} ({listed(found)})"
        raise LogError(f"{got}; allowed: {n}, one for each joint: {listed(columns.joints)}")
    factors = np.array([factor(name, unit) for unit in each(f"{name}.unit", one.unit, n)])
    factors = factors * np.array(each(f"{name}.sign", one.sign or (1,), n))
    if one.full_scale:
        factors = factors * np.array(each(f"{name}.full_scale", one.full_scale, n)) / 100
    return np.column_stack([table.columns[column] for column in found]).astype(float) * factors


def each(option: str, values: Sequence, n: int) -> tuple:
    """One value for each of n joints, from one for all or one for each; UsageError for another count."""
    if len(values) not in (1, n):
        raise UsageError(f"{option} has {len(values)} values; allowed: 1, or {n}, one for each joint")
    return tuple(values) * (n if len(values) == 1 else 1)


def _measured_rate(t: np.ndarray) -> float:
    """[Hz] of the median step, with four digits."""
    steps = np.diff(t)
    steps = steps[steps > 0]
    return float(f"{1 / np.median(steps):.4g}") if len(steps) else 1.0
