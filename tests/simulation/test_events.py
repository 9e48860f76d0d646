"""What comes and goes is in the log within its window and nowhere else, and is what Pinocchio makes of it.

Windows, sizes and joints are drawn at random. What is within 0.15 s of a window's edge is left out: there the filter
carries one into the other.
"""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from invdyn_cli.data.plant import Plant
from invdyn_cli.errors import UsageError
from invdyn_cli.robots import pinocchio_model
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.simulation.plant import record, simulate
from invdyn_cli.simulation.references import Multisine
from tests.simulation.recorded import RATE, SECONDS, filtered, recorded, rms, truth

EDGE = 0.15
"""[s] to either side of a step that a zero-phase low-pass at 20 Hz carries it."""

SEEDS = range(2)


def drawn(seed: int) -> tuple[np.random.Generator, list[float]]:
    """A stream, and a window of 1 to 2 s inside of what the filter leaves."""
    draw = np.random.default_rng([4, seed])
    start = draw.uniform(1.4, 2.4)
    return draw, [float(start), float(start + draw.uniform(1.0, 2.0))]


def far_from(*edges: float) -> np.ndarray:
    """(T - 2000,) whether a sample of what `filtered` leaves is far from all edges [s]."""
    t = np.arange(round(SECONDS * RATE))[1000:-1000] / RATE
    return np.all([np.abs(t - edge) > EDGE for edge in edges], axis=0)


@pytest.mark.parametrize("seed", SEEDS)
def test_gain_change(seed, apollo):
    """In the window the drive delivers gain x logged, outside of it what is logged; other joints never care."""
    draw, window = drawn(seed)
    gain, i = float(draw.uniform(0.6, 0.9)), int(draw.choice([0, 1, 3]))
    tr = recorded(apollo, Hidden("torque_gain_change", apollo.joints[i], {"gain": gain, "window": window}))
    x = truth(apollo, tr)
    inside = (x.t > window[0]) & (x.t < window[1])
    delivered = x.logged.copy()
    delivered[inside, i] *= gain
    left = (filtered(delivered) - filtered(x.nominal))[far_from(*window)]
    assert np.all(rms(left, 0) < 1e-3 * rms(filtered(x.nominal), 0))
    assert rms(filtered(x.logged - x.nominal)[:, i]) > 0.02 * rms(x.nominal[:, i])


def laden(robot, mass: float, com, radius: float):
    """The robot with a solid sphere on its last link."""
    sphere = pin.Inertia.FromSphere(mass, radius).se3Action(pin.SE3(np.eye(3), np.array(com)))
    last = robot.inertial[-1] + sphere.toDynamicParameters()
    return replace(robot, inertial=np.vstack([robot.inertial[:-1], last]))


@pytest.mark.parametrize(("seed", "ramp"), [(0, 0.0), (1, 0.8)])
def test_payload_change(seed, ramp, apollo):
    """The torque is Pinocchio's with the payload inside the window, without it outside, and with a share of its mass
    that grows and falls linearly over the ramp around either edge."""
    draw, window = drawn(seed)
    mass, com, radius = (
        float(draw.uniform(0.3, 1.2)),
        list(draw.uniform(-0.05, 0.1, 3)),
        float(draw.uniform(0.01, 0.05)),
    )
    how = {"mass": mass, "com": com, "radius": radius, "window": window} | ({"ramp": ramp} if ramp else {})
    tr = recorded(apollo, Hidden("payload_change", None, how))
    without, full = truth(apollo, tr), truth(laden(apollo, mass, com, radius), tr)
    corners = [edge + side * ramp / 2 for edge in window for side in (-1, 1)]
    share = np.interp(without.t, corners, [0, 1, 1, 0]) if ramp else (without.t > window[0]) & (without.t < window[1])
    expected = without.nominal + share[:, None] * (full.nominal - without.nominal)
    left = (filtered(without.logged) - filtered(expected))[far_from(*corners)]
    assert np.all(rms(left, 0) < 1e-3 * rms(filtered(expected), 0))
    assert rms(filtered(expected - without.nominal)) > 0.01 * rms(filtered(expected))


@pytest.mark.parametrize("placed", [False, True])
@pytest.mark.parametrize("seed", SEEDS)
def test_contact(seed, placed, apollo):
    """A force in the base frame at a point of a link, or without one at a joint's origin, adds minus the Jacobian's
    transpose times it, by Pinocchio's Jacobian, in the window; joints behind it do not feel it."""
    draw, window = drawn(seed)
    i, force = int(draw.integers(2, 6) if placed else draw.integers(3, 7)), draw.uniform(-30, 30, 3)
    point = draw.uniform(-0.05, 0.05, 3) if placed else np.zeros(3)
    hidden = {"force": force.tolist(), "window": window, **({"point": point.tolist()} if placed else {})}
    tr = recorded(apollo, Hidden("external_contact", apollo.joints[i], hidden))
    x, model = truth(apollo, tr), pinocchio_model(apollo)
    data, joint = model.createData(), model.getJointId(apollo.joints[i])
    term = np.zeros_like(x.q)
    for k in np.flatnonzero((x.t > window[0]) & (x.t < window[1])):
        pin.computeJointJacobians(model, data, x.q[k])
        jacobian = pin.getJointJacobian(model, data, joint, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        moment = np.cross(data.oMi[joint].rotation @ point, force)
        term[k] = -jacobian[:3].T @ force - jacobian[3:].T @ moment
    left = (filtered(x.logged) - filtered(x.nominal + term))[far_from(*window)]
    assert np.all(rms(left, 0) < 1e-3 * rms(filtered(x.nominal + term), 0))
    assert rms(filtered(term)) > 0.02 * rms(filtered(x.nominal))
    assert np.abs(term[:, i + placed :]).max() < 1e-9 * np.abs(term).max()


EVENTS = {
    "payload_change": Hidden("payload_change", None, {"mass": 1.0, "com": [0.0, 0.0, 0.1], "window": [1.0, 2.0]}),
    "torque_gain_change": Hidden("torque_gain_change", "arm_joint_2", {"gain": 0.7, "window": [1.0, 2.0]}),
    "external_contact": Hidden("external_contact", "arm_joint_4", {"force": [9.0, 0.0, 5.0], "window": [1.0, 2.0]}),
}


@pytest.mark.parametrize("name", EVENTS)
def test_nobody_knows_before(name, apollo):
    """Until the window begins, the log is that of an arm to which nothing happens, to rounding; where a load comes, to
    0.5 % of the torque, for the feedback's gains are such as hold it. Then it differs by more than ten times that."""
    plain, eventful = (simulate(apollo, Multisine(), hidden, duration=2.0) for hidden in ((), (EVENTS[name],)))
    scale = (5e-3 if name == "payload_change" else 1e-9) * rms(plain.tau)
    off = eventful.tau - plain.tau
    assert rms(off[:1000]) < scale
    assert rms(off[1000:]) > max(10 * scale, 0.05)


@pytest.mark.parametrize("name", EVENTS)
def test_in_one_trajectory(name, apollo):
    """An event that names a trajectory happens in that one; the others are as if it were not, to the last bit."""
    here = replace(EVENTS[name], parameters={**EVENTS[name].parameters, "trajectory": "trajectory_2"})
    ways = [Multisine(), Multisine()]
    first, second = record(apollo, ways, [here], duration=2.0).trajectories
    plain_first, plain_second = record(apollo, ways, duration=2.0).trajectories
    assert np.array_equal(first.tau, plain_first.tau)
    assert not np.allclose(second.tau, plain_second.tau)


WRONG = (
    ([8.0, 24.0], {}, "its window ends at 24 s; allowed: up to 20 s"),
    ([14.0, 8.0], {}, r"window=\[14.0, 8.0\]; allowed: \[start, end\] in s, 0 <= start < end"),
    ([-1.0, 8.0], {}, r"window=\[-1.0, 8.0\]; allowed"),
    ([8.0, 8.0], {}, r"window=\[8.0, 8.0\]; allowed"),
    ([8.0], {}, r"window=\[8.0\]; allowed: two times"),
    (8.0, {}, r"window=8.0; allowed: two times"),
    (["a", "b"], {}, r"allowed: two times"),
    ([8.0, 14.0], {"ramp": 7.0}, "ramp=7 s; allowed: up to the length of the window, 6 s"),
    ([8.0, 14.0], {"trajectory": "trajectory_3"}, "no trajectory 'trajectory_3', did you mean .*allowed: trajectory_1"),
    ([8.0, 14.0], {"trajectory": 3}, "trajectory=3; allowed: a trajectory's name"),
)


@pytest.mark.parametrize(("window", "more", "said"), WRONG, ids=[said for _, _, said in WRONG])
def test_refuses(window, more, said):
    """A window that is none or outside of the recording, and a trajectory that is not made, are refused in one line
    before anything is simulated."""
    effect = {"effect": "payload_change", "mass": 0.85, "com": [0, 0, 0.1], "window": window, **more}
    with pytest.raises(UsageError, match=said):
        Plant(effects=[effect], duration=20.0, trajectories=2)


def test_needs_a_window(apollo):
    """An event without a window is refused, and so is one that a single recording is too short for."""
    with pytest.raises(UsageError, match="lacks window"):
        recorded(apollo, Hidden("torque_gain_change", "arm_joint_2", {"gain": 0.7}))
    with pytest.raises(UsageError, match=r"allowed: up to 1\.5 s"):
        recorded(apollo, EVENTS["payload_change"], duration=1.5)
