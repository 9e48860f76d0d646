"""Angles within one turn are made continuous; everything else that jumps stays as it is."""

from dataclasses import replace

import numpy as np
import pytest

from invdyn_cli.diagnosis import doctor
from invdyn_cli.diagnosis.checks.samples import nominal_torque
from invdyn_cli.log import Log, RawTrajectory
from invdyn_cli.types import Motion
from tests.diagnosis.sick import changed, seen
from tests.records import make_robot

T = np.arange(0, 20, 0.005)
TURN = 2 * np.pi
WRAPS = {
    "to pi": lambda x: np.pi - (np.pi - x) % TURN,
    "to 2 pi": lambda x: x % TURN,
    "in float32": lambda x: (np.pi - (np.pi - x) % TURN).astype(np.float32).astype(float),
    "in degrees": lambda x: np.degrees(x) % 360,
}


def log_of(robot, q) -> Log:
    qd, qdd = np.gradient(q, T, axis=0), np.gradient(np.gradient(q, T, axis=0), T, axis=0)
    tau, _ = nominal_torque(robot, Motion(q, qd, qdd))
    return Log("toy", robot.joints, "motor", "N m", 200.0, (RawTrajectory("run", T, q, tau),))


@pytest.fixture(scope="module")
def robot():
    """A joint without limits, and one that may turn once in either direction."""
    made = make_robot(("roll", "bend"))
    return replace(made, lower=np.array([-np.inf, -TURN]), upper=np.array([np.inf, TURN]))


@pytest.fixture(scope="module")
def q():
    """(T, 2) [rad] of both: over one turn, with noise of an encoder, so that ends are passed to and fro."""
    noise = 1e-4 * np.random.default_rng(0).normal(size=(len(T), 2))
    return np.stack([5 * np.sin(0.9 * T) + np.sin(2.3 * T), 4.5 * np.sin(1.1 * T + 1)], axis=1) + noise


@pytest.mark.parametrize("how", WRAPS)
def test_jumps_of_a_turn_are_undone(how, robot, q):
    """A joint with limits and one without get their motion back but for whole turns; commands are put beside it."""
    ref = q + 0.01
    bad = changed(log_of(robot, q), q=WRAPS[how](q), q_ref=WRAPS[how](ref))
    corrected, examination = doctor.correct(bad, robot)
    one = corrected.trajectories[0]
    off = (one.q - q) / TURN
    np.testing.assert_allclose(off, np.tile(np.round(off[0]), (len(T), 1)), atol=1e-4)
    np.testing.assert_allclose(one.q_ref - one.q, ref - q, atol=1e-4)
    assert np.round(off[0, 1]) == 0  # where its limits are
    assert {x.threshold["channel"] for x in seen(examination, "wrapped_angle")} == {"q", "q_ref"}
    assert sum("made continuous" in x for x in doctor.done(examination)) == 4


def test_as_recorded(robot, q):
    """With correct=false the jumps are told and stay, and the log is not usable."""
    bad = changed(log_of(robot, q), q=WRAPS["to pi"](q))
    kept, examination = doctor.correct(bad, robot, change=False)
    assert len(seen(examination, "wrapped_angle", least="fail")) == 2 and not examination.usable
    np.testing.assert_array_equal(kept.trajectories[0].q, bad.trajectories[0].q)


def spiked(q):
    """One sample that is off by half a turn."""
    out = q.copy()
    out[1000] += np.pi
    return out


KEPT = {
    "no jump": lambda q: q,
    "less than a turn": lambda q: np.where(T[:, None] < 10, q, q - 0.8 * TURN),
    "an outlier": spiked,
    "several turns": lambda q: np.where(T[:, None] < 10, 3 * q, 3 * q - TURN),
}


@pytest.mark.parametrize("how", KEPT)
def test_other_jumps_stay(how, robot, q):
    """Steps that are no turn, and a turn of a joint that covers several, are not undone."""
    assert not seen(doctor.examine(changed(log_of(robot, q), q=KEPT[how](q)), robot), "wrapped_angle")


def test_a_slide_has_no_turns(robot, q):
    """A slide that jumps by 2 pi m is not corrected."""
    slides = replace(robot, prismatic=(True, True))
    bad = changed(log_of(robot, q), q=WRAPS["to pi"](q))
    assert not seen(doctor.examine(bad, slides), "wrapped_angle")


def test_a_gap_is_not_a_jump(robot, q):
    """What happens in a gap is not known: a turn there is left alone, while jumps between samples are undone."""
    keep = (T < 8) | (T > 9)
    raw = log_of(robot, q).trajectories[0]
    rows = replace(
        raw, t=T[keep], q=np.where(T[keep, None] < 8.5, 0.2 * q[keep], 0.2 * q[keep] + TURN), tau=raw.tau[keep]
    )
    bad = Log("toy", robot.joints, "motor", "N m", 200.0, (rows,))
    assert not seen(doctor.examine(bad, robot), "wrapped_angle")
