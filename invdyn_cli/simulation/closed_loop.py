"""The simulated arm tick by tick, for any controller: measure, then apply a torque that is held until the next tick.

`plant.simulate` uses the simulation's own controller, `control.py` of the package a learned one, with the same arm and
sensors.
"""
# pyright: reportAttributeAccessIssue=false

from collections.abc import Sequence

import numpy as np

from invdyn_cli.joints import units
from invdyn_cli.simulation import gear
from invdyn_cli.simulation.arm import build, set_joints
from invdyn_cli.simulation.control import Control, commissioned
from invdyn_cli.simulation.drive import Drive
from invdyn_cli.simulation.hidden import Hidden, assemble
from invdyn_cli.simulation.sensors import Late, Noise, Side, stepped
from invdyn_cli.types import Motion, Robot

EXACT = Noise()


class ClosedLoop:
    """One arm with its sensors: mutable, used for one simulation.

    Args:
        robot: what everybody believes the arm to be.
        hidden: what is different about it.
        samples: ticks from t = 0 on.
        before: ticks until then.
        noise: of the sensors.
        rate: [Hz] of the ticks.
        substeps: steps of the physics per tick.
        seed: of the noise.
        torque_side: "link": torques are felt behind the gear.
        name: the trajectory's, for events that belong to one.
    """

    def __init__(
        self,
        robot: Robot,
        hidden: Sequence[Hidden] = (),
        *,
        samples: int,
        before: int = 0,
        noise: Noise = EXACT,
        rate: float = 1000.0,
        substeps: int = 4,
        seed: int = 0,
        torque_side: Side = "command",
        name: str = "trajectory_1",
    ) -> None:
        self.robot, self.rate, self.before, self.tick = robot, rate, before, 0
        self.made = made = assemble(robot, hidden, name)
        self.step = 1 / (rate * substeps)
        self.arm = build(
            robot,
            inertial=made.inertial,
            gravity=made.gravity,
            carried=[*made.carried, *made.events.bodies()],
            armature=made.armature,
            geared=[x.joint for x in made.gears],
            couplings=made.couplings,
            timestep=self.step,
        )
        set_joints(self.arm, damping=made.damping, stiffness=made.stiffness, pull=made.pull)
        gear.put(self.arm, made.gears)
        self.arm.model.dof_frictionloss[self.arm.motor] = made.friction
        self.drive = Drive(self.arm, made, substeps, sense=torque_side == "link")
        self.noises = np.random.default_rng([seed, 1])
        self._errors = self.noises.normal(size=(before + samples, robot.dofs)) * noise.of("position", robot.dofs)
        self._errors += made.encoder
        self._quantum = noise.of("position_quantum", robot.dofs)
        self._torque_noise = noise.of("torque", robot.dofs)
        self._torque_quantum = noise.of("torque_quantum", robot.dofs)
        self._late = Late(made.behind * rate, made.smoothed * rate) if np.any([made.behind, made.smoothed]) else None
        self.commands = np.empty((before + samples, robot.dofs))

    @property
    def sample(self) -> int:
        """Ticks since t = 0, negative before."""
        return self.tick - self.before

    def start(self, q: np.ndarray) -> None:
        """At rest where the encoders read q (n,), except for their noise."""
        self.drive.start(q - self.made.encoder)

    def measure(self, *, link: bool = False) -> np.ndarray:
        """Angles (n,) [rad; m] as measured at this tick, of the motors or of the links."""
        measured = self.drive.q(link=link) + self._errors[self.tick]
        return stepped(measured, self._quantum) if self._quantum.any() else measured

    def apply(self, tau: np.ndarray) -> None:
        """Apply torques (n,) [N m; N] until the next tick."""
        self.commands[self.tick] = tau
        self.drive.advance(self.commands, self.tick, self.sample / self.rate)
        self.tick += 1

    def logged(self, tau: np.ndarray) -> np.ndarray:
        """Torques of one tick (n,) or of several (T, n), which follow the last ones, as they are logged: late, with
        noise and quantisation."""
        if self._late is not None:
            tau = np.array([self._late(x) for x in np.atleast_2d(tau)]).reshape(tau.shape)
        return stepped(tau + self.noises.normal(size=tau.shape) * self._torque_noise, self._torque_quantum)

    def hold(self, control: Control, wanted: Motion, ticks: int) -> None:
        """Start at the beginning of a motion (T, n), and let the simulation's own controller hold the arm there."""
        controller = commissioned(control, self.robot, self.made, wanted, self.rate, self.step)
        self.start(np.asarray(wanted.q)[0])
        for _ in range(ticks):
            self.apply(controller.torque(0, self.measure()))

    def lost(self, error: np.ndarray, largest: float) -> str:
        """Why an arm this far from its reference, (n,) [rad; m], is out of control; "" where it is not."""
        worst = int(np.argmax(np.where(np.isfinite(error), np.abs(error), np.inf)))
        if abs(error[worst]) <= largest:
            return ""
        t, off = self.sample / self.rate, abs(float(error[worst]))
        when = f"at {t:.2f} s" if t >= 0 else "before the log begins"
        unit = units(self.robot.prismatic[worst]).position
        digits = next((k for k in range(3, 17) if f"{off:.{k}g}" != f"{largest:.{k}g}"), 17)
        return (
            f"the simulated arm is out of control {when}: {self.robot.joints[worst]} is {off:.{digits}g} {unit} from "
            f"its reference; allowed: {largest:g} {unit}"
        )
