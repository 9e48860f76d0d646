"""Implausible parameters after a refinement: the effect only imitates another one."""

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Evidence
from invdyn_cli.diagnosis.search import noise, realisable
from invdyn_cli.diagnosis.search.composed import Model, Refined
from invdyn_cli.diagnosis.search.events import EDGE
from invdyn_cli.effects.composition import EffectInstance, TimeWindow
from invdyn_cli.joints import JointState

CLIPPED, SELDOM, BEYOND, PLAIN = 0.1, 0.5, 3.0, 30.0
"""Of the largest torque beyond a limit, what counts as clipped; on what share of the rows it may be; and how many times
the RMS of what is left elsewhere the torque beyond must be: a limit set into noise or a drift explains half of it; and
how many times the RMS of all that is left, to be a limit whatever the nominal model says."""


SEEN = 10.0
"""Standard deviations of the logged angle's noise below which a travel is not seen: three steps of an encoder, whose
rounding is noise of 0.29 of a step. Reversals come where its steps are."""


def unlikely(evidence: Evidence, model: Model, measured: noise.Noise, refined: Refined) -> set[tuple]:
    """Effects and joints with implausible parameters."""
    odd = {a.key for k, a in enumerate(refined.acting) if not _is_likely(evidence, model, measured, refined, k)}
    return odd | realisable.beyond(evidence, refined).keys()


def _is_likely(evidence: Evidence, model: Model, measured: noise.Noise, refined: Refined, place: int) -> bool:
    """Whether an effect with these parameters can be distinguished from others that look like it."""
    one = refined.acting[place]
    if (one.when is not None and _lasts(evidence, one.when)) or _at_a_bound(one) or one.effect.refuse(one.parameters):
        return False
    if not one.effect.invertible:
        return _is_a_limit(evidence, model, measured, refined, place)
    if one.joint is not None:
        if one.effect.travel(one.parameters) < SEEN * evidence.recording.position_noise[one.joint]:
            return False
        return is_plain(evidence, one)
    return True


def is_plain(evidence: Evidence, one: EffectInstance) -> bool:
    """Whether an effect on a joint can be distinguished, on this motion, from effects that look similar."""
    assert one.joint is not None
    q, qd, qdd = (evidence.on_rows(x)[:, one.joint] for x in ("q", "qd", "qdd"))
    state = JointState(evidence.on_rows("t"), q, qd, qdd, np.sign(qd), evidence.nominal[:, one.joint])
    return one.effect.is_plain(one.parameters, state)


def _at_a_bound(one: EffectInstance) -> bool:
    """Whether a parameter was to go beyond what is possible, and was kept at the end of that (`coordinates.inside`)."""
    bounds = {name: bound for name, bound in one.effect.parameters.items() if name not in one.effect.chosen}
    return any(
        np.ndim(value := one.parameters.get(name, 0.0)) == 0 and value != 0 and value in (bound.lower, bound.upper)
        for name, bound in bounds.items()
    )


def _lasts(evidence: Evidence, when: TimeWindow) -> bool:
    """Whether a window covers its whole trajectory: then the effect neither begins nor ends."""
    t = evidence.on_rows("t")[evidence.trajectory == when.trajectory]
    return bool(when.start < t[0] + EDGE and when.end > t[-1] - EDGE)


def _is_a_limit(evidence: Evidence, model: Model, measured: noise.Noise, refined: Refined, place: int) -> bool:
    """Whether a saturation is one: the torque that moved the joint stays within its limit, for the nominal model too,
    and what was asked for beyond is more than what swings on either side of every model."""
    saturation = refined.acting[place]
    j, limit = saturation.joint, saturation.parameters["limit"]
    assert j is not None
    if limit <= 0:  # then no torque would be left, and everything would be beyond it
        return False
    used = evidence.valid[:, j]
    others = [a for k, a in enumerate(refined.acting) if k != place]
    beyond = np.abs(model.without(refined, others) - refined.residual)[used, j]
    left = refined.residual[used, j]
    clipped = beyond > CLIPPED * beyond.max()
    if not 0 < clipped.mean() < SELDOM or np.mean(beyond[clipped] ** 2) < BEYOND**2 * np.mean(left[~clipped] ** 2):
        return False
    if np.mean(beyond**2) > PLAIN**2 * np.mean(left**2):
        return True
    reach = min(
        float(np.quantile(np.abs(x[used, j]), 0.99)) for x in (evidence.tau - refined.residual, evidence.nominal)
    )
    return limit > 0.75 * reach and limit > 3 * measured.deviation[j]
