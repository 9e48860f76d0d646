"""Rests without torque under gravity are left out; rests with torque, and torques without gravity, stay."""

from dataclasses import replace

import numpy as np
import pytest

from invdyn_cli.diagnosis import doctor, marks
from invdyn_cli.diagnosis.checks.samples import nominal_torque
from invdyn_cli.types import Motion
from tests.diagnosis.sick import changed, seen, sound

RATE, STOP, REST = 200.0, 18.0, 4.0


@pytest.fixture(scope="module")
def arm(apollo4):
    """Four joints, of which gravity loads some."""
    return apollo4


@pytest.fixture(scope="module")
def log(arm):
    """A sound log of it, 30 s at 200 Hz."""
    return sound(arm, rate=RATE)


def resting(log, arm, *, power: bool, share: float = 1.0, after: bool = True):
    """The log with a rest of 4 s put in at 18 s, which brakes begin within 0.1 s: torques of gravity or none, the noise
    and an offset of a hundredth beside them; `after` False ends it there."""
    raw = log.trajectories[0]
    k, draw = int(STOP * RATE), np.random.default_rng(1)
    since = np.arange(int(REST * RATE))[:, None] / RATE
    slip = np.exp(-since / 0.03)
    held = raw.q[k] + 0.03 * raw.qd[k] * (1 - slip) + 1e-5 * draw.normal(size=(len(since), arm.dofs))
    hold = share * nominal_torque(arm, Motion(held, 0 * held, 0 * held))[0] if power else 0 * held
    size = raw.tau.std(axis=0)
    still = {"q": held, "qd": raw.qd[k] * slip, "tau": hold + size * (0.01 + 0.01 * draw.normal(size=held.shape))}
    # The motion goes on from where it stopped, as a robot that drives back to its path would.
    joined = {
        c: np.concatenate([getattr(raw, c)[:k], x, getattr(raw, c)[k:][: len(raw.t) * after]]) for c, x in still.items()
    }
    return changed(log, t=np.arange(len(joined["q"])) / RATE, **joined)


@pytest.mark.parametrize("after", [True, False], ids=["in the middle", "at the end"])
@pytest.mark.parametrize("unit", [1.0, -1000.0], ids=["N m", "-N mm"])
def test_a_stop_is_left_out(log, arm, unit, after):
    """Whatever unit and sign the torque has: the rows without it go, hardly a second of the motion does."""
    bad = resting(log, arm, power=False, after=after)
    bad = changed(bad, tau=unit * bad.trajectories[0].tau)
    corrected, examination = doctor.correct(bad, arm)
    (found,) = seen(examination, "power_off", least="warn")
    (period,) = found.threshold["periods"]
    assert STOP - 1.25 < period[0] < STOP < STOP + REST < period[1] < STOP + REST + 1.25
    t = np.concatenate([x.t for x in corrected.trajectories])
    assert not np.any((t > STOP) & (t < STOP + REST)) and sum(t < STOP) > (STOP - 1.25) * RATE
    assert any("no power" in x for x in doctor.done(examination))
    unfit = [x for x in examination.checks if x.severity == "fail" and x.check not in ("unit_error", "sign_error")]
    assert not unfit and examination.usable


def test_it_is_drawn(log, arm):
    """Its rows are marked in the torque."""
    _, _, found = marks.located(resting(log, arm, power=False), arm)
    (one,) = [x for x in found if x.check == "power_off"]
    assert one.channel == "tau" and REST * RATE <= len(one.rows) <= (REST + 2.5) * RATE


@pytest.mark.parametrize("share", [1.0, 0.5, 0.2])
def test_a_rest_with_torque_stays(log, arm, share):
    """Drives that hold the arm, or a part of its weight beside the gears' friction, have power."""
    assert not seen(doctor.examine(resting(log, arm, power=True, share=share), arm), "power_off")


def test_torques_without_gravity_stay(log, arm):
    """Where gravity is subtracted from the torques a rest has none, said in the header or not."""
    bad = resting(log, arm, power=True)
    raw = bad.trajectories[0]
    free = changed(bad, tau=raw.tau - nominal_torque(arm, Motion(raw.q, 0 * raw.q, 0 * raw.q))[0])
    for one in (free, replace(free, compensated=("gravity",))):
        assert not seen(doctor.examine(one, arm), "power_off")


def test_a_torque_on_a_joint_that_gravity_does_not_load_is_power(log, arm):
    """Friction of a gear holds the loaded joints without torque, and another drive pushes: that is no stop."""
    bad = resting(log, arm, power=False)
    raw = bad.trajectories[0]
    load = np.abs(nominal_torque(arm, Motion(raw.q, 0 * raw.q, 0 * raw.q))[0]).max(axis=0)
    free = int(np.argmin(load))
    rests = (raw.t > STOP) & (raw.t < STOP + REST)
    tau = raw.tau.copy()
    tau[rests, free] += 0.5 * np.quantile(np.abs(tau[:, free]), 0.99)
    assert load[free] < 0.1 * load.max()
    assert not seen(doctor.examine(changed(bad, tau=tau), arm), "power_off")
