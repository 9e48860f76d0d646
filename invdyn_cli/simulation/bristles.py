"""Friction that is a spring before it slides: Dahl's bristles, whose bending is a state of the simulation.

force = stiffness z,   dz/dt = qd - stiffness / coulomb abs(qd) z                            (Dahl, 1968)
"""

from dataclasses import dataclass
from math import copysign, exp, expm1

SOFT = 1.0
"""[-] (step times natural frequency)^2 up to which a bristle is stepped explicitly, which is of second order; unstable
from 4 on."""


@dataclass(frozen=True)
class Bristle:
    """One joint's column, its sliding friction `coulomb` [N m; N] above 0, and `stiffness` [N m/rad; N/m]."""

    joint: int
    coulomb: float
    stiffness: float


class Bent:
    """A bristle in motion: mutable, used for one simulation, not bent at the beginning.

    A wrist on stiff bristles can be faster than the steps of the physics. Then a part of the force is evaluated at the
    end of the step, as damping that is integrated implicitly: this is stable for any stiffness.

    Args:
        bristle: it.
        inertia: [kg m^2; kg] the least that its joint moves.
        step: [s] of the physics.
    """

    def __init__(self, bristle: Bristle, inertia: float, step: float) -> None:
        self.joint, self.force = bristle.joint, 0.0
        self._coulomb, self._way = bristle.coulomb, step * bristle.stiffness / bristle.coulomb
        fast = 2 * bristle.stiffness * step**2 / inertia  # turning back, a bent bristle is twice as stiff
        self._ahead = step * bristle.stiffness * max(0.0, 0.5 * (1 - SOFT / fast))

    def damping(self, qd: float) -> float:
        """[N m s/rad] Damping that includes the change of the force within the next step, if steps are too long."""
        if not self._ahead or not qd:
            return self._ahead
        return self._ahead * min(2.0, max(0.0, 1 - copysign(self.force, self.force * qd) / self._coulomb))

    def advance(self, qd: float) -> None:
        """One step at velocity qd, exactly."""
        way = self._way * abs(qd)
        self.force = self.force * exp(-way) - copysign(self._coulomb, qd) * expm1(-way)
