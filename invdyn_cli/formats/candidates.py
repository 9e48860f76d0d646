"""The columns of a file in groups, each of which may be one channel: one quantity, one kind of name, one column per
joint."""

from collections.abc import Sequence
from dataclasses import dataclass

from invdyn_cli.formats.table import Table
from invdyn_cli.formats.words import FORCES, Meaning, meaning

NAME = "guessed from the name"


@dataclass(frozen=True)
class Candidate:
    """Columns that may be a channel: their common meaning, by joint, and how that is known."""

    meaning: Meaning
    columns: dict[str, str]
    known: str


def meant(table: Table, name: str) -> Meaning:
    """What the format defines of a column; if nothing, what its name says."""
    told = table.told.get(name)
    if told is None:
        return meaning(name)
    commanded = told.channel == "q_ref"
    return Meaning("q" if commanded else told.channel, joint=told.joint, commanded=commanded, unit=told.unit)


def candidates(table: Table) -> list[Candidate]:
    """The columns in groups of one meaning."""
    groups: dict[tuple, dict[str, str]] = {}
    read: dict[tuple, Meaning] = {}
    for name in table.columns:
        one = meant(table, name)
        if not one.quantity:
            continue
        key = (name in table.told, one.quantity, one.word, one.commanded, one.measured, one.link, bool(one.joint))
        while one.joint in groups.get(key, {}):  # two columns that say the same: one of two groups
            key = (*key, "another")
        groups.setdefault(key, {})[one.joint] = name
        read.setdefault(key, one)
    for key in [x for x in groups if read[x].word in FORCES]:  # a slide's force beside torques of the other joints
        of, forces = read[key], groups[key]
        for other, columns in groups.items():
            sides = read[other].quantity, read[other].commanded, read[other].measured, read[other].link
            beside = read[other].word not in FORCES and sides == (of.quantity, of.commanded, of.measured, of.link)
            if beside and not set(forces) & set(columns) and all(columns):
                columns |= forces
    return [Candidate(read[key], columns, table.by if key[0] else NAME) for key, columns in groups.items()]


def in_order(joints: dict[str, str]) -> list[str]:
    """The joints of a group: numbers by size, names as the file has them."""
    return sorted(joints, key=int) if all(x.isdigit() for x in joints) else list(joints)


def ranged(names: Sequence[str]) -> str:
    """The first and the last column's name, for a message."""
    return names[0] if len(names) == 1 else f"{names[0]}:{names[-1]}"
