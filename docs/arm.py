"""Stands for a robot and its controller in docs/tutorial.md: python arm.py slow|fast|trajectory.csv log.csv

Plays a motion on a simulated arm with two effects that its URDF lacks, and writes arm.urdf and a CSV in ms, deg, N m.
"""

import sys
from pathlib import Path

import numpy as np

from invdyn_cli.robots import load_urdf
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.simulation.plant import record
from invdyn_cli.simulation.played import Played
from invdyn_cli.simulation.references import Multisine
from invdyn_cli.simulation.sensors import Noise

motion, csv = sys.argv[1:]
robot = load_urdf("apollo_arm")
Path("arm.urdf").write_text(robot.urdf)
motions = {"slow": Multisine(speed=0.1, amplitude=0.2), "fast": Multisine()}
hidden = [
    Hidden("coulomb_friction", "arm_joint_2", {"coulomb": 2.0}),
    Hidden("actuator_lag", "arm_joint_3", {"time_constant": 0.012}),
]
noise = Noise(torque=0.05, position=1e-5)
log = record(robot, [motions.get(motion) or Played(motion)], hidden, noise=noise, duration=20, seed=len(csv))
one, joints = log.trajectories[0], range(1, 8)
names = ["timestamp_ms", *(f"axis_{j}_angle" for j in joints), *(f"axis_{j}_moment" for j in joints)]
rows = np.column_stack([1000 * one.t, np.degrees(one.q), one.tau])
np.savetxt(csv, rows, "%.5f", delimiter=",", header=",".join(names), comments="")
