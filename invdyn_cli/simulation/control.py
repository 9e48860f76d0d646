"""The arm's controller: computed torque along a reference, with the positions and velocities that it measures.

    tau = ID(q, qd_ref, qdd_ref + w^2 (q_ref - q) + 2 D w (qd_ref - qd)) + friction(qd_ref)      (Siciliano, 8.5.2)

ID is MuJoCo's inverse dynamics; q is measured, with its noise and steps; qd is its difference quotient through a
first-order low-pass. Inertia inside the feedback makes all joints equally fast. A wrist's inertia is a ten-thousandth
of a shoulder's, though: no feedback of this bandwidth holds it against a friction that the controller knows nothing
of. Hence the controller is commissioned on the arm as it is, unless it is told to know the nominal one alone. The log
is right either way: which torque moved the arm does not depend on who asked for it.

The inertia in the feedback has two exceptions, where a motor moves less at first than in the long run, or more. Behind
a compliant gear a motor moves only its rotor: with the inertia of the whole link in the feedback, and samples of T
seconds, it would oscillate. And gains that just hold a light wrist could not hold an unexpected load: the feedback is
tuned for the arm with its loads. In both cases M in the feedback becomes S M S, with M of the loaded arm and

    S_i = min(1, sqrt(J_i / (4 D w T) / M_ii)),   J_i the least that motor i moves,

half of what the motor still bears.
"""
# pyright: reportAttributeAccessIssue=false

from dataclasses import dataclass, replace
from typing import Any, Literal

import mujoco
import numpy as np

from invdyn_cli.errors import UsageError
from invdyn_cli.simulation.arm import build, lightest, mass_matrix, set_joints
from invdyn_cli.simulation.hidden import Build, assemble
from invdyn_cli.types import Motion, Robot

FASTEST = 4.0
"""[Hz] bandwidth without delays; a position noise of 1e-5 rad then makes torques of 0.5 N m rms in a shoulder."""

LATE = 0.06
"""[-] Bandwidth [Hz] times delay [s] beyond which the feedback would oscillate: 3 Hz at 20 ms."""

SMOOTH = 0.005
"""[rad/s; m/s] Speeds at which the friction that is compensated fades in and out."""


@dataclass(frozen=True)
class Control:
    """The parameters of the controller.

    Attributes:
        frequency: w / 2 pi [Hz], the bandwidth of the feedback; None: FASTEST, less where torques come late.
        damping_ratio: D [-].
        velocity_cutoff: [Hz] of the low-pass on the measured velocity.
        knows: "arm": the arm with all that is built into it, but delays, lags, saturation and custom effects;
            "nominal": the nominal arm.
        settle: [s] of holding the first posture before the log begins.
        largest_error: [rad; m] beyond which the arm is out of control and the simulation stops.
    """

    frequency: float | None = None
    damping_ratio: float = 0.8
    velocity_cutoff: float = 25.0
    knows: Literal["arm", "nominal"] = "arm"
    settle: float = 0.5
    largest_error: float = 1.0

    def __post_init__(self) -> None:
        for name in ("frequency", "damping_ratio", "velocity_cutoff", "largest_error"):
            value = getattr(self, name)
            if (value is None or value <= 0) and (name, value) != ("frequency", None):
                raise UsageError(f"control.{name}={value}; allowed: above 0")
        if self.settle < 0:
            raise UsageError(f"control.settle={self.settle}; allowed: from 0")
        if self.knows not in ("arm", "nominal"):
            raise UsageError(f"control.knows={self.knows!r}; allowed: arm, nominal")

    def bandwidth(self, latency: float) -> float:
        """w [rad/s], where torques come `latency` [s] late."""
        return 2 * np.pi * (self.frequency or min(FASTEST, LATE / max(latency, 1e-9)))


class Controller:
    """A controller in use: mutable, used for one simulation.

    Args:
        control: its numbers.
        model: the arm that it knows, without dry friction.
        build: what it knows beside the model: dry friction, ripple, offsets, gains.
        latency: [s] with which torques arrive, at worst.
        feedback: what makes torques of the feedback's accelerations; None: the inertia of the arm that it knows.
        wanted: the reference, at `rate` [Hz].
    """

    def __init__(
        self,
        control: Control,
        model: mujoco.MjModel,
        build: Build,
        latency: float,
        wanted: Motion,
        rate: float,
        feedback: "Feedback | None",
    ) -> None:
        omega = control.bandwidth(latency)
        self._stiffness, self._damping = omega**2, 2 * control.damping_ratio * omega
        self._feedback = feedback
        self._follow = 1 - np.exp(-2 * np.pi * control.velocity_cutoff / rate)
        self._model, self._build, self._rate = model, build, rate
        self._q, self._qd, self._qdd = (np.asarray(x) for x in (wanted.q, wanted.qd, wanted.qdd))
        self._data: Any = mujoco.MjData(model)
        self._qpos, self._qvel, self._qacc = self._data.qpos, self._data.qvel, self._data.qacc
        self._inverse = self._data.qfrc_inverse
        self._direction = np.tanh(self._qd / SMOOTH)
        self._friction = build.offset + build.friction * self._direction
        for x in build.bristles:
            self._friction[:, x.joint] += x.coulomb * self._direction[:, x.joint]
        for x in build.couplings:
            one = x.coulomb * np.tanh((self._qd[:, x.joint] + x.ratio * self._qd[:, x.driver]) / SMOOTH)
            self._friction[:, x.joint] += one
            self._friction[:, x.driver] += x.ratio * one
        t = np.arange(len(self._q)) / rate
        for i, damping in build.drags:
            self._friction[:, i] += damping(t, self._qd[:, i]) * self._qd[:, i]
        self._last: np.ndarray = self._q[0]
        self._velocity = np.zeros(model.nv)

    def torque(self, row: int, q: np.ndarray) -> np.ndarray:
        """The torque (n,) [N m; N] that it commands at a row of the reference, at measured positions q (n,)."""
        build = self._build
        self._velocity += self._follow * ((q - self._last) * self._rate - self._velocity)
        self._last = q
        self._qpos[:] = q - build.encoder
        self._qvel[:] = self._qd[row]
        self._qacc[:] = self._qdd[row]
        feedback = self._stiffness * (self._q[row] - q) + self._damping * (self._qd[row] - self._velocity)
        if self._feedback is None:
            self._qacc += feedback
        mujoco.mj_inverse(self._model, self._data)
        tau = self._inverse + self._friction[row]
        if self._feedback is not None:
            tau += self._feedback.torque(self._qpos, feedback)
        for i, level in build.levels:
            load = self._inverse[i] + self._data.qfrc_passive[i] - build.armature[i] * self._qacc[i]
            tau[i] += level(self._velocity[i], load) * self._direction[row, i]
        for i, force in build.forces:
            tau[i] += force(row / self._rate, self._qpos[i], self._velocity[i])
        return tau / build.gain


class Feedback:
    """S M S times the feedback's accelerations; mutable, alive for one simulation.

    Args:
        model: the stiff arm with its loads.
        bearable: (n,) [kg m^2; kg] largest inertia on the diagonal that each motor bears.
    """

    def __init__(self, model: mujoco.MjModel, bearable: np.ndarray) -> None:
        self._model, self._bearable = model, bearable
        self._data: Any = mujoco.MjData(model)

    def torque(self, q: np.ndarray, accelerations: np.ndarray) -> np.ndarray:
        """(n,) [N m; N] at q (n,)."""
        inertia = mass_matrix(self._model, self._data, q)
        scale = np.sqrt(np.minimum(1.0, self._bearable / np.diagonal(inertia)))
        return scale * (inertia @ (scale * accelerations))


def commissioned(
    control: Control, robot: Robot, made: Build, wanted: Motion, rate: float, timestep: float
) -> Controller:
    """The controller of an arm with these effects in it, or of the nominal one (`control.knows`)."""
    known = made if control.knows == "arm" else assemble(robot)
    parts = {"inertial": known.inertial, "gravity": known.gravity, "armature": known.armature, "timestep": timestep}
    couplings = [replace(x, coulomb=0.0) for x in known.couplings]  # dry friction is fed forward from the reference
    arm = build(robot, carried=known.carried, couplings=couplings, **parts)
    set_joints(arm, damping=known.damping, stiffness=known.stiffness, pull=known.pull)
    latency, feedback = float((made.delay + made.lag).max()), None
    if made.gears or made.events.loads:
        laden = build(robot, carried=[*known.carried, *(x.body for x in made.events.loads)], **parts)
        least = lightest(arm) if made.events.loads else np.full(robot.dofs, np.inf)
        for gear in made.gears:
            least[gear.joint] = min(least[gear.joint], gear.rotor)
        swing = 4 * control.damping_ratio * control.bandwidth(latency) * (1 / rate + latency)
        feedback = Feedback(laden.model, least / swing)
    return Controller(control, arm.model, known, latency, wanted, rate, feedback)
