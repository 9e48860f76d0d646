"""The simulated arm follows its reference, is measured with its sensors, and makes a log that reads like a real one."""

import time
from dataclasses import replace

import numpy as np
import pytest

from invdyn_cli.errors import UsageError
from invdyn_cli.logfile import read_log, refuse_defects, write_log
from invdyn_cli.simulation.control import Control
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.simulation.plant import record, simulate
from invdyn_cli.simulation.references import ConstantSpeed, Multisine, PickPlace
from invdyn_cli.simulation.sensors import Noise


def everywhere(robot, effect: str, **parameters) -> list[Hidden]:
    """The effect on every joint."""
    return [Hidden(effect, joint, parameters) for joint in robot.joints]


@pytest.mark.parametrize("way", [Multisine(), PickPlace(), ConstantSpeed()], ids=lambda x: type(x).__name__)
def test_follows(way, apollo):
    """Without effects the arm stays within 0.02 rad of its reference: the feedforward is exact, the rest is the
    velocity filter's lag at reversals."""
    tr = simulate(apollo, way, duration=6.0)
    assert tr.q_ref is not None and np.abs(tr.q - tr.q_ref).max() < 0.02


HARD = {
    "friction": lambda r: everywhere(r, "coulomb_friction", coulomb=1.0) + everywhere(r, "viscous_friction", damping=1),
    "stribeck": lambda r: everywhere(r, "stribeck_friction", coulomb=1.0, static=1.5, velocity=0.1),
    "load": lambda r: everywhere(r, "load_dependent_friction", mu=0.2),
    "ripple": lambda r: everywhere(r, "torque_ripple", amplitude=0.5, cycles=6.0, phase=0.0),
    "rotors": lambda r: everywhere(r, "rotor_inertia", armature=0.2),
    "gain": lambda r: everywhere(r, "torque_gain_error", gain=0.7),
    "payload": lambda r: [Hidden("payload", None, {"mass": 3.0, "com": [0.05, 0.0, 0.1]})],
    "delay": lambda r: everywhere(r, "torque_delay", delay=0.02),
    "lag": lambda r: everywhere(r, "actuator_lag", time_constant=0.02),
}


@pytest.mark.parametrize("name", HARD)
def test_stays_in_control(name, apollo):
    """With effects on all joints at once, delays of 20 ms among them, the arm still follows to 0.2 rad."""
    tr = simulate(apollo, Multisine(), HARD[name](apollo), duration=5.0)
    assert tr.q_ref is not None and np.abs(tr.q - tr.q_ref).max() < 0.2


def test_a_controller_that_knows_less(apollo):
    """A controller that knows only the nominal arm follows worse, and the log says the same about the arm."""
    hidden = [Hidden("payload", None, {"mass": 0.5, "com": [0.0, 0.0, 0.1]})]
    knowing, nominal = (
        simulate(apollo, Multisine(), hidden, duration=4.0, control=Control(knows=x)) for x in ("arm", "nominal")
    )
    errors = [np.abs(tr.q - tr.q_ref).max() for tr in (knowing, nominal)]
    assert errors[1] > 5 * errors[0]


def test_sensors(apollo):
    """Positions come in whole steps; noise on torques is on the log alone, and as large as it was asked for."""
    how = {"duration": 3.0, "seed": 3}
    plain = simulate(apollo, Multisine(), **how)
    steps = simulate(apollo, Multisine(), noise=Noise(position_quantum=1e-3), **how)
    np.testing.assert_allclose(steps.q / 1e-3, np.round(steps.q / 1e-3), atol=1e-9)
    noisy = simulate(apollo, Multisine(), noise=Noise(torque=[0.1 * i for i in range(7)], torque_quantum=0.01), **how)
    assert np.array_equal(noisy.q, plain.q)
    np.testing.assert_allclose((noisy.tau - plain.tau).std(0), 0.1 * np.arange(7), rtol=0.05, atol=0.004)
    np.testing.assert_allclose(noisy.tau / 0.01, np.round(noisy.tau / 0.01), atol=1e-9)


def test_noise_is_fed_back(apollo):
    """The controller sees the noise of the positions: the torques answer to it, and the arm to the torques."""
    how = {"duration": 2.0, "seed": 3}
    plain, noisy = (simulate(apollo, Multisine(), noise=Noise(position=x, velocity=0.0), **how) for x in (0.0, 1e-4))
    assert noisy.qd is not None and plain.qd is not None
    np.testing.assert_allclose((noisy.q - plain.q).std(0), 1e-4, rtol=0.2)
    assert np.diff(noisy.tau, axis=0).std() > 5 * np.diff(plain.tau, axis=0).std()
    assert 1e-6 < np.abs(noisy.qd - plain.qd).max() < 0.05


def test_logged_velocities(apollo):
    """A velocity sensor logs true velocities with its noise; without one none are logged."""
    tr = simulate(apollo, Multisine(), duration=2.0, noise=Noise(velocity=0.0))
    assert tr.qd is not None
    np.testing.assert_allclose(tr.qd[1:-1], np.gradient(tr.q, 1e-3, axis=0)[1:-1], atol=1e-4)
    assert simulate(apollo, Multisine(), duration=0.1).qd is None


def test_steps_of_the_physics(apollo):
    """Four steps per sample are enough: sixteen change the torques by less than 1e-4 of theirs."""
    four, sixteen = (simulate(apollo, Multisine(), duration=2.0, substeps=s).tau for s in (4, 16))
    assert np.sqrt(((four - sixteen) ** 2).mean()) < 1e-4 * np.sqrt((sixteen**2).mean())


def test_comes_from_its_seed(apollo):
    """The same seed gives the same log to the last bit, another one another."""
    logs = [record(apollo, [Multisine()], noise=Noise(torque=0.1), duration=1.0, seed=s) for s in (1, 1, 2)]
    one, same, other = (log.trajectories[0].tau for log in logs)
    assert np.array_equal(one, same)
    assert not np.allclose(one, other)


def test_makes_a_log(apollo, tmp_path):
    """A recording is an invdyn log without defects, and reads back as it was written."""
    log = record(apollo, [Multisine(), PickPlace()], duration=4.0, torque_side="motor", position_side="motor")
    refuse_defects(log)
    write_log(log, tmp_path / "log.h5")
    back = read_log(tmp_path / "log.h5")
    assert [raw.name for raw in back.trajectories] == ["trajectory_1", "trajectory_2"]
    assert (back.joints, back.torque_side, back.position_side, back.rate) == (apollo.joints, "motor", "motor", 1000.0)
    for a, b in zip(log.trajectories, back.trajectories, strict=True):
        assert np.array_equal(a.tau, b.tau) and np.array_equal(a.q, b.q)


def test_says_what_was_added(apollo):
    """A joint with nothing to move is simulated all the same, and the trajectory's notes say what it got for that."""
    empty = replace(apollo, inertial=np.vstack([apollo.inertial[:-1], np.zeros(10)]))
    assert "arm_joint_7" in simulate(empty, Multisine(), duration=0.5).notes


def test_out_of_control(apollo, tmp_path, monkeypatch):
    """An arm that cannot hold its own weight is stopped in one line that says which joint and when, and MuJoCo leaves
    no file of warnings behind."""
    monkeypatch.chdir(tmp_path)
    weak = [Hidden("torque_saturation", "arm_joint_2", {"limit": 1.0})]
    with pytest.raises(UsageError, match=r"out of control.*arm_joint.*Try: smaller hidden effects"):
        simulate(apollo, Multisine(), weak, duration=5.0)
    wild = [Hidden("custom", "arm_joint_2", {"force": lambda t, q, qd: -1e6 * qd - 1e6})]
    with pytest.raises(UsageError, match="out of control"):
        simulate(apollo, Multisine(), wild, duration=5.0, control=Control(largest_error=1e9))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"duration": 0.0}, "duration=0.0 s"),
        ({"substeps": 0}, "substeps=0; allowed: a whole number from 1"),
        ({"torque_side": "gear"}, "torque_side='gear'; allowed: command, motor, link"),
        ({"noise": Noise(position=[1.0, 2.0])}, "noise.position=.*a list of 7"),
        ({"noise": Noise(torque=-1.0)}, "noise.torque=-1.0"),
    ],
    ids=["duration", "substeps", "torque_side", "noise_shape", "noise_sign"],
)
def test_refuses(options, said, apollo):
    """Options out of range are refused before anything is simulated."""
    with pytest.raises(UsageError, match=said):
        simulate(apollo, Multisine(), **{"duration": 1.0, **options})


def test_is_fast(apollo):
    """Ten seconds of seven joints take less than three, and usually half of one."""
    start = time.perf_counter()
    simulate(apollo, Multisine(), everywhere(apollo, "coulomb_friction", coulomb=0.5), duration=10.0)
    assert time.perf_counter() - start < 3.0
