"""Effects that are the sum of others (`AbstractEffect.sum_of`): nothing in the motion tells the sum from its parts.

Coulomb friction beside a torque offset is friction that differs by direction.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from invdyn_cli.diagnosis.decide.doubt import or_else
from invdyn_cli.diagnosis.search.judge import Hypothesis
from invdyn_cli.interfaces import AbstractEffect
from invdyn_cli.types import Finding

UNEVEN = 2 / 3
"""Ratio of the smallest to the largest level of a sum, below which it may be meant: each is then farther than a fifth
from their mean. So much asymmetry is usual (Elhami and Brookfield 1996), and a small offset is in most drives."""


@dataclass(frozen=True)
class Sum:
    """Such an effect, and the positions of its parts in the hypothesis."""

    effect: AbstractEffect
    places: tuple[int, ...]


def standing(
    effects: Mapping[str, AbstractEffect], hypothesis: Hypothesis, ends: Sequence[Mapping[str, tuple]]
) -> list[Sum]:
    """The sums of effects on the same joint, if the parameters of the sum are possible."""
    keys = [c.key for c in hypothesis]
    made = []
    for effect in effects.values():
        for joint in {c.joint for c in hypothesis} if effect.sum_of else ():
            if not all((name, joint) in keys for name in effect.sum_of):
                continue
            places = tuple(keys.index((name, joint)) for name in effect.sum_of)
            sizes = [next(iter(ends[k].values()))[0] for k in places]
            if not effect.refuse(sizes_of(effect, sizes)):
                made.append(Sum(effect, places))
    return made


def sizes_of(effect: AbstractEffect, sizes: Sequence[Any]) -> dict[str, Any]:
    """Parameters of a sum from those of its parts, one of each."""
    parts = list(zip(effect.sum_of.values(), sizes, strict=True))
    return {name: sum(share[name] * x for share, x in parts) for name in effect.parameters}


def hidden(effects: Mapping[str, AbstractEffect], hypothesis: Hypothesis, i: int) -> list[str]:
    """Sums of the first part of which this is one, and the others of which another effect of the joint contains: a
    spring's rest holds what makes friction differ by direction."""
    own = hypothesis[i]
    beside = {name for c in hypothesis if c.joint == own.joint and c is not own for name in c.effect.contains}
    sums = [(name, list(e.sum_of)) for name, e in effects.items() if e.sum_of]
    return [name for name, parts in sums if own.effect.name == parts[0] and set(parts[1:]) <= beside]


def uneven(effects: Mapping[str, AbstractEffect], found: Sequence[Finding]) -> list[Finding]:
    """Standard terms (every parameter a level of torque); the last part of a sum whose levels are plainly UNEVEN is
    ambiguous with it."""
    sizes = {(f.effect, f.joint): next(iter(f.parameters.values())).value for f in found}

    def doubt(f: Finding) -> tuple[tuple[str, ...], ...]:
        sums = [e for e in effects.values() if e.sum_of and f.effect == [*e.sum_of][-1]]
        whole = [e for e in sums if all((name, f.joint) in sizes for name in e.sum_of)]
        levels = [(e, sizes_of(e, [sizes[name, f.joint] for name in e.sum_of])) for e in whole]
        return tuple((e.name,) for e, x in levels if not e.refuse(x) and min(x.values()) < UNEVEN * max(x.values()))

    told = ((f, doubt(f)) for f in found)
    return [or_else(f, *others) if others else f for f, others in told]
