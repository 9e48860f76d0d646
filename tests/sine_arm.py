"""The paper's interpolation split on a short arm, thinned, so that models are fitted within seconds."""

from dataclasses import replace
from functools import cache

import numpy as np

from invdyn_cli.data.sim import SineTasks
from invdyn_cli.interfaces import AbstractModel
from invdyn_cli.maths.metrics import nmse
from invdyn_cli.robots import load_urdf
from invdyn_cli.types import Dataset, Fit, Trajectory


def thinned(data: Dataset, step: int) -> Dataset:
    """Every `step`-th sample of each trajectory."""
    return replace(data, trajectories=tuple(x[slice(None, None, step)] for x in data.trajectories))


@cache
def sine_tasks(joints: int = 2, step: int = 40, **options) -> tuple[Dataset, Dataset]:
    """Training set (24,300 / step samples) and test set (450 samples at 0.5 and 0.6 Hz) without noise."""
    splits = SineTasks(**options).load(load_urdf("apollo_arm", dofs=joints))
    return thinned(splits.train, step), thinned(splits.tests["test"], 20)


def rubbed(data: Dataset) -> Dataset:
    """The same with Coulomb (1.5 N m) and viscous friction (0.5 N m s/rad) in every joint."""

    def more(x: Trajectory) -> Trajectory:
        return replace(x, tau=x.tau + 1.5 * np.clip(x.motion.qd / 0.02, -1, 1) + 0.5 * x.motion.qd)

    return replace(data, trajectories=tuple(more(x) for x in data.trajectories))


def error(model: AbstractModel, fit: Fit, data: Dataset) -> np.ndarray:
    """NMSE (n,)."""
    return nmse(data.tau, model.predict(fit, data.motion))


def ridge_error(train: Dataset, test: Dataset) -> np.ndarray:
    """NMSE (n,) of linear regression on [q, qd, qdd, 1]: what a model must beat to have learned more than a plane."""

    def rows(data: Dataset) -> np.ndarray:
        motion = data.motion
        return np.hstack([motion.q, motion.qd, motion.qdd, np.ones((data.samples, 1))])

    return nmse(test.tau, rows(test) @ np.linalg.lstsq(rows(train), train.tau, rcond=None)[0])
