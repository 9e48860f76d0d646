"""From the commanded torque to the next state: the channel in between, and the effects that MuJoCo does not integrate
itself.

A tick is a number of steps with constant command. If an effect changes from step to step, torques, friction and damping
are set before each step; otherwise MuJoCo takes all steps of a tick at once. Arrays (n,) belong to the motors unless
they are said to belong to the links.
"""
# pyright: reportAttributeAccessIssue=false

from typing import Any

import mujoco
import numpy as np

from invdyn_cli.simulation import gear
from invdyn_cli.simulation.arm import Arm, lightest
from invdyn_cli.simulation.bristles import Bent
from invdyn_cli.simulation.events import Stage
from invdyn_cli.simulation.hidden import Build


class Drive:
    """One arm in motion: mutable, used for one simulation.

    MuJoCo uses semi-implicit Euler steps: torques change the velocity, and then the arm moves with the new velocity. A
    tick therefore begins half a step before `qpos`, in the middle of that motion: half of the motion, the torques, the
    other half. In this way the steps are of second order, `qvel` is the velocity at that time, and a torque acts from
    the time at which it is logged.
    """

    def __init__(self, arm: Arm, build: Build, substeps: int, *, sense: bool = False) -> None:
        model, n = arm.model, len(arm.motor)
        self.sense, self.felt, self._felt_last = sense, np.zeros(n), np.zeros(n)
        self.arm, self.model, self.build, self.substeps = arm, model, build, substeps
        self.data: Any = mujoco.MjData(model)
        self._qpos, self._qvel, self._applied = self.data.qpos, self.data.qvel, self.data.qfrc_applied
        self._motor = arm.motor if len(arm.gear) else slice(None)  # a slice gives views, and there is nothing to pick
        self.step = float(model.opt.timestep)
        self._columns = np.arange(n)
        self._late = np.round(build.delay / self.step).astype(int)
        self._forget = np.where(build.lag > 0, np.exp(-self.step / np.where(build.lag > 0, build.lag, 1.0)), 0.0)
        self._share = np.where(build.lag > 0, build.lag / self.step * (1 - self._forget), 0.0)
        self._lagging: np.ndarray | None = None
        self._gains = bool((build.gain != 1).any())
        self._limits = bool(np.isfinite(build.limit).any())
        self._offsets = bool(build.offset.any())
        self._between = bool(self._late.any() or build.lag.any())
        self._laws = bool(build.drags or build.forces or build.customs or build.bristles)
        least = lightest(arm) if build.bristles else np.zeros(n)
        self._bristles = [Bent(x, float(least[x.joint]), self.step) for x in build.bristles]
        self._stops = gear.Stops(arm, build.gears, self.data)
        self._stage = Stage(build.events, model, self.data, len(build.carried)) if build.events else None
        changing = self._between or self._laws or bool(build.levels) or sense
        self._stepwise = changing or bool(self._stops) or self._stage is not None

    def start(self, q: np.ndarray) -> None:
        """At rest with the motors at q (n,), and the gears where the weight of the links holds them."""
        self._qpos[self._motor] = q
        self._qvel[:] = 0.0
        gear.loaded(self.arm, self.build.gears, self.data)

    def q(self, *, link: bool = False) -> np.ndarray:
        """True angles (n,) [rad; m] of the motors, or of the links, at the beginning of the next tick."""
        return self._of(self._qpos - (self.step / 2) * self._qvel, link)

    def qd(self, *, link: bool = False) -> np.ndarray:
        """True velocities (n,) [rad/s; m/s] then, of the motors or of the links."""
        return self._of(self._qvel, link)

    def advance(self, commands: np.ndarray, k: int, t: float) -> None:
        """Simulate one tick from t [s] on, with the command commands[k] (n,) and the earlier ones in commands (...,
        n)."""
        model, data = self.model, self.data
        if not self._stepwise:
            self._applied[self._motor] = self._delivered(commands[k], t)
            mujoco.mj_step(model, data, self.substeps)
            return
        for step in range(self.substeps):
            now = t + step * self.step
            if self._stage is not None:
                self._stage.put(now + self.step / 2)
            if self.build.levels:
                self._put_friction()
            torque = self._delivered(self._arriving(commands, k, step) if self._between else commands[k], now)
            self._applied[self._motor] = self._under_laws(torque, now) if self._laws else torque
            if self._stops:
                self._stops.look_ahead()
            mujoco.mj_step(model, data)
            for bristle in self._bristles:
                bristle.advance(float(self._qvel[self.arm.motor[bristle.joint]]))
            if self.sense and step == 0:
                felt = self.transmitted()
                self.felt, self._felt_last = (self._felt_last + felt) / 2, felt
        if self.sense:
            self._felt_last = self.transmitted()

    def transmitted(self) -> np.ndarray:
        """Torque (n,) that reached the links in the last step: what arrived, less friction, springs and rotors; through
        a gear that yields, what that passed on."""
        data = self.data
        felt = self._applied + data.qfrc_passive + data.qfrc_constraint - self.model.dof_armature * data.qacc
        for x in self.build.couplings:
            joint, driver = self.arm.motor[x.joint], self.arm.motor[x.driver]
            torque = x.armature * (data.qacc[joint] + x.ratio * data.qacc[driver])
            felt[joint] -= torque
            felt[driver] -= x.ratio * torque
        if not len(self.arm.gear):
            return felt
        links = felt[self._motor]
        links[self.arm.geared] = felt[self.arm.gear] - self._stops.drag
        return links

    def _of(self, state: np.ndarray, link: bool) -> np.ndarray:
        """Positions or velocities (n,) of the motors or the links, from those of all degrees of freedom (nv,)."""
        own = state[self._motor]
        if link and len(self.arm.gear):
            own[self.arm.geared] += state[self.arm.gear]
        return own

    def _arriving(self, commands: np.ndarray, k: int, step: int) -> np.ndarray:
        """Commands after delays and lags: the mean over this step."""
        if self._late.any():
            rows = np.maximum(k * self.substeps + step - self._late, 0) // self.substeps
            now = commands[rows, self._columns]
        else:
            now = commands[k]
        if self._lagging is None:
            self._lagging = now.copy()
        lead = self._lagging - now
        self._lagging = now + self._forget * lead
        return now + self._share * lead

    def _delivered(self, arriving: np.ndarray, t: float) -> np.ndarray:
        """Gain, then limits, then the offsets, in the step from t [s] on."""
        if self._gains:
            arriving = self.build.gain * arriving
        if self._stage is not None:
            arriving = self._stage.delivered(arriving, t + self.step / 2)
        if self._limits:
            arriving = np.clip(arriving, -self.build.limit, self.build.limit)
        return arriving - self.build.offset if self._offsets else arriving

    def _put_friction(self) -> None:
        """Dry friction of the next step, by the velocity before it and the torque that the last one transmitted."""
        friction, load, qd = self.build.friction.copy(), self.transmitted(), self.qd()
        for i, level in self.build.levels:
            friction[i] += level(float(qd[i]), float(load[i]))
        self.model.dof_frictionloss[self._motor] = friction

    def _under_laws(self, torque: np.ndarray, t: float) -> np.ndarray:
        """A torque (n,) minus the forces that depend on the state, for the step from t [s] on; also sets damping that
        depends on it."""
        build, torque = self.build, torque.copy()
        q, qd = self._of(self._qpos, False), self.qd()
        damping = build.damping.copy()
        for i, law in build.drags:
            damping[i] += law(t, float(qd[i]))
        for bristle in self._bristles:
            damping[bristle.joint] += bristle.damping(float(qd[bristle.joint]))
            torque[bristle.joint] -= bristle.force
        if build.drags or self._bristles:
            self.model.dof_damping[self._motor] = damping
        for i, force in build.forces:
            torque[i] -= force(t, float(q[i]), float(qd[i]))
        for i, force in build.customs:
            if i is None:
                torque -= force(t, q.copy(), qd.copy())
            else:
                torque[i] -= force(t, float(q[i]), float(qd[i]))
        return torque
