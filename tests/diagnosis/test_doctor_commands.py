"""q_ref beside q: unit, sign and lag are found together with their sizes, and nothing is said where q_ref is another
motion."""

import numpy as np
import pytest

from invdyn_cli.diagnosis import doctor
from invdyn_cli.robots import load_urdf
from tests.diagnosis.sick import changed, seen, sound


@pytest.fixture(scope="module")
def arm():
    """Four joints of the built-in arm."""
    return load_urdf("apollo_arm", joints=[f"arm_joint_{i}" for i in (1, 2, 3, 4)])


def recorded(arm, seed: int):
    """A log without q_ref, and a function that gives its positions `seconds` earlier."""
    log = sound(arm, seed, seconds=25)
    raw = log.trajectories[0]
    longer = np.pad(raw.q, ((2000, 2000), (0, 0)), mode="reflect", reflect_type="odd")
    t = np.arange(len(longer)) * 0.005 - 10.0

    def earlier(seconds: float) -> np.ndarray:
        return np.stack([np.interp(raw.t + seconds, t, column) for column in longer.T], axis=1)

    return log, earlier


@pytest.mark.parametrize("seed", range(4))
def test_lag_unit_and_sign_come_together(seed, arm):
    """Lags of tens of milliseconds to seconds, of either sign, with q_ref in another unit and one joint's sign turned:
    the lag comes out within 2 ms, the unit and the joint are named, and correcting leaves the lag alone."""
    draw = np.random.default_rng(seed)
    log, earlier = recorded(arm, seed)
    lag = float(draw.choice([-1, 1]) * draw.uniform(0.02, 2.5))
    factor = float(draw.choice([180 / np.pi, np.pi / 180, 1 / (2 * np.pi)]))
    joint = int(draw.integers(4))
    sign = np.where(np.arange(4) == joint, -1.0, 1.0)
    bad = changed(log, q_ref=factor * sign * earlier(lag))
    corrected, examination = doctor.correct(bad, None)
    (unit,) = seen(examination, "unit_error", least="warn")
    assert (unit.threshold["channel"], unit.threshold["factor"]) == ("q_ref", pytest.approx(factor))
    (turned,) = seen(examination, "sign_error", least="warn")
    assert turned.joint == arm.joints[joint]
    (late,) = seen(examination, "time_offset")
    assert late.value == pytest.approx(lag, abs=2e-3)
    notes = doctor.done(examination)
    assert len(notes) == 2
    np.testing.assert_allclose(np.asarray(corrected.trajectories[0].q_ref), earlier(lag), atol=1e-9)


def test_a_drive_that_follows_at_once_is_ok(arm):
    """A lag below a centisecond is no finding, and its number is there."""
    log, earlier = recorded(arm, 5)
    examination = doctor.examine(changed(log, q_ref=earlier(0.004)), None)
    assert seen(examination, "time_offset") == []
    (fine,) = [c for c in examination.checks if c.check == "time_offset" and c.severity == "ok"]
    assert fine.value == pytest.approx(0.004, abs=1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_another_motion_is_no_command(seed, arm):
    """Where q_ref is another motion, nothing is said of its lag, unit or sign: the checks are skipped and say why."""
    log, _ = recorded(arm, seed)
    other = sound(arm, seed + 50, seconds=25).trajectories[0].q
    examination = doctor.examine(changed(log, q_ref=other), None)
    for name in ("time_offset", "unit_error", "sign_error"):
        assert seen(examination, name) == []
        mine = [c for c in examination.checks if c.check == name and c.severity == "skipped"]
        assert any("q_ref explains" in c.seen for c in mine)


def test_a_sine_is_not_turned_round(arm):
    """Half a period later a sine fits with the opposite sign; the same sign is taken, and the other lags are told."""
    log, _ = recorded(arm, 0)
    raw = log.trajectories[0]
    q = np.sin(2 * np.pi * raw.t[:, None] / 3.0 + np.arange(4)) + 1e-5 * np.random.default_rng(0).normal(
        size=raw.q.shape
    )
    ref = np.sin(2 * np.pi * (raw.t[:, None] + 0.2) / 3.0 + np.arange(4))
    examination = doctor.examine(changed(log, q=q, qd=None, q_ref=ref), None)
    assert seen(examination, "sign_error") == []
    (late,) = seen(examination, "time_offset")
    assert late.value == pytest.approx(0.2, abs=2e-3)
    assert "the motion repeats" in late.seen
