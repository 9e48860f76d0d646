"""What a diagnosis is made of, by a data source: the log as it was recorded, what it is compared with, and which
stretches choose and judge."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from invdyn_cli.data import raw
from invdyn_cli.data.conditioning import Conditioning
from invdyn_cli.data.plant import Plant
from invdyn_cli.data.recorded import RealLog
from invdyn_cli.data.selection import SETS, Block, complete, refuse_overlap
from invdyn_cli.diagnosis.columns.recording import Window
from invdyn_cli.errors import LogError, UsageError, listed
from invdyn_cli.interfaces import Progress
from invdyn_cli.logfile import CHANNELS, Log, RawTrajectory
from invdyn_cli.types import Header, Robot

UNUSED = ("derivatives", "filter_cutoff", "filter_order", "torque_lag", "decimate", "rate")
"""Options of data=real_log that make data ready to learn from: a diagnosis has a conditioning of its own."""

Windows = dict[str, list[Window]] | None


@dataclass(frozen=True)
class Material:
    """A log, the earlier one that it is compared with, the stretches by role (None: shares of time), what to know."""

    log: Log
    reference: Log | None
    windows: Windows
    notes: tuple[str, ...]


class Recorded:
    """Measured logs: read at once, put together when the robot is known."""

    def __init__(self, source: RealLog) -> None:
        Conditioning.of(source).refuse_options()
        self.source = source
        self.keys = raw.keys_of(source.path, source)
        files = raw.reference_files(source, self.keys)
        names = SETS if files else (*SETS, "reference")
        self.asked = raw.asked(source, self.keys, names)
        refuse_overlap({name: blocks or () for name, blocks in self.asked.items()})
        named = {block.key for blocks in self.asked.values() for block in blocks or ()}
        whole = self.asked["train"] is None or self.asked["test"] is None
        self.logs = raw.read(self.keys, self.keys if whole else named, source)
        keys = raw.keys_of(files, source) if files else {}
        self.earlier = raw.read(keys, keys, source) if files else []

    def header(self) -> Header:
        """Robot and joints of the logs, and the first URDF that one of them names."""
        urdf = next((log.urdf for log in (*self.logs, *self.earlier) if log.urdf), "")
        return Header(self.logs[0].robot, self.logs[0].joints, urdf)

    def material(self, robot: Robot, progress: Progress) -> Material:
        """Columns in the robot's order; the reference parted from the rest."""
        notes = [f"data.{name} is ignored in a diagnosis" for name in _set_in_vain(self.source)]
        log = raw.merged(self.logs, robot, notes, currents=True)
        reference = raw.merged(self.earlier, robot, [], currents=True) if self.earlier else None
        blocks = self.asked.get("reference")
        if blocks:
            reference = _cut(log, blocks)
            kept = {block.key for name in SETS for block in self.asked[name] or ()}
            kept |= {x.name for x in log.trajectories} - {block.key for block in blocks}
            log = replace(log, trajectories=tuple(x for x in log.trajectories if x.name in kept))
            if not log.trajectories:
                raise UsageError(
                    "data.reference names all trajectories", advice="leave some trajectories for the diagnosis"
                )
        return Material(log, reference, windows(self.asked, log, self.source.train_share), tuple(notes))


class Simulated:
    """A simulated arm: it is played when the robot is known."""

    def __init__(self, source: Plant) -> None:
        self.source = source

    def header(self) -> None:
        """Any robot will do."""

    def material(self, robot: Robot, progress: Progress) -> Material:
        """The recording."""
        log = self.source.record(robot, progress)
        asked = raw.asked(self.source, [x.name for x in log.trajectories])
        refuse_overlap({name: blocks or () for name, blocks in asked.items()})
        notes = dict.fromkeys(x.notes for x in log.trajectories if x.notes)
        return Material(log, None, windows(asked, log, self.source.train_share), tuple(notes))


def material_of(source: Any) -> Recorded | Simulated:
    """What a source brings, before its robot is known; UsageError for one that has no log."""
    if isinstance(source, Plant):
        return Simulated(source)
    return Recorded(raw.refuse_other(source))


def windows(asked: Mapping[str, Sequence[Block] | None], log: Log, train_share: float) -> Windows:
    """role -> stretches: validation joins what chooses, and trajectories that nobody named do what was not asked for.

    None where nothing was asked for: then shares of time decide.

    Raises:
        LogError: for a selection without samples, or a role without any.
    """
    blocks = {name: None if asked[name] is None else list(asked[name] or ()) for name in SETS}
    if all(blocks[name] is None for name in SETS):
        return None
    clocks = {x.name: _clock(x) for x in log.trajectories}
    made = complete(blocks | {"validation": blocks["validation"] or []}, clocks, train_share, 0.0)
    roles = {"train": [*made["train"], *made["validation"]], "test": made["test"]}
    for block in (x for parts in roles.values() for x in parts if x.asked):
        t = clocks[block.key]
        if not block.rows(t).any():
            raise LogError(f"no samples in {block}; {block.key!r} runs from {t[0]:g} s to {t[-1]:g} s")
    for role in roles:
        if not roles[role]:
            got = f"data.{role} is empty: other sets name all trajectories"
            raise LogError(got, advice=f"data.{role}=[…] of {listed(clocks)}")
    return {role: [(x.key, x.start, x.end) for x in parts] for role, parts in roles.items()}


def _clock(trajectory: RawTrajectory) -> np.ndarray:
    """What can be read of t [s], at least one number: the doctor has not seen it yet."""
    t = np.ravel(trajectory.t)
    t = t[np.isfinite(t)]
    return t if len(t) else np.zeros(1)


def _cut(log: Log, blocks: Iterable[Block]) -> Log:
    """The log with these stretches alone."""
    found, parts = {x.name: x for x in log.trajectories}, []
    for block in blocks:
        one = found[block.key]
        rows = np.flatnonzero(block.rows(np.ravel(one.t)))
        if not len(rows):
            t = _clock(one)
            raise LogError(f"no samples in {block}; {block.key!r} runs from {t[0]:g} s to {t[-1]:g} s")
        whole = np.isinf(block.start) and np.isinf(block.end)
        some = {c: getattr(one, c)[rows] for c in ("t", *CHANNELS, "stage") if getattr(one, c) is not None}
        parts.append(one if whole else replace(one, name=str(block), **some))
    return replace(log, trajectories=tuple(parts))


def _set_in_vain(source: RealLog) -> list[str]:
    own = {f.name: f.default for f in fields(source)}
    return [name for name in UNUSED if getattr(source, name) != own[name]]
