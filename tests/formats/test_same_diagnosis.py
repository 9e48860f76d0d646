"""A diagnosis does not depend on the format of the file that the recording came in."""

import json
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest

import invdyn_cli as invdyn
from experiments.arms import random_arm
from invdyn_cli.log import Log, RawTrajectory
from invdyn_cli.types import Robot
from tests.formats import recordings
from tests.formats.recordings import WRITERS

HOW = {"options": invdyn.Options(replay=False), "design": False}
KNOWN = {"torque_side": "motor", "robot_name": "arm", "q": {"unit": "rad"}, "tau": {"unit": "N m"}}
"""What not every format says."""

CHANNELS = ("t", "q", "qd", "tau")

CLOSE = 1e-9
"""Of a number of diagnosis.json, relative to it or, below 1, absolute: bags count whole nanoseconds since 1970."""

Entries = dict[str, object]


@dataclass(frozen=True)
class Case:
    """A robot, its recording, and the entries of diagnosis.json by log; logs alike to the last bit are diagnosed
    once."""

    folder: Path
    robot: Robot
    data: recordings.Recording
    known: dict[tuple, Entries] = field(default_factory=dict)

    def diagnosed(self, log: Log) -> Entries:
        (one,) = log.trajectories
        key = tuple(getattr(one, channel).tobytes() for channel in CHANNELS)
        if key not in self.known:
            result = invdyn.diagnose(replace(log, trajectories=(replace(one, name="run"),)), self.robot, **HOW)
            result.save(self.folder)
            self.known[key] = dict(flat("", json.loads((self.folder / "diagnosis.json").read_text())))
        return self.known[key]


@pytest.fixture(scope="module")
def case(tmp_path_factory) -> Case:
    """12 s at 500 Hz of an arm of two joints with Coulomb friction on the second, as an invdyn log, too."""
    folder = tmp_path_factory.mktemp("same")
    (folder / "arm.urdf").write_text(random_arm(np.random.default_rng(0), 2))
    robot = invdyn.load_urdf(folder / "arm.urdf")
    hidden = {"effect": "coulomb_friction", "joint": "axis2", "coulomb": 2.0}
    options = {"trajectories": 1, "duration": 12.0, "rate": 500.0, "torque_noise": 0.02, "position_noise": 1e-6}
    log = invdyn.simulate(robot, effects=[hidden], **options)
    (one,) = log.trajectories
    data = {"t": one.t, "q": one.q, "qd": np.gradient(one.q, one.t, axis=0), "tau": one.tau}
    one = RawTrajectory("run", **data)
    invdyn.write_log(replace(log, robot="arm", torque_side="motor", trajectories=(one,)), folder / "run.h5")
    return Case(folder, robot, data)


def flat(at: str, node: object) -> Iterator[tuple[str, object]]:
    """Every entry of a tree by its path."""
    if not isinstance(node, dict | list):
        yield at, node
        return
    for key, value in node.items() if isinstance(node, dict) else enumerate(node):
        yield from flat(f"{at}/{key}", value)


@pytest.mark.parametrize("kind", WRITERS)
def test_the_same_diagnosis_through_every_format(kind, case, tmp_path, monkeypatch):
    """One recording through any format has the diagnosis of the HDF5 file: the same entries, all numbers to 1e-9."""
    monkeypatch.setattr(recordings, "JOINTS", case.robot.joints)
    expected = case.diagnosed(invdyn.read(case.folder / "run.h5"))
    found = case.diagnosed(invdyn.read(WRITERS[kind](tmp_path, case.data), columns=KNOWN))
    assert found.keys() == expected.keys()
    for place, value in expected.items():
        assert found[place] == (pytest.approx(value, rel=CLOSE, abs=CLOSE) if isinstance(value, float) else value), (
            place
        )
