"""Sensor errors of the simulated arm's encoders and torques: white noise, then quantisation."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from invdyn_cli.errors import UsageError


@dataclass(frozen=True)
class Noise:
    """Measuring errors, white, one number for all joints or one for each.

    Attributes:
        position: [rad; m] rms on the measured positions, which the controller sees too.
        torque: [N m; N] rms on the logged torques; the joints receive the torques without it.
        position_quantum, torque_quantum: [rad; m], [N m; N] whole steps of what is measured and logged; 0: none.
        velocity: [rad/s; m/s] rms of a velocity sensor; None: velocities are not logged.
    """

    position: float | Sequence[float] = 0.0
    torque: float | Sequence[float] = 0.0
    position_quantum: float | Sequence[float] = 0.0
    torque_quantum: float | Sequence[float] = 0.0
    velocity: float | Sequence[float] | None = None

    def of(self, name: str, joints: int) -> np.ndarray:
        """One of the numbers for each joint, (n,); zeros for what there is none of.

        Raises:
            UsageError: if there are not as many as joints, or one is negative or no number.
        """
        value = getattr(self, name)
        if value is None:
            return np.zeros(joints)
        try:
            numbers = np.asarray(value, float)
        except (TypeError, ValueError):
            numbers = np.array(np.nan)
        if numbers.shape not in ((), (joints,)) or not np.all(numbers >= 0) or not np.isfinite(numbers).all():
            raise UsageError(f"noise.{name}={value}; allowed: a number >= 0, or a list of {joints}, one for each joint")
        return np.broadcast_to(numbers, joints).copy()


def stepped(x: np.ndarray, quantum: np.ndarray) -> np.ndarray:
    """x (..., n) rounded to whole steps of quantum (n,); unchanged where that is 0."""
    return np.where(quantum > 0, np.round(x / np.where(quantum > 0, quantum, 1.0)) * quantum, x)


class Late:
    """Torques on their way to the log, sample by sample: behind a first-order filter of each joint, and a delay.

    Args:
        delay, constant: (n,) [samples] of the delay, and the filter's time constant; 0: none.
    """

    def __init__(self, delay: np.ndarray, constant: np.ndarray) -> None:
        self._keeps = np.exp(-1 / np.where(constant > 0, constant, 1.0)) * (constant > 0)
        self._whole, self._part = np.divmod(delay, 1.0)
        self._joints = np.arange(len(delay))
        self._past = np.empty((0, len(delay)))  # filtered, the newest first
        self._held = np.empty(0)

    def __call__(self, tau: np.ndarray) -> np.ndarray:
        """What arrives of torques (n,) that are held from this sample on."""
        if not len(self._past):
            self._past = np.tile(tau, (int(self._whole.max()) + 2, 1))
            self._held = tau
        held = np.where(self._keeps > 0, self._held, tau)  # a filter has answered to what was held until now
        self._past = np.concatenate([[held + self._keeps * (self._past[0] - held)], self._past[:-1]])
        self._held = tau
        newer, older = (self._past[self._whole.astype(int) + k, self._joints] for k in (0, 1))
        return newer + self._part * (older - newer)


Side = Literal["command", "motor", "link"]
"""Where the torque is taken; command, motor: what the controller asked for; link: behind the gear and its friction."""

SIDES: tuple[str, ...] = get_args(Side)
