"""The simulated arm beside the measured motion: a right model stays with it, a wrong one does not."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from experiments.arms import random_robot
from experiments.truth import mjcf_of
from invdyn_cli.errors import LogError, UsageError
from invdyn_cli.simulation.arm import GEAR
from invdyn_cli.simulation.driven import Segment
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.simulation.plant import simulate
from invdyn_cli.simulation.references import Multisine
from invdyn_cli.simulation.replay import MEMORY, feedback, free, held, replay, window_starts
from invdyn_cli.simulation.sensors import Noise
from invdyn_cli.types import Robot

CLOSE = 5e-4
"""[rad] after 0.2 s: the log's arm takes four steps where the replay takes one, and joints stick by either."""


@pytest.fixture(scope="module")
def arm() -> Robot:
    return random_robot(np.random.default_rng(3), 3)


def measured(robot: Robot, *hidden: Hidden, seconds: float = 3.0) -> Segment:
    """What an arm with something hidden in it does, without noise."""
    raw = simulate(robot, Multisine(), hidden, noise=Noise(velocity=0.0), duration=seconds, seed=1)
    assert raw.qd is not None
    return Segment(raw.name, raw.t, raw.q, raw.qd, raw.tau, held=True)


HELD = {
    "clean": (),
    "friction": (
        Hidden("coulomb_friction", "axis2", {"coulomb": 2.0}),
        Hidden("viscous_friction", "axis1", {"damping": 1.0}),
        Hidden("quadratic_friction", "axis3", {"drag": 0.2}),
    ),
    "one way": (Hidden("asymmetric_coulomb_friction", "axis2", {"positive": 3.0, "negative": 1.0}),),
    "channel": (
        Hidden("torque_gain_error", "axis2", {"gain": 0.9}),
        Hidden("torque_offset", "axis2", {"offset": 1.0}),
        Hidden("torque_saturation", "axis2", {"limit": 30.0}),
    ),
    "late": (
        Hidden("torque_delay", "axis2", {"delay": 0.0123}),
        Hidden("actuator_lag", "axis1", {"time_constant": 0.011}),
        Hidden("torque_delay", "axis1", {"delay": 0.005}),
    ),
    "bodies": (
        Hidden("payload", None, {"mass": 0.5, "com": (0.0, 0.02, 0.1)}),
        Hidden("link_inertia_error", "axis2", {"mass": 0.5, "com": (0.01, 0, 0), "inertia": 0.2}),
        Hidden("base_tilt", None, {"angle": 0.1, "azimuth": 0.5}),
        Hidden("rotor_inertia", "axis1", {"armature": 0.1}),
    ),
    "zeros": (
        Hidden("encoder_offset", "axis2", {"offset": 0.05}),
        Hidden("joint_spring", "axis2", {"stiffness": 5.0, "rest": 0.3}),
    ),
}
"""What an MJCF holds wholly."""


@pytest.mark.parametrize("name", HELD)
def test_what_is_written_moves_as_the_arm_did(arm, name):
    """The arm with what was hidden stays within CLOSE of the measured motion; the nominal one is off by ten times as
    much at least."""
    stretch = measured(arm, *HELD[name])
    text, said = mjcf_of(arm, HELD[name])
    assert said == ()
    starts = window_starts(stretch, every=0.4)
    after = free(text, stretch, starts)
    assert after.shape == (len(starts), 201, 3) and np.abs(after).max() < CLOSE
    if HELD[name]:
        assert np.abs(free(mjcf_of(arm)[0], stretch, starts)).max() > 10 * CLOSE


def test_a_replay_tells_the_gain(arm):
    """Errors fall where the friction was and is written, a right arm is held by next to nothing, and the trace is that
    of the joint that gains most."""
    hidden = HELD["friction"][:1]
    stretch = measured(arm, *hidden, seconds=5.0)
    out = replay(mjcf_of(arm)[0], mjcf_of(arm, hidden)[0], [stretch], arm.joints, most=10, not_held=("a word",))
    assert out.gain > 0.95 and out.windows == 10
    assert out.torque_before[1] == pytest.approx(2.0, rel=0.2)  # it is the friction that has to be made up for
    assert out.torque_after.max() < 0.02 and out.held_after.max() < 0.01 * out.held_before.max()
    assert {x.joint for x in out.traces} == {arm.joints[int(np.argmax(out.before))]}
    tree = out.as_dict()
    assert tree["windows"]["before"]["axis2"] == out.before[1] and tree["windows"]["length_s"] == 0.2
    assert set(tree) == {"windows", "closed_loop", "not_held"} and tree["not_held"] == ["a word"]


def test_the_arm_is_held_whatever_its_motors_do(arm):
    """What holds the arm is set by its inertias and torques, and by no motor; a right model needs next to none of it
    even where a motor is so late that feedback through it would swing."""
    late = [Hidden("torque_delay", "axis3", {"delay": 0.05})]
    stretch = measured(arm, *late)
    gains = feedback(mjcf_of(arm)[0], [stretch])
    moved, pulled = held(mjcf_of(arm, late)[0], stretch, *gains)
    assert moved.shape == pulled.shape == (3000 - 1 - round(MEMORY / 0.001), 3)
    assert np.abs(moved).max() < CLOSE and np.abs(pulled).max() < 0.01 * np.abs(stretch.tau).max()
    off, _ = held(mjcf_of(arm)[0], stretch, *gains)
    assert np.abs(off).max() > 10 * np.abs(moved).max()


def test_a_gear_starts_loaded(arm):
    """An arm that rests on an elastic joint, or on one side of its play, stays where it is: the gear begins bent."""
    for effect, bent in (
        (Hidden("joint_elasticity", "axis2", {"stiffness": 200.0}), lambda tau: -tau / 200.0),
        (Hidden("backlash", "axis2", {"gap": 0.04}), lambda tau: -0.02 * np.sign(tau)),
    ):
        text, _ = mjcf_of(arm, [effect, Hidden("rotor_inertia", "axis2", {"armature": 0.05})])
        model = mujoco.MjModel.from_xml_string(text)
        data, q = mujoco.MjData(model), np.array([0.3, 0.5, -0.4])
        names = [model.joint(i).name for i in range(model.njnt)]
        own, gear = [names.index(x) for x in arm.joints], names.index("axis2" + GEAR)
        tau = np.zeros(3)
        for _ in range(50):  # the torque bends the gear, and the bent gear asks for another torque
            data.qpos[own], data.qpos[gear] = q, bent(tau[1])
            mujoco.mj_forward(model, data)
            tau = data.qfrc_bias[own].copy()
        rest = Segment("rest", 0.001 * np.arange(400), *(np.tile(x, (400, 1)) for x in (q, 0 * q, tau)))
        assert np.abs(free(text, rest, [100])).max() < CLOSE


def test_clocks_need_not_be_those_of_the_simulation(arm):
    """At 250 Hz, with torques that run in straight lines, the same motion ends as close, up to what a held torque and
    a straight one differ by."""
    fine = measured(arm, *HELD["friction"])
    tau = (fine.tau + np.roll(fine.tau, 1, axis=0)) / 2  # held from t on: at t it is the mean of before and after
    rows = slice(4, None, 4)
    coarse = Segment("coarse", fine.t[rows], fine.q[rows], fine.qd[rows], tau[rows])
    error = free(mjcf_of(arm, HELD["friction"])[0], coarse, window_starts(coarse, every=0.4))
    assert np.abs(error).max() < 10 * CLOSE


def test_an_arm_that_flies_away_is_told_by_its_error(arm):
    """A torque a thousand times too large gives errors of half a turn, and no file of warnings."""
    stretch = measured(arm, seconds=1.0)
    wild = replace(stretch, tau=1e6 * np.ones_like(stretch.tau))
    assert np.abs(free(mjcf_of(arm)[0], wild, [200])[0, -1]).max() == pytest.approx(np.pi)


def test_bad_inputs_are_refused(arm):
    """Uneven clocks, other shapes, too few rows, other joints and windows beyond the log say what is allowed."""
    stretch, text = measured(arm, seconds=1.0), mjcf_of(arm)[0]
    t = stretch.t.copy()
    t[500:] += 0.01
    with pytest.raises(LogError, match="clock is uneven"):
        replace(stretch, t=t)
    with pytest.raises(LogError, match="allowed: \\(T,\\)"):
        replace(stretch, tau=stretch.tau[:-1])
    two = replace(stretch, q=stretch.q[:, :2], qd=stretch.qd[:, :2], tau=stretch.tau[:, :2])
    with pytest.raises(UsageError, match="3 motors, the log has 2 joints"):
        free(text, two, [200])
    with pytest.raises(UsageError, match="from row 900"):
        free(text, stretch, [900])
    with pytest.raises(LogError, match="no stretch is longer than"):
        replay(text, text, [stretch], arm.joints, length=2.0)
