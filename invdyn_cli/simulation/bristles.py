"""Friction that is a spring before it slides: Dahl's bristles, whose bending is carried from step to step.

force = stiffness z,   dz/dt = qd - stiffness / coulomb abs(qd) z                            (Dahl, 1968)
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

SOFT = 1.0
"""[-] (step times natural frequency)^2 up to which the bristle is stepped explicitly, which is of second order;
unstable from 4 on."""


@dataclass(frozen=True)
class Bristle:
    """One joint's column, its sliding friction `coulomb` [N m; N] above 0, and `stiffness` [N m/rad; N/m]."""

    joint: int
    coulomb: float
    stiffness: float


class Bristles:
    """All bristles of an arm; mutable, alive for one simulation, straight in the beginning.

    A wrist on stiff bristles can be faster than the steps of the physics. What is too fast for them gets as much
    damping, integrated implicitly, as puts that share of the force at the end of the step: stable for any stiffness.

    Args:
        bristles: m of them.
        inertia: (m,) [kg m^2; kg] the least that each joint moves.
        step: [s] of the physics.
    """

    def __init__(self, bristles: Sequence[Bristle], inertia: np.ndarray, step: float) -> None:
        self.joints = np.array([x.joint for x in bristles], int)
        self._coulomb = np.array([x.coulomb for x in bristles])
        self._stiffness = np.array([x.stiffness for x in bristles])
        self._step = step
        fast = 2 * self._stiffness * step**2 / inertia  # turning back, a bent bristle is twice as stiff
        self._ahead = step * self._stiffness * np.maximum(0.0, 0.5 * (1 - SOFT / fast))
        self._z = np.zeros(len(bristles))

    @property
    def force(self) -> np.ndarray:
        """(m,) [N m; N] against the motion."""
        return self._stiffness * self._z

    def damping(self, qd: np.ndarray) -> np.ndarray:
        """(m,) [N m s/rad] by which the force grows within the next step, where that has to be counted in."""
        return self._ahead * np.clip(1 - np.sign(qd) * self.force / self._coulomb, 0.0, 2.0)

    def advance(self, qd: np.ndarray) -> None:
        """One step at velocity qd (m,), exactly."""
        bend = self._coulomb / self._stiffness
        way = np.abs(qd) * self._step / bend
        self._z = self._z * np.exp(-way) - np.sign(qd) * bend * np.expm1(-way)
