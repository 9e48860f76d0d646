"""Gear: play and elasticity, which let the link move relative to the motor.

The motor's angle is logged; the link's angle is that plus a deflection, and the motor carries the inverse dynamics of
the link's motion. Load is the torque that would keep the link on the motor's motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from invdyn_cli.interfaces import AbstractGearEffect, Parameter, Parameters
from invdyn_cli.joints import SimulatorTerms, UsualJoint
from invdyn_cli.types import Array

STRETCH = 128
"""Samples of a stretch of a spring's motion; all stretches are computed in parallel."""

STANDS = 2e-3
"""[rad/s; m/s] Velocity of a motor below which the friction of its link has no side of its own."""

USUAL_GAP, USUAL_RESONANCE = 0.003, 12.0
"""[rad; m] of play of an ordinary gear, 10 minutes of arc; and [Hz] of a link on its joint's spring, motor held."""

BLOW, SLOWED = 1, 1.5
"""Samples that the blow of flanks that meet may last: filters spread it. It does where the motor's own deceleration
then takes that much of the link's speed against it."""


LINK_FRICTION = {"link_coulomb": Parameter("N m", 0.0), "link_damping": Parameter("N m s/rad", 0.0)}
NO_FRICTION = dict.fromkeys(LINK_FRICTION, 0.0)


class AbstractRubbingGearEffect(AbstractGearEffect):
    """A gear whose link may have friction of its own, as of its bearings, which is transmitted like a load; the joint's
    other friction acts on the motor.

    Attributes:
        shares: of a joint's friction that the link may have.
        others: friction of the link that is tried beside a found one, over that.
    """

    shares: tuple[float, ...]
    others: ClassVar[tuple[float, ...]] = (0.6, 0.8, 1.25, 1.6)

    def drag(self, parameters: Parameters, qd: Array) -> Array | float:
        own = self.whole(parameters)
        return own["link_coulomb"] * qd / np.hypot(qd, STANDS) + own["link_damping"] * qd

    def dragged(self, coulomb: float, viscous: float) -> Sequence[Parameters]:
        return [{"link_coulomb": x * coulomb, "link_damping": x * viscous} for x in self.shares if coulomb > 0]

    def relatives(self, parameters: Parameters) -> Sequence[Parameters]:
        own = self.whole(parameters)
        more = ({**own, **{name: x * own[name] for name in LINK_FRICTION}} for x in self.others)
        return [x for x in more if x["link_coulomb"] > 0]

    def lost(self, parameters: Parameters) -> str:
        """What a simulator's joint does not hold of it."""
        return "has the friction of its link on the motor" if any(map(parameters.get, LINK_FRICTION)) else ""


@dataclass(frozen=True)
class Backlash(AbstractRubbingGearEffect):
    """Play of the gear: where the transmitted torque changes its sign, the link moves freely until it reaches the other
    flank of the teeth.

    Attributes:
        gaps: to try [rad]; the found one is refined between them. Flanks part and meet elsewhere at half as much again.
    """

    gaps: tuple[float, ...] = tuple(0.0004 * 2 ** (k / 4) for k in (*range(0, 20, 2), *range(20, 25)))
    shares: tuple[float, ...] = (0.3, 0.9)

    sharp = True
    name = "backlash"
    title = "backlash"
    meaning = "Play in the gear: the link moves freely by this angle before the motor drives it again."
    equation = "link free of the motor within ±gap/2; on it: link_coulomb sign(qd) + link_damping qd"
    reference = "Nordin and Gutman, Automatica 2002"
    parameters = {"gap": Parameter("rad", 1e-5, 0.1), **LINK_FRICTION}
    defaults = NO_FRICTION
    chosen = tuple(LINK_FRICTION)
    confounders = (("presliding_hysteresis",), ("stribeck_friction",), ("joint_elasticity",), ("coulomb_friction",))
    advice = "the same slow motion with a load of constant sign and with a load that changes sign; or a link encoder"
    panels = ("loops_over_load",)
    needs = ("motion", "load_zeros")
    shows = ("load_zeros",)

    def typical(self, usual: UsualJoint) -> dict[str, Any]:
        return {"gap": USUAL_GAP, **self.defaults}

    def in_simulator(self, parameters: Parameters) -> SimulatorTerms:
        return SimulatorTerms({"gap": parameters["gap"]}, lost=self.lost(parameters))

    def shapes(self, load: Array, inertia: Array, rate: float) -> Sequence[Parameters]:
        return [{"gap": x} for x in self.gaps]

    def deflection(self, parameters: Parameters, load: Array, inertia: Array, rate: float) -> tuple[Array, Array]:
        return _within_gap(np.asarray(load), np.asarray(inertia), parameters["gap"], rate)

    def compliance(self, parameters: Parameters) -> float:
        return parameters["gap"]

    def from_compliance(self, compliance: float) -> dict[str, float]:
        return {"gap": compliance}


@dataclass(frozen=True)
class JointElasticity(AbstractRubbingGearEffect):
    """A compliant gear: a spring between motor and link.

    Attributes:
        resonances: of the link on its spring, motor held, to try [Hz]; the found stiffness is refined between them.
        ratios: damping ratios of that resonance that are tried where a spring was found: below the resonance they play
            no part. The default is more than most gears have, or every error of the measured motion would ring on
            (docs/decisions/011).
        nearby: stiffnesses that are tried with these ratios, over the one that was found: the more a spring is damped,
            the stiffer it fits where its resonance lies in the band.
    """

    resonances: tuple[float, ...] = (2.7, 4.0, 6.0, 9.0, 13.0, 20.0, 30.0)
    ratios: tuple[float, ...] = (0.1, 0.05, 0.02)
    nearby: tuple[float, ...] = (0.7, 0.84, 1.0, 1.19)
    shares: tuple[float, ...] = (0.1, 0.3, 1.0)

    others = (0.35, *AbstractRubbingGearEffect.others)

    name = "joint_elasticity"
    title = "joint elasticity"
    meaning = "A gear that deflects under load."
    equation = (
        "torque = stiffness δ + 2 damping_ratio √(stiffness inertia) dδ/dt, δ = motor angle − link angle; the link has "
        "link_coulomb sign(qd) + link_damping qd"
    )
    reference = "Spong, ASME JDSMC 1987"
    parameters = {"stiffness": Parameter("N m/rad", 1.0), "damping_ratio": Parameter("-", 1e-3, 0.99), **LINK_FRICTION}
    defaults = {"damping_ratio": 0.2, **NO_FRICTION}
    chosen = ("damping_ratio", *LINK_FRICTION)
    confounders = (("torque_delay",), ("actuator_lag",), ("rotor_inertia",), ("link_inertia_error",), ("backlash",))
    advice = "a chirp up to the resonance: the phase of a delay is linear in frequency, that of a spring is quadratic"
    panels = ("loops_over_load",)
    needs = ("motion", "frequency")
    shows = ("torque_slope", "acceleration")

    def typical(self, usual: UsualJoint) -> dict[str, Any]:
        return {"stiffness": max(usual.inertia * (2 * np.pi * USUAL_RESONANCE) ** 2, 1.0), **self.defaults}

    def in_simulator(self, parameters: Parameters) -> SimulatorTerms:
        return SimulatorTerms({"compliance": 1 / parameters["stiffness"]}, lost=self.lost(parameters))

    def shapes(self, load: Array, inertia: Array, rate: float) -> Sequence[Parameters]:
        return [{"stiffness": float(np.median(inertia)) * (2 * np.pi * f) ** 2} for f in self.resonances]

    def deflection(self, parameters: Parameters, load: Array, inertia: Array, rate: float) -> tuple[Array, Array]:
        ratio = self.whole(parameters)["damping_ratio"]
        return _on_spring(np.asarray(load), np.asarray(inertia), parameters["stiffness"], ratio, rate)

    def relatives(self, parameters: Parameters) -> Sequence[Parameters]:
        own = parameters["stiffness"]
        swinging = [{"stiffness": k * own, "damping_ratio": x} for x in self.ratios for k in self.nearby]
        return [*super().relatives(parameters), *({**parameters, **x} for x in swinging)]

    def compliance(self, parameters: Parameters) -> float:
        return 1 / parameters["stiffness"]

    def from_compliance(self, compliance: float) -> dict[str, float]:
        return {"stiffness": float(1 / max(compliance, 1e-9))}


def _within_gap(load: np.ndarray, inertia: np.ndarray, gap: float, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Deflection (T,) of a link that is pushed by one flank or the other, or falls without bouncing, and its second
    derivative, blows with their whole momentum; inertia times the link's acceleration against the motor is then -load.

    A blow stops the motor as well, and that is seen a sample late: where it brakes the fall, the link is left to it for
    BLOW samples, or until they go together; elsewhere its speed goes at once.
    """
    step, half = 1 / rate, gap / 2
    side = np.where(load > 0, -half, half)
    turns = np.flatnonzero(np.diff(side) != 0) + 1
    out, bend = np.empty(len(load)), np.zeros(len(load))
    fall = (-load / inertia).tolist()
    k, end, at = 0, len(load), float(side[0])
    while k < end:
        later = turns[np.searchsorted(turns, k) :]
        leaves = next((int(x) for x in later if side[x] != at), end) if side[k] == at else k
        out[k:leaves] = at
        k, b, speed, there = leaves, at, 0.0, 0
        while k < end:
            now, before = fall[k], fall[k - 1] if k else fall[k]
            b += speed * step + (2 * before + now) / 6 * step * step
            speed += (before + now) / 2 * step
            out[k], bend[k] = min(max(b, -half), half), now
            k += 1
            there = there + 1 if abs(b) >= half else 0
            if there == 1:
                braked = abs(speed) > SLOWED * abs(speed + sum(fall[k : k + BLOW]) * step)
            if there and (b * speed <= 0 or there > BLOW or not braked):
                at = half if b > 0 else -half
                bend[k - 1] -= bend[leaves:k].sum()
                break
    return out, bend


def _on_spring(load: np.ndarray, inertia: np.ndarray, stiffness: float, ratio: float, rate: float):
    """Deflection (T,) of a link on a spring and its second derivative: inertia b'' + damping b' + stiffness b = -load,
    exact for loads that run in straight lines between samples. It starts on the course that its load, as a parabola
    over the first half period, would keep up: in the middle of a motion, a start from rest would ring on."""
    omega = np.sqrt(stiffness / inertia)
    swing, fade = omega * np.sqrt(1 - ratio**2), ratio * omega
    step = 1 / rate
    cosine, sine = np.cos(swing * step), np.sin(swing * step)
    decay = np.exp(-fade * step)
    kept = decay * (cosine + fade / swing * sine), decay * sine / swing
    lost = -decay * omega**2 * sine / swing, decay * (cosine - fade / swing * sine)
    rest = -load / stiffness
    slope = np.diff(rest, append=rest[-1]) * rate
    late = 2 * ratio / omega * slope  # behind the course that the load's straight line would keep up
    change = np.array([kept, lost])
    ahead = np.stack([rest - late, slope])
    drift = ahead - np.einsum("xyt,yt->xt", change, ahead) + np.stack([slope * step, np.zeros_like(slope)])
    first = rest[: max(3, round(np.pi / omega[0] * rate))]
    bends, grows, begins = np.polyfit(step * np.arange(len(first)), first, 2)
    lag = 2 * ratio / omega[0]
    start = np.array([begins - lag * grows + 2 * (lag**2 - omega[0] ** -2) * bends, grows - 2 * lag * bends])
    b, speed = _followed(change, drift, start)
    return b, -load / inertia - 2 * ratio * omega * speed - omega**2 * b


def _followed(change: np.ndarray, drift: np.ndarray, start: np.ndarray) -> np.ndarray:
    """States (m, T) of x[t + 1] = change[t] x[t] + drift[t], for change (m, m, T) and drift (m, T), from a start (m,):
    all stretches are first computed in parallel from zero and from unit states, then joined one after the other."""
    m, samples = drift.shape
    count = -(-samples // STRETCH)
    step = np.zeros((m + 1, m + 1, count * STRETCH))
    step[:m, :m, :samples], step[:m, m, :samples], step[m, m] = change, drift, 1.0
    step = np.ascontiguousarray(step.reshape(m + 1, m + 1, count, STRETCH).transpose(3, 2, 0, 1))
    state = np.empty((STRETCH + 1, count, m + 1, m + 1))  # of the units and, last, of zero
    state[0] = np.eye(m + 1)
    for t in range(STRETCH):
        np.matmul(step[t], state[t], out=state[t + 1])
    first = np.empty((count, m + 1))
    first[0] = [*start, 1.0]
    for k in range(count - 1):
        first[k + 1] = state[-1, k] @ first[k]
    return np.einsum("tcxy,cy->xct", state[:-1, :, :m], first).reshape(m, -1)[:, :samples]
