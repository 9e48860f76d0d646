"""The arm of an MJCF file, driven by logged torques on the clock of a measured stretch.

As in `drive`, a step begins half a step before `qpos`, so that the integration is of second order.
"""
# pyright: reportAttributeAccessIssue=false

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from invdyn_cli.errors import LogError, UsageError
from invdyn_cli.simulation.arm import GEAR

STEP = 1e-3
"""[s] Longest step of the physics."""


@dataclass(frozen=True)
class Segment:
    """A measured stretch without gaps on an even clock: t (T,) [s], the others (T, n) [rad, rad/s, N m; m, m/s, N].

    `held`: a torque acts from its t until the next one, as a controller applies it; otherwise torques are linear
    between samples.
    """

    name: str
    t: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    tau: np.ndarray
    held: bool = False

    def __post_init__(self) -> None:
        shapes = {np.shape(x) for x in (self.q, self.qd, self.tau)}
        if len(shapes) != 1 or len(self.t) < 3 or next(iter(shapes))[:1] != np.shape(self.t):
            got = ", ".join(str(np.shape(x)) for x in (self.t, self.q, self.qd, self.tau))
            got = f"{self.name}: t, q, qd, tau have shapes {got}"
            raise LogError(f"{got}; allowed: (T,) for t, (T, n) for the others, T >= 3")
        steps = np.diff(self.t)
        if not np.all(np.abs(steps - self.period) < 0.01 * self.period):
            raise LogError(f"{self.name}: the clock is uneven; allowed: steps within 1 % of {self.period:.3g} s")

    @property
    def period(self) -> float:
        """[s] between samples."""
        return float((self.t[-1] - self.t[0]) / (len(self.t) - 1))

    def torque(self, times: np.ndarray) -> np.ndarray:
        """(K, n) at times (K,) [s]; constant beyond the ends."""
        rows = (np.asarray(times) - self.t[0]) / self.period
        if self.held:
            return self.tau[np.clip(np.floor(rows + 1e-9).astype(int), 0, len(self.t) - 1)]
        rows = np.clip(rows, 0, len(self.t) - 1)
        before = np.minimum(rows.astype(int), len(self.t) - 2)
        share = (rows - before)[:, None]
        return (1 - share) * self.tau[before] + share * self.tau[before + 1]


class Driven:
    """The arm of a file on the clock of a stretch: mutable, used for one replay."""

    def __init__(self, mjcf: str, stretch: Segment) -> None:
        self.stretch, n = stretch, stretch.q.shape[1]
        self.substeps = int(np.ceil(stretch.period / STEP - 1e-9))
        self.step = stretch.period / self.substeps
        spec: Any = mujoco.MjSpec.from_string(mjcf)
        if len(spec.actuators) != n:
            got = f"the MJCF has {len(spec.actuators)} motors, the log has {n} joints"
            raise UsageError(f"{got}; allowed: one motor per joint")
        spec.option.timestep = self.step
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        for motor in spec.actuators:
            if motor.delay > 0:
                motor.nsample = int(np.ceil(motor.delay / self.step)) + 2
        model: Any = spec.compile()
        self.model, self.data = model, mujoco.MjData(model)
        joints = model.actuator_trnid[:, 0]
        model.jnt_limited[joints] = False  # the log was there
        self.rows, self.columns = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        names = [model.joint(i).name for i in range(model.njnt)]
        self._gears = [
            (i, names.index(names[joint] + end))
            for i, joint in enumerate(joints)
            for end in (GEAR, GEAR + "_spring")
            if names[joint] + end in names
        ]
        self._lagging = model.actuator_dyntype != mujoco.mjtDyn.mjDYN_NONE
        # Torques of a step are those of its middle; a lag's state is asked for a whole step on.
        late = self.step * np.where(self._lagging, 1.0, 0.5)
        ticks = stretch.t[0] + self.step * np.arange(self.substeps * (len(stretch.t) - 1))
        self.commands = np.stack([self._mean(ticks + x, i) for i, x in enumerate(late)], axis=1)
        self._late = late
        self._hold: tuple[np.ndarray, np.ndarray] | None = None

    def q(self) -> np.ndarray:
        """Motors' positions (n,)."""
        return self.data.qpos[self.rows] - self.step / 2 * self.data.qvel[self.columns]

    def qd(self) -> np.ndarray:
        """Motors' velocities (n,)."""
        return self.data.qvel[self.columns].copy()

    def start(self, row: int) -> None:
        """Set the arm to the measured state at a row, gears loaded by the torque, motors with their memory."""
        model, data, stretch = self.model, self.data, self.stretch
        mujoco.mj_resetData(model, data)
        data.qpos[self.rows] = stretch.q[row] + self.step / 2 * stretch.qd[row]
        data.qvel[self.columns] = stretch.qd[row]
        for i, gear in self._gears:
            torque = model.actuator_gainprm[i, 0] * stretch.tau[row, i] + model.actuator_biasprm[i, 0]
            at = model.jnt_qposadr[gear]
            if model.jnt_limited[gear]:
                data.qpos[at] = -np.sign(torque) * model.jnt_range[gear, 1]
            else:
                data.qpos[at] = -torque / model.jnt_stiffness[gear]
        now = stretch.t[row]
        for i in np.flatnonzero(model.actuator_delay > 0):
            ages = np.arange(model.actuator_history[i, 0], 0, -1) * self.step
            past = self._mean(now - ages + self._late[i], int(i))
            mujoco.mj_initCtrlHistory(model, data, int(i), -ages, np.ascontiguousarray(past[:, None]))
        for i in np.flatnonzero(self._lagging):
            data.act[model.actuator_actadr[i]] = self._lagged(now - model.actuator_delay[i] + self.step / 2, int(i))

    def _lagged(self, now: float, i: int) -> float:
        """The output of a first-order motor at a time [s], given the torques before it."""
        lag = self.model.actuator_dynprm[i, 0]
        ages = self.step * np.arange(max(1, round(8 * lag / self.step)))
        weights = np.exp(-ages / lag)
        return float(weights @ self._mean(now - ages - self.step / 2, i) / weights.sum())

    def _mean(self, times: np.ndarray, i: int) -> np.ndarray:
        """A joint's torque (K,), mean over the steps about these times."""
        quarter = self.step / 4
        return (self.stretch.torque(times - quarter)[:, i] + self.stretch.torque(times + quarter)[:, i]) / 2

    def hold(self, stiffness: np.ndarray, damping: np.ndarray) -> None:
        """From now on, put a spring and a damper (n,) between each joint and the measured motion. MuJoCo integrates the
        damper implicitly, so that it may be strong compared with a wrist's inertia."""
        self._hold = stiffness, damping
        self.model.dof_damping[self.columns] += damping

    def advance(self, row: int) -> None:
        """Simulate from a row to the next, under the logged torques."""
        q, qd = self.stretch.q, self.stretch.qd
        for k in range(self.substeps):
            if self._hold is not None:
                share = (k + 0.5) / self.substeps  # a step begins half a step before qpos
                wanted, speed = ((1 - share) * x[row] + share * x[row + 1] for x in (q, qd))
                stiffness, damping = self._hold
                pull = stiffness * (wanted - self.data.qpos[self.rows]) + damping * speed
                self.data.qfrc_applied[self.columns] = pull
            self.data.ctrl[:] = self.commands[row * self.substeps + k]
            mujoco.mj_step(self.model, self.data)
