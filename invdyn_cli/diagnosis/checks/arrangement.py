"""Which order and signs of the columns the physics asks for, by likelihood, and which others it cannot tell from that.

Every arrangement of the positions (an exchange of two joints, a known order of all, one joint's sign) gives another
motion, and with it a likelihood for every torque column on every joint (`fitness`). Arrangements that are wrong cost
what makes them rare beforehand; those that are as likely as the best are told, too.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from invdyn_cli.diagnosis.checks.fitness import Fitness, Rows, fitness, rows_of
from invdyn_cli.diagnosis.checks.samples import gather_changing, torque_of
from invdyn_cli.log import Log
from invdyn_cli.recording.memory import once_for_a_log
from invdyn_cli.types import Robot

FLAW = 5.0
"""Log of the odds against each thing that is wrong in a log, before it is looked at; its place costs the log of their
number on top (ours: one log in a hundred and fifty)."""

FOUND = 8.0
"""Log of the odds, that cost included, from which on an arrangement is stated (ours: once in three thousand)."""

ALIKE = 5.0
"""Log of the likelihood ratio below which two arrangements count as alike (Kass, Raftery 1995: 5 is very strong)."""

OWN = 4.0
"""Log of the odds against a factor of a column's own, counts for instance: it may lie in a range of ten thousand."""

BEYOND, PAST = 0.1, 4.0
"""[rad; m] past a joint's limits that speak against an arrangement, and by how much each joint does."""

MOVED = 0.02
"""[rad; m] RMS of a position about its mean below which nothing shows whose it is."""

MOST = 0.5
"""More than this share of the joints that change places in a known order have to move; and of all joints, before one
that rests changes places with one that moves (ours)."""

ROUNDS = 3
"""How often the search begins anew with the noise of what was found."""

SOURCE = "log likelihood of friction, rotor, spring and the URDF with a prior; own choice: odds of e^8"
"""Where a threshold of what is stated comes from."""

AFTER_ORDER = "the order of the columns must be settled first"
"""Why a check is skipped whose finding may be no more than a consequence of a wrong order."""

MOUNTINGS = np.concatenate([np.eye(3), -np.eye(3)])
"""Directions of gravity in the base frame: of a base on the floor, under a ceiling or at a wall."""

UNITS = (1.0, 1e3, 1e-3)
"""Logged torque over N m while orders and signs are looked for; else every column has a factor of its own."""


@dataclass(frozen=True)
class Arrangement:
    """Joint j of the robot: positions from column `order[j]` times `signs[j]`, torque from `columns[j]` times
    `turned[j]`. `likelihood`: log; `support`: of it what the bodies' torque adds to friction, spring, rotor and offset,
    which fit wherever joints move alike; `plain`: what the URDF's torque adds to these as it stands; `cost`: log of the
    odds against what would be wrong."""

    order: tuple[int, ...]
    signs: tuple[float, ...]
    columns: tuple[int, ...]
    turned: tuple[float, ...]
    likelihood: float
    support: float
    plain: float
    cost: float

    def beside(self, other: "Arrangement") -> float:
        """Log of the odds for this arrangement against another one, as far as all three likelihoods agree: a rigid
        body with errors in every parameter fits much where joints move in phase; the URDF has to fit better, too."""
        gain = min(getattr(self, x) - getattr(other, x) for x in ("likelihood", "support", "plain"))
        return gain - self.cost + other.cost

    @property
    def key(self) -> tuple:
        """What makes it differ from others."""
        return self.order, self.signs, self.columns, self.turned


@dataclass(frozen=True)
class Verdict:
    """`logged`: the columns as they stand; `best`: the likeliest; `alike`: others as likely as the best by all three
    likelihoods; `rivals`: these, and others as simple that one of the three does not exclude; `judged` (n,): whether
    the torque of each joint, so arranged, is explained by its rigid body. `gravity` (3,) [m/s^2]: in which direction it
    acts on the base if that, with the columns as they stand, is likelier than the URDF's, or as likely as columns that
    would be wrong; then the best is as logged."""

    logged: Arrangement
    best: Arrangement
    alike: tuple[Arrangement, ...]
    rivals: tuple[Arrangement, ...]
    judged: np.ndarray
    gravity: np.ndarray | None = None

    @property
    def other_orders(self) -> list[tuple[tuple[int, ...], tuple[int, ...]]]:
        """Other orders (of positions, of torques) that the physics does not exclude beside the best, but for joints
        without a torque that shows: of these two may always be exchanged."""
        best, kept = self.best, []
        for one in self.rivals:
            pair = one.order, one.columns
            if pair == (best.order, best.columns) or pair in kept:
                continue
            moved = {j for a, b in ((one.order, best.order), (one.columns, best.columns)) for j in _differ(a, b)}
            if any(self.judged[j] for j in moved):
                kept.append(pair)
        return kept

    @property
    def in_order(self) -> bool:
        """Whether the likeliest order is the one in which the columns stand."""
        return self.best.order == self.best.columns == tuple(range(len(self.judged)))


@once_for_a_log
def arrangement(log: Log, robot: Robot) -> Verdict | None:
    """What the columns of a log say of their order and signs; None where nothing moves long enough."""
    samples = gather_changing(log, robot)
    if samples is None or not np.ptp(samples.motion.q, axis=0).any():
        return None
    rows = rows_of(samples, without_gravity="gravity" in log.compensated)
    return _search(rows, robot)


def _search(rows: Rows, robot: Robot) -> Verdict:
    """In a unit that all joints have; where factors of their own are far likelier, with these."""
    unit = _unit(rows, robot)
    first = fitness(rows, robot, (unit,))
    verdict, fit = _searched(rows, robot, unit, 0, first.effective)
    at = np.arange(robot.dofs), np.array(verdict.best.columns)
    common, own = (fit.likelihood[at][..., k].max(1).sum() for k in (0, -1))
    if own - OWN * robot.dofs > common + FLAW:
        verdict, _ = _searched(rows, robot, unit, -1, first.effective)
    return verdict


def _searched(rows: Rows, robot: Robot, unit: float, mode: int, effective: np.ndarray) -> tuple[Verdict, Fitness]:
    """The verdict with a common unit (mode 0) or factors of the columns' own (-1), and the fitness of its motion."""
    n = robot.dofs
    found: tuple | None = None
    for _ in range(ROUNDS):  # noise is judged where the columns stand, and that is known only in the end
        look = _Look(rows, robot, unit, mode, effective)
        logged, best = look.climbed(found)
        if best.key == (logged.key if found is None else found):
            break
        found = best.key
        home = rows.arranged(best.order, best.signs)
        effective = fitness(home, robot, (unit,), None, best.columns).effective
    look.at((best.columns, best.signs))  # of joints at rest nothing else shows whether q was exchanged with the torque
    others = [x for x in look.tried.values() if x.key != best.key]
    alike = [x for x in others if x.beside(best) + x.cost - best.cost > -ALIKE]
    simple = max(best.cost, _of_order((1, 0, *range(2, n)), robot))
    rivals = [x for x in others if x in alike or (x.cost <= simple and best.beside(x) + best.cost - x.cost < ALIKE)]
    fit = look.fits[(best.order, best.signs)]
    at = np.arange(n), np.array(best.columns)
    judged = (fit.explained[at] > 0.5) & (fit.likelihood[at][..., mode].max(1) > fit.lost[at] + 3.0)
    stated = best.key != logged.key
    gravity, odds = look.otherwise_mounted(best) if stated or not judged.all() else (None, -np.inf)
    if odds > (-ALIKE if stated else FOUND):
        return Verdict(logged, logged, (), (), judged, gravity), fit
    alike, rivals = (tuple(sorted(found, key=lambda x: -x.likelihood)) for found in (alike, rivals))
    return Verdict(logged, best, alike, rivals, judged), fit


class _Look:
    """Arrangements that were tried, and the fitness of every arrangement of the positions among them."""

    def __init__(self, rows: Rows, robot: Robot, unit: float, mode: int, effective: np.ndarray):
        self.rows, self.robot, self.unit, self.mode, self.effective = rows, robot, unit, mode, effective
        self.tried: dict[tuple, Arrangement] = {}
        self.fits: dict[tuple, Fitness] = {}

    def at(self, motion: tuple) -> list[Arrangement]:
        """Arrangements of the torque columns on one of the positions; the first is in its order, no sign turned."""
        if motion not in self.fits:
            self.fits[motion] = fitness(self.rows.arranged(*motion), self.robot, (self.unit,), self.effective)
        fit = self.fits[motion]
        order, signs = motion
        cost = _cost(order, signs, self.rows, self.robot)
        made = list(_on_motion(order, signs, fit, self.mode, cost))
        for one in made:
            self.tried.setdefault(one.key, one)
        return made

    def climbed(self, found: tuple | None) -> tuple[Arrangement, Arrangement]:
        """The columns as logged, and the best arrangement that steps from there, and from what was found, lead to."""
        n = self.robot.dofs
        start = (tuple(range(n)), (1.0,) * n)
        logged = best = self.at(start)[0]
        if found is not None:
            for motion in (found[:2], *_near(start, self.rows, self.robot)):
                self.at(motion)
            best = self.tried.get(found, logged)
        for _ in range(n if n > 1 else 0):
            for motion in _near((best.order, best.signs), self.rows, self.robot):
                self.at(motion)
            top = self.best(logged)
            if top.key == best.key:
                break
            best = top
        return logged, best

    def otherwise_mounted(self, best: Arrangement) -> tuple[np.ndarray | None, float]:
        """The likeliest direction of gravity but the URDF's with the columns as they stand, and the log of its odds
        against an arrangement; upside down, it turns the torque of every joint that it loads."""
        start, known = (tuple(range(self.robot.dofs)), (1.0,) * self.robot.dofs), np.asarray(self.robot.gravity, float)
        others = [x for x in np.linalg.norm(known) * MOUNTINGS if not np.allclose(x, known)]

        def odds(gravity: np.ndarray) -> float:
            robot = replace(self.robot, gravity=gravity)
            one = _Look(self.rows, robot, self.unit, self.mode, self.effective).at(start)[0]
            return replace(one, cost=one.cost + FLAW + np.log(len(MOUNTINGS))).beside(best)

        if not known.any() or self.rows.without_gravity:
            return None, -np.inf
        return max(((x, odds(x)) for x in others), key=lambda one: one[1])

    def best(self, start: Arrangement) -> Arrangement:
        """The start, or one whose odds beside it are FOUND: of these the simplest, unless another one has such odds
        beside it. What a large gain in one place would hide in another is so judged by itself."""
        better = sorted(
            ((x.cost, -x.beside(start), x) for x in self.tried.values() if x.beside(start) > FOUND),
            key=lambda x: x[:2],
        )
        best = start
        for _, _, one in better:
            if best is start or one.beside(best) > FOUND:
                best = one
        return best


def _unit(rows: Rows, robot: Robot) -> float:
    """The factor in UNITS that makes the torques about as large as the URDF's, whatever their order."""
    nominal = torque_of(robot, rows.motion)
    ratio = np.median(rows.tau.std(0)) / max(float(np.median(nominal.std(0))), 1e-300)
    return min(UNITS, key=lambda x: abs(np.log(max(ratio, 1e-300) / x)))


def _near(motion: tuple, rows: Rows, robot: Robot) -> Iterator[tuple]:
    """Arrangements of positions one step from one: exchanges, known orders, single signs; where something moves."""
    order, signs = motion
    moves = rows.motion.q.std(0) > MOVED
    for a, b in itertools.combinations(range(len(order)), 2):
        able = (moves[order[a]], moves[order[b]])
        if not any(able) or (not all(able) and np.mean(moves) <= MOST):  # too little moves to tell a joint by its rest
            continue
        yield _exchanged(order, a, b), signs
    for known in known_orders(robot).values():
        if np.mean([moves[i] for j, i in enumerate(known) if i != order[j]] or [False]) > MOST:
            yield known, signs
    for j in np.flatnonzero(moves[list(order)]).tolist():
        yield order, tuple(-s if k == j else s for k, s in enumerate(signs))


def known_orders(robot: Robot) -> dict[str, tuple[int, ...]]:
    """Orders in which drivers publish joints: name -> for every joint of the robot, its column."""
    n = robot.dofs
    alphabet = sorted(range(n), key=lambda j: robot.joints[j])
    orders = {
        "alphabetical, as ROS 2 publishes joint states": tuple(alphabet.index(j) for j in range(n)),
        "in the robot's order, while their names are in alphabetical order": tuple(alphabet),
        "from the tip to the base": tuple(reversed(range(n))),
    }
    if n >= 3:
        orders["elbow first, as the UR driver publishes joint states"] = (2, 1, 0, *range(3, n))
    return {name: order for name, order in orders.items() if order != tuple(range(n))}


def _cost(order: tuple[int, ...], signs: tuple[float, ...], rows: Rows, robot: Robot) -> float:
    """Log odds against an arrangement of the positions."""
    n = len(order)
    q = rows.motion.q[:, list(order)] * np.array(signs)
    past = np.maximum(np.asarray(robot.lower) - q.min(0), q.max(0) - np.asarray(robot.upper)) > BEYOND
    flips = sum(s < 0 for s in signs)
    return _of_order(order, robot) + flips * (FLAW + np.log(n)) + PAST * float(past.sum())


def _of_order(order: tuple[int, ...], robot: Robot) -> float:
    return FLAW + 1.0 if order in known_orders(robot).values() else _of_exchange(order, range(len(order)))


def _of_exchange(one: Sequence[int], other: Sequence[int]) -> float:
    """Log odds against one order beside another."""
    n, moved = len(one), len(_differ(one, other))
    return FLAW + (moved - 1) * np.log(n * (n - 1) / 2) if moved else 0.0


def _on_motion(order, signs, fit: Fitness, mode: int, cost: float) -> Iterator[Arrangement]:
    """Arrangements of the torque columns beside one of the positions: the same order first; the likeliest; and those
    that differ from these in one exchange or one sign."""
    n = len(order)
    every = np.arange(n)
    orders = [tuple(order)]
    table, direct = fit.likelihood[..., mode], fit.plain[..., mode]
    for scores in (table.max(2), table.max(2) - fit.lost, direct.max(2)):
        joints, columns = scipy.optimize.linear_sum_assignment(-scores)
        orders.append(tuple(int(i) for i in columns[np.argsort(joints)]))
    bases = set(orders)
    for base in tuple(bases):
        orders += [_exchanged(base, a, b) for a, b in itertools.combinations(range(n), 2)]
    for chosen in dict.fromkeys(orders):
        both = table[every, list(chosen)]  # (n, 2)
        plain = direct[every, list(chosen)]
        alone = fit.lost[every, list(chosen)].sum()
        extra = _of_exchange(chosen, order)
        flips = both[:, 1] - both[:, 0] > FLAW + np.log(n)
        patterns = np.array([np.zeros(n, bool), flips, np.ones(n, bool)])
        if chosen in bases:
            patterns = np.concatenate([patterns, flips ^ np.eye(n, dtype=bool)])
        turned, turns = np.where(patterns, -1.0, 1.0).tolist(), patterns.sum(1) * (FLAW + np.log(n))
        if n > 1:
            turns[patterns.all(1)] = FLAW
        likelihood, as_is = (np.where(patterns, x[:, 1], x[:, 0]).sum(1) for x in (both, plain))
        numbers = np.stack([likelihood, likelihood - alone, as_is, cost + extra + turns], axis=1).tolist()
        for signs_of_torques, row in zip(map(tuple, turned), numbers, strict=True):
            yield Arrangement(tuple(order), tuple(signs), chosen, signs_of_torques, *row)


def _exchanged(order: Sequence[int], a: int, b: int) -> tuple[int, ...]:
    changed = list(order)
    changed[a], changed[b] = changed[b], changed[a]
    return tuple(changed)


def _differ(one: Sequence[int], other: Sequence[int]) -> list[int]:
    return [j for j, (a, b) in enumerate(zip(one, other, strict=True)) if a != b]
