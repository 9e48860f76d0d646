"""Angles that were logged within one turn: they jump by a turn where the joint goes on."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from invdyn_cli.interfaces import AbstractCheck
from invdyn_cli.log import Log, RawTrajectory
from invdyn_cli.recording.rows import each, longest_step, present
from invdyn_cli.types import Check, Robot

POSITIONS = ("q", "q_ref", "q_link")

TURNS = (2 * np.pi, 360.0)
"""A turn in rad, and in degrees that the header calls rad."""


@dataclass(frozen=True)
class WrappedAngles(AbstractCheck):
    """Angles in (-pi, pi] or [0, 2 pi), or in degrees likewise, whose joint turns past the end of that range.

    A step between neighbouring samples counts as a jump if it is a turn but for a share of it, the steps beside it are
    as small once whole turns are taken off, and the channel never leaves one turn. Slides have none; steps across gaps
    are left alone, because a joint may turn there.

    Attributes:
        share: of a turn (ours: at 100 Hz a tenth is 63 rad/s, beyond any arm).
        beside: steps on either side that have to be so small.
        range: turns that the channel may cover (ours: rounding of the ends).
    """

    name: ClassVar[str] = "wrapped_angle"
    share: float = 0.1
    beside: int = 5
    range: float = 1.01

    def examine(self, log: Log, robot: Robot | None) -> list[Check]:
        """Per trajectory, channel and joint; the value is the number of jumps."""
        return [
            self._seen(raw, channel, log.joints[j], rows)
            for raw in log.trajectories
            for channel, j, rows, _ in self._wrapped(log, raw, robot)
        ]

    def _seen(self, raw: RawTrajectory, channel: str, joint: str, rows: np.ndarray) -> Check:
        times, at = "once" if len(rows) == 1 else f"{len(rows)} times", raw.t[rows[0]]
        return Check(
            self.name,
            "fail",
            raw.name,
            joint,
            value=len(rows),
            threshold={"channel": channel, "share": self.share},
            seen=f"{channel} jumps by one turn {times} from one sample to the next, first at t = {at:.3f} s",
            meaning="the angle was logged modulo one turn, but the joint turned further",
            advice="a logger that counts turns",
            source="own choice: a tenth of a turn from sample to sample is faster than any arm",
        )

    def correct(self, log: Log, found: Sequence[Check], robot: Robot | None) -> tuple[Log, list[str]]:
        """Whole turns added after each jump; commands and link angles are put beside the measured angle. A joint with
        limits is moved by whole turns to where they are."""
        notes = []

        def change(raw: RawTrajectory) -> RawTrajectory:
            made = {c: np.array(x, float) for c, x in present(raw).items() if c in POSITIONS}
            turns: dict[int, float] = {}
            for channel, j, rows, turn in self._wrapped(log, raw, robot):
                turns[j] = turn
                if channel == "q":
                    made["q"][:, j] = _unwrapped(made["q"][:, j], rows, turn)
                    if robot is not None and turn == TURNS[0]:
                        made["q"][:, j] += turn * _turns_to(made["q"][:, j], robot, j)
                jumps = "1 jump" if len(rows) == 1 else f"{len(rows)} jumps"
                notes.append(f"{raw.name}: {channel} of {log.joints[j]} made continuous, {jumps} of one turn undone")
            for j, turn in turns.items():
                for channel in set(made) - {"q"}:
                    made[channel][:, j] += turn * np.round((made["q"][:, j] - made[channel][:, j]) / turn)
            return replace(raw, **made)

        return each(log, change, {c.trajectory for c in found}), notes

    def _wrapped(
        self, log: Log, raw: RawTrajectory, robot: Robot | None
    ) -> Iterator[tuple[str, int, np.ndarray, float]]:
        """(channel, joint, rows behind a jump, a turn) of every angle that was logged within one turn."""
        steps = np.diff(raw.t)
        near = steps <= longest_step(steps)
        for channel in POSITIONS:
            x = getattr(raw, channel)
            if x is None or np.shape(x) != (len(raw.t), len(log.joints)):
                continue
            for j in range(len(log.joints)):
                if robot is not None and robot.prismatic[j]:
                    continue
                for turn in TURNS:
                    rows = self.jumps(x[:, j], near, turn)
                    if len(rows):
                        yield channel, j, rows, turn
                        break

    def jumps(self, x: np.ndarray, near: np.ndarray, turn: float) -> np.ndarray:
        """Rows of an angle x (T,) behind a jump of a turn; `near` (T - 1,) tells steps without a gap."""
        if len(x) < 2 * self.beside or np.ptp(x) > self.range * turn or np.ptp(x) < (1 - self.share) * turn:
            return np.arange(0)
        steps = np.diff(x)
        rest = np.abs(steps - turn * np.round(steps / turn))
        padded = np.pad(np.where(near, rest, 0.0), self.beside)
        largest = np.lib.stride_tricks.sliding_window_view(padded, 2 * self.beside + 1).max(1)
        return np.flatnonzero(near & (np.abs(np.round(steps / turn)) == 1) & (largest < self.share * turn)) + 1


def _unwrapped(x: np.ndarray, rows: np.ndarray, turn: float) -> np.ndarray:
    """x (T,) with whole turns added from each of these rows on, so that it goes on there."""
    steps = np.zeros(len(x))
    steps[rows] = -np.round((x[rows] - x[rows - 1]) / turn)
    return x + turn * np.cumsum(steps)


def _turns_to(x: np.ndarray, robot: Robot, joint: int) -> float:
    """The whole turns that bring the middle of x (T,) [rad] nearest to that of a joint's limits; 0 without limits."""
    middle = (float(robot.lower[joint]) + float(robot.upper[joint]) - np.min(x) - np.max(x)) / 2
    return float(np.round(middle / TURNS[0])) if np.isfinite(middle) else 0.0
