"""Effects as a row of numbers for a least-squares step, and back."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invdyn_cli.diagnosis.columns.evidence import Evidence
from invdyn_cli.effects.composition import EffectInstance

REACH = 0.2
"""[m] Prior scale of a force's distance from the origin of its joint's frame, along each axis."""

EDGES = ("start", "end")
"""Coordinates of a window [s]."""


def flat(evidence: Evidence, acting: Sequence[EffectInstance]) -> tuple[np.ndarray, tuple[tuple[int, str, int], ...]]:
    """All coordinates in one row, and the meaning of each: (effect number, parameter or "" for coefficients in which
    the torque is linear, index)."""
    values, labels = [], []
    for number, a in enumerate(acting):
        row = coordinates(evidence, a)
        if row is not None:
            place = a.parameters.get(a.effect.placed_by, ())
            values += [*row, *map(float, place)]
            labels += [(number, "", index) for index in range(len(row))]
            labels += [(number, a.effect.placed_by, index) for index in range(len(place))]
        else:
            refined = {name: x for name, x in a.parameters.items() if name not in a.effect.chosen}
            values += [float(x) for x in refined.values()]
            labels += [(number, name, 0) for name in refined]
        if a.when is not None:
            values += [a.when.start, a.when.end]
            labels += [(number, name, 0) for name in EDGES]
    return np.array(values), tuple(labels)


def coordinates(evidence: Evidence, acting: EffectInstance) -> list[float] | None:
    """The coefficients of bodies and forces in which the torque is linear; None for other effects."""
    return acting.effect.coordinates(acting.parameters, evidence.robot, acting.joint)


def with_parameters(
    evidence: Evidence, acting: Sequence[EffectInstance], labels, theta: np.ndarray
) -> tuple[EffectInstance, ...]:
    """The effects with parameters from one row of coordinates."""
    made = []
    for number, a in enumerate(acting):
        own = {(name, index): x for (k, name, index), x in zip(labels, theta, strict=True) if k == number}
        linear = [x for (name, _), x in own.items() if not name]
        place = [x for (name, _), x in own.items() if name and name == a.effect.placed_by]
        if a.when is not None:
            a = replace(a, when=a.when._replace(**{name: float(own[name, 0]) for name in EDGES}))
        if linear:
            trial = {**a.parameters, a.effect.placed_by: place} if place else a.parameters
            made.append(replace(a, parameters=a.effect.found(linear, trial, evidence.robot, a.joint)))
        else:
            refined = {name: float(x) for (name, _), x in own.items() if name not in EDGES}
            made.append(replace(a, parameters={**a.parameters, **refined}))
    return tuple(made)


def inside(evidence: Evidence, acting: Sequence[EffectInstance], labels, theta: np.ndarray) -> np.ndarray:
    """Parameters moved back into their physical bounds, and windows into their trajectory."""
    lower, upper = np.full(len(theta), -np.inf), np.full(len(theta), np.inf)
    for i, (number, name, _) in enumerate(labels):
        a = acting[number]
        if name in EDGES and a.when is not None:
            lower[i], upper[i] = evidence.recording.ends[a.when.trajectory]
        elif name in a.effect.parameters:
            lower[i], upper[i] = a.effect.parameters[name].lower, a.effect.parameters[name].upper
    return np.clip(theta, lower, upper)


def precision_of(evidence: Evidence, acting: Sequence[EffectInstance], labels) -> np.ndarray:
    """Prior of the coordinates: those of a body or a force that the data do not determine stay near zero."""
    out = np.zeros(len(labels))
    for number, a in enumerate(acting):
        own = [k for k, (of, name, _) in enumerate(labels) if of == number and not name]
        if own:
            out[own] = a.effect.precision(evidence.robot, a.joint, len(own))
        place = [k for k, (of, name, _) in enumerate(labels) if of == number and name and name == a.effect.placed_by]
        out[place] = REACH**-2
    return out
