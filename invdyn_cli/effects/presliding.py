"""Presliding: friction with a memory, before a joint slides."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import copysign, exp
from typing import Any

import numpy as np

from invdyn_cli.interfaces import AbstractTorqueEffect, JointState, Parameter, Parameters
from invdyn_cli.joints import SimulatorTerms, UsualJoint
from invdyn_cli.types import Array

USUAL_LENGTH = 0.005
"""[rad; m] Distance after which two thirds of the friction are reached."""

SHORTEST = 1e-9
"""[rad] Shortest bending distance of the bristles."""

SOFTEST = 1e-3
"""[N m/rad; N/m] Least stiffness of the bristles."""


@dataclass(frozen=True)
class PreslidingHysteresis(AbstractTorqueEffect):
    """Friction with a memory: bristles that bend before they slide. It depends on the distance since the joint last
    reversed, not on speed; after coulomb/stiffness [rad] two thirds of the level are reached.

    Attributes:
        lengths: coulomb/stiffness to try [rad]; the found one is refined between them.
    """

    lengths: tuple[float, ...] = (0.0005, 0.001, 0.002, 0.004, 0.008, 0.016, 0.032, 0.064)

    name = "presliding_hysteresis"
    title = "presliding hysteresis"
    friction = True
    meaning = "Friction that yields like a spring after every reversal, before the joint slides."
    equation = "stiffness z, dz/dt = qd − stiffness/coulomb |qd| z"
    reference = "Dahl, AIAA Journal 1976; Canudas de Wit, Olsson, Åström and Lischinsky, IEEE TAC 1995"
    parameters = {"coulomb": Parameter("N m", 0.0), "stiffness": Parameter("N m/rad", SOFTEST)}
    confounders = (("coulomb_friction",), ("stribeck_friction",), ("backlash",))
    contains = ("coulomb_friction",)
    contains_as_limit = True
    nonlinear = ("stiffness",)
    advice = (
        "reversals of a few milliradians, slow and fast: presliding friction depends on the distance since the "
        "reversal, not on speed"
    )
    panels = ("loops_over_position",)
    needs = ("motion", "reversals", "creep")
    shows = ("reversals",)

    def typical(self, usual: UsualJoint) -> dict[str, Any]:
        return {"coulomb": usual.level, "stiffness": usual.level / USUAL_LENGTH}

    def in_simulator(self, parameters: Parameters) -> SimulatorTerms:
        level = parameters["coulomb"]
        return SimulatorTerms(
            {"friction": level}, lost=f"is represented as dry friction of {level:.3g}, without memory"
        )

    def term(self, parameters: Parameters, state: JointState) -> Array:
        return parameters["coulomb"] * _bristle(state, self.shape_of(parameters)["length"])

    def travel(self, parameters: Parameters) -> float:
        return parameters["coulomb"] / max(parameters["stiffness"], SOFTEST)

    def shapes(self, state: JointState) -> Sequence[Parameters]:
        return [{"length": x} for x in self.lengths]

    def shape_of(self, parameters: Parameters) -> Parameters:
        return {"length": max(self.travel(parameters), SHORTEST)}

    def basis(self, state: JointState, shape: Parameters) -> Sequence[Array]:
        return (_bristle(state, shape["length"]),)

    def read(self, coefficients: Sequence[float], shape: Parameters) -> dict[str, float]:
        return {"coulomb": coefficients[0], "stiffness": coefficients[0] / shape["length"]}


TREMBLE = 0.02
"""Share of that distance by which a joint must go back to count as reversed, so that encoder noise at rest has no
effect."""


def _bristle(state: JointState, length: float) -> Array:
    """Bending of the bristles over its largest (T,), exact where the joint moves evenly between samples. In the
    beginning, and of one sample, which has no memory, it is what it comes to: the sign of the velocity."""
    if np.ndim(state.q) == 0:
        return state.sign
    first = float(np.trunc(state.sign[0])) if state.before is None else 0.0
    angles = np.concatenate([() if state.before is None else state.before, state.q])
    out, bent, at, towards = [], first, angles[0], 0.0
    for q in angles.tolist():
        step = q - at
        if step * towards > 0 or abs(step) > TREMBLE * length:
            keep = exp(-abs(step) / length)
            bent = keep * bent + copysign(1 - keep, step)
            at, towards = q, step
        out.append(bent)
    return np.array(out[-len(state.q) :])
