"""What may be claimed: causes are judged whatever the search refined before them."""

from dataclasses import replace

import numpy as np

from invdyn_cli.diagnosis.decide import claim, support
from invdyn_cli.diagnosis.search.inquiry import inquire
from invdyn_cli.effects.catalogue import EFFECTS
from tests.diagnosis.analytic import candidate, evidence_of, log_of, moved, on, raw


def test_a_delay_that_was_never_refined_is_judged():
    """With other rounding the search may come to a delay that the refinement dropped: it is judged by its own columns,
    and one that the data do not hold fails, without a sentence."""
    names = ("torque_delay", "actuator_lag", "coulomb_friction")
    friction = on(0, lambda t, q, qd, qdd: 2.0 * np.tanh(qd / 0.01))
    evidence = evidence_of(log_of(raw(*moved(20.0), friction, torque=0.02, position=1e-5)), names)
    inquiry = inquire(evidence, {name: EFFECTS[name] for name in names}, (), 3, compares=False)
    assert ("coulomb_friction", 0) in {c.key for c in inquiry.hypothesis}
    late = next(c for c in evidence.candidates if c.effect.name == "torque_delay")
    assert late.key not in {a.key for a in inquiry.chosen.acting}
    hypothesis = (*inquiry.hypothesis, candidate(evidence, *late.key))
    chosen, after = claim.exactly(inquiry, hypothesis, inquiry.chosen), claim.left(inquiry, hypothesis)
    one = claim.Claim(inquiry, hypothesis, len(hypothesis) - 1, chosen, after)
    why = support.refusal(one)
    assert why is not None and why.why(one) == ""
    kept, _, said = support.supported(replace(inquiry, hypothesis=hypothesis))
    assert late.key not in {c.key for c in kept} and not any("delay" in x for x in said)
