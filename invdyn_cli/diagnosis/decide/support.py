"""What is refused a claim, in one ordered table: data that did not choose it must gain by it, its exact formula must
hold there, and what stays unexplained on its joint must not outweigh it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Candidate
from invdyn_cli.diagnosis.decide.claim import Claim, exactly, left
from invdyn_cli.diagnosis.search import naming
from invdyn_cli.diagnosis.search.exact import Refined
from invdyn_cli.diagnosis.search.inquiry import Inquiry
from invdyn_cli.diagnosis.search.judge import Hypothesis

OUTWEIGHED = 1.0
"""Share of the variance that stays unexplained on its joint, without which an effect explains too little to be named:
a column that is nearly orthogonal to an unknown cause still picks up a few percent of it, and one that the arm's answer
to it goes with, more."""

PICKED_UP = 0.2
"""And so much more for every further coefficient, each of which picks up as much."""

MIN_SHARE_OF_RESIDUAL = 0.5
"""Of the squares that are left on its joints, what an effect must save: a controller answers to the noise and the
rounding of its encoders, the motion follows, and the noise of the regressor goes with that of the torque."""


EVIDENCE = 400.0
"""Noise variances by which an anomaly of a worn arm must lower the held-out loss, all else fitted anew
(experiments/calibrate.md)."""


@dataclass(frozen=True)
class Refusal:
    """A row of the table.

    Attributes:
        name: as the calibration has it (experiments/calibrate.md).
        figure: of a claim.
        least: what the figure must be.
        why: the clause that a report has of a claim below it; none where held-out data are not predicted better: that
            what is not there was tried is not worth a word.
    """

    name: str
    figure: Callable[[Claim], float]
    least: float
    why: Callable[[Claim], str] = lambda _: ""


def _beside_unknown(claim: Claim) -> float:
    """What a claim gains, as a multiple of what one of its coefficients picks up of an unknown cause."""
    needed = OUTWEIGHED + PICKED_UP * (claim.inquiry.judge.freedom(claim.candidate) - 1)
    return claim.gain / max(needed * claim.unknown, 1e-300)


REFUSALS = (
    Refusal("gain on held-out rows", lambda x: x.gain, np.nextafter(0, 1)),
    Refusal("gain while joints rest", lambda x: x.gain_with_rest if x.acts_at_rest else np.inf, np.nextafter(0, 1)),
    Refusal(
        "gain over what stays unknown",
        _beside_unknown,
        1.0,
        lambda _: "most of what it would explain comes from an effect that is not in the catalogue",
    ),
    Refusal("evidence beside the standard model", lambda x: x.evidence if x.inquiry.wear else np.inf, EVIDENCE),
    Refusal(
        "delay over the sampling period",
        lambda x: x.delay / x.inquiry.evidence.recording.period,
        1.0,
        lambda x: f"{1e3 * x.delay:.2g} ms is less than one sampling period and may come from the clock of the log",
    ),
    Refusal("chance that its exact formula gains", lambda x: x.exact[0], 1 - naming.DOUBT),
    Refusal(
        "gain over the residual",
        lambda x: x.exact[1],
        MIN_SHARE_OF_RESIDUAL,
        lambda _: (
            "it is small compared with the residual, and may be an artefact of encoder noise in the feedback loop"
        ),
    ),
)
"""What a claim must reach, in this order."""


def supported(inquiry: Inquiry, refusals: Sequence[Refusal] = REFUSALS) -> tuple[Hypothesis, Refined, tuple[str, ...]]:
    """The candidates that gain on data that did not choose them, and explain more than what stays unknown, their
    parameters, refined anew whenever one is dropped; and sentences on others that held-out data speak for. What another
    effect might be as well has no sentence of its own: which of them was tried is chance."""
    hypothesis, chosen, said = inquiry.hypothesis, inquiry.chosen, []
    if {a.key for a in chosen.acting} != {c.key for c in hypothesis}:
        chosen = exactly(inquiry, hypothesis, chosen)
    while hypothesis:
        after = left(inquiry, hypothesis)
        claims = (Claim(inquiry, hypothesis, i, chosen, after) for i in range(len(hypothesis)))
        refused = [(x, why) for x in claims if (why := refusal(x, refusals))]
        if refused:
            worst, row = min(refused, key=lambda x: x[0].gain)
            place, why = worst.place, row.why(worst)
            if why and not any(r.equal for r in _rivals(inquiry, hypothesis, place)):
                name = _titled(inquiry, worst.candidate)
                said.append(f"{name[0].upper()}{name[1:]} was tried, but it is not claimed: {why}.")
        elif inquiry.wear and (vague := _vague(inquiry, hypothesis)):
            place, rival = vague
            one, other = sorted(_titled(inquiry, x) for x in (hypothesis[place], rival.candidate))
            said.append(f"Neither {one} nor {other} is claimed: these different effects explain the data equally well.")
        else:
            break
        hypothesis = hypothesis[:place] + hypothesis[place + 1 :]
        around = inquiry.beside(hypothesis)
        hypothesis = naming.simplified(inquiry.judge, around, hypothesis, inquiry.pool, inquiry.wear)
        chosen = exactly(inquiry, hypothesis, chosen)
    return hypothesis, chosen, tuple(said)


def refusal(claim: Claim, refusals: Sequence[Refusal] = REFUSALS) -> Refusal | None:
    """The first row that refuses a claim; None if it may be claimed."""
    return next((row for row in refusals if row.figure(claim) < row.least), None)


def _titled(inquiry: Inquiry, one: Candidate) -> str:
    """A candidate in a sentence: its effect and its joint."""
    return one.effect.title + (f" on {inquiry.evidence.robot.joints[one.joint]}" if one.joint is not None else "")


def _rivals(inquiry: Inquiry, hypothesis: Hypothesis, i: int) -> list[naming.Rival]:
    return naming.rivals(inquiry.judge, inquiry.always, hypothesis, i, inquiry.pool)


def _vague(inquiry: Inquiry, hypothesis: Hypothesis) -> tuple[int, naming.Rival] | None:
    """The candidate beside the standard model in whose place an effect does best for which theory does not take it, if
    there is one, and that effect: what so different effects explain alike is too little to have a name."""
    found: list[tuple[int, naming.Rival]] = []
    for i, one in enumerate(hypothesis):
        like = {one.effect.name, *(name for names in one.effect.confounders for name in names)}
        others = [r for r in _rivals(inquiry, hypothesis, i) if r.equal]
        others = [r for r in others if not (one.effect.load and r.candidate.effect.load)]
        found += [(i, r) for r in others if r.candidate.effect.name not in like]
    return min(found, key=lambda x: x[1].excess, default=None)
