"""data=plant: a simulated arm's log, split and conditioned as a measured one."""

import numpy as np
import pytest

from invdyn_cli.data.plant import Plant
from invdyn_cli.data.recorded import RealLog
from invdyn_cli.errors import InvdynError, UsageError
from invdyn_cli.logfile import write_log
from invdyn_cli.simulation.references import PickPlace
from invdyn_cli.testing import check_source

FRICTION = {"effect": "coulomb_friction", "joint": "arm_joint_2", "coulomb": 2.0}
SHORT = {"duration": 3.0, "trajectories": 2, "effects": [FRICTION]}


def test_keeps_the_contract(apollo):
    """It passes the checks that third parties' sources have to pass."""
    check_source(Plant(**SHORT), apollo)


def test_is_a_real_log(apollo, tmp_path):
    """What it gives is what real_log gives of its log, sample by sample."""
    source = Plant(**SHORT, decimate=5, filter_cutoff=12.0, test=["trajectory_2[1:]"])
    write_log(source.record(apollo), tmp_path / "log.h5")
    read = RealLog(str(tmp_path / "log.h5"), decimate=5, filter_cutoff=12.0, test=["trajectory_2[1:]"])
    made, expected = source.load(apollo), read.load(apollo)
    for a, b in ((made.train, expected.train), (made.tests["test"], expected.tests["test"])):
        assert [x.name for x in a.trajectories] == [x.name for x in b.trajectories]
        assert np.array_equal(a.tau, b.tau) and np.array_equal(a.motion.qdd, b.motion.qdd)


def test_says_what_it_made(apollo):
    """The description holds the hidden effects and the way it moved, for the record."""
    said = Plant(duration=8.0, trajectories=1, effects=[FRICTION], reference=PickPlace()).load(apollo).description
    assert said["reference"] == "PickPlace"
    assert said["effects"] == [{"effect": "coulomb_friction", "joint": "arm_joint_2", "parameters": {"coulomb": 2.0}}]
    assert said["torque_side"] == "command"


def test_trajectories_differ(apollo):
    """Each trajectory is another motion, and the seed makes others."""
    first, second = Plant(**SHORT).record(apollo).trajectories
    assert not np.allclose(first.q, second.q)
    (again,) = Plant(duration=3.0, trajectories=1, effects=[FRICTION], seed=1).record(apollo).trajectories
    assert np.array_equal(again.q, second.q)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"effects": ["coulomb_friction"]}, "data.effects has 'coulomb_friction'.*Try: "),
        ({"effects": [{"effect": "friction"}]}, "no effect 'friction'"),
        ({"effects": [{"effect": "coulomb_friction", "joint": "arm_joint_2"}]}, "lacks coulomb"),
        ({"reference": "sine"}, "data.reference=sine; allowed: multisine, pick_place, constant_speed"),
        ({"trajectories": 0}, "data.trajectories=0"),
        ({"seed": -1}, "data.seed=-1"),
        ({"torque_side": "gear"}, "data.torque_side=gear; allowed: command, motor, link"),
        ({"rate": 0.0}, "rate=0.0 Hz"),
        ({"decimate": 0}, "data.decimate=0"),
        ({"control_frequency": 0.0}, "control.frequency=0.0"),
        ({"train": ["trajectory_9"]}, "no trajectory 'trajectory_9'"),
        ({"position_noise": [1e-5, 1e-5]}, "noise.position=.*a list of 7"),
    ],
    ids=lambda x: next(iter(x)) + str(len(str(x))) if isinstance(x, dict) else "said",
)
def test_refuses(options, said, apollo):
    """Every misuse is one line that says what is allowed."""
    with pytest.raises(InvdynError, match=said):
        Plant(**{"duration": 1.0, "trajectories": 1, **options}).load(apollo)


def test_an_effect_on_a_joint_of_another_robot(apollo):
    """The joint's name is checked against the robot, as soon as there is one."""
    source = Plant(effects=[FRICTION | {"joint": "panda_joint2"}])
    with pytest.raises(UsageError, match=r"no joint 'panda_joint2'.*allowed: arm_joint_1"):
        source.load(apollo)
