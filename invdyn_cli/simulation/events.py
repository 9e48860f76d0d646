"""Events in a recording: a drive that becomes weaker, a load that is picked up, a contact.

The controller does not know of them. Times are those of the log; each step of the physics is inside a window or
outside.
"""
# pyright: reportAttributeAccessIssue=false

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from invdyn_cli.errors import UsageError, closest, listed
from invdyn_cli.simulation.arm import Body


@dataclass(frozen=True)
class Window:
    """From `start` to `end` [s] of the log, rising and falling linearly within `ramp` [s] around either."""

    start: float
    end: float
    ramp: float = 0.0

    def share(self, t: float) -> float:
        """Its weight at t [s], 0 to 1."""
        if not self.ramp:
            return float(self.start <= t < self.end)
        return float(np.clip(min(t - self.start, self.end - t) / self.ramp + 0.5, 0.0, 1.0))


@dataclass(frozen=True)
class GainChange:
    """The drive of a joint's column delivers `gain` times more in the window."""

    joint: int
    gain: float
    window: Window


@dataclass(frozen=True)
class Load:
    """A body that is there only in the window."""

    body: Body
    window: Window


@dataclass(frozen=True)
class Contact:
    """A force (3,) [N] in the base frame, at a point (3,) [m] of a joint's frame."""

    joint: int
    force: np.ndarray
    window: Window
    point: Sequence[float]


@dataclass(frozen=True)
class Events:
    """All events of one recording."""

    gains: list[GainChange] = field(default_factory=list)
    loads: list[Load] = field(default_factory=list)
    contacts: list[Contact] = field(default_factory=list)

    def __bool__(self) -> bool:
        return bool(self.gains or self.loads or self.contacts)

    def bodies(self) -> list[Body]:
        """Bodies without mass with which the arm is built: the loads, then the points of contact."""
        absent = [Body(0.0, x.body.com, x.body.radius) for x in self.loads]
        return absent + [Body(0.0, x.point, 0.0, x.joint) for x in self.contacts]


class Stage:
    """The events of one simulation, applied to its arm; mutable.

    Args:
        events: the events.
        model, data: the arm's, built with the events' bodies.
        first: how many bodies it carries beside them.
    """

    def __init__(self, events: Events, model: mujoco.MjModel, data: Any, first: int) -> None:
        self._events, self._model, self._data = events, model, data
        ids = [model.body(f"carried_{first + i}").id for i in range(len(events.loads) + len(events.contacts))]
        self._loads, self._points = ids[: len(events.loads)], ids[len(events.loads) :]
        self._scratch: Any = mujoco.MjData(model) if events.loads else None
        self._there = [0.0] * len(events.loads)

    def put(self, t: float) -> None:
        """Loads and forces for a step around t [s]."""
        there = [x.window.share(t) for x in self._events.loads]
        if there != self._there:
            self._there = there
            for body, load, share in zip(self._loads, self._events.loads, there, strict=True):
                mass = share * load.body.mass
                self._model.body_mass[body] = mass
                self._model.body_inertia[body] = 0.4 * mass * load.body.radius**2
            mujoco.mj_setConst(self._model, self._scratch)
        for body, contact in zip(self._points, self._events.contacts, strict=True):
            self._data.xfrc_applied[body, :3] = contact.window.share(t) * contact.force

    def delivered(self, torque: np.ndarray, t: float) -> np.ndarray:
        """The torque (n,) that the drives deliver in a step around t [s]."""
        for change in self._events.gains:
            if change.window.share(t):
                torque = torque.copy()
                torque[change.joint] *= change.gain
        return torque


def window_of(effect: str, value: Sequence[float], ramp: float = 0.0) -> Window:
    """The window of an effect's parameters.

    Raises:
        UsageError: for one that ends before it begins, or a ramp that is longer than it.
    """
    start, end = (float(x) for x in value)
    if not 0 <= start < end:
        got = f"{effect}: window={[start, end]}"
        raise UsageError(f"{got}; allowed: [start, end] in s, 0 <= start < end")
    if ramp > end - start:
        raise UsageError(f"{effect}: ramp={ramp:g} s; allowed: up to the length of the window, {end - start:g} s")
    return Window(start, end, ramp)


def refuse_outside(effect: str, end: float, duration: float) -> None:
    """Raise a UsageError for a window that ends at `end` [s], after the recording."""
    if end > duration:
        raise UsageError(f"{effect}: its window ends at {end:g} s; allowed: up to {duration:g} s, the recording's end")


def refuse_trajectory(effect: str, name: str | None, names: Iterable[str]) -> None:
    """Raise a UsageError for an event in a recording that is not simulated."""
    names = list(names)
    if name is not None and name not in names:
        raise UsageError(f"{effect}: no trajectory {name!r}{closest(name, names)}; allowed: {listed(names)}")
