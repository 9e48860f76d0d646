"""Drive and torque channel: effects between the logged torque and the torque that moves the joint."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import scipy

from invdyn_cli.effects.linear import AbstractLinearEffect
from invdyn_cli.interfaces import AbstractChannelEffect, JointState, Parameter, Parameters
from invdyn_cli.joints import NO_TIME, SimulatorTerms, UsualJoint
from invdyn_cli.types import Array

SLOWEST = 0.05
"""[s] Largest delay: with a larger one an arm could not be controlled at its usual bandwidth."""

MOTOR_SIDES = ("motor", "command", "unknown")


@dataclass(frozen=True)
class RotorInertia(AbstractLinearEffect):
    """Inertia of the motor side of the gear; a sensor behind the gear does not measure it."""

    name = "rotor_inertia"
    title = "rotor inertia"
    meaning = "The motor's own inertia, seen through the gear."
    equation = "armature qdd"
    reference = "Khalil and Dombre, Modeling, Identification and Control of Robots, 2002"
    parameters = {"armature": Parameter("kg m²", 0.0)}
    sides = MOTOR_SIDES
    confounders = (("link_inertia_error",),)
    advice = "accelerations of the joint in postures with different link inertia"
    panels = ("acceleration",)
    group = "standard"
    needs = ("motion", "acceleration")
    shows = ("acceleration",)

    def typical(self, usual: UsualJoint) -> dict[str, Any]:
        return {"armature": 0.15 * usual.inertia}

    def in_simulator(self, parameters: Parameters) -> SimulatorTerms:
        return SimulatorTerms({"armature": parameters["armature"]})

    def basis(self, state: JointState, shape: Parameters) -> Sequence[Array]:
        return (state.qdd,)


@dataclass(frozen=True)
class TorqueOffset(AbstractLinearEffect):
    """A constant: zero of a sensor or a drive."""

    name = "torque_offset"
    title = "torque offset"
    meaning = "A constant torque, such as the zero offset of a sensor."
    equation = "offset"
    reference = "Swevers, Verdonck and De Schutter, IEEE Control Systems 2007"
    parameters = {"offset": Parameter("N m")}
    confounders = (("joint_spring",), ("asymmetric_coulomb_friction",), ("base_tilt",), ("link_inertia_error",))
    advice = "many postures, each approached from both directions, one of them without gravity load"
    group = "standard"
    needs = ("reversals",)
    shows = ("level",)

    def typical(self, usual: UsualJoint) -> dict[str, Any]:
        return {"offset": usual.level}

    def in_simulator(self, parameters: Parameters) -> SimulatorTerms:
        return SimulatorTerms({"offset": parameters["offset"]})

    def basis(self, state: JointState, shape: Parameters) -> Sequence[Array]:
        xp = state.q.__array_namespace__()
        return (xp.ones_like(state.q),)


@dataclass(frozen=True)
class TorqueOffsetDrift(AbstractLinearEffect):
    """An offset that drifts during a trajectory."""

    name = "torque_offset_drift"
    title = "torque offset drift"
    meaning = "A torque offset that changes at a constant rate."
    equation = "rate t"
    reference = "Albu-Schäffer, Haddadin, Ott, Stemmer, Wimböck and Hirzinger, Industrial Robot 2007"
    parameters = {"rate": Parameter("N m/s")}
    confounders = (("torque_offset",), ("thermal_friction_drift",), ("joint_spring",))
    advice = "the same postures, repeated after some minutes"
    needs = ("minutes",)
    shows = ("time",)

    def typical(self, usual: UsualJoint) -> dict[str, Any]:
        return {"rate": 2 * usual.level / usual.duration}

    def in_simulator(self, parameters: Parameters) -> SimulatorTerms:
        return SimulatorTerms(lost=NO_TIME)

    def basis(self, state: JointState, shape: Parameters) -> Sequence[Array]:
        return (state.t,)


class AbstractGainEffect(AbstractChannelEffect):
    """A joint that delivers a fixed multiple of what is logged."""

    parameters = {"gain": Parameter("-", 0.4, 2.5)}
    factor = "gain"

    def shapes(self, tau: Array, rate: float) -> Sequence[Parameters]:
        return ({"gain": 1.0},)

    def delivered(self, parameters: Parameters, tau: Array, rate: float) -> Array:
        return parameters["gain"] * tau

    def logged(self, parameters: Parameters, tau: Array, rate: float) -> Array:
        return tau / parameters["gain"]


@dataclass(frozen=True)
class TorqueGainError(AbstractGainEffect):
    """Wrong torque constant, drive gain or sensor gain."""

    name = "torque_gain_error"
    title = "torque gain error"
    meaning = "A wrong torque constant or sensor scale: the joint delivers a fixed multiple of what is logged."
    equation = "delivered = gain · logged"
    loaded = True
    reference = "Gautier and Briot, ASME JDSMC 2014"
    for_a_time = "torque_gain_change"
    confounders = (("link_inertia_error",), ("load_dependent_friction",), ("payload",), ("rotor_inertia",))
    advice = "a known payload: it distinguishes a wrong gain from wrong masses"
    panels = ("nominal_torque",)
    needs = ("torque",)
    shows = ("load",)

    def typical(self, usual: UsualJoint) -> dict[str, Any]:
        return {"gain": 0.9}

    def in_simulator(self, parameters: Parameters) -> SimulatorTerms:
        return SimulatorTerms({"gain": parameters["gain"]})


@dataclass(frozen=True)
class TorqueDelay(AbstractChannelEffect):
    """Pure delay between command and torque, or, negative, between torque and log: a measured torque that comes late.

    Attributes:
        delays: to try [s], of either sign.
    """

    delays: tuple[float, ...] = (0.0, 0.003, 0.006, 0.01, 0.015, 0.02, 0.028, 0.04)

    name = "torque_delay"
    title = "torque delay"
    meaning = "The torque reaches the joint later than the log says. If the delay is negative, it was logged too late."
    equation = "delivered(t) = logged(t − delay)"
    reference = "first order: delay · d torque/dt"
    parameters = {"delay": Parameter("s", -SLOWEST, SLOWEST)}
    late_by = "delay"
    confounders = (("actuator_lag",), ("viscous_friction",))
    advice = "fast motion: the phase of a delay is linear in frequency; that of a lag is not, and a lag also attenuates"
    panels = ("torque_rate", "time_shift")
    needs = ("torque",)
    shows = ("torque_slope",)

    def typical(self, usual: UsualJoint) -> dict[str, Any]:
        return {"delay": 0.01}

    def in_simulator(self, parameters: Parameters) -> SimulatorTerms:
        return SimulatorTerms({"delay": max(parameters["delay"], 0.0)})  # the log may be late, but not the arm

    def shapes(self, tau: Array, rate: float) -> Sequence[Parameters]:
        return [{"delay": x} for x in _of_either_sign(self.delays)]

    def delivered(self, parameters: Parameters, tau: Array, rate: float) -> Array:
        return shifted(tau, -parameters["delay"] * rate)

    def logged(self, parameters: Parameters, tau: Array, rate: float) -> Array:
        return shifted(tau, parameters["delay"] * rate)


@dataclass(frozen=True)
class ActuatorLag(AbstractChannelEffect):
    """First-order lag of the drive's current or torque loop, or, negative, of the measured torque on its way to the
    log.

    Attributes:
        time_constants: to try [s], of either sign.
    """

    time_constants: tuple[float, ...] = (0.0, 0.003, 0.006, 0.01, 0.015, 0.02, 0.028, 0.04)

    name = "actuator_lag"
    title = "actuator lag"
    meaning = (
        "The delivered torque follows the logged one as a first-order filter does; with a negative time constant, the "
        "logged one follows the delivered one."
    )
    equation = (
        "time_constant · d delivered/dt + delivered = logged; with a negative time_constant: "
        "|time_constant| · d logged/dt + logged = delivered"
    )
    reference = "first-order current loop"
    parameters = {"time_constant": Parameter("s", -SLOWEST, SLOWEST)}
    late_by = "time_constant"
    confounders = (("torque_delay",), ("viscous_friction",))
    advice = TorqueDelay.advice
    panels = ("torque_rate", "time_shift")
    needs = ("torque",)
    shows = ("torque_slope",)

    def typical(self, usual: UsualJoint) -> dict[str, Any]:
        return {"time_constant": 0.01}

    def in_simulator(self, parameters: Parameters) -> SimulatorTerms:
        return SimulatorTerms({"lag": max(parameters["time_constant"], 0.0)})  # as of a late log

    def shapes(self, tau: Array, rate: float) -> Sequence[Parameters]:
        return [{"time_constant": x} for x in _of_either_sign(self.time_constants)]

    def delivered(self, parameters: Parameters, tau: Array, rate: float) -> Array:
        return _lagged(tau, parameters["time_constant"] * rate)

    def logged(self, parameters: Parameters, tau: Array, rate: float) -> Array:
        return _lagged(tau, -parameters["time_constant"] * rate)


@dataclass(frozen=True)
class TorqueSaturation(AbstractChannelEffect):
    """A limit of current or torque that the log does not contain.

    Attributes:
        shares: of the samples that a tried limit would cut off.
        apart: ratio of neighbouring limits at most; others are tried between.
    """

    shares: tuple[float, ...] = (0.004, 0.01, 0.02, 0.04, 0.08, 0.12, 0.17, 0.23, 0.3)
    apart: float = 1.3

    name = "torque_saturation"
    title = "torque saturation"
    meaning = "The drive delivers at most a limit, even if more is commanded."
    invertible = False  # what was asked for beyond the limit, no model can know
    equation = "delivered = clip(logged, ±limit)"
    reference = "data sheets of drives"
    parameters = {"limit": Parameter("N m", 0.0)}
    advice = "a log of the measured torque or current together with the commanded one"
    panels = ("clipping",)
    shows = ("load",)

    def typical(self, usual: UsualJoint) -> dict[str, Any]:
        return {"limit": 1.5 * usual.torque}

    def in_simulator(self, parameters: Parameters) -> SimulatorTerms:
        return SimulatorTerms({"limit": parameters["limit"]})

    def shapes(self, tau: Array, rate: float) -> Sequence[Parameters]:
        limits = np.quantile(abs(np.asarray(tau)), [1 - x for x in self.shares])
        limits = limits[limits > 0]
        for high, low in pairwise(limits):  # a controller that asks for ever more leaves a gap
            between = int(np.ceil(np.log(high / low) / np.log(self.apart)))
            limits = np.append(limits, np.geomspace(high, low, between + 1)[1:-1] if between > 1 else [])
        return [{"limit": float(x)} for x in limits]

    def delivered(self, parameters: Parameters, tau: Array, rate: float) -> Array:
        xp = tau.__array_namespace__()
        return xp.clip(tau, -parameters["limit"], parameters["limit"])

    def logged(self, parameters: Parameters, tau: Array, rate: float) -> Array:
        return self.delivered(parameters, tau, rate)


def _of_either_sign(x: Sequence[float]) -> tuple[float, ...]:
    """These numbers, and then the negative of each but zero."""
    return (*x, *(-one for one in x if one))


def _lagged(tau: Array, samples: float) -> Array:
    """First-order response to torques (T, …) that are linear between samples, exactly, with a time constant of so many
    of these; negative: the torques (T, …) that have these as their response, by central differences."""
    if samples < 0:
        xp = tau.__array_namespace__()
        slope = xp.concatenate([tau[1:2] - tau[:1], (tau[2:] - tau[:-2]) / 2, tau[-1:] - tau[-2:-1]])
        return tau - samples * slope
    tau = np.asarray(tau)
    if samples < 1e-9:
        return tau
    decay = np.exp(-1 / samples)
    now, before = 1 - samples * (1 - decay), samples * (1 - decay) - decay
    out, _ = scipy.signal.lfilter([now, before], [1, -decay], tau, axis=0, zi=tau[:1] * (1 - now))
    return out


def shifted(x: Array, samples: float) -> np.ndarray:
    """x (T, …) at the times `samples` later (cubic spline; the end values go on): shifted(x, 1)[i] is x[i + 1]."""
    x = np.asarray(x, float)
    if not samples or len(x) < 4:
        return x
    rows = [scipy.ndimage.shift(row, -samples, order=3, mode="nearest") for row in x.reshape(len(x), -1).T]
    return np.transpose(rows).reshape(x.shape)
