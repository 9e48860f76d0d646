"""References of the simulated arm: motions from rest to rest, inside its joint and velocity limits."""

import abc
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy

from invdyn_cli.errors import UsageError
from invdyn_cli.types import Motion, Robot

UNLIMITED = 2.0
"""[rad] Range on both sides of zero of joints without limits."""
UNLIMITED_SLIDE = 0.5
"""[m] likewise for sliding joints."""
UNLIMITED_SPEED = 3.0
"""[rad/s] for joints without a velocity limit."""
UNLIMITED_SLIDE_SPEED = 1.0
"""[m/s] likewise for sliding joints."""


class AbstractReference(abc.ABC):
    """A way to move; its fields are shares of what the joints allow, so that it suits any arm."""

    @abc.abstractmethod
    def motion(self, robot: Robot, duration: float, rate: float, seed: int) -> Motion:
        """The motion (T, n) of `duration` [s], T = duration rate, at 0, 1/rate, …; random choices by the seed."""


@dataclass(frozen=True)
class Multisine(AbstractReference):
    """A sum of harmonics on all joints at once, with random phases and weights, faded in from rest and out again.

    Attributes:
        amplitude: share of half the joint's range that it swings to either side, at most.
        speed: share of the joint's velocity limit, at most; the stricter of the two decides.
        harmonics: their number, from the base frequency on.
        base: [Hz]; the motion repeats after 1/base seconds.
        ramp: [s] of fading in, and out.
    """

    amplitude: float = 0.6
    speed: float = 0.5
    harmonics: int = 5
    base: float = 0.1
    ramp: float = 2.0

    def __post_init__(self) -> None:
        _refuse_shares(self)
        if self.base <= 0 or self.harmonics < 1 or self.ramp <= 0:
            got = f"multisine with base={self.base}, harmonics={self.harmonics}, ramp={self.ramp}"
            raise UsageError(f"{got}; allowed: base and ramp above 0, harmonics >= 1")

    def motion(self, robot: Robot, duration: float, rate: float, seed: int) -> Motion:
        draw = np.random.default_rng(seed)
        middle, half, fastest = room(robot)
        centre = middle + draw.uniform(-1, 1, robot.dofs) * (0.95 - min(self.amplitude, 0.95)) * half
        t = np.arange(round(duration * rate)) / rate
        window = faded(t, duration, min(self.ramp, duration / 2))
        s, s1, s2 = (np.zeros((len(t), robot.dofs)) for _ in range(3))
        for k in range(1, self.harmonics + 1):
            omega = 2 * np.pi * self.base * k
            angle = omega * t[:, None] + draw.uniform(0, 2 * np.pi, robot.dofs)
            weight = draw.uniform(0.5, 1.0, robot.dofs) / k**0.5
            sine, cosine = weight * np.sin(angle), weight * np.cos(angle)
            s += sine
            s1 += omega * cosine
            s2 -= omega**2 * sine
        x, x1, x2 = times([w[:, None] for w in window], (s, s1, s2))
        scale = np.minimum(self.amplitude * half / np.abs(x).max(0), self.speed * fastest / np.abs(x1).max(0))
        return Motion(centre + scale * x, scale * x1, scale * x2)


@dataclass(frozen=True)
class PickPlace(AbstractReference):
    """Minimum-jerk moves of all joints between random postures, with rests.

    Attributes:
        amplitude: share of the joints' ranges in which the postures lie.
        speed: share of the velocity limits that the fastest joint of a move reaches.
        dwell: [s] of rest after each move.
    """

    amplitude: float = 0.6
    speed: float = 0.5
    dwell: float = 0.5

    def __post_init__(self) -> None:
        _refuse_shares(self)
        if self.dwell < 0:
            raise UsageError(f"pick_place with dwell={self.dwell}; allowed: 0 or more")

    def motion(self, robot: Robot, duration: float, rate: float, seed: int) -> Motion:
        draw = np.random.default_rng(seed)
        middle, half, fastest = room(robot)
        t = np.arange(round(duration * rate)) / rate
        here = middle + draw.uniform(-1, 1, robot.dofs) * self.amplitude * half
        q, qd, qdd = np.tile(here, (len(t), 1)), np.zeros((len(t), robot.dofs)), np.zeros((len(t), robot.dofs))
        start = self.dwell
        while True:
            there = middle + draw.uniform(-1, 1, robot.dofs) * self.amplitude * half
            takes = max(0.3, float(np.max(1.875 * np.abs(there - here) / (self.speed * fastest))))
            if start + takes > duration:
                break
            _move((q, qd, qdd), t, start, takes, here, there)
            here, start = there, start + takes + self.dwell
        if not qd.any():
            got = f"pick_place: no move ends within {duration:g} s"
            needed = f"{start + takes:.3g} s or more, {self.dwell:g} s of rest and the first move"
            raise UsageError(f"{got}; allowed: {needed}", advice="a longer duration")
        return Motion(q, qd, qdd)


STAGES = ("approach", "grasp", "place", "retract")
"""Stages of a manipulation (paper, section V-A.3)."""

POSTURES = {
    "home": (0.0, -0.3, 0.0, 0.3, 0.0, 0.2, 0.0),
    "object": (0.25, 0.2, -0.1, 0.45, 0.2, -0.15, 0.1),
    "lifted": (0.25, 0.0, -0.1, 0.6, 0.2, -0.05, 0.1),
    "target": (-0.3, 0.15, 0.15, 0.4, -0.2, 0.1, -0.15),
}
"""Shares of half the joints' ranges; an arm of more joints begins again, one of fewer leaves some out."""


@dataclass(frozen=True)
class Manipulation(AbstractReference):
    """Approach an object, grasp and lift it, carry it to a target and put it there, retract: each repetition differs a
    little.

    Attributes:
        spread: of the postures, rms [rad; m]; of the moves' durations, rms, as a share of them, three times as much.
        grasping: [s] of rest with the object and with the target in reach; hands close and open in the middle of it.
    """

    spread: float = 0.01
    grasping: float = 0.4

    def __post_init__(self) -> None:
        if self.spread < 0 or self.grasping <= 0:
            got = f"manipulation with spread={self.spread}, grasping={self.grasping}"
            raise UsageError(f"{got}; allowed: spread >= 0, grasping above 0")

    def times(self, seed: int) -> dict[str, tuple[float, float]]:
        """When each stage begins and ends, and when the hand "holds" the object [s]."""
        start, approach, lift, carry, retract = self._durations(seed)
        reached = start + approach
        lifted = reached + self.grasping + lift
        placed = lifted + carry + self.grasping
        edges = dict(zip(STAGES, pairwise((0.0, reached, lifted, placed, placed + retract)), strict=True))
        return {**edges, "holds": (reached + self.grasping / 2, placed - self.grasping / 2)}

    def motion(self, robot: Robot, duration: float, rate: float, seed: int) -> Motion:
        middle, half, _ = room(robot)
        draw = np.random.default_rng([3, seed])
        home, grasp, lifted, target = (
            middle + np.resize(shares, robot.dofs) * half + self.spread * draw.normal(size=robot.dofs)
            for shares in POSTURES.values()
        )
        rest, approach, lift, carry, retract = self._durations(seed)
        if (takes := self.times(seed)["retract"][1]) > duration:
            got = f"duration={duration:g} s, but the manipulation takes {takes:.2f} s"
            raise UsageError(f"{got}; allowed: {takes:.2f} s or more")
        t = np.arange(round(duration * rate)) / rate
        q, qd, qdd = np.tile(home, (len(t), 1)), np.zeros((len(t), robot.dofs)), np.zeros((len(t), robot.dofs))
        here, start = home, rest
        moves = (
            (grasp, approach, self.grasping),
            (lifted, lift, 0.0),
            (target, carry, self.grasping),
            (home, retract, 0.0),
        )
        for there, takes, dwell in moves:
            _move((q, qd, qdd), t, start, takes, here, there)
            here, start = there, start + takes + dwell
        return Motion(q, qd, qdd)

    def _durations(self, seed: int) -> np.ndarray:
        """Durations [s] of the first rest and the four moves."""
        draw = np.random.default_rng([4, seed])
        return np.array([0.3, 2.5, 1.3, 2.8, 1.3]) * (1 + 3 * self.spread * draw.normal(size=5))


@dataclass(frozen=True)
class ConstantSpeed(AbstractReference):
    """Each joint sweeps to one side, the other and back at several constant speeds, with smooth reversals.

    Attributes:
        speeds: shares of `speed`, swept one after the other.
        speed: share of the joint's velocity limit that stands for 1.
        amplitude: share of half the joint's range that it sweeps to either side, at most.
        together: all joints at once, each with another order of speeds; else one after the other, the others at rest.
        by_joint: one after the other, each through all speeds before the next one begins; else speed after speed.
        blend: [s] of a reversal, at most; short sweeps have shorter ones.
    """

    speeds: tuple[float, ...] = (0.05, 0.15, 0.4, 1.0)
    speed: float = 0.5
    amplitude: float = 0.6
    together: bool = False
    by_joint: bool = False
    blend: float = 0.3

    def __post_init__(self) -> None:
        _refuse_shares(self)
        object.__setattr__(self, "speeds", tuple(self.speeds))
        if not self.speeds or not all(0 < x <= 1 for x in self.speeds) or self.blend <= 0:
            got = f"constant_speed with speeds={list(self.speeds)}, blend={self.blend}"
            raise UsageError(f"{got}; allowed: speeds (shares of the top speed) above 0 up to 1, blend above 0")

    def motion(self, robot: Robot, duration: float, rate: float, seed: int) -> Motion:
        draw = np.random.default_rng(seed)
        middle, half, fastest = room(robot)
        n, slots = robot.dofs, len(self.speeds) * (1 if self.together else robot.dofs)
        t = np.arange(round(duration * rate)) / rate
        qd, qdd = np.zeros((2, len(t), n))
        each = duration / slots
        for slot in range(slots):
            turn, joint = divmod(slot, n) if not self.by_joint else divmod(slot, len(self.speeds))[::-1]
            for i in range(n) if self.together else (joint,):
                turn = (slot + i) % len(self.speeds) if self.together else turn
                v = self.speeds[turn] * self.speed * fastest[i]
                sign = draw.choice((-1.0, 1.0))
                x1, x2 = self._sweep(t - slot * each, each, v, self.amplitude * half[i])
                qd[:, i] += sign * x1
                qdd[:, i] += sign * x2
        start = middle + draw.uniform(-1, 1, n) * (0.95 - min(self.amplitude, 0.95)) * half
        way = scipy.integrate.cumulative_trapezoid(qd, dx=1 / rate, axis=0, initial=0.0)
        return Motion(start + way, qd, qdd)

    def _sweep(self, t: np.ndarray, takes: float, v: float, reach: float) -> tuple[np.ndarray, np.ndarray]:
        """Speed and acceleration of +v, -v, +v over `takes` [s] from 0 on, less where it would go beyond `reach`."""
        longest, b = takes, self.blend
        for _ in range(3):  # a shorter sweep has shorter reversals, and goes a little farther for that
            b = min(self.blend, takes / 8)
            takes = min(longest, 4 * reach / v + 2.25 * b)
        first = (takes - 3 * b) / 4  # reversals take 2 b, start and end b, and it comes back to where it began
        return changing(t, [(0.0, v, b), (first, -2 * v, 2 * b), (3 * first + b, 2 * v, 2 * b), (takes - b, -v, b)])


def room(robot: Robot) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Middle and half of each joint's range, and its highest speed, (n,) each [rad; m, and per second]."""
    lower, upper = np.asarray(robot.lower), np.asarray(robot.upper)
    bounded = np.isfinite(lower) & np.isfinite(upper)
    free = np.where(robot.prismatic, UNLIMITED_SLIDE, UNLIMITED)
    low, high = (np.where(bounded, x, 0.0) for x in (lower, upper))
    half = (high - low) / 2
    wide = ~bounded | (half > np.pi)  # a joint that turns several times need not
    middle = np.where(wide, np.clip(0.0, lower + free, upper - free), (low + high) / 2)
    speed = np.asarray(robot.velocity_limit)
    usual = np.where(robot.prismatic, UNLIMITED_SLIDE_SPEED, UNLIMITED_SPEED)
    speed = np.where(np.isfinite(speed) & (speed > 0), speed, usual)
    return middle, np.where(wide, free, half), speed


def minimum_jerk(s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Minimum jerk from 0 to 1 over s in [0, 1], constant outside; its first and second derivative by s."""
    s = np.clip(s, 0.0, 1.0)
    return s**3 * (10 - 15 * s + 6 * s**2), 30 * s**2 * (1 - s) ** 2, 60 * s * (1 - s) * (1 - 2 * s)


def changing(t: np.ndarray, changes: Sequence[tuple[float, float, float]]) -> tuple[np.ndarray, np.ndarray]:
    """A speed (T,) and its acceleration, from rest on: each change begins at a time, by so much, and takes so long."""
    speed, acceleration = np.zeros((2, len(t)))
    for at, change, long in changes:
        s, slope, _ = minimum_jerk((t - at) / long)
        speed += change * s
        acceleration += slope / long * change
    return speed, acceleration


def _move(
    motion: tuple[np.ndarray, ...], t: np.ndarray, start: float, takes: float, here: np.ndarray, there: np.ndarray
) -> None:
    """Move q, qd, qdd (T, n) from `here` to `there` from `start` on; they stay there."""
    q, qd, qdd = motion
    x, x1, x2 = minimum_jerk((t - start) / takes)
    rows = t >= start
    q[rows] = here + x[rows, None] * (there - here)
    qd[rows] = x1[rows, None] / takes * (there - here)
    qdd[rows] = x2[rows, None] / takes**2 * (there - here)


def faded(t: np.ndarray, duration: float, ramp: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A window (T,) that rises and falls over `ramp` [s], and its first and second derivative by time."""
    (a, a1, a2), (b, b1, b2) = minimum_jerk(t / ramp), minimum_jerk((duration - t) / ramp)
    return a * b, (a1 * b - a * b1) / ramp, (a2 * b - 2 * a1 * b1 + a * b2) / ramp**2


def times(a: Sequence[np.ndarray], b: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A product of two functions, each with its first and second derivative."""
    (w, w1, w2), (s, s1, s2) = a, b
    return w * s, w1 * s + w * s1, w2 * s + 2 * w1 * s1 + w * s2


def _refuse_shares(reference: AbstractReference) -> None:
    for name in ("amplitude", "speed"):
        value = getattr(reference, name)
        if not 0 < value <= 1:
            raise UsageError(f"{type(reference).__name__}: {name}={value}; allowed: above 0 up to 1")
