"""Physically consistent bodies: payloads and changed links are moved to consistent inertials, with a note if the data
disagree.

A log determines a few combinations of a link's ten parameters; the others are free, and a fit rarely makes a possible
body of them. First the free ones are changed. If this does not suffice, the misfit increases; if it increases by more
than chance, a note says so.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from invdyn_cli.diagnosis.columns.evidence import Evidence
from invdyn_cli.diagnosis.search.composed import Model, Refined
from invdyn_cli.diagnosis.search.coordinates import precision_of
from invdyn_cli.diagnosis.search.exact import moved
from invdyn_cli.diagnosis.search.judge import RELEVANT
from invdyn_cli.joints import units
from invdyn_cli.maths import pseudo_inertia
from invdyn_cli.maths.pseudo_inertia import consistent

CHANCE = 1e-3
"""Probability that a fit of true inertials exceeds the cost from which on a note is written."""

SEEN = 1.0
"""Multiple of the prior information above which the data determine a combination of parameters."""

LIGHT = 1e-3
"""Share of the arm's mass below which a link of the URDF is a placeholder without information on the real one."""

FAR = 100.0
"""Multiple of the cost by chance above which inconsistent inertials indicate another effect: the weights of the noise
may be wrong by some factor, and a slightly wrong model makes ten times chance (`make confusion`)."""

NEGATIVE = 2.0
"""Standard errors by which a mass must be below zero to be reported as negative."""


@dataclass(frozen=True)
class Body:
    """A payload, or a link with its change.

    Attributes:
        name: what a sentence calls it.
        places: (10,) where its coordinates stand among all refined ones.
        base: (10,) the row that they are added to: none for a payload, the link's nominal one.
        reference: (10,) the body that it is taken for where the data show nothing.
    """

    name: str
    places: np.ndarray
    base: np.ndarray
    reference: np.ndarray


def realisable(
    evidence: Evidence, model: Model, refined: Refined, names: Sequence[str]
) -> tuple[Refined, tuple[str, ...], dict[int, float]]:
    """The refined effects with payloads and links that can be; a sentence for each that the data wanted otherwise, and
    what it costs in noise variances that these effects, by their numbers, are bodies.

    A body that is already consistent stays, and nothing moves if all are. Other effects change together with the bodies
    as far as the data couple them. A link that is inconsistent in the URDF may stay so by as much: the change refers to
    the nearest consistent body. `names` (n,) are those of the links.
    """
    bodies, notes = _bodies(evidence, refined, names)
    after, moving, said, costs = refined, [False] * len(bodies), (), {}
    while True:
        impossible = [not _can_be(after, body) for body in bodies]
        if not any(i and not m for i, m in zip(impossible, moving, strict=True)):
            break
        moving = [i or m for i, m in zip(impossible, moving, strict=True)]
        after, said, costs = _moved(evidence, model, refined, [b for b, m in zip(bodies, moving, strict=True) if m])
    return after, notes + said, costs


def beyond(evidence: Evidence, refined: Refined, loads: bool = False) -> dict[tuple, float]:
    """Links, or payloads, (the keys of their effects) that the data want to be what no body is, by far more than
    chance, and what a consistent body costs in noise variances. Something else looks like such a link. A payload may be
    less than none, if the last link is lighter than its model: it depends on what else may be in its place."""
    found = {}
    for body in _bodies(evidence, refined, evidence.robot.joints)[0]:
        one = refined.acting[_number(refined, body)]
        if one.effect.load != loads or _can_be(refined, body):
            continue
        wanted, known, beforehand = _known(evidence, refined, [body])
        _, cost, chance = _change(body.reference[None], wanted, known, beforehand)
        if cost > FAR * chance:
            found[one.key] = cost
    return found


def _moved(
    evidence: Evidence, model: Model, refined: Refined, bodies: Sequence[Body]
) -> tuple[Refined, tuple[str, ...], dict[int, float]]:
    """The refined effects with these bodies moved to consistent inertials, the notes about it, and the cost of each
    effect that a note is about."""
    at = np.concatenate([b.places for b in bodies])
    reference = np.array([b.reference for b in bodies])
    wanted, known, beforehand = _known(evidence, refined, bodies)
    change, cost, chance = _change(reference, wanted, known, beforehand)
    move = change @ np.linalg.lstsq(refined.unknown[:, at], refined.unknown, rcond=None)[0]
    move[at] = change
    after = moved(evidence, model, refined, move)
    if not _matters(evidence, refined, after):
        return after, (), {}
    said, costs = [], {}
    for i, body in enumerate(bodies):
        own = slice(10 * i, 10 * i + 10)
        _, alone, by_chance = _change(reference[[i]], wanted[[i]], _alone(known, own), beforehand[own])
        if alone > by_chance:
            said.append(_sentence(evidence, refined, after, [body], alone, by_chance))
            costs[_number(refined, body)] = alone
    if not said and cost > chance:
        said.append(_sentence(evidence, refined, after, bodies, cost, chance))
        costs = {_number(refined, body): cost for body in bodies}
    return after, tuple(said), costs


def _known(evidence: Evidence, refined: Refined, bodies: Sequence[Body]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The wanted rows (n, 10) of bodies, their inverse covariance (10 n, 10 n), and what was known of them beforehand
    (10 n,)."""
    at = np.concatenate([b.places for b in bodies])
    # the rows of `unknown` are a root of the covariance, in which all that is no body of these is marginalised
    root = np.linalg.inv(np.linalg.qr(refined.unknown[:, at], mode="r"))
    wanted = np.array([_row(refined, b) for b in bodies])
    return wanted, root @ root.T, precision_of(evidence, refined.acting, refined.labels)[at]


def _change(
    reference: np.ndarray, wanted: np.ndarray, known: np.ndarray, beforehand: np.ndarray
) -> tuple[np.ndarray, float, float]:
    """What bodies (n, 10) change by to be some (10 n,), what that costs in noise variances, and what it costs at most
    but for a share CHANCE of true bodies: the truth can be, so that the best fit that can is no farther from the free
    one than the truth is (chi-square of what the data show).

    Args:
        known: (10 n, 10 n) inverse covariance of the wanted rows, with what was known `beforehand` (10 n,).
    """
    change = (consistent(reference, wanted, known).rows - wanted).ravel()
    unit = np.sqrt(beforehand)
    values, vectors = np.linalg.eigh(known / np.outer(unit, unit))
    shown = np.maximum(values - 1, 0)  # what the data say themselves
    freedom = max(int(np.sum(shown > SEEN)), 1)
    return change, float(shown @ ((unit * change) @ vectors) ** 2), float(scipy.stats.chi2.ppf(1 - CHANCE, freedom))


def _matters(evidence: Evidence, before: Refined, after: Refined) -> bool:
    """Whether the torque of a joint changes by more than an accurate log leaves unexplained."""
    change, tau = (np.mean(x**2, axis=0) for x in (after.residual - before.residual, evidence.tau))
    return bool(np.any(change > RELEVANT**2 * tau))


def _bodies(evidence: Evidence, refined: Refined, names: Sequence[str]) -> tuple[list[Body], tuple[str, ...]]:
    """The bodies among refined effects, and a note for each whose URDF has none."""
    bodies, notes = [], []
    nominal = np.asarray(evidence.robot.inertial)
    for number, one in enumerate(refined.acting):
        if not one.effect.changes_inertials:
            continue
        places = np.array([k for k, (of, name, _) in enumerate(refined.labels) if of == number and not name])
        if one.effect.load:
            mass, *moment = refined.theta[places[:4]]
            if mass < 0:  # taken off since a reference
                continue
            ball = pseudo_inertia.ball(abs(mass), np.array(moment) / mass)
            bodies.append(Body("the payload", places, np.zeros(10), ball))
            continue
        assert one.joint is not None
        own, name = nominal[one.joint], names[one.joint]
        base = pseudo_inertia.realisable(own)
        if not pseudo_inertia.is_realisable(own):
            notes.append(
                f"The inertials of {name} in the URDF are not physically consistent. The change that was found refers "
                "to the nearest consistent inertials; the difference between these and the URDF remains in the model."
            )
        like = own if own[0] > LIGHT * nominal[:, 0].sum() else base + refined.theta[places]
        bodies.append(Body(name, places, base, pseudo_inertia.realisable(like, pseudo_inertia.ROUND)))
    return bodies, tuple(notes)


def _number(refined: Refined, body: Body) -> int:
    """Which of the refined effects makes this body."""
    return refined.labels[body.places[0]][0]


def _row(refined: Refined, body: Body) -> np.ndarray:
    return body.base + refined.theta[body.places]


def _can_be(refined: Refined, body: Body) -> bool:
    return pseudo_inertia.is_realisable(_row(refined, body))


def _alone(information: np.ndarray, own: slice) -> np.ndarray:
    """Information on one body, with the others unconstrained (Schur's complement)."""
    other = np.ones(len(information), bool)
    other[own] = False
    if not other.any():
        return information
    cross = information[other][:, own]
    return information[own, own] - cross.T @ np.linalg.lstsq(information[np.ix_(other, other)], cross, rcond=1e-12)[0]


def _sentence(
    evidence: Evidence, before: Refined, after: Refined, bodies: Sequence[Body], cost: float, chance: float
) -> str:
    """A note: the best-fit bodies are not physically consistent, and the cost of consistent ones."""
    rows = np.maximum(evidence.valid.sum(0), 1)
    free, bound = (np.sum((x.residual * evidence.valid) ** 2, axis=0) / rows for x in (before, after))
    worst = int(np.argmax(bound - free))
    unit = units(evidence.robot.prismatic[worst]).torque
    why = ""
    for body in bodies:
        mass, error = _row(before, body)[0], float(np.linalg.norm(before.unknown[:, body.places[0]]))
        if mass < -NEGATIVE * error:
            why = f" (a mass of {mass:.3g} ± {NEGATIVE * error:.1g} kg)"
    return (
        f"The best-fit inertials of {' and '.join(b.name for b in bodies)} are not physically consistent{why}. The "
        f"nearest consistent ones fit significantly worse: squared errors grow by {cost:.3g} noise variances (by "
        f"chance {chance:.3g} at most), and the RMSE on {evidence.robot.joints[worst]} grows from "
        f"{free[worst] ** 0.5:.3g} to {bound[worst] ** 0.5:.3g} {unit}. Suspect another cause with a similar effect."
    )
