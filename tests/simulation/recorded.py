"""What a recording of the simulated arm says: its true motion and Pinocchio's torque of that, beside the logged one.

The nominal torque is of the true motion (noise-free positions, differentiated). Both torques are filtered alike; the
logged one is the mean of what was held before and after t.
"""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.signal import butter, sosfiltfilt

from invdyn_cli.robots import pinocchio_model
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.simulation.plant import simulate
from invdyn_cli.simulation.references import Multisine

RATE, SECONDS = 1000.0, 6.0


@dataclass(frozen=True)
class Truth:
    """What the term of an effect on joint column i may depend on; arrays (T, n)."""

    t: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    nominal: np.ndarray
    logged: np.ndarray


def filtered(x: np.ndarray) -> np.ndarray:
    """(T, n) through a zero-phase low-pass at 20 Hz, a second off either end."""
    return sosfiltfilt(butter(4, 20.0, fs=RATE, output="sos"), x, axis=0)[1000:-1000]


def rms(x: np.ndarray, axis=None):
    """Root of the mean square."""
    return np.sqrt((x**2).mean(axis))


def rests(qd: np.ndarray) -> np.ndarray:
    """(T - 2000,) whether a joint rests or turns within 0.1 s: there friction sticks, sign(qd) jumps, and the filter
    carries it."""
    slow = (np.abs(qd) < 0.01).astype(float)
    return np.convolve(slow, np.ones(201), "same")[1000:-1000] > 0.5


def middle(held: np.ndarray) -> np.ndarray:
    """(T, n) torques held from t on -> their value at t, between the one before and the one after."""
    return np.concatenate([held[:1], (held[1:] + held[:-1]) / 2])


def truth(robot, trajectory, offset=0.0) -> Truth:
    """The true motion by central differences, Pinocchio's torque of it, and the logged one at its middle."""
    q = trajectory.q - offset
    qd, qdd = np.gradient(q, 1 / RATE, axis=0), np.zeros_like(q)
    qdd[1:-1] = np.diff(q, 2, axis=0) * RATE**2
    model = pinocchio_model(robot)
    data = model.createData()
    nominal = np.array([pin.rnea(model, data, *rows) for rows in zip(q, qd, qdd, strict=True)])
    return Truth(trajectory.t, q, qd, qdd, nominal, middle(trajectory.tau))


def recorded(robot, *hidden: Hidden, **options):
    """Six seconds of a multisine, unless the options have it otherwise."""
    return simulate(robot, Multisine(), hidden, **{"duration": SECONDS, "rate": RATE, "seed": 2, **options})
