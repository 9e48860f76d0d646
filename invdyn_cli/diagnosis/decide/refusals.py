"""The table of what a claim must reach, row by row: above all, held-out data must be predicted better with the effect,
by more than what stays unexplained on its joint."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Candidate
from invdyn_cli.diagnosis.decide.claim import Claim, exactly, left
from invdyn_cli.diagnosis.search import naming
from invdyn_cli.diagnosis.search.composed import Refined
from invdyn_cli.diagnosis.search.events import PRICE, SHORTEST
from invdyn_cli.diagnosis.search.feigned import EVIDENCE
from invdyn_cli.diagnosis.search.inquiry import Inquiry
from invdyn_cli.diagnosis.search.judge import Hypothesis

OUTWEIGHED = 1.0
"""Least gain of an effect, as a multiple of the variance that stays unexplained on its joint: columns that have little
to do with an unknown cause pick up some percent of it, and more where the arm answers to it."""

PICKED_UP = 0.2
"""What each further coefficient adds to that multiple."""

MIN_SHARE_OF_RESIDUAL = 0.5
"""Least ratio of the squared error that an effect removes on its joints to that which stays there. A controller reacts
to the noise of its encoders, the motion follows, and the noise of the regressor correlates with that of the torque: a
small effect may be an artefact of that."""

ONE_SIZE = 0.75
"""Least share of what an effect makes where the arm moves slowly that may be saved there: 1 for a true one; columns are
approximations."""


@dataclass(frozen=True)
class Refusal:
    """A row of the table: a claim is refused if its figure is below the least one.

    Attributes:
        name: what the figure is (experiments/calibrate.md shows it for right and for false claims).
        figure: a function of the claim.
        least: the least figure of a claim that is not refused.
        why: the report's clause about a refused claim; "" if held-out data do not speak for the effect, because then
            it is not worth a sentence.
    """

    name: str
    figure: Callable[[Claim], float]
    least: float
    why: Callable[[Claim], str] = lambda _: ""


@dataclass(frozen=True)
class Refused:
    """A candidate that is not claimed.

    Attributes:
        candidate: its effect and its place.
        criterion: the name of the row that refused it, or ALIKE.
        figure, required: that row's figure of the candidate, and the least one of a claim; None with ALIKE.
        told: the report's sentence about it; "" if held-out data do not speak for it.
    """

    candidate: Candidate
    criterion: str
    figure: float | None
    required: float | None
    told: str


ALIKE = "no different effect explains the data equally well"
"""What refuses both of such effects."""


MOST = 1e6
"""Largest figure of `over_unknown`."""


def over_unknown(claim: Claim) -> float:
    """The gain of a claim, as a multiple of what its coefficients would explain of an unknown cause; within -MOST and
    MOST, because nothing may stay unknown."""
    needed = OUTWEIGHED + PICKED_UP * (claim.inquiry.judge.freedom(claim.candidate) - 1)
    return float(np.clip(claim.gain / max(needed * claim.unknown, 1e-300), -MOST, MOST))


def _why_unknown(claim: Claim) -> str:
    gains = "most of its gain may come from what stays unexplained on that joint"
    return gains if claim.gain > 0 else ""


USUAL_LINKS = Refusal(
    "evidence beside link errors of the usual size",
    lambda x: x.evidence_beside_usual_links if x.inquiry.wear else np.inf,
    0.0,
    lambda _: "errors of the links' inertials, of the size that URDFs usually have, explain the data as well",
)

REFUSALS = (
    Refusal("gain over what stays unknown", over_unknown, 1.0, _why_unknown),
    Refusal("gain on its own joint", lambda x: x.gain_on_its_joint, -naming.LEAST_DIFFERENCE),
    Refusal(
        "least gain by its interval",
        lambda x: x.least_gain,
        np.nextafter(0, 1),
        lambda _: "the 95 % interval of its gain, the decrease of the held-out error, contains zero",
    ),
    Refusal(
        "share of its torque confirmed at motion frequencies",
        lambda x: x.slow_gain,
        ONE_SIZE,
        lambda _: "its size at the frequencies of the motion differs from that at those of encoder noise",
    ),
    Refusal(
        "evidence beside the standard model, at motion frequencies",
        lambda x: x.slow_evidence if x.inquiry.wear else np.inf,
        EVIDENCE,
    ),
    USUAL_LINKS,
    Refusal(
        "delay over the sampling period",
        lambda x: x.delay / x.inquiry.evidence.recording.period,
        1.0,
        lambda x: (
            f"the delay may be as short as {1e3 * max(x.delay, 0.0):.2g} ms, less than one sampling period, and may be "
            "caused by the log's clock"
        ),
    ),
    Refusal(
        "least size by its interval", lambda x: x.size, np.nextafter(0, 1), lambda _: "its 95 % interval contains zero"
    ),
    Refusal(
        "distance from no force",
        lambda x: x.distance,
        PRICE,
        lambda _: "its size is no surer than that of the best of many windows of noise",
    ),
    Refusal(
        "length of its window",
        lambda x: x.lasts,
        SHORTEST,
        lambda x: f"it would act for {x.lasts:.2g} s only, and a jolt looks like it",
    ),
    Refusal("possible size", lambda x: float(not x.impossible), 1.0, lambda x: f"its {x.impossible}"),
    Refusal(
        "gain over the residual",
        lambda x: x.share_of_residual,
        MIN_SHARE_OF_RESIDUAL,
        lambda _: (
            "it is small compared with the residual, and may be an artefact of encoder noise in the feedback loop"
        ),
    ),
    Refusal(
        "excess loss of the best impossible effect in its place",
        lambda x: x.beaten,
        -naming.LEAST_DIFFERENCE,
        lambda _: "another effect explains the data better, although only with a physically impossible size",
    ),
)
"""What a claim must reach, in this order."""


def supported(
    inquiry: Inquiry, refusals: Sequence[Refusal] = REFUSALS
) -> tuple[Inquiry, list[Claim], tuple[Refined, Refined], tuple[Refused, ...]]:
    """The claims that no row refuses; their exact parameters on all rows, and on the data that chose, refined again
    after each refusal; and the refused candidates, with a sentence on each for which held-out data speak. A candidate
    in whose place another effect does equally well gets no sentence, because it is chance which of them was tried.
    First comes the inquiry that they are of: where USUAL_LINKS refuse one, the others are judged beside such links,
    too."""
    hypothesis, exact, out = inquiry.hypothesis, (inquiry.whole, inquiry.chosen), []
    beside: dict[tuple, Hypothesis] = {}  # of a candidate that nothing spoke against, those that were refused
    while True:
        rows, after = inquiry.judge.rows, left(inquiry, hypothesis)
        whole, chosen = exact
        exact = exactly(inquiry, hypothesis, whole, np.ones_like(rows)), exactly(inquiry, hypothesis, chosen, rows)
        claims = [Claim(inquiry, hypothesis, i, *exact, after, beside.get(c.key, ())) for i, c in enumerate(hypothesis)]
        refused = [(x, why) for x in claims if (why := refusal(x, refusals))]
        if refused:
            worst, row = min(refused, key=lambda x: x[0].evidence if inquiry.wear else x[0].gain)
            place, why = worst.place, row.why(worst)
            for other in {x.key for x in claims} - {x.key for x, _ in refused}:
                beside[other] = (*beside.get(other, ()), worst.candidate)
            inquiry = inquiry.beside_usual_links() if row is USUAL_LINKS else inquiry
            name, told = _titled(inquiry, worst.candidate), ""
            if why and not any(r.equal for r in worst.rivals):
                told = f"{name[0].upper()}{name[1:]} was tried, but it is not claimed: {why}."
            out.append(Refused(worst.candidate, row.name, float(row.figure(worst)), round(float(row.least), 9), told))
        elif inquiry.wear and (vague := _vague(claims)):
            place, rival = vague
            one, other = sorted(_titled(inquiry, x) for x in (hypothesis[place], rival.candidate))
            told = f"Neither {one} nor {other} is claimed: these different effects explain the data equally well."
            out.append(Refused(hypothesis[place], ALIKE, None, None, told))
        else:
            break
        hypothesis = hypothesis[:place] + hypothesis[place + 1 :]
        around = inquiry.beside(hypothesis)
        hypothesis = naming.simplified(inquiry.judge, around, hypothesis, inquiry.pool, inquiry.wear)
    passing = {c.effect.name for c in hypothesis if c.when is not None}
    # that a second event of a claimed effect is not claimed would seem to deny that
    out = [replace(x, told="") if x.candidate.effect.name in passing else x for x in out]
    return inquiry, claims, exact, tuple(out)


def refusal(claim: Claim, refusals: Sequence[Refusal] = REFUSALS) -> Refusal | None:
    """The first row that refuses a claim; None if it may be claimed."""
    return next((row for row in refusals if row.figure(claim) < row.least), None)


def _titled(inquiry: Inquiry, one: Candidate) -> str:
    """A candidate in a sentence: its effect and its joint."""
    return one.effect.title + (f" on {inquiry.evidence.robot.joints[one.joint]}" if one.joint is not None else "")


def _vague(claims: Sequence[Claim]) -> tuple[int, naming.Rival] | None:
    """Among claims beside the standard model in whose place an effect that is none of their confounders does equally
    well, the one whose rival has the smallest excess loss, and that rival; None if there is none. What so different
    effects explain alike is too little to have a name."""
    found: list[tuple[int, naming.Rival]] = []
    for claim in claims:
        one = claim.candidate
        like = {one.effect.name, *(name for names in one.effect.confounders for name in names)}
        others = [r for r in claim.rivals if r.equal]
        others = [r for r in others if not (one.effect.load and r.candidate.effect.load)]
        found += [(claim.place, r) for r in others if r.candidate.effect.name not in like]
    return min(found, key=lambda x: x[1].excess, default=None)
