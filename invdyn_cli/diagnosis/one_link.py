"""One link whose mass is off by far more than that of the others, beside errors of all links: a part that was
exchanged, a wrong density. Its centre and its shape are taken from the URDF, so that one number says it all."""

from collections.abc import Sequence

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Evidence, judged
from invdyn_cli.diagnosis.decide.gain import gain_of
from invdyn_cli.diagnosis.decide.intervals import reach
from invdyn_cli.diagnosis.standard import Beside
from invdyn_cli.diagnosis.standard_columns import LINK, least_of, stretches
from invdyn_cli.effects.composition import EffectInstance
from invdyn_cli.maths import standard
from invdyn_cli.types import Finding, Quantity

PLAINLY = 15.0
"""Nats of evidence by which one link must be better than none; on clean logs of worn arms the best has up to 12."""

SIZE, LARGE = 0.5, 0.15
"""Prior standard deviation of the share by which its mass is off, and the share up to which it is wear. Its size is
told beside links that are off by the USUAL share."""


def claimed(
    evidence: Evidence, more: Beside, left: np.ndarray, acting: Sequence[EffectInstance]
) -> list[tuple[Finding, np.ndarray]]:
    """The finding, if the log proves one, and what it adds to the torque (R, n). The last link is left out: what it
    lacks is a payload.

    Args:
        more: the standard model beside what was found.
        left: (R, n) what these effects, `acting`, leave without it.
    """
    robot, columns = evidence.robot, more.columns
    rows, count = np.ones(len(evidence.role), bool), len(more.found.theta)
    motions, prior, times = columns.asked(left, rows, standard.link_scales(robot), least_of(columns, acting))
    heavier = np.zeros((robot.dofs - 1, count))
    for i, link in enumerate(heavier):
        link[10 * i : 10 * i + 10] = robot.inertial[i]
    before = max(standard.of_shares(motions, prior, times).values())
    tried = [standard.with_one_more(motions, prior, x, SIZE) for x in heavier]
    gains = np.array([max(standard.of_shares(*x, times).values()) - before for x in tried])
    if gains.max(initial=0.0) < PLAINLY:
        return []
    i = int(np.argmax(gains))
    every, wider = tried[i]
    fitted = standard.fit(every, wider, times, standard.USUAL)
    parts, _ = standard.with_one_more([columns.sums(left, x) for x in stretches(rows)], prior, heavier[i], SIZE)
    mass, of_mass = float(robot.inertial[i, 0]), np.zeros(count + 1)
    of_mass[[10 * i, -1]] = 1.0, mass
    scatter = standard.replicas(parts, wider, times, standard.USUAL) @ of_mass
    change, std = float(of_mass @ fitted.theta), np.sqrt(of_mass @ fitted.covariance @ of_mass)
    half = float(reach([scatter[:, None]], np.array([[std]]))[0])
    own, held = columns.of(change / mass * heavier[i]), judged(evidence)
    made = {j: gain_of(evidence, k, more.residual + own, more.residual) for k, j in enumerate(robot.joints)}
    gain = {j: x for j, x in made.items() if x is not None and x.interval95[0] > 0}
    if not gain or abs(change) < max(half, LARGE * mass):
        return []
    torque = np.sqrt(np.mean(np.stack([own, evidence.tau])[:, held] ** 2, axis=1))
    facts = {
        "rms_of_term_N_m": dict(zip(robot.joints, torque[0].tolist(), strict=True)),
        "share_of_torque": dict(zip(robot.joints, (torque[0] / torque[1]).tolist(), strict=True)),
        "share_of_mass": change / mass,
        "nats": float(gains[i]),
    }
    doubt = bool(np.any(np.delete(gains, i) > gains[i] - standard.OPEN))
    finding = Finding(
        LINK.name,
        robot.joints[i],
        "ambiguous" if doubt else "named",
        alternatives=((LINK.name,),) * doubt,
        parameters={"mass": Quantity(change, "kg", [change - half, change + half])},
        gain=gain,
        evidence=facts,
        advice=LINK.advice * doubt,
        group="standard",
    )
    return [(finding, own)]
