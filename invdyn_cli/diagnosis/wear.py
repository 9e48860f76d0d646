"""Worn arms: whether a log asks for links that are all a little off, as one candidate beside every hypothesis.

A share of the links' own scales says by how much (`maths.standard`); what the log shows of it are the directions that
make a torque beyond noise.
"""

from collections.abc import Sequence

import numpy as np

from invdyn_cli.diagnosis.columns.candidates import trial_at
from invdyn_cli.diagnosis.columns.evidence import Candidate, Evidence
from invdyn_cli.diagnosis.columns.links import with_links
from invdyn_cli.diagnosis.search.believed import volume
from invdyn_cli.diagnosis.search.further import others_of
from invdyn_cli.diagnosis.search.inquiry import Inquiry
from invdyn_cli.diagnosis.search.judge import PRICE_OF_COEFFICIENT, Hypothesis
from invdyn_cli.diagnosis.search.noise import MOVES, measure
from invdyn_cli.diagnosis.standard import CLAIMED
from invdyn_cli.diagnosis.standard_columns import LINK, Columns, least_of, std_of
from invdyn_cli.effects.composition import EffectInstance
from invdyn_cli.maths.standard import USUAL, Standard, link_scales

WORN = 0.005
"""Share of its scales below which a link is as its URDF has it: clocks and filters leave that much."""

PLAINLY, SURE, HEARD = 0.75, 4.0, 0.5
"""Share of the joints that have friction, so many standard deviations above zero, on an arm that is worn for sure; of
those that move, of whose torque less than that is left, and, where links are right, on which the least that can be
claimed would be as sure."""

FELT = 0.1
"""Noise variances of torque on a whole log, below which a direction of the links' parameters does not show."""


def worn_links(columns: Columns, weights: np.ndarray, share: float, moved: np.ndarray | None = None) -> Hypothesis:
    """All links off by a share of their scales, as one candidate that is part of every hypothesis: the directions of
    their parameters that make FELT noise variances of torque at least, `weights` (n,) being the inverse of a row's; in
    units of the USUAL share, so that a precision of one is that (`Inquiry.always_usual`). Where the evidence's links
    are `moved` (10 n,) from the URDF's already, a fixed column takes that back in these directions, so that the prior's
    mean is the URDF and not a fit to the same rows."""
    evidence, n = columns.evidence, columns.evidence.dofs
    scale = share * link_scales(evidence.robot).ravel()
    rows = [np.where(evidence.valid[:, j], columns.links[:, j], 0.0) * scale[:, None] for j in range(n)]
    normal = np.sum([w * x @ x.T for w, x in zip(weights, rows, strict=True)], axis=0)
    values, vectors = np.linalg.eigh(normal)
    scale *= USUAL / share
    moves = vectors[:, values > FELT].T * scale
    if not len(moves):
        return ()
    where = {}
    for j in range(n):
        made = moves @ columns.links[:, j]
        fixed = () if moved is None else evidence.append(j, [-(moves @ (moved / scale**2)) @ made])
        where[j] = fixed, evidence.append(j, list(made))
    return (Candidate(LINK, None, {}, where, np.full(len(moves), (USUAL / share) ** 2)),)


def unsure_links(columns: Columns, inquiry: Inquiry) -> Hypothesis:
    """Links that are off by as much as a log leaves open, where a load was found: what it takes up of their errors does
    not show, and links beside it seem better than they are. Nothing where none was found."""
    acting = inquiry.chosen.acting
    others = [a for a in acting if not a.effect.load or a.when is not None]
    if len(others) == len(acting):
        return ()
    choosing = inquiry.evidence.of_role("train")
    share = columns.behind(others).widest(inquiry.model.residual(others), choosing)
    return worn_links(columns, inquiry.noise.weights, share)


def is_worn(inquiry: Inquiry, other: Hypothesis) -> bool:
    """Whether a hypothesis beside the standard model does better than another without. Links, all of them a little off
    or some of them by themselves, are paid for as by the marginal likelihood, by the volume that the log leaves of what
    was believed of them (MacKay 1992); other standard terms by their coefficients. What clocks and filters leave
    (`judge.RELEVANT`) is no evidence that all links are off, nor that several are wrong by themselves."""
    judge, apart = inquiry.judge, inquiry.always[: len(inquiry.always) - len(inquiry.wear)]
    judge.refresh()

    def loss(always: Hypothesis, hypothesis: Hypothesis, standard: Hypothesis) -> float:
        links = tuple(c for c in standard if c.effect is LINK)
        terms = PRICE_OF_COEFFICIENT * sum(judge.freedom(c) for c in standard if c.effect is not LINK)
        return judge.loss((*always, *hypothesis)) - judge.price(standard) + volume(judge, links) + terms

    found = tuple(c for c in other if c.effect.group == "standard")
    gain = loss(apart, other, found) - loss(inquiry.always, inquiry.hypothesis, inquiry.wear)
    several = sum(c.effect is LINK for c in found) > 1
    return gain > (-judge.least[None] if several else judge.least[None])


def of(columns: Columns, inquiry: Inquiry) -> Standard | None:
    """The standard model beside all that was found but errors of single links, if the log asks for it and for links
    that are off by a share of their scales; else None."""
    acting = [a for a in inquiry.chosen.acting if a.effect is not LINK]
    choosing = inquiry.evidence.of_role("train")
    return _asked_for(columns.behind(acting).fit(inquiry.model.residual(acting), choosing, least_of(columns, acting)))


def plain(columns: Columns, residual: np.ndarray) -> Standard | None:
    """The standard model of a `residual` (R, n) beside nothing else, if it is plain from it alone that the arm is worn:
    PLAINLY of the joints that would show it have a friction that can be claimed. No single cause makes that, so the arm
    is not looked at as if it were as its URDF says, though its links may be. Links that seem to be off without being
    asked for may be a load that comes and goes: nothing is plain then."""
    evidence = columns.evidence
    choosing = evidence.of_role("train")
    fitted = columns.fit(residual, choosing)
    right = fitted.gain > 0 and fitted.share <= WORN
    if not right and _asked_for(fitted) is None:
        return None
    of_friction = [t for t, term in enumerate(columns.terms) if term in ("coulomb", "viscous")]
    value, std = (columns.split(x)[1][of_friction] for x in (fitted.theta, std_of(fitted)))
    made = np.sqrt(np.mean(columns.own[of_friction][:, :, choosing] ** 2, axis=2))
    whole = np.sqrt(np.mean(evidence.tau[choosing] ** 2, axis=0))
    moves = (evidence.valid & choosing[:, None]).sum(0) > MOVES * choosing.sum()
    moves &= fitted.noise < HEARD * whole
    worn = np.any((value > SURE * std) & (value * made > CLAIMED * whole), axis=0)
    if right:
        moves &= worn | np.any(SURE * std * made < CLAIMED * whole, axis=0)
    return fitted if np.sum(worn & moves) >= max(2, np.ceil(PLAINLY * moves.sum())) else None


def _asked_for(fitted: Standard) -> Standard | None:
    return fitted if min(fitted.gain, fitted.of_inertial) > 0 and fitted.share > WORN else None


def beside(
    columns: Columns, wear: Standard, weights: np.ndarray | None = None, acting: Sequence[EffectInstance] = ()
) -> tuple[Evidence, Hypothesis, Hypothesis]:
    """The evidence with links as the standard model has them, `worn_links`, and the anomalies among what was found that
    last, as trials there; `weights` (n,) are the inverse of a row's noise variance, if it is known."""
    evidence, found = columns.evidence, [a for a in acting if a.when is None]
    moved, _ = columns.split(wear.theta)
    worn = with_links(evidence, np.asarray(evidence.robot.inertial) + moved)
    weights = measure(worn, worn.of_role("train")).weights if weights is None else weights
    links = worn_links(columns, weights, min(wear.share, USUAL), moved.ravel())
    start = [trial_at(worn, a, others_of(found, a)) for a in found if a.effect.group != "standard"]
    return worn, links, tuple(start)
