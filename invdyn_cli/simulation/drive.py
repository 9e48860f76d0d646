"""From the commanded torque to the next state: the channel in between, and what MuJoCo does not integrate by itself.

A tick is so many steps of constant command. Where an effect changes from step to step, torques, friction and damping
are set before each step; else MuJoCo takes all steps of a tick at once.
"""
# pyright: reportAttributeAccessIssue=false

from typing import Any

import mujoco
import numpy as np

from invdyn_cli.simulation.hidden import Build


class Drive:
    """One arm in motion; mutable, alive for one simulation.

    MuJoCo steps by semi-implicit Euler: torques push, and then the arm moves on with the new velocity. A tick therefore
    begins half a step before `qpos`, in the middle of that way: half of the way, the push, the other half. Read so, the
    steps are of second order, `qvel` is the velocity of that instant, and a torque acts from when it is logged.
    """

    def __init__(self, model: mujoco.MjModel, build: Build, substeps: int, *, sense: bool = False) -> None:
        self.sense, self.felt, self._felt_last = sense, np.zeros(model.nv), np.zeros(model.nv)
        self.model, self.build, self.substeps = model, build, substeps
        self.data: Any = mujoco.MjData(model)
        self.qpos, self.qvel, self.applied = self.data.qpos, self.data.qvel, self.data.qfrc_applied
        self.step = float(model.opt.timestep)
        n = model.nv
        self._columns = np.arange(n)
        self._late = np.round(build.delay / self.step).astype(int)
        self._forget = np.where(build.lag > 0, np.exp(-self.step / np.where(build.lag > 0, build.lag, 1.0)), 0.0)
        self._share = np.where(build.lag > 0, build.lag / self.step * (1 - self._forget), 0.0)
        self._lagging: np.ndarray | None = None
        self._gains = bool((build.gain != 1).any())
        self._limits = bool(np.isfinite(build.limit).any())
        self._offsets = bool(build.offset.any())
        self._between = bool(self._late.any() or build.lag.any())
        self._laws = bool(build.drags or build.forces or build.customs)
        self._stepwise = self._between or self._laws or bool(build.levels) or sense

    def start(self, q: np.ndarray) -> None:
        """At rest at q (n,)."""
        self.qpos[:] = q
        self.qvel[:] = 0.0

    def measured_q(self) -> np.ndarray:
        """True q (n,) at the beginning of the next tick."""
        return self.qpos - (self.step / 2) * self.qvel

    def advance(self, commands: np.ndarray, k: int, t: float) -> None:
        """One tick from t [s] on, under commands[k] (n,) and what came before it in commands (..., n)."""
        model, data = self.model, self.data
        if not self._stepwise:
            self.applied[:] = self._delivered(commands[k])
            mujoco.mj_step(model, data, self.substeps)
            return
        for step in range(self.substeps):
            if self.build.levels:
                self._put_friction()
            self.applied[:] = self._delivered(self._arriving(commands, k, step) if self._between else commands[k])
            if self._laws:
                self._put_laws(t + step * self.step)
            mujoco.mj_step(model, data)
            if self.sense and step == 0:
                now = self.transmitted()
                self.felt, self._felt_last = (self._felt_last + now) / 2, now
        if self.sense:
            self._felt_last = self.transmitted()

    def transmitted(self) -> np.ndarray:
        """Torque (n,) that reached the links in the last step: what arrived, less friction, springs and rotors."""
        data = self.data
        return self.applied + data.qfrc_passive + data.qfrc_constraint - self.model.dof_armature * data.qacc

    def _arriving(self, commands: np.ndarray, k: int, step: int) -> np.ndarray:
        """Commands behind delays and lags: the mean over this step."""
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

    def _delivered(self, arriving: np.ndarray) -> np.ndarray:
        """Gain, then limits, then what is taken away."""
        if self._gains:
            arriving = self.build.gain * arriving
        if self._limits:
            arriving = np.clip(arriving, -self.build.limit, self.build.limit)
        return arriving - self.build.offset if self._offsets else arriving

    def _put_friction(self) -> None:
        """Dry friction of the next step, by the velocity before it and the torque that the last one transmitted."""
        friction, load = self.build.friction.copy(), self.transmitted()
        for i, level in self.build.levels:
            friction[i] += level(float(self.qvel[i]), float(load[i]))
        self.model.dof_frictionloss[:] = friction

    def _put_laws(self, t: float) -> None:
        """Damping and forces that depend on the state, for the next step."""
        build, model = self.build, self.model
        if build.drags:
            damping = build.damping.copy()
            for i, law in build.drags:
                damping[i] += law(t, float(self.qvel[i]))
            model.dof_damping[:] = damping
        for i, force in build.forces:
            self.applied[i] -= force(t, float(self.qpos[i]), float(self.qvel[i]))
        for i, force in build.customs:
            if i is None:
                self.applied -= force(t, self.qpos.copy(), self.qvel.copy())
            else:
                self.applied[i] -= force(t, float(self.qpos[i]), float(self.qvel[i]))
