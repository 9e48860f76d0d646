"""A reference trajectory that distinguishes rivals: gestures are chosen from many random ones by what they add to the
smallest distance between any true cause and its rival, then varied as long as that helps.

The distance is that of `contest`, the gestures come from `gestures`. The chosen gestures fill a round, which is played
two or three times, so that training and held-out data contain the same motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from invdyn_cli.design import contest, gestures
from invdyn_cli.design.causes import Cause, Scenes, Usual, scenes_of
from invdyn_cli.design.contest import Contest, Pair, Side
from invdyn_cli.design.gestures import (
    Gesture,
    Postures,
    Room,
    drawn,
    joined,
    motion_of,
    room_of,
    seconds_between,
    varied,
)
from invdyn_cli.effects.composition import inertia_column
from invdyn_cli.effects.rigid import rigid_torque
from invdyn_cli.errors import UsageError
from invdyn_cli.interfaces import Progress, silent
from invdyn_cli.simulation.references import room
from invdyn_cli.types import Motion, Robot

RATE = 100.0
"""[Hz] at which motions are judged."""

LIBRARY = 240
"""Gestures at random to choose from."""

GESTURE, SHORTEST = 2.0, 1.0
"""[s] Length of a gesture in the library, and the shortest one in a design."""

ROUND = 12.0
"""[s] of a round, about."""

TRIES, AT_ONCE, FRESH = 120, 6, 0.3
"""Number of variations that are tried, how many of them at once, and the share that replaces a gesture by one
from the library."""

ENOUGH = 1.1 * np.log(60.0**2)
"""Worth of a design in which all pairs are sixty standard errors apart: no more is tried."""

CALMER = 8
"""Largest number of times that a design is slowed down, until the nominal torque is within its limit."""

FEWEST = 8
"""Gestures within the effort limits that a library must have."""

LEAST = 0.02
"""Share of the strongest joint's torque that a joint's usual torque is taken for at least."""

APART = 10.0
"""Standard errors from which two causes are told apart: what `naming` asks of a rival is a difference of ten noise
variances on nearly every draw of the blocks, and estimated sizes are not the true ones."""

CHANCE = 2.0
"""Standard errors up to which a difference may be chance."""

ALIKE = 0.02
"""Share of its torque that a cause must keep from its rival on all motions together: below, no motion tells them
apart, and a little noise in the regressor does the rest."""

BAND = 20.0
"""[Hz] of the low-pass where none is given."""

NOISE = 0.01
"""Share of its usual torque that a joint's noise has where none is given."""

POSTURES = 2048
"""Postures at random from which a joint's usual torque is taken, and those where it bears none, or much."""


@dataclass(frozen=True)
class Told:
    """A pair on the designed motion: `distance` in standard errors; `share` of the true cause's torque that the rival
    cannot make up for on all motions of the library together; whether any motion tells them apart, and this one."""

    question: int
    true: Side
    rival: Side
    distance: float
    share: float
    possible: bool

    @property
    def apart(self) -> bool:
        """Whether the designed motion distinguishes them."""
        return self.possible and self.distance >= APART

    @property
    def useful(self) -> bool:
        """Whether it shows a difference at all."""
        return self.possible and self.distance >= CHANCE


@dataclass(frozen=True)
class Design:
    """A trajectory: t (T,) [s], its motion (T, n), the causes that it distinguishes, and the limits that it keeps."""

    robot: Robot
    t: np.ndarray
    motion: Motion
    pairs: tuple[Told, ...]
    room: Room
    torque: np.ndarray
    questions: tuple[tuple[Side, ...], ...]

    def of(self, question: int) -> list[Told]:
        """The pairs of one question."""
        return [x for x in self.pairs if x.question == question]


def design(
    robot: Robot,
    questions: Sequence[Sequence[Side]],
    *,
    duration: float = 30.0,
    rate: float = 250.0,
    noise: np.ndarray | float | None = None,
    cutoffs: np.ndarray | None = None,
    seed: int = 0,
    known: Sequence[Cause] = (),
    tries: int = TRIES,
    progress: Progress = silent,
) -> Design:
    """The trajectory of `duration` [s] that best distinguishes the sides of every question.

    Args:
        robot: the nominal model.
        questions: for each the sets of causes between which it is open; causes without parameters get typical sizes.
        rate: [Hz] of the trajectory that is returned.
        noise: standard deviation [N m; N] of the torques behind the low-pass, one number or (n,); None: a share.
        cutoffs: (n,) [Hz] of the low-pass.
        seed: of the random choices.
        known: causes that are allowed for beside them.
        tries: variations.

    Raises:
        UsageError: for fewer than two sides in a question, a cause without a typical size, or too short a duration.
    """
    for sides in questions:
        if len(sides) < 2:
            raise UsageError(f"{len(sides)} cause to distinguish; allowed: two or more")
    if not questions:
        raise UsageError("0 causes to distinguish; allowed: two or more")
    if not np.isfinite(duration) or duration < 5.0:
        raise UsageError(f"duration={duration:g} s; allowed: 5 s or more")
    draw = np.random.default_rng(seed)
    allowed, usual, postures = _room_and_usual(robot, draw)
    start = (allowed.lower + allowed.upper) / 2
    library, scenes = _library(robot, allowed, postures, _joints(robot, questions), duration, draw)
    questions = contest.sized(questions, robot, usual, duration, scenes)
    made = _contest(robot, questions, known, usual, noise, cutoffs)
    evaluation = contest.evaluated(made, scenes)
    made = replace(made, factors=contest.factors(made, evaluation))
    squares, whole = contest.distances(made, evaluation, evaluation.grams.sum(0))
    share = np.sqrt(squares / np.maximum(whole, 1e-300))
    possible = (share > ALIKE) & (whole > 0)
    progress(0.4, "choosing")
    count = max(1, int((duration / _rounds(duration) - 0.6) / (GESTURE + 0.8)))
    chosen = _greedy(made, evaluation, possible, count, library)
    search = _Search(made, allowed, start, duration, possible, contest.is_time_varying(made, scenes))
    best = search.values([chosen])[0]
    for step in range(0, tries if possible.any() else 0, AT_ONCE):
        if best > ENOUGH:
            break
        moves = [_varied(chosen, library, allowed, draw) for _ in range(min(AT_ONCE, tries - step))]
        values = search.values(moves)
        if values.max() > best:
            best, chosen = values.max(), moves[int(values.argmax())]
        progress(0.4 + 0.6 * step / tries, "refining")
    squares, over = search.squares([chosen])
    for _ in range(CALMER):
        if over[0] <= 0:
            break
        calm = replace(search.allowed, speed=0.8 * search.allowed.speed, acceleration=0.7 * search.allowed.acceleration)
        search = replace(search, allowed=calm)
        squares, over = search.squares([chosen])
    motion = search.motion(chosen, rate)
    return Design(
        robot=robot,
        t=np.arange(motion.q.shape[1]) / rate,
        motion=Motion(*(np.asarray(x).T for x in (motion.q, motion.qd, motion.qdd))),
        pairs=tuple(_told(made, *one) for one in zip(made.pairs, squares[:, 0], share, possible, strict=True)),
        room=allowed,
        torque=rigid_torque(robot, motion).T,
        questions=tuple(tuple(x) for x in questions),
    )


def _varied(
    chosen: Sequence[Gesture], library: Sequence[Gesture], allowed: Room, draw: np.random.Generator
) -> list[Gesture]:
    """The list with one gesture varied, or taken anew from the library."""
    k = int(draw.integers(len(chosen)))
    fresh = draw.random() < FRESH
    other = library[int(draw.integers(len(library)))] if fresh else varied(chosen[k], allowed, draw)
    return [*chosen[:k], other, *chosen[k + 1 :]]


@dataclass(frozen=True)
class _Search:
    """What lists of gestures are worth."""

    made: Contest
    allowed: Room
    start: np.ndarray
    duration: float
    possible: np.ndarray
    timed: bool

    def motion(self, gestures: Sequence[Gesture], rate: float) -> Motion:
        """All rounds (n, T), from the first posture back to it."""
        fitted = self.fitted(gestures)
        return joined(fitted * _rounds(self.duration), self.allowed, self.start, rate, self.start)

    def fitted(self, gestures: Sequence[Gesture]) -> list[Gesture]:
        """The gestures of a round in order, stretched so that all rounds take the duration."""
        rounds = _rounds(self.duration)
        ordered = _ordered(gestures, self.start)
        stops = [self.start, *([g.centre for g in ordered] * rounds), self.start]
        moves = sum(seconds_between(a, b, self.allowed) for a, b in pairwise(stops))
        seconds = (self.duration - moves) / (len(ordered) * rounds)
        if seconds < SHORTEST and len(ordered) > 1:
            return self.fitted(gestures[:-1])  # the one that was chosen last does least
        return [replace(g, seconds=max(seconds, SHORTEST)) for g in ordered]

    def squares(self, lists: Sequence[Sequence[Gesture]]) -> tuple[np.ndarray, np.ndarray]:
        """Squared distances (P, m) of all pairs on all rounds of m lists, and the share by which the nominal torque is
        beyond its room (m,)."""
        rounds = _rounds(self.duration)
        cycles = [joined(own, self.allowed, own[-1].centre, RATE) for own in map(self.fitted, lists)]
        length = max(x.q.shape[1] for x in cycles)
        cycles = [_held(x, length) for x in cycles]
        starts = [k * self.duration / rounds for k in range(rounds if self.timed else 1)]
        each = [(x, start) for x in cycles for start in starts]
        scenes = scenes_of(self.made.robot, [x for x, _ in each], [start for _, start in each], RATE)
        over = (np.abs(scenes.torque).max(axis=2) / self.allowed.torque[:, None]).max(axis=0) - 1
        evaluation = contest.evaluated(self.made, scenes)
        grams = evaluation.grams.reshape(len(lists), len(starts), *evaluation.grams.shape[1:]).sum(1)
        grams = grams * (rounds / len(starts))
        return contest.distances(self.made, evaluation, grams)[0], over.reshape(len(lists), -1).max(axis=1)

    def values(self, lists: Sequence[Sequence[Gesture]]) -> np.ndarray:
        """The value of lists (m,); 0 where the torque exceeds its limit."""
        squares, over = self.squares(lists)
        return _worth(squares, self.possible) - 100 * np.maximum(over, 0.0)


def _held(motion: Motion, length: int) -> Motion:
    """The motion (n, T) with its last posture held up to a length."""
    more = ((0, 0), (0, length - motion.q.shape[1]))
    return Motion(np.pad(motion.q, more, mode="edge"), np.pad(motion.qd, more), np.pad(motion.qdd, more))


def _worth(squares: np.ndarray, possible: np.ndarray) -> np.ndarray:
    """The value of squared distances (P, …): the smallest, plus a small share of all, in logarithms."""
    each = np.log(1 + squares[possible]) if possible.any() else np.log(1 + squares)
    return each.min(axis=0) + 0.1 * each.mean(axis=0)


def _greedy(made: Contest, evaluation, possible: np.ndarray, count: int, library: list[Gesture]) -> list[Gesture]:
    """That many gestures; each one adds most to the distances that the ones before it reach."""
    chosen, so_far = [], np.zeros_like(evaluation.grams[0])
    for _ in range(count):
        squares, _ = contest.distances(made, evaluation, so_far + evaluation.grams)
        each = np.log(1 + (squares[possible] if possible.any() else squares))
        k = int(np.argmax(0.5 * each.min(axis=0) + each.mean(axis=0)))  # of all pairs: the first cannot do everything
        chosen.append(library[k])
        so_far = so_far + evaluation.grams[k]
    return chosen


def _library(
    robot: Robot, allowed: Room, postures: Postures, joints: Sequence[int], duration: float, draw: np.random.Generator
) -> tuple[list[Gesture], Scenes]:
    """Gestures at random whose nominal torque has room, and their scenes, some time in the recording."""
    made = [drawn(draw, allowed, joints, GESTURE, postures) for _ in range(LIBRARY)]
    starts = draw.uniform(0, duration, LIBRARY)
    scenes = scenes_of(robot, [motion_of(g, allowed, RATE) for g in made], starts, RATE)
    kept = np.flatnonzero(np.all(np.abs(scenes.torque).max(axis=2) <= allowed.torque[:, None], axis=0))
    if len(kept) < FEWEST:
        got = f"only {len(kept)} of {LIBRARY} random motions stay within the effort limits of {robot.name}"
        raise UsageError(
            f"{got}; needed: {FEWEST}",
            advice="effort limits in the URDF that are large enough to hold the arm's weight",
        )
    kept = kept[np.arange(LIBRARY) % len(kept)]  # of one number: programs are compiled for it
    motion = Motion(*(np.asarray(x)[:, kept] for x in (scenes.motion.q, scenes.motion.qd, scenes.motion.qdd)))
    return [made[k] for k in kept], replace(scenes, t=scenes.t[kept], motion=motion, torque=scenes.torque[:, kept])


def _contest(robot: Robot, questions, known, usual: Usual, noise, cutoffs) -> Contest:
    n = robot.dofs
    usual_noise = NOISE * usual.torque
    own = usual_noise if noise is None else np.broadcast_to(np.asarray(noise, float), (n,))
    own = np.where(np.isfinite(own) & (own >= 0), own, usual_noise)
    bands = np.full(n, BAND) if cutoffs is None else np.asarray(cutoffs, float)
    bands = np.where(np.isfinite(bands) & (bands > 0), bands, BAND)  # a joint that was held has none
    variance = own**2 + (contest.MODEL_ERROR * usual.torque) ** 2
    weights = 2 * bands / RATE / variance
    return Contest(robot, questions, known, usual, weights, bands, contest.pairs_of(questions))


def usual_of(robot: Robot) -> Usual:
    """What the joints of a robot usually do, over postures within their limits."""
    return _room_and_usual(robot, np.random.default_rng(0))[1]


def _room_and_usual(robot: Robot, draw: np.random.Generator) -> tuple[Room, Usual, Postures]:
    middle, half, speed = room(robot)
    q = draw.uniform((middle - half)[:, None], (middle + half)[:, None], (robot.dofs, POSTURES))
    still = np.zeros_like(q)
    weight = rigid_torque(robot, Motion(q, still, still))
    inertia = np.array([np.median(inertia_column(robot, q, j)[j]) for j in range(robot.dofs)])
    pull = inertia * gestures.ACCELERATION * speed
    strongest = np.abs(weight).max(axis=1) + pull
    allowed = room_of(robot, np.maximum(strongest, 1e-6 * strongest.max()))  # a last link may have no mass
    usual = np.hypot(np.sqrt(np.mean(weight**2, axis=1)), 0.15 * pull)
    usual = np.maximum(usual, LEAST * usual.max())
    return allowed, Usual(usual, speed, inertia, 2 * half, middle), Postures(q, weight)


def _joints(robot: Robot, questions: Sequence[Sequence[Side]]) -> list[int]:
    """The joints that the causes act on; all of them where one acts on the whole arm."""
    causes = [c for sides in questions for side in sides for c in side]
    if any(c.joint is None or c.effect.point in ("body", "motion") for c in causes):
        return list(range(robot.dofs))
    return sorted({c.joint for c in causes if c.joint is not None})


def _rounds(duration: float) -> int:
    return max(1, min(3, round(duration / ROUND)))


def _ordered(gestures: Sequence[Gesture], start: np.ndarray) -> list[Gesture]:
    """The postures ordered by nearest neighbour from the start, so that moves are short."""
    left, here, out = list(gestures), start, []
    while left:
        k = int(np.argmin([np.abs(g.centre - here).max() for g in left]))
        out.append(left.pop(k))
        here = out[-1].centre
    return out


def _told(made: Contest, pair: Pair, square: float, share: float, possible: bool) -> Told:
    sides = made.questions[pair.question]
    return Told(pair.question, sides[pair.true], sides[pair.rival], float(np.sqrt(square)), float(share), possible)
