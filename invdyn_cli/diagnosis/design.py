"""A reference trajectory that tells rivals apart: gestures are chosen from many at random by what they add to the
smallest distance between any true cause and its rival, then varied while that helps.

The distance is that of `contest`, the gestures are those of `design_family`. What is chosen fills a round, which is
played two or three times, so that the part of a log that chooses shows what the part that judges does.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from invdyn_cli.diagnosis import contest, design_family
from invdyn_cli.diagnosis.causes import Cause, Usual, scenes_of
from invdyn_cli.diagnosis.contest import Contest, Pair, Side
from invdyn_cli.diagnosis.design_family import Gesture, Room, drawn, joined, motion_of, room_of, seconds_between, varied
from invdyn_cli.effects.composition import rigid_torque
from invdyn_cli.errors import UsageError
from invdyn_cli.interfaces import Progress, silent
from invdyn_cli.simulation.references import room
from invdyn_cli.types import Motion, Robot

RATE = 100.0
"""[Hz] at which motions are judged."""

LIBRARY = 240
"""Gestures at random to choose from."""

GESTURE, SHORTEST = 2.0, 1.2
"""[s] of a gesture in the library, and at least in a design."""

ROUND = 10.0
"""[s] of a round, about."""

TRIES = 60
"""Variations that are tried."""

APART = 10.0
"""Standard errors from which two causes are told apart: what `naming` asks of a rival is a difference of ten noise
variances on nearly every draw of the blocks, and estimated sizes are not the true ones."""

ALIKE = 0.02
"""Share of its torque that a cause must keep from its rival on all motions together: below, no motion tells them
apart, and a little noise in the regressor does the rest."""

BAND = 20.0
"""[Hz] of the low-pass where none is given."""

NOISE = 0.01
"""Share of its usual torque that a joint's noise has where none is given."""

POSTURES = 512
"""Postures at random from which a joint's usual torque is taken."""


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
        """Whether the designed motion tells them apart."""
        return self.possible and self.distance >= APART


@dataclass(frozen=True)
class Design:
    """A trajectory: t (T,) [s], its motion (T, n), what it tells apart, and the room that it was made in."""

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
    """The trajectory of `duration` [s] that best tells apart the sides of every question.

    Args:
        robot: the nominal model.
        questions: for each the sets of causes between which it is open; causes without parameters get typical sizes.
        rate: [Hz] of the trajectory that is returned.
        noise: standard deviation [N m; N] of the torques behind the low-pass, one number or (n,); None: a share.
        cutoffs: (n,) [Hz] of the low-pass.
        seed: of what is left to chance.
        known: causes that are allowed for beside them.
        tries: variations.

    Raises:
        UsageError: for fewer than two sides in a question, a cause without a typical size, or too short a duration.
    """
    for sides in questions:
        if len(sides) < 2:
            raise UsageError(f"{len(sides)} rival to tell apart; allowed: two or more")
    if not questions:
        raise UsageError("nothing to tell apart; allowed: two rivals or more")
    if not np.isfinite(duration) or duration < 5.0:
        raise UsageError(f"duration={duration:g} s; allowed: from 5 s")
    draw = np.random.default_rng(seed)
    allowed, usual = _room_and_usual(robot, draw)
    joints = _joints(robot, questions)
    start = (allowed.lower + allowed.upper) / 2
    library = _library(robot, allowed, joints, draw)
    starts = draw.uniform(0, duration, len(library))
    scenes = scenes_of(robot, [motion_of(g, allowed, RATE) for g in library], starts, RATE)
    questions = contest.sized(questions, robot, usual, duration, scenes)
    made = _contest(robot, questions, known, usual, noise, cutoffs)
    evaluation = contest.evaluated(made, scenes)
    squares, whole = contest.distances(made, evaluation, evaluation.grams.sum(0))
    share = np.sqrt(squares / np.maximum(whole, 1e-300))
    possible = (share > ALIKE) & (whole > 0)
    progress(0.3, "choosing")
    count = max(1, int((duration / _rounds(duration) - 0.6) / (GESTURE + 0.8)))
    chosen = _greedy(made, evaluation, possible, count, [library[k] for k in range(len(library))])
    state = _Search(made, allowed, start, duration, possible)
    best = state.value(chosen)
    for step in range(tries):
        k = int(draw.integers(len(chosen)))
        fresh = draw.random() < 0.3
        other = library[int(draw.integers(len(library)))] if fresh else varied(chosen[k], allowed, draw)
        moved = [*chosen[:k], other, *chosen[k + 1 :]]
        value = state.value(moved)
        if value > best:
            best, chosen = value, moved
        progress(0.3 + 0.7 * step / max(tries, 1), "refining")
    squares, _ = state.squares(chosen)
    pairs = tuple(_told(made, p, s, f, bool(o)) for p, s, f, o in zip(made.pairs, squares, share, possible, strict=True))
    motion = state.motion(chosen, rate)
    torque = rigid_torque(robot, motion)
    t = np.arange(motion.q.shape[1]) / rate
    transposed = Motion(*(np.asarray(x).T for x in (motion.q, motion.qd, motion.qdd)))
    return Design(robot, t, transposed, pairs, allowed, torque.T, tuple(tuple(s) for s in questions))


class _Search:
    """Values of lists of gestures."""

    def __init__(self, made: Contest, allowed: Room, start: np.ndarray, duration: float, possible: np.ndarray) -> None:
        self.made, self.allowed, self.start, self.duration = made, allowed, start, duration
        self.possible = possible

    def motion(self, gestures: Sequence[Gesture], rate: float) -> Motion:
        """All rounds, stretched to the duration."""
        rounds = _rounds(self.duration)
        ordered = _ordered(gestures, self.start)
        stops = [self.start, *([g.centre for g in ordered] * rounds), self.start]
        moves = sum(seconds_between(a, b, self.allowed) for a, b in zip(stops[:-1], stops[1:], strict=True))
        seconds = (self.duration - moves) / (len(ordered) * rounds)
        if seconds < SHORTEST and len(ordered) > 1:
            return self.motion(ordered[:-1], rate)
        stretched = [replace(g, seconds=max(seconds, SHORTEST)) for g in ordered] * rounds
        return joined(stretched, self.allowed, self.start, rate)

    def squares(self, gestures: Sequence[Gesture]) -> tuple[np.ndarray, float]:
        """Squared distances (P,) of all pairs, and by how much the nominal torque is beyond its limits."""
        scenes = scenes_of(self.made.robot, [self.motion(gestures, RATE)], [0.0], RATE)
        over = float((np.abs(scenes.torque).max(axis=(1, 2)) / self.allowed.torque).max()) - 1
        evaluation = contest.evaluated(self.made, scenes)
        return contest.distances(self.made, evaluation, evaluation.grams[0])[0], over

    def value(self, gestures: Sequence[Gesture]) -> float:
        squares, over = self.squares(gestures)
        return float(_worth(squares, self.possible)) - 100 * max(over, 0.0)


def _worth(squares: np.ndarray, possible: np.ndarray) -> np.ndarray:
    """What squared distances (P, …) are worth: the smallest, and a little of all, in the logarithm."""
    each = np.log(1 + squares[possible]) if possible.any() else np.log(1 + squares)
    return each.min(axis=0) + 0.1 * each.mean(axis=0)


def _greedy(made: Contest, evaluation, possible: np.ndarray, count: int, library: list[Gesture]) -> list[Gesture]:
    """So many gestures, each the one that adds most to what the ones before it tell apart."""
    chosen, so_far = [], np.zeros_like(evaluation.grams[0])
    for _ in range(count):
        squares, _ = contest.distances(made, evaluation, so_far + evaluation.grams)
        each = np.log(1 + (squares[possible] if possible.any() else squares))
        k = int(np.argmax(0.5 * each.min(axis=0) + each.mean(axis=0)))  # of all pairs: the first cannot do everything
        chosen.append(library[k])
        so_far = so_far + evaluation.grams[k]
    return chosen


def _library(robot: Robot, allowed: Room, joints: Sequence[int], draw: np.random.Generator) -> list[Gesture]:
    """Gestures at random whose nominal torque has room."""
    made = [drawn(draw, allowed, joints, GESTURE) for _ in range(LIBRARY)]
    motions = [motion_of(g, allowed, RATE) for g in made]
    torque = scenes_of(robot, motions, [0.0] * len(made), RATE).torque
    fits = np.all(np.abs(torque).max(axis=2) <= allowed.torque[:, None], axis=0)
    kept = [g for g, ok in zip(made, fits, strict=True) if ok]
    if len(kept) < 8:
        got = f"{len(kept)} of {LIBRARY} motions within the effort limits of {robot.name}"
        raise UsageError(f"{got}; allowed: 8 or more", advice="effort limits of the URDF that hold the arm's weight")
    return [kept[k % len(kept)] for k in range(LIBRARY)]


def _contest(robot: Robot, questions, known, usual: Usual, noise, cutoffs) -> Contest:
    n = robot.dofs
    own = NOISE * usual.torque if noise is None else np.broadcast_to(np.asarray(noise, float), (n,))
    bands = np.full(n, BAND) if cutoffs is None else np.asarray(cutoffs, float)
    variance = own**2 + (contest.MODEL_ERROR * usual.torque) ** 2
    weights = 2 * bands / RATE / variance
    return Contest(robot, questions, known, usual, weights, bands, contest.pairs_of(questions))


def _room_and_usual(robot: Robot, draw: np.random.Generator) -> tuple[Room, Usual]:
    middle, half, speed = room(robot)
    q = draw.uniform((middle - half)[:, None], (middle + half)[:, None], (robot.dofs, POSTURES))
    still = np.zeros_like(q)
    weight = rigid_torque(robot, Motion(q, still, still))
    inertia = np.zeros(robot.dofs)
    for j in range(robot.dofs):
        unit = np.zeros_like(q)
        unit[j] = 1.0
        inertia[j] = np.median((rigid_torque(robot, Motion(q, still, unit)) - weight)[j])
    pull = inertia * design_family.ACCELERATION * speed
    allowed = room_of(robot, np.abs(weight).max(axis=1) + 0.7 * pull)
    usual = np.hypot(np.sqrt(np.mean(weight**2, axis=1)), 0.15 * pull)
    return allowed, Usual(usual, speed, inertia, 2 * half, middle)


def _joints(robot: Robot, questions: Sequence[Sequence[Side]]) -> list[int]:
    """The joints that the causes act on; all of them where one acts on the whole arm."""
    causes = [c for sides in questions for side in sides for c in side]
    if any(c.joint is None or c.effect.point in ("body", "motion") for c in causes):
        return list(range(robot.dofs))
    return sorted({c.joint for c in causes if c.joint is not None})


def _rounds(duration: float) -> int:
    return max(1, min(3, round(duration / ROUND)))


def _ordered(gestures: Sequence[Gesture], start: np.ndarray) -> list[Gesture]:
    """Each next to the nearest that is left, from the start on: moves are short."""
    left, here, out = list(gestures), start, []
    while left:
        k = int(np.argmin([np.abs(g.centre - here).max() for g in left]))
        out.append(left.pop(k))
        here = out[-1].centre
    return out


def _told(made: Contest, pair: Pair, square: float, share: float, possible: bool) -> Told:
    sides = made.questions[pair.question]
    return Told(
        pair.question, sides[pair.true], sides[pair.rival], float(np.sqrt(square)), float(share), possible
    )
