"""The motions that a design chooses from: gestures that begin and end at rest in one posture, and how they are joined.

A gesture is about two seconds long, so that many fit into a recording and every block of it contains information. Its
kinds distinguish causes: multisines (Swevers et al. 1997) for bodies; sweeps at constant speeds for friction; reversals
of milliradians, slow and fast, with and without load, for bristles and play; small swings for what is between; chirps
for delays and compliance.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from invdyn_cli.simulation.references import changing, faded, minimum_jerk, room, times
from invdyn_cli.types import Motion, Robot

KINDS = ("multisine", "sweep", "swing", "reversal", "chirp")

OFTEN = (0.28, 0.24, 0.13, 0.2, 0.15)
"""Shares of the kinds among random gestures."""

MARGIN = 0.06
"""Share of half a joint's range that is kept from its limits."""

FASTEST = 0.6
"""Share of the velocity limits."""

STRONGEST = 0.8
"""Share of the effort limits that the nominal torque may take: hidden effects need the rest."""

ACCELERATION = 6.0
"""[1/s] Acceleration of a joint over its velocity limit: most joints reach their highest speed in 0.1 to 0.3 s."""

SLOWEST_SWEEP, SLOWEST_SWING = 0.006, 0.002
"""Lowest speed of a sweep [rad/s; m/s]: below, a joint counts as resting. Smallest swing [rad; m]."""

SMALLEST_REVERSAL, LARGEST_REVERSAL = 0.001, 0.03
"""[rad; m] Distance between two reversals; bristles bend and the play of a gear opens over shorter distances."""

FASTEST_REVERSAL = 4.0
"""[Hz] of a way forth and back."""

HIGHEST_CHIRP = 8.0
"""[Hz] Far above, a usual controller does not follow a reference. Chirps are smaller the higher they are: each of their
frequencies has what the joint's limits allow."""

LOADED = 0.4, 0.8
"""Share of the small gestures with almost no load on the joint; up to the second number, with a large load; the rest
anywhere."""

MOVE = 1.875
"""Highest speed of a minimum-jerk move, times its mean speed."""

SHORTEST_MOVE = 0.5
"""[s] of a move from posture to posture."""


@dataclass(frozen=True)
class Gesture:
    """A motion that begins and ends at rest in a posture.

    Attributes:
        kind: one of KINDS.
        centre: (n,) the posture [rad; m].
        size: (n,) largest excursion of each joint from it [rad; m]; 0: the joint holds.
        numbers: (n, 12) phases, weights and speeds, drawn between 0 and 1: what each kind makes of them, it says.
        seconds: [s] it takes.
    """

    kind: str
    centre: np.ndarray
    size: np.ndarray
    numbers: np.ndarray
    seconds: float


@dataclass(frozen=True)
class Room:
    """What a joint may do: positions (n,), speeds, accelerations, and the nominal torque."""

    lower: np.ndarray
    upper: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    torque: np.ndarray


@dataclass(frozen=True)
class Postures:
    """Random postures q (n, K), and the torques (n, K) [N m; N] that hold them."""

    q: np.ndarray
    load: np.ndarray

    def of(self, draw: np.random.Generator, joint: int) -> np.ndarray | None:
        """A posture (n,) in which a joint bears almost no load, or a large one; None: any posture."""
        style, some = draw.random(), draw.choice(self.q.shape[1], max(1, self.q.shape[1] // 8), replace=False)
        load = np.abs(self.load[joint, some])
        if style < LOADED[0]:
            return self.q[:, some[np.argmin(load)]]
        return self.q[:, some[np.argmax(load)]] if style < LOADED[1] else None


def room_of(robot: Robot, strongest: np.ndarray) -> Room:
    """The limits within which a design stays; `strongest` (n,) [N m; N] is used where a joint has no effort limit."""
    middle, half, speed = room(robot)
    effort = np.asarray(robot.effort_limit)
    effort = np.where(np.isfinite(effort) & (effort > 0), STRONGEST * effort, strongest)
    inner = (1 - MARGIN) * half
    return Room(middle - inner, middle + inner, FASTEST * speed, ACCELERATION * speed, np.minimum(effort, strongest))


def drawn(
    draw: np.random.Generator, allowed: Room, joints: Sequence[int], seconds: float, postures: Postures
) -> Gesture:
    """A random gesture that moves some of these joints, or the whole arm."""
    n = len(allowed.lower)
    kind = str(draw.choice(KINDS, p=OFTEN))
    moved = np.zeros(n, bool)
    style = draw.random()
    if style < 0.4:
        moved[:] = True
    elif style < 0.7 or len(joints) == 1:
        moved[draw.choice(list(joints))] = True
    else:
        moved[list(joints)] = True
    reach = (allowed.upper - allowed.lower) / 2
    if kind == "reversal":
        size = np.exp(draw.uniform(np.log(SMALLEST_REVERSAL), np.log(LARGEST_REVERSAL), n)) * moved
    else:
        largest = {"multisine": 0.9, "sweep": 0.9, "swing": 0.06, "chirp": 0.15}[kind]
        size = largest * reach * np.exp(draw.uniform(np.log(0.1), 0.0, n)) * moved
    made = placed(Gesture(kind, np.zeros(n), size, draw.random((n, 12)), seconds), allowed, draw)
    at = postures.of(draw, int(draw.choice(list(joints)))) if kind in ("reversal", "swing") else None
    return made if at is None else _moved_to(made, at, allowed)


def placed(gesture: Gesture, allowed: Room, draw: np.random.Generator) -> Gesture:
    """The gesture in another posture where the limits allow it."""
    size = np.minimum(gesture.size, (allowed.upper - allowed.lower) / 2)
    low, high = allowed.lower + size, allowed.upper - size
    return replace(gesture, size=size, centre=draw.uniform(low, np.maximum(high, low)))


def _moved_to(gesture: Gesture, centre: np.ndarray, allowed: Room) -> Gesture:
    """The gesture in this posture, or in the nearest one where the limits allow it."""
    low, high = allowed.lower + gesture.size, allowed.upper - gesture.size
    return replace(gesture, centre=np.clip(centre, low, np.maximum(high, low)))


def varied(gesture: Gesture, allowed: Room, draw: np.random.Generator) -> Gesture:
    """A gesture like this one with one feature drawn anew."""
    feature = draw.integers(3)
    small = gesture.kind in ("reversal", "swing")  # their posture is what they were chosen for
    if feature == 0 and small:
        step = draw.normal(0, 0.05, len(gesture.size)) * (allowed.upper - allowed.lower)
        return _moved_to(gesture, gesture.centre + step, allowed)
    if feature == 0:
        return placed(gesture, allowed, draw)
    if feature == 1:
        size = gesture.size * np.exp(draw.normal(0, 0.5, len(gesture.size)))
        other = replace(gesture, size=np.minimum(size, (allowed.upper - allowed.lower) / 2))
        return _moved_to(other, gesture.centre, allowed) if small else placed(other, allowed, draw)
    again = draw.random(gesture.numbers.shape) < 0.3
    return replace(gesture, numbers=np.where(again, draw.random(gesture.numbers.shape), gesture.numbers))


def motion_of(gesture: Gesture, allowed: Room, rate: float) -> Motion:
    """The gesture's motion (n, T) at 0, 1/rate, … up to its end, slowed or made smaller until speed and acceleration
    have room."""
    count = max(8, round(gesture.seconds * rate))
    t = np.arange(count + 1) / rate
    takes = count / rate
    shapes = {"multisine": _multisine, "sweep": _sweep, "swing": _swing, "reversal": _reversal, "chirp": _chirp}
    x, x1, x2 = shapes[gesture.kind](gesture, allowed, t, takes)
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = _share(gesture.size, x), _share(allowed.speed, x1), _share(allowed.acceleration, x2)
        scale = np.minimum(1.0, np.min(shares, axis=0))
    scale = np.where(gesture.size > 0, scale, 0.0)[:, None]
    return Motion(gesture.centre[:, None] + scale * x, scale * x1, scale * x2)


def joined(
    gestures: Sequence[Gesture], allowed: Room, start: np.ndarray, rate: float, end: np.ndarray | None = None
) -> Motion:
    """All gestures one after the other (n, T), with minimum-jerk moves from posture to posture: from `start` (n,), and
    on to `end` where there is one."""
    parts, here = [], start
    for gesture in gestures:
        parts += [moved(here, gesture.centre, allowed, rate), motion_of(gesture, allowed, rate)]
        here = gesture.centre
    if end is not None:
        parts.append(moved(here, end, allowed, rate))
        here = end
    still = np.zeros((len(here), 1))
    each = [*(Motion(p.q[:, :-1], p.qd[:, :-1], p.qdd[:, :-1]) for p in parts), Motion(here[:, None], still, still)]
    return Motion(*(np.concatenate([getattr(p, x) for p in each], axis=1) for x in ("q", "qd", "qdd")))


def moved(here: np.ndarray, there: np.ndarray, allowed: Room, rate: float) -> Motion:
    """A minimum-jerk move (n, T) between postures, both ends included."""
    count = round(seconds_between(here, there, allowed) * rate)
    s = np.arange(count + 1) / count
    takes = count / rate
    x, x1, x2 = minimum_jerk(s)
    way = (there - here)[:, None]
    return Motion(here[:, None] + way * x, way * x1 / takes, way * x2 / takes**2)


def seconds_between(here: np.ndarray, there: np.ndarray, allowed: Room) -> float:
    """[s] that a move takes: at nine tenths of the speed and half of the acceleration that a gesture may have."""
    way = np.abs(there - here)
    by_speed = np.max(MOVE * way / (0.9 * allowed.speed))
    by_acceleration = np.max(np.sqrt(5.8 * way / (0.5 * allowed.acceleration)))
    return float(max(SHORTEST_MOVE, by_speed, by_acceleration))


def _share(limit: np.ndarray, x: np.ndarray) -> np.ndarray:
    largest = np.abs(x).max(axis=1)
    return np.where(largest > 0, limit / np.where(largest > 0, largest, 1.0), np.inf)


def _multisine(g: Gesture, allowed: Room, t: np.ndarray, takes: float):
    """Harmonics one to four of 1 / seconds; numbers: four weights, four phases."""
    s, s1, s2 = (np.zeros((len(g.size), len(t))) for _ in range(3))
    for k in range(1, 5):
        omega = 2 * np.pi * k / takes
        angle = omega * t + 2 * np.pi * g.numbers[:, 3 + k : 4 + k]
        weight = g.numbers[:, k - 1 : k] / k
        s += weight * np.sin(angle)
        s1 += weight * omega * np.cos(angle)
        s2 -= weight * omega**2 * np.sin(angle)
    x, x1, x2 = times(faded(t, takes, 0.3 * takes), (s, s1, s2))
    grown = g.size / np.maximum(np.abs(x).max(axis=1), 1e-12)
    return tuple(grown[:, None] * y for y in (x, x1, x2))


def _sweep(g: Gesture, allowed: Room, t: np.ndarray, takes: float):
    """One way and back at constant speed, one to three times; numbers: speed in the logarithm between the slowest and
    the fastest, times, sign."""
    fastest = np.minimum(allowed.speed, np.maximum(2 * g.size / takes, SLOWEST_SWEEP) * 6)
    v = SLOWEST_SWEEP * (np.maximum(fastest / SLOWEST_SWEEP, 1.0)) ** g.numbers[:, 0]
    out = np.zeros((3, len(g.size), len(t)))
    for j in np.flatnonzero(g.size > 0):
        least = v[j] * takes / (2 * max(g.size[j], 1e-9))  # times that keep it within its size
        times = max(1 + int(3 * g.numbers[j, 1]), int(np.ceil(least)))
        out[:, j] = _back_and_forth(t, takes, v[j], times, 1.0 if g.numbers[j, 2] < 0.5 else -1.0)
    return out


def _back_and_forth(t: np.ndarray, takes: float, v: float, times: int, sign: float) -> np.ndarray:
    """Position, speed and acceleration (3, T) of so many sweeps one way and back from 0, reversals up to 0.2 s."""
    half = takes / (2 * times)
    blend = min(0.1, 0.25 * half)
    turns = [(k * half - blend, -2 * v if k % 2 else 2 * v, 2 * blend) for k in range(1, 2 * times)]
    x1, x2 = changing(t, [(0.0, v, blend), *turns, (takes - blend, v, blend)])
    return sign * np.stack([scipy.integrate.cumulative_trapezoid(x1, t, initial=0.0), x1, x2])


def _swing(g: Gesture, allowed: Room, t: np.ndarray, takes: float):
    """A sine that grows from a tenth; numbers: size in the logarithm, frequency from 1 to 4 Hz, phase."""
    size = np.maximum(SLOWEST_SWING, g.size * 10 ** (g.numbers[:, 0] - 1))[:, None]
    omega = 2 * np.pi * (1 + 3 * g.numbers[:, 1:2])
    angle = omega * t + 2 * np.pi * g.numbers[:, 2:3]
    ramp, slope = 0.1 + 0.9 * t / takes, 0.9 / takes
    s = ramp * np.sin(angle)
    s1 = slope * np.sin(angle) + ramp * omega * np.cos(angle)
    s2 = 2 * slope * omega * np.cos(angle) - ramp * omega**2 * np.sin(angle)
    return tuple(size * y for y in times(faded(t, takes, 0.15 * takes), (s, s1, s2)))


def _reversal(g: Gesture, allowed: Room, t: np.ndarray, takes: float):
    """Forth and back over its size at constant speed; numbers: how often, in the logarithm between once and
    FASTEST_REVERSAL (but no slower than SLOWEST_SWEEP), sign."""
    out = np.zeros((3, len(g.size), len(t)))
    for j in np.flatnonzero(g.size > 0):
        most = max(1.0, FASTEST_REVERSAL * takes)
        least = min(max(1.0, SLOWEST_SWEEP * takes / (2 * g.size[j])), most)
        times = round(least * (most / least) ** g.numbers[j, 0])
        speed = 2 * g.size[j] * times / takes
        out[:, j] = _back_and_forth(t, takes, speed, times, 1.0 if g.numbers[j, 1] < 0.5 else -1.0)
    return out


def _chirp(g: Gesture, allowed: Room, t: np.ndarray, takes: float):
    """A frequency that rises, as large as speed and acceleration let it be; numbers: lowest (0.5 to 2 Hz), highest (up
    to HIGHEST_CHIRP), phase."""
    low = 0.5 + 1.5 * g.numbers[:, 0:1]
    high = low + (HIGHEST_CHIRP - low) * g.numbers[:, 1:2]
    rise = (high - low) / takes
    angle = 2 * np.pi * (low * t + rise * t**2 / 2 + g.numbers[:, 2:3])
    omega = 2 * np.pi * (low + rise * t)
    limits = [np.maximum(x, 1e-9)[:, None] for x in (g.size, 0.9 * allowed.speed, 0.8 * allowed.acceleration)]
    size = np.sum([(omega**k / x) ** 4 for k, x in enumerate(limits)], axis=0) ** -0.25  # nearly the least of the three
    fade, *_ = faded(t, takes, 0.2 * takes)
    spline = scipy.interpolate.make_interp_spline(t, size * fade * np.sin(angle), k=5, axis=1)
    return tuple(spline(t, k) for k in range(3))
