"""Before a name is given: every rival is fitted in its place; and how much of a residual is no noise.

A rival is equally good if the held-out loss with it in the effect's place is within the noise of that with the effect.
The noise is that of the difference, block by block, so that errors which both share do not count (Vuong 1989).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import scipy

from invdyn_cli.diagnosis.columns.evidence import Candidate, Evidence
from invdyn_cli.diagnosis.search.equations import inverted
from invdyn_cli.diagnosis.search.judge import (
    PRICE_OF_COEFFICIENT,
    PRICE_OF_EFFECT,
    Hypothesis,
    HypothesisScorer,
    parameters_of,
    strain,
)
from invdyn_cli.diagnosis.search.shared_part import precision_of
from invdyn_cli.diagnosis.search.steps import clash, free_beside
from invdyn_cli.effects.friction import StribeckFriction
from invdyn_cli.interfaces import Parameters

DOUBT = 0.005
"""Probability that a rival is equally good on another draw of the log's blocks, above which it is not rejected."""

SPECIAL = 4.0
"""Standard errors by which a general effect must be better than its special case: its more flexible shape fits many
other errors."""

LEAST_DIFFERENCE = 10.0
"""Noise variances by which a rival must do worse not to be equal: a likelihood ratio of 150 (Kass and Raftery 1995
call it very strong)."""

MIN_CLEAR_DIFFERENCE, MAX_OPPOSED_SHARE = 100.0, 0.03
"""Noise variances of a difference that needs no draws, where what speaks against it makes less than this share."""

MOST_RIVALS = 12
"""Number of rivals that are compared block by block; the search has scored all."""

MEMORY, LAGS = 0.8, 6
"""Memory of a low-pass filter's noise in units of 1 / cut-off; and how many times this lag is searched: structure
returns within it, perhaps with the opposite sign."""


SMALLER = 0.5
"""Share of what a general effect saves beyond its special case, below which no other effect speaks against it."""

LEAST_SHARE = 0.7
"""Share of what an effect explains beyond noise that a rival must explain, too, however much blocks differ: play may
show in a single one."""


@dataclass(frozen=True)
class Rival:
    """How a candidate does in an effect's place: `excess` held-out loss, its standard error, the verdict in words, the
    parameters that it then has, and whether these are impossible; that of a more general effect does not count.
    `share`: of what the effect explains, what it explains, if it may be the cause."""

    candidate: Candidate
    excess: float
    error: float
    equal: bool
    why: str
    parameters: Parameters
    impossible: bool = False
    share: float = 0.0


def simplified(
    judge: HypothesisScorer,
    always: Hypothesis,
    hypothesis: Hypothesis,
    pool: Sequence[Candidate],
    usual: Hypothesis = (),
) -> Hypothesis:
    """The hypothesis with the special case in the place of every effect that the data do not ask for in full, and the
    simpler effect in the place of a link's inertials, or a standard term in that of a gain, that do no better. Special
    cases among `usual` are there without being part of it, if they are not among `always`."""
    simpler = _simplified(judge, always, hypothesis, [*pool, *(u for u in usual if u not in always)])
    return tuple(c for c in simpler if c not in usual)


def _simplified(
    judge: HypothesisScorer, always: Hypothesis, hypothesis: Hypothesis, pool: Sequence[Candidate]
) -> Hypothesis:
    for i, general in enumerate(hypothesis):
        for c in pool:
            possible = clash(general, c) and not any(c.key == e.key for e in hypothesis)
            if possible and not _needs(judge, always, hypothesis, i, c):
                return _simplified(judge, always, (*hypothesis[:i], c, *hypothesis[i + 1 :]), pool)
        if general.effect.changes_inertials and general.effect.of_joint:
            # ten coefficients do what fewer of another effect do as well, or no more of terms that every arm has
            for simpler in _split(hypothesis, i, pool):
                equal = as_well(*_lost(judge, always, simpler, hypothesis))
                if equal and not judge.refused(always + simpler, judge.verdict(always + simpler).theta):
                    return _simplified(judge, always, simpler, pool)
            for one in (rival.candidate for rival in rivals(judge, always, hypothesis, i, pool) if rival.equal):
                if judge.freedom(one) < judge.freedom(general) + (0.5 if _is_usual(one) else -1):
                    return _simplified(judge, always, (*hypothesis[:i], one, *hypothesis[i + 1 :]), pool)
        if general.effect.factor and general.when is None:  # of a constant mass the rotor that every drive has
            for one in (rival.candidate for rival in rivals(judge, always, hypothesis, i, pool) if rival.equal):
                if _is_usual(one) and one.joint == general.joint:
                    return _simplified(judge, always, (*hypothesis[:i], one, *hypothesis[i + 1 :]), pool)
    return hypothesis


def _needs(judge: HypothesisScorer, always: Hypothesis, hypothesis: Hypothesis, place: int, special: Candidate) -> bool:
    """Whether the data ask for a general effect of a hypothesis instead of its special case: beside all others, or
    without those that are worth less than SMALLER of what it saves, each and together, if that is more than noise
    saves. Smaller effects may do a part of what it does."""
    general = hypothesis[place]

    def simpler(of: Hypothesis) -> tuple[np.ndarray, float]:
        return _lost(judge, always, tuple(special if c is general else c for c in of), of)

    def lost(*without: Candidate) -> float:
        step, extra = _lost(judge, always, tuple(c for c in hypothesis if c not in without), hypothesis)
        return float(step.sum()) + extra

    step, extra = simpler(hypothesis)
    if _clearly_asked_for(step, extra):
        return True
    least = SMALLER * (float(step.sum()) + extra)
    if least < LEAST_DIFFERENCE:
        return False
    small = [c for c in hypothesis if c is not general and lost(c) < least]
    large = tuple(c for c in hypothesis if c not in small)
    return bool(small) and lost(*small) < least and _clearly_asked_for(*simpler(large))


def _clearly_asked_for(step: np.ndarray, extra: float) -> bool:
    """`asked_for`, and on nearly every draw of the blocks."""
    return asked_for(step, extra) and chance(step, extra) <= DOUBT


def _split(hypothesis: Hypothesis, place: int, pool: Sequence[Candidate]) -> Iterator[Hypothesis]:
    """A hypothesis with what every arm has on each of the joints, as the inertia of rotors, in the place of a link's
    inertials, which have room for that of several: on two of them, and on all."""
    link, others = hypothesis[place], hypothesis[:place] + hypothesis[place + 1 :]
    usual = [c for c in free_beside(others, pool) if c.joint in link.columns and _is_usual(c)]
    rotors = [c for c in usual if "acceleration" in c.effect.shows]
    return ((*others, *some) for some in (*combinations(rotors, 2), rotors) if len(some) > 1)


def _is_usual(c: Candidate) -> bool:
    """Whether it is a term that every arm has on a joint."""
    return c.effect.group == "standard" and c.effect.is_local


def _lost(
    judge: HypothesisScorer, always: Hypothesis, other: Hypothesis, hypothesis: Hypothesis
) -> tuple[np.ndarray, float]:
    """What another hypothesis leaves more in each block (B,), and what it costs more: its coefficients, and links that
    must be farther off."""
    one, now = judge.verdict(always + other), judge.verdict(always + hypothesis)
    more = sum(map(judge.freedom, other)) - sum(map(judge.freedom, hypothesis))
    dearer = strain(always, one.theta) - strain(always, now.theta)
    return one.blocks - now.blocks, PRICE_OF_COEFFICIENT * more + dearer


def as_well(step: np.ndarray, extra: float, least: float = LEAST_DIFFERENCE) -> bool:
    """Whether what costs `extra`, and leaves `step` (B,) more in each block, does as well: with less than `least` noise
    variances in all, or by the draw of the blocks."""
    return bool(step.sum() + extra < least or chance(step, extra) > DOUBT)


def asked_for(step: np.ndarray, extra: float) -> bool:
    """Whether the data ask for a general effect instead of its special case, which leaves `step` (B,) more in each
    block: on average by SPECIAL standard errors, or in most blocks (signed ranks, Wilcoxon 1945) where few have most
    of it, as slow motion may come seldom."""
    if step.sum() + extra >= SPECIAL * np.std(step) * np.sqrt(len(step)) or undenied(step, extra):
        return True
    by_chance = scipy.stats.wilcoxon(step + extra / len(step), alternative="greater").pvalue  # type: ignore[attr-defined]
    return bool(by_chance < DOUBT)


def rivals(
    judge: HypothesisScorer, always: Hypothesis, hypothesis: Hypothesis, place: int, pool: Sequence[Candidate]
) -> list[Rival]:
    """The best trial of every other effect in the place of one, by effect and joint, the strongest first. A more
    general effect is one if it does better by a standard error in a comparison, where errors of what both logs show
    hide what is more; else its special case is enough until it replaces that (`asked_for`)."""
    compares = judge.evidence.reference_rows is not None
    now = judge.verdict(always + hypothesis)
    own, others = hypothesis[place], hypothesis[:place] + hypothesis[place + 1 :]
    without = judge.verdict(always + others)
    believed = strain(always, now.theta)
    whole = float(np.sum(without.blocks - now.blocks)) + strain(always, without.theta) - believed
    made = []
    for c in _strongest(judge, (*always, *others), free_beside(others, pool), own):
        other = judge.verdict((*always, *others, c))
        # what a rival gains on joints that the effect does not touch is not to its credit
        rows = other.rows - now.rows
        elsewhere = [j for j in range(len(rows)) if j not in own.columns]
        step = other.blocks - now.blocks - sum(np.minimum(rows[j].sum(), 0.0) / rows.shape[1] for j in elsewhere)
        dearer = strain(always, other.theta) - believed
        simpler = PRICE_OF_COEFFICIENT * (judge.freedom(c) - judge.freedom(own)) + _timed(c) - _timed(own)
        excess = float(step.sum() + dearer + simpler)
        error = float(np.std(step, ddof=1) * np.sqrt(len(step))) if len(step) > 1 else abs(excess)
        refused = judge.refused((*always, *others, c), other.theta)
        equal = as_well(step, excess - float(step.sum()))
        share = 1 - (float(step.sum()) + dearer) / whole if whole > 0 else 0.0
        equal &= share > LEAST_SHARE or excess < MIN_CLEAR_DIFFERENCE
        why = f"explains {100 * max(share, 0):.3g} % of what {own.effect.title} explains on held-out data"
        enough = _why_enough(own, c, compares and excess < -max(error, LEAST_DIFFERENCE)) if equal else ""
        if refused:
            why = f"{refused} (it {why})"
        elif enough:
            why = enough
        elif not equal:
            why += f"; worse by {excess / max(error, 1e-9):.1f} standard errors"
        equal = equal and not (refused or enough)
        parameters = parameters_of(judge.evidence, c, other.theta[len(other.theta) - len(c.precision) :])
        impossible = bool(c.effect.refuse(parameters)) and not clash(c, own)
        made.append(Rival(c, excess, error, equal, why, parameters, impossible, 0.0 if refused else share))
    return made


def _strongest(
    judge: HypothesisScorer, others: Hypothesis, pool: Sequence[Candidate], own: Candidate
) -> list[Candidate]:
    """The best trial of every other effect of a pool beside all `others`, by effect and joint, the strongest of them.
    What another joint alone feels is no rival."""
    best: dict[tuple, tuple[float, Candidate]] = {}
    near = [c for c in pool if c.key[:2] != own.key[:2] and not c.columns.keys().isdisjoint(own.columns)]
    for value, c in zip(judge.extended(others, near)[0], near, strict=True):
        value = float(value) - judge.price((c,)) + PRICE_OF_COEFFICIENT * judge.freedom(c)
        if c.key not in best or value < best[c.key][0]:
            best[c.key] = value, c
    return [c for _, c in sorted(best.values(), key=lambda x: x[0])[:MOST_RIVALS]]


def _why_enough(own: Candidate, rival: Candidate, surely_better: bool) -> str:
    """Why an effect is enough although a rival does as well; "" if it may not be."""
    if clash(rival, own) and not surely_better:
        return f"is the more general effect, but not clearly better than {own.effect.title}"
    if own.effect.group == "standard" and rival.effect.coupled:
        return f"is for a gear that two joints share, and {own.effect.title} alone explains these data"
    return ""


def _timed(candidate: Candidate) -> float:
    """The price of its windows: each was chosen among many, and has two edges."""
    count = 0 if candidate.when is None else len(candidate.when.each)
    return count * (PRICE_OF_EFFECT + 2 * PRICE_OF_COEFFICIENT)


def chance(step: np.ndarray, extra: float) -> float:
    """Share of draws of as many blocks, with replacement, on which a rival is as good (bootstrap, fixed draws)."""
    if undenied(step, extra):
        return 0.0
    draws = np.random.default_rng(0).integers(len(step), size=(4000, len(step)))
    return float(np.mean(step[draws].sum(1) + extra < LEAST_DIFFERENCE))


def undenied(step: np.ndarray, extra: float) -> bool:
    """Whether what comes up in few blocks is contradicted by none: many draws would miss it, and it is sure."""
    against = -np.minimum(step, 0).sum()
    return bool(step.sum() + extra > MIN_CLEAR_DIFFERENCE and against < MAX_OPPOSED_SHARE * np.maximum(step, 0).sum())


def blind_to_stribeck(judge: HypothesisScorer, others: Hypothesis, own: Candidate, pool: Sequence[Candidate]) -> bool:
    """Whether a typical drop of friction with speed could be hidden by Coulomb friction (`own`) on this log, beside
    `others`."""
    effect = next((c.effect for c in pool if isinstance(c.effect, StribeckFriction)), None)
    trials = [c for c in pool if c.effect is effect and c.joint == own.joint and own.effect.name in c.effect.contains]
    if effect is None or not trials:
        return False
    typical = min(trials, key=lambda c: abs(np.log(c.shape["velocity"] / effect.usual_velocity)))
    together = (*others, typical)
    moments, normal = judge.equations(together)
    variance, k = inverted(normal, precision_of(together)), len(typical.precision)
    coulomb, drop = (variance @ moments)[[-k, -k + 1]]
    error = np.sqrt(max(variance[-k + 1, -k + 1], 0))
    return bool(drop + 2 * error > (effect.usual_ratio - 1) * coulomb)


def structure(evidence: Evidence, residual: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Variance (n,) of what is not noise in a residual (R, n): its largest autocovariance, of either sign, beyond the
    memory of the joint's own filter, and beyond what white noise has there by chance."""
    filter, piece = evidence.recording.filter, evidence.piece
    out = np.zeros(residual.shape[1])
    for j in range(len(out)):
        used = valid[:, j]
        if used.sum() < 50:
            continue
        x = np.where(used, residual[:, j] - np.mean(residual[used, j]), 0.0)
        first = int(np.ceil(MEMORY * filter.rate / filter.keep / filter.cutoffs[j]))
        by_chance = 3 * np.mean(x[used] ** 2) / np.sqrt(used.sum() / max(first / 2, 1))
        for lag in range(first, LAGS * first + 1):
            both = used[lag:] & used[:-lag] & (piece[lag:] == piece[:-lag])
            if both.sum() > 20:
                out[j] = max(out[j], abs(float(np.mean(x[lag:][both] * x[:-lag][both]))) - by_chance)
    return out
