"""invdyn simulate: a log that real_log reads, with its URDF, and the truth beside it."""

import json
from pathlib import Path

import numpy as np

from invdyn_cli.logfile import read_log
from invdyn_cli.robots import load_urdf

EFFECTS = "data.effects=[{effect: coulomb_friction, joint: arm_joint_2, coulomb: 2.0}]"
TINY = ("data.duration=4", "data.trajectories=2", EFFECTS)


def test_leaves_its_files(command):
    """The last line is the folder, which holds log.h5, robot.urdf and truth.json; the table names what is hidden."""
    said = command("simulate", *TINY)
    assert (said.code, said.err) == (0, [])
    folder = Path(said.out[-1])
    assert folder.parts[:2] == ("outputs", "logs")
    assert {p.name for p in folder.iterdir() if not p.name.startswith(".")} == {"log.h5", "robot.urdf", "truth.json"}
    text = "\n".join(said.out)
    assert all(word in text for word in ("trajectory_1", "trajectory_2", "coulomb_friction", "arm_joint_2"))
    log = read_log(folder / "log.h5")
    assert Path(log.urdf).samefile(folder / "robot.urdf")
    assert len(log.trajectories) == 2 and len(log.trajectories[0].t) == 4000


def test_tells_the_truth(command):
    """truth.json has every hidden effect with joint and parameters, and all options of the recording."""
    command("simulate", *TINY, "data.seed=5", "hydra.run.dir=out")
    truth = json.loads(Path("out/truth.json").read_text())
    assert truth["schema"] == "invdyn-truth/1"
    assert truth["effects"] == [{"effect": "coulomb_friction", "joint": "arm_joint_2", "parameters": {"coulomb": 2.0}}]
    assert truth["joints"] == [f"arm_joint_{i}" for i in range(1, 8)]
    assert '"seed": 5' in json.dumps(truth["source"])


def test_tells_when(command):
    """What comes and goes has its window, and its trajectory where it names one, beside its parameters."""
    contact = "effect: external_contact, joint: arm_joint_4, force: [0, 9, 0], window: [1, 2], trajectory: trajectory_2"
    said = command("simulate", *TINY[:2], f"data.effects=[{{{contact}}}]", "hydra.run.dir=out")
    assert said.code == 0, said.err
    (told,) = json.loads(Path("out/truth.json").read_text())["effects"]
    assert told["parameters"] == {"force": [0, 9, 0]}
    assert (told["window"], told["trajectory"]) == ([1, 2], "trajectory_2")


def test_is_read_as_a_real_log(command):
    """The log goes straight into invdyn run, with the robot that it names; an exact model of a clean log is exact."""
    made = ("robot.dofs=3", "data.duration=6", "data.trajectories=2", "hydra.run.dir=out")
    assert command("simulate", *made).code == 0
    said = command(
        "run", "data=real_log", "data.path=out/log.h5", "data.decimate=20", "model=pest", "hydra.run.dir=run"
    )
    assert said.code == 0, said.err
    metrics = json.loads(Path("run/metrics.json").read_text())
    assert metrics["test"]["nmse"]["joint"]["arm_joint_2"] < 1e-3


def test_data_plant_runs(command):
    """invdyn run data=plant works with the robot that stands there by default."""
    said = command("run", "data=plant", "model=pest", "data.duration=4", "data.trajectories=2", "hydra.run.dir=run")
    assert said.code == 0, said.err
    assert json.loads(Path("run/metrics.json").read_text())["data"] == "plant"


def test_a_reference_with_options(command):
    """The way it moves may be an object with options of its own, and velocities are logged on request."""
    way = "data.reference={_target_: invdyn_cli.simulation.references.ConstantSpeed, together: true}"
    said = command(
        "simulate", way, "data.duration=4", "data.trajectories=1", "data.velocity_noise=0.01", "hydra.run.dir=o"
    )
    assert said.code == 0, said.err
    assert read_log("o/log.h5").trajectories[0].qd is not None


def test_what_the_urdf_does_not_say(command):
    """Options of the robot that no URDF keeps are named, so that they are given again."""
    said = command("simulate", *TINY, "robot.gravity=[0,0,-3.7]", "hydra.run.dir=out")
    assert any("robot.gravity" in line for line in said.out)


def test_a_shorter_arm_is_written_whole(command):
    """The URDF beside a log of the first joints is that of the shorter arm: read without robot.dofs, it is the one that
    was simulated."""
    assert command("simulate", *TINY, "robot.dofs=4", "hydra.run.dir=out").code == 0
    kept, simulated = load_urdf("out/robot.urdf"), load_urdf("apollo_arm", dofs=4)
    assert kept.joints == simulated.joints and np.array_equal(kept.inertial, simulated.inertial)


def test_misuse_is_one_line(command):
    """Another source, an unknown effect, an unknown joint, an arm out of control: one line each, exit code 2."""
    for overrides, word in (
        (("data=sim_noisy",), "data=plant"),
        (("data=real_log",), "data=plant"),
        (("data.effects=[{effect: coulomb}]",), "no effect 'coulomb'"),
        (("data.effects=[{effect: torque_offset, joint: j1, offset: 1}]",), "no joint 'j1'"),
        (("data.effects=[{effect: payload_change, mass: 1, com: [0, 0, 0.1], window: [1, 99]}]",), "up to 30 s"),
        (("data.link_encoder=true",), "position_side=motor"),
        (("data.effects=[{effect: torque_saturation, joint: arm_joint_2, limit: 1}]",), "out of control"),
        (("data.durations=3",), "data.duration"),
    ):
        said = command("simulate", *overrides)
        assert said.code == 2
        assert len(said.err) == 1 and word in said.err[0]
