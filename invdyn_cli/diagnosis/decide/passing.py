"""Doubt about what comes and goes: several such effects may be one that the catalogue lacks."""

from collections.abc import Mapping, Sequence

from invdyn_cli.diagnosis.decide.doubt import UNKNOWN, or_else
from invdyn_cli.diagnosis.decide.gain import lowers
from invdyn_cli.types import Finding

MOMENT = 0.25
"""[s] Two edges of windows that are no farther apart are of one moment: an edge is known to some tenths of a second."""


def doubted(claims: Sequence[Finding], ends: Mapping[str, tuple[float, float]]) -> list[Finding]:
    """The claims; those that may be of an effect that is not in the catalogue are ambiguous:

    - two of one effect on one joint that act at once have a shape together that none of them has;
    - two effects that come and go on one and the same joint alone, as contacts that no other joint feels and gains: a
      torque at one posture was told as both;
    - what begins or ends in the same moment as another that does more may be a part of it: an encoder that jumps was
      told as a load that comes and a gain that goes.

    Args:
        ends: first and last time [s] of every trajectory; nothing begins or ends there.
    """

    def in_doubt(one: Finding) -> bool:
        return any(
            _at_once(one, other)
            or _on_one_joint(one, other)
            or (_of_a_moment(one, other, ends) and lowers([other]) > lowers([one]))
            for other in claims
        )

    return [or_else(one, UNKNOWN) if in_doubt(one) else one for one in claims]


def perhaps_unknown(findings: Sequence[Finding]) -> list[Finding]:
    """The anomalies, and what comes and goes, that may be of an effect that is not in the catalogue."""
    return [f for f in findings if UNKNOWN in f.alternatives and (f.window is not None or f.group != "standard")]


def _at_once(one: Finding, other: Finding) -> bool:
    """Whether both are of one effect on one joint, and act at the same time."""
    if one is other or (one.effect, one.joint, one.trajectory) != (other.effect, other.joint, other.trajectory):
        return False
    a, b = one.window, other.window
    return a is not None and b is not None and max(a[0], b[0]) < min(a[1], b[1])


def _on_one_joint(one: Finding, other: Finding) -> bool:
    """Whether two effects that come and go lower the error of one and the same joint, and of no other."""
    lowered = [{j for j, g in x.gain.items() if g.rmse_after < g.rmse_before} for x in (one, other)]
    both = one.window is not None and other.window is not None and one.effect != other.effect
    return both and len(lowered[0]) == 1 and lowered[0] == lowered[1]


def _of_a_moment(one: Finding, other: Finding, ends: Mapping[str, tuple[float, float]]) -> bool:
    """Whether two different effects, or one on two joints, begin or end in the same moment of a trajectory."""
    if (one.effect, one.joint) == (other.effect, other.joint) or one.trajectory != other.trajectory:
        return False
    return any(abs(a - b) <= MOMENT for a in _edges(one, ends) for b in _edges(other, ends))


def _edges(one: Finding, ends: Mapping[str, tuple[float, float]]) -> list[float]:
    """When it begins and when it ends, unless that is the beginning or the end of its trajectory."""
    if one.window is None or one.trajectory is None:
        return []
    first, last = ends[one.trajectory]
    return [x for x in one.window if first + MOMENT < x < last - MOMENT]
