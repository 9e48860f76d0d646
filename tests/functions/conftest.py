"""A small arm with a hidden effect, as arrays, as objects and as files."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

import invdyn_cli as invdyn
from experiments.arms import random_arm
from invdyn_cli.log import Log
from invdyn_cli.types import Robot


@dataclass(frozen=True)
class Case:
    """The folder with arm.urdf and log.h5, what both hold, and which effect is hidden."""

    folder: Path
    robot: Robot
    log: Log
    joint: str = "axis2"
    coulomb: float = 2.0

    @property
    def arrays(self):
        """The recording as a user would have it in memory."""
        one = self.log.trajectories[0]
        return {"q": one.q, "tau": one.tau, "t": one.t, "q_ref": one.q_ref}


@pytest.fixture(scope="package")
def case(tmp_path_factory) -> Case:
    """Two joints, 12 s at 500 Hz, Coulomb friction on the second."""
    folder = tmp_path_factory.mktemp("case")
    (folder / "arm.urdf").write_text(random_arm(np.random.default_rng(0), 2))
    robot = invdyn.load_urdf(folder / "arm.urdf")
    hidden = {"effect": "coulomb_friction", "joint": Case.joint, "coulomb": Case.coulomb}
    options = {"trajectories": 1, "duration": 12.0, "rate": 500.0, "torque_noise": 0.02, "position_noise": 1e-6}
    log = invdyn.simulate(robot, effects=[hidden], **options)
    invdyn.write_log(replace(log, urdf=str(folder / "arm.urdf")), folder / "log.h5")
    return Case(folder, robot, log)
