"""The gear that yields, if any, beside which the standard model is fitted at first.

Play and springs let a link move against its motor. A standard model makes up for that with other links and with
friction that changes its side gradually, and these hide the gear afterwards: play is crossed where a joint's load
changes its sign, and the load is that of the links. Nothing is named here.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import scipy

from invdyn_cli.diagnosis.columns import gears
from invdyn_cli.diagnosis.columns.evidence import Evidence, slow_saved, slow_share
from invdyn_cli.diagnosis.columns.links import loaded_by
from invdyn_cli.diagnosis.search.equations import inverse_root
from invdyn_cli.diagnosis.search.feigned import asked_by_noise
from invdyn_cli.diagnosis.standard_columns import Columns
from invdyn_cli.diagnosis.transition import TOLD
from invdyn_cli.effects.composition import EffectInstance
from invdyn_cli.interfaces import AbstractEffect, AbstractGearEffect
from invdyn_cli.maths.standard import Standard, fit, link_scales
from invdyn_cli.maths.threads import side_by_side

SHORTLIST = 3
"""Gears that are fitted with the standard model: those that gain most in the noise of a fit without them."""

BETWEEN, SCANNED = 0.4, 9
"""Logarithm of a compliance, to either side of a trial, and number of values, among which a gear's is looked for: where
play is crossed at other times, the least loss is within some percent."""

SHARES = (1.0, 0.5, 0.0)
"""Of a fit's change of the links, the shares that are tried as a gear's load."""


def gear(columns: Columns, effects: Sequence[AbstractEffect]) -> EffectInstance | None:
    """The trial of a gear, of any joint, beside which the standard model leaves least, if that is plainly less than
    without it, and not by what encoder noise feigns."""
    evidence, rows = columns.evidence, columns.evidence.of_role("train")
    nominal = evidence.residual((), np.zeros(0))
    plain = columns.fit(nominal, rows)
    before = nominal - columns.of(plain.theta)
    used = (rows[:, None] & evidence.valid).T
    squares = _squares(columns, nominal, rows)
    friction = _friction(columns, plain.theta)
    places = [(x, j) for x in effects if isinstance(x, AbstractGearEffect) for j in range(evidence.dofs)]
    trials = [
        EffectInstance(effect, joint, {**shape, **own})
        for effect, joint in places
        for shapes in [gears.shapes_of(evidence, effect, joint)]
        for own in ({}, *effect.dragged(*friction[joint]))
        for shape in shapes
    ]
    losses = side_by_side(lambda one: squares(left(columns, one)), trials)
    best: dict[tuple, EffectInstance] = {}
    for number in np.argsort(losses):
        best.setdefault(trials[number].key, trials[number])
    found, most = None, TOLD
    for trial in list(best.values())[:SHORTLIST]:
        one = _nearest_dragged(evidence, trial, lambda made: squares(nominal - made.T))
        rest = left(columns, one)
        fitted = columns.fit(rest, rows)
        after = rest - columns.of(fitted.theta)
        independent = used.sum(1) / np.minimum(columns.times(before, rows), columns.times(after, rows))
        gain = 2 * float(independent @ np.log(plain.noise / fitted.noise))
        trained, precise = rows[:, None], 1 / plain.noise**2
        saved = slow_saved(evidence, range(evidence.dofs), True, before * trained, after * trained, precise)
        if gain > most and not asked_by_noise(slow_share(saved), gain):
            found, most = one, gain
    return found and _nearest(evidence, found, lambda made: squares(nominal - made.T))[0]


def _nearest_dragged(evidence: Evidence, one: EffectInstance, loss: Callable[[np.ndarray], float]) -> EffectInstance:
    """A trial of a sharp effect whose link has friction, with the share of that, and the compliance, that have the
    least `loss`; any other as it is."""
    assert isinstance(one.effect, AbstractGearEffect)
    if not one.effect.sharp or not any(name in one.parameters for name in one.effect.chosen):
        return one
    alike = (one, *(replace(one, parameters=x) for x in one.effect.relatives(one.parameters)))
    return min((_nearest(evidence, x, loss) for x in alike), key=lambda x: x[1])[0]


def _friction(columns: Columns, theta: np.ndarray) -> list[tuple[float, float]]:
    """Coulomb and viscous friction of each joint by these coefficients (p,), no less than none."""
    own = dict(zip(columns.terms, columns.split(theta)[1], strict=True))
    levels = (np.maximum(own.get(term, np.zeros(columns.evidence.dofs)), 0.0) for term in ("coulomb", "viscous"))
    return list(zip(*(x.tolist() for x in levels), strict=True))


def believable(columns: Columns, one: EffectInstance | None, fitted: Standard) -> Standard:
    """The standard model of what this gear leaves, with its links moved from the URDF only as far as the gear, under
    their load, leaves least: an offset and the weight of a link may be hard to tell apart, but play is crossed where
    the load changes its sign."""
    if one is None:
        return fitted
    evidence = columns.evidence
    nominal, rows = evidence.residual((), np.zeros(0)), evidence.of_role("train")
    squares = _squares(columns, left(columns, one), rows)
    best = np.inf, fitted
    for share in SHARES:
        moved = np.where(columns.inertial, share, 1.0) * fitted.theta
        carried = loaded_by(evidence, np.asarray(evidence.robot.inertial) + columns.split(moved)[0])
        loss = _nearest(carried, one, lambda made: squares(nominal - made.T))[1]
        if loss < best[0]:
            best = loss, replace(fitted, theta=moved)
    return best[1]


def _nearest(
    evidence: Evidence, one: EffectInstance, loss: Callable[[np.ndarray], float]
) -> tuple[EffectInstance, float]:
    """A gear with the compliance, between its neighbours among the trials, whose torque (n, R) has the least `loss`;
    and that."""
    effect, joint = one.effect, one.joint
    assert isinstance(effect, AbstractGearEffect)
    assert joint is not None

    def at(logarithm: float) -> dict[str, Any]:
        return effect.as_soft(one.parameters, float(np.exp(logarithm)))

    def of(logarithm: float) -> float:
        return loss(gears.torque(evidence, effect, joint, at(logarithm)))

    tried = np.log(effect.compliance(one.parameters)) + np.linspace(-BETWEEN, BETWEEN, SCANNED)
    best, step = tried[int(np.argmin(side_by_side(of, tried)))], tried[1] - tried[0]
    found = scipy.optimize.minimize_scalar(of, bounds=(best - step, best + step), options={"xatol": 2e-3})
    return replace(one, parameters=at(found.x)), float(found.fun)


def left(columns: Columns, one: EffectInstance | None) -> np.ndarray:
    """(R, n) what the nominal model leaves, without what this gear makes."""
    evidence = columns.evidence
    nominal = evidence.residual((), np.zeros(0))
    if one is None:
        return nominal
    assert isinstance(one.effect, AbstractGearEffect)
    assert one.joint is not None
    return nominal - gears.torque(evidence, one.effect, one.joint, one.parameters).T


def _squares(columns: Columns, residual: np.ndarray, rows: np.ndarray) -> Callable[[np.ndarray], float]:
    """A function of targets (R, n): the squares that the standard model leaves of them, each joint in its noise in a
    fit of a `residual` (R, n) on some `rows` (R,), and its coefficients without bounds."""
    motions, prior, times = columns.asked(residual, rows, link_scales(columns.evidence.robot))
    fitted = fit(motions, prior, times)
    precise = 1 / np.maximum(fitted.noise**2 * times, 1e-300)
    scale = prior.at(fitted.share)
    grams = np.sum([m.grams for m in motions], axis=0)[:, :-1, :-1]
    normal = np.einsum("j,jab->ab", precise, grams) * np.outer(scale, scale)
    root = scale[:, None] * inverse_root(normal, np.ones(len(scale)))
    weights = np.where(rows[:, None] & columns.evidence.valid, precise, 0.0)
    of_links = columns.links.reshape(len(columns.links), -1)

    def squares(target: np.ndarray) -> float:
        weighted = np.ascontiguousarray((weights * target).T)
        own = np.einsum("tjr,jr->tj", columns.own, weighted)
        explained = np.concatenate([of_links @ weighted.ravel(), own.ravel()]) @ root
        return float(np.sum(weighted * target.T) - explained @ explained)

    return squares
