"""Doubt about what comes and goes: several such effects may be one that the catalogue lacks."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from invdyn_cli.diagnosis.decide.gain import lowers
from invdyn_cli.recording.pieces import Recording
from invdyn_cli.types import Finding

MOMENT = 0.25
"""[s] Two edges of windows that are no farther apart are of one moment: an edge is known to some tenths of a second."""

UNKNOWN = ("unknown",)


def doubted(claims: Sequence[Finding], ends: Mapping[str, tuple[float, float]]) -> list[Finding]:
    """The claims; those that may be of an effect that is not in the catalogue are ambiguous:

    - two of one effect on one joint that act at once have a shape together that none of them has; what else comes and
      goes on the joints that feel them, and on no other, may be that, too;
    - what begins or ends in the same moment as another that does more may be a part of it: an encoder that jumps was
      told as a load that comes and a gain that goes.

    Args:
        ends: first and last time [s] of every trajectory; nothing begins or ends there.
    """
    odd = {i for i, one in enumerate(claims) if any(_at_once(one, other) for other in claims)}
    felt = {joint for i in odd for joint in claims[i].gain}
    for i, one in enumerate(claims):
        beside = one.window is not None and bool(one.gain) and felt >= one.gain.keys()
        if beside or any(_of_a_moment(one, x, ends) and lowers([x]) > lowers([one]) for x in claims):
            odd.add(i)
    return [_unknown(one) if i in odd else one for i, one in enumerate(claims)]


def ends(recording: Recording) -> dict[str, tuple[float, float]]:
    """First and last time [s] of every trajectory."""
    found: dict[str, tuple[float, float]] = {}
    for piece in recording.pieces:
        first, last = found.get(piece.trajectory, (np.inf, -np.inf))
        found[piece.trajectory] = min(first, float(piece.t[0])), max(last, float(piece.t[-1]))
    return found


def _at_once(one: Finding, other: Finding) -> bool:
    """Whether both are of one effect on one joint, and act at the same time."""
    if one is other or (one.effect, one.joint, one.trajectory) != (other.effect, other.joint, other.trajectory):
        return False
    a, b = one.window, other.window
    return a is not None and b is not None and max(a[0], b[0]) < min(a[1], b[1])


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


def _unknown(one: Finding) -> Finding:
    return replace(one, status="ambiguous", alternatives=tuple(dict.fromkeys((*one.alternatives, UNKNOWN))))
