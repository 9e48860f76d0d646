"""How gradually friction changes its side. A joint whose friction jumps sticks where it turns back; one that creeps
there, on bristles or in a simulation that smooths Coulomb's law, has less than its whole friction at low speed."""

from collections.abc import Callable, Sequence

import numpy as np
import scipy

from invdyn_cli.diagnosis.columns.evidence import filtered
from invdyn_cli.diagnosis.standard_columns import Columns
from invdyn_cli.effects.composition import EffectInstance, sign_of
from invdyn_cli.effects.friction import about_reversals
from invdyn_cli.errors import listed
from invdyn_cli.interfaces import AbstractTorqueEffect, JointState
from invdyn_cli.joints import units
from invdyn_cli.maths.statistics import autocorrelation_time
from invdyn_cli.types import Array, Robot

SHARES = (0.0025, 0.005, 0.01, 0.02, 0.04, 0.08)
"""Transitions that are tried, as shares of a joint's usual speed (its 90 % quantile)."""

TOLD = 30.0
"""Twice the logarithm of the likelihood by which another transition must be better than the one that is used."""


def speeds(columns: Columns, residual: np.ndarray, jumping: Sequence[EffectInstance] = ()) -> tuple[float, ...]:
    """(n,) [rad/s; m/s] v of the friction tanh(qd / v) of each joint that leaves least, with the links as the standard
    model has them: the present one where no other is plainly better. Of a comparison's logs the reference tells it: a
    torque that has since come late looks like it.

    Args:
        residual: (R, n) logged torque minus that of a model without friction.
        jumping: what was found that jumps where its joint turns back, and is still in the residual.
    """
    evidence = columns.evidence
    rows = evidence.of_role("reference")
    rows = rows if rows.any() else evidence.of_role("train")
    theta = columns.fit(residual, rows).theta
    target = residual - columns.of(np.where(columns.inertial, theta, 0.0))
    now = evidence.recording.transition
    if "coulomb" not in columns.terms:
        return now

    def speed(j: int, others: Sequence[float] = ()) -> float:
        own = [a for a in jumping if a.joint == j]
        return _speed(columns, target[:, j], rows & evidence.valid[:, j], j, own, now[j], others)

    found = [speed(j) for j in range(evidence.dofs)]
    slides = evidence.robot.prismatic
    told = [[v for i, v in enumerate(found) if v > 0 and i != j and slides[i] == slides[j]] for j in range(len(found))]
    return tuple(speed(j, others) if others else found[j] for j, others in enumerate(told))


def _speed(
    columns: Columns,
    target: np.ndarray,
    rows: np.ndarray,
    joint: int,
    jumping: Sequence[EffectInstance],
    now: float,
    others: Sequence[float],
) -> float:
    """A joint's; beside SHARES those of `others` are tried: a slow joint's own shares end below them."""
    usual = float(np.quantile(np.abs(np.concatenate([s[joint].qd for s in columns.evidence.states])), 0.9))
    if rows.sum() < 10 * len(columns.terms) or not usual > 0:
        return now
    left = _left(columns, target, rows, joint, jumping)
    before = left(now)

    def squares(transition: float) -> float:
        return float(np.sum(left(transition) ** 2))

    best = min((0.0, *(share * usual for share in SHARES), *others), key=squares)
    after = left(best)
    independent = rows.sum() / autocorrelation_time(np.where(rows, after, 0.0))
    if independent * np.log(np.sum(before**2) / max(np.sum(after**2), 1e-300)) < TOLD:
        return now
    if not best:
        return 0.0
    near = np.log([best / 2, min(2 * best, max(SHARES[-1] * usual, best))])
    found = scipy.optimize.minimize_scalar(lambda x: squares(np.exp(x)), bounds=near, options={"xatol": 0.02})
    return float(np.exp(found.x))


def _left(
    columns: Columns, target: np.ndarray, rows: np.ndarray, joint: int, jumping: Sequence[EffectInstance]
) -> Callable[[float], np.ndarray]:
    """What a joint's own terms and what jumps there leave (R,) of a target on these rows, for a transition."""
    evidence, coulomb = columns.evidence, columns.terms.index("coulomb")
    states, rate = [s[joint] for s in evidence.states], evidence.recording.filter.rate
    others = np.delete(columns.own[:, joint], coulomb, axis=0)

    def jumps(state: JointState, transition: float) -> Array:
        sign = np.asarray(sign_of(state.qd, state.width, transition))
        made: list[Array] = [sign, *about_reversals(sign, rate)]
        for one in jumping:
            assert isinstance(one.effect, AbstractTorqueEffect)
            made += one.effect.basis(state._replace(sign=sign), one.effect.shape_of(one.parameters))
        return np.stack(made)

    def left(transition: float) -> np.ndarray:
        every = np.concatenate([others, filtered(evidence.recording, [jumps(s, transition) for s in states], joint)]).T
        theta = np.linalg.lstsq(every[rows], target[rows], rcond=None)[0]
        return (target - every @ theta) * rows

    return left


def note_of(robot: Robot, speeds: Sequence[float]) -> tuple[str, ...]:
    """What is to be said of the joints whose friction does not jump."""
    if not any(speeds):
        return ()
    every = zip(robot.joints, speeds, robot.prismatic, strict=True)
    told = [f"{joint} ({v:.2g} {units(slides).position}/s)" for joint, v, slides in every if v > 0]
    return (
        f"The friction of these joints changes sign gradually, as tanh(qd / v), with v in brackets: {listed(told)}. "
        "They creep at reversals (presliding), or the log comes from a simulation that smooths friction.",
    )
