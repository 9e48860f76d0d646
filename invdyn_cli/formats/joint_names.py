"""Which names of joints mean the same joint: those of a log's columns beside those of a robot, in any order."""

import re
from collections.abc import Callable, Sequence

from invdyn_cli.formats.words import FILLERS

_TOKEN = re.compile(r"[^\W\d_]+|\d+")

Words = tuple[str, ...]


def matched(names: Sequence[str], wanted: Sequence[str]) -> list[int] | None:
    """The index in `names` of every one of `wanted`; None unless each has one of its own.

    Names are compared as they are, then without case and separators, then without words such as "joint" and "j", and
    last one may be the beginning or the end of the other: "j3_quill", "J3-Quill", "3_quill" and "quill" may be one.
    """
    for one in _RULES:
        found = [[i for i, name in enumerate(names) if one(name, want)] for want in wanted]
        if all(len(x) == 1 for x in found) and len({x[0] for x in found}) == len(wanted):
            return [x[0] for x in found]
    return None


def elsewhere(names: Sequence[str], wanted: Sequence[str]) -> list[tuple[str, str]]:
    """(name, the one of `wanted` that alone matches it) where that is not the one at the same place."""
    found = []
    for place, name in enumerate(names):
        hits = next((x for one in _RULES if (x := [k for k, want in enumerate(wanted) if one(name, want)])), [])
        if len(hits) == 1 and hits[0] != place:
            found.append((name, wanted[hits[0]]))
    return found


def _words(name: str) -> Words:
    return tuple(_TOKEN.findall(name.lower()))


def _bare(name: str) -> Words:
    """The words without those that stand beside the name of any joint."""
    words = _words(name)
    return tuple(x for x in words if x not in FILLERS) or words


def _is_part(name: str, want: str) -> bool:
    """Whether one is the beginning or the end of the other; a number alone is no such part."""
    short, long = sorted((_bare(name), _bare(want)), key=len)
    return any(not x.isdigit() for x in short) and short in (long[: len(short)], long[-len(short) :])


_RULES: tuple[Callable[[str, str], bool], ...] = (
    lambda name, want: name == want,
    lambda name, want: _words(name) == _words(want),
    lambda name, want: _bare(name) == _bare(want),
    _is_part,
)


def placed(order: Sequence[int], values: Sequence) -> tuple:
    """Values, one for each joint, in another order; one or none for all joints stay as they are."""
    return tuple(values[k] for k in order) if len(values) == len(order) else tuple(values)
