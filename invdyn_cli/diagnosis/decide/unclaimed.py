"""What the search found and nobody claims: it may be part of the written model, without a name (docs/decisions/048)."""

from dataclasses import replace

import numpy as np

from invdyn_cli.diagnosis.decide.claim import exactly
from invdyn_cli.diagnosis.decide.findings import Made, sizes
from invdyn_cli.diagnosis.decide.quantities import quantities, tried
from invdyn_cli.diagnosis.search.inquiry import Inquiry
from invdyn_cli.diagnosis.search.judge import Hypothesis
from invdyn_cli.diagnosis.search.steps import clash, free_beside
from invdyn_cli.types import Finding


def unclaimed(inquiry: Inquiry, made: Made) -> Hypothesis:
    """The torques that were found, always act and have a place beside the claims, or in that of a special case which is
    all that may be claimed of them; but standard terms, which the model has anyway."""
    lasting = [c for c in inquiry.hypothesis if c.effect.adds and c.effect.group != "standard" and c.when is None]
    return tuple(free_beside(made.hypothesis, lasting, instead=True))


def together(
    inquiry: Inquiry, made: Made, more: Hypothesis, unsure: Hypothesis = ()
) -> tuple[Made, tuple[Finding, ...]]:
    """The effects of all claims and `more`, fitted together, without claims that are special cases of `more`; and the
    latter, with status "unclaimed". `unsure` as in `findings.report`."""
    claims = (c for c in made.hypothesis if not any(clash(x, c) for x in more))
    hypothesis, rows = (*claims, *more), inquiry.judge.rows
    chosen = exactly(inquiry, hypothesis, inquiry.chosen, rows)
    whole = exactly(inquiry, hypothesis, inquiry.whole, np.ones_like(rows))
    sized, keys = sizes(inquiry, whole, unsure), {c.key for c in more}
    robot, acting = inquiry.evidence.robot, sized.whole.acting
    findings = tuple(
        Finding(
            effect=one.effect.name,
            joint=None if one.joint is None else robot.joints[one.joint],
            status="unclaimed",
            parameters=quantities(robot, one.effect, one.joint, ends) | tried(robot, one),
            evidence={"in_place_of": one.effect.contains},
            group=one.effect.group,
            text=one.effect.text,
        )
        for before, one, ends in zip(whole.acting, acting, sized.ends, strict=True)
        if before.key in keys
    )
    fuller = replace(
        made,
        hypothesis=hypothesis,
        acting=acting,
        intervals=tuple(sized.ends),
        residual=chosen.residual + inquiry.worn(chosen),
        whole=inquiry.model.residual(acting),
    )
    return fuller, findings
