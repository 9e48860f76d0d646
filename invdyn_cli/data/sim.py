"""data=sim_clean and data=sim_noisy: the sine tasks of section V-A, made from the robot's own rigid-body dynamics.

Eight tasks of 10 s at 0.1 to 0.8 Hz move all joints at once, sampled at 500 Hz; velocities and accelerations come from
differentiating positions, torques from inverse dynamics on those; 250 samples at either end are dropped, which leaves
the paper's 8 x 4,500. Noise: the positions are truncated after the fifth decimal and differentiated anew, while the
torques stay those of the unmodified positions.

The paper does not give amplitudes, the filter's weights, how closely the tasks follow one path, phases and the joints'
frequencies. The first three are options whose defaults were found on its interpolation results alone
(experiments/open_choices.md); the others are fixed here.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from invdyn_cli.effects.rigid import rigid_torque
from invdyn_cli.errors import UsageError
from invdyn_cli.interfaces import AbstractSource, Progress, silent
from invdyn_cli.maths import signals
from invdyn_cli.types import Dataset, Motion, Robot, Splits, Trajectory

TASKS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
"""Frequencies [Hz] of the tasks (paper, V-A.1)."""

TESTED = {"interpolation": (0.5, 0.6), "extrapolation": (0.7, 0.8)}
"""Tasks [Hz] for the test; all others are learned from (paper, Table II)."""

MULTIPLES = (1.0, 1.3, 0.7, 1.6, 0.9, 1.15, 1.45)
"""Every joint's frequency as a multiple of the task's, from the first joint on and over again. One frequency for all
joints would make the data one closed curve through q, run at different speeds, and extrapolation far too easy."""

PHASES = (0.0, 1.9, 4.1, 0.8, 5.3, 2.7, 3.6)
"""Every joint's phase [rad], which `jitter` varies from task to task."""

AMPLITUDES = (0.9, 1.0, 0.8, 0.95, 0.85, 1.0, 0.9)
"""Every joint's share of `amplitude`, from the first joint on and over again."""

DIGITS = 15
"""Decimal digits that a float64 holds."""

MOST_SAMPLES = 1_000_000
"""Largest number of samples of a task: eight tasks of half an hour at 500 Hz take 2 GB for seven joints."""


@dataclass(frozen=True)
class SineTasks(AbstractSource):
    """The simulated data of section V-A.

    Attributes:
        noisy: whether the positions are truncated after `decimals` decimals (paper, V-A.2).
        split: test frequencies: interpolation (0.5 and 0.6 Hz) or extrapolation (0.7 and 0.8 Hz; paper, Table II).
        amplitude: [rad; m] largest amplitude of a joint; others have 0.8 to 0.95 of it, as far as their limits allow.
        filter: differentiation: backward (differences of two samples), central or savgol (Savitzky-Golay).
        savgol_window: [samples] length of the window, for filter=savgol.
        savgol_order: [-] degree of the polynomial, for filter=savgol.
        validation_share: [-] middle share of every training task that is used for validation instead.
        duration: [s] length of a task.
        rate: [Hz] sampling rate.
        trim: [samples] dropped at either end of a task.
        decimals: [-] decimals of the positions that the truncation keeps.
        jitter: [rad] spread by which the phases of the tasks differ. With 0 all tasks run along one path through q, at
            eight speeds, and a model that knows the path needs no accelerations.
    """

    noisy: bool = False
    split: Literal["interpolation", "extrapolation"] = "interpolation"
    amplitude: float = 1.0
    filter: Literal["backward", "central", "savgol"] = "backward"
    savgol_window: int = 21
    savgol_order: int = 3
    validation_share: float = 0.1
    duration: float = 10.0
    rate: float = 500.0
    trim: int = 250
    decimals: int = 5
    jitter: float = 0.01

    def __post_init__(self) -> None:
        for name, allowed in (("split", TESTED), ("filter", signals.DERIVATIVES)):
            if getattr(self, name) not in allowed:
                raise UsageError(f"data.{name}={getattr(self, name)!r}; allowed: {', '.join(allowed)}")
        if not 0 < self.amplitude < np.inf:
            raise UsageError(f"data.amplitude={self.amplitude}; allowed: a number above 0 [rad; m]")
        if not 0 <= self.validation_share < 1:
            raise UsageError(f"data.validation_share={self.validation_share}; allowed: from 0 to below 1")
        if not 1 <= self.savgol_order < self.savgol_window <= self.duration * self.rate:
            raise UsageError(
                f"data.savgol_order={self.savgol_order} and data.savgol_window={self.savgol_window}; allowed: an order "
                ">= 1, and a window that is longer than the order but not longer than a task"
            )
        if not 0 <= self.jitter <= np.pi:
            raise UsageError(f"data.jitter={self.jitter}; allowed: a spread from 0 to pi [rad]")
        if not 0 <= self.decimals <= DIGITS:
            raise UsageError(f"data.decimals={self.decimals}; allowed: 0 to {DIGITS}, the digits of a float64")
        if not 0 < self.duration * self.rate <= MOST_SAMPLES:
            got = f"data.duration={self.duration} s at data.rate={self.rate} Hz"
            raise UsageError(f"{got}; allowed: both above 0, and at most {MOST_SAMPLES:.0e} samples per task")
        if self.trim < 0 or self.duration * self.rate - 2 * self.trim < 100:
            raise UsageError(
                f"data.duration={self.duration} s at data.rate={self.rate} Hz, minus 2 x data.trim={self.trim} "
                "samples, leaves fewer than 100 samples; allowed: 100 or more",
                advice="a longer duration, a higher rate or a smaller trim",
            )

    def load(self, robot: Robot | None, progress: Progress = silent) -> Splits:
        """36,000 samples; `tests` has "test", and for noisy data "test_clean": the same torques, noise-free inputs."""
        assert robot is not None
        clean, noisy = {}, {}
        for task in TASKS:
            q = self.positions(robot, task)
            clean[task] = self._trajectory(robot, task, q, q)
            modified = np.trunc(q * 10**self.decimals) / 10**self.decimals
            noisy[task] = self._trajectory(robot, task, modified, q) if self.noisy else clean[task]
            progress(len(clean) / len(TASKS), f"{task} Hz")
        tested = TESTED[self.split]
        learned = [noisy[task] for task in TASKS if task not in tested]

        def dataset(trajectories) -> Dataset:
            return Dataset(tuple(trajectories), robot.joints, robot)

        tests = {"test": dataset(noisy[task] for task in tested)}
        if self.noisy:
            tests["test_clean"] = dataset(clean[task] for task in tested)
        parted = [_parted(x, self.validation_share) for x in learned]
        return Splits(
            train=dataset(part for before, _, after in parted for part in (before, after) if len(part.t)),
            validation=dataset(watched for _, watched, _ in parted) if self.validation_share else None,
            tests=tests,
            description={
                "source": "sine tasks (simulated)",
                "amplitude": self.amplitude,
                "filter": self.filter,
                "noise": f"positions truncated after decimal {self.decimals}" if self.noisy else "none",
                "path": f"phases spread by {self.jitter} rad" if self.jitter else "one for all tasks",
                "train_Hz": [task for task in TASKS if task not in tested],
                "test_Hz": list(tested),
                "validation": f"the middle {self.validation_share:.0%} of every learned task",
            },
        )

    def positions(self, robot: Robot, task: float) -> np.ndarray:
        """q (T, n) [rad; m] of a task [Hz]: sines about the middle of each joint's range, at most 95 % of its half."""
        t = np.arange(round(self.duration * self.rate))[:, None] / self.rate
        n = robot.dofs
        bounded = np.isfinite(robot.lower) & np.isfinite(robot.upper)
        middle = np.where(bounded, (np.nan_to_num(robot.lower) + np.nan_to_num(robot.upper)) / 2, 0.0)
        room = np.where(bounded, 0.95 * (np.asarray(robot.upper) - np.asarray(robot.lower)) / 2, np.inf)
        amplitude = np.minimum(self.amplitude * np.resize(AMPLITUDES, n), room)
        phase = np.resize(PHASES, n) + self.jitter * np.random.default_rng(round(10 * task)).normal(size=n)
        return middle + amplitude * np.sin(2 * np.pi * task * np.resize(MULTIPLES, n) * t + phase)

    def _trajectory(self, robot: Robot, task: float, q: np.ndarray, q_of_torque: np.ndarray) -> Trajectory:
        motion = self._motion(q)
        true = motion if q_of_torque is q else self._motion(q_of_torque)
        tau = rigid_torque(robot, Motion(true.q.T, true.qd.T, true.qdd.T))
        t = np.arange(self.trim, self.trim + len(motion)) / self.rate
        return Trajectory(f"sine_{task:.1f}_Hz", t, motion, tau.T)

    def _motion(self, q: np.ndarray) -> Motion:
        window, order = (self.savgol_window, self.savgol_order) if self.filter == "savgol" else (3, 2)
        qd = signals.differentiate(q, self.rate, method=self.filter, window=window, order=order)
        qdd = signals.differentiate(qd, self.rate, method=self.filter, window=window, order=order)
        return Motion(q, qd, qdd)[slice(self.trim, len(q) - self.trim)]


def _parted(x: Trajectory, share: float) -> tuple[Trajectory, Trajectory, Trajectory]:
    """The parts before, in and after the middle block, which has this share of the data."""
    start, end = round(len(x.t) * (1 - share) / 2), round(len(x.t) * (1 + share) / 2)
    rows = slice(None, start), slice(start, end), slice(end, None)
    before, middle, after = (Trajectory(x.name, x.t[r], x.motion[r], x.tau[r]) for r in rows)
    return before, middle, after
