"""The gear that yields, if any, beside which the standard model is fitted at first.

Play and springs let a link move against its motor. A standard model makes up for that with other links and with
friction that changes its side gradually, and these hide the gear afterwards: play is crossed where a joint's load
changes its sign, and the load is that of the links. Nothing is named here.
"""

from collections.abc import Callable, Sequence

import numpy as np

from invdyn_cli.diagnosis.columns import gears
from invdyn_cli.diagnosis.columns.evidence import slow_saved, slow_share
from invdyn_cli.diagnosis.search.equations import inverse_root
from invdyn_cli.diagnosis.search.feigned import asked_by_noise
from invdyn_cli.diagnosis.standard import Columns
from invdyn_cli.diagnosis.transition import TOLD
from invdyn_cli.effects.composition import EffectInstance
from invdyn_cli.interfaces import AbstractEffect, AbstractGearEffect
from invdyn_cli.maths.standard import fit, link_scales
from invdyn_cli.recording.pieces import ROLES

SHORTLIST = 3
"""Gears that are fitted with the standard model: those that gain most in the noise of a fit without them."""


def gear(columns: Columns, effects: Sequence[AbstractEffect]) -> EffectInstance | None:
    """The trial of a gear, of any joint, beside which the standard model leaves least, if that is plainly less than
    without it, and not by what encoder noise feigns."""
    evidence, rows = columns.evidence, columns.evidence.role == ROLES.index("train")
    nominal = evidence.residual((), np.zeros(0))
    plain = columns.fit(nominal, rows)
    before = nominal - columns.of(plain.theta)
    used = (rows[:, None] & evidence.valid).T
    squares = _squares(columns, nominal, rows)
    best: dict[tuple, tuple[float, EffectInstance, np.ndarray]] = {}
    for effect in effects:
        if not isinstance(effect, AbstractGearEffect):
            continue
        for joint in range(evidence.dofs):
            for shape in gears.shapes_of(evidence, effect, joint):
                made = gears.torque(evidence, effect, joint, shape)
                loss = squares(nominal - made.T)
                if loss < best.get((effect.name, joint), (np.inf,))[0]:
                    best[effect.name, joint] = loss, EffectInstance(effect, joint, shape), made.T
    found, most = None, TOLD
    for _, one, made in sorted(best.values(), key=lambda x: x[0])[:SHORTLIST]:
        fitted = columns.fit(nominal - made, rows)
        after = nominal - made - columns.of(fitted.theta)
        independent = used.sum(1) / np.minimum(columns.times(before, rows), columns.times(after, rows))
        gain = 2 * float(independent @ np.log(plain.noise / fitted.noise))
        trained, precise = rows[:, None], 1 / plain.noise**2
        saved = slow_saved(evidence, range(evidence.dofs), True, before * trained, after * trained, precise)
        if gain > most and not asked_by_noise(slow_share(saved), gain):
            found, most = one, gain
    return found


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

    def squares(target: np.ndarray) -> float:
        weighted = weights * target
        links, own = np.einsum("pjr,rj->p", columns.links, weighted), np.einsum("tjr,rj->tj", columns.own, weighted)
        explained = np.concatenate([links, own.ravel()]) @ root
        return float(np.sum(weighted * target) - explained @ explained)

    return squares
