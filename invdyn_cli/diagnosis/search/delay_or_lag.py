"""Delay or lag: a comparison in which noise favours neither.

To first order both add time x slope of the torque; only the small second order distinguishes them. A lag's column on
the measured torque smooths its noise; one on the model's torque contains the noise of positions, differentiated three
times. In the lowest part of a joint's frequency band, where the arm moves, both noises are small.

An error of the model that repeats with the motion favours the same one in every block of time. So a small difference
is not decisive even if all blocks agree: it must exceed MIN_CLEAR_DIFFERENCE, too.
"""

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from invdyn_cli.diagnosis.columns.candidates import trial_at
from invdyn_cli.diagnosis.columns.evidence import slow
from invdyn_cli.diagnosis.search import naming
from invdyn_cli.diagnosis.search.composed import Model, Refined
from invdyn_cli.diagnosis.search.exact import refine
from invdyn_cli.diagnosis.search.judge import Hypothesis, HypothesisScorer
from invdyn_cli.interfaces import AbstractEffect
from invdyn_cli.maths.statistics import autocorrelation_time


def distinguish(
    judge: HypothesisScorer,
    model: Model,
    effects: Mapping[str, AbstractEffect],
    always: Hypothesis,
    hypothesis: Hypothesis,
    chosen: Refined,
    barred: Collection[tuple] = (),
) -> tuple[Hypothesis, Refined, dict[tuple[str, int | None], bool]]:
    """Delays and lags decided by their formulas on the model's torque, where a lag does not smooth the noise of the
    measured one: the better one of both, and whether the other does as well. Keys that are `barred` are not chosen."""
    close: dict[tuple[str, int | None], bool] = {}
    evidence, rows = judge.evidence, judge.rows
    for i, one in enumerate(chosen.acting):
        other = next((e for e in effects.values() if e.late_by and e.name != one.effect.name), None)
        if not one.effect.late_by or other is None or (other.name, one.joint) in barred:
            continue
        swapped = replace(one, effect=other, parameters={other.late_by: one.parameters[one.effect.late_by]})
        others = chosen.acting[:i], chosen.acting[i + 1 :]
        trial = refine(evidence, model, (*others[0], swapped, *others[1]), rows, judge.weights, always)
        assert one.joint is not None
        valid = evidence.valid[:, one.joint]
        left = [slow(evidence, x.residual[:, one.joint] * valid, one.joint)[rows] for x in (trial, chosen)]
        best = min(left, key=lambda x: float(x @ x))
        unit = float(np.mean(best**2)) * autocorrelation_time(best)  # of a loss: noise variance x correlation time
        numbers, of = np.unique(evidence.block[rows], return_inverse=True)
        losses = [np.bincount(of, x**2, len(numbers)) for x in left]
        step = (losses[0] - losses[1]) / max(unit, 1e-300)
        if step.sum() < 0:
            chosen, step = trial, -step
            candidate = trial_at(evidence, trial.acting[i])
            judge.refresh()
            hypothesis = (*hypothesis[:i], candidate, *hypothesis[i + 1 :])
        close[hypothesis[i].key] = naming.as_well(step, 0.0, naming.MIN_CLEAR_DIFFERENCE)
    return hypothesis, chosen, close
