"""Makes invdyn logs for tests, sound ones and broken ones, with h5py alone: it shares no code with `logfile`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

HEADER = {
    "format": "invdyn-log", "version": 1, "robot": "two_link", "urdf": "arm.urdf", "joint_names": ["shoulder", "elbow"],
    "torque_side": "link", "torque_unit": "N m", "rate": 100.0, "source": "a test", "licence": "MIT",
}  # fmt: skip


def motion(seconds: float = 10.0, rate: float = 100.0, t: np.ndarray | None = None) -> dict[str, np.ndarray]:
    """Sines of two joints on the clock t [s]: {"t" (T,), "q", "qd", "qdd", "tau" (T, 2)}, tau = 3 q in N m."""
    t = np.arange(round(seconds * rate)) / rate if t is None else t
    w, phase = 2 * np.pi * np.array([0.4, 0.7]), np.array([0.3, 1.1])
    angle = t[:, None] * w + phase
    q, qd, qdd = np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle)
    return {"t": t, "q": q, "qd": qd, "qdd": qdd, "tau": 3 * q}


def positions(**kwargs: Any) -> dict[str, np.ndarray]:
    """`motion` without its derivatives, as most logs come."""
    return {name: x for name, x in motion(**kwargs).items() if name in ("t", "q", "tau")}


def make_log(path: Path, trajectories: Mapping[str, Mapping[str, Any]] | None = None, **header: Any) -> Path:
    """Write a log with these trajectories (default: a sound one, "run"); header attributes given as None are left out.

    Arrays of a trajectory become its datasets, numbers and text its attributes.
    """
    with h5py.File(path, "w") as file:
        file.attrs.update({name: value for name, value in (HEADER | header).items() if value is not None})
        file.create_group("trajectories")
        for name, channels in ({"run": motion()} if trajectories is None else trajectories).items():
            group = file.create_group(f"trajectories/{name}")
            for channel, values in channels.items():
                if isinstance(values, np.ndarray):
                    group[channel] = values
                else:
                    group.attrs[channel] = values
    return path
